"""Sticks made of numbers move emulated arms, in simulated time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple, NoReturn

import pytest

from hexwire.control.loop.owner import RobotOwner, release
from hexwire.control.motion.path_check import PathCheck
from hexwire.control.motion.teleop import TeleopController, run_teleop
from hexwire.drivers.base import RobotDriver
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.drivers.puma260 import Puma260Driver
from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.puma import EmulatedPuma
from hexwire.emulator.serve import BoardLink, FakeClock
from hexwire.errors import LimitError, ReplyTimeoutError, UsageError
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.model.arms.puma260.kinematics import Puma260Model
from hexwire.model.state import JointTarget
from hexwire.motion.teleop import JogMode, StickMap, Teleop
from hexwire.wire.modules import ModuleType

HELD = 1 << 4
PERIOD = 0.05
Script = Callable[[float], tuple[dict[int, float], int, float]]


class Rig(NamedTuple):
    """An arm, the rules, and a hand that does what a script says."""

    robot: RobotDriver
    rules: Teleop
    clock: FakeClock
    notes: list[object]

    def run(self, script: Script, seconds: float) -> None:
        """`script` gives axes, buttons and age for each time."""
        began = self.clock()

        def stick() -> tuple[tuple[float, ...], int, float]:
            axes, buttons, age = script(self.clock() - began)
            return tuple(axes.get(i, 0.0) for i in range(8)), buttons, age

        owner = RobotOwner(
            self.robot, borrowed=True, command_rate=1 / PERIOD, watchdog=0.0, sleep=self.clock.advance
        )
        owner.group.members = (TeleopController(self.rules, stick, PERIOD, self.notes.append),)
        owner.connect()
        while self.clock() < began + seconds - PERIOD / 2:
            owner.turn()
        # Given up as it is: the end of a teleoperation would hold the joints.
        release(self.robot, owner)

    def at(self, name: str) -> float:
        return self.robot.read()[name].position


def hex7bot(dialect: int = 2, mode: JogMode = JogMode.JOINT) -> Rig:
    clock = FakeClock(1000.0)
    board = make_hex7bot_board(dialect=dialect, baud=115200, faults=(), start=clock.time)
    robot: RobotDriver = Hex7BotDriver(Session(IpcHandle.from_link(BoardLink(board, clock, baud=115200))))
    robot.attach()
    return Rig(robot, Teleop(robot.model, Hex7BotModel(), mode=mode), clock, [])


def puma(mode: JogMode = JogMode.JOINT) -> Rig:
    clock = FakeClock(1000.0)
    link = BoardLink(EmulatedPuma(start=clock.time).connect(253), clock)
    handle = IpcHandle.from_link(link, ModuleType.PUMA260_HOST_IO_TRX, ModuleType.PUMA260_RBT_IO_SVR)
    robot: RobotDriver = Puma260Driver(Session(handle))
    robot.attach()
    return Rig(robot, Teleop(robot.model, Puma260Model(), mode=mode), clock, [])


@pytest.fixture(params=[hex7bot, puma])
def rig(request: pytest.FixtureRequest) -> Iterator[Rig]:
    made: Rig = request.param()
    made.robot.torque(True)
    yield made
    made.robot.detach()


def push(
    axis: int, *, begin: float = 0.1, rest: float = 0.1, until: float = math.inf, lost: float = math.inf
) -> Script:
    def script(t: float) -> tuple[dict[int, float], int, float]:
        held = begin <= t < until
        return ({axis: 1.0} if t > begin + rest else {}), HELD if held else 0, 0.0 if t < lost else t - lost + 0.3

    return script


def test_a_joint_follows_the_stick(rig: Rig) -> None:
    before = rig.at("J1")
    others = [rig.at(name) for name in rig.robot.model.names[1:]]
    rig.run(push(0), 1.6)
    speed = rig.robot.model.joints[0].max_speed
    assert rig.at("J1") - before == pytest.approx(0.3 * speed * 1.4, rel=0.2)
    assert [rig.at(name) for name in rig.robot.model.names[1:]] == pytest.approx(others, abs=0.01)


@pytest.mark.parametrize("how", ["released", "lost"])
def test_letting_go_and_losing_the_channel_brakes_and_holds(rig: Rig, how: str) -> None:
    end = 1.5
    script = push(0, until=end) if how == "released" else push(0, lost=end)
    rig.run(script, end)
    there = rig.at("J1")
    rig.run(lambda t: script(t + end), 0.6)
    rig.clock.advance(1.0)
    joint = rig.robot.model.joints[0]
    speed = 0.3 * joint.max_speed
    # No more than it moves in the cycle that it takes to hear of it, and what it needs to brake and to stand.
    brakes = 0.5 * speed * (speed / joint.max_acceleration + joint.max_acceleration / joint.max_jerk)
    assert brakes < abs(rig.at("J1") - there) < 3 * speed * PERIOD + brakes
    rig.run(lambda t: script(t + end + 1), 1.0)
    held = rig.at("J1")
    rig.clock.advance(1.0)
    assert rig.at("J1") == pytest.approx(held, abs=2e-3)
    assert not rig.robot.read().stopped


def test_a_stop_of_somebody_else_is_not_ended_by_the_stick(rig: Rig) -> None:
    rig.run(push(0), 0.5)
    rig.robot.stop()
    rig.clock.advance(0.5)
    there = rig.at("J1")
    rig.run(lambda t: ({0: 1.0}, HELD, 0.0), 0.5)
    assert rig.at("J1") == pytest.approx(there, abs=2e-3)
    rig.robot.resume()
    # The button is still down: it must be released first.
    rig.run(lambda t: ({0: 1.0}, HELD, 0.0), 0.5)
    assert rig.at("J1") == pytest.approx(there, abs=2e-3)


@pytest.mark.parametrize("make", [hex7bot, puma])
def test_cartesian_jog_moves_the_tool(make: Callable[..., Rig]) -> None:
    rig = make(mode=JogMode.CARTESIAN)
    robot, kinematics = rig.robot, rig.rules.kinematics
    assert kinematics is not None
    robot.torque(True)
    start = {"J1": 0.4, "J2": -0.6, "J3": -0.4, "J5": 0.4} if make is puma else {"J2": 0.7, "J5": 0.5}
    robot.write(JointTarget.of(start, 2.0))
    rig.clock.advance(4.0)

    def tool() -> tuple[float, ...]:
        return kinematics.forward(kinematics.from_joints(robot.read().positions)).position

    before = tool()
    rig.run(push(0), 1.4)
    after = tool()
    assert after[0] - before[0] == pytest.approx(0.05, abs=0.015)
    assert after[1:] == pytest.approx(before[1:], abs=0.008)
    robot.detach()


def test_the_chapters_board_can_be_driven_too() -> None:
    rig = hex7bot(dialect=1)
    rig.robot.torque(True)
    before = rig.at("J1")
    rig.run(push(0, begin=1.0, rest=1.0), 20.0)
    assert rig.at("J1") > before + 0.1
    rig.robot.detach()


def test_a_set_point_goes_no_further_than_one_of_a_program() -> None:
    rig = hex7bot()
    model = Hex7BotModel()
    path = PathCheck(HEX7BOT, model, None)
    stick = StickMap(axes=(0, 1, 2, 3, 6, 7))
    rig = rig._replace(rules=Teleop(HEX7BOT, model, stick, check=path.posture))
    rig.robot.torque(True)
    rig.robot.write(JointTarget.of({"J3": HEX7BOT.joint("J3").offset + 0.7}, 1.0))
    rig.clock.advance(2.0)
    rig.run(push(1), 4.0)
    assert any("elbow folded" in str(note) for note in rig.notes)
    held = rig.robot.read().positions
    path.posture(held, {"J2": held["J2"]})
    with pytest.raises(LimitError, match="elbow folded"):
        path.posture(held, {"J2": held["J2"] + math.radians(3)})


def test_a_rate_that_no_loop_keeps_is_refused_before_an_arm_gets_torque() -> None:
    rules = Teleop(HEX7BOT, None, StickMap())
    with pytest.raises(UsageError, match="a rate of 1e\\+09 Hz is not possible"):
        TeleopController(rules, lambda: ((), 0, math.inf), 1e-9)


class _EndedError(Exception):
    """The operator ends it."""


@pytest.mark.parametrize("lost", [False, True])
def test_a_run_ends_with_a_hold_or_with_a_stop_if_that_fails(lost: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = hex7bot()
    done: list[str] = []
    began = rig.clock()

    def stick() -> tuple[tuple[float, ...], int, float]:
        if rig.clock() > began + 1.0:
            raise _EndedError
        pushed = 1.0 if rig.clock() > began + 0.4 else 0.0
        return (pushed,) + (0.0,) * 7, HELD if rig.clock() > began + 0.2 else 0, 0.0

    @contextmanager
    def shield() -> Iterator[None]:
        done.append("shielded")
        if lost:
            monkeypatch.setattr(rig.robot, "read", _no_answer)
        yield

    write, holds = rig.robot.write, []

    def noted(target: JointTarget) -> object:
        holds.append("shielded" in done)
        return write(target)

    monkeypatch.setattr(rig.robot, "write", noted)
    controller = TeleopController(rig.rules, stick, PERIOD)
    with pytest.raises(_EndedError):
        run_teleop(
            rig.robot,
            controller,
            1 / PERIOD,
            on_ready=lambda: done.append("ready"),
            shield=shield,
            sleep=rig.clock.advance,
        )
    monkeypatch.undo()
    assert done == ["ready", "shielded"]
    assert holds.count(False) > 5, "the arm moved"
    assert holds.count(True) == 0 if lost else holds.count(True) > 3, "it brakes, and holds"
    assert rig.robot.read().stopped == lost


def _no_answer() -> NoReturn:
    raise ReplyTimeoutError("the state")
