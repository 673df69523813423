from __future__ import annotations

import math
from dataclasses import replace

from hexwire.drivers.arm_file import load_profile
from hexwire.model.geometry import make_kinematics
from hexwire.model.hex7bot import HEX7BOT
from hexwire.studio.pages.arm_joints import joints_html, space_html, tip_html


def test_each_joint_has_a_labelled_slider_with_its_limits() -> None:
    html = joints_html(HEX7BOT)
    assert html.count('role="slider"') == 7
    assert 'aria-label="J3" aria-orientation="horizontal"\n      aria-valuemin="-82.5" aria-valuemax="77.5"' in html
    assert html.count('aria-label="Jog J3 ') == 2
    assert "−82.5" in html


def test_a_name_of_a_users_arm_file_is_text() -> None:
    joint = replace(HEX7BOT.joints[0], name='<b onclick="x">', minimum=math.radians(-0.04))
    html = joints_html(replace(HEX7BOT, joints=(joint, *HEX7BOT.joints[1:])))
    assert "<b onclick" not in html
    assert "&lt;b onclick=&quot;x&quot;&gt;" in html
    assert 'aria-valuemin="0"' in html


def test_the_tip_of_an_arm_of_five_joints_has_pitch_and_roll() -> None:
    assert tip_html(make_kinematics("hex7bot")).count("data-tip") == 6
    five = tip_html(make_kinematics("so101"))
    assert 'data-tip="toolpitch"' in five
    assert "yaw" not in five
    assert load_profile("so101").model.names[0] in joints_html(load_profile("so101").model)


def test_jog_in_space_has_a_button_for_each_direction() -> None:
    html = space_html()
    for place in range(6):
        for turn in (-1, 1):
            assert html.count(f'data-axis="{place}" data-turn="{turn}"') == 1
    assert html.count("aria-label=") == 14
