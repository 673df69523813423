"""`move`, and what the motion commands share: the plan and the result of a motion, and its picture.

Owns how a user types a target, and the texts. Must not know how a motion is checked or run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

from hexwire.errors import ServoError, UsageError
from hexwire.link.tap import Missed

from .exits import note, shielded, tell_missed
from .look import joint_json, raise_if_silent
from .model import make_robot_with
from .options import (
    RobotOptions,
    attached,
    json_option,
    links_option,
    number_option,
    on_terminal,
    refuse_idle_table,
    robot_options,
    table_options,
)
from .output import print_json, say
from .plot import MotionPlot

if TYPE_CHECKING:
    from hexwire.control.motions import CheckedPath, MotionOptions, MotionResult
    from hexwire.control.rest import Rest
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.arm import ArmModel
    from hexwire.model.kinematics import KinematicModel
    from hexwire.model.state import JointState, SentTarget
    from hexwire.motion.checks import MotionReport
    from hexwire.motion.waypoints import Trajectory
    from hexwire.new_file import OutputFile

__all__ = [
    "RunOptions",
    "arrived_words",
    "check_targets",
    "hold_on_ctrl_c",
    "move",
    "parse_targets",
    "rest_json",
    "run_legs",
    "unwatched_note",
]

_SHOWN = math.radians(0.1)
"""A little more than a count."""

_GRACE = 2.0
"""Seconds after the duration of the move in which the joints must arrive: servos settle, and lag under load."""


@click.command()
@click.argument("targets", metavar="{JOINT=DEGREES | POSE}...", nargs=-1, required=True)
@number_option(
    "--duration",
    "SECONDS",
    "Duration of the motion; longer if a speed limit requires it.",
    minimum=0,
    default=1.0,
)
@click.option("--wait", is_flag=True, help="Wait until the joints have arrived; Ctrl-C stops the arm.")
@number_option("--tolerance", "DEGREES", "With --wait, how near counts as arrived.", above=0, default=1.0)
@click.option(
    "--host-timed",
    is_flag=True,
    help="Send one target, to which each servo goes by itself, although the board can keep the time.",
)
@table_options
@links_option
@robot_options
@json_option
def move(
    targets: tuple[str, ...],
    duration: float,
    wait: bool,
    tolerance: float,
    host_timed: bool,
    table: float | None,
    links: str,
    options: RobotOptions,
    as_json: bool,
) -> None:
    """Move joints to angles in degrees, for example J1=10 J3=-5.5, or to a pose: home, or one saved by name.

    Torque is first switched on for joints without it, which moves nothing. If the arm's geometry is known, a path
    that violates the joint coupling limits or the table is refused.

    A board with hexwire's firmware moves all joints together on a smooth path, in its own time; on other robots and
    on a shared arm each servo goes to its target by itself.

    With --wait, the board stops the arm if this program dies or hangs for a second. Without --wait, this program
    ends at once, and the board completes the motion; only 'hexwire stop', or another command that moves the same
    joints, ends it earlier. A board of dialect 1 and a servo bus have no watchdog: for these, --wait sends the
    motion in short steps, so that the arm soon stops if this program dies.
    """
    from hexwire.control.motions import MotionObserver, MotionOptions, run_motion
    from hexwire.control.rest import come_to_rest
    from hexwire.errors import ServoError
    from hexwire.model.state import JointTarget

    angles = parse_targets([word for word in targets if "=" in word])
    robot = make_robot_with(links, options)
    poses = known_poses(robot.model, [word for word in targets if "=" not in word], "JOINT=DEGREES")
    angles += [(name, math.degrees(angle)) for pose in poses.values() for name, angle in pose.items()]
    target = JointTarget.of(check_targets(robot.model, angles), duration)
    refuse_idle_table(robot)
    tell: Callable[[str], object] = (lambda _: None) if as_json else say
    how = MotionOptions(
        table=table,
        tolerance=math.radians(tolerance),
        grace=_GRACE,
        host_timed=host_timed,
    )

    with _progress() if wait and on_terminal() and not as_json else nullcontext(lambda *_: None) as show:

        class Teller(MotionObserver):
            goal: Mapping[str, float] = {}
            farthest = 0.0

            def powered(self, joints: Sequence[str]) -> None:
                tell(f"torque on: {' '.join(joints)}")

            def unwatched(self, seconds: float) -> None:
                unwatched_note(robot, seconds)

            def sent(self, sent: SentTarget) -> None:
                self.goal = dict(sent.positions)
                words = "  ".join(f"{name} {math.degrees(angle):.2f}" for name, angle in sent.positions)
                tell(f"moving to: {words} deg in {sent.duration:.2f} s")
                if sent.clamped:
                    note(f"warning: the board's own limits clamped the target of {', '.join(sent.clamped)}")

            def seen(self, state: JointState) -> None:
                left = state.distances(self.goal)
                if left:
                    name = max(left, key=lambda name: left[name])
                    self.farthest = max(self.farthest, left[name])
                    share = 1.0 if not self.farthest else 1.0 - left[name] / self.farthest
                    show(share if math.isfinite(share) else 0.0, f"{name} {math.degrees(left[name]):.1f} deg to go")

        with attached(robot), hold_on_ctrl_c(robot):
            result = run_motion(robot, target, how, wait=wait, observer=Teller())
            rest = None
            if result.arrived and result.sent is not None:
                rest = come_to_rest(robot, dict(result.sent.positions))
            if as_json:
                print_json(_as_json(robot, result) | rest_json(rest))
    if result.sent is not None:
        raise_if_silent([(robot.model.joint(name).servo_id, name) for name in result.sent.silent])
    if result.stopped is not None:
        why = f"the arm was stopped before it arrived: {result.stopped}"
        raise ServoError(f"{why}; clear it with 'hexwire resume'")
    if result.without_torque:
        raise ServoError(result.why)
    if result.arrived is False:
        raise ServoError(_shortfall(result))
    if rest is not None:
        tell(arrived_words(rest))


def parse_targets(words: Sequence[str]) -> list[tuple[str, float]]:
    """Parse targets such as ``J1=10``; returns pairs of name and degrees.

    Raises:
        UsageError: A target is wrong; the text lists all of them on one line.
    """
    from hexwire.errors import UsageError

    targets, wrong = [], []
    for word in words:
        name, equals, text = word.partition("=")
        try:
            angle = float(text)
        except ValueError:
            angle = math.nan
        if not name or not equals or not math.isfinite(angle):
            wrong.append(repr(word))
        targets.append((name, angle))
    if wrong:
        raise UsageError(f"{', '.join(wrong)}: write a target as JOINT=DEGREES, for example J1=10 J3=-5.5")
    return targets


def check_targets(model: ArmModel, targets: Sequence[tuple[str, float]]) -> dict[str, float]:
    """Check targets in degrees.

    Returns:
        Radians by joint name as in the model.

    Raises:
        UsageError: A joint does not exist, is named twice or would leave its limits; the text lists all faults.
    """
    from hexwire.errors import LimitError, UsageError

    goal: dict[str, float] = {}
    wrong = []
    for name, angle in targets:
        if name.lower() not in (known.lower() for known in model.names):
            wrong.append(f"no joint {name!r} ({model.name} has {', '.join(model.names)})")
            continue
        joint = model.joint(name)
        if joint.name in goal:
            wrong.append(f"{joint.name} is named twice")
        goal[joint.name] = math.radians(angle)
        try:
            joint.check(goal[joint.name])
        except LimitError as error:
            wrong.append(str(error).partition(";")[0])
    if wrong:
        raise UsageError("; ".join([*wrong, "nothing was sent"]))
    return goal


def known_poses(arm: ArmModel, names: Sequence[str], instead: str = "a number") -> dict[str, Mapping[str, float]]:
    """The poses of these names: radians by joint.

    Args:
        arm: Whose poses.
        names: Words that were typed.
        instead: What else such a word may be, for the error.

    Raises:
        UsageError: There is no such pose.
        ConfigError: The file of poses is damaged.
    """
    if not names:
        return {}
    from hexwire.control.pose_file import PoseFile

    known = PoseFile(arm).known()
    for name in names:
        if name not in known:
            raise UsageError(
                f"{name!r} is neither {instead} nor a pose of {arm.name}; known are: {', '.join(known)}"
            )
    return {name: known[name] for name in names}


@contextmanager
def hold_on_ctrl_c(robot: RobotDriver) -> Iterator[None]:
    """Stop the arm when the program is interrupted; the arm holds."""
    from hexwire.errors import HexwireError

    try:
        yield
    except KeyboardInterrupt:
        with shielded():
            try:
                robot.stop()
            except HexwireError as error:
                note(f"warning: the arm could not be stopped: {error}")
            else:
                kept = robot.stop_kept_by
                note("stopped: the arm holds" + ("; clear it with 'hexwire resume'" if kept else ""))
        raise


def unwatched_note(robot: RobotDriver, seconds: float) -> None:
    """Warn that nothing stops the arm if this program, or the server of a shared arm, dies."""
    where, dies = ("at its server", "its server") if robot.has_watchdog else ("on this port", "this program")
    note(
        f"note: {robot.model.name} has no watchdog {where}: "
        f"if {dies} dies, the arm moves on to its last target, for up to {seconds:.2g} s"
    )


def arrived_words(rest: Rest) -> str:
    """That the arm has arrived, and how far off its goal it came to rest."""
    if math.isnan(rest.off):
        return f"arrived; since then the position of {rest.joint} is unknown"
    if rest.off < _SHOWN:
        return "arrived"
    text = f"arrived, {rest.joint} {math.degrees(rest.off):.1f} deg off"
    return text if rest.tip is None else f"{text}, the tip {1e3 * rest.tip:.1f} mm"


def rest_json(rest: Rest | None) -> dict[str, float | None]:
    """How far off its goal the arm came to rest, for ``--json``; None if it has not arrived."""
    if rest is None:
        return {"off_deg": None, "off_mm": None}
    return {
        "off_deg": None if math.isnan(rest.off) else math.degrees(rest.off),
        "off_mm": None if rest.tip is None else 1e3 * rest.tip,
    }


def _shortfall(result: MotionResult) -> str:
    from hexwire.model.state import condition

    parts = []
    for row in result.off:
        why = "ok" if result.state is None else condition(result.state[row.joint])
        far = math.degrees(row.by)
        known = row.by < math.inf
        where = f"{row.joint} is {far:.1f} deg away" if known else f"the position of {row.joint} is unknown"
        parts.append(where + ("" if why == "ok" else f" ({why})"))
    if result.ended:
        return f"not arrived: {', '.join([result.ended, *parts])}"
    return f"not arrived after {result.seconds:.1f} s: {', '.join(parts)}"


@contextmanager
def _progress() -> Iterator[Callable[[float, str], None]]:
    from .draw import progress

    with progress() as bar:
        task = bar.add_task("", total=1.0)
        yield lambda share, text: bar.update(task, completed=share, description=text)


def _as_json(robot: RobotDriver, result: MotionResult) -> dict[str, object]:
    sent = result.sent
    return {
        "sent": [
            {"name": name, "position_rad": angle, "position_deg": math.degrees(angle)}
            for name, angle in (sent.positions if sent is not None else ())
        ],
        "duration_s": sent.duration if sent is not None else None,
        "torque_switched_on": result.powered,
        "clamped": sent.clamped if sent is not None else (),
        "silent": sent.silent if sent is not None else (),
        "arrived": result.arrived,
        "joints": (None if result.arrived is None else [joint_json(joint, robot.model) for joint in robot.read()]),
    }


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
        told.append(_leg_json(name, report))
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


def _leg_json(name: str, report: MotionReport) -> dict[str, object]:
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
