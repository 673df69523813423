"""Events of a session, as frozen values.

Owns the event types with their log lines, and the counters. Knows nothing of the source of events.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from hexwire.wire.command_frame import Frame, command_name, status_name

__all__ = [
    "Answers",
    "BadFrame",
    "ConnectionCounters",
    "Event",
    "Garbage",
    "Reply",
    "Report",
    "Request",
    "Stale",
    "TimedOut",
]


@dataclass(slots=True)
class ConnectionCounters:
    """Counters of a connection since it was made.

    Attributes:
        refused: Datagrams refused as old or of another conversation; `stale` counts them too.
        not_for_several: Requests to several modules with a command that goes to one only.
    """

    frames_sent: int = 0
    requests: int = 0
    replies: int = 0
    retries: int = 0
    timeouts: int = 0
    stale: int = 0
    refused: int = 0
    repeats: int = 0
    reports: int = 0
    reports_dropped: int = 0
    not_for_several: int = 0
    events_dropped: int = 0


@dataclass(frozen=True, slots=True)
class Garbage:
    """Bytes that belong to no frame.

    Attributes:
        count: Number of bytes discarded.
        data: The first of them, at most 64.
    """

    count: int
    data: bytes

    def __str__(self) -> str:
        return f"{self.count} bytes of garbage: {self.data[:16].hex(' ').upper()}"


@dataclass(frozen=True, slots=True)
class BadFrame:
    """Bytes that begin like a frame but fail a check. Nothing in them is executed.

    Attributes:
        reason: In words: the check, the tail, unfinished.
        data: Its first bytes, at most 64.
    """

    reason: str
    data: bytes

    def __str__(self) -> str:
        return f"bad frame, {self.reason}: {self.data[:16].hex(' ').upper()}"


@dataclass(frozen=True, slots=True)
class Request:
    """Board side: a request of a host. Answer it with `Connection.reply`."""

    frame: Frame

    def __str__(self) -> str:
        return f"request {self.frame}"


class Reply(NamedTuple):
    """Host side: the answer to the request with this ticket.

    Attributes:
        ticket: The value that `Connection.request` returned.
        cmd: Command code of the request.
        status: Status code; 0 is ok. Always 0 in dialect 1, where errors are packets.
        body: In dialect 2 the reply's body; in dialect 1 the status packet, echo and noise removed.
        frame: The frame of the reply; None for a command of dialect 1 that is never answered.
        rtt: Seconds from the last attempt to the reply.
        attempts: Number of times that it was sent.
    """

    ticket: int
    cmd: int
    status: int
    body: bytes
    frame: Frame | None
    rtt: float
    attempts: int

    def __str__(self) -> str:
        return f"reply to {command_name(self.cmd)}: {status_name(self.status)}, {len(self.body)} bytes"


@dataclass(frozen=True, slots=True)
class Report:
    """Host side: an unsolicited frame of the board."""

    frame: Frame

    def __str__(self) -> str:
        return f"report {self.frame}"


@dataclass(frozen=True, slots=True)
class TimedOut:
    """Host side: no answer to the request with this ticket, after all attempts.

    Attributes:
        ticket: The value that `Connection.request` returned.
        cmd: Command code of the request.
        attempts: Number of times that it was sent.
        instead: What arrived instead, in words; empty if nothing arrived.
    """

    ticket: int
    cmd: int
    attempts: int
    instead: str

    def __str__(self) -> str:
        return f"no answer to {command_name(self.cmd)} after {self.attempts}"


@dataclass(frozen=True, slots=True)
class Answers:
    """Host side: the end of the request to several modules with this ticket.

    Attributes:
        ticket: The value that `Connection.request_several` returned.
        cmd: Command code of the request.
        replies: The answer of each module, by its id in rising order.
        silent: Modules that were named, or known, and have not answered after all attempts; of IDENTIFY also those
            in whose place a gateway has answered.
    """

    ticket: int
    cmd: int
    replies: dict[int, Reply]
    silent: frozenset[int]

    def __str__(self) -> str:
        silent = f", none from {', '.join(map(str, sorted(self.silent)))}" if self.silent else ""
        return f"{len(self.replies)} answers to {command_name(self.cmd)}{silent}"


@dataclass(frozen=True, slots=True)
class Stale:
    """Host side: a valid frame that answers no outstanding request; discarded and counted."""

    frame: Frame
    reason: str

    def __str__(self) -> str:
        return f"stale frame, {self.reason}: {self.frame}"


Event = Garbage | BadFrame | Request | Reply | Report | TimedOut | Answers | Stale
