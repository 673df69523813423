"""A stop waits for nobody: whoever has the lock of the controllers, the board is told first; in simulated time."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import product

import pytest
from tests.control.arm_bench import STOPPED, Bench, Service, Told, make_bench, order
from tests.control.shared_bench import SharedBench
from tests.few import few
from tests.motion.arms import HOME

import hexwire.motion.set_point_generator
from hexwire.control.loop import group
from hexwire.control.loop.group import ControllerGroup
from hexwire.control.loop.holding import stop_or_log
from hexwire.control.requests.readiness import deactivate
from hexwire.errors import GoalError
from hexwire.motion.safety import StopReason
from hexwire.motion.trajectory import Trajectory
from hexwire.wire.command_frame import Command

J1 = HOME["J1"]
MOVES = {Command.JOINT_MOVE, Command.TRAJECTORY_BEGIN, Command.TRAJECTORY_POINTS, Command.TRAJECTORY_START}
STOPS: dict[str, Callable[[Bench], object]] = {
    "owner": lambda bench: bench.owner.stop("a test"),
    "arm": lambda bench: bench.arm.stop("a test"),
    "deactivate": lambda bench: deactivate(bench.arm),
    "lease": lambda bench: stop_or_log(bench.owner, "a test"),
    "guard": lambda bench: bench.owner._output.stop(StopReason("fault", "a test", "J1")),
}


@pytest.fixture(autouse=True)
def _hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody waits long for a lock that does not come free."""
    monkeypatch.setattr(group, "_PATIENCE", 0.001)
    monkeypatch.setattr("hexwire.control.requests.teach_mode._PATIENCE", 0.001)


@contextmanager
def held(bench: Bench) -> Iterator[None]:
    """A thread that has the lock of the controllers and does not let go."""
    has, may_go = threading.Event(), threading.Event()

    def hold() -> None:
        with bench.owner.locked():
            has.set()
            assert may_go.wait(30.0)

    service = Service(hold)
    try:
        assert has.wait(30.0)
        yield
    finally:
        may_go.set()
        service.answer()


def after_stop(bench: Bench) -> list[int]:
    """The commands that the board got after the first stop."""
    commands = bench.emulated.commands()
    return commands[commands.index(Command.STOP) + 1 :]


def reset(bench: Bench) -> None:
    bench.ask(bench.arm.reset)


@few("name, host_timed", product(STOPS, (True, False)), ("owner", False), ("guard", False))
def test_a_stop_is_sent_while_another_thread_has_the_lock(name: str, host_timed: bool) -> None:
    stop = STOPS[name]
    bench = make_bench(host_timed=host_timed)
    told = Told()
    bench.arm.command("", order((5.0, {"J1": J1 + 0.6}), still=True), listener=told)
    bench.turn(1.0)
    asked = bench.arm.mark()
    with held(bench):
        turning = bench.begin(lambda: bench.turn(2.0))
        bench.begin(lambda: stop(bench)).answer()
        assert bench.board.state.stopped
        assert bench.owner.group.reason is not None
    turning.answer()
    bench.turn(1.0)
    assert told.outcome == STOPPED
    assert not bench.controller.moving
    reset(bench)
    # What was asked for before the stop is void for ever.
    with pytest.raises(GoalError, match="was stopped since"):
        bench.arm.command("", order((1.0, {"J1": J1})), asked=asked)
    bench.turn(2.0)
    assert not MOVES & set(after_stop(bench))


def test_what_a_thread_does_with_the_lock_after_the_stop_is_stopped_too() -> None:
    bench = make_bench()
    told, owner, controller = Told(), bench.owner, bench.controller
    with owner.locked():
        plan = controller.plan(order((2.0, {"J1": J1 + 0.3})), owner.now())
        bench.begin(lambda: owner.stop("a test")).answer()
        assert bench.board.state.stopped
        controller.accept(plan, owner.newest(), owner.now(), listener=told)
        assert controller.moving
    assert not controller.moving
    bench.turn(1.0)
    assert told.outcome == STOPPED
    assert not MOVES & set(after_stop(bench))


def test_a_stop_is_sent_while_a_planner_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = make_bench()
    bench.command(order((5.0, {"J1": J1 + 0.6})))
    bench.turn(1.0)
    plans, may_go, take_over = threading.Event(), threading.Event(), hexwire.motion.set_point_generator.take_over

    def hangs(*arguments: object, **options: object) -> Trajectory:
        plans.set()
        assert may_go.wait(30.0)
        return take_over(*arguments, **options)  # type: ignore[arg-type]  # as they came

    monkeypatch.setattr(hexwire.motion.set_point_generator, "take_over", hangs)
    service = bench.begin(lambda: bench.command(order((3.0, {"J1": J1 - 0.6}))))
    assert plans.wait(30.0)
    bench.begin(lambda: bench.owner.stop("a test")).answer()
    assert bench.board.state.stopped
    may_go.set()
    with pytest.raises(GoalError, match="stopped"):
        service.answer()
    reset(bench)
    bench.turn(2.0)
    assert not MOVES & set(after_stop(bench))


def test_a_stop_of_a_shared_arm_is_sent_while_another_thread_has_the_lock() -> None:
    bench = SharedBench()
    key = bench.take()
    bench.move(key, J1=0.6)
    bench.keep(key, 1.0)
    with held(bench.bench):
        bench.bench.begin(lambda: bench.shared.stop("a test")).answer()
        assert bench.board.state.stopped
    bench.keep(key, 1.0)
    reset(bench.bench)
    bench.keep(key, 2.0)
    assert not MOVES & set(after_stop(bench.bench))


@pytest.mark.slow
def test_a_program_ends_while_another_thread_has_the_lock() -> None:
    bench = make_bench()
    bench.command(order((5.0, {"J1": J1 + 0.6})))
    bench.turn(1.0)
    with held(bench):
        bench.begin(bench.owner.shutdown).answer()
        assert bench.board.state.stopped


class Slow:
    """A controller that another stop comes to while it is stopped."""

    joints, busy, moving = ("J1",), False, False

    def __init__(self) -> None:
        self.reason: StopReason | None = None
        self.then: Callable[[], object] = lambda: None

    def stop(self, reason: StopReason) -> None:
        self.reason = self.reason or reason
        then, self.then = self.then, lambda: None
        then()

    def reset(self) -> None:
        self.reason = None
        then, self.then = self.then, lambda: None
        then()

    def take_ended(self) -> list[object]:
        return []


def test_the_reason_never_disappears_between_the_announcement_and_the_controllers() -> None:
    one = Slow()
    seen: list[StopReason | None] = []
    members = ControllerGroup((one,))  # type: ignore[arg-type]  # what a stop needs
    first, second = StopReason("asked", "first"), StopReason("asked", "second")
    one.then = lambda: (members.announce(second), seen.append(members.reason))
    members.stop(first)
    assert seen == [first]
    assert members.reason == first
    assert members.epochs.number == 2
    # A stop that comes in the middle of a reset stays.
    one.then = lambda: members.announce(second)
    members.reset(members.epochs.mark())
    assert one.reason == second
    assert members.reason == second
