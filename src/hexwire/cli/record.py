"""Recordings: `--record` and `--record-ros2` of any command, and `record`, which inspects and converts them.

Owns arguments and printing, the relation of the wall clock to the links' clock, which arm's description a bag gets,
and what happens if a recording fails. `hexwire.trace` and `hexwire.ros2` own the contents.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, TextIO
from weakref import WeakKeyDictionary

import click

from hexwire.errors import UsageError
from hexwire.inputs import open_file, parse_message
from hexwire.link.base import Link
from hexwire.link.tap import Direction, Missed, Passed, TapLink, wrap_new_links
from hexwire.model.arms import arms_with_geometry
from hexwire.model.geometry import make_kinematics
from hexwire.new_file import OutputFile

from .exits import note, tell_missed
from .options import InputFile, arm_option, early_robot, force_option, json_option, name_of, observing_states
from .output import Column, RowType, answer, print_json, say, say_document, wants_json
from .sim import link_option, serve_device, tcp_option

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.state import JointState
    from hexwire.ros2.bag import BagRecording
    from hexwire.trace.capture import Writer

__all__ = ["bag_recording", "capturing", "record", "record_as", "ros2", "topic_for"]

_arms: WeakKeyDictionary[RobotDriver, str] = WeakKeyDictionary()
"""Names of the robots that have a topic of their own."""


def record_as(robot: RobotDriver, arm: str) -> None:
    """Record the states of a robot on a topic of their own: a command with several arms names each."""
    _arms[robot] = arm


def topic_for(robot: RobotDriver) -> str:
    """The topic of a robot's states in a recording."""
    from hexwire.trace.recording import JOINT_STATES, topic_of

    arm = _arms.get(robot)
    return JOINT_STATES if arm is None else topic_of(arm)


@contextmanager
def capturing(
    path: str,
    make_writer: Callable[[], Writer] | None = None,
    *,
    force: bool = False,
    optional: bool = False,
    observe: Callable[[RobotDriver], object] = lambda _: None,
) -> Iterator[None]:
    """In this context, traffic and joint states are recorded.

    A recording that cannot be started is an error before anything happens. Later write errors are counted and
    reported at the end, in one line; the command continues.

    Args:
        path: The file, or the name in messages of another format.
        make_writer: Makes what writes another format.
        force: Overwrite an existing file.
        optional: Continue without a recording: a stop must not fail because a disk is full.
        observe: Gets the robot, before each of its states is recorded.

    Raises:
        UsageError: The file cannot be created, or the package for recordings is not installed.
    """
    from hexwire.trace.capture import Capture

    missed = Missed()
    try:
        capture = Capture(
            path if make_writer is None else make_writer(), offset=time.time() - time.monotonic(), force=force
        )
    except (OSError, UsageError) as error:
        if not optional:
            raise
        missed.add(error)
        try:
            yield
        finally:
            tell_missed(f"the recording {path}", missed)
        return

    def state(robot: RobotDriver, joints: JointState) -> None:
        observe(robot)
        capture.joint_state(joints, time.time(), topic_for(robot))

    def tap(link: Link) -> Link:
        return TapLink(link, missed.guard(capture.passed))

    try:
        with wrap_new_links(tap), observing_states(missed.guard(state)):
            yield
    except BaseException:
        missed.guard(capture.abandon)()
        raise
    finally:
        missed.guard(capture.close)()
        tell_missed(f"the recording {path}", missed)


_MOST_REPLAYED = 64 * 1024 * 1024
"""Largest number of bytes of traffic for a replayed board."""
_MOST_DRAWN = 7_000_000
"""Largest number of angles in a plot."""
_COLUMNS = ("position", "velocity", "load", "current", "voltage", "temperature", "flags")


@click.group()
def record() -> None:
    """Inspect, convert and repair recordings (MCAP).

    `hexwire --record FILE.mcap ...` records any command.
    """


_TOPICS: RowType[tuple[str, str, int]] = RowType(
    Column("topic", "topic", itemgetter(0)),
    Column("schema", "schema", itemgetter(1)),
    Column("messages", "messages", itemgetter(2)),
)


@record.command()
@click.argument("file", type=InputFile())
@json_option
def info(file: BinaryIO) -> None:
    """Show the contents of FILE: topics, messages, times, and whether it is complete."""
    from hexwire.trace.capture import read_messages

    counts: dict[tuple[str, str], int] = {}
    first, last = float("inf"), float("-inf")
    remarks = []
    for message in read_messages(file, name_of(file)):
        if isinstance(message, str):
            remarks.append(message)
            continue
        key = (message.topic, message.schema or message.encoding)
        counts[key] = counts.get(key, 0) + 1
        first, last = min(first, message.time), max(last, message.time)
    rows = [(*key, count) for key, count in sorted(counts.items())]
    if wants_json():
        topics = [_TOPICS.as_json(row) for row in rows]
        print_json({"topics": topics, "first": first, "last": last, "remarks": remarks})
        return
    _TOPICS.show(rows)
    if rows:
        say(f"{last - first:.3f} s, from {first:.6f}")
    for remark in remarks:
        say(f"! {remark}")


@record.command()
@click.argument("file", type=InputFile())
@click.argument("target")
@arm_option
@force_option
@json_option
def export(file: BinaryIO, target: str, arm: str | None, force: bool) -> None:
    """Convert FILE to TARGET, whose name gives the format: .csv, .jsonl or .pcapng.

    CSV has the joint states, one row each; JSON lines has every message; pcapng has the traffic, for Wireshark.
    """
    form = Path(target).suffix
    if form not in (".csv", ".jsonl", ".pcapng"):
        raise UsageError(f"{target}: the name must end in .csv, .jsonl or .pcapng")
    if arm is not None and form != ".csv":
        raise UsageError(f"--arm selects states for .csv; {target} has all arms")
    with OutputFile(target, force=force) as out:
        if form == ".pcapng":
            count = _pcapng(file, name_of(file), out.file)
        else:
            text = io.TextIOWrapper(out.file, encoding="utf-8", newline="")
            count = _csv(file, name_of(file), text, arm) if form == ".csv" else _jsonl(file, name_of(file), text)
            text.detach()
    words = f"{count} {'states' if form == '.csv' else 'messages'} written to {target}"
    answer({"count": count, "file": target}, words)


@record.command()
@click.argument("file", type=click.Path(exists=True, dir_okay=False))
@click.argument("target")
@force_option
@json_option
def recover(file: str, target: str, force: bool) -> None:
    """Save the intact part of FILE, truncated by a crash, as TARGET."""
    from hexwire.trace.capture import recover as save

    if os.path.realpath(file) == os.path.realpath(target):
        raise UsageError("give the recovered recording another name; the damaged file is not changed")
    with open_file(file) as source, OutputFile(target, force=force) as out:
        saved = save(source, file, out.file)
    data = {"count": saved.messages, "file": target, "problem": saved.problem or None}
    answer(data, f"{saved.messages} messages saved to {target}")
    if saved.problem:
        note(saved.problem)


@record.command()
@click.argument("file", type=click.Path(exists=True, dir_okay=False))
@click.argument("picture")
@arm_option
@force_option
@json_option
def plot(file: str, picture: str, arm: str | None, force: bool) -> None:
    """Plot the joint states of FILE to PICTURE (.png, .svg or .pdf): angle over time."""
    from hexwire.trace.recording import read_joint_states, topic_of

    from .plot import MotionPlot, open_picture

    with open_picture(picture, force=force) as out:
        drawn, begin = MotionPlot((), title=Path(file).name), 0.0
        for state in read_joint_states(file, topic=None if arm is None else topic_of(arm)):
            if not drawn.planned:
                drawn.names, begin = state.names, state.time
            if state.names == drawn.names:
                drawn.planned.append((state.time - begin, state.position))
            if len(drawn.planned) * len(drawn.names) > _MOST_DRAWN:
                raise UsageError(f"{file} has more than {_MOST_DRAWN} angles: too many for a plot")
        if not drawn.planned:
            raise UsageError(f"{file} has no joint states" + (f" of {arm}" if arm is not None else ""))
        drawn.draw(out)
    words = f"{len(drawn.planned)} states plotted to {picture}"
    answer({"count": len(drawn.planned), "file": picture}, words)


@record.command()
@click.argument("file", type=InputFile())
@link_option
@click.option(
    "--baud",
    type=click.IntRange(min=0),
    default=0,
    metavar="N|0",
    help="Simulate this line rate; 0 means no delay.",
)
@tcp_option
def replay(file: BinaryIO, link: str | None, baud: int, tcp: str | None) -> None:
    """Emulate the board in FILE with its recorded answers: prints the port to open, and runs until stopped.

    Use it for a fault that was recorded elsewhere: programs get exactly the recorded answers, without the arm. To
    move an arm along the joint states of FILE, use `hexwire play FILE`.
    """
    from hexwire.emulator.replay import RecordedTransfer, ReplayedBoard
    from hexwire.trace.capture import traffic_of

    def transfers() -> Iterator[RecordedTransfer]:
        total = 0
        for item in traffic_of(file, name_of(file)):
            if isinstance(item, str):
                note(item)
                continue
            total += len(item.data)
            if total > _MOST_REPLAYED:
                raise UsageError(f"{name_of(file)} has more than {_MOST_REPLAYED >> 20} MiB of traffic to replay")
            yield RecordedTransfer(item.direction is Direction.SENT, item.data, item.time)

    device = ReplayedBoard(transfers(), start=time.monotonic())
    note(f"{device.known} different requests will be answered")
    serve_device(device, tcp=tcp, link=link, baud=baud, stop=lambda: False, announce=say_document)


def _pcapng(data: BinaryIO, name: str, out: BinaryIO) -> int:
    from hexwire.trace.capture import traffic_of
    from hexwire.trace.pcap import write_pcapng

    def transfers() -> Iterator[Passed]:
        for item in traffic_of(data, name):
            if isinstance(item, str):
                note(item)
            else:
                yield item

    return write_pcapng(out, transfers(), name="hexwire")


def _jsonl(data: BinaryIO, name: str, out: TextIO) -> int:
    from hexwire.trace.capture import read_messages

    count = 0
    for message in read_messages(data, name):
        if isinstance(message, str):
            note(message)
            continue
        row = {"time": message.time, "topic": message.topic, "schema": message.schema}
        if message.encoding == "json":
            item = parse_message(message.data, name, f"message {count + 1}")
            try:
                row["message"] = _finite_or_null(item.value)
            except RecursionError:
                raise item.fault("is nested too deeply") from None
        else:
            row["hex"] = message.data.hex(" ").upper()
        out.write(json.dumps(row, allow_nan=False) + "\n")
        count += 1
    return count


def _csv(data: BinaryIO, name: str, out: TextIO, arm: str | None) -> int:
    from hexwire.trace.capture import read_messages
    from hexwire.trace.recording import parse_joints, several_arms, topic_of

    writer, count, columns = csv.writer(out), 0, list[tuple[str, str]]()
    only = None if arm is None else topic_of(arm)
    for message in read_messages(data, name):
        if isinstance(message, str):
            note(message)
        elif message.schema == "foxglove.JointStates" and message.encoding == "json":
            if arm is not None and message.topic != only:
                continue
            only = only or message.topic
            if message.topic != only:
                raise several_arms(name, only, message.topic)
            _, rows = parse_joints(message.data, name, count + 1)
            joints = {joint["name"].value: {key: item.value for key, item in joint.items()} for joint in rows}
            if not columns:
                columns = [(joint, key) for joint in joints for key in _COLUMNS]
                writer.writerow(["time", *(f"{joint}.{key}" for joint, key in columns)])
            cells = [_cell(joints.get(joint, {}).get(key)) for joint, key in columns]
            writer.writerow([f"{message.time:.9f}", *cells])
            count += 1
    if arm is not None and not count:
        raise UsageError(f"{name} has no joint states of {arm}")
    return count


def _cell(value: object) -> object:
    return value if isinstance(value, int | float) and math.isfinite(value) else ""


def _finite_or_null(value: object) -> object:
    """A value for JSON, which has no NaN and no infinity."""
    if isinstance(value, dict):
        return {key: _finite_or_null(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite_or_null(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@contextmanager
def bag_recording(folder: str, *, force: bool, optional: bool = False) -> Iterator[None]:
    """In this context, traffic and joint states are recorded in a bag of ROS 2.

    Arguments and errors are those of `capturing`. The bag gets the URDF of each robot
    whose states are read, if it has a geometry.
    """
    from hexwire.ros2.bag import BagRecording
    from zenoh_ros2 import Types

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


@record.command()
@click.argument("file", type=InputFile())
@click.argument("folder")
@click.option("--robot", metavar="NAME", help=f"Arm whose URDF the bag gets: {', '.join(arms_with_geometry())}.")
@force_option
@json_option
def ros2(file: BinaryIO, folder: str, robot: str | None, force: bool) -> None:
    """Convert FILE to FOLDER, a bag of ROS 2.

    `ros2 bag` plays FOLDER; Foxglove and PlotJuggler open the MCAP file in it.
    """
    from hexwire.model.urdf import make_urdf
    from hexwire.ros2.bag import BagRecording, convert
    from zenoh_ros2 import Types

    robot = early_robot(robot)
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
    answer({"count": recording.count, "folder": folder, "left_out": left_out}, words)
