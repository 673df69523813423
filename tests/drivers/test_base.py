"""What a robot answers that supplies no more than a driver must."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import pytest
from tests.model.states import make_state

from hexwire.drivers import abilities
from hexwire.drivers.abilities import OwnWatchdog, ServoPing, StateReports, Watchdog
from hexwire.drivers.base import RobotDriver, Signal, StopCause, StopLatch, StopMode
from hexwire.errors import DeviceError, NotSupportedError, StoppedError, UsageError
from hexwire.link.diagnose import Level
from hexwire.model.arm import ArmModel, JointModel
from hexwire.model.state import JointState, JointTarget, SentTarget

MODEL = ArmModel("plain", (JointModel("J1", 1, "none", 0, 1, 0.0, 0.001, -1.0, 1.0, 1.0),))


class Plain(RobotDriver):
    """Has no session, no link and no board."""

    model = MODEL

    def __init__(self) -> None:
        super().__init__()
        self.angle, self.here, self.said = 0.0, False, list[str]()
        self.stopped = self.tripped = self.broken = False

    @property
    def is_attached(self) -> bool:
        return self.here

    def attach(self) -> None:
        self.here = True

    def detach(self, *, torque_off: bool = False) -> None:
        self.here = False

    def read(self) -> JointState:
        if self.broken:
            raise DeviceError("it fell over")
        return make_state(self.angle, stamp=self.now(), stopped=self.stopped, watchdog_tripped=self.tripped)

    def write(self, target: JointTarget) -> SentTarget:
        self.angle = dict(target.positions)["J1"]
        return SentTarget(target.positions, target.duration)

    def torque(self, on: bool, joints: Sequence[str] | None = None) -> tuple[str, ...]:
        self.said.append(f"torque {on}")
        return MODEL.names

    def stop(self, mode: StopMode = StopMode.HOLD) -> tuple[str, ...]:
        with self.epochs.stopping():
            self.said.append(f"stop {mode.name}")
            self.stopped = True
        return MODEL.names

    def resume(self) -> None:
        self.epochs.resumed(self.epochs.token("resume", freeing=True))
        self.said.append("resume")
        self.stopped = self.tripped = False


class Guarded(Plain, OwnWatchdog):
    """Has a watchdog."""

    armed = 0.0

    @property
    def watchdog_armed(self) -> bool:
        return self.armed > 0

    def watchdog(self, timeout: float, mode: StopMode = StopMode.HOLD) -> None:
        if self.broken:
            raise DeviceError("it fell over")
        self.armed = timeout
        self.said.append(f"watchdog {timeout:g}")


def test_a_driver_must_supply_the_chapters_verbs() -> None:
    verbs = {"attach", "detach", "read", "write", "torque", "stop", "resume"}
    assert RobotDriver.__abstractmethods__ == verbs | {"is_attached"}


def test_a_robot_needs_no_session() -> None:
    with Plain.from_url("anything") as robot:
        assert robot.is_attached
        assert robot.write(JointTarget.of({"J1": 0.5})).positions == (("J1", 0.5),)
        assert robot.read()["J1"].position == 0.5
        assert robot.probe().missing == ()
        assert robot.may_move(1), "who does not know says so"
    assert not robot.is_attached


def test_an_attached_robot_is_not_attached_again() -> None:
    robot = Plain()
    robot.attach()
    robot.attach = lambda: pytest.fail("attached twice")  # type: ignore[method-assign]  # to see it
    with robot:
        assert robot.is_attached


def test_what_a_plain_robot_says_of_itself() -> None:
    robot = Plain()
    assert (robot.url, robot.command_rate, robot.stop_kept_by) == ("", 20.0, "board")
    kinds = [getattr(abilities, name) for name in abilities.__all__]
    assert [kind for kind in kinds if robot.can(kind) or kind.find(robot) is not None] == []
    assert robot.probe().counters == {}
    before = time.monotonic()
    assert before <= robot.now() <= time.monotonic()


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (Watchdog, "plain has no watchdog to stop it when this program falls silent"),
        (StateReports, "plain sends no state reports; use read"),
        (ServoPing, "the servos of robot plain cannot be pinged one by one"),
    ],
)
def test_an_ability_that_it_has_not_is_an_error(kind: Any, words: str) -> None:
    with pytest.raises(NotSupportedError, match=words):
        kind.of(Plain())


def test_abort_ends_it_and_sends_nothing() -> None:
    with Plain() as robot:
        robot.abort()
        assert not robot.is_attached
        assert robot.said == []


def test_two_robots_have_stops_of_their_own() -> None:
    one, other = Plain(), Plain()
    one.stop()
    assert (one.epochs.stopped, other.epochs.stopped) == (True, False)


def test_the_latch_says_what_stopped_the_robot() -> None:
    robot = Plain()
    assert robot.stop_latch() == StopLatch(StopCause.NONE)
    robot.stopped = True
    assert robot.stop_latch() == StopLatch(StopCause.ELSEWHERE)
    robot.stop()
    assert robot.stop_latch() == StopLatch(StopCause.HERE)
    robot.tripped = True
    assert robot.stop_latch() == StopLatch(StopCause.WATCHDOG)
    robot.resume()
    assert not robot.stop_latch().stopped


def test_the_latch_of_a_stop_that_somebody_else_ended_is_open() -> None:
    robot = Plain()
    robot.stop()
    robot.stopped = False
    assert robot.stop_latch() == StopLatch(StopCause.NONE)


def test_a_stop_that_was_not_confirmed_holds_here() -> None:
    robot = Plain()
    with suppress(DeviceError), robot.epochs.stopping():
        raise DeviceError("it did not hear it")
    assert robot.epochs.failed
    assert robot.stop_latch() == StopLatch(StopCause.HERE)
    robot.resume()
    assert not robot.epochs.failed


def test_signals_are_the_verbs_by_number() -> None:
    robot = Plain()
    for signal in Signal:
        robot.signal(signal)
    assert robot.said == ["stop HOLD", "stop TORQUE_OFF", "resume", "torque True", "torque False"]
    with pytest.raises(UsageError, match="no signal 9; there are 1 STOP, "):
        robot.signal(9)


def test_a_plain_robot_is_examined_by_its_probe_and_its_state() -> None:
    robot = Plain()
    robot.attach()
    said = [(finding.level, finding.about, finding.text) for finding in robot.examine()]
    assert said[:2] == [(Level.OK, "board", "plain"), (Level.OK, "servos", "all 1 answer")]
    assert Level.BAD not in [level for level, _, _ in said]


# -- watched --------------------------------------------------------------------------------------------


def test_a_watchdog_that_nobody_would_find_is_an_error() -> None:
    with pytest.raises(TypeError, match="Lonely has a watchdog: derive it from"):
        type("Lonely", (Plain,), {"watchdog": Guarded.watchdog})


def test_watched_arms_and_disarms() -> None:
    robot = Guarded()
    with robot.watched(0.5) as covered:
        assert (covered, robot.armed) == (True, 0.5)
        with robot.watched(9.0):
            assert robot.armed == 0.5
        assert robot.armed == 0.5
    assert robot.said == ["watchdog 0.5", "watchdog 0"]


def test_watched_says_that_nobody_watches() -> None:
    with Plain().watched(0.5) as covered:
        assert not covered


@pytest.mark.parametrize(
    ("tripped", "why"), [(False, "the arm is stopped; "), (True, r"stopped \(its watchdog stopped it .*\); ")]
)
def test_a_robot_that_is_stopped_is_not_watched_and_nothing_begins_without(tripped: bool, why: str) -> None:
    robot = Guarded()
    robot.stopped, robot.tripped = True, tripped
    with pytest.raises(StoppedError, match=f"{why}`hexwire resume` ends that"), robot.watched(0.5):
        pytest.fail("somebody might resume it now")
    assert robot.said == []
    with robot.watched(0.5, always=True):
        assert robot.armed == 0.5


def test_the_first_failure_is_raised_not_the_failure_to_disarm_the_watchdog() -> None:
    robot = Guarded()

    def fail() -> None:
        robot.broken = True
        raise ValueError("mine")

    with pytest.raises(ValueError, match="mine"), robot.watched(0.5):
        fail()


def test_the_report_of_a_probe_can_do_without_a_dialect() -> None:
    report = Plain().probe()
    assert report.same_kind(replace(report, counters={"a": 1}))
