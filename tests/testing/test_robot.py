"""The suite for robots: hexwire's own robots pass it, and a robot that breaks a promise does not."""

from __future__ import annotations

import math
import runpy
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.control.so_bench import SoBench
from tests.drivers.arms import Arm
from tests.drivers.test_own_robot import drivers

from hexwire.drivers.abilities import ServoPing
from hexwire.drivers.base import RobotDriver, StopMode
from hexwire.drivers.bus_arm import So101Arm
from hexwire.drivers.puma260 import Puma260Driver
from hexwire.emulator.puma import EmulatedPuma
from hexwire.emulator.serve import BoardLink, FakeClock
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session
from hexwire.model.arm import ArmModel
from hexwire.model.state import JointTarget
from hexwire.testing import RobotConformance
from hexwire.wire.modules import ModuleType

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_driver.py"


class TestHex7Bot(RobotConformance):
    dialect = 2

    def make_robot(self, tmp_path: Path) -> RobotDriver:
        self.arm = Arm(self.dialect, attach=False)
        return self.arm.driver

    def wait(self, robot: RobotDriver, seconds: float) -> None:
        self.arm.wait(seconds)


class TestHex7BotOfTheChapter(TestHex7Bot):
    dialect = 1


class TestPuma260(RobotConformance):
    def make_robot(self, tmp_path: Path) -> RobotDriver:
        self.clock = FakeClock(1000.0)
        link = BoardLink(EmulatedPuma(start=self.clock.time).connect(253), self.clock)
        handle = IpcHandle.from_link(link, ModuleType.PUMA260_HOST_IO_TRX, ModuleType.PUMA260_RBT_IO_SVR)
        return Puma260Driver(Session(handle))

    def wait(self, robot: RobotDriver, seconds: float) -> None:
        self.clock.time += seconds


class TestSo101(RobotConformance):
    """On a bare servo bus; its servos stand where its maker has mounted them."""

    def make_robot(self, tmp_path: Path) -> RobotDriver:
        self.bench = SoBench(pose=3, any_horns=False)
        return So101Arm(self.bench.link)

    def wait(self, robot: RobotDriver, seconds: float) -> None:
        self.bench.link.clock.time += seconds


class TestTheRobotOfThePage(RobotConformance):
    """docs/adding-a-robot.md."""

    def make_robot(self, tmp_path: Path) -> RobotDriver:
        return page()["PretendDriver"]()

    def wait(self, robot: RobotDriver, seconds: float) -> None:
        """It reaches every target at once."""


class TestTheExample(RobotConformance):
    """examples/own_driver.py."""

    def make_robot(self, tmp_path: Path) -> RobotDriver:
        robot: RobotDriver = runpy.run_path(str(EXAMPLE))["PanTilt"]()
        self.time = 1000.0
        robot.now = lambda: self.time  # type: ignore[method-assign]  # in simulated time
        return robot

    def wait(self, robot: RobotDriver, seconds: float) -> None:
        self.time += seconds


def page() -> dict[str, Any]:
    names: dict[str, Any] = {"__name__": "page"}
    exec(drivers(), names)
    return names


# --- a robot that breaks a promise -----------------------------------------------------------------------


class Suite(TestTheRobotOfThePage):
    __test__ = False  # asked by hand below


@pytest.fixture
def pretend() -> Iterator[Any]:
    robot = page()["PretendDriver"]()
    robot.attach()
    yield robot
    robot.detach()


def test_a_robot_that_moves_when_it_gets_torque_is_found(pretend: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    suite = Suite()
    suite.test_torque_moves_nothing(pretend)
    torque = pretend.torque

    def jump(on: bool, joints: Any = None) -> Any:
        pretend._angles["J1"] += 0.1
        return torque(on, joints)

    monkeypatch.setattr(pretend, "torque", jump)
    with pytest.raises(AssertionError):
        suite.test_torque_moves_nothing(pretend)


def test_a_robot_without_limits_is_found(pretend: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    suite = Suite()
    suite._model = pretend.model
    pretend.torque(True)
    suite.test_a_target_outside_the_limits_is_refused_whole(pretend)
    monkeypatch.setattr(pretend, "write", lambda target: None)
    with pytest.raises(pytest.fail.Exception):
        suite.test_a_target_outside_the_limits_is_refused_whole(pretend)


def test_a_robot_that_never_arrives_is_found(pretend: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    suite = Suite()
    suite._model = pretend.model
    pretend.torque(True)
    suite.test_a_target_is_reached(pretend)
    angles = dict(pretend._angles)
    write = pretend.write

    def forget(target: JointTarget) -> Any:
        sent = write(target)
        pretend._angles.update(angles)
        return sent

    monkeypatch.setattr(pretend, "write", forget)
    with pytest.raises(AssertionError, match="did not get to"):
        suite.test_a_target_is_reached(pretend)


def test_a_stop_that_does_not_hold_is_found(pretend: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    suite = Suite()
    suite._model = pretend.model
    pretend.torque(True)
    suite.test_a_stop_holds_until_resume(pretend)
    monkeypatch.setattr(pretend, "stop", lambda mode=StopMode.HOLD: ())
    for question in (
        suite.test_a_stop_holds_until_resume,
        suite.test_another_thread_may_stop_it,
        suite.test_a_stop_takes_the_torque_away_if_it_is_asked_to,
    ):
        with pytest.raises(AssertionError):
            question(pretend)


@pytest.mark.parametrize(
    "change",
    [
        {"minimum": -math.inf},
        {"maximum": math.inf},
        {"minimum": 1.0, "maximum": 1.0},
        {"max_speed": 0.0},
        {"max_speed": math.inf},
        {"max_speed": math.nan},
    ],
)
def test_a_model_with_a_joint_that_is_unsound_is_found(
    pretend: Any, monkeypatch: pytest.MonkeyPatch, change: dict[str, Any]
) -> None:
    suite, model = Suite(), pretend.model
    suite.test_the_model_is_sound(pretend)
    first, *others = model.joints
    monkeypatch.setattr(pretend, "model", ArmModel(model.name, (replace(first, **change), *others)))
    with pytest.raises(AssertionError):
        suite.test_the_model_is_sound(pretend)


def test_a_robot_that_takes_no_targets_is_found(pretend: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(type(pretend), "command_rate", 0.0)
    with pytest.raises(AssertionError):
        Suite().test_what_it_cannot_do_is_an_error_of_hexwire(pretend)


def test_a_ping_has_one_byte_or_nothing_for_an_answer() -> None:
    class Pinged(page()["PretendDriver"], ServoPing):  # type: ignore[misc]
        error: int | None = None

        def ping(self, servo_id: int) -> int | None:
            return self.error

    suite, robot = Suite(), Pinged()
    for error in (None, 0, 255):
        robot.error = error
        suite.test_what_it_cannot_do_is_an_error_of_hexwire(robot)
    for error in (-1, 256):
        robot.error = error
        with pytest.raises(AssertionError):
            suite.test_what_it_cannot_do_is_an_error_of_hexwire(robot)


def test_a_robot_has_five_seconds_to_get_there(pretend: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    suite = Suite()
    waited = 0.0

    def wait(robot: RobotDriver, seconds: float) -> None:
        nonlocal waited
        waited += seconds
        if waited >= arrival:
            pretend._angles["J1"] = 0.1

    monkeypatch.setattr(suite, "wait", wait)
    for arrival, arrives in ((4.9, True), (5.1, False)):
        waited, pretend._angles["J1"] = 0.0, 0.0
        assert suite.arrives(pretend, "J1", 0.1) is arrives, arrival
        assert waited == pytest.approx(min(arrival, 5.0), abs=0.051)


def test_how_long_a_robot_is_watched_that_should_stay(pretend: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A suite on a real arm takes this time."""
    suite = Suite()
    suite._model = pretend.model
    waits: list[float] = []
    monkeypatch.setattr(suite, "wait", lambda robot, seconds: waits.append(seconds))
    suite.test_torque_moves_nothing(pretend)
    assert sum(waits) == pytest.approx(0.2)
    pretend.torque(True)
    waits.clear()
    suite.test_a_stop_holds_until_resume(pretend)
    assert sum(waits) == pytest.approx(0.7)
    waits.clear()
    suite.test_a_stop_in_motion_ends_the_motion(pretend)
    assert sum(waits) == pytest.approx(0.6)


def test_the_joint_that_moves_has_room_for_two_steps_on_both_sides(pretend: Any) -> None:
    suite = Suite()
    suite._model = pretend.model
    joint = pretend.model.joints[0]
    for position in (joint.minimum + 2.5 * suite.step, joint.maximum - 2.5 * suite.step):
        pretend._angles[joint.name] = position
        assert suite.choose(pretend.read()) == joint.name
    for position in (joint.minimum + 1.5 * suite.step, joint.maximum - 1.5 * suite.step):
        pretend._angles.update({name: pretend.model.joint(name).maximum for name in pretend._angles})
        pretend._angles[joint.name] = position
        with pytest.raises(AssertionError, match="no joint has room"):
            suite.choose(pretend.read())


def test_the_suite_of_a_robot_needs_its_robot(tmp_path: Path) -> None:
    with pytest.raises(NotImplementedError):
        RobotConformance().make_robot(tmp_path)
