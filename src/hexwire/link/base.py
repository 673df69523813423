"""The byte link: the interface of every line between host and board.

Owns the contract, `Link`, the rule of what is opened and closed (``with thing:``), and how a deadline becomes the
timeout of a system call. Most links implement it through `hexwire.link.poll_link`. Must not know frames, sessions
or the meaning of the bytes.

A **stream** link (serial, TCP) delivers bytes in order and preserves no boundaries: a read may return part of a
write, or several writes together. A **datagram** link (UDP, message queue) delivers whole messages of at most
`max_message` bytes, or nothing.
"""

from __future__ import annotations

import enum
import threading
from abc import ABC, abstractmethod
from time import monotonic
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["LONGEST_POLL", "WRITE_TIME", "Link", "LinkKind", "Openable", "lock_timeout", "poll_timeout"]

# poll() takes milliseconds as a C int; longer waits are split into parts of this many seconds.
LONGEST_POLL = 1_000_000.0
# Seconds after which `exchange` abandons a request that the line does not accept.
WRITE_TIME = 1.0


class Openable(ABC):
    """Has `open` and `close`, and is open inside ``with``."""

    @abstractmethod
    def open(self) -> None:
        """Open it."""

    @abstractmethod
    def close(self) -> None:
        """Close it; what is closed stays closed."""

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class LinkKind(enum.Enum):
    """Whether a link preserves the boundaries between writes."""

    STREAM = "stream"
    DATAGRAM = "datagram"


def poll_timeout(deadline: float | None) -> float | None:
    """For `poll`: milliseconds. `poll` rounds them up, so that nothing returns early."""
    return None if deadline is None else max(0.0, min(deadline - monotonic(), LONGEST_POLL)) * 1000.0


def lock_timeout(deadline: float | None) -> float:
    """For `Lock.acquire`: seconds, -1 for no limit."""
    return -1.0 if deadline is None else max(0.0, min(deadline - monotonic(), threading.TIMEOUT_MAX))


def _clock_of(link: Link) -> Callable[[], float]:
    """The clock of a link in simulated time, else the system's."""
    clock: Callable[[], float] = getattr(link, "clock", monotonic)
    return clock


class Link(Openable):
    """A line that carries bytes in both directions. Creating a link does no I/O; `open` does.

    One thread may read while another writes. Any thread may `close` or `wake`.

    Attributes:
        url: The link's address, such as ``serial:///dev/ttyUSB0?baud=115200``.
        kind: Stream or datagram.
        max_message: Longest write in bytes, or None if there is no such limit.
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
            LinkBusyError: Another program, or this one, already has it open.
            LinkTimeoutError: The peer did not answer in time.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the line and free its resources. Harmless if already closed; allowed from any thread.

        A read or write that waits in another thread ends with LinkClosedError.
        """

    @abstractmethod
    def read(self, deadline: float | None) -> bytes:
        """Wait for bytes.

        Args:
            deadline: Value of `time.monotonic` at which to give up; None waits forever. With a deadline in the
                past, only bytes that have already arrived are returned.

        Returns:
            One or more bytes of a stream, one whole message of a datagram link, or ``b""`` if nothing arrived
            by the deadline or `wake` was called.

        Raises:
            LinkLostError: The line was lost.
            LinkClosedError: It is not open, or was closed during the wait.
        """

    @abstractmethod
    def write(self, data: bytes, deadline: float | None = None) -> None:
        """Write all of `data`; return when the system has accepted it. Writing nothing does nothing.

        Args:
            data: The bytes; at most `max_message` of them.
            deadline: Value of `time.monotonic` at which to give up; None waits forever.

        Raises:
            UsageError: More than `max_message` bytes; nothing was written.
            LinkTimeoutError: The line did not accept everything in time. A stream may have accepted part of it.
            LinkLostError: The line was lost.
            LinkClosedError: It is not open, or was closed during the wait.
        """

    def stalled(self, seconds: float) -> float:
        """Seconds of the last so many in which this program did not run, if the device is inside it; else 0."""
        return 0.0

    def post(self, data: bytes) -> None:
        """Write a packet without an answer: `write` with a deadline in `WRITE_TIME` seconds, on the fast path.

        Raises:
            LinkError: As `write`.
        """
        self.write(data, _clock_of(self)() + WRITE_TIME)

    def collect(self, window: float, rest: Callable[[bytes], float] | None = None) -> bytes:
        """Read the answer to a request that was just sent: the second half of `exchange`.

        Args:
            window: Seconds to wait for the first bytes; infinite waits forever.
            rest: Returns the seconds to wait for more, given the bytes received so far; 0.0 if they are complete.
                With None, the first bytes are returned. An error that it raises ends the call and passes
                unchanged, even an OSError: the link stays open, and the bytes received are discarded.

        Returns:
            As `read`; with `rest`, all bytes that arrived before a wait ended or `wake` was called.

        Raises:
            LinkError: As `read`.
        """
        clock = _clock_of(self)
        answer = more = self.read(clock() + window)
        while more and rest is not None and (wait := rest(answer)) > 0.0:
            more = self.read(clock() + wait)
            answer += more
        return answer

    def exchange(self, data: bytes, window: float, rest: Callable[[bytes], float] | None = None) -> bytes:
        """Write a request and read the bytes that come back: the fast path of a request-and-answer bus.

        `post` and `collect` in one call; a caller with work to do meanwhile calls the two itself.

        Args:
            data: The request.
            window: As in `collect`.
            rest: As in `collect`.

        Returns:
            As `collect`.

        Raises:
            LinkError: As `write` and `read`.
        """
        self.post(data)
        return self.collect(window, rest)

    @abstractmethod
    def flush_input(self) -> int:
        """Discard bytes that have arrived but were not read.

        Returns:
            Number of bytes discarded.
        """

    @abstractmethod
    def wake(self) -> None:
        """Make the waiting read, or otherwise the next one, return at once. Allowed from any thread."""

    def confirm(self) -> None:
        """Confirm that the bytes read last were valid. A link that chooses its peer then keeps that peer."""

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.url} {'open' if self.is_open else 'closed'}>"
