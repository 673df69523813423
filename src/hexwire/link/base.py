"""The byte link: what every line between host and board can do, whatever it is made of.

Owns the contract, `Link`. How most links keep it is `hexwire.link.poll_link`'s. Must not know frames, sessions or
what the bytes mean.

A **stream** link (serial, TCP) delivers bytes in order and keeps no boundaries: a read may return a part of
what was written, or several writes in one piece. A **datagram** link (UDP, message queue) delivers whole
messages of at most `max_message` bytes, or none.
"""

from __future__ import annotations

import enum
from abc import ABC, abstractmethod
from time import monotonic
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType

__all__ = ["WRITE_TIME", "Link", "LinkKind"]

# A request of `exchange` that the line does not take within this many seconds is given up.
WRITE_TIME = 1.0


class LinkKind(enum.Enum):
    """What a link keeps of the boundaries between writes."""

    STREAM = "stream"
    DATAGRAM = "datagram"


class Link(ABC):
    """A line that carries bytes both ways. Building one does no I/O; `open` does.

    One thread may read while another writes. Any thread may `close` or `wake`.

    Attributes:
        url: The link's address, as in ``serial:///dev/ttyUSB0?baud=115200``.
        kind: Stream or datagram.
        max_message: Longest write in bytes, or None where there is no such limit.
    """

    kind: LinkKind
    url: str
    max_message: int | None = None

    @property
    @abstractmethod
    def is_open(self) -> bool:
        """True from `open` until `close` or until the link is lost."""

    @abstractmethod
    def open(self) -> None:
        """Open the line. A link that was closed or lost may be opened again.

        Raises:
            LinkNotFoundError: There is no such port, host or queue.
            LinkPermissionError: This user may not open it.
            LinkBusyError: It has an owner already, in another program or in this one.
            LinkTimeoutError: The peer did not answer in time.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the line and free what it held. Harmless if it is closed already; allowed from any thread.

        A read or write that waits in another thread ends with LinkClosedError.
        """

    @abstractmethod
    def read(self, deadline: float | None) -> bytes:
        """Wait for bytes.

        Args:
            deadline: Value of `time.monotonic` at which to give up; None waits without end. A deadline in the
                past takes what is there already.

        Returns:
            One or more bytes of a stream, one whole message of a datagram link, or ``b""`` if nothing came by
            the deadline or `wake` was called.

        Raises:
            LinkLostError: The line went away.
            LinkClosedError: It is not open, or was closed during the wait.
        """

    @abstractmethod
    def write(self, data: bytes, deadline: float | None = None) -> None:
        """Hand over all of `data`; return when the system has taken it. Writing nothing does nothing.

        Args:
            data: The bytes; at most `max_message` of them.
            deadline: Value of `time.monotonic` at which to give up; None waits without end.

        Raises:
            UsageError: More than `max_message` bytes; nothing was written.
            LinkTimeoutError: The line did not take everything in time. A stream may have taken a part.
            LinkLostError: The line went away.
            LinkClosedError: It is not open, or was closed during the wait.
        """

    def exchange(self, data: bytes, window: float, rest: Callable[[bytes], float] | None = None) -> bytes:
        """Write a request and read what comes back: what a request-and-answer bus does all day.

        Args:
            data: The request.
            window: Seconds to wait for the first bytes.
            rest: Tells from the bytes that are here how long to wait for more, in seconds; 0.0 if they are all.
                None takes the first bytes as they come.

        Returns:
            As `read`; with `rest`, all that came before a wait was over or `wake` was called.

        Raises:
            LinkError: As `write` and `read`.
        """
        # A link in simulated time has a clock of its own.
        clock = getattr(self, "clock", monotonic)
        self.write(data, clock() + WRITE_TIME)
        answer = more = self.read(clock() + window)
        while more and rest is not None and (wait := rest(answer)) > 0.0:
            more = self.read(clock() + wait)
            answer += more
        return answer

    @abstractmethod
    def flush_input(self) -> int:
        """Throw away what has arrived and was not read.

        Returns:
            Number of bytes thrown away.
        """

    @abstractmethod
    def wake(self) -> None:
        """Make the read that waits now, or else the next one, return at once. Allowed from any thread."""

    def confirm(self) -> None:  # noqa: B027 (most links have nothing to choose)
        """Say that what was read last made sense. A link that has to choose its other end keeps to that one."""

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.url} {'open' if self.is_open else 'closed'}>"
