"""The state of a whole robot in one word."""

from __future__ import annotations

import math
from typing import Any

import pytest
from tests.drivers.arms import Arm
from tests.drivers.test_base import Plain
from tests.model.states import make_state

from hexwire.drivers.base import RobotState
from hexwire.errors import DeviceError, LinkLostError, ReplyTimeoutError
from hexwire.model.state import JointFlag, JointState

ON, UNKNOWN, SILENT, HOT = (
    int(flag) for flag in (JointFlag.TORQUE_ON, JointFlag.TORQUE_UNKNOWN, JointFlag.SILENT, JointFlag.TEMPERATURE)
)
STOPPED = {"stopped": True, "maintenance": True, "flags": (HOT,), "velocity": (1.0,)}


@pytest.mark.parametrize(
    ("known", "state"),
    [
        ({}, RobotState.LIMP),
        ({"flags": (int(JointFlag.CLAMPED),)}, RobotState.LIMP),
        ({"flags": (ON,)}, RobotState.HOLDING),
        ({"flags": (UNKNOWN,)}, RobotState.HOLDING),
        ({"flags": (ON,), "velocity": (-0.04,)}, RobotState.HOLDING),
        ({"flags": (ON,), "velocity": (math.nan,)}, RobotState.HOLDING),
        ({"flags": (ON,), "velocity": (-0.06,)}, RobotState.MOVING),
        ({"velocity": (1.0,), "maintenance": True}, RobotState.MAINTENANCE),
        ({"flags": (ON | SILENT,), "maintenance": True}, RobotState.FAULT),
        ({"flags": (ON | HOT,), "velocity": (1.0,)}, RobotState.FAULT),
        (STOPPED, RobotState.STOPPED),
    ],
)
def test_a_state_has_one_word(known: dict[str, Any], state: RobotState) -> None:
    assert RobotState.of(make_state(0.0, **known)) is state


def test_the_numbers_stay() -> None:
    names = ["DETACHED", "LOST", "LIMP", "HOLDING", "MOVING", "STOPPED", "FAULT", "MAINTENANCE"]
    assert [state.name for state in RobotState] == names
    assert [int(state) for state in RobotState] == list(range(8))


@pytest.mark.parametrize("error", [LinkLostError("gone", url="x"), ReplyTimeoutError("a read", attempts=3)])
def test_a_robot_without_an_answer_is_lost(error: Exception) -> None:
    class Mute(Plain):
        def read(self) -> JointState:
            raise error

    robot = Mute()
    assert robot.robot_state() is RobotState.DETACHED
    robot.attach()
    assert robot.robot_state() is RobotState.LOST


def test_another_error_is_not_hidden() -> None:
    with Plain() as robot:
        robot.broken = True
        with pytest.raises(DeviceError, match="fell over"):
            robot.robot_state()


@pytest.mark.parametrize("dialect", [1, 2])
def test_an_arm_goes_through_its_states(dialect: int) -> None:
    arm = Arm(dialect, attach=False)
    robot = arm.driver
    assert robot.robot_state() is RobotState.DETACHED
    robot.attach()
    # A board of dialect 1 does not report torque.
    assert robot.robot_state() is (RobotState.HOLDING if dialect == 1 else RobotState.LIMP)
    robot.torque(True)
    assert robot.robot_state() is RobotState.HOLDING
    robot.stop()
    assert robot.robot_state() is RobotState.STOPPED
    robot.resume()
    assert robot.robot_state() is RobotState.HOLDING
    robot.detach()
    assert robot.robot_state() is RobotState.DETACHED
