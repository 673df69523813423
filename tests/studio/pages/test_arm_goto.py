from __future__ import annotations

from dataclasses import replace

from hexwire.drivers.arm_file import load_profile
from hexwire.model.geometry import make_kinematics
from hexwire.model.hex7bot import HEX7BOT
from hexwire.studio.pages.arm_goto import goto_html, number_field


def test_an_arm_is_aimed_as_its_joints_allow() -> None:
    six = goto_html(HEX7BOT, make_kinematics("hex7bot"))
    five = goto_html(load_profile("so101").model, make_kinematics("so101"))
    assert 'value="rpy"' in six
    assert 'value="pitch"' not in six
    assert 'value="pitch"' in five
    assert 'value="rpy"' not in five
    assert [f'name="{axis}"' in six for axis in ("x", "y", "z", "roll", "pitch", "yaw")] == [True] * 6


def test_without_geometry_there_are_joint_angles_only() -> None:
    html = goto_html(HEX7BOT, None)
    assert html.count('type="radio"') == 1
    assert 'name="x"' not in html
    assert html.count('name="joint:') == 7
    assert 'data-for="joints">' in html


def test_names_are_text() -> None:
    assert number_field('a"b', "<i>", "mm").count("&lt;i&gt;") == 1
    joint = replace(HEX7BOT.joints[0], name='"><script>')
    assert "<script>" not in goto_html(replace(HEX7BOT, joints=(joint, *HEX7BOT.joints[1:])), None)
