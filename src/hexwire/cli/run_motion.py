"""How the motion commands run a trajectory: checked as a whole, guarded, drawn, told.

Owns the order: check, torque, watchdog, motion, watchdog off. Must not know where a trajectory comes from.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hexwire.errors import ServoError, UsageError
from hexwire.link.tap import Missed

from .common import watched
from .exits import note, tell_missed
from .move import hold_on_ctrl_c
from .output import print_json, say
from .plot import MotionPlot

if TYPE_CHECKING:
    from hexwire.control.loop import MotionLoop
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.kinematics import KinematicModel
    from hexwire.model.state import JointState
    from hexwire.motion.checks import MotionReport
    from hexwire.motion.waypoints import Trajectory
    from hexwire.new_file import OutputFile

__all__ = ["MotionOptions", "run_motion", "torque_up"]

_SETTLE = 3.0
_ARRIVED = math.radians(1.5)


@dataclass(frozen=True, slots=True)
class MotionOptions:
    """What all motion commands share.

    Attributes:
        table: Height of the table above the base, metres; None for none.
        plot: File for a picture, made already; or None.
        dry_run: Check and draw only.
        rate: Cycles a second; by dialect if None.
        as_json: Print one JSON document at the end, and no lines.
    """

    table: float | None
    plot: OutputFile | None
    dry_run: bool
    rate: float | None
    as_json: bool


def torque_up(robot: RobotDriver, names: Sequence[str]) -> None:
    """Give torque to those joints that have none; nothing moves by it.

    Raises:
        ServoError: A joint did not confirm it.
    """
    have = robot.read().torque_on
    missing = [name for name in names if name not in have]
    if missing:
        confirmed = robot.torque(True, missing)
        limp = [name for name in missing if name not in confirmed]
        if limp:
            raise ServoError(f"no torque on {', '.join(limp)}: check cable, power and id")


def run_motion(
    robot: RobotDriver,
    legs: Sequence[tuple[str, Trajectory]],
    model: KinematicModel | None,
    start: Mapping[str, float],
    options: MotionOptions,
    title: str,
) -> None:
    """Check every leg, then run them one after the other.

    Args:
        robot: Attached.
        legs: Pairs of what it is and the trajectory, in driver joints; each begins where the one before ends.
        model: Kinematics for gates, table and path; None without.
        start: Where all joints are, radians.
        options: As typed.
        title: For the picture.

    Raises:
        LimitError: A leg must not be run; nothing was sent.
        ServoError: The arm was stopped, or did not arrive.
    """
    from hexwire.motion.checks import check_trajectory

    where = dict(start)
    told: list[dict[str, object]] = []
    for name, leg in legs:
        report = check_trajectory(leg, robot.model, model, others=where, table=options.table).require()
        told.append(_as_json(name, report))
        if not options.as_json:
            say(f"{name}: {_in_words(report)}")
        where.update(zip(leg.names, leg.goal, strict=True))
    plot = _planned(legs, model, start, title)
    missed = Missed()
    outcome: dict[str, object] = {"legs": told, "arrived": None if options.dry_run else False, "plot": None}
    try:
        if not options.dry_run:
            _drive(robot, legs, model, options, plot, missed)
            outcome["arrived"] = True
    finally:
        if options.plot is not None:
            # The arm has moved as it has: a picture that fails changes nothing of that.
            draw = plot.draw if options.dry_run else missed.guard(plot.draw)
            draw(options.plot)
            if missed.first is None:
                outcome["plot"] = str(options.plot.path)
                if not options.as_json:
                    say(f"drawn: {options.plot.path}")
            # Harmless for one that was drawn.
            options.plot.discard()
        tell_missed(f"the picture {options.plot.path if options.plot else ''}", missed)
        if options.as_json:
            print_json(outcome)


def _as_json(name: str, report: MotionReport) -> dict[str, object]:
    return {
        "name": name,
        "duration_s": report.duration,
        "peak_speed_deg_per_s": {joint: math.degrees(speed) for joint, speed in report.peak_speed.items()},
        "lowest_point_m": report.lowest,
    }


def _in_words(report: MotionReport) -> str:
    fastest = max(report.peak_speed, key=lambda name: report.peak_speed[name])
    text = f"{report.duration:.2f} s, fastest {fastest} at {math.degrees(report.peak_speed[fastest]):.0f} deg/s"
    if math.isfinite(report.lowest):
        text += f", lowest point {1e3 * report.lowest:.0f} mm"
    return text


def _planned(
    legs: Sequence[tuple[str, Trajectory]], model: KinematicModel | None, start: Mapping[str, float], title: str
) -> MotionPlot:
    names = legs[0][1].names
    plot = MotionPlot(names, title)
    begin = 0.0
    for _, leg in legs:
        if leg.names != names:
            raise UsageError("the legs of a motion must move the same joints")
        for t, sample in leg.samples(max(leg.duration / 200, 1e-3)):
            plot.planned.append((begin + t, sample.position))
            if model is not None:
                angles = model.from_joints({**start, **dict(zip(names, sample.position, strict=True))})
                plot.path.append(model.forward(angles).position)
        begin += leg.duration
    return plot


def _drive(
    robot: RobotDriver,
    legs: Sequence[tuple[str, Trajectory]],
    model: KinematicModel | None,
    options: MotionOptions,
    plot: MotionPlot,
    missed: Missed,
) -> None:
    from hexwire.control.loop import MotionLoop
    from hexwire.motion.follower import Follower
    from hexwire.motion.safety import SafetyLimits

    names = legs[0][1].names
    rate = options.rate or robot.command_rate
    loop = MotionLoop(robot, Follower(robot.model, SafetyLimits.at_period(1.0 / rate)), rate)
    began = 0.0

    @missed.guard
    def seen(state: JointState) -> None:
        positions = state.positions
        plot.measured.append((state.stamp - began, [positions[name] for name in names]))
        if model is not None:
            plot.way.append(model.forward(model.from_joints(positions)).position)

    # On Ctrl-C the stop comes first, and the watchdog goes off after it.
    with watched(robot, loop.lead, loop.timing.period), hold_on_ctrl_c(robot):
        torque_up(robot, names)
        loop.cycle()
        began = loop.state.stamp if loop.state else 0.0
        for _, leg in legs:
            # Stopped before it began: the reason is told below.
            if loop.follower.reason is not None:
                break
            loop.follow(leg)
            reason = loop.run(until_done=True, each=seen)
            if reason is None:
                reason = loop.run(loop.lead, each=seen)
            if reason is not None:
                break
        off = _settle(loop, names, legs[-1][1].goal)
    if loop.follower.reason is not None:
        raise ServoError(f"stopped: {loop.follower.reason}; 'hexwire resume' ends that")
    counters = loop.timing.counters
    if counters.skipped:
        note(f"warning: line or machine are too slow for {rate:g} Hz; {counters.skipped} cycles were left out")
    if off:
        raise ServoError(f"did not arrive: {off}")
    if not options.as_json:
        say("arrived")


def _settle(loop: MotionLoop, names: Sequence[str], goal: Sequence[float]) -> str:
    """Wait until the joints stand at the goal; returns which do not."""
    off: dict[str, float] = {}
    for _ in loop.timing.ticks(_SETTLE):
        loop.cycle()
        if loop.state is None or loop.follower.reason is not None:
            break
        ways = loop.state.distances(dict(zip(names, goal, strict=True)))
        off = {name: way for name, way in ways.items() if way > _ARRIVED}
        if not off:
            return ""
    return ", ".join(
        f"{name} is {math.degrees(way):.1f} deg off" if way < math.inf else f"it is not known where {name} is"
        for name, way in off.items()
    )
