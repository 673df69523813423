"""Set-points that are published and not answered: what a server tells of them, and what a client learns.

An answer to each set-point of a stream would cost both programs as much again as the set-point. So the states,
which the client reads anyway, say which orders were dealt with, and why the last one was refused. Owns when a
client publishes, and what it concludes. Must not know Zenoh, nor how a set-point is done.
"""

from __future__ import annotations

import math
import os
import threading
from typing import TYPE_CHECKING

from hexwire.errors import HexwireError, LeaseError, PreemptedError, ReplyTimeoutError, StoppedError

from . import messages as m
from .failures import describe, restore

if TYPE_CHECKING:
    from hexwire.model.state import SentTarget

__all__ = ["LONGEST", "SetPointReports", "SharedSetPoints"]

LONGEST = 0.25
"""Seconds; a target of longer duration is no set-point, but a motion that its sender waits for."""
_ANSWERED = 5
"""Set-points in a row that are answered before others are published."""
_PAUSE = 0.1
"""Most seconds between two of them."""
_LATE = 2.0
"""Seconds after which a set-point that no state tells of counts as lost, as an answer to it would."""
_SILENT = 0.5
"""Seconds without a state after which set-points are asked again."""
_MOST_WAITING = 50
"""Published set-points of which no state has told yet; the next one is asked. So a server that is slow or halted
slows the program down, before its queue or that of the network is full."""
_NUMBER_BYTES = 6


class SetPointReports:
    """What a server tells of the published set-points. Any thread may call its methods."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._key, self._report = 0, m.Stream(0)

    def number(self, key: int) -> int:
        """The number of the lease with this key, another one for each lease."""
        with self._lock:
            if key != self._key:
                self._key, self._report = key, m.Stream(int.from_bytes(os.urandom(_NUMBER_BYTES)) | 1)
            return self._report.lease

    @property
    def dealt(self) -> tuple[int, int]:
        """Number of a lease, and of its last order that was done or refused."""
        report = self._report
        return report.lease, report.dealt

    def done(self, key: int, sequence: int, sent: SentTarget) -> None:
        """Note that a set-point was done."""
        with self._lock:
            if key == self._key:
                old = self._report
                self._report = m.Stream(
                    *(old.lease, max(old.dealt, sequence), old.refused, old.last, old.kind, old.text, old.details),
                    *(sent.clamped, sent.silent),
                )

    def refuse(self, key: int, sequence: int, error: HexwireError) -> None:
        """Note that a set-point was refused."""
        kind, text, details = describe(error)
        with self._lock:
            if key == self._key:
                old = self._report
                self._report = m.Stream(
                    *(old.lease, max(old.dealt, sequence), old.refused + 1, sequence, kind, text, details),
                    *(old.clamped, old.silent),
                )

    def report(self, key: int, dealt: tuple[int, int]) -> m.Stream | None:
        """What a state tells; None before the lease has a number, and once another one has.

        Args:
            key: Of the present lease; 0 if nobody holds it.
            dealt: As the property, when the values of the state were sampled.
        """
        with self._lock:
            if not key or key != self._key:
                return None
            newest = self._report
        before = dealt[1] if dealt[0] == newest.lease else 0
        if before == newest.dealt:
            return newest
        return m.Stream(
            *(newest.lease, before, newest.refused, newest.last, newest.kind, newest.text, newest.details),
            *(newest.clamped, newest.silent),
        )


class SharedSetPoints:
    """Which set-points of a client are published, and what became of them. Any thread may call its methods.

    Args:
        url: Address of the arm, for error texts.

    Attributes:
        lease: Number of the client's lease; 0 if it has none, or the server tells nothing of set-points.
        renewed: When the last set-point was made that has renewed the lease, seconds.
        refused: Number of refused set-points.
        clamped: Joints of the last one that was done that were clamped, as in `SentTarget`.
        silent: Joints of that one that gave no answer.
    """

    def __init__(self, url: str) -> None:
        self.lease, self.renewed, self.refused = 0, -math.inf, 0
        self.clamped: tuple[str, ...] = ()
        self.silent: tuple[str, ...] = ()
        # A signal handler may stop the arm at any line here: it may come in, and each change is one assignment.
        self._url, self._lock = url, threading.RLock()
        # Set-points in a row that were answered, and when the last one was made.
        self._row, self._last = 0, -math.inf
        self._arrived = -math.inf
        # Published ones of which no state has told yet: number, and when it was made.
        self._waiting: tuple[tuple[int, float], ...] = ()
        # The refusals that are known, and the last order whose end the client knows by other means.
        self._known = self._barrier = 0
        self._seen = False
        self._error: HexwireError | None = None

    def begin(self, lease: int) -> None:
        """A lease was taken, kept or given back: its number, 0 for none."""
        with self._lock:
            if lease != self.lease:
                self.lease, self._seen, self._known = lease, False, 0
                self._forget(0)

    def lose(self, error: LeaseError) -> None:
        """The lease was lost, as this error says."""
        with self._lock:
            if self._waiting:
                self._fail(error)
            self.lease, self._seen, self._known = 0, False, 0

    def answered(self, sequence: int, now: float, *, set_point: bool) -> None:
        """Note an order that was answered, or a stop: nobody needs to hear of the set-points before it any more."""
        with self._lock:
            goes_on = set_point and now - self._last <= _PAUSE
            self._forget(sequence)
            self._row, self._last = (self._row + 1 if goes_on else 1 if set_point else 0), now

    def _forget(self, barrier: int) -> None:
        self._barrier, self._waiting, self._error = barrier, (), None

    def runs(self, now: float) -> bool:
        """Whether a set-point that is made now belongs to a stream, and states will tell of it."""
        steady = self._row >= _ANSWERED and now - self._last <= _PAUSE
        return steady and self._seen and now - self._arrived < _SILENT and len(self._waiting) < _MOST_WAITING

    def published(self, sequence: int, now: float) -> None:
        """Note a set-point that is about to be published."""
        with self._lock:
            self._waiting = (*self._waiting, (sequence, now))
            self._last = now

    @property
    def waits(self) -> bool:
        """Whether no state has told yet what became of some set-point."""
        return bool(self._waiting)

    def look(self, state: m.State | None, arrived: float) -> None:
        """Learn from the newest state.

        Args:
            state: The state; None if there is none.
            arrived: When it arrived, seconds.
        """
        if state is None or not self.lease:
            return
        with self._lock:
            self._arrived, told = arrived, state.stream
            if told is None or told.lease != self.lease:
                if self._seen and self._waiting:
                    self._fail(_lost(state))
                return
            self._seen = True
            self.clamped, self.silent = told.clamped, told.silent
            new, self._known = told.refused - self._known, told.refused
            self.refused += max(0, new)
            if new > 0 and told.last > self._barrier:
                self._fail(restore(told.kind, told.text, told.details))
                return
            over = max(told.dealt, self._barrier)
            done = [made for sequence, made in self._waiting if sequence <= over]
            if done:
                self.renewed = done[-1]
                self._waiting = tuple(each for each in self._waiting if each[0] > over)
            waiting = self._waiting
            if waiting and arrived - waiting[0][1] > _LATE:
                self._fail(ReplyTimeoutError(f"a set-point at {self._url}"))

    def _fail(self, error: HexwireError) -> None:
        # Once for all that were published meanwhile.
        self._forget(max([self._barrier, *(sequence for sequence, _ in self._waiting)]))
        self._row, self._error = 0, error

    def take_error(self) -> HexwireError | None:
        """Why a set-point was refused, once; None if none was. For the next order."""
        error, self._error = self._error, None
        return error

    def take_error_of_read(self, now: float, *, stopped: bool) -> HexwireError | None:
        """The same for somebody who reads, if no set-point follows, whose write would raise it.

        Args:
            now: Seconds.
            stopped: The state shows that the arm is stopped; that is kept for the next order.
        """
        error = self._error
        if error is None or now - self._last < LONGEST:
            return None
        return None if stopped and isinstance(error, StoppedError | PreemptedError) else self.take_error()


def _lost(state: m.State) -> LeaseError:
    """Why the lease is not ours any more."""
    holder = f"{state.holder} holds the lease" if state.holder else ""
    return LeaseError(state.held or holder or "the lease was lost", holder=state.holder)
