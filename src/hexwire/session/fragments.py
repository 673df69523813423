"""Bodies that do not fit a frame: split into chunks, assembled again, with missing chunks requested again.

Owns both ends of PROTOCOL.md's FRAGMENT and FRAGMENT_MISSING, bounded in size, number and time. The receiver pulls:
it confirms a window by requesting the next one, so a slow receiver or a lossy link limits the rate. No I/O; time
comes in as `now`. Knows nothing of frames or links.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import islice

from hexwire.errors import LocalProtocolError, RemoteProtocolError
from hexwire.wire import tables
from hexwire.wire.commands import FRAGMENT_HEAD_SIZE, FragmentHead, parse_missing, serialize_missing

__all__ = ["WINDOW", "FragmentReceiver", "FragmentSender", "Message"]

WINDOW = 16
"""Chunks sent before the receiver must request more. 16 chunks of 8 kB fit a default UDP receive buffer."""

ASK_AGAIN = 0.1
"""Seconds of silence after which a receiver requests the missing chunks."""


@dataclass(frozen=True, slots=True)
class Message:
    """An assembled body."""

    message_id: int
    cmd: int
    cmd_ext: int
    body: bytes


@dataclass(slots=True)
class _Outgoing:
    cmd: int
    cmd_ext: int
    chunks: list[bytes]
    deadline: float


@dataclass(slots=True)
class _Incoming:
    cmd: int
    cmd_ext: int
    count: int
    last_rx: float
    asked_at: float
    window_end: int
    first_missing: int = 0
    chunk_size: int = 0
    size: int = 0
    chunks: dict[int, bytes] = field(default_factory=dict)


class FragmentSender:
    """Splits bodies and keeps them until the peer has received them.

    Args:
        chunk_size: Bytes of the body in each fragment.
        lifetime: Seconds without a request of the peer after which a message is dropped.
        first: Chunks sent before the receiver asks for more. A controller board takes them one after the other, and
            gets the first alone.
    """

    def __init__(self, chunk_size: int, lifetime: float = tables.FRAGMENT_LIFETIME, *, first: int = WINDOW) -> None:
        self._chunk_size = chunk_size
        self._lifetime = lifetime
        self._first = first
        self._out: dict[int, _Outgoing] = {}
        self.expired = 0

    def send(self, message_id: int, cmd: int, cmd_ext: int, body: bytes, now: float) -> Iterator[bytes]:
        """Start a message; yields the FRAGMENT bodies that are sent unasked.

        Raises:
            LocalProtocolError: It is larger than a receiver accepts, or too many messages are unfinished.
        """
        if len(body) > tables.FRAGMENT_MAX_BYTES:
            raise LocalProtocolError(
                f"a body of {len(body)} bytes is too long for fragments; at most {tables.FRAGMENT_MAX_BYTES}"
            )
        self.handle_timeout(now)
        if len(self._out) >= tables.FRAGMENT_MESSAGES and message_id not in self._out:
            raise LocalProtocolError(f"{len(self._out)} fragmented messages are unfinished; wait for one to finish")
        size = self._chunk_size
        chunks = [body[i : i + size] for i in range(0, len(body), size)] or [b""]
        if len(chunks) > 0xFFFF:
            raise LocalProtocolError(f"a body of {len(chunks)} chunks is too long; at most 65535")
        self._out[message_id] = _Outgoing(cmd, cmd_ext, chunks, now + self._lifetime)
        return self._bodies(message_id, range(min(self._first, len(chunks))))

    def remind(self, message_id: int, cmd: int, cmd_ext: int, body: bytes, now: float) -> Iterator[bytes]:
        """Send the first chunk again.

        A receiver that missed the whole window then requests the rest; one that has all chunks confirms again.
        """
        if message_id not in self._out and len(self._out) < tables.FRAGMENT_MESSAGES:
            self.send(message_id, cmd, cmd_ext, body, now)
        return self._bodies(message_id, (0,) if message_id in self._out else ())

    def forget(self, message_id: int) -> None:
        """Drop a message; later requests for its chunks are not answered."""
        self._out.pop(message_id, None)

    def receive_missing(self, body: bytes, now: float) -> Iterator[bytes]:
        """Process a FRAGMENT_MISSING body; yields the FRAGMENT bodies requested.

        Raises:
            RemoteProtocolError: The body is malformed.
        """
        message_id, indexes = parse_missing(body)
        message = self._out.get(message_id)
        if message is None:
            return iter(())
        if not indexes:
            del self._out[message_id]
            return iter(())
        message.deadline = now + self._lifetime
        # At most one window per answer; the peer requests the rest again.
        return self._bodies(message_id, [i for i in indexes if i < len(message.chunks)][:WINDOW])

    def next_timeout(self) -> float | None:
        """Time at which to call `handle_timeout`, or None."""
        if not self._out:
            return None
        return min(m.deadline for m in self._out.values())

    def handle_timeout(self, now: float) -> None:
        """Drop messages of which the peer no longer requests chunks."""
        for message_id in [i for i, m in self._out.items() if m.deadline <= now]:
            del self._out[message_id]
            self.expired += 1

    def _bodies(self, message_id: int, indexes: Iterable[int]) -> Iterator[bytes]:
        for index in indexes:
            message = self._out[message_id]
            count = len(message.chunks)
            head = FragmentHead(message_id, index, count, message.cmd, message.cmd_ext)
            yield head.serialize() + message.chunks[index]


class FragmentReceiver:
    """Assembles messages; bounded in number, size and time.

    Attributes:
        expired: Messages dropped because the peer fell silent.
        refused: Fragments that fit no message, or would exceed a bound.
        duplicates: Chunks received before.
    """

    def __init__(self, lifetime: float = tables.FRAGMENT_LIFETIME) -> None:
        self._lifetime = lifetime
        self._in: dict[int, _Incoming] = {}
        self._done: dict[int, float] = {}
        self.expired = 0
        self.refused = 0
        self.duplicates = 0

    def receive(self, body: bytes, now: float) -> tuple[Message | None, list[bytes]]:
        """Process a FRAGMENT body.

        Returns:
            The message if it is complete, and the FRAGMENT_MISSING bodies to send back.

        Raises:
            RemoteProtocolError: The body is malformed, or exceeds a bound.
        """
        head = FragmentHead.parse(body)
        chunk = body[FRAGMENT_HEAD_SIZE:]
        if self.is_done(head.message_id, now):
            # Our confirmation was lost: confirm again.
            self.duplicates += 1
            return None, [serialize_missing(head.message_id, ())]
        message = self._in.get(head.message_id)
        if message is None or (message.cmd, message.cmd_ext, message.count) != (
            head.cmd,
            head.cmd_ext,
            head.chunks,
        ):
            message = self._start(head, now)
        if head.number in message.chunks:
            self.duplicates += 1
            return None, []
        self._check_size(message, head, chunk)
        message.chunks[head.number] = chunk
        message.size += len(chunk)
        message.last_rx = now
        if len(message.chunks) == message.count:
            del self._in[head.message_id]
            self._forget_done(now)
            self._done.pop(head.message_id, None)
            self._done[head.message_id] = now
            whole = b"".join(message.chunks[i] for i in range(message.count))
            return Message(head.message_id, head.cmd, head.cmd_ext, whole), [serialize_missing(head.message_id, ())]
        if head.number == message.window_end - 1:
            return None, [self._ask(head.message_id, message, now)]
        return None, []

    def is_done(self, message_id: int, now: float) -> bool:
        """Whether a message was assembled within its lifetime."""
        done = self._done.get(message_id)
        return done is not None and done + self._lifetime > now

    def forget(self) -> None:
        """Drop all messages, complete or not: a restarted peer may use their numbers again."""
        self._in.clear()
        self._done.clear()

    def next_timeout(self) -> float | None:
        """Time at which to call `handle_timeout`, or None."""
        if not self._in:
            return None
        return min(
            min(max(m.last_rx, m.asked_at) + ASK_AGAIN, m.last_rx + self._lifetime) for m in self._in.values()
        )

    def handle_timeout(self, now: float) -> list[bytes]:
        """Request missing chunks again, and drop messages that were silent too long; returns bodies to send."""
        asks = []
        for message_id, message in list(self._in.items()):
            if now >= message.last_rx + self._lifetime:
                del self._in[message_id]
                self.expired += 1
            elif now >= max(message.last_rx, message.asked_at) + ASK_AGAIN:
                asks.append(self._ask(message_id, message, now))
        self._forget_done(now)
        return asks

    def _forget_done(self, now: float) -> None:
        # Entries are in order of completion, so only dropped ones cost time.
        while self._done:
            message_id, done = next(iter(self._done.items()))
            if done + self._lifetime > now:
                break
            del self._done[message_id]

    def _start(self, head: FragmentHead, now: float) -> _Incoming:
        if head.message_id not in self._in and len(self._in) >= tables.FRAGMENT_MESSAGES:
            self.refused += 1
            raise RemoteProtocolError(f"more than {tables.FRAGMENT_MESSAGES} fragmented messages at the same time")
        message = _Incoming(head.cmd, head.cmd_ext, head.chunks, now, now, min(WINDOW, head.chunks))
        self._in[head.message_id] = message
        return message

    def _check_size(self, message: _Incoming, head: FragmentHead, chunk: bytes) -> None:
        if head.number < head.chunks - 1:
            message.chunk_size = message.chunk_size or len(chunk)
            last = message.chunks.get(head.chunks - 1, b"")
            fits = len(chunk) == message.chunk_size and len(chunk) >= max(len(last), 1)
        else:
            fits = not message.chunk_size or len(chunk) <= message.chunk_size
        whole = message.chunk_size * (head.chunks - 1)
        if not fits or whole > tables.FRAGMENT_MAX_BYTES or message.size + len(chunk) > tables.FRAGMENT_MAX_BYTES:
            del self._in[head.message_id]
            self.refused += 1
            raise RemoteProtocolError(
                f"fragment {head.number} of {head.chunks} with {len(chunk)} bytes does not fit its message's size"
            )

    def _ask(self, message_id: int, message: _Incoming, now: float) -> bytes:
        while message.first_missing in message.chunks:
            message.first_missing += 1
        candidates = (i for i in range(message.first_missing, message.count) if i not in message.chunks)
        missing = tuple(islice(candidates, WINDOW))
        message.window_end = missing[-1] + 1
        message.asked_at = now
        return serialize_missing(message_id, missing)
