"""How a goal begins while the arm moves: planned without the lock, and again if it has become wrong meanwhile."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from tests.control.arm_bench import SUCCEEDED, Bench, Service, make_bench, order
from tests.motion.arms import EXCESS, HOME, NAMES

import hexwire.motion.set_point_generator
from hexwire.errors import GoalError
from hexwire.model.arms.hex7bot.joints import HEX7BOT

J1 = HOME["J1"]


class Planning:
    """Counts how ways are planned, with the lock or without, and does something while one is planned without."""

    def __init__(self, bench: Bench, monkeypatch: pytest.MonkeyPatch, meanwhile: Callable[[], object]) -> None:
        self._lock, self._meanwhile = bench.owner.locked(), meanwhile
        self.without = self.within = 0
        self._take_over = hexwire.motion.set_point_generator.take_over
        monkeypatch.setattr(hexwire.motion.set_point_generator, "take_over", self._plan)

    def _is_free(self) -> bool:
        def look() -> bool:
            found = self._lock.acquire(blocking=False)
            if found:
                self._lock.release()
            return found

        return Service(look).answer()

    def _plan(self, *arguments: Any, **options: Any) -> Any:
        if self._is_free():
            self.without += 1
            self._meanwhile()
        else:
            self.within += 1
        return self._take_over(*arguments, **options)


def moving() -> Bench:
    bench = make_bench(host_timed=True)
    bench.command(order((4.0, {"J1": J1 + 0.8}), still=True))
    bench.turn(1.5)
    return bench


def keeps_limits(bench: Bench) -> bool:
    """Whether what is planned keeps the limits all along."""
    generator = bench.controller.generator
    begin, end = bench.clock.time - 0.5, bench.clock.time + 4.0
    before = None
    for i in range(round((end - begin) / 1e-3)):
        found = generator.desired(NAMES, begin + i * 1e-3)
        for name, v, a, b in zip(
            NAMES, found.velocity, found.acceleration, before or found.acceleration, strict=True
        ):
            joint = HEX7BOT.joint(name)
            if abs(v) > EXCESS * joint.max_speed or abs(a) > EXCESS * joint.max_acceleration:
                return False
            if abs(a - b) > EXCESS * joint.max_jerk * 1e-3 + 1e-6:
                return False
        before = found.acceleration
    return True


@pytest.mark.slow
def test_the_lock_is_free_while_a_way_is_planned(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = moving()
    planning = Planning(bench, monkeypatch, lambda: None)
    told = bench.command(order((3.0, {"J1": J1 - 0.3}), still=True))
    assert planning.without >= 1
    assert planning.within == 0
    assert keeps_limits(bench)
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED


@pytest.mark.slow
def test_what_is_planned_too_late_is_planned_again_for_later(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = moving()
    planning = Planning(bench, monkeypatch, lambda: bench.turn(0.08))
    told = bench.command(order((3.0, {"J1": J1 - 0.3}), still=True))
    # The first is for now, the second is made in time, since it is known how long that takes.
    assert planning.without == 2
    assert planning.within == 0
    assert bench.controller.planning == pytest.approx(0.08, abs=0.05)
    assert keeps_limits(bench)
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED
    assert bench.where("J1") == pytest.approx(J1 - 0.3, abs=0.02)


@pytest.mark.slow
def test_what_is_never_planned_in_time_is_planned_with_the_lock_in_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = moving()
    planning = Planning(bench, monkeypatch, lambda: bench.turn(0.4))
    told = bench.command(order((3.0, {"J1": J1 - 0.3}), still=True))
    assert planning.without == 3
    assert planning.within >= 1
    assert keeps_limits(bench)
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED


@pytest.mark.slow
def test_what_else_is_begun_meanwhile_is_what_it_begins_from(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = moving()
    todo = [lambda: bench.arm.hold("", "a test")]
    planning = Planning(bench, monkeypatch, lambda: todo.pop()() if todo else None)
    told = bench.command(order((3.0, {"J1": J1 - 0.3}), still=True))
    assert planning.without == 2
    assert keeps_limits(bench)
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED


def test_a_goal_that_nobody_wants_any_more_does_not_begin(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = moving()
    wanted = [True]
    Planning(bench, monkeypatch, wanted.clear)
    changes = bench.controller.generator.changes
    with pytest.raises(GoalError, match="cancelled before it began"):
        bench.command(order((3.0, {"J1": J1 - 0.3}), still=True), wanted=lambda: bool(wanted))
    assert bench.controller.generator.changes == changes
