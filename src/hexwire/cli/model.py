"""`model`: computations with the arm's geometry, without a robot.

Owns the format of angles, poses and reports: degrees, and millimetres, but metres for the PUMA 260. Must not know
the geometry.
"""

from __future__ import annotations

import functools
import math
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from hexwire.errors import ConfigError, LimitError, UsageError
from hexwire.folders import make_folder
from hexwire.inputs import LARGEST_TEXT, Item, parse_json, read_bytes, read_stream, read_text
from hexwire.model.arms import arm_with_geometry, arms_with_geometry
from hexwire.model.geometry import make_kinematics
from hexwire.new_file import OutputFile
from hexwire.units import decimal, plain

from .options import (
    DEFAULT_ROBOT,
    FiniteFloat,
    NumbersCommand,
    early_robot,
    force_option,
    json_option,
    links_option,
    refuse_idle_force,
    unit_of,
)
from .output import Column, RowType, answer, line_width, print_json, say, say_document, say_table, wants_json

if TYPE_CHECKING:
    from hexwire.model.kinematics import KinematicModel, Solution
    from hexwire.model.pose import Vector

__all__ = ["model"]

DEGREES = FiniteFloat("degrees")
_OFF = math.radians(1.0)
"""Radians by which the tool of an arm of five joints may miss a rotation that was typed."""
_MOST = 1e6
"""Millimetres beyond the reach of any arm."""
_ANGLES = "T0 T1 T2 T3 T4 [T5]"


def _robot_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """``--robot``, which may also come before the command."""

    @functools.wraps(command)
    def packed(*args: Any, robot: str | None, **rest: Any) -> Any:
        robot = early_robot(robot) or DEFAULT_ROBOT
        arm_with_geometry(robot)
        return command(*args, robot=robot, **rest)

    known = ", ".join(arms_with_geometry())
    return click.option("--robot", metavar="NAME", help=f"Arm: {known}.  [default: {DEFAULT_ROBOT}]")(packed)


@click.group()
def model() -> None:
    """Compute with the arm's geometry; no robot needed.

    Angles are in degrees, lengths in millimetres, but in metres for the PUMA 260. The 7Bot's angles are its servo
    angles (90 is neutral); those of an SO-100 or SO-101 are its five joint angles, as in LeRobot.
    """


@model.command(cls=NumbersCommand)
@click.argument("angles", nargs=-1, required=True, type=DEGREES, metavar=_ANGLES)
@links_option
@_robot_option
@json_option
def fk(angles: tuple[float, ...], links: str, robot: str) -> None:
    """Compute the tool pose for joint angles: five for an SO-100 or SO-101, otherwise six."""
    arm = make_kinematics(robot, links)
    _check_count(arm, angles)
    report = _pose_report(arm, angles)
    if wants_json():
        print_json(report)
    for key, value in report.items():
        if key == "rotation":
            for name, row in zip(("rotation", "", ""), value, strict=True):
                say(f"{name:12} " + "  ".join(f"{plain(v, 6):>9}" for v in row))
        elif key in {"violations", "near_singularity"}:
            for text in value:
                say(f"{'warning':12} {'near a singularity: ' if key == 'near_singularity' else ''}{text}")
        elif isinstance(value, tuple):
            digits = 5 if key.endswith("_m") else 3
            say(f"{key.replace('_', ' '):12} " + "  ".join(f"{plain(v, digits):>{digits + 6}}" for v in value))
        elif isinstance(value, float):
            say(f"{key.replace('_', ' '):12} {plain(value, 3)}")
        elif isinstance(value, str):
            say(f"{key:12} {value}")


def _check_count(arm: KinematicModel, angles: Sequence[float]) -> None:
    if len(angles) != len(arm.ranges):
        words = " ".join(f"T{i}" for i in range(len(arm.ranges)))
        raise UsageError(f"{words} takes {len(arm.ranges)} values, not {len(angles)}")


def _pose_report(arm: KinematicModel, degrees: Sequence[float]) -> dict[str, Any]:
    from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
    from hexwire.model.arms.puma260.kinematics import Puma260Model
    from hexwire.model.arms.so_arm.kinematics import SoArmModel

    angles = [math.radians(d) for d in degrees]
    pose = arm.forward(angles)
    report: dict[str, Any] = {"robot": arm.name}
    if isinstance(arm, Hex7BotModel):
        k = arm.links
        elbow = k.elbow_angle(angles[1], angles[2])
        report |= {
            "links": k.name,
            "angles_deg": tuple(degrees),
            "wrist_mm": _mm(arm.wrist(angles)),
            "tip_mm": _mm(pose.position),
            "side_mm": _mm(arm.side(pose)),
            "rotation": pose.rotation,
            "elbow_deg": math.degrees(elbow + k.forearm_angle),
            "gate_deg": math.degrees(elbow),
        }
    elif isinstance(arm, Puma260Model):
        report |= {
            "angles_deg": tuple(degrees),
            "wrist_m": arm.wrist(angles),
            "position_m": pose.position,
            "rotation": pose.rotation,
        }
    elif isinstance(arm, SoArmModel):
        report |= {
            "angles_deg": tuple(degrees),
            "wrist_mm": _mm(arm.wrist(angles)),
            "tip_mm": _mm(pose.position),
            "pitch_deg": math.degrees(arm.pitch(angles)),
            "roll_deg": degrees[4],
            "rotation": pose.rotation,
        }
    report["allowed"] = not arm.violations(angles)
    report["violations"] = list(arm.violations(angles))
    report["near_singularity"] = list(arm.singularity(angles).near)
    return report


_SOLUTIONS: RowType[Solution] = RowType(
    Column("angles_deg", get=lambda row: [math.degrees(angle) for angle in row.angles]),
    Column("branch", "branch"),
    Column("allowed"),
    Column("violations", get=lambda row: list(row.violations)),
    Column("singular"),
    Column("", "", text=lambda row: _short(row.violations)),
)


@model.command(cls=NumbersCommand)
@click.argument("place", nargs=-1, metavar="X Y Z | FILE | -")
@click.option(
    "--rotation",
    nargs=9,
    type=FiniteFloat("number"),
    metavar="R11 .. R33",
    help="Rotation matrix of the tool, row by row.",
)
@click.option("--rpy", nargs=3, type=DEGREES, metavar="R P Y", help="The rotation as roll, pitch, yaw in degrees.")
@click.option("--pitch", type=DEGREES, help="SO-100, SO-101: pitch of the tool; 0 is level, 90 straight down.")
@click.option("--roll", type=DEGREES, help="With --pitch: angle of wrist_roll, 0 if not given.")
@click.option("--wrist", is_flag=True, help="7Bot: X Y Z is the wrist centre; without a rotation, only T0 T1 T2.")
@links_option
@_robot_option
@json_option
def ik(
    place: tuple[str, ...],
    rotation: tuple[float, ...] | None,
    rpy: tuple[float, ...] | None,
    pitch: float | None,
    roll: float | None,
    wrist: bool,
    links: str,
    robot: str,
) -> None:
    """Compute all joint angles that put the tool at a pose.

    The pose is X Y Z with --rotation, --rpy or, for an SO-100 or SO-101, --pitch; or the output of
    `hexwire model fk --json` in a file or on standard input (-). Solutions within the limits come
    first. Exit status 2 if there is no solution.
    """
    pose_file = None
    if len(place) == 1:
        pose_file = _read_pose(place[0])
        robot = pose_file["robot"].text() if "robot" in pose_file else robot
        links = pose_file["links"].text() if "links" in pose_file else links
    with _named(place[0] if pose_file is not None else ""):
        arm = make_kinematics(robot, links)
        solutions = _solve(arm, place, _ToolDirection(rotation, rpy, pitch, roll), wrist, pose_file)
    if wants_json():
        print_json({"robot": arm.name, "solutions": [_SOLUTIONS.as_json(row) for row in solutions]})
    names = [r.name for r in arm.ranges][: len(solutions[0].angles)]
    head = (*names, *_SOLUTIONS.titles)
    cells = [(*(plain(math.degrees(a), 4) for a in s.angles), *_SOLUTIONS.cells(s)) for s in solutions]
    if line_width() is not None:
        # A number identifies the parts of a row if the terminal is too narrow for all columns.
        head, cells = ("no", *head), [(str(i), *row) for i, row in enumerate(cells, start=1)]
    say_table(head, cells)


class _ToolDirection(NamedTuple):
    """Where the tool points, as typed; None for what was not."""

    rotation: Sequence[float] | None
    rpy: Sequence[float] | None
    pitch: float | None
    roll: float | None


def _solve(
    arm: KinematicModel,
    place: Sequence[str],
    turn: _ToolDirection,
    wrist: bool,
    pose_file: dict[str, Item] | None,
) -> tuple[Solution, ...]:
    from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
    from hexwire.model.pose import Pose, column, rotation_between, rotation_from_numbers, rotation_from_rpy

    seven = isinstance(arm, Hex7BotModel)
    unit = unit_of(arm.name)
    rotation = turn.rotation
    if pose_file is not None:
        key = "position_m" if unit_of(arm.name) == 1.0 else "tip_mm"
        if key not in pose_file or "rotation" not in pose_file:
            raise UsageError(f"the pose needs {key} (three numbers) and rotation (three rows of three)")
        numbers = pose_file[key].numbers(3, -_MOST, _MOST)
        rotation = [v for row in pose_file["rotation"].rows(3, 3) for v in row.numbers(3, -_MOST, _MOST)]
    else:
        if len(place) != 3:
            raise UsageError(f"a position has three coordinates X Y Z, got {len(place)}")
        numbers = tuple([FiniteFloat("coordinate").convert(text, None, None) for text in place])
    where: Vector = (numbers[0] * unit, numbers[1] * unit, numbers[2] * unit)
    if turn.roll is not None and turn.pitch is None:
        raise UsageError("--roll needs --pitch")
    if turn.pitch is not None and (rotation is not None or turn.rpy is not None):
        raise UsageError("--pitch contradicts the rotation; give only one of them")
    if rotation is not None:
        tool = rotation_from_numbers(rotation)
    elif turn.rpy is not None:
        tool = rotation_from_rpy(*(math.radians(d) for d in turn.rpy))
    elif turn.pitch is not None:
        zero = [0.0] * len(arm.ranges)
        tool = arm.aimed(where, math.radians(turn.pitch), math.radians(turn.roll or 0.0), zero)
    elif wrist and isinstance(arm, Hex7BotModel):
        if not arm.reach_wrist(where).reachable:
            raise LimitError(f"out of reach: {arm.reach_wrist(where).cause}")
        return arm.inverse_wrist(where)
    else:
        more = "; or --wrist for the arm alone" if seven else ", or --pitch" if len(arm.ranges) < 6 else ""
        raise UsageError("a pose needs --rotation or --rpy" + more)
    if wrist:
        if not isinstance(arm, Hex7BotModel):
            raise UsageError("--wrist is for the 7Bot only")
        f, z = arm.links.f, column(tool, 2)
        where = (where[0] + f * z[0], where[1] + f * z[1], where[2] + f * z[2])
    pose = Pose(where, tool)
    solutions = arm.inverse(pose)
    if not solutions:
        raise LimitError(f"out of reach: {arm.reach(pose).cause}")
    off = min(rotation_between(tool, arm.forward(s.angles).rotation)[1] for s in solutions)
    if off > _OFF:
        raise LimitError(
            f"the heading of the tool follows from the position: {arm.name} would miss the rotation by "
            f"{decimal(math.degrees(off))} deg; give --pitch and --roll"
        )
    return solutions


@contextmanager
def _named(file: str) -> Iterator[None]:
    """Add the name of the pose file to usage errors that its contents cause."""
    try:
        yield
    except (ConfigError, LimitError):
        raise
    except UsageError as error:
        if not file:
            raise
        raise ConfigError(str(error), file=file) from None


def _read_pose(name: str) -> dict[str, Item]:
    if name == "-":
        name = "standard input"
        data = read_stream(sys.stdin.buffer, name, largest=LARGEST_TEXT)
    else:
        data = read_bytes(name)
    root = parse_json(data, name)
    if not isinstance(root.value, dict):
        raise UsageError(f"{name} is not a pose: it must be a JSON object as printed by 'hexwire model fk --json'")
    return root.table()


@model.command(cls=NumbersCommand)
@click.argument("angles", nargs=-1, required=True, type=DEGREES, metavar=_ANGLES)
@links_option
@_robot_option
@json_option
def check(angles: tuple[float, ...], links: str, robot: str) -> None:
    """Check joint angles against all limits, and show their distance from singularities.

    Exit status 2 if they are not allowed.
    """
    arm = make_kinematics(robot, links)
    _check_count(arm, angles)
    radians = [math.radians(d) for d in angles]
    found = arm.violations(radians)
    singular = arm.singularity(radians)
    data = {
        "allowed": not found,
        "violations": list(found),
        "singularity": dict(singular.measures),
        "near_singularity": list(singular.near),
        "manipulability_m3": singular.manipulability,
    }
    lines = [
        f"{name:10} {plain(value, 3)}{'  near a singularity' if name in singular.near else ''}"
        for name, value in singular.measures.items()
    ]
    answer(data, *lines, *(() if found else ("allowed",)))
    if found:
        raise LimitError("; ".join(found))


@model.command()
@links_option
@_robot_option
@click.option("-o", "--output", metavar="FILE", help="Write to this file instead of standard output.")
@force_option
def urdf(links: str, robot: str, output: str | None, force: bool) -> None:
    """Write the arm as URDF, from the same constants, with the joints of the driver."""
    from hexwire.model.urdf import make_urdf

    text = make_urdf(make_kinematics(robot, links))
    if output is None:
        refuse_idle_force(force, "the file of --output")
        say_document(text)
    else:
        with OutputFile(output, force=force) as out:
            out.file.write(text.encode())


@model.command("ros2-package")
@click.argument("folder", metavar="DIR")
@click.option(
    "--distribution",
    metavar="NAME",
    help="ROS 2 distribution: humble, jazzy, kilted, lyrical or rolling.  [default: ROS_DISTRO, else jazzy]",
)
@links_option
@_robot_option
@force_option
def ros2_package(folder: str, distribution: str | None, links: str, robot: str, force: bool) -> None:
    """Write a ROS 2 package of the arm to the folder DIR, for a workspace's src/.

    It has the URDF with the tags of ros2_control, controllers, the MoveIt configuration, and launch
    files for the arm alone, under ros2_control, and with MoveIt. No ROS is needed to make it.
    """
    from hexwire.ros2.package import make_package, package_name
    from hexwire.ros2.package.releases import usual_release

    distribution = distribution or usual_release(os.environ)
    files = make_package(robot, links, distribution)
    target = Path(folder)
    name = package_name(robot)
    _refuse_other_package(target, name)
    with ExitStack() as stack:
        # All are opened before any is written: an existing file leaves everything as it was.
        opened = []
        for path, text in files.items():
            make_folder((target / path).parent)
            out = stack.enter_context(OutputFile(target / path, force=force, mode=0o644))
            opened.append((out, text))
        for out, text in opened:
            out.file.write(text.encode())
    say(f"{name} for ROS 2 {distribution.lower()}: {len(files)} files in {folder}")


def _refuse_other_package(folder: Path, name: str) -> None:
    """Refuse to mix two packages in one folder, which --force does not allow either."""
    manifest = folder / "package.xml"
    if manifest.is_file() and f"<name>{name}</name>" not in read_text(manifest):
        raise UsageError(f"{folder} contains another package; choose a folder of its own for {name}")


def _short(violations: Sequence[str]) -> str:
    if not violations:
        return "allowed"
    return violations[0] + (f" (and {len(violations) - 1} more)" if len(violations) > 1 else "")


def _mm(v: Sequence[float]) -> tuple[float, ...]:
    return tuple(1e3 * x for x in v)
