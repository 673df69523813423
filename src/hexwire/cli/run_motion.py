"""Shared by the motion commands: prints the plan and the result of a motion, and draws it.

Owns the texts and the picture. Must not know how a motion is checked or run.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hexwire.errors import ServoError
from hexwire.link.tap import Missed

from .common import refuse_idle_table
from .exits import note, tell_missed
from .move import arrived_words, hold_on_ctrl_c, rest_json, unwatched_note
from .output import print_json, say
from .plot import MotionPlot

if TYPE_CHECKING:
    from hexwire.control.motions import CheckedPath, MotionOptions
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.kinematics import KinematicModel
    from hexwire.model.state import JointState
    from hexwire.motion.checks import MotionReport
    from hexwire.motion.waypoints import Trajectory
    from hexwire.new_file import OutputFile

__all__ = ["RunOptions", "run_legs"]


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Options of all motion commands.

    Attributes:
        table: Height of the table above the base, metres; None for no table.
        plot: File for a picture, already created; or None.
        dry_run: Check and draw only.
        rate: Cycles per second; by dialect if None.
        as_json: Print one JSON document at the end instead of lines.
        host_timed: Send targets one by one, also to a board that keeps the time itself.
        outlives: Let such a board finish the motion although this program dies.
    """

    table: float | None
    plot: OutputFile | None
    dry_run: bool
    rate: float | None
    as_json: bool
    host_timed: bool = False
    outlives: bool = False


def run_legs(
    robot: RobotDriver,
    legs: Sequence[tuple[str, Trajectory]],
    start: Mapping[str, float],
    options: RunOptions,
    title: str,
) -> None:
    """Check every leg, then run them one after the other.

    Args:
        robot: Attached.
        legs: Pairs of name and trajectory, in driver joints; each begins where the previous one ends.
        start: Positions of all joints, radians.
        options: As typed.
        title: Title of the picture.

    Raises:
        UsageError: The path of a leg is not allowed; nothing was sent.
        ServoError: The arm was stopped, or did not arrive.
    """
    from hexwire.control.motions import MotionOptions, check_path
    from hexwire.control.rest import come_to_rest

    refuse_idle_table(robot)
    model = robot.kinematics
    how = MotionOptions(
        table=options.table,
        rate=options.rate or 0.0,
        host_timed=options.host_timed,
        outlives=options.outlives,
    )
    path = check_path(robot, [leg for _, leg in legs], how, start=start)
    told = []
    for (name, _), report in zip(legs, path.reports, strict=True):
        told.append(_as_json(name, report))
        if not options.as_json:
            say(f"{name}: {_in_words(report)}")
    plot = _planned(path.legs, model, start, title)
    missed = Missed()
    outcome: dict[str, object] = {"legs": told, "arrived": None if options.dry_run else False, "plot": None}
    outcome |= rest_json(None)
    try:
        if not options.dry_run:
            _drive(robot, path, how, plot, missed)
            rest = come_to_rest(robot, dict(zip(path.legs[-1].names, path.legs[-1].goal, strict=True)))
            if not options.as_json:
                say(arrived_words(rest))
            outcome |= {"arrived": True, **rest_json(rest)}
    finally:
        if options.plot is not None:
            # After a motion, a failure to draw must not hide how the motion ended.
            draw = plot.draw if options.dry_run else missed.guard(plot.draw)
            draw(options.plot)
            if missed.first is None:
                outcome["plot"] = str(options.plot.path)
                if not options.as_json:
                    say(f"drawn: {options.plot.path}")
            # Does nothing if the picture was drawn.
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
    legs: Sequence[Trajectory], model: KinematicModel | None, start: Mapping[str, float], title: str
) -> MotionPlot:
    names = legs[0].names
    plot = MotionPlot(names, title)
    begin = 0.0
    for leg in legs:
        for t, sample in leg.samples(max(leg.duration / 200, 1e-3)):
            plot.planned.append((begin + t, sample.position))
            if model is not None:
                angles = model.from_joints({**start, **dict(zip(names, sample.position, strict=True))})
                plot.path.append(model.forward(angles).position)
        begin += leg.duration
    return plot


def _drive(robot: RobotDriver, path: CheckedPath, how: MotionOptions, plot: MotionPlot, missed: Missed) -> None:
    from hexwire.control.motions import MotionObserver, run_motion

    names, model = path.legs[0].names, robot.kinematics
    began: list[float] = []

    @missed.guard
    def draw(state: JointState) -> None:
        positions = state.positions
        began.append(state.stamp)
        plot.measured.append((state.stamp - began[0], [positions[name] for name in names]))
        if model is not None:
            plot.measured_path.append(model.forward(model.from_joints(positions)).position)

    class Watcher(MotionObserver):
        def unwatched(self, seconds: float) -> None:
            unwatched_note(robot, seconds)

        def refused(self, why: str) -> None:
            note(f"targets are sent one by one, since the board does not follow this path itself: {why}")

        def seen(self, state: JointState) -> None:
            draw(state)

    # On Ctrl-C the stop comes first.
    with hold_on_ctrl_c(robot):
        result = run_motion(robot, path, how, observer=Watcher())
    if result.stopped is not None:
        raise ServoError(f"{result.why}; clear it with 'hexwire resume'")
    # A board that keeps the time does not mind.
    if (skipped := result.timing.skipped) and not result.timed:
        rate = how.rate or robot.command_rate
        note(f"warning: the line or the machine is too slow for {rate:g} Hz; {skipped} cycles were skipped")
    result.require()
