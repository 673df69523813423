"""Recordings: MCAP files with JSON channels under Foxglove's schema names, which other tools open as they are.

Owns the file, its channels and their schemas. A joint state is a ``foxglove.JointStates`` message on the topic
``/joint_states``; the schema lets further fields in, and what Foxglove has no name for (load, current, voltage,
temperature, flags) is there as well. Must not know who records or plays. Needs the package ``mcap``, imported on
first use.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from hexwire.errors import ConfigError, UsageError
from hexwire.inputs import Item, parse_message
from hexwire.model.state import JointState
from hexwire.new_file import OutputFile

from .mcap_file import load_mcap, read_records

if TYPE_CHECKING:
    from types import TracebackType

__all__ = [
    "JOINT_STATES",
    "RecordedJoints",
    "RecordingWriter",
    "is_joint_state",
    "make_positions",
    "nanoseconds",
    "parse_joints",
    "read_joint_states",
]

JOINT_STATES = "/joint_states"
"""Topic of the joint states."""

_NSEC = 1_000_000_000
_END_OF_TIME = 2**63 / _NSEC
"""Seconds since 1970 at which nanoseconds leave 64 bits: in 2262."""
# Small chunks: a crash loses the chunk that is being written, and no more.
_CHUNK = 64 * 1024

_MOST_JOINTS = 253
_MOST = 1e4
"""Radians that no joint has."""
_TIME = {
    "type": "object",
    "title": "time",
    "properties": {
        "sec": {"type": "integer", "minimum": 0},
        "nsec": {"type": "integer", "minimum": 0, "maximum": _NSEC - 1},
    },
}
_NUMBER = {"type": "number"}
SCHEMAS: dict[str, dict[str, Any]] = {
    "foxglove.JointStates": {
        "title": "foxglove.JointStates",
        "description": "The states of a robot's joints",
        "type": "object",
        "properties": {
            "timestamp": _TIME,
            "joints": {
                "type": "array",
                "items": {
                    "type": "object",
                    "title": "foxglove.JointState",
                    "properties": {
                        "name": {"type": "string"},
                        "position": {**_NUMBER, "description": "radians"},
                        "velocity": {**_NUMBER, "description": "radians per second"},
                        "load": {**_NUMBER, "description": "signed fraction of full drive"},
                        "current": {**_NUMBER, "description": "amperes"},
                        "voltage": {**_NUMBER, "description": "volts"},
                        "temperature": {**_NUMBER, "description": "degrees Celsius"},
                        "flags": {"type": "integer", "description": "condition, as hexwire.model.state.JointFlag"},
                    },
                },
            },
        },
    },
}
SCHEMAS["foxglove.Log"] = {
    "title": "foxglove.Log",
    "description": "A frame on the line, in words",
    "type": "object",
    "properties": {
        "timestamp": _TIME,
        "level": {"type": "integer", "description": "2 info, 3 warning"},
        "message": {"type": "string"},
        "name": {"type": "string", "description": "sent or received"},
        "file": {"type": "string"},
        "line": {"type": "integer"},
        "hex": {"type": "string", "description": "the bytes"},
    },
}
"""JSON schemas by name."""


@dataclass(frozen=True, slots=True)
class RecordedJoints:
    """One joint state of a recording.

    Attributes:
        time: Seconds since 1970.
        names: Joint names.
        position: Radians.
        values: Further values of each joint by their names in the file, as far as they were recorded.
    """

    time: float
    names: tuple[str, ...]
    position: tuple[float, ...]
    values: tuple[dict[str, float], ...]


class RecordingWriter:
    """Writes a recording; use it as a context manager, or `close` it.

    Args:
        path: The file. Only its maker can read it.
        force: Write over one that is there; it stays as it is until the recording is whole.

    Raises:
        UsageError: The file is there already or cannot be made, or the package ``mcap`` is not installed.
    """

    def __init__(self, path: str | Path, *, force: bool = False) -> None:
        writer_module = load_mcap("mcap.writer")
        self._out = OutputFile(path, force=force, partial=True)
        self._closed = False
        self._writer = writer_module.Writer(
            self._out.file, chunk_size=_CHUNK, compression=writer_module.CompressionType.ZSTD
        )
        self._writer.start(profile="", library="hexwire")
        self._channels: dict[str, int] = {}
        self._sequence: dict[str, int] = {}
        self._failed: OSError | None = None
        self.count = 0

    def message(self, topic: str, schema: str, stamp: float, body: dict[str, Any]) -> None:
        """Write a JSON message.

        Args:
            topic: Its channel; made on first use.
            schema: A name of `SCHEMAS`.
            stamp: Seconds since 1970.
            body: What the schema says.
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

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """What fails once fails from then on: behind half a chunk nothing can be read, and it would only grow."""
        if self._failed is not None:
            raise self._failed
        try:
            yield
        except OSError as error:
            self._failed = error
            raise

    def raw(self, topic: str, stamp: float, data: bytes) -> None:
        """Write bytes as they are, without a schema.

        Args:
            topic: Their channel; made on first use.
            stamp: Seconds since 1970.
            data: The bytes.
        """
        with self._writing():
            if topic not in self._channels:
                self._channels[topic] = self._writer.register_channel(
                    topic=topic, message_encoding="application/octet-stream", schema_id=0
                )
            self._add(topic, stamp, data)

    def joint_state(self, state: JointState, stamp: float) -> None:
        """Write a joint state; what is not known (NaN) is left out.

        Args:
            state: The state.
            stamp: Seconds since 1970 at which it was true.
        """
        joints = []
        for i, name in enumerate(state.names):
            joint: dict[str, Any] = {"name": name}
            for key, column in (
                ("position", state.position),
                ("velocity", state.velocity),
                ("load", state.load),
                ("current", state.current),
                ("voltage", state.voltage),
                ("temperature", state.temperature),
            ):
                if math.isfinite(column[i]):
                    joint[key] = column[i]
            joint["flags"] = int(state.flags[i])
            joints.append(joint)
        ns = nanoseconds(stamp)
        body = {"timestamp": {"sec": ns // _NSEC, "nsec": ns % _NSEC}, "joints": joints}
        self.message(JOINT_STATES, "foxglove.JointStates", stamp, body)

    def close(self) -> None:
        """Finish the file. Harmless if it is finished; one that could not be written stays cut off.

        Raises:
            OSError: The end cannot be written.
        """
        if self._closed:
            return
        self._closed = True
        try:
            if self._failed is None:
                self._writer.finish()
        finally:
            # Closing writes what is buffered, and fails again where writing did.
            with suppress(OSError) if self._failed is not None else nullcontext():
                self._out.keep()

    def discard(self) -> None:
        """Take the file away again. Harmless if it is finished."""
        self._closed = True
        self._out.discard()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # An error ends a recording, and what was recorded before it is kept.
        if kind is not None and not self.count:
            self.discard()
        self.close()


def nanoseconds(stamp: float) -> int:
    """Nanoseconds since 1970, as a recording has them.

    Raises:
        UsageError: It is before 1970, not a number, or later than a recording can tell.
    """
    if not 0 <= stamp < _END_OF_TIME:
        raise UsageError(f"a recording has no time {stamp:g} s; it takes seconds since 1970")
    return round(stamp * _NSEC)


def make_positions(names: Sequence[str], position: Sequence[float]) -> JointState:
    """A joint state of which only the positions are known, in radians: for recordings that are made, not read."""
    nan = (math.nan,) * len(names)
    flags, age = (0,) * len(names), (0.0,) * len(names)
    return JointState(
        names=tuple(names),
        position=tuple(position),
        velocity=nan,
        load=nan,
        current=nan,
        voltage=nan,
        temperature=nan,
        flags=flags,
        age=age,
        stamp=0.0,
    )


def read_joint_states(path: str | Path, *, whole: bool = False) -> Iterator[RecordedJoints]:
    """The joint states of a recording, in the order of the file; one that was cut off gives what is whole.

    Also reads files of other programs that have ``foxglove.JointStates`` messages in JSON. A joint without a
    position is left out, and so is a value that is no number.

    Args:
        path: The file.
        whole: Refuse a file that is cut off or damaged, at its end.

    Raises:
        UsageError: It is no recording, or the package ``mcap`` is not installed.
        ConfigError: The file cannot be read, or a joint state is wrong; the text says which, and where in it.
    """
    number = 0
    try:
        if Path(path).exists() and not Path(path).is_file() and not Path(path).is_dir():
            raise ConfigError("is a pipe or a device, not a file", file=str(path))
        with Path(path).open("rb") as file:
            for record in read_records(file, str(path)):
                if isinstance(record, str):
                    if whole:
                        raise ConfigError(f"{record}: save that by 'hexwire record recover'", file=str(path))
                elif is_joint_state(record[0], record[1]):
                    number += 1
                    yield _joints(record[2], str(path), number)
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror or error}", file=str(path)) from None


def is_joint_state(schema: Any, channel: Any) -> bool:
    """Whether messages of a channel are joint states, by the records of `read_records`."""
    return schema is not None and schema.name == "foxglove.JointStates" and channel.message_encoding == "json"


def parse_joints(data: bytes, file: str, number: int) -> tuple[float | None, list[dict[str, Item]]]:
    """The message of a joint state: its own time, and what it says of each joint, with the name checked.

    Raises:
        ConfigError: It is none; the text says where.
    """
    root = parse_message(data, file, f"joint state {number}").table(needed=("joints",))
    stamp = None
    if "timestamp" in root and root["timestamp"].value is not None:
        parts = root["timestamp"].table(needed=("sec", "nsec"))
        stamp = parts["sec"].integer(0, int(_END_OF_TIME)) + parts["nsec"].integer(0, _NSEC - 1) / _NSEC
    joints = [item.table(needed=("name",)) for item in root["joints"].rows(_MOST_JOINTS)]
    names = [joint["name"].text(100, least=1) for joint in joints]
    if len(set(names)) != len(names):
        raise root["joints"].fault("name a joint twice")
    return stamp, joints


def _joints(message: Any, file: str, number: int) -> RecordedJoints:
    stamp, joints = parse_joints(message.data, file, number)
    rows = [joint for joint in joints if "position" in joint and joint["position"].value is not None]
    return RecordedJoints(
        message.log_time / _NSEC if stamp is None else stamp,
        tuple([joint["name"].text() for joint in rows]),
        tuple([joint["position"].number(-_MOST, _MOST, "rad") for joint in rows]),
        tuple([_numbers(joint) for joint in rows]),
    )


def _numbers(joint: dict[str, Item]) -> dict[str, float]:
    values = {key: item.value for key, item in joint.items()}
    return {
        key: float(value)
        for key, value in values.items()
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    }
