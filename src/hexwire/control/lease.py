"""The lease of an arm: who may command it, and until when.

Owns the rules: one holder at a time, renewal by heartbeat, loss by silence, pre-emption by rank, and which orders
of the holder are accepted. Pure: time comes in as `now`, in seconds of the owner's monotonic clock. Must not know
robots, networks or threads.
"""

from __future__ import annotations

import math
import secrets
from collections.abc import Callable
from dataclasses import dataclass, field

from hexwire.drivers.values import StopMode
from hexwire.errors import LeaseError

__all__ = ["Grant", "Lease", "LeaseCounters", "Rank"]

Rank = int
"""Whom a client may pre-empt: holders of its own rank and below. Greater is more."""

TIMEOUT = 0.5
"""Seconds of silence after which a lease is lost."""
MAX_AGE = 0.25
"""Greatest age of a set-point, seconds."""
_ID_BITS = 53


@dataclass(slots=True)
class LeaseCounters:
    """Numbers of refused orders, by reason, and of lost and pre-empted leases.

    Attributes:
        without_lease: The sender did not hold the lease.
        too_old: The set-point was older than allowed.
        out_of_order: A later order of the same holder had been accepted.
        lost: Leases that ended by silence.
        preempted: Leases that were taken from their holder.
    """

    without_lease: int = 0
    too_old: int = 0
    out_of_order: int = 0
    lost: int = 0
    preempted: int = 0


@dataclass(slots=True)
class Grant:
    """A lease that was granted.

    Attributes:
        key: Proves who holds it; known to the holder only.
        client: The holder in words, for display.
        rank: Its rank.
        since: When it was granted.
        heard: Its last sign of life.
        active: When its program last used the arm: silence of the program, not of its heartbeat thread.
        sequence: Number of its last accepted order.
        ends: For a holder that has left while a motion of its own ends: when it ends. Infinite otherwise.
        watchdog: Seconds without a call of the holder's program after which the arm is stopped; 0 for never.
        watchdog_mode: How it is stopped then.
    """

    key: int
    client: str
    rank: Rank
    since: float
    heard: float
    active: float
    sequence: int = 0
    ends: float = math.inf
    watchdog: float = 0.0
    watchdog_mode: StopMode = StopMode.HOLD


@dataclass(slots=True)
class Lease:
    """The lease of one arm. Not thread-safe.

    Args:
        timeout: Seconds of silence after which a holder loses it.
        max_age: Greatest age of an order, seconds.
        new_key: Makes keys that nobody can guess.

    Attributes:
        holder: The present holder, or None.
        ended: How the last lease ended, in words; empty if it was given back, or if somebody has taken it since.
        counters: What was refused, and how leases ended.
    """

    timeout: float = TIMEOUT
    max_age: float = MAX_AGE
    new_key: Callable[[], int] = field(default=lambda: secrets.randbits(_ID_BITS) + 1, repr=False)
    holder: Grant | None = None
    ended: str = ""
    counters: LeaseCounters = field(default_factory=LeaseCounters)

    def take(self, client: str, rank: Rank, now: float, *, force: bool = False) -> Grant:
        """Grant the lease.

        Args:
            client: Who asks, for display.
            rank: Its rank.
            now: Seconds.
            force: Pre-empt another holder of the same rank or a lower one.

        Raises:
            LeaseError: Another client holds it, and is not pre-empted.
        """
        holder = self.holder
        # A holder that has left only waits for the end of its motion: nobody needs to be asked.
        if holder is not None and holder.ends == math.inf:
            if not force:
                raise LeaseError(
                    f"{holder.client} holds the lease; wait until it is given back, or take it with --take",
                    holder=holder.client,
                )
            if rank < holder.rank:
                raise LeaseError(
                    f"{holder.client} holds the lease, and your role may not take it", holder=holder.client
                )
            self.counters.preempted += 1
        self.ended = ""
        self.holder = Grant(self.new_key(), client, rank, now, now, now)
        return self.holder

    def beat(self, key: int, now: float, idle: float = 0.0) -> Grant:
        """Renew the lease.

        Args:
            key: The holder's.
            now: Seconds.
            idle: Seconds since the holder's program last used the arm.

        Raises:
            LeaseError: The client does not hold it.
        """
        holder = self._check(key, now)
        holder.heard = now
        holder.active = max(holder.active, now - max(0.0, idle))
        return holder

    def admit(self, key: int, sequence: int, now: float, age: float | None = None) -> Grant:
        """Accept an order of the holder.

        Args:
            key: The sender's.
            sequence: Number of the order; each is greater than the last.
            now: Seconds.
            age: Least age that a set-point can have, seconds; None for an order that may wait.

        Raises:
            LeaseError: The order is refused, and counted.
        """
        try:
            holder = self._check(key, now)
        except LeaseError:
            self.counters.without_lease += 1
            raise
        if sequence <= holder.sequence:
            self.counters.out_of_order += 1
            raise LeaseError(
                f"order {sequence} came after order {holder.sequence}; it is not done", holder=holder.client
            )
        # The number counts even if the order is too old: an older one must not follow.
        holder.sequence = sequence
        if age is not None and not age <= self.max_age:
            self.counters.too_old += 1
            raise LeaseError(
                f"the set-point is {1000 * age:.0f} ms old, more than {1000 * self.max_age:.0f} ms; it is not done",
                holder=holder.client,
            )
        holder.heard = holder.active = now
        return holder

    def leave(self, key: int, now: float, ends: float = -math.inf) -> None:
        """Give the lease back; it ends now, or when the holder's motion ends. Without effect for a former holder.

        Args:
            key: The holder's.
            now: Seconds.
            ends: When the motion that the holder began ends.
        """
        if self.holder is None or self.holder.key != key:
            return
        if ends > now:
            self.holder.ends = ends
        else:
            self.holder = None

    def expire(self, now: float) -> Grant | None:
        """End the lease if its time is over.

        Returns:
            The former holder if it fell silent, so that the arm must hold; otherwise None.
        """
        holder = self.holder
        if holder is None or now < self.due:
            return None
        self.holder = None
        if holder.ends < math.inf:
            return None
        self.counters.lost += 1
        self.ended = f"{holder.client} lost the lease after {self.timeout:g} s of silence"
        return holder

    @property
    def due(self) -> float:
        """When `expire` ends the lease unless the holder renews it; infinite without a holder."""
        holder = self.holder
        if holder is None:
            return math.inf
        return holder.ends if holder.ends < math.inf else holder.heard + self.timeout

    def _check(self, key: int, now: float) -> Grant:
        holder = self.holder
        if holder is not None and holder.key == key and holder.ends == math.inf and now < self.due:
            return holder
        if holder is not None and holder.key != key:
            raise LeaseError(f"{holder.client} holds the lease", holder=holder.client)
        why = self.ended or "this program holds no lease"
        raise LeaseError(f"{why}; take the lease again")
