"""Streams of goals of one point, as of MoveIt Servo: on a board that executes them, and target by target."""

from __future__ import annotations

from itertools import product
from math import cos, floor, sin

import pytest
from tests.control.test_onboard_execution import Timed
from tests.few import few
from tests.motion.arms import NAMES

from hexwire.control.motion.goals import Point, TrajectoryGoal
from hexwire.model.arms.hex7bot.joints import HEX7BOT

SPEED, RATE, ENDS = 0.6, 50.0, 1.6


KEPT, SENT = "kept by the board", "target by target"


@few(
    "keeper, velocities, horizon",
    product((KEPT, SENT), (False, True), (0.05, 0.1, 0.2, 0.3, 0.4, 0.5)),
    (KEPT, False, 0.1),
)
def test_a_stream_is_followed_evenly_and_ends_at_rest(keeper: str, velocities: bool, horizon: float) -> None:
    stream(keeper == SENT, velocities, horizon, 1)


@few(
    "keeper, velocities, many",
    product((KEPT, SENT), (False, True), ((3, 0.05), (5, 0.08), (3, 0.12), (5, 0.2), (2, 0.3), (3, 0.4), (3, 0.5))),
    (SENT, True, (5, 0.08)),
)
def test_so_is_a_stream_of_trajectories(keeper: str, velocities: bool, many: tuple[int, float]) -> None:
    """Of so many points, the last one so many seconds ahead."""
    count, horizon = many
    stream(keeper == SENT, velocities, horizon, count)


def stream(host_timed: bool, velocities: bool, horizon: float, count: int) -> None:
    """Follow a stream at an even speed whose trajectories have so many points, the last one `horizon` s ahead."""
    bench = Timed(host_timed=host_timed)
    where, began, due = {name: bench.where(name) for name in NAMES}, bench.clock.time, bench.clock.time
    generator, joint = bench.controller.generator, HEX7BOT.joint("J1")
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
        state = generator.desired(NAMES, bench.clock.time)
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


@few(
    "horizon, velocities, even",
    product((0.05, 0.1, 0.2, 0.4), (False, True), (False, True)),
    (0.2, True, False),
)
def test_what_is_planned_on_the_way_keeps_all_limits(horizon: float, velocities: bool, even: bool) -> None:
    """At 1 kHz, as one trajectory replaces the other on a board that executes trajectories."""
    bench, joint, step = Timed(), HEX7BOT.joint("J1"), 0.001
    where, began, due = {name: bench.where(name) for name in NAMES}, bench.clock.time, bench.clock.time
    done, before, fastest, told = 0, None, 0.0, ""
    while (now := bench.clock.time - began) < ENDS + 1.2:
        if bench.clock.time >= due and now < ENDS:
            due += 1.0 / RATE
            time = now + horizon
            place, speed = (SPEED * time, SPEED) if even else (0.3 - 0.3 * cos(2 * time), SPEED * sin(2 * time))
            there = tuple({**where, "J1": where["J1"] - place}[name] for name in NAMES)
            speeds = tuple(-speed if name == "J1" else 0.0 for name in NAMES) if velocities else ()
            bench.arm.command("", TrajectoryGoal(NAMES, (Point(horizon, there, speeds),)), listener=None)
        bench._step()
        onboard = bench.owner._output._onboard
        if onboard is None or not onboard.joints:
            continue
        plan, here = onboard.feeder.on_robot, bench.clock.time - onboard.feeder.origin
        done = done or max(0, floor(here / step) - 1)
        for n in range(done, floor(here / step) + 1):
            sample = plan.sample(min(n * step, plan.duration))
            i = plan.names.index("J1")
            change = 0.0 if before is None else abs(sample.acceleration[i] - before)
            told = f"at {n * step:.3f} s: {sample.velocity[i]}, {before} to {sample.acceleration[i]}"
            assert abs(sample.velocity[i]) <= 1.001 * joint.max_speed, told
            assert abs(sample.acceleration[i]) <= 1.001 * joint.max_acceleration, told
            assert change <= 1.001 * joint.max_jerk * step + 1e-6, told
            before, done = sample.acceleration[i], n + 1
            fastest = max(fastest, abs(sample.velocity[i]))
    assert fastest > 0.9 * SPEED
