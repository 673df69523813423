"""Trajectories of a shared arm that begin at a given time, on emulated servos in simulated time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import pytest
from tests.control.arm_bench import order
from tests.control.shared_bench import SharedBench
from tests.motion.arms import HOME

from hexwire.control.goals import Point, TrajectoryGoal
from hexwire.control.shared_goals import SharedGoals
from hexwire.errors import GoalError, LeaseError
from hexwire.motion.fence import Fence

AWAY = 0.3
STILL = 0.004


class Goals(SharedBench):
    """Times of its owner's clock are far from those of another one's."""

    def __init__(self) -> None:
        super().__init__()
        self.goals = SharedGoals(self.shared)
        self.key = self.take()

    def follow(self, delay: float = 1.0, seconds: float = 2.0, **by: float) -> int:
        """Send a motion that begins in `delay` seconds; returns its number."""
        goal = {name: self.where(name) + way for name, way in (by or {"J1": AWAY}).items()}
        return self.goals.follow(self.order(self.key), order((seconds, {**HOME, **goal})), self.owner.now() + delay)

    def outcome(self, number: int) -> str:
        report = self.goals.report(number)
        assert report is not None
        return report.outcome


def test_a_motion_begins_at_its_time_and_not_before() -> None:
    bench = Goals()
    number = bench.follow(delay=1.0)
    before = bench.where("J1")
    bench.keep(bench.key, 0.9)
    assert abs(bench.where("J1") - before) < STILL
    bench.keep(bench.key, 4.0)
    assert bench.where("J1") == pytest.approx(before + AWAY, abs=0.03)
    assert bench.outcome(number) == "succeeded"


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


def test_arms_whose_clocks_differ_begin_together() -> None:
    """The skew of the first movement, on the servos, is less than a cycle of the owners."""
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


def test_the_first_movement_is_interpolated_between_two_samples() -> None:
    bench = Goals()
    number = bench.follow(delay=1.0)
    report = bench.goals.report(number)
    assert report is not None
    state, place = bench.owner.newest(), bench.robot.model.index("J1")
    for seconds, degrees in ((-0.5, 0.5), (0.0, 0.0), (0.1, 0.1), (0.1, 0.1), (0.2, -0.5), (0.3, 2.0)):
        position = list(state.position)
        position[place] += math.radians(degrees)
        old = (0.02,) * len(state.names)
        seen = replace(state, position=tuple(position), stamp=report.start + seconds + 0.02, age=old)
        assert report.moved is None or seconds == 0.3
        for observe in bench.owner.observers:
            observe(seen)
    assert report.moved == pytest.approx(report.start + 0.15), "0.3 deg lie half-way between 0.1 and 0.5"


def test_a_start_in_the_past_is_refused_and_nothing_moves() -> None:
    bench = Goals()
    for delay in (-0.1, 0.0, 0.01, 1e4):
        with pytest.raises(GoalError):
            bench.follow(delay=delay)
    before = bench.where("J1")
    bench.keep(bench.key, 1.0)
    assert abs(bench.where("J1") - before) < STILL
    assert not bench.owner.group.busy


def test_a_motion_can_be_cancelled_before_and_after_its_start() -> None:
    bench = Goals()
    number = bench.follow(delay=1.0)
    bench.goals.cancel(bench.order(bench.key), number + 1)
    assert bench.outcome(number) == ""
    bench.goals.cancel(bench.order(bench.key), number)
    assert bench.outcome(number) == "preempted"
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
        assert report.outcome == "aborted"
        assert "lost the lease" in report.text
        assert bench.travel("J1", 1.0) < STILL
        assert (abs(bench.where("J1") - before) < STILL) == (silence > 0)


def test_a_stop_ends_the_motion_and_what_was_asked_before_it() -> None:
    bench = Goals()
    early = bench.order(bench.key)
    number = bench.follow(delay=1.0)
    bench.bench.ask(lambda: bench.shared.stop("Bob stopped it"))
    report = bench.goals.report(number)
    assert report is not None
    assert "Bob stopped it" in report.text
    bench.bench.ask(lambda: bench.shared.resume(bench.order(bench.key)))
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
    with pytest.raises(GoalError, match="cancelled before it began"):
        _ = (
            bench.goals.check(sent, order((0.0, HOME), far))
            if only_check
            else bench.goals.follow(sent, order(far), soon)
        )
    assert len(seen) == 10


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
    assert bench.outcome(number) == ""
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
    bench.goals.close()
    with pytest.raises(ValueError, match="not in list"):
        bench.goals.close()
