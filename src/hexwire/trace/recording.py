"""Recordings: MCAP files with JSON channels under Foxglove's schema names, which other tools can open.

Owns the file and its channels. A joint state is a ``foxglove.JointStates`` message on the topic ``/joint_states``.
Needs the package ``mcap``, imported on first use.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

from hexwire.errors import ConfigError, UsageError
from hexwire.inputs import Item, open_file, parse_message
from hexwire.model.state import JointState

from .foxglove import (
    END_OF_TIME,
    NSEC,
    SCHEMAS,
    compressed_image,
    joint_states,
    nanoseconds,
    picture_topic,
)
from .mcap_file import NewMcapFile, Readable, read_records

__all__ = [
    "JOINT_STATES",
    "RecordedJoints",
    "RecordingWriter",
    "arm_of",
    "check_recording_name",
    "is_joint_state",
    "joint_states_in",
    "parse_joints",
    "read_joint_states",
    "several_arms",
    "topic_of",
    "wall_time",
]

JOINT_STATES = "/joint_states"
"""Topic of the joint states."""

_MOST_JOINTS = 253
_MOST = 1e4
"""Greatest plausible joint position, radians."""
_NUMBERS = (float, int)


@dataclass(frozen=True, slots=True)
class RecordedJoints:
    """One joint state of a recording.

    Attributes:
        time: Seconds since 1970.
        names: Joint names.
        position: Radians.
        values: Other recorded values of each joint, by their names in the file.
        topic: Its channel; an arm has one of its own in the recording of a fleet.
    """

    time: float
    names: tuple[str, ...]
    position: tuple[float, ...]
    values: tuple[dict[str, float], ...]
    topic: str = JOINT_STATES


class RecordingWriter(NewMcapFile):
    """Writes a recording; see `NewMcapFile`.

    Args:
        path: The file. Only its owner can read it.
        force: Overwrite an existing file; it is unchanged until the recording is complete.
    """

    def __init__(self, path: str | Path, *, force: bool = False) -> None:
        super().__init__(path, "", force=force)
        self._channels: dict[str, int] = {}
        self._sequence: dict[str, int] = {}

    def message(self, topic: str, schema: str, stamp: float, body: dict[str, Any]) -> None:
        """Write a JSON message.

        Args:
            topic: Its channel; created on first use.
            schema: A name in `SCHEMAS`.
            stamp: Seconds since 1970.
            body: Fields of the schema.
        """
        data = json.dumps(body, separators=(",", ":"), allow_nan=False).encode()
        with self._writing():
            if topic not in self._channels:
                schema_id = self._writer.register_schema(
                    name=schema, encoding="jsonschema", data=json.dumps(SCHEMAS[schema]).encode()
                )
                self._channels[topic] = self._writer.register_channel(
                    topic=topic, message_encoding="json", schema_id=schema_id
                )
            self._add(topic, stamp, data)

    def _add(self, topic: str, stamp: float, data: bytes) -> None:
        ns = nanoseconds(stamp)
        sequence = self._sequence[topic] = self._sequence.get(topic, 0) + 1
        self._writer.add_message(
            channel_id=self._channels[topic],
            log_time=ns,
            publish_time=ns,
            sequence=sequence & 0xFFFFFFFF,
            data=data,
        )
        self.count += 1

    def raw(self, topic: str, stamp: float, data: bytes) -> None:
        """Write raw bytes, without a schema.

        Args:
            topic: Their channel; created on first use.
            stamp: Seconds since 1970.
            data: The bytes.
        """
        with self._writing():
            if topic not in self._channels:
                self._channels[topic] = self._writer.register_channel(
                    topic=topic, message_encoding="application/octet-stream", schema_id=0
                )
            self._add(topic, stamp, data)

    def joint_state(
        self,
        state: JointState,
        stamp: float,
        *,
        topic: str = JOINT_STATES,
        goals: Mapping[str, float] | None = None,
        extra: Mapping[str, Any] | None = None,
    ) -> None:
        """Write a joint state; unknown values (NaN) are omitted.

        Args:
            state: The state.
            stamp: Time of the state, seconds since 1970.
            topic: Its channel: one for each arm.
            goals: Positions that were sent last, by joint, radians.
            extra: Further fields, by name.
        """
        body = joint_states(state, stamp, goals) | dict(extra or {})
        self.message(topic, "foxglove.JointStates", stamp, body)

    def picture(self, jpeg: bytes, camera: str, stamp: float) -> None:
        """Write a picture.

        Args:
            jpeg: A whole JPEG.
            camera: Name of its camera, which is that of its channel, too.
            stamp: When it was taken, seconds since 1970.
        """
        body = compressed_image(jpeg, camera, stamp)
        self.message(picture_topic(camera), "foxglove.CompressedImage", stamp, body)


def check_recording_name(file: str | Path) -> None:
    """Refuse a name for a new recording that other programs would not open.

    Raises:
        UsageError: It does not end in ``.mcap``.
    """
    if Path(file).suffix.lower() != ".mcap":
        raise UsageError(f"{file}: the name of a recording must end in .mcap")


def wall_time(state: JointState) -> float:
    """The time of a state of this computer, which its clock has stamped, as seconds of the time of day."""
    return time.time() - (time.monotonic() - state.stamp)


def read_joint_states(
    path: str | Path, *, whole: bool = False, topic: str | None = None, several: bool = False
) -> Iterator[RecordedJoints]:
    """The joint states of a recording in file order; of a truncated one, those before the cut.

    Also reads files of other programs that have ``foxglove.JointStates`` messages in JSON. Joints without a
    position and values that are not numbers are omitted.

    Args:
        path: The file.
        whole: Refuse a truncated or damaged file, once its intact part is read.
        topic: Only those of this channel.
        several: Those of several arms; otherwise a file that has them is refused.

    Raises:
        UsageError: It is not a recording, or the package ``mcap`` is not installed.
        ConfigError: The file cannot be read, or a joint state is wrong; the text says which, and where in it.
    """
    try:
        with open_file(path) as file:
            for state in joint_states_in(file, str(path), topic=topic, several=several):
                if not isinstance(state, str):
                    yield state
                elif whole:
                    raise ConfigError(f"{state}: recover it with 'hexwire record recover'", file=str(path))
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror or error}", file=str(path)) from None


def joint_states_in(
    file: Readable, name: str, *, topic: str | None = None, several: bool = False
) -> Iterator[RecordedJoints | str]:
    """As `read_joint_states`, of an open file; finally a sentence if it is truncated or damaged.

    Raises:
        UsageError: As `read_joint_states`.
        ConfigError: A joint state is wrong.
    """
    number, only = 0, topic
    known: dict[str, tuple[str, ...]] = {}
    for record in read_records(file, name):
        if isinstance(record, str):
            yield record
        elif is_joint_state(record[0], record[1]):
            found = record[1].topic
            if topic is not None and found != topic:
                continue
            if only is None:
                only = found
            if found != only and not several:
                raise several_arms(name, only, found)
            number += 1
            item = parse_message(record[2].data, name, f"joint state {number}")
            joints = _quick(item.value, known.get(found, ()), record[2].log_time, found)
            if joints is None:
                joints = _joints(item, record[2].log_time, found)
                known[found] = joints.names
            yield joints


def is_joint_state(schema: Any, channel: Any) -> bool:
    """Whether a schema and channel of `read_records` are those of joint states."""
    return schema is not None and schema.name == "foxglove.JointStates" and channel.message_encoding == "json"


def parse_joints(data: bytes, file: str, number: int) -> tuple[float | None, list[dict[str, Item]]]:
    """Parse a joint state: its own time, if it has one, and the fields of each joint, with checked names.

    Raises:
        ConfigError: It is not a joint state; the text says where.
    """
    return _checked(parse_message(data, file, f"joint state {number}"))


def _checked(item: Item) -> tuple[float | None, list[dict[str, Item]]]:
    root = item.table(("joints",))
    stamp = None
    if "timestamp" in root and root["timestamp"].value is not None:
        parts = root["timestamp"].table(("sec", "nsec"))
        stamp = parts["sec"].integer(0, int(END_OF_TIME)) + parts["nsec"].integer(0, NSEC - 1) / NSEC
    joints = [item.table(("name",)) for item in root["joints"].rows(_MOST_JOINTS)]
    names = [joint["name"].text(100, least=1) for joint in joints]
    if len(set(names)) != len(names):
        raise root["joints"].fault("name a joint twice")
    return stamp, joints


def several_arms(file: str, first: str, second: str) -> UsageError:
    """The error for a recording of several arms where one is needed."""
    return UsageError(
        f"{file} has the states of several arms ({arm_of(first)}, {arm_of(second)}, ...): choose one with --arm"
    )


def arm_of(topic: str) -> str:
    """Name of the arm whose joint states a channel has; empty if it has no name."""
    return topic.removesuffix(JOINT_STATES).removeprefix("/")


def topic_of(arm: str) -> str:
    """Channel of the joint states of an arm in the recording of a fleet."""
    return f"/{arm}{JOINT_STATES}"


def _joints(item: Item, log_time: int, topic: str) -> RecordedJoints:
    stamp, joints = _checked(item)
    rows = [joint for joint in joints if "position" in joint and joint["position"].value is not None]
    return RecordedJoints(
        log_time / NSEC if stamp is None else stamp,
        tuple([joint["name"].text() for joint in rows]),
        tuple([joint["position"].number(-_MOST, _MOST, "rad") for joint in rows]),
        tuple([_numbers(joint) for joint in rows]),
        topic,
    )


def _quick(root: Any, names: tuple[str, ...], log_time: int, topic: str) -> RecordedJoints | None:
    """A joint state of exactly these joints, whose names are checked; None if `_joints` must look at it.

    An hour has 360,000 states that are alike: this takes a third of the time.
    """
    joints = root.get("joints") if type(root) is dict else None
    if type(joints) is not list or not names or len(joints) != len(names):
        return None
    stamp = root.get("timestamp")
    time = log_time / NSEC
    if stamp is not None:
        sec, nsec = (stamp.get("sec"), stamp.get("nsec")) if type(stamp) is dict else (None, None)
        if type(sec) is not int or type(nsec) is not int:
            return None
        if not (0 <= sec <= int(END_OF_TIME) and 0 <= nsec < NSEC):
            return None
        time = sec + nsec / NSEC
    positions, rows = [], []
    for name, joint in zip(names, joints, strict=True):
        if type(joint) is not dict or joint.get("name") != name:
            return None
        position: Any = joint.get("position")
        if type(position) not in _NUMBERS or not -_MOST <= position <= _MOST:
            return None
        positions.append(float(position))
        rows.append({key: float(v) for key, v in joint.items() if type(v) in _NUMBERS and isfinite(v)})
    return RecordedJoints(time, names, tuple(positions), tuple(rows), topic)


def _numbers(joint: dict[str, Item]) -> dict[str, float]:
    values = {key: item.value for key, item in joint.items()}
    return {
        key: float(value)
        for key, value in values.items()
        if isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)
    }
