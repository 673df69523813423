"""A link that reports all its bytes to an observer and otherwise behaves like the link it wraps.

Owns the observation point, and the rule that observing never changes the traffic: errors of an observer are counted
and not passed on. Must not know what the bytes mean, nor who observes them. Without an observer there is no tap, so
observation costs nothing when it is off.
"""

from __future__ import annotations

import enum
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, NamedTuple, ParamSpec

from .base import Link

__all__ = [
    "TRACE_VARIABLE",
    "Direction",
    "Missed",
    "Passed",
    "TapLink",
    "tapped",
    "wrap_every_link",
    "wrap_new_links",
]

_P = ParamSpec("_P")

TRACE_VARIABLE = "HEXWIRE_TRACE"
"""Environment variable that has every link of a program traced; `hexwire.trace.live` does it."""


class Direction(enum.Enum):
    """Direction of bytes, seen from the host."""

    SENT = "sent"
    RECEIVED = "received"


class Passed(NamedTuple):
    """Bytes that went over a link.

    Attributes:
        direction: Direction.
        data: The bytes of one write, or as returned by one read.
        time: Clock of the link (monotonic seconds) when the call returned.
        url: The link.
    """

    direction: Direction
    data: bytes
    time: float
    url: str


Observer = Callable[[Passed], None]

_wrapper: ContextVar[Callable[[Link], Link] | None] = ContextVar("hexwire_link_wrapper", default=None)
_everywhere: list[Callable[[Link], Link]] = []


class Missed:
    """Catches and counts the errors of observers. Any thread.

    Attributes:
        count: Number of failed calls of observers.
        first: The first error; None if there was none.
    """

    def __init__(self) -> None:
        self.count = 0
        self.first: Exception | None = None
        # Re-entrant: a signal handler may stop the arm, and be observed, in the middle of `add`.
        self._lock = threading.RLock()

    def guard(self, observer: Callable[_P, object]) -> Callable[_P, None]:
        """The observer, wrapped so that it cannot fail."""

        def guarded(*args: _P.args, **kwargs: _P.kwargs) -> None:
            try:
                observer(*args, **kwargs)
            except Exception as error:  # noqa: BLE001  # an observer must not affect the arm
                self.add(error)

        return guarded

    def add(self, error: Exception) -> None:
        """Count a failure."""
        with self._lock:
            self.count += 1
            # Without its traceback, which would keep the bytes of that moment in memory.
            self.first = self.first or error.with_traceback(None)


class TapLink(Link):
    """Wraps a link.

    Args:
        link: The link that does the work.
        observer: Called for all bytes, in the thread that moved them. Its errors are counted and do not affect the
            traffic.

    Attributes:
        missed: Errors of the observer.
    """

    def __init__(self, link: Link, observer: Observer) -> None:
        from time import monotonic

        self.link = link
        self.kind = link.kind
        self.max_message = link.max_message
        self.clock = getattr(link, "clock", None) or monotonic
        self.missed = Missed()
        self._observer = self.missed.guard(observer)

    def __getattr__(self, name: str) -> Any:
        # Attributes of some links only, such as `baud` and `set_baud`: a tap must not hide them.
        if name == "link":
            raise AttributeError(name)
        return getattr(self.link, name)

    @property
    def url(self) -> str:  # type: ignore[override]  # a listening link learns its port when it opens
        """Address of the wrapped link."""
        return self.link.url

    @property
    def is_open(self) -> bool:
        return self.link.is_open

    def stalled(self, seconds: float) -> float:
        return self.link.stalled(seconds)

    def open(self) -> None:
        self.link.open()

    def close(self) -> None:
        self.link.close()

    def read(self, deadline: float | None) -> bytes:
        data = self.link.read(deadline)
        if data:
            self._observer(Passed(Direction.RECEIVED, data, self.clock(), self.url))
        return data

    def write(self, data: bytes, deadline: float | None = None) -> None:
        self.link.write(data, deadline)
        if data:
            self._observer(Passed(Direction.SENT, bytes(data), self.clock(), self.url))

    def flush_input(self) -> int:
        return self.link.flush_input()

    def wake(self) -> None:
        self.link.wake()

    def confirm(self) -> None:
        self.link.confirm()


@contextmanager
def wrap_new_links(wrapper: Callable[[Link], Link]) -> Iterator[None]:
    """In this context, every link that `make_link` creates goes through `wrapper`.

    In nested contexts both wrappers apply, the inner context's outermost.
    """
    inner = _wrapper.get()
    token = _wrapper.set(wrapper if inner is None else lambda link: wrapper(inner(link)))
    try:
        yield
    finally:
        _wrapper.reset(token)


def wrap_every_link(wrapper: Callable[[Link], Link]) -> None:
    """From now on, all links that `make_link` creates, in any thread, go through `wrapper` first."""
    _everywhere.append(wrapper)


def tapped(link: Link) -> Link:
    """The link, wrapped if `wrap_new_links` is active. For `make_link`."""
    for everywhere in _everywhere:
        link = everywhere(link)
    wrapper = _wrapper.get()
    return link if wrapper is None else wrapper(link)
