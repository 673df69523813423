"""The angles that the chapter's log prints, from the counts that its servos gave."""

from __future__ import annotations

import math
from typing import Any

import pytest
from tests.model.poses import VECTORS

from hexwire.model.arms.hex7bot.joints import HEX7BOT


@pytest.mark.parametrize("row", VECTORS["chapter_log"], ids=lambda row: row["joint"])
def test_printed_angle_to_all_six_digits(row: dict[str, Any]) -> None:
    joint = HEX7BOT.joint(row["joint"])
    angle = math.degrees(joint.counts_to_angle(joint.neutral + row["counts"]))
    # As C++ streams print: six significant digits.
    assert f"{angle:.6g}" == f"{row['printed']:.6g}"


@pytest.mark.parametrize("row", VECTORS["chapter_log"], ids=lambda row: row["joint"])
def test_printed_angle_back_to_counts(row: dict[str, Any]) -> None:
    joint = HEX7BOT.joint(row["joint"])
    assert joint.angle_to_counts(math.radians(row["printed"])) == joint.neutral + row["counts"]


def test_first_joint_from_the_bytes_on_the_wire() -> None:
    # FF F5 00 04 00 05 08 EE: 0x0805 in the order the firmware gives the host.
    assert f"{math.degrees(HEX7BOT.joint('J1').counts_to_angle(0x0805)):.6g}" == "-4.47257"


def test_one_count_is_the_rounded_constant() -> None:
    for joint in HEX7BOT.joints:
        step = joint.counts_to_angle(2048) - joint.counts_to_angle(2047)
        assert step == pytest.approx(0.001534, abs=1e-12)
        assert step != pytest.approx(math.tau / 4096, abs=1e-9)


def test_joints_and_servos() -> None:
    assert HEX7BOT.names == ("J1", "J2", "J3", "J4", "J5", "J6", "J7")
    assert [joint.series for joint in HEX7BOT.joints] == ["seven_bot"] * 4 + ["hls"] * 3
    assert [joint.servo_id for joint in HEX7BOT.joints] == list(range(7))
    for joint in HEX7BOT.joints:
        low, high = joint.count_limits
        assert 0 <= low < joint.neutral < high <= 4095
