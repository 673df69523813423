"""Bodies that do not fit a frame: cut into chunks, put together, missing chunks asked for again.

Owns both ends of PROTOCOL.md's FRAGMENT and FRAGMENT_MISSING, bounded in size, number and time. The receiver
pulls: it confirms a window by asking for the next one, so a slow receiver or a lossy link sets the pace by
itself. Sans I/O; time comes in as `now`. Knows nothing of frames or links.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import islice

from hexwire.errors import LocalProtocolError, RemoteProtocolError
from hexwire.wire import tables
from hexwire.wire.commands import FRAGMENT_HEAD_SIZE, FragmentHead, parse_missing, serialize_missing

__all__ = ["FragmentReceiver", "FragmentSender", "Message"]

WINDOW = 16
"""Chunks sent before the receiver must ask on. 16 of 8 kB stay inside a default UDP receive buffer."""

ASK_AGAIN = 0.1
"""Seconds of silence after which a receiver asks for what is missing."""


@dataclass(frozen=True, slots=True)
class Message:
    """A body put together again."""

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
    """Cuts bodies and keeps them until the peer has them.

    Args:
        chunk_size: Bytes of body a fragment carries.
        lifetime: Seconds without a word from the peer after which a message is forgotten.
    """

    def __init__(self, chunk_size: int, lifetime: float = tables.FRAGMENT_LIFETIME) -> None:
        self._chunk_size = chunk_size
        self._lifetime = lifetime
        self._out: dict[int, _Outgoing] = {}
        self.expired = 0

    def send(self, message_id: int, cmd: int, cmd_ext: int, body: bytes, now: float) -> Iterator[bytes]:
        """Start a message; yields the FRAGMENT bodies of its first window.

        Raises:
            LocalProtocolError: It is over the size that a receiver takes, or too many are under way.
        """
        if len(body) > tables.FRAGMENT_MAX_BYTES:
            raise LocalProtocolError(
                f"a body of {len(body)} bytes is over the {tables.FRAGMENT_MAX_BYTES} that fragments carry"
            )
        self.handle_timeout(now)
        if len(self._out) >= tables.FRAGMENT_MESSAGES and message_id not in self._out:
            raise LocalProtocolError(f"{len(self._out)} fragmented messages are under way already")
        size = self._chunk_size
        chunks = [body[i : i + size] for i in range(0, len(body), size)] or [b""]
        if len(chunks) > 0xFFFF:
            raise LocalProtocolError(f"{len(chunks)} chunks are over the 65535 that can be counted")
        self._out[message_id] = _Outgoing(cmd, cmd_ext, chunks, now + self._lifetime)
        return self._bodies(message_id, range(min(WINDOW, len(chunks))))

    def remind(self, message_id: int, cmd: int, cmd_ext: int, body: bytes, now: float) -> Iterator[bytes]:
        """Send the first chunk again.

        A receiver that missed the whole window then asks for the rest; one that has it all says so once more.
        """
        if message_id not in self._out and len(self._out) < tables.FRAGMENT_MESSAGES:
            self.send(message_id, cmd, cmd_ext, body, now)
        return self._bodies(message_id, (0,) if message_id in self._out else ())

    def forget(self, message_id: int) -> None:
        """Drop a message; what the peer still asks of it is not answered."""
        self._out.pop(message_id, None)

    def receive_missing(self, body: bytes, now: float) -> Iterator[bytes]:
        """Act on a FRAGMENT_MISSING body; yields the FRAGMENT bodies asked for.

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
        # At most a window an answer, whatever a peer asks: it asks again for the rest.
        return self._bodies(message_id, [i for i in indexes if i < len(message.chunks)][:WINDOW])

    def next_timeout(self) -> float | None:
        """When `handle_timeout` wants to be called, or None."""
        if not self._out:
            return None
        return min(m.deadline for m in self._out.values())

    def handle_timeout(self, now: float) -> None:
        """Forget messages that the peer no longer asks about."""
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
    """Puts messages together; bounded in number, size and time.

    Attributes:
        expired: Messages given up because the peer fell silent.
        refused: Fragments that fit no message, or would have gone over a bound.
        duplicates: Chunks that were there already.
    """

    def __init__(self, lifetime: float = tables.FRAGMENT_LIFETIME) -> None:
        self._lifetime = lifetime
        self._in: dict[int, _Incoming] = {}
        self._done: dict[int, float] = {}
        self.expired = 0
        self.refused = 0
        self.duplicates = 0

    def receive(self, body: bytes, now: float) -> tuple[Message | None, list[bytes]]:
        """Take a FRAGMENT body.

        Returns:
            The message if it is whole now, and the FRAGMENT_MISSING bodies to send back.

        Raises:
            RemoteProtocolError: The body is malformed, or over a bound.
        """
        head = FragmentHead.parse(body)
        chunk = body[FRAGMENT_HEAD_SIZE:]
        if self.is_done(head.message_id, now):
            # Our confirmation was lost: the sender is still asking what we got.
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
        """Whether a message was put together within its lifetime."""
        done = self._done.get(message_id)
        return done is not None and done + self._lifetime > now

    def forget(self) -> None:
        """Drop all messages, whole or not: the peer starts anew, and may use their numbers again."""
        self._in.clear()
        self._done.clear()

    def next_timeout(self) -> float | None:
        """When `handle_timeout` wants to be called, or None."""
        if not self._in:
            return None
        return min(
            min(max(m.last_rx, m.asked_at) + ASK_AGAIN, m.last_rx + self._lifetime) for m in self._in.values()
        )

    def handle_timeout(self, now: float) -> list[bytes]:
        """Ask again for what is missing, give up what has been silent too long; returns bodies to send."""
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
        # In the order they were done: the cost is that of what is dropped.
        while self._done:
            message_id, done = next(iter(self._done.items()))
            if done + self._lifetime > now:
                break
            del self._done[message_id]

    def _start(self, head: FragmentHead, now: float) -> _Incoming:
        if head.message_id not in self._in and len(self._in) >= tables.FRAGMENT_MESSAGES:
            self.refused += 1
            raise RemoteProtocolError(f"more than {tables.FRAGMENT_MESSAGES} fragmented messages at once")
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
                f"fragment {head.number} of {head.chunks} with {len(chunk)} bytes breaks its message's size"
            )

    def _ask(self, message_id: int, message: _Incoming, now: float) -> bytes:
        while message.first_missing in message.chunks:
            message.first_missing += 1
        candidates = (i for i in range(message.first_missing, message.count) if i not in message.chunks)
        missing = tuple(islice(candidates, WINDOW))
        message.window_end = missing[-1] + 1
        message.asked_at = now
        return serialize_missing(message_id, missing)
