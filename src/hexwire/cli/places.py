"""`tip`, `limits` and `poses`: where the tool is, how far the joints go, and the poses that have a name.

Owns their presentation. Must not know where poses are kept, nor how an arm gets to one.
"""

from __future__ import annotations

import math

import click

from hexwire.errors import UsageError
from hexwire.units import decimal, plain

from .model import make_robot_with, unit_of
from .options import (
    RobotOptions,
    attached,
    json_option,
    links_option,
    make_robot,
    refuse_idle_force,
    robot_options,
)
from .output import answer, print_json, say, say_table

__all__ = ["limits", "poses", "tip"]


@click.command()
@links_option
@robot_options
@json_option
def tip(links: str, options: RobotOptions, as_json: bool) -> None:
    """Show where the tip of the tool is, and where the tool points, in the units and angles of `hexwire goto`."""
    from hexwire.arm.verbs import Arm

    robot = make_robot_with(links, options)
    with attached(robot):
        found = Arm(robot).tip
    rpy = [math.degrees(angle) for angle in found.rpy]
    tilt = None if found.pitch_roll is None else [math.degrees(angle) for angle in found.pitch_roll]
    unit = unit_of(robot.model.name)
    name, digits = ("mm", 1) if unit == 1e-3 else ("m", 4)
    place = " ".join(plain(value / unit, digits) for value in found.position)
    aim = "rpy " + " ".join(plain(angle, 1) for angle in rpy)
    if tilt is not None:
        aim = f"pitch {plain(tilt[0], 1)}, roll {plain(tilt[1], 1)}"
    data = {"position_m": found.position, "rpy_deg": rpy, "pitch_roll_deg": tilt}
    answer(as_json, data, f"{place} {name}, {aim} deg")


@click.command()
@robot_options
@json_option
def limits(options: RobotOptions, as_json: bool) -> None:
    """Show how far and how fast each joint may move."""
    from hexwire.arm.verbs import Arm

    joints = Arm(make_robot(options)).limits
    rows = {
        name: {
            "minimum_deg": math.degrees(joint.minimum),
            "maximum_deg": math.degrees(joint.maximum),
            "speed_deg_per_s": math.degrees(joint.max_speed),
            "acceleration_deg_per_s2": math.degrees(joint.max_acceleration),
        }
        for name, joint in joints.items()
    }
    if as_json:
        print_json([{"name": name} | row for name, row in rows.items()])
    else:
        cells = [(name, *(plain(value, 1) for value in row.values())) for name, row in rows.items()]
        say_table(("joint", "from deg", "to deg", "deg/s", "deg/s2"), cells)


@click.command()
@click.option("--save", metavar="NAME", help="Save where the joints are now.")
@click.option("--delete", metavar="NAME", help="Delete a pose.")
@click.option("--force", is_flag=True, help="With --save, replace a pose of that name.")
@robot_options
@json_option
def poses(save: str | None, delete: str | None, force: bool, options: RobotOptions, as_json: bool) -> None:
    """List the poses of this kind of arm, to which `hexwire move` and `goto` go by name; save or delete one."""
    from hexwire.arm.verbs import Arm
    from hexwire.control.requests.pose_file import PoseFile, check_pose_name, refuse_taken

    if save is not None and delete is not None:
        raise UsageError("--save and --delete contradict each other")
    if save is None:
        refuse_idle_force(force, "a pose of --save")
    robot = make_robot(options)
    arm = Arm(robot)
    if save is not None:
        refuse_taken(check_pose_name(save), () if force else arm.poses, "--force replaces it")
        with attached(robot):
            arm.poses.save(save, force=force)
    elif delete is not None:
        PoseFile(robot.model).remove(delete)
    degrees = {name: {joint: math.degrees(a) for joint, a in arm.poses[name].items()} for name in arm.poses}
    if as_json:
        print_json(degrees)
        return
    for name, angles in degrees.items():
        say(f"{name}: " + " ".join(f"{joint}={decimal(angle)}" for joint, angle in angles.items()))
