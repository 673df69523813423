"""Epochs: a stop cancels every call that was made before it and has not been sent yet.

Owns the epochs of one arm, and the call that each thread executes. Must not know links or frames. Every stop begins
an epoch at the moment it is called. A call belongs to the epoch in which it was made, however long it waits for the
line, for a reconnection or for a read, and however many requests it sends.

What stops an arm without a call of this host (its board's latch, the path check, the loss of the robot) voids what
was asked for before it as well, but begins no epoch: nobody has to resume from it here.

Nothing here locks, because a signal handler may stop the arm at any line of this file. An epoch is a unique object,
and every change is a single assignment.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import NamedTuple, Self, TypeVar

from hexwire.errors import HexwireError, PreemptedError, StoppedError

__all__ = ["Epochs", "Token"]

_T = TypeVar("_T")

_A_MOMENT, _LONGEST = 0.001, 1000
_MEETINGS = 10
"""Stops that torque off meets at most, one after another, before it gives up."""
_CAME = "a stop came after the call; `resume()` first, then call it again"
_OVER = "a stop came after the call, and is over; call it again"
_UNDER_WAY = "the arm is being stopped; when that is done, `resume()` first"
_UNCONFIRMED = "a stop was not confirmed; check the arm, then `resume()`"
_RESUMED = "it was called while the arm was stopped; call it again"
_LIMP = "torque was switched off after the call; call it again"


class Token(NamedTuple):
    """The time of a call, relative to stops.

    Attributes:
        epoch: The last stop before the call.
        stopped: That stop still held at the call, as far as the host knows.
        urgent: The call is the stop itself.
        refusal: A further condition: returns the error with which the call is refused, or None. Asked whenever the
            epoch is checked, so also right before the bytes leave. Must not block.
        late: As `refusal`, but called only right before the first bytes of a request that acts leave.
            Must not wait for the line.
        voided: The last stop before the call that no call of this host made.
        limp: The last time before the call that torque was switched off; None if that does not void it.
        frees: The call switches torque off: no stop voids it.
    """

    epoch: object
    stopped: bool
    urgent: bool = False
    refusal: Callable[[], HexwireError | None] | None = None
    late: Callable[[], HexwireError | None] | None = None
    voided: object = None
    limp: object = None
    frees: bool = False


class _Calls(threading.local):
    """The call that each thread executes; None outside calls."""

    token: Token | None = None


class Epochs:
    """The stops of one arm, shared by all its sessions, buses and drivers.

    Attributes:
        number: Another one after each stop; for those to whom a token cannot be given, such as pages.
        calls: Has the token of the call that this thread executes.
    """

    def __init__(self) -> None:
        self._current: object = object()
        self._ended: object = self._current
        self._failed: object = None
        self._voided: object = object()
        self._limp: object = object()
        self._unstopped = Token(self._current, False, voided=self._voided, limp=self._limp)
        self.number = 0
        self._numbers = itertools.count(1)
        self._under_way: set[object] = set()
        self._stopper = 0
        self.calls = _Calls()
        self._wakes: list[Callable[[], None]] = []

    @property
    def stopped(self) -> bool:
        """Whether the host stopped the arm and has not resumed it; the only latch if no board latches a stop."""
        return self._ended is not self._current

    @property
    def failed(self) -> bool:
        """Whether the last stop is unconfirmed; then only `resume` and torque off are allowed until `resume`."""
        return self.stopped and self._failed is self._current

    @property
    def stopped_by_this_thread(self) -> bool:
        """Whether this thread called the last stop, perhaps in a signal handler that interrupted a call."""
        return self._stopper == threading.get_ident()

    def stopped_since(self, token: Token) -> bool:
        """Whether the arm was stopped after that call, by whomever."""
        return token.epoch is not self._current or token.voided is not self._voided

    def stopped_here_since(self, token: Token) -> bool:
        """Whether this thread called the last stop, and did so after that call."""
        return token.epoch is not self._current and self.stopped_by_this_thread

    def on_stop(self, wake: Callable[[], None]) -> None:
        """Register a function that is called when a stop begins, to wake a waiting thread."""
        self._wakes.append(wake)

    def let_through(self) -> None:
        """Wait while another thread stops the arm, so that continuous reads do not keep the line busy."""
        for _ in range(_LONGEST):
            if not self._under_way or self.stopped_by_this_thread:
                return
            time.sleep(_A_MOMENT)

    def forget(self) -> None:
        """Forget all stops; for a newly attached arm."""
        self._ended, self._failed = self._current, None

    def assume_stopped(self) -> None:
        """Assume that a stop of another program holds."""
        self._current = object()
        self.number = next(self._numbers)

    def void(self) -> None:
        """Void what was asked for before now: the arm was stopped, but not by a call of this host."""
        self._voided = object()
        self.number = next(self._numbers)

    @contextmanager
    def torque_off(self) -> Iterator[None]:
        """Void what was asked for before torque is switched off, which no stop voids; put the block around that.

        The call that this thread executes goes on, as one that was made now.
        """
        token = self.calls.token
        self._limp = limp = object()
        # Another torque off at the same time does not refuse this one, only what comes after it.
        try:
            now = self.mark()
            own = now if token is None else token._replace(epoch=now.epoch, voided=now.voided)
            with self.using(own._replace(limp=None, frees=True)):
                yield
        finally:
            if token is not None:
                self.calls.token = token._replace(limp=limp)

    def free(self, switch_off: Callable[[], _T]) -> _T:
        """Switch torque off: at once, and again after a stop that was under way meanwhile.

        A stop takes the line from what is being sent, and a joint may hold by it that has just lost its torque.

        Args:
            switch_off: Does it; may be called several times.
        """
        with self.torque_off():
            for _ in range(_MEETINGS):
                before = self._quiet
                try:
                    done = switch_off()
                except (StoppedError, PreemptedError):
                    self.let_through()
                    continue
                if before is not None and before is self._quiet:
                    return done
                self.let_through()
                if self._under_way:
                    # It takes long, or this is a part of it.
                    return done
            return switch_off()

    @property
    def _quiet(self) -> object | None:
        """The last stop, which is over; None while one is under way."""
        return None if self._under_way else self._current

    def limp_since(self, token: Token) -> bool:
        """Whether torque was switched off after that call."""
        return token.limp not in (None, self._limp)

    # -- calls ----------------------------------------------------------------------------------------

    def token(self, what: str, *, freeing: bool = False) -> Token:
        """Return the token of the call that this thread executes, or of a new call if there is none.

        Args:
            what: Name of the call, for error texts.
            freeing: The call ends a stop or switches torque off, which is allowed after an unconfirmed stop.

        Raises:
            StoppedError: A stop is under way, or was not confirmed.
        """
        mine = self.calls.token
        if mine is not None:
            return mine
        if self._under_way:
            raise StoppedError.unsent(what, StoppedError.STATUS, _UNDER_WAY)
        # What only frees the arm must not be refused because somebody else frees it, too.
        current, voided, limp = self._current, self._voided, None if freeing else self._limp
        if self._ended is current:
            if freeing:
                return Token(current, False, voided=voided)
            # The same object until the next stop: a control loop makes a call a millisecond.
            token = self._unstopped
            if token.epoch is not current or token.voided is not voided or token.limp is not limp:
                self._unstopped = token = Token(current, False, voided=voided, limp=limp)
            return token
        if self._failed is current and not freeing:
            raise StoppedError.unsent(what, StoppedError.STATUS, _UNCONFIRMED)
        return Token(current, True, voided=voided, limp=limp)

    def mark(self) -> Token:
        """Return a token of the present: the next stop cancels it, even if the arm is stopped now."""
        # The same object until the next stop: the owner of an arm asks a hundred times a second.
        token = self._unstopped
        if token.epoch is self._current and token.voided is self._voided and token.limp is self._limp:
            return token
        self._unstopped = token = Token(self._current, False, voided=self._voided, limp=self._limp)
        return token

    @property
    def of_this_call(self) -> Token | None:
        """Token of the call that this thread executes; None outside calls."""
        return self.calls.token

    def holds(self, token: Token) -> bool:
        """Whether requests of that call may still be sent."""
        if self.undisturbed(token) or token.urgent:
            return True
        return self._refused(token) is None and (token.refusal is None or token.refusal() is None)

    def undisturbed(self, token: Token) -> bool:
        """Whether nothing has come since that call, no stop holds, and nothing else refuses it: the usual case."""
        return (
            token.epoch is self._current is self._ended
            and token.voided is self._voided
            and token.limp is self._limp
            and not token.stopped
            and token.refusal is token.late is None
        )

    def _refused(self, token: Token) -> str | None:
        """Why requests of that call must not be sent any more; None if they may."""
        # Torque off takes nothing back from a stop, and must not be lost.
        if token.frees:
            return None
        # Asked several times for each target: not by `stopped_since` and `limp_since`.
        if token.epoch is not self._current or token.voided is not self._voided:
            # A stop that no call of this host made may still be latched.
            return _CAME if self.stopped or token.voided is not self._voided else _OVER
        if token.stopped and self._ended is token.epoch:
            return _RESUMED
        return None if token.limp is None or token.limp is self._limp else _LIMP

    def check(self, token: Token, what: str) -> None:
        """Refuse a call made before a stop or torque off; call this while holding the line, before bytes leave.

        Raises:
            StoppedError: The arm was stopped after the call, or its torque was switched off.
            HexwireError: The refusal of the token.
        """
        if token.urgent:
            return
        if (why := self._refused(token)) is not None:
            raise StoppedError.unsent(what, StoppedError.STATUS, why)
        if token.refusal is not None and (error := token.refusal()) is not None:
            raise error

    def check_leaving(self, token: Token, what: str) -> None:
        """As `check`, for a request that acts and is next on the line: also refuse one that has waited too long.

        Raises:
            StoppedError: The arm was stopped after the call.
            HexwireError: The refusal of the token.
        """
        if self.undisturbed(token):
            return  # the line is idle meanwhile
        self.check(token, what)
        if token.late is not None and (error := token.late()) is not None:
            raise error

    def calling(self, what: str, *, freeing: bool = False) -> _Within:
        """Make everything in a `with` block part of one call: a new one, or the one that this thread executes.

        Raises:
            StoppedError: As `token`.
        """
        return _Within(self.calls, self.token(what, freeing=freeing))

    def using(self, token: Token | None) -> _Within:
        """Make everything in a `with` block part of an earlier call, perhaps one of another thread."""
        return _Within(self.calls, token)

    # -- stops ----------------------------------------------------------------------------------------

    def stopping(self) -> _Stopping:
        """Begin a stop for a `with` block; it is confirmed unless the block raises."""
        return _Stopping(self)

    def begin(self, stop: object) -> None:
        """Cancel the calls made before this stop."""
        self._under_way.add(stop)
        self._current = stop
        self.number = next(self._numbers)
        self._stopper = threading.get_ident()
        for wake in tuple(self._wakes):
            wake()

    def end(self, stop: object, *, confirmed: bool) -> None:
        """Finish a stop; after an unconfirmed stop everything is refused until `resume`."""
        if not confirmed:
            self._failed = stop
        self._under_way.discard(stop)

    def unconfirmed(self) -> None:
        """Mark the stop that this thread executes as unconfirmed, although it raised no error."""
        token = self.calls.token
        if token is not None and token.urgent:
            self._failed = token.epoch

    def resumed(self, token: Token) -> None:
        """End the stop before this call, but not a later one."""
        self._ended = token.epoch


class _Within:
    __slots__ = ("_before", "_calls", "token")

    def __init__(self, calls: _Calls, token: Token | None) -> None:
        self._calls, self.token = calls, token
        self._before: Token | None = None

    def __enter__(self) -> Self:
        self._before, self._calls.token = self._calls.token, self.token
        return self

    def __exit__(self, *_: object) -> None:
        self._calls.token = self._before


class _Stopping:
    def __init__(self, epochs: Epochs) -> None:
        self._epochs = epochs
        self._within: _Within | None = None
        self._stop: object = None

    def __enter__(self) -> Self:
        epochs = self._epochs
        self._stop = stop = object()
        try:
            epochs.begin(stop)
            self._within = _Within(epochs.calls, Token(stop, True, True))
            self._within.__enter__()
        except BaseException:
            epochs.end(stop, confirmed=False)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._within is not None:
            self._within.__exit__(kind, error, trace)
        self._epochs.end(self._stop, confirmed=error is None)
