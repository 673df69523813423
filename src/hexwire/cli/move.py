"""`move`: joints to angles and poses.

Owns how a user types a target. Must not know how a motion is checked or run, nor what is told of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING

import click

from hexwire.errors import UsageError

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

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel

__all__ = ["known_poses", "move", "parse_targets"]

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
    help="Send one target, to which each servo goes by itself, even if the board can keep the time.",
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
        told = MoveTeller(robot, as_json, drawn)
        if wait and on_terminal() and not as_json:
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
