"""Everything a command did on the line, as one recording: raw bytes, frames in words, joint states; and back.

Owns the topics of such a recording, how it is read and mended. The file itself is `recording`'s. Topics:
``/bytes/sent`` and ``/bytes/received`` hold bytes as they are, ``/frames`` holds ``foxglove.Log``,
``/joint_states`` holds ``foxglove.JointStates``. Must not know who moves the bytes.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, NamedTuple, Self

from hexwire.errors import HexwireError
from hexwire.link.tap import Direction, Passed

from .explain import Explainer
from .mcap_file import MAGIC, load_mcap, read_records
from .recording import RecordingWriter, nanoseconds

if TYPE_CHECKING:
    from types import TracebackType

    from hexwire.model.state import JointState

    from .explain import Explained

__all__ = ["BYTES", "FRAMES", "MAGIC", "Capture", "Message", "Recovered", "read_messages", "recover", "traffic_of"]

BYTES = {Direction.SENT: "/bytes/sent", Direction.RECEIVED: "/bytes/received"}
FRAMES = "/frames"
_INFO, _WARNING = 2, 3
_NSEC = 1_000_000_000


class Capture:
    """Records what passes over links and what a robot's joints did. Any thread may tell it something.

    What it is told by a signal handler while its thread is telling it something is refused (HexwireError): waiting
    for itself would keep a stop from the line.

    Args:
        path: The file. Only its maker can read it.
        offset: Seconds to add to a link's clock for seconds since 1970.
        force: Write over one that is there.

    Raises:
        UsageError: The file is there already or cannot be made, or the package ``mcap`` is not installed.
    """

    def __init__(self, path: str | Path, *, offset: float, force: bool = False) -> None:
        self._writer = RecordingWriter(path, force=force)
        self._explainers: dict[str, Explainer] = {}
        self._offset = offset
        self._lock = threading.Lock()
        self._owner = 0
        self._closed = False

    def passed(self, passed: Passed) -> None:
        """Record a transfer, and the frames it completes."""
        with self._alone():
            if self._closed:
                return
            stamp = passed.time + self._offset
            self._writer.raw(BYTES[passed.direction], stamp, passed.data)
            for explained in self._explainers.setdefault(passed.url, Explainer()).feed(passed):
                self._frame(explained, stamp)

    def joint_state(self, state: JointState, stamp: float) -> None:
        """Record a joint state at `stamp`, seconds since 1970."""
        with self._alone():
            if not self._closed:
                self._writer.joint_state(state, stamp)

    def close(self) -> None:
        """Finish the file. Harmless if it is finished.

        Raises:
            OSError: The end cannot be written.
        """
        with self._alone():
            if self._closed:
                return
            self._closed = True
            self._writer.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self.abandon()
        self.close()

    def abandon(self) -> None:
        """Take a recording of nothing away again: it would be in the way of the next attempt."""
        with self._alone():
            if not self._closed and not self._writer.count:
                self._closed = True
                self._writer.discard()

    @contextmanager
    def _alone(self) -> Iterator[None]:
        if self._owner == threading.get_ident():
            raise HexwireError("a signal came while the recording was written")
        with self._lock:
            self._owner = threading.get_ident()
            try:
                yield
            finally:
                self._owner = 0

    def _frame(self, explained: Explained, stamp: float) -> None:
        ns = nanoseconds(stamp)
        doubtful = bool(explained.problem) or " ! " in explained.reading
        body = {
            "timestamp": {"sec": ns // _NSEC, "nsec": ns % _NSEC},
            "level": _WARNING if doubtful else _INFO,
            "message": explained.reading,
            "name": explained.direction.value,
            "file": "",
            "line": 0,
            "hex": explained.data.hex(" ").upper(),
        }
        self._writer.message(FRAMES, "foxglove.Log", stamp, body)


class Message(NamedTuple):
    """One message of a recording.

    Attributes:
        topic: Its channel.
        schema: Name of the schema, empty for bytes.
        encoding: Of the data: json, or application/octet-stream.
        time: Seconds since 1970.
        data: As it stands in the file.
    """

    topic: str
    schema: str
    encoding: str
    time: float
    data: bytes


class Recovered(NamedTuple):
    """What `recover` saved: messages, and why reading ended (empty if the file was whole)."""

    messages: int
    problem: str


def read_messages(file: IO[bytes], name: str) -> Iterator[Message | str]:
    """The messages of a recording in the order of the file, as far as it is whole.

    Args:
        file: Open for reading bytes; it need not be seekable.
        name: What to call it in an error.

    Yields:
        Messages; at last a sentence if the file is cut off or damaged.

    Raises:
        UsageError: It is no recording, or the package ``mcap`` is not installed.
    """
    for record in read_records(file, name):
        if isinstance(record, str):
            yield record
            continue
        schema, channel, message = record
        yield Message(
            channel.topic,
            schema.name if schema else "",
            channel.message_encoding,
            message.log_time / _NSEC,
            message.data,
        )


def traffic_of(file: IO[bytes], name: str) -> Iterator[Passed | str]:
    """The transfers of a recording; sentences about the file itself.

    Raises:
        UsageError: As `read_messages`.
    """
    ways = {topic: direction for direction, topic in BYTES.items()}
    for message in read_messages(file, name):
        if isinstance(message, str):
            yield message
        elif message.topic in ways:
            yield Passed(ways[message.topic], message.data, message.time, "")


def recover(source: IO[bytes], name: str, target: IO[bytes]) -> Recovered:
    """Write what is whole of a recording to a new one that every program opens.

    Args:
        source: The damaged recording.
        name: What to call it in an error.
        target: Open for writing bytes.

    Raises:
        UsageError: It is no recording, or the package ``mcap`` is not installed.
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
