"""What a listening server waits for: new clients, those that are still connecting, and its waker.

Owns the choice between epoll and what other systems have. Must not know what a client is.
"""

from __future__ import annotations

import select
import sys
from typing import Protocol

from hexwire.system import READABLE, make_poll

__all__ = ["Doors", "PlainDoors", "make_doors"]


class Doors(Protocol):
    """Descriptors with the events that are waited for, and a waker."""

    def fileno(self) -> int:
        """A descriptor that becomes readable when one of them is ready, for programs that watch many servers.

        Of `PlainDoors` it is the first one, so only asking shows what a client has sent that is still connecting.
        """

    def register(self, fd: int, eventmask: int, /) -> None:
        """Add a descriptor."""

    def modify(self, fd: int, eventmask: int, /) -> None:
        """Change the events of a descriptor."""

    def unregister(self, fd: int, /) -> None:
        """Remove a descriptor, before it is closed."""

    def wait(self, timeout: float | None) -> list[int]:
        """Wait at most `timeout` milliseconds, forever if None; returns what is ready, the waker included."""

    def close(self) -> None:
        """Free what the system holds for it; the descriptors stay open."""


class PlainDoors:
    """For systems without epoll.

    Args:
        waker: Descriptor of the waker.
    """

    def __init__(self, waker: int) -> None:
        self._waker = waker
        self._events: dict[int, int] = {}

    def fileno(self) -> int:
        return next(iter(self._events), -1)

    def register(self, fd: int, eventmask: int) -> None:
        self._events[fd] = eventmask

    def modify(self, fd: int, eventmask: int) -> None:
        self._events[fd] = eventmask

    def unregister(self, fd: int) -> None:
        del self._events[fd]

    def wait(self, timeout: float | None) -> list[int]:
        poll = make_poll()
        for fd, events in ((self._waker, READABLE), *self._events.items()):
            poll.register(fd, events)
        return [fd for fd, _ in poll.poll(timeout)]

    def close(self) -> None:
        self._events.clear()


if sys.platform == "linux" and hasattr(select, "epoll"):

    class _EpollDoors:
        def __init__(self, waker: int) -> None:
            self._all = select.epoll()
            self.register, self.modify, self.unregister = self._all.register, self._all.modify, self._all.unregister
            self._poll = make_poll()
            self._poll.register(self._all.fileno(), READABLE)
            self._poll.register(waker, READABLE)

        def fileno(self) -> int:
            return self._all.fileno()

        def wait(self, timeout: float | None) -> list[int]:
            ready = [fd for fd, _ in self._poll.poll(timeout)]
            if self._all.fileno() not in ready:
                return ready
            ready.remove(self._all.fileno())
            return ready + [fd for fd, _ in self._all.poll(0.0)]

        def close(self) -> None:
            self._all.close()


def make_doors(waker: int) -> Doors:
    """Nothing but a waker's descriptor.

    Raises:
        OSError: The system has no descriptor left.
    """
    if sys.platform == "linux" and hasattr(select, "epoll"):
        return _EpollDoors(waker)
    return PlainDoors(waker)
