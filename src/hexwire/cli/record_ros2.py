"""`--record-ros2` on any command, and `hexwire record ros2`: recordings as bags of ROS 2.

Owns arguments, printing, and which arm's description a bag gets. `hexwire.ros2` owns the contents of a bag.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, BinaryIO

import click

from hexwire.errors import UsageError
from hexwire.model.geometry import ROBOTS, make_kinematics

from .common import force_option, json_option
from .exits import note
from .input_file import InputFile, name_of
from .output import answer
from .recording import capturing, topic_for

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.ros2.bag_recording import BagRecording

__all__ = ["bag_recording", "ros2"]


@contextmanager
def bag_recording(folder: str, *, force: bool, optional: bool = False) -> Iterator[None]:
    """In this context, traffic and joint states are recorded in a bag of ROS 2.

    Arguments and errors are those of `hexwire.cli.recording.recording`. The bag gets the URDF of each robot
    whose states are read, if it has a geometry.
    """
    from hexwire.ros2.bag_recording import BagRecording
    from hexwire.ros2.rmw.types import Types

    made: list[BagRecording] = []

    def make_writer() -> BagRecording:
        made.append(BagRecording(folder, Types(), force=force))
        return made[0]

    def observe(robot: RobotDriver) -> None:
        topic = topic_for(robot)
        if topic not in made[0].urdfs:
            made[0].urdfs[topic] = _urdf_of(robot)

    with capturing(folder, make_writer, optional=optional, observe=observe):
        yield


def _urdf_of(robot: RobotDriver) -> str:
    from hexwire.model.urdf import make_urdf

    return "" if robot.kinematics is None else make_urdf(robot.kinematics)


@click.command()
@click.argument("file", type=InputFile())
@click.argument("folder")
@click.option("--robot", metavar="NAME", help=f"Arm whose URDF the bag gets: {', '.join(ROBOTS)}.")
@force_option
@json_option
def ros2(file: BinaryIO, folder: str, robot: str | None, force: bool, as_json: bool) -> None:
    """Convert FILE to FOLDER, a bag of ROS 2.

    `ros2 bag` plays FOLDER; Foxglove and PlotJuggler open the MCAP file in it.
    """
    from hexwire.model.urdf import make_urdf
    from hexwire.ros2.bag_recording import BagRecording, convert
    from hexwire.ros2.rmw.types import Types

    robot = robot or click.get_current_context().find_root().params.get("robot")
    if robot is not None and robot not in ROBOTS:
        raise UsageError(f"no geometry is known for {robot!r}; choose one of {', '.join(ROBOTS)}")
    urdf = "" if robot is None else make_urdf(make_kinematics(robot))
    recording = BagRecording(folder, Types(), force=force)
    recording.urdf = urdf
    try:
        left_out = convert(file, name_of(file), recording, note=note)
    except BaseException:
        recording.discard()
        raise
    recording.close()
    for schema, count in sorted(left_out.items()):
        note(f"left out: {count} messages of {schema}, which has no counterpart in ROS 2")
    words = f"{recording.count} messages written to {folder}"
    answer(as_json, {"count": recording.count, "folder": folder, "left_out": left_out}, words)
