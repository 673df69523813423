"""Events of a session, as frozen values, and their bounded queue, which never drops the outcome of a request.

Owns the event types with their log lines, the counters, and what is dropped when the caller does not take events:
the oldest report for a new report, and the oldest event except the ends of requests for any other. Knows nothing of
the source of events.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from hexwire.wire.command_frame import Frame, command_name, status_name

__all__ = [
    "Answers",
    "BadFrame",
    "ConnectionCounters",
    "Event",
    "EventQueue",
    "Garbage",
    "Reply",
    "Report",
    "Request",
    "Stale",
    "TimedOut",
]

_MAX_REPORTS = 64
_MAX_EVENTS = 4096


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


class EventQueue:
    """Events in order.

    Args:
        counters: Counters for dropped reports and events.
    """

    __slots__ = ("_counters", "_events", "_reports")

    def __init__(self, counters: ConnectionCounters) -> None:
        self._counters = counters
        self._events: deque[Event] = deque()
        self._reports = 0

    def pop(self) -> Event | None:
        """Remove and return the oldest event, or return None."""
        if not self._events:
            return None
        try:
            event = self._events.popleft()
        except IndexError:
            # A signal handler that stops the arm has taken it.
            return None
        if event.__class__ is Report:
            self._reports -= 1
        return event

    def add(self, event: Event) -> None:
        """Append an event."""
        if len(self._events) >= _MAX_EVENTS:
            self._make_room()
        self._events.append(event)

    def add_report(self, report: Report) -> None:
        """Append a report; if there are too many, drop the oldest, since the newest state matters most."""
        if self._reports >= _MAX_REPORTS:
            i = next(i for i, event in enumerate(tuple(self._events)) if event.__class__ is Report)
            del self._events[i]
            self._reports -= 1
            self._counters.reports_dropped += 1
        self.add(report)
        self._reports += 1

    def _make_room(self) -> None:
        # A caller waits for each reply or time-out, and there are no more of them than requests.
        for i, event in enumerate(tuple(self._events)):
            if not isinstance(event, Reply | TimedOut | Answers):
                del self._events[i]
                self._reports -= event.__class__ is Report
                self._counters.events_dropped += 1
                return
