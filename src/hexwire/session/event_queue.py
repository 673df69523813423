"""Bounded queue of events that never drops the outcome of a request.

Owns what is dropped when the caller does not take events: the oldest report for a new report, and the oldest event
except the ends of requests for any other. Knows nothing of the source of events.
"""

from __future__ import annotations

from collections import deque

from .events import Answers, ConnectionCounters, Event, Reply, Report, TimedOut

__all__ = ["EventQueue"]

_MAX_REPORTS = 64
_MAX_EVENTS = 4096


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
