"""The base of most links: one loop over one descriptor that poll can watch.

Owns deadlines, waiting, waking, closing from another thread or a signal handler, and the turn that one reader takes
at a time. Must not know what the descriptor is, nor what the bytes mean.

A signal handler may raise at almost any step of a call, as Ctrl-C does, and may not leave the turn taken. The
interpreter runs handlers, and lets other threads run, only at calls, at the start of a function and at jumps back.
Neither happens between a look at `taken` and the next line. So a call is written like this::

    if turn.taken:
        return turn.later(timeout, call)
    turn.taken = 1
    try:
        turn.lock.acquire()
        return call()
    finally:
        turn.taken -= 1
        turn.lock.release()

The lock is free while `taken` is 0, so `acquire` does not wait, and a handler comes before the first line or after
`acquire`. The lock alone keeps other calls out. `with` would do the same, at four times the cost.
"""

from __future__ import annotations

import enum
import logging
import threading
from abc import abstractmethod
from time import monotonic
from typing import TYPE_CHECKING, ClassVar, TypeVar

from hexwire.errors import (
    LinkBusyError,
    LinkClosedError,
    LinkError,
    LinkLostError,
    LinkTimeoutError,
    UsageError,
)
from hexwire.system import READABLE, WRITABLE, make_poll

from .base import LONGEST_POLL, WRITE_TIME, Link, lock_timeout, poll_timeout
from .waker import Waker

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["CallTurn", "PollLink"]

_T = TypeVar("_T")


class CallTurn:
    """The turn of one call at a time. A call that a signal handler makes inside another one has the turn as well.

    Attributes:
        lock: Held by the call. Re-entrant.
        taken: Number of calls that have the turn or wait for it.
    """

    __slots__ = ("_condition", "lock", "taken")

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.taken = 0
        self._condition = threading.Condition(self.lock)

    def is_mine(self) -> bool:
        """Whether a call of this thread has the turn: in a signal handler, the call that it interrupts."""
        try:
            self._condition.notify(0)
        except RuntimeError:
            return False
        return True

    def later(self, timeout: float, call: Callable[[], _T]) -> _T | None:
        """Wait for the turn, then make a call; None if the turn was not free within `timeout` seconds.

        Args:
            timeout: Seconds, -1.0 for no limit.
            call: The call; it must not return None.
        """
        # Counted while it waits: after the holder's release it may have the lock, but not run yet.
        self.taken += 1
        got = False
        try:
            # Unpacking calls `acquire`, and no handler runs before the result is stored.
            (got,) = map(self.lock.acquire, (True,), (timeout,))
            if not got:
                return None
            return call()
        finally:
            self.taken -= 1
            if got:
                self.lock.release()


_log = logging.getLogger(__name__)

# Maximum number of bytes that flush_input discards, so that a peer that never stops sending cannot block it.
_FLUSH_LIMIT = 1 << 20


class _LinkState(enum.Enum):
    CLOSED = enum.auto()
    OPENING = enum.auto()
    OPEN = enum.auto()
    LOST = enum.auto()


# What is asked at every read and write: an enum's member by its class costs a tenth of a microsecond each time.
_OPEN = _LinkState.OPEN


def _milliseconds(wait: float) -> float:
    """For `poll`, of a wait that has passed, or of one longer than it takes, which is waited for in parts."""
    return LONGEST_POLL * 1000.0 if wait > 0.0 else 0.0


class PollLink(Link):
    """A link over one descriptor that `poll` can watch.

    A backend supplies `_open`, `_close`, `_fileno`, `_read_ready` and `_write_ready`, all non-blocking except
    `_open`. It lets OSError pass: this class turns it into LinkLostError. The descriptor must not change while the
    link is open.
    """

    # Advice about a lost line, at the end of the error text.
    _lost_advice: ClassVar[str] = ""

    def __init__(self, url: str) -> None:
        self.url = url
        self._state = _LinkState.CLOSED
        self._closing = False
        self._close_pending = False
        self._why_lost = ""
        # Re-entrant, since a signal handler may close the link in the middle of open().
        self._changing = threading.RLock()
        self._reading = CallTurn()
        self._writing = CallTurn()
        self._read_waker = Waker()
        self._write_waker = Waker()
        self._fd = self._write_fd = -1
        # The system calls of `_read_ready` and `_write_ready` alone, for `collect` and `post`; a backend may set
        # them in `_open`. None unless a stream is open, and not being closed. After b"" from the first,
        # `_read_ready` is called, which knows what that means.
        self._read_now: Callable[[], bytes] | None = None
        self._write_now: Callable[[bytes], int] | None = None
        self._ready = [(-1, READABLE)]
        self._watched: dict[int, Callable[[], None]] = {}
        self._wait_to_read = make_poll().poll
        self._write_poll = make_poll()

    # --- supplied by a backend --------------------------------------------------------------------

    @abstractmethod
    def _open(self) -> None:
        """Open the line or raise; after an error nothing may stay open (`_close` is called as well)."""

    @abstractmethod
    def _close(self) -> None:
        """Close whatever is open; harmless if nothing is."""

    @abstractmethod
    def _fileno(self) -> int:
        """Descriptor to wait on."""

    def _write_fileno(self) -> int:
        """Descriptor to wait on before writing, if it is a different one."""
        return self._fileno()

    @abstractmethod
    def _read_ready(self) -> bytes:
        """Read available bytes; ``b""`` after a false alarm; raise OSError if the line is lost."""

    @abstractmethod
    def _write_ready(self, data: memoryview | bytes) -> int:
        """Write what fits now; return the number of bytes; raise BlockingIOError if none fit."""

    def _write_given_up(self) -> None:
        """A write was abandoned half-way; forget its state."""

    # --- opening and closing ----------------------------------------------------------------------

    @property
    def is_open(self) -> bool:
        return self._state is _LinkState.OPEN

    def fileno(self) -> int:
        """Descriptor that becomes readable when `read` has data, for callers that watch many links."""
        if self._state is not _LinkState.OPEN:
            raise self._refusal()
        return self._fd

    def open(self) -> None:
        with self._changing:
            if self._state in (_LinkState.OPEN, _LinkState.OPENING):
                raise LinkBusyError(f"{self.url} is already open: one link object has one owner", url=self.url)
            if self._state is _LinkState.LOST:
                self._release()
            self._closing = False
            self._state = _LinkState.OPENING
            try:
                self._read_waker.open()
                self._write_waker.open()
                self._open()
                if self.max_message is None:
                    self._read_now = self._read_now or self._read_ready
                    self._write_now = self._write_now or self._write_ready
                self._fd = self._fileno()
                self._ready = [(self._fd, READABLE)]
                read_poll = make_poll()
                read_poll.register(self._fd, READABLE)
                read_poll.register(self._read_waker.fileno(), READABLE)
                for fd in self._watched:
                    read_poll.register(fd, READABLE)
                self._wait_to_read = read_poll.poll
                self._write_poll = make_poll()
                self._write_fd = self._write_fileno()
                self._write_poll.register(self._write_fd, WRITABLE)
                self._write_poll.register(self._write_waker.fileno(), READABLE)
                if self._closing:
                    raise self._closed()
            except BaseException as error:
                try:
                    self._release()
                finally:
                    self._state = _LinkState.CLOSED
                if isinstance(error, OSError) and not isinstance(error, LinkError):
                    raise LinkError(
                        f"{self.url} cannot be opened: {error.strerror or error}", url=self.url
                    ) from error
                raise
            self._state = _LinkState.OPEN
            _log.debug("%s is open", self.url)

    def close(self) -> None:
        self._closing = True
        self._read_now = self._write_now = None
        self._read_waker.set()
        self._write_waker.set()
        with self._changing:
            if self._state in (_LinkState.CLOSED, _LinkState.OPENING):
                # Closed already; or a signal handler closes from inside open(), which then stops.
                return
            if self._reading.is_mine() or self._writing.is_mine():
                # A signal handler closes from inside this thread's own read() or write(), which will do it
                # on leaving.
                self._close_pending = True
                return
            self._close_pending = False
            self._reading.later(-1.0, lambda: self._writing.later(-1.0, self._release))

    def _release(self) -> bool:
        self._fd = -1
        self._read_now = self._write_now = None
        self._close()
        self._watched.clear()
        self._read_waker.close()
        self._write_waker.close()
        # At the end: after Ctrl-C above, close() does what is left.
        self._close_pending = False
        self._state = _LinkState.CLOSED
        return True

    def wake(self) -> None:
        self._read_waker.set()

    # --- reading ----------------------------------------------------------------------------------

    def read(self, deadline: float | None) -> bytes:
        turn = self._reading
        try:
            if turn.taken:
                data = turn.later(lock_timeout(deadline), lambda: self._read(deadline))
                if data is None and self._closing:
                    raise self._closed()  # the one who has the turn is close()
                return data or b""
            turn.taken = 1
            try:
                turn.lock.acquire()
                return self._read(deadline)
            finally:
                turn.taken -= 1
                turn.lock.release()
        finally:
            if self._close_pending:
                self.close()

    def _read(self, deadline: float | None) -> bytes:
        woken = False
        while self._state is _OPEN and not self._closing:
            if woken:
                self._read_waker.clear()
                return b""
            if deadline is None:
                events = self._wait_to_read()
            else:
                # A float: poll rounds it up to whole milliseconds, so nothing returns early.
                left = deadline - monotonic()
                events = self._wait_to_read(min(left, LONGEST_POLL) * 1000.0 if left > 0.0 else 0)
            data = b""
            for fd, _ in events:
                if fd == self._fd:
                    data = self._receive()
                elif fd in self._watched:
                    self._watched[fd]()
                else:
                    woken = True  # by wake(), or because the link was closed or lost: look again
            if data:
                return data
            if not woken and deadline is not None and monotonic() >= deadline:
                return b""
        raise self._refusal()

    def collect(self, window: float, rest: Callable[[bytes], float] | None = None) -> bytes:
        # One poll and one read for each piece that comes. Measured on a pseudo-terminal, 56-byte answers: poll
        # costs 0.7 us over a bare blocking read, select 1.2 us, epoll 1.4 us; trying the read before the poll costs
        # an exception (1.5 us) whenever the answer is not there yet, which is nearly always. A read that VMIN makes
        # wait has VTIME as its only time-out, a tenth of a second, and setting them anew reprograms some USB
        # adapters. To sleep until the answer comes would be late: 80 us on an idle machine, milliseconds on a busy
        # one. `rest` may sleep between its pieces, where the time of the last one is known (`BusLine.transact`).
        turn = self._reading
        if turn.taken or self.max_message is not None:
            return super().collect(window, rest)
        answer, left, wait = b"", 0.0, window
        try:
            turn.taken = 1
            try:
                turn.lock.acquire()
                poll, ready, read = self._wait_to_read, self._ready, self._read_now
                if read is None:
                    raise self._refusal()
                # What comes after the answer delays the next request; until then, time is free.
                while True:
                    try:
                        events = poll(wait * 1000.0 if 0.0 < wait <= LONGEST_POLL else _milliseconds(wait))
                        if events != ready:
                            if events or not wait > LONGEST_POLL:
                                break
                            wait -= LONGEST_POLL
                            continue
                        left = wait
                        data = read() or self._read_ready()
                    except BlockingIOError:
                        break
                    except OSError as error:
                        raise self._as_lost(error) from error
                    if not data:
                        break
                    answer += data
                    if rest is None:
                        return answer
                    wait = rest(answer)
                    if wait <= 0.0:
                        return answer
            finally:
                turn.taken -= 1
                turn.lock.release()
        finally:
            if self._close_pending:
                self.close()
        # A false alarm (half a TLS record, say) must not pass for the end of the window.
        return answer or self.read(monotonic() + left)

    def flush_input(self) -> int:
        try:
            count = self._reading.later(1.0, self._flush)
        finally:
            if self._close_pending:
                self.close()
        if count is None:
            raise LinkBusyError(f"{self.url}: cannot flush, another thread is reading", url=self.url)
        return count

    def _flush(self) -> int:
        if self._state is not _OPEN or self._closing:
            raise self._refusal()
        count = 0
        while count < _FLUSH_LIMIT and (data := self._receive()):
            count += len(data)
        return count

    def _receive(self) -> bytes:
        try:
            return self._read_ready()
        except (BlockingIOError, InterruptedError):
            return b""
        except OSError as error:
            raise self._lose(error) from error

    # --- writing ----------------------------------------------------------------------------------

    def write(self, data: bytes, deadline: float | None = None) -> None:
        size = len(data)
        if self.max_message is not None and size > self.max_message:
            raise UsageError(
                f"{self.url} carries messages of at most {self.max_message} bytes, not {size}: send it in parts"
            )
        turn = self._writing
        try:
            if turn.taken:
                if turn.later(lock_timeout(deadline), lambda: self._write(data, deadline)) is None:
                    # If the link is being closed, close() has the turn.
                    raise self._closed() if self._closing else self._late(0, size)
                return
            turn.taken = 1
            try:
                turn.lock.acquire()
                self._write(data, deadline)
            finally:
                turn.taken -= 1
                turn.lock.release()
        finally:
            if self._close_pending:
                self.close()

    def _write(self, data: bytes, deadline: float | None) -> int:
        if self._state is not _OPEN or self._closing:
            raise self._refusal()
        size = len(data)
        if size and (sent := self._send(data)) < size:
            self._write_rest(memoryview(data), sent, deadline)
        return size

    def post(self, data: bytes) -> None:
        turn = self._writing
        if turn.taken or self.max_message is not None:
            return super().post(data)
        try:
            turn.taken = 1
            try:
                turn.lock.acquire()
                write = self._write_now
                if write is None:
                    raise self._refusal()
                try:
                    sent = write(data)
                except BlockingIOError:
                    sent = 0
                except OSError as error:
                    raise self._as_lost(error) from error
                if sent < len(data):
                    self._write_rest(memoryview(data), sent, monotonic() + WRITE_TIME)
            finally:
                turn.taken -= 1
                turn.lock.release()
        finally:
            if self._close_pending:
                self.close()

    def _write_rest(self, data: memoryview, sent: int, deadline: float | None) -> None:
        size = len(data)
        while sent < size:
            writable = any(fd == self._write_fd for fd, _ in self._write_poll.poll(poll_timeout(deadline)))
            # Close and loss show in the reading side's state as well as in an event of our own.
            if self._closing or self._state is not _OPEN:
                raise self._refusal()
            if writable:
                sent += self._send(data[sent:])
            if sent < size and deadline is not None and monotonic() >= deadline:
                self._write_given_up()
                raise self._late(sent, size)

    def _send(self, data: memoryview | bytes) -> int:
        try:
            return self._write_ready(data)
        except (BlockingIOError, InterruptedError):
            return 0
        except OSError as error:
            raise self._lose(error) from error

    # --- helpers for this class and its backends --------------------------------------------------

    def _wait_for(self, fd: int, events: int, deadline: float) -> bool:
        """Wait during `_open` for a descriptor of the backend's own; False at the deadline."""
        poll = make_poll()
        poll.register(fd, events)
        poll.register(self._read_waker.fileno(), READABLE)
        while True:
            ready = poll.poll(poll_timeout(deadline))
            if self._closing:
                raise self._closed()
            if any(number == fd for number, _ in ready):
                return True
            self._read_waker.clear()
            if monotonic() >= deadline:
                return False

    def _as_lost(self, error: OSError) -> LinkError:
        """Return the error to raise for an OSError of the backend: a loss, unless it says something else."""
        if isinstance(error, LinkError) and not isinstance(error, LinkLostError):
            return error
        return self._lose(error)

    def _lose(self, error: OSError) -> LinkLostError | LinkClosedError:
        """Enter the lost state for good (until the next open) and make the error that says so.

        While `close` waits for its turn, a backend's own threads may have ended the line: that is no loss.
        """
        if self._closing:
            return self._closed()
        if isinstance(error, LinkLostError):
            self._why_lost = str(error)
        else:
            self._why_lost = f"{self.url} was lost: {error.strerror or error}{self._lost_advice}"
        if self._state is _LinkState.OPEN:
            self._state = _LinkState.LOST
            self._read_now = self._write_now = None
            _log.debug("%s", self._why_lost)
            # The other direction must not wait on a dead line.
            self._read_waker.set()
            self._write_waker.set()
        return LinkLostError(self._why_lost, url=self.url)

    def _refusal(self) -> LinkLostError | LinkClosedError:
        if self._state is _LinkState.LOST and not self._closing:
            return LinkLostError(self._why_lost, url=self.url)
        return self._closed()

    def _closed(self) -> LinkClosedError:
        return LinkClosedError(f"{self.url} is closed", url=self.url)

    def _late(self, sent: int, size: int) -> LinkTimeoutError:
        took = f"{sent} of {size} bytes" if sent else f"none of {size} bytes"
        return LinkTimeoutError(f"{self.url} took {took} in time: the other side is not reading", url=self.url)
