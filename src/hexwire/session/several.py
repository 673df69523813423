"""Requests to several modules of a channel: one frame to all of them, one answer from each.

Owns who has answered such a request, and its repeats, which go only to those who have not. No I/O; time comes in as
`now`. Must not know links.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

from hexwire.errors import LocalProtocolError
from hexwire.wire.addresses import Broadcast, Multicast
from hexwire.wire.command_frame import Command, Frame, Status, command_name
from hexwire.wire.tables import EXT_STATUS_MASK, PROTO_CHAPTER, PROTO_HEXWIRE

from .conversation import Conversations
from .events import Answers, ConnectionCounters, EventQueue, Reply
from .policy import RetryPolicy

__all__ = ["SeveralRequests", "To"]


@dataclass(slots=True)
class _ToSeveral:
    ticket: int
    cmd: int
    body: bytes
    seq: int
    to: Multicast | Broadcast
    wanted: frozenset[int]
    window: float
    attempts: int
    urgent: bool
    sent: int = 0
    sent_at: float = 0.0
    deadline: float = 0.0
    answers: dict[int, Reply] = field(default_factory=dict)
    unreachable: set[int] = field(default_factory=set)
    frames: list[bytes] = field(default_factory=list)

    @property
    def silent(self) -> frozenset[int]:
        return self.wanted - self.answers.keys()


class To(NamedTuple):
    """Who is asked, and of a broadcast who is known to be there."""

    address: Multicast | Broadcast
    known: Collection[int] = ()


class Numbered(Protocol):
    """What is needed of a host's connection."""

    dialect: int
    policy: RetryPolicy
    counters: ConnectionCounters
    conversations: Conversations | None
    local: int

    @property
    def in_conversation(self) -> bool:
        """Whether commands may be sent."""

    @property
    def longest_body(self) -> int:
        """Bytes that fit one frame."""

    def take_ticket(self) -> int:
        """The ticket of a new request."""

    def take_number(self, cmd: int, body: bytes, now: float, end: float) -> int:
        """Its sequence number."""

    def put(self, data: bytes, *, urgent: bool) -> None:
        """Queue a frame."""

    def build(self, proto: int, cmd: int, body: bytes, seq: int, now: float, *, dst: int | None) -> bytes:
        """Make a frame."""


class SeveralRequests:
    """The outstanding requests of one host connection that more than one module answers.

    Args:
        maker: The connection, which numbers, builds and queues frames.
        events: Where the answers go.
    """

    def __init__(self, maker: Numbered, events: EventQueue) -> None:
        self._maker = maker
        self._events = events
        self._asked: dict[int, _ToSeveral] = {}

    def __contains__(self, seq: int) -> bool:
        return seq in self._asked

    def request(
        self,
        to: To,
        cmd: int,
        body: bytes,
        now: float,
        *,
        window: float | None = None,
        attempts: int | None = None,
        urgent: bool = False,
    ) -> int:
        """Send one request to several modules. The end is an `Answers` event with the ticket returned here.

        It ends when all modules have answered that `to` names; for a broadcast all that are known, and if none is,
        when the time is up. Repeats go only to those who have not answered.

        Args:
            to: The modules.
            cmd: Command code.
            body: Its body.
            now: Seconds, monotonic.
            window: Seconds to wait for the answers to each attempt; the policy's if None.
            attempts: Number of times to send it; the policy's if None.
            urgent: Send it before everything in the queue.

        Raises:
            LocalProtocolError: Dialect 1 has one module, and so has IDENTIFY over datagrams; the body must fit one
                frame.
        """
        maker = self._maker
        if maker.dialect == PROTO_CHAPTER or not maker.in_conversation:
            raise LocalProtocolError(
                "several modules need dialect 2, and over datagrams an answer of one to IDENTIFY"
            )
        if maker.conversations is not None and cmd == Command.IDENTIFY:
            raise LocalProtocolError("over datagrams IDENTIFY begins a conversation with one module")
        if len(body) > maker.longest_body:
            raise LocalProtocolError(
                f"{command_name(cmd)} to several modules has {len(body)} bytes; it must fit one frame, "
                f"which has room for {maker.longest_body}"
            )
        wanted = to.address.modules if isinstance(to.address, Multicast) else frozenset(to.known)
        policy = maker.policy
        window, attempts = window or policy.window, attempts or policy.attempts
        ticket, seq = maker.take_ticket(), maker.take_number(cmd, body, now, now + attempts * window)
        asked = _ToSeveral(ticket, cmd, body, seq, to.address, wanted, window, attempts, urgent)
        self._transmit(asked, now)
        self._asked[seq] = asked
        return ticket

    def take(self, frame: Frame, now: float) -> bool:
        """Process an answer; returns whether it is one that was waited for."""
        asked = self._asked.get(frame.seq)
        maker = self._maker
        if asked is None or asked.cmd != frame.cmd or frame.dst != maker.local or not asked.to.names(frame.src):
            return False
        if frame.src in asked.answers:
            # Of a module that answered a repeat, too.
            return True
        maker.counters.replies += 1
        status = frame.cmd_ext & EXT_STATUS_MASK
        if status == Status.UNREACHABLE:
            # Of a gateway, in place of the module, whose own answer may still come.
            asked.unreachable.add(frame.src)
            return True
        rtt = now - asked.sent_at
        asked.answers[frame.src] = Reply(asked.ticket, frame.cmd, status, frame.body, frame, rtt, asked.sent)
        if asked.wanted and not asked.silent:
            self._end(asked)
        return True

    def next_timeout(self) -> float | None:
        """Time at which to call `handle_timeout`, or None."""
        if not self._asked:
            return None
        return min((asked.deadline for asked in tuple(self._asked.values())), default=None)

    def handle_timeout(self, now: float) -> None:
        """Repeat what is due, and give up."""
        for asked in tuple(self._asked.values()):
            if asked.deadline > now:
                continue
            if asked.sent < asked.attempts:
                self._maker.counters.retries += 1
                self._transmit(asked, now)
            else:
                self._maker.counters.timeouts += bool(asked.silent)
                self._end(asked)

    def holds(self, ticket: int) -> bool:
        """Whether a request still waits for answers."""
        return any(asked.ticket == ticket for asked in tuple(self._asked.values()))

    def abandon(self, ticket: int) -> list[bytes] | None:
        """Forget a request; returns its last frames, or None if there is no such request or a repeat has left."""
        for asked in tuple(self._asked.values()):
            if asked.ticket == ticket:
                del self._asked[asked.seq]
                return asked.frames if asked.sent == 1 else None
        return None

    def void(self) -> list[bytes]:
        """Forget every request but stops; returns the frames of those."""
        kept = []
        for asked in tuple(self._asked.values()):
            if asked.urgent:
                kept += asked.frames
            else:
                self._asked.pop(asked.seq, None)
        return kept

    def _transmit(self, asked: _ToSeveral, now: float) -> None:
        asked.sent += 1
        asked.sent_at, asked.deadline = now, now + asked.window
        # Those who have answered would answer again from store; nothing is gained by asking them.
        to = Multicast(asked.silent) if asked.sent > 1 and asked.silent else asked.to
        data = self._maker.build(PROTO_HEXWIRE, asked.cmd, asked.body, asked.seq, now, dst=to.dst)
        asked.frames = [data]
        self._maker.put(data, urgent=asked.urgent)

    def _end(self, asked: _ToSeveral) -> None:
        self._asked.pop(asked.seq, None)
        silent = asked.silent | (asked.unreachable - asked.answers.keys())
        self._events.add(Answers(asked.ticket, asked.cmd, dict(sorted(asked.answers.items())), silent))
