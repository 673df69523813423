from __future__ import annotations

import math
from typing import Any

import pytest
from tests.motion.arms import state

from hexwire.drivers.arm_file import load_profile
from hexwire.drivers.tools import Gripper, Suction
from hexwire.errors import UsageError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.state import JointTarget
from hexwire.wire.command_frame import Command


class Robot:
    """Keeps what it was told."""

    model = HEX7BOT

    def __init__(self) -> None:
        self.io: list[tuple[int, bytes]] = []
        self.value = 0
        self.targets: list[JointTarget] = []

    def ioctl(self, sub_cmd: int, data: bytes = b"") -> bytes:
        self.io.append((sub_cmd, data))
        mask, value = data
        self.value = (self.value & ~mask) | (value & mask)
        return bytes((mask, self.value))

    def write(self, target: JointTarget) -> None:
        self.targets.append(target)


@pytest.fixture
def robot() -> Any:
    return Robot()


def test_suction_is_pump_and_valve_and_leaves_the_buzzer_alone(robot: Any) -> None:
    robot.value = 0x04
    suction = Suction(robot)
    suction.suck()
    assert robot.value == 0x05
    assert suction.read() == (True, False)
    suction.release()
    assert suction.read() == (False, True)
    suction.off()
    assert suction.read() == (False, False)
    assert robot.value == 0x04
    assert {cmd for cmd, _ in robot.io} == {Command.IO}


def test_gripper_shares(robot: Any) -> None:
    gripper = Gripper(robot)
    gripper.move(0.0)
    gripper.move(1.0)
    j7 = HEX7BOT.joint("J7")
    assert [dict(t.positions)["J7"] for t in robot.targets] == pytest.approx([j7.maximum, j7.minimum])
    assert gripper.share(state({"J7": gripper.angle(0.3)})) == pytest.approx(0.3)
    with pytest.raises(UsageError, match=r"not 1\.5"):
        gripper.move(1.5)


def test_gripper_holds_when_it_presses_short_of_its_goal(robot: Any) -> None:
    gripper = Gripper(robot)
    between = gripper.angle(0.4)
    assert gripper.holds(state({"J7": between}, load={"J7": 0.5}), 0.0)
    assert not gripper.holds(state({"J7": between}, load={"J7": 0.1}), 0.0)
    assert not gripper.holds(state({"J7": between}, load={"J7": math.nan}), 0.0)
    assert not gripper.holds(state({"J7": gripper.angle(0.0)}, load={"J7": 0.5}), 0.0)


def test_gripper_keeps_a_little_pressure(robot: Any) -> None:
    gripper = Gripper(robot)
    gripper.keep(state({"J7": 0.1}))
    gripper.keep(state({"J7": gripper.joint.maximum}))
    assert [dict(t.positions)["J7"] for t in robot.targets] == pytest.approx(
        [0.1 + math.radians(3), gripper.joint.maximum]
    )


def test_the_gripper_of_an_so_arm_closes_at_its_lower_limit(robot: Any) -> None:
    robot.model = load_profile("so101").model
    gripper = Gripper(robot)
    gripper.move(0.0)
    gripper.move(1.0)
    joint = robot.model.joint("gripper")
    assert [dict(t.positions)["gripper"] for t in robot.targets] == pytest.approx([joint.minimum, joint.maximum])


def test_an_unknown_gripper_is_not_guessed_at(robot: Any) -> None:
    robot.model = load_profile("chain").model
    with pytest.raises(UsageError, match=r"no gripper of chain is known.*`hexwire move NAME=DEGREES`"):
        Gripper(robot)
    assert robot.targets == []
