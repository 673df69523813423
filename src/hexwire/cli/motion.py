"""`move`, `goto`, `line`, `play` and `teach`: motions to angles and poses, and recordings.

Owns how a user types a motion: targets, places, names of saved poses, where the tool is to point, and their units.
Must not know how a motion is planned, checked or run, nor what is told of it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from hexwire.errors import UsageError
from hexwire.model.aim import Aim
from hexwire.model.geometry import make_kinematics
from hexwire.units import decimal

from .exits import note, shielded
from .options import (
    FiniteFloat,
    NumbersCommand,
    RobotOptions,
    arm_option,
    attached,
    confirm,
    force_option,
    host_timed_option,
    is_number,
    is_typed,
    json_option,
    links_option,
    make_robot_with,
    number_option,
    on_terminal,
    open_robot,
    parse_opening,
    refuse_idle_force,
    refuse_idle_table,
    robot_options,
    table_options,
    unit_of,
)
from .output import answer, wants_json
from .plot import open_picture

if TYPE_CHECKING:
    from hexwire.arm.verbs import Arm
    from hexwire.control.motion.motion_result import MotionResult
    from hexwire.control.motion.via import Place
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.arm import ArmModel
    from hexwire.model.kinematics import KinematicModel
    from hexwire.model.pose import Vector
    from hexwire.motion.teach import Taught
    from hexwire.motion.trajectory import Trajectory
    from hexwire.new_file import OutputFile

    from .verbs import RunOptions

__all__ = [
    "Point",
    "goto",
    "line",
    "move",
    "parse_targets",
    "play",
    "points_argument",
    "points_words",
    "pose_options",
    "teach",
    "to_points",
]

_GRACE = 2.0
"""Seconds after the duration of the move in which the joints must arrive: servos settle, and lag under load."""
_INSIDE = 3.0
"""No tip comes that near to the middle of its base, millimetres: somebody has given metres."""

Point = tuple[float, float, float] | str
"""A place as typed, or the name of a pose."""

_F = TypeVar("_F", bound=Callable[..., Any])
_METAVAR = "{X Y Z | POSE}..."


def points_argument(command: _F) -> _F:
    """The argument ``points``: places of three numbers, and names of poses; the command gets a list of `Point`."""

    def parse(ctx: click.Context, param: click.Parameter, words: tuple[str, ...]) -> list[Point]:
        points: list[Point] = []
        numbers: list[float] = []
        kind = FiniteFloat("coordinate")
        for word in words:
            if not numbers and not is_number(word):
                points.append(word)
                continue
            numbers.append(kind.convert(word, param, ctx))
            if len(numbers) == 3:
                points.append((numbers[0], numbers[1], numbers[2]))
                numbers = []
        if numbers:
            typed = len(numbers) + 3 * sum(not isinstance(point, str) for point in points)
            raise click.UsageError(f"X Y Z takes 3 values, not {typed}", ctx)
        return points

    return click.argument("points", nargs=-1, required=True, metavar=_METAVAR, callback=parse)(command)


def pose_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """``--down``, ``--pitch``, ``--roll`` and ``--rpy``, which the command gets as ``aim``; and ``--relative``."""

    def given(
        *args: Any,
        down: bool,
        rpy: Vector | None,
        pitch: float | None,
        roll: float | None,
        **rest: Any,
    ) -> Any:
        turns = None if rpy is None else (math.radians(rpy[0]), math.radians(rpy[1]), math.radians(rpy[2]))
        tilt, turn = (None if angle is None else math.radians(angle) for angle in (pitch, roll))
        return command(*args, aim=Aim(down, turns, tilt, turn), **rest)

    packed: Callable[..., Any] = functools.wraps(command)(given)
    for option in (
        click.option(
            "--relative", is_flag=True, help="X Y Z is relative to the tip's position, or the point before."
        ),
        click.option(
            "--rpy",
            nargs=3,
            type=FiniteFloat("degrees"),
            metavar="R P Y",
            help="Roll, pitch and yaw of the tool in degrees.",
        ),
        number_option("--roll", "DEG", "With --pitch: angle of wrist_roll. If not given, it stays."),
        number_option("--pitch", "DEG", "SO-100, SO-101: pitch of the tool; 0 is level, 90 straight down."),
        click.option("--down", is_flag=True, help="The tool points straight down."),
    ):
        packed = option(packed)
    return packed


_grip_option = click.option(
    "--grip",
    metavar="open|close|PERCENT",
    help="Open or close the gripper meanwhile.",
    callback=lambda ctx, param, text: None if text is None else parse_opening(text),
)


def to_points(points: Sequence[Point], model: KinematicModel | None, aim: Aim, relative: bool) -> list[Place | str]:
    """The places in metres and radians; the poses by name.

    Args:
        points: As typed.
        model: Kinematics; None only without a place.
        aim: Where the tool is to point at places.
        relative: Places count from the point before them.

    Raises:
        UsageError: The arm does not support the aim, or a place is in metres.
    """
    from hexwire.control.motion.via import Place

    if model is not None:
        aim.check(model, "--")
    elif aim.given:
        raise UsageError("the tool of an arm without a geometry cannot be aimed")
    unit = unit_of("" if model is None else model.name)
    for point in points:
        if unit == 1e-3 and not relative and not isinstance(point, str) and max(map(abs, point)) < _INSIDE:
            typed = " ".join(decimal(value) for value in point)
            raise UsageError(f"a place is in millimetres, and {typed} mm is inside the base of the arm")
    return [
        point if isinstance(point, str)
        else Place((point[0] * unit, point[1] * unit, point[2] * unit), aim, relative=relative)
        for point in points
    ]  # fmt: skip


def points_words(
    points: Sequence[Point],
    model: KinematicModel | None,
    relative: bool,
    start: Mapping[str, float],
    wanted: Sequence[Place | str],
    poses: Mapping[str, Mapping[str, float]],
) -> str:
    """The points for people: places from the base, also where they were typed as relative.

    Args:
        points: As typed.
        model: Kinematics, for the unit; None without places.
        relative: As typed.
        start: Radians by joint.
        wanted: The points as `to_points` returned them.
        poses: The poses among them.
    """
    from hexwire.control.motion.via import tip_poses

    unit = unit_of("" if model is None else model.name)
    if relative and model is not None:
        ends = [poses[point] if isinstance(point, str) else point for point in wanted]
        tips = [pose.position for pose in tip_poses(model, start, ends)]
        there = [(x / unit, y / unit, z / unit) for x, y, z in tips]
        points = [point if isinstance(point, str) else place for point, place in zip(points, there, strict=True)]
    name = "mm" if unit == 1e-3 else "m"
    return ", ".join(
        point if isinstance(point, str) else " ".join(map(decimal, point)) + f" {name}" for point in points
    )


def _motion_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """``--table``, ``--plot``, ``--dry-run`` and ``--rate``; the command gets them as ``run: RunOptions``."""

    @functools.wraps(command)
    def given(
        *args: Any,
        table: float | None,
        plot: str | None,
        dry_run: bool,
        rate: float | None,
        host_timed: bool,
        let_finish: bool,
        **rest: Any,
    ) -> Any:
        from .verbs import RunOptions

        # Before the robot is opened, so that the arm does not move if the picture cannot be written.
        with _picture(plot, rest["force"], rest.get("save")) as picture:
            if "save" not in rest:
                del rest["force"]
            run = RunOptions(table, picture, dry_run, rate, host_timed, let_finish)
            return command(*args, run=run, **rest)

    packed = json_option(force_option(given))
    for option in (
        number_option("--rate", "HZ", "Cycles per second (20; 1.5 with a board of dialect 1).", above=0),
        click.option(
            "--let-finish", is_flag=True, help="Let the board finish the motion even if this program falls silent."
        ),
        host_timed_option,
        click.option("--dry-run", is_flag=True, help="Check the path (and draw it with --plot), but move nothing."),
        click.option("--plot", metavar="FILE", help="Draw joints and path as .png, .svg or .pdf."),
    ):
        packed = option(packed)
    return table_options(packed)


@contextmanager
def _picture(plot: str | None, force: bool, save: str | None) -> Iterator[OutputFile | None]:
    if plot is None:
        if save is None:
            refuse_idle_force(force, "the file of --plot")
        yield None
        return
    with open_picture(plot, force=force) as picture:
        yield picture


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
    help="Send one target, to which each servo goes by itself, even if the board can execute trajectories.",
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
    from hexwire.arm.front import Front
    from hexwire.arm.plans import joint_angles
    from hexwire.arm.verbs import Arm
    from hexwire.control.motion import motions

    from .verbs import MoveTeller, hold_on_ctrl_c, progress_bar

    angles = parse_targets([word for word in targets if "=" in word])
    robot = make_robot_with(links, options)
    poses = known_poses(robot.model, [word for word in targets if "=" not in word], "JOINT=DEGREES")
    angles += [pair for pose in poses.values() for pair in pose.items()]
    goal = joint_angles(robot.model, angles, within=True)
    refuse_idle_table(robot)
    how = motions.MotionOptions(tolerance=math.radians(tolerance), grace=_GRACE, host_timed=host_timed)
    with ExitStack() as drawn:
        told = MoveTeller(robot, drawn)
        if wait and on_terminal() and not wants_json():
            told.show = drawn.enter_context(progress_bar())
        with attached(robot), hold_on_ctrl_c(robot):
            Arm(robot, table=table, front=Front(told, how)).send(goal, duration=duration, wait=wait)


def parse_targets(words: Sequence[str]) -> list[tuple[str, float]]:
    """Parse targets such as ``J1=10``; returns pairs of name and radians.

    Raises:
        UsageError: A target is wrong; the text lists all of them on one line.
    """
    targets, wrong = [], []
    for word in words:
        name, equals, text = word.partition("=")
        try:
            angle = float(text)
        except ValueError:
            angle = math.nan
        if not name or not equals or not math.isfinite(angle):
            wrong.append(repr(word))
        targets.append((name, math.radians(angle)))
    if wrong:
        raise UsageError(f"{', '.join(wrong)}: write a target as JOINT=DEGREES, for example J1=10 J3=-5.5")
    return targets


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
    from hexwire.control.requests.pose_file import PoseFile, find_pose

    known = PoseFile(arm).known()
    return {name: find_pose(arm, known, name, instead) for name in names}


@click.command(cls=NumbersCommand)
@points_argument
@pose_options
@_grip_option
@number_option("--speed", "PERCENT", "Percentage of the joints' speed limits.", above=0, default=50.0)
@links_option
@_motion_options
@robot_options
def goto(
    points: Sequence[Point],
    aim: Aim,
    relative: bool,
    grip: float | None,
    speed: float,
    links: str,
    run: RunOptions,
    options: RobotOptions,
) -> None:
    """Move the tool tip to X Y Z on the fastest path: millimetres, but metres for the PUMA 260.

    Several points are passed without a stop: places, and poses: home, which is the middle of every joint but the
    gripper, or one saved by name (`hexwire studio`). For example: `hexwire goto 0 220 200 60 180 120 home`. With
    --relative, each place counts from the point before it.

    Without --down, --rpy or --pitch, the tool keeps its direction relative to the arm. Five joints reach a
    position, a pitch and a roll; the heading of an SO-100 or SO-101 follows from the position.
    """
    robot = make_robot_with(links, options)
    places = any(not isinstance(point, str) for point in points)
    model = _geometry_of(robot) if places else robot.kinematics
    _run_through(
        "goto",
        robot,
        points,
        model,
        aim,
        relative,
        run,
        lambda arm, wanted: arm.goto(*wanted, speed=min(1.0, speed / 100), grip=grip),
    )


@click.command(cls=NumbersCommand)
@points_argument
@pose_options
@_grip_option
@number_option("--speed", "MM/S", "Speed of the tip.", above=0, default=50.0)
@number_option(
    "--round",
    "MM",
    "Of several lines: how far from a corner the tip may leave them; 0 stops there.",
    minimum=0,
    default=10.0,
    dest="rounding",
)
@links_option
@_motion_options
@robot_options
def line(
    points: Sequence[Point],
    aim: Aim,
    relative: bool,
    grip: float | None,
    speed: float,
    rounding: float,
    links: str,
    run: RunOptions,
    options: RobotOptions,
) -> None:
    """Move the tool tip to X Y Z on a straight line: millimetres, but metres for the PUMA 260.

    Several points are joined by lines; the tip passes their corners without a stop, and rounds them.

    Without --down, --rpy or --pitch, the tool keeps its direction in space. That of an SO-100 or SO-101 turns with
    the base unless it points straight down; its pitch stays.
    """
    from hexwire.arm.plans import FARTHEST

    robot = make_robot_with(links, options)
    # More has no effect; the verb takes it for a mistake.
    tip, rounded = min(speed / 1000, FARTHEST), min(rounding / 1000, FARTHEST)
    _run_through(
        "line to",
        robot,
        points,
        _geometry_of(robot),
        replace(aim, fixed=True),
        relative,
        run,
        lambda arm, wanted: arm.line(*wanted, tip_speed=tip, rounding=rounded, grip=grip),
    )


def _run_through(
    words: str,
    robot: RobotDriver,
    points: Sequence[Point],
    model: KinematicModel | None,
    aim: Aim,
    relative: bool,
    run: RunOptions,
    call: Callable[[Arm, list[Place | str]], MotionResult],
) -> None:
    """Call a verb that takes points."""
    from .verbs import run_verb

    poses = known_poses(robot.model, [word for word in points if isinstance(word, str)])
    wanted = to_points(points, model, aim, relative)

    def title(start: Mapping[str, float]) -> str:
        return f"{words} {points_words(points, model, relative, start, wanted, poses)}"

    run_verb(robot, run, title, lambda arm: call(arm, wanted))


@click.command()
@click.argument("file", metavar="FILE")
@number_option("--speed", "FACTOR", "2 plays twice as fast.", above=0, default=1.0)
@number_option("--from", "SECONDS", "Start time.", minimum=0, default=0.0, dest="begin")
@number_option("--to", "SECONDS", "End time.", above=0, dest="end")
@number_option("--smooth", "SECONDS", "Remove tremor shorter than this.", minimum=0, default=0.0)
@click.option("--trim", is_flag=True, help="Remove pauses at both ends.")
@click.option("--fit", is_flag=True, help="If it is too fast for the limits, play it at the speed that fits.")
@click.option(
    "--repeat", type=click.IntRange(min=1), default=1, show_default=True, metavar="N", help="Number of times."
)
@click.option(
    "--fastest", is_flag=True, help="Pass waypoints as fast as the joints' limits allow, not at their times."
)
@click.option("--step", type=click.IntRange(min=1), default=1, metavar="N", help="Begin a program with this step.")
@arm_option
@click.option("--save", metavar="FILE.mcap", help="Write the edited recording, and move nothing.")
@links_option
@_motion_options
@robot_options
def play(
    file: str,
    speed: float,
    begin: float,
    end: float | None,
    smooth: float,
    trim: bool,
    fit: bool,
    repeat: int,
    fastest: bool,
    step: int,
    arm: str | None,
    save: str | None,
    force: bool,
    links: str,
    run: RunOptions,
    options: RobotOptions,
) -> None:
    """Play a recording (.mcap), waypoints (.json in the format of ROS's JointTrajectory), or a program (.toml).

    The arm first moves slowly to the start of the motion. A program is checked as a whole before it begins. With
    --fastest, waypoints need no times, and --speed is a share of the speed limits.
    """
    from hexwire.control.requests.program import is_program
    from hexwire.inputs import LARGEST_DATA, read_bytes
    from hexwire.motion.teach import Edits, Taught
    from hexwire.motion.through import arm_path
    from hexwire.motion.trajectory import Scaled
    from hexwire.motion.waypoint_file import parse_points, parse_waypoints

    from .verbs import run_program, run_verb

    if is_program(file):
        for name in ("speed", "begin", "end", "smooth", "trim", "fit", "fastest", "arm", "save"):
            if is_typed(name):
                option = {"begin": "from", "end": "to"}.get(name, name)
                raise UsageError(f"--{option} is for motions; a program (.toml) has its own")
        run_program(make_robot_with(links, options), run, file, step, repeat)
        return
    if is_typed("step"):
        raise UsageError("--step is for programs (.toml)")
    if fit and (fastest or save is not None):
        raise UsageError("--fit is for what an arm plays at times of its own: leave out --fastest and --save")
    motion: Taught | Trajectory | None = None
    names: tuple[str, ...] = ()
    points: Sequence[Sequence[float]] = ()
    if file.lower().endswith(".json"):
        if begin or end is not None or smooth or trim or arm is not None:
            raise UsageError("--from, --to, --smooth, --trim and --arm are for recordings; edit the waypoints")
        if save is not None:
            raise UsageError("--save is for recordings; edit the file of waypoints instead")
        content = read_bytes(file, largest=LARGEST_DATA)
        if fastest:
            names, points = parse_points(content, file)
        else:
            motion = parse_waypoints(content, file)
            names = Scaled(motion, speed).names
    elif fastest:
        raise UsageError("--fastest is for waypoints; a recording has its own times, --speed changes them")
    else:
        from hexwire.arm.recorded import read_taught

        last = math.inf if end is None else end
        motion = read_taught(file, arm).edited(Edits(begin, last, trim, smooth))
        if save is not None:
            _save(motion.faster(speed), file, save, force)
            return
        names = motion.faster(speed).trajectory().names
    robot = make_robot_with(links, options)
    unknown = [name for name in names if name not in robot.model.names]
    if unknown:
        raise UsageError(
            f"{file} moves {', '.join(unknown)}; {robot.model.name} has {', '.join(robot.model.names)}"
        )
    if isinstance(motion, Taught) and motion.within(robot.model) != motion:
        note("a joint that rested on its stop goes to its limit instead, just before the stop")
    factor = speed
    if motion is None:
        motion, factor = arm_path(robot.model, names, points, speed=min(1.0, speed)), 1.0
    played = motion
    run_verb(
        robot,
        run,
        lambda start: f"play {Path(file).name}",
        lambda arm: arm.play(played, factor=factor, fit=fit, repeat=repeat),
    )


@click.command()
@click.argument("file", metavar="FILE.mcap")
@number_option("--rate", "HZ", "States per second (20; 1.5 with dialect 1).", above=0)
@number_option("--duration", "SECONDS", "End after this time; otherwise Ctrl-C ends it.", above=0)
@click.option("--limp", is_flag=True, help="Leave torque off at the end; otherwise the arm holds its position.")
@click.option("--yes", is_flag=True, help="Do not ask whether somebody holds the arm.")
@force_option
@robot_options
@json_option
def teach(
    file: str,
    rate: float | None,
    duration: float | None,
    limp: bool,
    yes: bool,
    force: bool,
    options: RobotOptions,
) -> None:
    """Record the motion of an arm that is guided by hand, for `hexwire play`.

    Torque is switched off, so the arm sinks unless somebody holds it.
    """
    from hexwire.arm.front import Front
    from hexwire.arm.verbs import Arm
    from hexwire.trace.recording import RecordingWriter, check_recording_name

    check_recording_name(file)
    with RecordingWriter(file, force=force) as recording:
        try:
            with open_robot(options) as robot:
                confirm(
                    "Torque is switched off and the arm sinks. Do you hold it?",
                    yes,
                    alone="the arm sinks when torque is switched off: hold it, and confirm with --yes",
                )
                seconds = math.inf if duration is None else duration
                lesson = Arm(robot, front=Front()).teach(recording, rate=rate or 0.0, seconds=seconds, limp=limp)
                note("recording; Ctrl-C ends it" if duration is None else f"recording for {duration:g} s")
                with suppress(KeyboardInterrupt):
                    lesson.wait()
                with shielded():
                    lesson.end()
        except BaseException:
            if recording.count:
                note(f"{recording.count} states are kept in {file}")
            raise
    words = f"{recording.count} states in {file}" + ("" if limp else "; the arm holds")
    answer({"states": recording.count, "file": file, "holds": not limp}, words)


def _geometry_of(robot: RobotDriver) -> KinematicModel:
    return robot.kinematics or make_kinematics(robot.model.name)


def _save(taught: Taught, file: str, save: str, force: bool) -> None:
    from hexwire.arm.recorded import write_taught
    from hexwire.trace.recording import check_recording_name

    check_recording_name(save)
    if Path(save).exists() and Path(save).samefile(file):
        raise UsageError(f"--save {save} would overwrite its source")
    states = write_taught(taught, save, force=force)
    data = {"states": states, "duration_s": taught.duration, "file": save}
    answer(data, f"{states} states, {taught.duration:.2f} s in {save}")
