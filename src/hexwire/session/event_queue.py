"""The events that wait to be taken: bounded, and never at the cost of an outcome.

Owns what gives way when nobody takes events: the oldest report first makes room for the newest, and anything
but the outcome of a request for everything else. Knows nothing of how events come about.
"""

from __future__ import annotations

from collections import deque

from .events import ConnectionCounters, Event, Reply, Report, TimedOut

__all__ = ["EventQueue"]

_MAX_REPORTS = 64
_MAX_EVENTS = 4096


class EventQueue:
    """Events in order.

    Args:
        counters: Where it is counted what made room.
    """

    __slots__ = ("_counters", "_events", "_reports")

    def __init__(self, counters: ConnectionCounters) -> None:
        self._counters = counters
        self._events: deque[Event] = deque()
        self._reports = 0

    def pop(self) -> Event | None:
        """The oldest event, or None."""
        if not self._events:
            return None
        try:
            event = self._events.popleft()
        except IndexError:
            # A signal handler that stops the arm has taken it meanwhile.
            return None
        if event.__class__ is Report:
            self._reports -= 1
        return event

    def add(self, event: Event) -> None:
        """Put an event at the end."""
        if len(self._events) >= _MAX_EVENTS:
            self._make_room()
        self._events.append(event)

    def add_report(self, report: Report) -> None:
        """Put a report at the end. The newest state matters most: the oldest report makes room."""
        if self._reports >= _MAX_REPORTS:
            i = next(i for i, event in enumerate(tuple(self._events)) if event.__class__ is Report)
            del self._events[i]
            self._reports -= 1
            self._counters.reports_dropped += 1
        self.add(report)
        self._reports += 1

    def _make_room(self) -> None:
        # Somebody waits for a reply or its time-out, and there are no more of them than were asked for.
        for i, event in enumerate(tuple(self._events)):
            if not isinstance(event, Reply | TimedOut):
                del self._events[i]
                self._reports -= event.__class__ is Report
                self._counters.events_dropped += 1
                return
