"""Bags of ROS 2, and what they hold of a recording: joint states, the arm's description, and the traffic.

Owns the folder and its files, made as safely as a recording, topics and their messages. It writes what
`hexwire.trace.recording.RecordingWriter` writes, as messages that every program of ROS 2 knows, and converts a
recording:

    /joint_states           sensor_msgs/msg/JointState          fresh positions and velocities, as of the sample
    /dynamic_joint_states   control_msgs/msg/DynamicJointState  all that is known of each joint, at the state's time
    /robot_description      std_msgs/msg/String                 URDF, for late joiners
    /frames                 rcl_interfaces/msg/Log              frames in words
    /bytes/sent, received   std_msgs/msg/UInt8MultiArray        raw bytes

Efforts stay empty: a servo's load is no torque. `/dynamic_joint_states` has it as ``load``, and ``position``,
``velocity``, ``current``, ``voltage``, ``temperature``, ``goal`` and ``flags`` of each joint as far as known.

Needs the package ``mcap``, imported on first use.
"""

from __future__ import annotations

import math
import re
import stat
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from hexwire.control.loop.known_state import StateFilter
from hexwire.errors import UsageError
from hexwire.inputs import parse_message
from hexwire.model.state import JointState
from hexwire.new_file import OutputFile
from hexwire.trace.capture import BYTES, CapturedMessage, read_messages
from hexwire.trace.foxglove import nanoseconds
from hexwire.trace.mcap_file import NewMcapFile, load_mcap
from hexwire.trace.recording import JOINT_STATES, parse_joints
from zenoh_ros2 import DEFAULT, LATCHED, Qos, Types
from zenoh_ros2.bag import METADATA, PROFILE, BagMessages, mcap_name

from .wire import own_errors

__all__ = ["DYNAMIC", "BagRecording", "BagWriter", "convert", "ros_topic"]

DYNAMIC = "/dynamic_joint_states"
_DESCRIPTION = "/robot_description"
_LOG_LEVELS = {2: 20, 3: 30}
"""Level of ``foxglove.Log`` -> that of ``rcl_interfaces/msg/Log``: info, warning."""
_NSEC = 1_000_000_000
_COLUMNS = ("position", "velocity", "load", "current", "voltage", "temperature")
_LONGEST_LOG = 64 * 1024


class BagWriter(NewMcapFile):
    """Writes a bag; use it as a context manager, or `close` it.

    Args:
        folder: The bag. Only its owner can read the files in it.
        types: The distribution's; its name is stored.
        force: Overwrite an existing bag of this name.

    Attributes:
        folder: The bag.
        count: Messages written.

    Raises:
        UsageError: The folder exists already or cannot be created, or the package ``mcap`` is not installed.
    """

    def __init__(self, folder: str | Path, types: Types, *, force: bool = False) -> None:
        load_mcap("mcap.writer")
        self.folder = Path(folder)
        self._force = force
        file = mcap_name(self.folder)
        self._made = _make_folder(self.folder, {file, METADATA}, force)
        try:
            super().__init__(self.folder / file, PROFILE, force=force)
        except UsageError:
            self._remove_folder()
            raise
        self._messages = BagMessages(self._writer, file, types)

    def write(self, topic: str, message_type: str, message: Any, stamp: int, qos: Qos = DEFAULT) -> None:
        """Write a message; see `zenoh_ros2.bag.BagMessages.write`.

        Raises:
            LocalProtocolError: The message has an unsuitable value.
            OSError: It cannot be written; nor can anything after it.
        """
        with self._writing(), own_errors():
            self._messages.write(topic, message_type, message, stamp, qos)
        self.count += 1

    def close(self) -> None:
        """Finish the bag. Does nothing if it is finished; after a write error, its MCAP file stays truncated.

        Raises:
            OSError: The end cannot be written.
            UsageError: Another program has put a file there meanwhile.
        """
        if self._closed:
            return
        super().close()
        if self._failed is None:
            with OutputFile(self.folder / METADATA, force=self._force) as out:
                out.file.write(self._messages.metadata().encode())

    def discard(self) -> None:
        """Delete the bag. Does nothing if it is finished."""
        if not self._closed:
            super().discard()
            self._remove_folder()

    def _remove_folder(self) -> None:
        if self._made:
            with suppress(OSError):
                self.folder.rmdir()


def _make_folder(folder: Path, files: set[str], force: bool) -> bool:
    """Make the folder of a bag; return whether it is new."""
    if folder.name in ("", ".."):
        raise UsageError(f"{folder} has no name; name a new folder")
    try:
        folder.mkdir()
    except FileExistsError:
        if not stat.S_ISDIR(folder.lstat().st_mode):
            raise UsageError(f"{folder} is not a folder; choose another name") from None
        if not force:
            raise UsageError(f"{folder} already exists; --force overwrites it") from None
        if others := sorted({path.name for path in folder.iterdir()} - files):
            raise UsageError(f"{folder} is not overwritten: it also has {others[0]}") from None
        return False
    except OSError as error:
        raise UsageError(f"{folder} cannot be created: {error.strerror}; choose another place") from None
    return True


class BagRecording:
    """Writes a bag from what a recording is made of; use it in place of a `RecordingWriter`.

    Args:
        folder: The bag.
        types: The distribution's.
        force: Overwrite an existing bag.

    Attributes:
        urdf: The arm's description; it is written with the first joint state. Empty without one.
        urdfs: That of each of several arms, by the topic of its joint states.

    Raises:
        UsageError: As `BagWriter`.
    """

    def __init__(self, folder: str | Path, types: Types, *, force: bool = False) -> None:
        self.urdf = ""
        self.urdfs: dict[str, str] = {}
        self._bag = BagWriter(folder, types, force=force)
        self._types = types
        self._filters: dict[str, StateFilter] = {}
        self._described: set[str] = set()

    @property
    def count(self) -> int:
        """Messages written."""
        return self._bag.count

    def joint_state(
        self,
        state: JointState,
        stamp: float,
        *,
        topic: str = JOINT_STATES,
        goals: Mapping[str, float] | None = None,
        extra: Mapping[str, Any] | None = None,
    ) -> None:
        """Write a joint state, as `RecordingWriter.joint_state`; `extra` has no place in ROS's messages."""
        urdf = self.urdfs.get(topic, self.urdf)
        topic = ros_topic(topic)
        namespace = topic.removesuffix(JOINT_STATES)
        if urdf and namespace not in self._described:
            self._described.add(namespace)
            text = self._types.message("std_msgs/msg/String")(data=urdf)
            self._bag.write(f"{namespace}{_DESCRIPTION}", "std_msgs/msg/String", text, nanoseconds(stamp), LATCHED)
        known = self._filters.setdefault(topic, StateFilter()).take(state)
        if known is not None:
            type_ = self._types.message("sensor_msgs/msg/JointState")
            message = type_(name=list(known.names), position=known.position, velocity=known.velocity)
            self._stamp(message.header, stamp - known.age)
            self._bag.write(topic, type_.name, message, nanoseconds(stamp))
        self._dynamic(state, stamp, namespace + DYNAMIC, goals or {})

    def _dynamic(self, state: JointState, stamp: float, topic: str, goals: Mapping[str, float]) -> None:
        values_type = self._types.message("control_msgs/msg/InterfaceValue")
        columns = [(key, getattr(state, key)) for key in _COLUMNS]
        rows = []
        for i, name in enumerate(state.names):
            values = {key: column[i] for key, column in columns if math.isfinite(column[i])}
            if math.isfinite(goal := goals.get(name, math.nan)):
                values["goal"] = goal
            values["flags"] = float(int(state.flags[i]))
            rows.append(values_type(interface_names=list(values), values=list(values.values())))
        type_ = self._types.message("control_msgs/msg/DynamicJointState")
        message = type_(joint_names=list(state.names), interface_values=rows)
        self._stamp(message.header, stamp)
        self._bag.write(topic, type_.name, message, nanoseconds(stamp))

    def message(self, topic: str, schema: str, stamp: float, body: Mapping[str, Any]) -> None:
        """Write a ``foxglove.Log``; the only schema of a recording, beside joint states, with a place in ROS."""
        if schema != "foxglove.Log":
            raise UsageError(f"a bag has no place for {schema}")
        type_ = self._types.message("rcl_interfaces/msg/Log")
        message = type_(
            level=_LOG_LEVELS.get(body.get("level", 2), 20),
            **{
                field: _text(body.get(key, ""))
                for field, key in (("name", "name"), ("msg", "message"), ("file", "file"))
            },
        )
        self._time(message.stamp, nanoseconds(stamp))
        self._bag.write(ros_topic(topic), type_.name, message, nanoseconds(stamp))

    def raw(self, topic: str, stamp: float, data: bytes) -> None:
        """Write raw bytes."""
        type_ = self._types.message("std_msgs/msg/UInt8MultiArray")
        self._bag.write(ros_topic(topic), type_.name, type_(data=data), nanoseconds(stamp))

    def _stamp(self, header: Any, stamp: float) -> None:
        self._time(header.stamp, nanoseconds(max(0.0, stamp)))

    def _time(self, time: Any, ns: int) -> None:
        # ROS's seconds end in 2038.
        time.sec, time.nanosec = min(ns // _NSEC, 2**31 - 1), ns % _NSEC

    def close(self) -> None:
        """Finish the bag; errors as `BagWriter.close`."""
        self._bag.close()

    def discard(self) -> None:
        """Delete the bag. Does nothing if it is finished."""
        self._bag.discard()


def ros_topic(topic: str) -> str:
    """The name of a topic of a recording in ROS, which allows letters, digits and underscores."""
    parts = [re.sub(r"[^A-Za-z0-9_]", "_", part) for part in topic.split("/") if part]
    return "".join(f"/_{part}" if part[0].isdigit() else f"/{part}" for part in parts)


def convert(file: IO[bytes], name: str, recording: BagRecording, *, note: Callable[[str], None]) -> dict[str, int]:
    """Write the messages of a recording to a bag.

    Args:
        file: The recording, open for reading bytes.
        name: Its name in errors.
        recording: The bag; the caller closes it.
        note: Gets a sentence about damage.

    Returns:
        How many messages of which schema have no place in a bag.

    Raises:
        UsageError: It is not a recording, or has two topics whose names become one.
        ConfigError: A message is wrong; the text says which.
    """
    left_out: dict[str, int] = {}
    topics: dict[str, str] = {}
    for number, message in enumerate(read_messages(file, name), 1):
        if isinstance(message, str):
            note(message)
            continue
        first = topics.setdefault(ros_topic(message.topic), message.topic)
        if first != message.topic:
            raise UsageError(f"{name}: {first} and {message.topic} have the same name in ROS, {ros_topic(first)}")
        if not _convert(message, name, number, recording):
            key = message.schema or message.encoding
            left_out[key] = left_out.get(key, 0) + 1
    return left_out


def _convert(message: CapturedMessage, name: str, number: int, recording: BagRecording) -> bool:
    if message.schema == "foxglove.JointStates" and message.encoding == "json":
        stamp, rows = parse_joints(message.data, name, number)
        values = [{key: item.value for key, item in row.items()} for row in rows]
        time = message.time if stamp is None else stamp
        goals = {row["name"]: _number(row.get("goal")) for row in values}
        recording.joint_state(_state(values, time), time, topic=message.topic, goals=goals)
    elif message.schema == "foxglove.Log" and message.encoding == "json":
        body = parse_message(message.data, name, f"message {number}").table()
        level = body["level"].value if "level" in body else 2
        fields = {key: item.value for key, item in body.items() if key != "level"}
        recording.message(message.topic, "foxglove.Log", message.time, {**fields, "level": 3 if level == 3 else 2})
    elif message.topic in BYTES.values():
        recording.raw(message.topic, message.time, message.data)
    else:
        return False
    return True


def _state(rows: list[dict[str, Any]], time: float) -> JointState:
    columns: dict[str, Any] = {key: tuple(_number(row.get(key)) for row in rows) for key in _COLUMNS}
    ages = (_number(row.get("age")) for row in rows)
    flags = (row.get("flags") for row in rows)
    return JointState(
        names=tuple(row["name"] for row in rows),
        flags=tuple(flag if type(flag) is int and 0 <= flag < 1 << 16 else 0 for flag in flags),
        # A recording leaves out an age of zero.
        age=tuple(age if age >= 0.0 else 0.0 for age in ages),
        stamp=time,
        **columns,
    )


def _text(value: object) -> str:
    """A text that UTF-8 can hold, and no longer than that of any frame."""
    return str(value)[:_LONGEST_LOG].encode("utf-8", "replace").decode()


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
