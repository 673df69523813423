"""An order to a shared arm, and the check whether it may be carried out.

Owns when an order is checked: when it is admitted, and right before its bytes leave. Must not know what the order
does, nor the rules of the lease.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import TYPE_CHECKING

from hexwire.errors import LeaseError

if TYPE_CHECKING:
    from hexwire.epochs import Token

    from .lease import Grant, Lease

__all__ = ["Order", "OrderCheck"]


class Order:
    """What the check of an order needs: its sender, and when it was made and arrived.

    Args:
        key: Key of the sender's lease.
        sequence: Number of the order; each is greater than the last.
        arrived: Token of the robot's epochs at its arrival; a later stop cancels the order.
        made: When it was made, seconds of the owner's clock as the sender estimates it; None for an order that may
            wait.
        doubt: Uncertainty of that time, seconds.
    """

    __slots__ = ("arrived", "doubt", "key", "made", "sequence")

    def __init__(
        self, key: int, sequence: int, arrived: Token, made: float | None = None, doubt: float = 0.0
    ) -> None:
        self.key, self.sequence, self.arrived, self.made, self.doubt = key, sequence, arrived, made, doubt


class OrderCheck:
    """Checks orders against the rules of a lease. Any thread may call its methods.

    Args:
        lease: The rules.
        lock: Guards the rules; it is never held while waiting for the line of the arm.
        clock: The clock of the lease, seconds.
        now: The owner's clock, seconds.
    """

    def __init__(
        self,
        lease: Lease,
        lock: AbstractContextManager[object],
        clock: Callable[[], float],
        now: Callable[[], float],
    ) -> None:
        self._lease, self._lock, self._clock, self._now = lease, lock, clock, now

    def admit(self, order: Order, *, frees: bool = False) -> Grant:
        """Accept an order of the holder; raises `LeaseError`, as `Lease.admit`, which see for `frees`."""
        with self._lock:
            # Not earlier: waiting for the locks makes a set-point older.
            age = None if order.made is None else self._now() - order.made
            return self._lease.admit(order.key, order.sequence, self._clock(), age, order.doubt, frees=frees)

    def refusal(self, key: int) -> LeaseError:
        """Count an order from somebody who does not hold the lease; returns the error for it."""
        with self._lock:
            self._lease.counters.without_lease += 1
            try:
                self._lease.check(key, self._clock())
            except LeaseError as error:
                return error
        return LeaseError("the lease has just changed hands; nothing was done", lost=False)

    def of_targets(self) -> LeaseError | None:
        """Why no controller may send a target now; None if controllers may."""
        if self._lease.is_alive(self._clock()):
            return None
        return LeaseError(self._lease.ended or "nobody holds the lease")

    def token(self, order: Order) -> Token:
        """Token that cancels an admitted order after a stop, the end of the lease, or too long a wait."""

        def refusal() -> LeaseError | None:
            try:
                self._lease.check(order.key, self._clock())
            except LeaseError as error:
                return error
            return None

        return replace(order.arrived, refusal=refusal, late=self._lateness(order))

    def _lateness(self, order: Order) -> Callable[[], LeaseError | None] | None:
        """Check for the age of a set-point until its first bytes leave."""
        made, leaving = order.made, False
        if made is None:
            return None

        def late() -> LeaseError | None:
            nonlocal leaving
            try:
                if not leaving:
                    with self._lock:
                        self._lease.check_age(self._now() - made, order.doubt)
            except LeaseError as error:
                return error
            # Some robots need several packets for a target; half a target is worse than a late one.
            leaving = True
            return None

        return late
