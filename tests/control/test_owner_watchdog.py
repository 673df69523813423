"""No target goes to a robot without a watchdog armed, whoever else stops and resumes the robot meanwhile."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from tests.drivers.test_base import MODEL, Guarded
from tests.model.states import make_state
from tests.motion.arms import rest_to_rest

from hexwire.control.loop.owner import RobotOwner
from hexwire.control.motion.motions import MotionOptions, run_motion
from hexwire.control.motion.teleop import TeleopController
from hexwire.drivers.values import StopMode
from hexwire.errors import StoppedError
from hexwire.model.state import JointFlag, JointState, JointTarget, SentTarget
from hexwire.motion.teleop import Teleop

STOP, RESUME, TRIP = "stop", "resume", "trip"


class Shared(Guarded):
    """Between its calls somebody else stops and resumes it; `events` says before which call what happens."""

    command_rate = 20.0

    def __init__(self, events: Mapping[int, str] | None = None) -> None:
        super().__init__()
        self.events, self.calls, self.time = events or {}, 0, 0.0
        self.torque_is_on = True
        self.writes = 0
        self.unwatched: list[JointTarget] = []
        self.here = True

    def now(self) -> float:
        return self.time

    def wait(self, seconds: float) -> None:
        self.time += seconds

    def _called(self) -> None:
        event = self.events.get(self.calls)
        self.calls += 1
        self.time += 0.001
        if event is not None:
            self.stopped, self.tripped = event != RESUME, event == TRIP

    def read(self) -> JointState:
        self._called()
        flags = JointFlag.TORQUE_ON if self.torque_is_on else 0
        return make_state(
            self.angle, stamp=self.now(), flags=(flags,), stopped=self.stopped, watchdog_tripped=self.tripped
        )

    def write(self, target: JointTarget) -> SentTarget:
        self._called()
        if self.armed == 0.0:
            self.unwatched.append(target)
        if self.stopped:
            raise StoppedError("JOINT_MOVE", 5, "the arm is stopped")
        self.writes += 1
        return super().write(target)

    def torque(self, on: bool, joints: Any = None) -> tuple[str, ...]:
        self._called()
        if on and self.stopped:
            raise StoppedError("TORQUE", 5, "the arm is stopped")
        self.torque_is_on = on
        return MODEL.names

    def watchdog(self, timeout: float, mode: StopMode = StopMode.HOLD) -> None:
        self._called()
        super().watchdog(timeout, mode)


def options(robot: Shared, watchdog: float = 1.0) -> MotionOptions:
    return MotionOptions(clock=robot.now, sleep=robot.wait, watchdog=watchdog, grace=0.5)


def path(robot: Shared, how: MotionOptions) -> None:
    run_motion(robot, rest_to_rest(("J1",), (0.0,), (0.2,), 1.0), how)


def target(robot: Shared, how: MotionOptions) -> None:
    run_motion(robot, JointTarget.of({"J1": 0.2}, 1.0), how)


def cut_short(robot: Shared, how: MotionOptions) -> None:
    """Something else is sent in place of a path that has hardly begun."""
    for end in (True, JointTarget.of({"J1": 0.1}, 0.5)):
        way = rest_to_rest(("J1",), (robot.angle,), (0.2,), 1.0)
        run_motion(robot, way, how, until=lambda _, end=end: end)  # type: ignore[misc]


def teleop(robot: Shared, how: MotionOptions) -> None:
    """The operator lets the button go now and then, and pushes the stick else."""
    turns = iter(range(1000))

    def stick() -> Any:
        turn = next(turns)
        return (float(turn % 5 > 2), *[0.0] * 7), (turn % 5 > 0) << 4, 0.0

    controller = TeleopController(Teleop(MODEL, None), stick, 0.05)
    with RobotOwner(
        robot, borrowed=True, command_rate=20.0, watchdog=how.watchdog, clock=robot.now, sleep=robot.wait
    ) as owner:
        owner.group.members = (controller,)
        for _ in range(15):
            owner.turn()


CALLERS = {"path": path, "target": target, "cut short": cut_short, "teleop": teleop}


@pytest.mark.parametrize("name", CALLERS)
@settings(max_examples=60)
@given(events=st.dictionaries(st.integers(0, 30), st.sampled_from((STOP, RESUME, TRIP)), max_size=8), torque=...)
@example(events={0: STOP, 4: RESUME}, torque=True)
@example(events={2: STOP, 3: RESUME}, torque=True)
@example(events={1: TRIP, 2: RESUME}, torque=True)
@example(events={1: STOP, 4: RESUME}, torque=True)
@example(events={1: STOP, 5: RESUME}, torque=True)
@example(events={1: STOP, 6: RESUME}, torque=True)
@example(events={1: STOP, 7: RESUME}, torque=True)
def test_no_target_goes_out_before_a_watchdog_is_armed(name: str, events: dict[int, str], torque: bool) -> None:
    robot = Shared(events)
    robot.torque_is_on = torque
    with suppress(StoppedError):
        CALLERS[name](robot, options(robot))
    assert robot.unwatched == []
    assert robot.armed == 0.0, "it is disarmed at the end"


@pytest.mark.parametrize("name", CALLERS)
def test_it_moves_and_without_a_watchdog_if_none_is_wanted(name: str) -> None:
    for watchdog in (1.0, 0.0):
        robot = Shared()
        CALLERS[name](robot, options(robot, watchdog))
        assert robot.writes > 0
        assert bool(robot.unwatched) == (watchdog == 0.0)


def test_teleop_that_finds_the_arm_stopped_arms_the_watchdog_when_it_is_resumed() -> None:
    robot = Shared({0: STOP, 6: RESUME})
    teleop(robot, options(robot))
    assert [said for said in robot.said if "watchdog" in said] == ["watchdog 1", "watchdog 0"]
    assert robot.writes > 0
    assert robot.unwatched == []


def test_an_arm_that_stays_stopped_keeps_the_word_of_its_watchdog() -> None:
    robot = Shared({0: TRIP})
    with pytest.raises(StoppedError, match="its watchdog tripped"):
        run_motion(robot, JointTarget.of({"J1": 0.2}, 1.0), options(robot))
    assert robot.said == []
