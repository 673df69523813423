"""How a path on an emulated board ends, on its servo line: cancelled, held, and without its host."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import product
from typing import Any

import pytest
from tests.conformance_board.trajectory_pairs import _targets
from tests.control.arm_bench import order
from tests.control.path_ends import rested
from tests.control.test_motions import Watched
from tests.control.test_onboard_execution import Timed
from tests.control.test_timed_motion import Timed as Program
from tests.few import few
from tests.motion.arms import HOME, NAMES

from hexwire.control.loop.outcomes import Outcome
from hexwire.control.motion.board_path_feeder import PathBrake
from hexwire.control.motion.goals import Point, TrajectoryGoal
from hexwire.control.motion.motions import run_motion
from hexwire.drivers.timed_path import PathState, TimedPath, TimedPoint
from hexwire.emulator.board_trajectory import LEAD_MS
from hexwire.errors import LimitError
from hexwire.model.arm import ArmModel
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.geometry import make_kinematics
from hexwire.model.pose import Pose
from hexwire.model.state import JointState
from hexwire.motion.checks import InJoints
from hexwire.motion.limits import slow_enough
from hexwire.motion.line import Line as TipLine
from hexwire.motion.safety import SafetyLimits
from hexwire.motion.through import arm_path
from hexwire.motion.trajectory import Trajectory
from hexwire.wire.command_frame import Command

MOST = 1.001
STEP = 0.001
ROUNDING = 1.1
"""Counts: half of one by which cubics between points may be off, half for rounding, and what the wire rounds."""
JOINTS = {"J1": 1.0, "J5": -0.8, "J6": 0.4}
CURVED = ("J1", "J3", "J4", "J5", "J6")
NEARLY = replace(
    HEX7BOT,
    joints=tuple(
        replace(joint, max_acceleration=0.85 * joint.max_acceleration, max_jerk=0.4 * joint.max_jerk)
        for joint in HEX7BOT.joints
    ),
)
"""What a client keeps: between its points the quintics of a goal have more jerk than the path that they are of."""


class Line:
    """What a bench sends to its servos, and the brakes that were made for it."""

    def __init__(self, bench: Timed, patch: pytest.MonkeyPatch) -> None:
        self.bench = bench
        self.targets: list[tuple[float, int, int]] = []
        self.brakes: list[tuple[Trajectory, float, list[TimedPoint], tuple[str, ...]]] = []
        transact = bench.board.wire.transact

        def noted(packet: bytes, now: float) -> tuple[bytes, float]:
            self.targets += [(now, joint, counts) for joint, counts in _targets(packet)]
            return transact(packet, now)

        patch.setattr(bench.board.wire, "transact", noted)
        after = PathBrake.after

        def made(brake: PathBrake, plan: Trajectory, time: float) -> list[TimedPoint]:
            points = after(brake, plan, time)
            self.brakes.append((plan, time, points, brake._joints))
            return points

        patch.setattr(PathBrake, "after", made)

    def ideal(self) -> tuple[Callable[[float], list[tuple[float, float, float]]], tuple[str, ...], float]:
        """What was meant: position, velocity and acceleration of the joints at a time; their names; the end."""
        onboard = self.bench.owner._output._onboard
        path = self.bench.board.trajectory.path
        assert onboard is not None
        assert path is not None
        last = path._knots[-1]
        end = last.at * 1e-4
        for plan, begin, points, names in reversed(self.brakes):
            if points and abs(points[-1].time - end) < 1e-5:
                row = zip(names, points[-1].positions, last.positions, strict=True)
                if all(abs(HEX7BOT.joint(name).angle_to_counts(p, 8) - counts) <= 1 for name, p, counts in row):
                    return rested(plan, begin, points, names), names, end
        whole = onboard.feeder.on_robot
        return (lambda t: list(zip(*whole.sample(t), strict=True))), whole.names, whole.duration


@few("how, seed", product(("cancelled", "held", "silent"), range(2)), ("cancelled", 0), ("silent", 1))
def test_a_path_ends_within_all_limits_however_it_ends(
    how: str, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At 1 kHz what the host means keeps the limits, and on the servo line is what the host means."""
    draw = random.Random(10 * seed + len(how))
    bench = Timed(watchdog=0.0)
    line = Line(bench, monkeypatch)
    far = draw.uniform(0.5, 1.2)
    limit = HEX7BOT.joint("J1")
    # A quintic at one of its limits.
    seconds = max(
        1.875 * far / limit.max_speed,
        math.sqrt(5.7735 * far / limit.max_acceleration),
        (60.0 * far / limit.max_jerk) ** (1.0 / 3.0),
    )
    there = {name: HOME[name] + share * far for name, share in JOINTS.items()}
    told = bench.command(order((0.6, HOME), (0.6 + 1.02 * seconds, there), still=True))
    # Where it is fast.
    bench.turn(0.6 + draw.uniform(0.35, 0.6) * seconds)
    assert bench.state is PathState.RUNNING
    since = bench.clock.time
    if how == "cancelled":
        bench.owner.group.cancel(told)
        bench.turn(1.5)
    elif how == "held":
        bench.ask(lambda: bench.owner.settle("a jog was begun"))
    else:
        bench.stall(5.0)
    at, names, end = line.ideal()
    limits = [HEX7BOT.joint(name) for name in names]
    start = bench.board.trajectory.start_at - LEAD_MS / 1000.0
    fastest = 0.0
    for n in range(round(max(0.0, since - start - 0.2) / STEP), math.ceil(end / STEP)):
        before, now = at((n - 1) * STEP), at(n * STEP)
        for (_, _, b), (p, v, a), joint in zip(before, now, limits, strict=True):
            assert abs(v) <= MOST * joint.max_speed
            assert abs(a) <= MOST * joint.max_acceleration
            assert abs(a - b) <= MOST * joint.max_jerk * STEP + 1e-6
            assert joint.minimum <= p <= joint.maximum
            fastest = max(fastest, abs(v))
    assert fastest > 0.4
    assert all(abs(v) < 1e-6 for _, v, _ in at(end))
    told_counts = 0
    for time, servo, counts in line.targets:
        name = HEX7BOT.by_servo(servo).name
        if start < time <= start + end and name in names:
            place = at(time - start)[names.index(name)][0]
            ideal = (place - HEX7BOT.joint(name).counts_to_angle(counts)) / HEX7BOT.joint(name).scale
            assert abs(ideal) <= ROUNDING, (name, time - start, ideal)
            told_counts += 1
    assert told_counts > 100


@few("how, seed", product(("held", "settled"), range(12)), ("held", 2), ("settled", 9))
def test_on_a_curve_at_its_limits_the_host_ends_a_path_and_not_the_board(how: str, seed: int) -> None:
    """The law of the board exceeds the limits there; it is neither asked for, nor does it run out of points."""
    draw = random.Random(seed)
    names = draw.sample(CURVED, draw.choice((1, 2, 4)))
    fast = _fast(draw, names)
    bench = Timed(watchdog=0.0)
    told = bench.command(_goal(fast, 0.5))
    bench.turn(0.5 + draw.uniform(0.1, 0.9) * fast.duration)
    assert bench.state is PathState.RUNNING
    path = bench.board.trajectory.path
    if how == "held":
        bench.arm.hold("", "a test")
    else:
        bench.ask(lambda: bench.owner.settle("a jog was begun"))
    bench.until(lambda: bench.state is not PathState.RUNNING and told.ends)
    assert Command.TRAJECTORY_ABORT not in bench.commands()
    assert bench.state is PathState.DONE
    assert not (path and path.dry)


@few("seed", (*range(24), 32, 43), 43)
def test_on_a_curve_at_its_limits_a_new_goal_never_lets_the_board_brake_by_itself(seed: int) -> None:
    """Where no brake is possible, each request with points of a path lasts until the next one has come."""
    draw = random.Random(seed)
    names = draw.sample(CURVED, draw.choice((1, 2, 4)))
    before = _fast(draw, names)
    bench = Timed(watchdog=0.0)
    bench.command(_goal(before, 0.5))
    if seed < 24:
        after = _fast(draw, names)
        bench.turn(0.5 + draw.uniform(0.1, 0.8) * before.duration)
        begins = draw.uniform(1.0, 2.0)
    else:
        # The next goal begins where the arm is now, half a second later.
        now, begins = draw.uniform(0.1, 0.9) * before.duration, 0.5
        bench.turn(0.5 + now)
        after = _fast(draw, names, HOME | dict(zip(names, before.sample(now).position, strict=True)))
    assert bench.state is PathState.RUNNING
    told = bench.command(_goal(after, begins))
    path, seen = bench.board.trajectory.path, set[PathState]()
    while not told.ends:
        bench.turn(0.01)
        seen.add(bench.state)
    assert [end.outcome for end in told.ends] == [Outcome.SUCCEEDED]
    assert seen <= {PathState.RUNNING, PathState.DONE}
    assert bench.board.trajectory.path is path
    assert not (path and path.dry)


@few("seed", range(12), 0, 5)
def test_over_a_slow_line_a_program_lets_no_board_run_dry_on_a_curve_at_its_limits(seed: int) -> None:
    """It sends so much at once that the points last until the next request has come."""
    draw, bench = random.Random(seed), Program()
    names = NAMES[:6]
    fast = _fast(draw, names, {name: bench.at(name) for name in names})
    begin = bench.robot.path

    def begun(*given: Any, **rest: Any) -> TimedPath:
        path = begin(*given, **rest)
        for what in ("send", "report"):
            setattr(path, what, slowly(getattr(path, what)))
        return path

    def slowly(call: Callable[..., Any]) -> Callable[..., Any]:
        def called(*given: Any, **rest: Any) -> Any:
            bench.arm.wait(0.3)
            return call(*given, **rest)

        return called

    def look(state: JointState) -> None:
        path = bench.arm.board.trajectory.path
        assert not (path and (path.braking or path.dry))

    bench.robot.path = begun  # type: ignore[method-assign]
    limits = SafetyLimits(following_error=3.0, collision_load=3.0, load=3.0)
    options = bench.options(check_geometry=False, limits=limits, watchdog=3.0)
    result = run_motion(bench.robot, fast, options, observer=Watched(look))
    assert (result.arrived, result.timed, result.why) == (True, True, "")


# Lines from paths that turn J5: where it stays at home the wrist is singular, and a line takes minutes, far below
# all limits but for a moment.
@few(
    "how, seed",
    (*product(["goal"], range(8)), *product(["line"], (0, 2, 4, 11, 12, 14, 15, 17))),
    ("goal", 1),
    ("line", 0),
)
def test_what_replaces_a_path_near_its_limits_keeps_them_at_1_khz_and_on_the_line(
    how: str, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Until its second request comes, a board has only the points of the first one, in place of all others."""
    draw = random.Random(f"{how} {seed}")
    names = draw.sample(CURVED, draw.choice((1, 2, 4)))
    fast = _fast(draw, names, HOME, NEARLY)
    bench = Timed(watchdog=0.0)
    line = Line(bench, monkeypatch)
    bench.command(_goal(fast, 0.5))
    when = draw.uniform(0.1, 0.9) * fast.duration
    bench.turn(0.5 + when)
    here = HOME | dict(zip(names, fast.sample(when).position, strict=True))
    new = _straight(draw, here) if how == "line" else _fast(draw, names, here, NEARLY)
    began, ends = bench.clock.time, bench.clock.time + new.duration + 1.0
    told = bench.command(_goal(new, 0.5))
    onboard, start = bench.owner._output._onboard, bench.board.trajectory.start_at - LEAD_MS / 1000.0
    assert onboard is not None
    limits = [HEX7BOT.joint(name) for name in NAMES]
    n, before, meant = round((began - start) / STEP), None, dict[int, tuple[float, ...]]()
    while bench.clock.time < ends:
        bench.turn(0.02)
        path = bench.board.trajectory.path
        assert path is not None
        assert not path.braking
        plan = onboard.feeder.on_robot
        while n * STEP <= bench.clock.time - start:
            now = plan.sample(min(n * STEP, plan.duration))
            for i, joint in enumerate(limits):
                assert joint.minimum <= now.position[i] <= joint.maximum
                assert abs(now.velocity[i]) <= MOST * joint.max_speed
                assert abs(now.acceleration[i]) <= MOST * joint.max_acceleration
                change = 0.0 if before is None else abs(now.acceleration[i] - before.acceleration[i])
                assert change <= MOST * joint.max_jerk * STEP + 1e-6
            before, meant[n] = now, now.position
            n += 1
    assert told.ends
    assert bench.state is PathState.DONE
    assert not bench.targets
    for time, servo, counts in line.targets:
        place, turned = math.floor((time - start) / STEP), HEX7BOT.by_servo(servo)
        if time > began and place in meant and place + 1 in meant:
            assert turned is not None
            i, share = NAMES.index(turned.name), (time - start) / STEP - place
            ideal = meant[place][i] + share * (meant[place + 1][i] - meant[place][i])
            assert abs(ideal - turned.counts_to_angle(counts)) <= ROUNDING * turned.scale, (
                turned.name,
                time - start,
            )
    # It never had to come to rest in between.
    assert bench.commands().count(Command.TRAJECTORY_BEGIN) == 1
    assert Command.TRAJECTORY_ABORT not in bench.commands()


def _fast(
    draw: random.Random, names: Sequence[str], start: Mapping[str, float] = HOME, arm: ArmModel = HEX7BOT
) -> Trajectory:
    """A path through random places, as fast as the servos of this arm follow."""
    joints = [HEX7BOT.joint(name) for name in names]
    rows = [[start[name] for name in names]]
    for _ in range(draw.choice((2, 3, 5))):
        row = [HOME[name] + draw.uniform(-0.8, 0.8) for name in names]
        rows.append([min(max(p, j.minimum + 0.02), j.maximum - 0.02) for p, j in zip(row, joints, strict=True)])
    return arm_path(arm, names, rows, speed=0.6)


def _straight(draw: random.Random, start: Mapping[str, float]) -> Trajectory:
    """A fast line of the tip."""
    model = make_kinematics(HEX7BOT.name, for_motion=True)
    angles = model.from_joints(start)
    here = model.forward(angles)
    for _ in range(500):
        x, y, z = (value + draw.uniform(-0.1, 0.1) for value in here.position)
        with suppress(LimitError):
            tip = TipLine(model, angles, Pose((x, y, z), here.rotation), speed=0.3, acceleration=1.2)
            return slow_enough(NEARLY, InJoints(tip, model))
    raise AssertionError("no line was found")


def _goal(path: Trajectory, begins: float) -> TrajectoryGoal:
    """A client's points of a path, close together."""
    points, count = [], round(path.duration / 0.03)
    for i in range(count + 1):
        sample = path.sample(path.duration * i / count)
        place, speed, more = dict(HOME), dict.fromkeys(NAMES, 0.0), dict.fromkeys(NAMES, 0.0)
        for column, values in zip((place, speed, more), sample, strict=True):
            column.update(zip(path.names, values, strict=True))
        rows = [tuple(column[name] for name in NAMES) for column in (place, speed, more)]
        points.append(Point(begins + path.duration * i / count, *rows))
    return TrajectoryGoal(NAMES, tuple(points), 0.0)
