"""What a stop voids: every call that was made before it and has not been sent yet.

Owns the epochs of one arm, and which call a thread is in. Must not know links, frames or what a call does. Every
stop begins an epoch, at the moment it is called. A call belongs to the epoch it was made in, however long it waits
for the line, for a reconnection or for what it must read first, and however many requests it is made of.

Nothing here locks: a signal handler may stop the arm in the middle of any line of this file. An epoch is an object
of its own, and every change is one assignment.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import NamedTuple, Self

from hexwire.errors import StoppedError

__all__ = ["Epochs", "Token"]

_A_MOMENT, _LONGEST = 0.001, 1000
_STOPPED = 5
"""Status `stopped` of PROTOCOL.md section 6.2."""
_CAME = "a stop came after it was called; `resume()` first, then call it again"
_UNDER_WAY = "the arm is being stopped; `resume()` first, when that is done"
_UNCONFIRMED = "a stop was not confirmed; see to the arm, then `resume()`"
_RESUMED = "it was called while the arm was stopped; call it again"


class Token(NamedTuple):
    """When a call was made.

    Attributes:
        epoch: The stop before it.
        stopped: That stop was not ended then, as far as this side knows.
        urgent: It is the stop itself.
    """

    epoch: object
    stopped: bool
    urgent: bool = False


class _Local(threading.local):
    token: Token | None = None


class Epochs:
    """The stops of one arm, however many sessions, buses and drivers lead to it."""

    def __init__(self) -> None:
        self._current: object = object()
        self._ended: object = self._current
        self._failed: object = None
        self._under_way: set[object] = set()
        self._stopper = 0
        self._local = _Local()
        self._wakes: list[Callable[[], None]] = []

    @property
    def stopped(self) -> bool:
        """Stopped from this side, and not resumed. Where no board latches a stop, this is all there is."""
        return self._ended is not self._current

    @property
    def failed(self) -> bool:
        """The last stop was not confirmed; only `resume` and torque off are allowed until `resume`."""
        return self.stopped and self._failed is self._current

    @property
    def stopped_by_this_thread(self) -> bool:
        """The last stop was called in this thread: perhaps by a signal handler in the middle of something."""
        return self._stopper == threading.get_ident()

    def on_stop(self, wake: Callable[[], None]) -> None:
        """Have something woken when a stop begins, that it may look up."""
        self._wakes.append(wake)

    def let_through(self) -> None:
        """Wait while another thread stops the arm: who asks all the time must not keep the line from it."""
        for _ in range(_LONGEST):
            if not self._under_way or self.stopped_by_this_thread:
                return
            time.sleep(_A_MOMENT)

    def forget(self) -> None:
        """Nothing is known of any stop: the arm is met anew."""
        self._ended, self._failed = self._current, None

    def assume_stopped(self) -> None:
        """A stop of another program holds."""
        self._current = object()

    # -- calls ----------------------------------------------------------------------------------------

    def token(self, what: str, *, freeing: bool = False) -> Token:
        """The token of the call that this thread is in; of one that begins now if it is in none.

        Args:
            what: The call, for people.
            freeing: It ends a stop or takes torque away, which may be done after a stop that was not confirmed.

        Raises:
            StoppedError: A stop is under way, or was not confirmed.
        """
        mine = self._local.token
        if mine is not None:
            return mine
        if self._under_way:
            raise StoppedError.unsent(what, _STOPPED, _UNDER_WAY)
        current = self._current
        stopped = self._ended is not current
        if stopped and self._failed is current and not freeing:
            raise StoppedError.unsent(what, _STOPPED, _UNCONFIRMED)
        return Token(current, stopped)

    def mark(self) -> Token:
        """The present: what is planned now is void after the next stop, whether the arm is stopped now or not."""
        return Token(self._current, False)

    @property
    def of_this_call(self) -> Token | None:
        """The token of the call that this thread is in, if it is in one."""
        return self._local.token

    def holds(self, token: Token) -> bool:
        """Whether what was called then may still be sent."""
        if token.urgent:
            return True
        return token.epoch is self._current and not (token.stopped and self._ended is token.epoch)

    def check(self, token: Token, what: str) -> None:
        """Refuse what was called before a stop; right before its bytes leave, with the line in hand.

        Raises:
            StoppedError: A stop came since.
        """
        if not self.holds(token):
            raise StoppedError.unsent(what, _STOPPED, _CAME if token.epoch is not self._current else _RESUMED)

    def calling(self, what: str, *, freeing: bool = False) -> _Within:
        """All that this thread does inside belongs to one call that begins now, or to the one it is in.

        Raises:
            StoppedError: As `token`.
        """
        return _Within(self._local, self.token(what, freeing=freeing))

    def using(self, token: Token | None) -> _Within:
        """All that this thread does inside belongs to a call that was made before, perhaps in another thread."""
        return _Within(self._local, token)

    # -- stops ----------------------------------------------------------------------------------------

    def stopping(self) -> _Stopping:
        """A stop begins now, and is confirmed unless an error comes out of it."""
        return _Stopping(self)

    def begin(self, stop: object) -> None:
        """Void what was called before this stop."""
        self._under_way.add(stop)
        self._current = stop
        self._stopper = threading.get_ident()
        for wake in tuple(self._wakes):
            wake()

    def end(self, stop: object, *, confirmed: bool) -> None:
        """A stop is over; one that was not confirmed refuses all until `resume`."""
        if not confirmed:
            self._failed = stop
        self._under_way.discard(stop)

    def unconfirmed(self) -> None:
        """The stop that this thread is in was not confirmed, though no error came of it."""
        token = self._local.token
        if token is not None and token.urgent:
            self._failed = token.epoch

    def resumed(self, token: Token) -> None:
        """The stop before this call is ended; one that came after it is not."""
        self._ended = token.epoch


class _Within:
    def __init__(self, local: _Local, token: Token | None) -> None:
        self._local, self.token = local, token
        self._before: Token | None = None

    def __enter__(self) -> Self:
        self._before, self._local.token = self._local.token, self.token
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._local.token = self._before


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
            self._within = _Within(epochs._local, Token(stop, True, True))
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
