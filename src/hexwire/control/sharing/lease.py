"""The lease of an arm: who may command it, and until when.

Owns the rules: one holder at a time, renewal by heartbeat, loss by silence, pre-emption by rank, and which orders
of the holder are accepted. Pure: time comes in as `now`, in seconds of a clock that also runs while the computer is
suspended. Must not know robots, networks or threads.
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
"""Greatest age of a set-point, seconds; also the greatest uncertainty of its age."""
_ID_BITS = 53
_ROUNDING = 1e-3
"""Seconds by which a set-point may seem to come from the future."""


@dataclass(slots=True)
class LeaseCounters:
    """Numbers of refused orders, by reason, and of lost and pre-empted leases.

    Attributes:
        without_lease: The sender did not hold the lease.
        too_old: The set-point was older than allowed.
        undated: The age of the set-point is unknown: the offset of the clocks is not known well enough.
        out_of_order: A later order of the same holder had been accepted.
        lost: Leases that ended by silence.
        preempted: Leases that were taken from their holder.
    """

    without_lease: int = 0
    too_old: int = 0
    undated: int = 0
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
        voided: Number of the last order that it made before a stop of its own; none up to it is accepted any more.
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
    voided: int = 0
    ends: float = math.inf
    watchdog: float = 0.0
    watchdog_mode: StopMode = StopMode.HOLD

    @property
    def finishing(self) -> bool:
        """The holder has left, and its motion ends."""
        return self.ends < math.inf


@dataclass(slots=True)
class Lease:
    """The lease of one arm. Not thread-safe, except `check`.

    Call `expire` before `take`, so that a holder whose time is over leaves the arm holding.

    Args:
        timeout: Seconds of silence after which a holder loses it.
        max_age: Greatest age of a set-point, and greatest uncertainty of that age, seconds.
        new_key: Makes keys that nobody can guess.

    Attributes:
        holder: The present holder, or None.
        heir: Name of the client that is about to get it, while the arm is made to hold; empty if nobody is.
        ended: How the last lease ended, in words; empty if it was given back, or if somebody has taken it since.
        counters: What was refused, and how leases ended.
    """

    timeout: float = TIMEOUT
    max_age: float = MAX_AGE
    new_key: Callable[[], int] = field(default=lambda: secrets.randbits(_ID_BITS) + 1, repr=False)
    holder: Grant | None = None
    heir: str = ""
    ended: str = ""
    counters: LeaseCounters = field(default_factory=LeaseCounters)
    _former: tuple[int, str] = field(default=(0, ""), repr=False)
    """Key of the last holder that lost the lease, and why. It gets that reason even if others hold it now."""
    _passing: int = field(default=0, repr=False)
    """Key of a holder from which it is being taken, until the next one has it."""

    # -- taking and leaving ---------------------------------------------------------------------------

    def check_take(self, rank: Rank, *, force: bool = False) -> None:
        """Check that a client may take the lease; changes nothing.

        Args:
            rank: Rank of the client.
            force: Pre-empt another holder of the same rank or a lower one.

        Raises:
            LeaseError: Another client holds it, and is not pre-empted.
        """
        holder = self.holder
        # A holder that has left only waits for the end of its motion: nobody needs to be asked.
        if holder is None or holder.finishing:
            return
        if not force:
            raise LeaseError(
                f"{holder.client} holds the lease; wait until it is given back, or take it with --take",
                holder=holder.client,
            )
        if rank < holder.rank:
            raise LeaseError(
                f"{holder.client} holds the lease, and your role may not take it", holder=holder.client
            )

    def revoke(self, why: str, heir: str = "") -> Grant | None:
        """End the lease of a holder that is pre-empted; returns the former holder, None if it has left already.

        Args:
            why: In words.
            heir: Name of the client that takes it next.
        """
        former, self.holder, self.heir = self.holder, None, heir
        if former is None or former.finishing:
            return None
        self.counters.preempted += 1
        self.ended = why
        self._former, self._passing = (former.key, why), former.key
        return former

    def take(self, client: str, rank: Rank, now: float, *, force: bool = False) -> Grant:
        """Grant the lease.

        Args:
            client: Name of the client, for display.
            rank: Its rank.
            now: Seconds.
            force: As in `check_take`.

        Raises:
            LeaseError: As `check_take`.
        """
        self.check_take(rank, force=force)
        self.revoke("")
        self.ended = ""
        self.holder, self._passing = Grant(self.new_key(), client, rank, now, now, now), 0
        return self.holder

    def taken_from(self, key: int) -> str:
        """Who has the lease, or is about to get it, that a client with this key had, in words; empty if nobody."""
        holder = self.holder
        if holder is None:
            return self.ended if key and self._passing == key else ""
        return f"{holder.client} holds the lease" if key and holder.key != key else ""

    def keep(self, key: int, now: float) -> Grant | None:
        """Renew the lease of a client that asks for a lease it holds; None if it does not hold it.

        Args:
            key: Key of the lease that the client had.
            now: Seconds.
        """
        try:
            return self.beat(key, now)
        except LeaseError:
            return None

    def void(self, key: int, sequence: int) -> None:
        """Void the orders that the holder made before a stop, since a stop may overtake them on the way.

        Call it when the stop arrives, in any thread: nothing here waits. Without effect for another program's stop.

        Args:
            key: Key of the lease of the program that stops.
            sequence: Number of the last order that it had made.
        """
        holder = self.holder
        # Only the holder's own stops write this number.
        if holder is not None and holder.key == key:
            holder.voided = max(holder.voided, sequence)

    def leave(self, key: int, now: float, ends: float = -math.inf) -> None:
        """Give the lease back; it ends now, or when the holder's motion ends. Without effect for a former holder.

        Args:
            key: The holder's.
            now: Seconds.
            ends: When the motion that the holder began ends.
        """
        try:
            holder = self.check(key, now)
        except LeaseError:
            return
        if ends > now:
            holder.ends = ends
        else:
            self.holder = None

    # -- signs of life and orders -----------------------------------------------------------------------

    def beat(self, key: int, now: float, idle: float = 0.0) -> Grant:
        """Renew the lease.

        Args:
            key: The holder's.
            now: Seconds.
            idle: Seconds since the holder's program last used the arm; what is no such time counts as 0.

        Raises:
            LeaseError: The client does not hold it.
        """
        holder = self.check(key, now)
        holder.heard = now
        holder.active = max(holder.active, now - idle if idle > 0.0 else now)
        return holder

    def admit(
        self,
        key: int,
        sequence: int,
        now: float,
        age: float | None = None,
        doubt: float = 0.0,
        *,
        frees: bool = False,
    ) -> Grant:
        """Accept an order of the holder.

        Args:
            key: The sender's.
            sequence: Number of the order; each is greater than the last.
            now: Seconds.
            age: Estimated age of a set-point, seconds; None for an order that may wait.
            doubt: Uncertainty of the age, seconds.
            frees: It switches torque off: no stop voids it.

        Raises:
            LeaseError: The order is refused, and counted.
        """
        try:
            holder = self.check(key, now)
        except LeaseError:
            self.counters.without_lease += 1
            raise
        if sequence <= holder.voided and not frees:
            self.counters.out_of_order += 1
            raise self._late(f"order {sequence} was made before a stop of the same program; it is not done")
        if not sequence > holder.sequence:
            self.counters.out_of_order += 1
            raise self._late(f"order {sequence} came after order {holder.sequence}; it is not done")
        # The number counts even if the order is too old: an older one must not follow.
        holder.sequence = sequence
        if age is not None:
            self.check_age(age, doubt)
        holder.heard = holder.active = now
        return holder

    def check_age(self, age: float, doubt: float) -> None:
        """Check that a set-point is not too old: when it arrives, and right before its bytes leave.

        Args:
            age: Its estimated age, seconds.
            doubt: Uncertainty of the age, seconds.

        Raises:
            LeaseError: It is too old, or its age is unknown. This is counted.
        """
        # Compared so that NaN is refused.
        if not 0.0 <= doubt <= self.max_age or not -_ROUNDING <= age + doubt < math.inf:
            self.counters.undated += 1
            raise self._late(
                "the age of the set-point is not known, since the clocks of this program and of the server are not "
                "related well enough; it is not done"
            )
        least = age - doubt
        if not least <= self.max_age:
            self.counters.too_old += 1
            raise self._late(
                f"the set-point is {1000 * least:.0f} ms old, more than {1000 * self.max_age:.0f} ms; "
                "it is not done"
            )

    def _late(self, why: str) -> LeaseError:
        return LeaseError(why, holder=self.holder.client if self.holder else "", lost=False)

    # -- time -------------------------------------------------------------------------------------------

    def expire(self, now: float) -> Grant | None:
        """End the lease if its time is over.

        Returns:
            The former holder if it fell silent, so that the arm must hold; otherwise None.
        """
        holder = self.holder
        if holder is None or now < self.due:
            return None
        self.holder = None
        if holder.finishing:
            return None
        self.counters.lost += 1
        self.ended = f"{holder.client} lost the lease after {self.timeout:g} s of silence"
        self._former = holder.key, self.ended
        return holder

    @property
    def due(self) -> float:
        """When `expire` ends the lease unless the holder renews it; infinite without a holder."""
        holder = self.holder
        return math.inf if holder is None else self._due(holder)

    def _due(self, holder: Grant) -> float:
        return holder.ends if holder.ends < math.inf else holder.heard + self.timeout

    def is_alive(self, now: float) -> bool:
        """Whether somebody holds the lease, or has left it to a motion that ends. Any thread may call this."""
        holder = self.holder
        return holder is not None and now < self._due(holder)

    def check(self, key: int, now: float) -> Grant:
        """Return the holder, if it has that key. Any thread may call this.

        Raises:
            LeaseError: The client does not hold the lease, or not any more.
        """
        holder = self.holder
        # Asked several times for each set-point: neither by `_due` nor by `finishing`.
        if (
            holder is not None
            and holder.key == key
            and now < holder.heard + self.timeout
            and holder.ends == math.inf
        ):
            return holder
        if holder is not None and holder.key != key:
            raise LeaseError(f"{holder.client} holds the lease", holder=holder.client)
        if holder is not None and not holder.finishing:
            raise LeaseError(f"the lease was lost after {self.timeout:g} s of silence")
        former, why = self._former
        raise LeaseError(why if key == former else "this program holds no lease")
