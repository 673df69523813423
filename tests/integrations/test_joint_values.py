"""LeRobot's numbers for joints. The rest of the plug-in is tested with LeRobot: `make test-lerobot`."""

from __future__ import annotations

import importlib.util
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hexwire.drivers.arm_file import load_profile
from hexwire.model.arm import ArmModel
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.calibration import Calibration, JointCalibration

FILE = Path(__file__).parents[2] / "integrations/lerobot/src/lerobot_robot_hexwire/joint_values.py"
LOW, HIGH = 900, 3301
"""Of a range whose middle lies between two counts."""


def module() -> Any:
    spec = importlib.util.spec_from_file_location("joint_values", FILE)
    assert spec is not None
    assert spec.loader is not None
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


JointValues = module().JointValues


def so101() -> ArmModel:
    model = load_profile("so101").model
    rows = [JointCalibration(j.name, j.servo_id, (LOW + HIGH) / 2, LOW, HIGH, turn=4095) for j in model.joints]
    return Calibration("so101", "", tuple(rows)).apply(model)


def lerobot(counts: int, unit: str, drive_mode: int = 0) -> float:
    """`MotorsBus._normalize` of LeRobot 0.4.4."""
    share = (min(HIGH, max(LOW, counts)) - LOW) / (HIGH - LOW)
    if unit == "degrees":
        return (counts - (LOW + HIGH) / 2) * 360 / 4095
    if unit == "percent":
        return 100 - 100 * share if drive_mode else 100 * share
    return (-1 if drive_mode else 1) * (200 * share - 100)


@pytest.mark.parametrize("counts", [LOW, 1000, 2048, 2100, HIGH, HIGH + 50])
@pytest.mark.parametrize("drive_mode", [0, 1])
@pytest.mark.parametrize("degrees", [True, False])
def test_the_same_file_gives_the_same_values_as_in_lerobot(counts: int, drive_mode: int, degrees: bool) -> None:
    model = so101()
    values = JointValues(model, degrees=degrees, reversed_joints=model.names if drive_mode else ())
    found = values.values(joint.counts_to_angle(counts) for joint in model.joints)
    unit = "degrees" if degrees else "range"
    body = lerobot(counts, unit, drive_mode)
    wanted = [body] * 5 + [lerobot(counts, "percent", drive_mode)]
    assert list(found) == [f"{name}.pos" for name in model.names]
    assert list(found.values()) == pytest.approx(wanted, abs=1e-9)
    if counts <= HIGH:
        back = values.angles(found)
        assert [joint.angle_to_counts(back[joint.name]) for joint in model.joints] == [counts] * 6


def test_a_gripper_that_closes_at_its_upper_limit() -> None:
    values = JointValues(HEX7BOT, degrees=True)
    joint = HEX7BOT.joint("J7")
    assert values.value("J7", joint.maximum) == pytest.approx(0.0)
    assert values.value("J7", joint.minimum) == pytest.approx(100.0)
    assert values.value("J1", 1.0) == pytest.approx(math.degrees(1.0))


def test_some_joints_and_other_keys() -> None:
    values = JointValues(so101(), degrees=True)
    assert values.angles({"elbow_flex.pos": 90, "task": 1.0}) == {"elbow_flex": pytest.approx(math.pi / 2)}


def test_what_is_no_number() -> None:
    values = JointValues(so101(), degrees=False)
    for value in (math.nan, math.inf, -math.inf, None, "fast", 10**400):
        with pytest.raises(ValueError, match=r"the action of gripper is .*; nothing was sent"):
            values.angles({"gripper.pos": value})  # type: ignore[dict-item]  # also what is no number at all


def test_a_joint_that_does_not_exist() -> None:
    model = so101()
    values = JointValues(replace(model, joints=model.joints[:2]), degrees=True)
    with pytest.raises(ValueError, match="no joint 'gripper'; there are shoulder_pan, shoulder_lift"):
        values.angles({"gripper.pos": 1.0})
