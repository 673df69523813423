"""Streams of goals of one point, as of MoveIt Servo: on a board that keeps the time, and target by target."""

from __future__ import annotations

from itertools import product

import pytest
from tests.control.test_sent_ahead import Timed
from tests.few import few
from tests.motion.arms import NAMES

from hexwire.control.goals import Point, TrajectoryGoal
from hexwire.model.hex7bot import HEX7BOT

SPEED, RATE, ENDS = 0.6, 50.0, 1.6


KEPT, SENT = "kept by the board", "target by target"


@few(
    "keeper, velocities, horizon",
    product((KEPT, SENT), (False, True), (0.05, 0.1, 0.2, 0.3, 0.4, 0.5)),
    (KEPT, False, 0.1),
    (SENT, False, 0.3),
)
def test_a_stream_is_followed_evenly_and_ends_at_rest(keeper: str, velocities: bool, horizon: float) -> None:
    stream(keeper == SENT, velocities, horizon, 1)


@few(
    "keeper, velocities, horizon",
    product((KEPT, SENT), (False, True), (0.2, 0.3, 0.5)),
    (KEPT, False, 0.3),
)
def test_so_is_a_stream_of_trajectories_of_three_points(keeper: str, velocities: bool, horizon: float) -> None:
    stream(keeper == SENT, velocities, horizon, 3)


def stream(host_timed: bool, velocities: bool, horizon: float, count: int) -> None:
    """Follow a stream at an even speed whose trajectories have so many points, the last one `horizon` s ahead."""
    bench = Timed(host_timed=host_timed)
    where, began, due = {name: bench.where(name) for name in NAMES}, bench.clock.time, bench.clock.time
    follower, joint = bench.controller.follower, HEX7BOT.joint("J1")
    told: list[tuple[float, float, float]] = []
    while (now := bench.clock.time - began) < ENDS + 1.2:
        if bench.clock.time >= due and now < ENDS:
            due += 1.0 / RATE
            points = []
            for i in range(count):
                ahead = horizon * (i + 1) / count
                there = {**where, "J1": where["J1"] - SPEED * (now + ahead)}
                speeds = tuple(-SPEED if name == "J1" else 0.0 for name in NAMES) if velocities else ()
                points.append(Point(ahead, tuple(there[name] for name in NAMES), speeds))
            # None is refused, however far the arm is behind.
            bench.arm.command("", TrajectoryGoal(NAMES, tuple(points)), listener=None)
        bench._step()
        state = follower.desired(NAMES, bench.clock.time)
        told.append((bench.clock.time - began, state.position[0], state.velocity[0]))
    steady = [v for t, _, v in told if 0.9 < t < ENDS]
    assert max(steady) - min(steady) <= 0.1
    assert max(abs(v + SPEED) for v in steady) <= 0.1
    assert max(abs(v) for _, _, v in told) <= joint.max_speed
    assert told[-1][2] == 0.0
    lag = 0.35 if not velocities else 0.0
    last = where["J1"] - SPEED * (ENDS + horizon)
    # Beyond a point that is passed: where it had gone on to when the board could know it, and the brake.
    assert last - 0.2 <= told[-1][1] <= last + SPEED * lag
    assert joint.minimum <= told[-1][1] <= joint.maximum
    assert bench.where("J1") == pytest.approx(told[-1][1], abs=0.01)
    assert bool(bench.targets) is host_timed
