"""Trajectories of a shared arm that begin at a given time, on emulated servos in simulated time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import pytest
from tests.control.arm_bench import order
from tests.control.shared_bench import SharedBench
from tests.motion.arms import HOME

from hexwire.control.loop.outcomes import Outcome, Reason
from hexwire.control.motion.goals import Point, TrajectoryGoal
from hexwire.control.sharing.shared_goals import BOARD, CONFIRM, HOST, GoalReport, SharedGoals
from hexwire.drivers.timed_path import PathState
from hexwire.errors import GoalError, LeaseError, StoppedError
from hexwire.model.state import JointTarget, SentTarget
from hexwire.motion.fence import Fence

AWAY = 0.3
STILL = 0.004


class Goals(SharedBench):
    """Times of its owner's clock are far from those of another one's."""

    def __init__(self, **options: object) -> None:
        super().__init__(**options)
        self.goals = SharedGoals(self.shared)
        self.key = self.take()

    def follow(self, delay: float = 1.0, seconds: float = 2.0, *, confirm: bool = False, **by: float) -> int:
        """Send a motion that begins in `delay` seconds; returns its number."""
        goal = {name: self.where(name) + way for name, way in (by or {"J1": AWAY}).items()}
        path, start = order((seconds, {**HOME, **goal})), self.owner.now() + delay
        return self.goals.follow(self.order(self.key), path, start, confirm=confirm)

    def confirm(self, number: int) -> None:
        self.goals.confirm(self.order(self.key), number)

    def report(self, number: int) -> GoalReport:
        report = self.goals.report(number)
        assert report is not None
        return report

    def outcome(self, number: int) -> Outcome | None:
        return self.report(number).outcome


@pytest.mark.slow
def test_a_motion_begins_at_its_time_and_not_before() -> None:
    bench = Goals()
    number = bench.follow(delay=1.0)
    before = bench.where("J1")
    bench.keep(bench.key, 0.9)
    assert abs(bench.where("J1") - before) < STILL
    bench.keep(bench.key, 4.0)
    assert bench.where("J1") == pytest.approx(before + AWAY, abs=0.03)
    assert bench.outcome(number) is Outcome.SUCCEEDED


def test_nobody_takes_the_motion_of_the_next_holder_for_its_own() -> None:
    bench = Goals()
    former = bench.follow(delay=1.0)
    bench.shared.leave(bench.key, finish=False)
    bench.key = bench.take()
    number = bench.follow(delay=1.0)
    assert bench.goals.report(former) is None
    assert bench.goals.report(number) is not None
    bench.goals.cancel(bench.order(bench.key), former)
    assert not bench.outcome(number)
    assert number != Goals().follow(delay=1.0), "nor that of the next server"


def test_who_leaves_lets_the_motion_finish_and_no_longer() -> None:
    bench = Goals()
    bench.follow(delay=1.0, seconds=2.0)
    bench.shared.leave(bench.key, finish=True)
    bench.turn(2.9)
    assert bench.shared.holder is not None
    bench.turn(0.2)
    assert bench.shared.holder is None


def test_arms_whose_clocks_differ_begin_together() -> None:
    """The skew of the first movement, on the servos, is that of the samples between which it is found."""
    late = []
    for ahead in (0.0, 0.013, 0.031):
        bench = Goals()
        # Where its cycles are when the order comes differs.
        bench.keep(bench.key, 0.5 + ahead)
        number = bench.follow(delay=1.0, seconds=2.0)
        bench.keep(bench.key, 2.0)
        report = bench.goals.report(number)
        assert report is not None
        assert report.moved is not None
        late.append(report.moved - report.start)
    assert all(0.0 < seconds < 0.5 for seconds in late)
    assert max(late) - min(late) <= bench.owner.command_period


@pytest.mark.slow
@pytest.mark.parametrize("confirm", [False, True], ids=["plain", "confirmed"])
def test_the_board_has_the_motion_and_its_start_as_soon_as_it_is_accepted(confirm: bool) -> None:
    bench = Goals()
    number = bench.follow(delay=4.0, confirm=confirm)
    assert not bench.report(number).ready
    bench.keep(bench.key, 0.3)
    board, report = bench.board.trajectory, bench.report(number)
    assert (board.state, report.ready) == (PathState.WAITING, BOARD)
    if confirm:
        bench.confirm(number)
    before = bench.where("J1")
    bench.keep(bench.key, report.start - bench.clock.time - 0.15)
    assert abs(bench.where("J1") - before) < STILL
    # In the emulator's time, which is also that of the owner; a request takes none here.
    assert report.doubt < 0.001
    assert board.start_at == pytest.approx(report.start, abs=0.0001)
    bench.keep(bench.key, 3.0)
    assert bench.outcome(number) is Outcome.SUCCEEDED
    assert not bench.sent


@pytest.mark.parametrize("options", [{"host_timed": True}, {"dialect": 1, "publish_rate": 1.0}], ids=str)
def test_without_such_a_board_the_first_target_comes_a_period_late_at_most(options: dict[str, object]) -> None:
    bench = Goals(**options)
    number = bench.follow(delay=1.0, confirm=True, seconds=8.0)
    bench.keep(bench.key, 0.3)
    report = bench.report(number)
    assert (report.ready, report.doubt) == (HOST, bench.owner.command_period)
    bench.confirm(number)
    times, write = list[float](), bench.robot.write

    def timed(target: JointTarget) -> SentTarget:
        times.append(bench.clock.time)
        return write(target)

    bench.robot.write = timed  # type: ignore[method-assign]  # it looks at the time
    bench.keep(bench.key, 1.5)
    assert 0.0 <= times[0] - report.start <= report.doubt + 0.01


@pytest.mark.parametrize("options", [{}, {"host_timed": True}], ids=["board", "host"])
def test_a_motion_that_is_not_confirmed_in_time_never_begins(options: dict[str, object]) -> None:
    bench = Goals(**options)
    number = bench.follow(delay=1.0, confirm=True)
    before = bench.where("J1")
    with pytest.raises(GoalError, match="it is not ready"):
        bench.confirm(number)
    bench.keep(bench.key, 1.0 - CONFIRM - 0.05)
    with pytest.raises(LeaseError):
        bench.goals.confirm(bench.order(bench.key + 1), number)
    with pytest.raises(GoalError, match="no goal"):
        bench.confirm(number + 1)
    assert bench.outcome(number) is None
    bench.clock.sleep(0.06)
    with pytest.raises(GoalError, match=r"not confirmed 0\.25 s before its start"):
        bench.confirm(number)
    bench.keep(bench.key, 0.1)
    assert bench.report(number).text == "it was not confirmed 0.25 s before its start"
    assert bench.outcome(number) is Outcome.PREEMPTED
    assert bench.board.trajectory.state in (PathState.ABORTED, PathState.NONE)
    with pytest.raises(GoalError, match="not confirmed"):
        bench.confirm(number)
    bench.keep(bench.key, 1.5)
    assert abs(bench.where("J1") - before) < STILL


def test_a_motion_that_is_to_be_confirmed_needs_the_time_for_it() -> None:
    bench = Goals()
    with pytest.raises(GoalError):
        bench.follow(delay=CONFIRM, confirm=True)
    assert not bench.owner.group.busy


@pytest.mark.parametrize(
    ("samples", "moved"),
    [
        (((-0.5, 0.5), (0.0, 0.0), (0.1, 0.1), (0.1, 0.1), (0.2, -0.5), (0.3, 2.0)), 0.15),
        # Not before the start, where no state came for long.
        (((-0.5, 0.0), (0.3, 3.0)), 0.03),
        (((0.0, 0.0), (0.1, math.nan), (0.2, 0.6), (0.3, 2.0)), 0.1),
    ],
    ids=["half-way between 0.1 and 0.5", "a stall", "a silent joint"],
)
def test_the_first_movement_is_interpolated_between_two_samples(
    samples: tuple[tuple[float, float], ...], moved: float
) -> None:
    bench = Goals()
    number = bench.follow(delay=1.0)
    report = bench.goals.report(number)
    assert report is not None
    state, place = bench.owner.newest(), bench.robot.model.index("J1")
    for seconds, degrees in samples:
        position = list(state.position)
        position[place] += math.radians(degrees)
        old = (0.02,) * len(state.names)
        seen = replace(state, position=tuple(position), stamp=report.start + seconds + 0.02, age=old)
        assert report.moved is None or seconds == 0.3
        for observe in bench.owner.observers:
            observe(seen)
    assert report.moved == pytest.approx(report.start + moved)


def test_a_start_in_the_past_is_refused_and_nothing_moves() -> None:
    bench = Goals()
    for delay in (-0.1, 0.0, 0.01, 1e4):
        with pytest.raises(GoalError):
            bench.follow(delay=delay)
    before = bench.where("J1")
    bench.keep(bench.key, 1.0)
    assert abs(bench.where("J1") - before) < STILL
    assert not bench.owner.group.busy


@pytest.mark.slow
def test_a_motion_can_be_cancelled_before_and_after_its_start() -> None:
    bench = Goals()
    number = bench.follow(delay=1.0)
    bench.goals.cancel(bench.order(bench.key), number + 1)
    assert bench.outcome(number) is None
    bench.goals.cancel(bench.order(bench.key), number)
    assert bench.outcome(number) is Outcome.PREEMPTED
    before = bench.where("J1")
    bench.keep(bench.key, 2.0)
    assert abs(bench.where("J1") - before) < STILL
    number = bench.follow(delay=0.2, seconds=4.0)
    bench.keep(bench.key, 1.5)
    bench.goals.cancel(bench.order(bench.key), number)
    bench.keep(bench.key, 0.5)
    assert bench.travel("J1", 0.4) < STILL


def test_a_lost_lease_ends_the_motion_also_before_its_start() -> None:
    for silence in (2.0, 0.0):
        bench = Goals()
        number = bench.follow(delay=1.0, seconds=6.0)
        before = bench.where("J1")
        bench.keep(bench.key, 3.0 - silence - 0.5)
        bench.turn(1.5)
        report = bench.goals.report(number)
        assert report is not None
        assert report.outcome is Outcome.ABORTED
        assert "lost the lease" in report.text
        assert bench.travel("J1", 1.0) < STILL
        assert (abs(bench.where("J1") - before) < STILL) == (silence > 0)


def test_a_stop_ends_the_motion_and_what_was_asked_before_it() -> None:
    bench = Goals()
    early = bench.order(bench.key)
    number = bench.follow(delay=1.0)
    bench.ask(lambda: bench.shared.stop("Bob stopped it"))
    report = bench.goals.report(number)
    assert report is not None
    assert "Bob stopped it" in report.text
    bench.ask(lambda: bench.shared.resume(bench.order(bench.key)))
    with pytest.raises((GoalError, LeaseError)):
        bench.goals.follow(early, order((2.0, HOME)), bench.owner.now() + 1.0)


@pytest.mark.parametrize("only_check", [False, True], ids=["follow", "check"])
@pytest.mark.parametrize("ends", ["taken", "stopped"])
def test_the_check_of_a_long_path_ends_with_the_right_to_move(
    ends: str, only_check: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The orders of the next holder, and a resume, do not wait for the rest of it."""
    bench, seen = Goals(), list[float]()
    plain = Fence.check

    def check(fence: Fence, where: Mapping[str, float]) -> dict[str, str]:
        seen.append(where["J1"])
        if len(seen) == 10 and ends == "taken":
            bench.take("Bob", force=True)
        elif len(seen) == 10:
            bench.robot.epochs.begin(object())
        return plain(fence, where)

    monkeypatch.setattr(Fence, "check", check)
    far = (600.0, {**HOME, "J1": HOME["J1"] + AWAY})
    sent, soon = bench.order(bench.key), bench.owner.now() + 30.0
    why = (LeaseError, "Bob holds the lease") if ends == "taken" else (StoppedError, "a stop came after the call")
    with pytest.raises(why[0], match=why[1]):
        _ = (
            bench.goals.check(sent, order((0.0, HOME), far))
            if only_check
            else bench.goals.follow(sent, order(far), soon)
        )
    assert len(seen) == 10


def test_a_path_whose_check_lasts_until_its_start_is_too_late(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its sender may give it another start; nothing else is wrong with it."""
    bench = Goals()
    plain = Fence.check

    def check(fence: Fence, where: Mapping[str, float]) -> dict[str, str]:
        bench.clock.time += 0.01
        return plain(fence, where)

    monkeypatch.setattr(Fence, "check", check)
    far = order((9.0, {**HOME, "J1": HOME["J1"] + AWAY}))
    with pytest.raises(GoalError, match="could not be checked before it was to begin") as raised:
        bench.goals.follow(bench.order(bench.key), far, bench.owner.now() + 0.5)
    assert raised.value.reason == Reason.TOO_LATE
    assert not bench.owner.group.moving


def test_only_the_holder_may_follow_check_and_cancel() -> None:
    bench = Goals()
    number = bench.follow()
    stranger = bench.key + 1
    way = order((0.0, HOME), (2.0, HOME))
    with pytest.raises(LeaseError):
        bench.goals.follow(bench.order(stranger), way, bench.owner.now() + 1.0)
    with pytest.raises(LeaseError):
        bench.goals.check(bench.order(stranger), way)
    with pytest.raises(LeaseError):
        bench.goals.cancel(bench.order(stranger), number)
    assert bench.outcome(number) is None
    assert bench.goals.report(number + 1) is None


def test_a_path_is_checked_from_its_own_first_point_and_moves_nothing() -> None:
    bench = Goals()
    elsewhere = {**HOME, "J1": HOME["J1"] + 1.0}
    back = {**HOME, "J1": HOME["J1"] + 0.5}
    assert bench.goals.check(bench.order(bench.key), order((0.0, elsewhere), (2.0, back))) == 2.0
    with pytest.raises(GoalError, match="J1 would turn at"):
        bench.goals.check(bench.order(bench.key), order((0.0, elsewhere), (0.01, back)))
    with pytest.raises(GoalError, match="must be the start"):
        bench.goals.check(bench.order(bench.key), order((1.0, elsewhere), (2.0, back)))
    with pytest.raises(GoalError, match="no controller moves all of X9"):
        bench.goals.check(bench.order(bench.key), TrajectoryGoal(("X9",), (Point(0.0, (math.pi,)),)))
    assert not bench.sent
    assert bench.goals._see in bench.owner.observers
    bench.goals.close()
    assert bench.goals._see not in bench.owner.observers
