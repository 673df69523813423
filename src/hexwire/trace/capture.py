"""Recordings of all traffic of a command: raw bytes, frames in words, joint states; and reading them back.

Owns the topics of such a recording, reading it and recovering a damaged one; `recording` owns the file. Topics:
``/bytes/sent`` and ``/bytes/received`` hold raw bytes, ``/frames`` holds ``foxglove.Log``, ``/joint_states`` holds
``foxglove.JointStates``, ``/NAME/joint_states`` those of one of several arms.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePath
from typing import IO, TYPE_CHECKING, Any, NamedTuple, Protocol, Self

from hexwire.errors import HexwireError
from hexwire.link.tap import Direction, Passed

from .explain import doubt
from .foxglove import INFO, NSEC, WARNING, log_line
from .line_reader import LineReader
from .mcap_file import MAGIC, Readable, load_mcap, read_records
from .recording import JOINT_STATES, RecordingWriter

if TYPE_CHECKING:
    from hexwire.model.state import JointState

    from .reading import FrameReading

__all__ = [
    "BYTES",
    "FRAMES",
    "MAGIC",
    "Capture",
    "CapturedMessage",
    "Recovered",
    "Writer",
    "read_messages",
    "recover",
    "traffic_of",
]

BYTES = {Direction.SENT: "/bytes/sent", Direction.RECEIVED: "/bytes/received"}
FRAMES = "/frames"


class Writer(Protocol):
    """What writes a recording: `RecordingWriter`, or another format with the same calls."""

    @property
    def count(self) -> int:
        """Messages written."""

    def raw(self, topic: str, stamp: float, data: bytes) -> None:
        """Write raw bytes."""

    def message(self, topic: str, schema: str, stamp: float, body: dict[str, Any]) -> None:
        """Write a JSON message."""

    def joint_state(self, state: JointState, stamp: float, *, topic: str) -> None:
        """Write a joint state."""

    def close(self) -> None:
        """Finish the recording."""

    def discard(self) -> None:
        """Delete the recording."""


class Capture:
    """Records the traffic of links and the joint states of a robot. Any thread may call it.

    A call from a signal handler that interrupts another call in the same thread is refused (HexwireError): it would
    deadlock, and keep a stop off the line.

    Args:
        path: The file, which only its owner can read; or what writes another format.
        offset: Seconds to add to a link's clock for seconds since 1970.
        force: Overwrite an existing file.

    Raises:
        UsageError: The file exists already or cannot be created, or the package ``mcap`` is not installed.
    """

    def __init__(self, path: str | Path | Writer, *, offset: float, force: bool = False) -> None:
        self._writer: Writer = RecordingWriter(path, force=force) if isinstance(path, str | PurePath) else path
        self._lines: dict[str, LineReader] = {}
        self._offset = offset
        self._lock = threading.Lock()
        self._owner = 0
        self._closed = False

    def passed(self, passed: Passed) -> None:
        """Record a transfer, and the frames it completes."""
        with self._exclusive():
            if self._closed:
                return
            stamp = passed.time + self._offset
            self._writer.raw(BYTES[passed.direction], stamp, passed.data)
            for reading in self._lines.setdefault(passed.url, LineReader()).feed(passed):
                self._frame(reading, stamp)

    def joint_state(self, state: JointState, stamp: float, topic: str = JOINT_STATES) -> None:
        """Record a joint state at `stamp`, seconds since 1970; each of several arms has a topic of its own."""
        with self._exclusive():
            if not self._closed:
                self._writer.joint_state(state, stamp, topic=topic)

    def close(self) -> None:
        """Finish the file. Does nothing if it is finished.

        Raises:
            OSError: The end of the file cannot be written.
        """
        with self._exclusive():
            if self._closed:
                return
            self._closed = True
            self._writer.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            self.abandon()
        self.close()

    def abandon(self) -> None:
        """Delete an empty recording, so that the next attempt does not find an existing file."""
        with self._exclusive():
            if not self._closed and not self._writer.count:
                self._closed = True
                self._writer.discard()

    @contextmanager
    def _exclusive(self) -> Iterator[None]:
        if self._owner == threading.get_ident():
            raise HexwireError("a signal arrived while the recording was being written")
        with self._lock:
            self._owner = threading.get_ident()
            try:
                yield
            finally:
                self._owner = 0

    def _frame(self, reading: FrameReading, stamp: float) -> None:
        line = log_line(WARNING if doubt(reading) else INFO, reading.text, reading.way.value, stamp)
        body = line | {"hex": reading.data.hex(" ").upper()}
        self._writer.message(FRAMES, "foxglove.Log", stamp, body)


class CapturedMessage(NamedTuple):
    """One message of a recording.

    Attributes:
        topic: Its channel.
        schema: Name of the schema, empty for bytes.
        encoding: Encoding of the data: json, or application/octet-stream.
        time: Seconds since 1970.
        data: As stored in the file.
    """

    topic: str
    schema: str
    encoding: str
    time: float
    data: bytes


class Recovered(NamedTuple):
    """What `recover` saved: number of messages, and why reading ended (empty if the file was complete)."""

    messages: int
    problem: str


def read_messages(file: IO[bytes], name: str) -> Iterator[CapturedMessage | str]:
    """The messages of a recording in file order, up to the first damage.

    Args:
        file: Open for reading bytes; it need not be seekable.
        name: Name of the file in errors.

    Yields:
        Messages; finally a sentence if the file is truncated or damaged.

    Raises:
        UsageError: It is not a recording, or the package ``mcap`` is not installed.
    """
    for record in read_records(file, name):
        if isinstance(record, str):
            yield record
            continue
        schema, channel, message = record
        yield CapturedMessage(
            channel.topic,
            schema.name if schema else "",
            channel.message_encoding,
            message.log_time / NSEC,
            message.data,
        )


def traffic_of(file: IO[bytes], name: str) -> Iterator[Passed | str]:
    """The transfers of a recording; sentences about the file itself.

    Raises:
        UsageError: As `read_messages`.
    """
    directions = {topic: direction for direction, topic in BYTES.items()}
    for message in read_messages(file, name):
        if isinstance(message, str):
            yield message
        elif message.topic in directions:
            yield Passed(directions[message.topic], message.data, message.time, "")


def recover(source: Readable, name: str, target: IO[bytes]) -> Recovered:
    """Copy the intact part of a recording to a new one that every program can open.

    Args:
        source: The damaged recording.
        name: Its name in errors.
        target: Open for writing bytes.

    Raises:
        UsageError: It is not a recording, or the package ``mcap`` is not installed.
    """
    writer = load_mcap("mcap.writer").Writer(target)
    count, problem = 0, ""
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    started = False
    for record in read_records(source, name):
        if not started:
            writer.start(profile="", library="hexwire")
            started = True
        if isinstance(record, str):
            problem = record
            continue
        schema, channel, message = record
        if schema is not None and schema.id not in schemas:
            schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
        if channel.id not in channels:
            channels[channel.id] = writer.register_channel(
                channel.topic, channel.message_encoding, schemas.get(channel.schema_id, 0), channel.metadata
            )
        writer.add_message(
            channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence
        )
        count += 1
    if not started:
        writer.start(profile="", library="hexwire")
    writer.finish()
    return Recovered(count, problem)
