"""A link that tells an observer every byte that passes, and otherwise is the link it wraps.

Owns the observation point, and that watching never changes what is watched: what an observer raises is counted and
goes no further. Must not know what the bytes mean, nor who looks on. Where nobody does, no tap is made: watching
costs nothing when it is off.
"""

from __future__ import annotations

import enum
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, NamedTuple, ParamSpec

from .base import Link

__all__ = ["Direction", "Missed", "Passed", "TapLink", "tapped", "wrap_new_links"]

_P = ParamSpec("_P")


class Direction(enum.Enum):
    """Which way bytes went, seen from the host."""

    SENT = "sent"
    RECEIVED = "received"


class Passed(NamedTuple):
    """Bytes that went over a link.

    Attributes:
        direction: Which way.
        data: As they were written, or as one read returned them.
        time: Clock of the link (monotonic seconds) when the call returned.
        url: The link.
    """

    direction: Direction
    data: bytes
    time: float
    url: str


Observer = Callable[[Passed], None]

_wrapper: ContextVar[Callable[[Link], Link] | None] = ContextVar("hexwire_link_wrapper", default=None)


class Missed:
    """Keeps from the watched what its observers raise, and counts it. Any thread.

    Attributes:
        count: Calls of observers that failed.
        first: What the first of them raised; None if none did.
    """

    def __init__(self) -> None:
        self.count = 0
        self.first: Exception | None = None
        # Re-entrant: a signal handler may stop the arm, and be watched, in the middle of `add`.
        self._lock = threading.RLock()

    def guard(self, observer: Callable[_P, object]) -> Callable[_P, None]:
        """The observer, as something that cannot fail."""

        def guarded(*args: _P.args, **kwargs: _P.kwargs) -> None:
            try:
                observer(*args, **kwargs)
            except Exception as error:  # noqa: BLE001  # whatever an observer does wrong, the arm goes on
                self.add(error)

        return guarded

    def add(self, error: Exception) -> None:
        """Count a failure."""
        with self._lock:
            self.count += 1
            # Without its traceback, which would keep the bytes of that moment for as long as the program runs.
            self.first = self.first or error.with_traceback(None)


class TapLink(Link):
    """Wraps a link.

    Args:
        link: The link that does the work.
        observer: Told of everything that passes, in the thread that moved it. What it raises is counted, and the
            bytes go on as if nobody watched.
        clock: Monotonic seconds; the link's own if it has one.

    Attributes:
        missed: What the observer failed to see.
    """

    def __init__(self, link: Link, observer: Observer, clock: Callable[[], float] | None = None) -> None:
        from time import monotonic

        self.link = link
        self.kind = link.kind
        self.max_message = link.max_message
        self.clock = clock or getattr(link, "clock", None) or monotonic
        self.missed = Missed()
        self._observer = self.missed.guard(observer)

    def __getattr__(self, name: str) -> Any:
        # What only some links have, as `baud` and `set_baud`: who watches a bus must not take that away.
        if name == "link":
            raise AttributeError(name)
        return getattr(self.link, name)

    @property
    def url(self) -> str:  # type: ignore[override]  # a listening link learns its port when it opens
        """Address of the link inside."""
        return self.link.url

    @property
    def is_open(self) -> bool:
        return self.link.is_open

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
    """While this lasts, every link that `make_link` builds in this context goes through `wrapper`.

    Within another such block both look on, this one outermost.
    """
    inner = _wrapper.get()
    token = _wrapper.set(wrapper if inner is None else lambda link: wrapper(inner(link)))
    try:
        yield
    finally:
        _wrapper.reset(token)


def tapped(link: Link) -> Link:
    """The link, wrapped if `wrap_new_links` is in force. For `make_link`."""
    wrapper = _wrapper.get()
    return link if wrapper is None else wrapper(link)
