"""An impaired link: it splits, delays, drops, flips, duplicates, reorders and freezes, reproducibly from a seed.

Owns the faults of a bad line, in either direction. Wraps any link and needs no thread. Time comes from a clock,
which may be simulated. Must not know what the bytes mean.
"""

from __future__ import annotations

import heapq
import itertools
import random
import threading
from collections.abc import Callable
from dataclasses import dataclass, fields
from time import monotonic
from typing import cast

from hexwire.errors import LinkTimeoutError, UsageError

from .base import Link, LinkKind

__all__ = ["NOTHING", "ImpairedLink", "Impairment", "ImpairmentCounters", "Lane"]

# Maximum number of pieces that a lane holds back; beyond that it drops them, like a full buffer on a real line.
_MOST_WAITING = 10_000


@dataclass(frozen=True)
class Impairment:
    """The faults of one direction of a line.

    The first seven are probabilities from 0 to 1 per unit: a message of a datagram link, or one write or read of a
    stream.

    Attributes:
        split: The unit arrives in two to four pieces. Streams only: a datagram is whole or lost.
        drop: A datagram is lost; a stream loses a run of bytes somewhere in the unit.
        flip: One bit is inverted.
        duplicate: A datagram arrives twice; a stream repeats a run of bytes.
        reorder: The unit arrives after the next one, or `delay_time` later if there is none.
        delay: The unit is late. On a stream everything after it waits; a datagram may be overtaken.
        freeze: The direction stops, with the unit at its head.
        delay_time: Longest delay in seconds.
        freeze_time: Duration of a freeze in seconds.
    """

    split: float = 0.0
    drop: float = 0.0
    flip: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    delay: float = 0.0
    freeze: float = 0.0
    delay_time: float = 0.02
    freeze_time: float = 0.5

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if not 0.0 <= value <= (1.0 if not item.name.endswith("_time") else 3600.0):
                raise UsageError(f"{item.name} of an impaired line cannot be {value}")

    @classmethod
    def all_of(cls, probability: float) -> Impairment:
        """The same probability for each of the seven faults."""
        return cls(*[probability] * 7)


NOTHING = Impairment()


@dataclass
class ImpairmentCounters:
    """Counts of the faults in one direction."""

    units: int = 0
    split: int = 0
    dropped: int = 0
    flipped: int = 0
    duplicated: int = 0
    reordered: int = 0
    delayed: int = 0
    frozen: int = 0
    overflowed: int = 0


class Lane:
    """One direction of a bad line: units come out changed, and possibly at another time.

    Args:
        impairment: The faults.
        kind: Stream or datagram.
        seed: Two lanes with the same seed treat the same units alike.
    """

    def __init__(self, impairment: Impairment, kind: LinkKind, seed: str) -> None:
        self.counters = ImpairmentCounters()
        self._impairment = impairment
        self._stream = kind is LinkKind.STREAM
        self._random = random.Random(seed)
        # Output time, rank that preserves the order of arrival, bytes.
        self._waiting: list[tuple[float, int, bytes]] = []
        self._ranks = itertools.count()
        self._held: list[bytes] = []
        self._held_until = 0.0
        self._not_before = 0.0
        self._frozen_until = 0.0

    def put(self, data: bytes, now: float) -> None:
        """Put a unit in."""
        count, bad = self.counters, self._impairment
        count.units += 1
        # The same number of random draws for each unit, so that one fault does not shift all later ones.
        split, drop, flip, duplicate, reorder, delay, freeze = (self._random.random() for _ in range(7))
        choice = random.Random(self._random.getrandbits(64))
        copies = 1
        if drop < bad.drop:
            count.dropped += 1
            data = self._without_a_run(data, choice)
        if data and flip < bad.flip:
            count.flipped += 1
            data = _with_a_flip(data, choice)
        if data and duplicate < bad.duplicate:
            count.duplicated += 1
            if self._stream:
                data = _with_a_repeat(data, choice)
            else:
                copies = 2
        due = now
        if delay < bad.delay:
            count.delayed += 1
            due = now + choice.uniform(0.0, bad.delay_time)
        if freeze < bad.freeze:
            count.frozen += 1
            self._frozen_until = max(self._frozen_until, now + bad.freeze_time)
        if not data:
            return
        pieces = [data] * copies
        if self._stream and split < bad.split and len(data) > 1:
            count.split += 1
            pieces = _pieces(data, choice)
        if reorder < bad.reorder and not self._held:
            count.reordered += 1
            self._held, self._held_until = pieces, now + bad.delay_time
            return
        self._queue(pieces, due)
        self._queue(self._held, due)
        self._held = []

    def take(self, now: float) -> bytes:
        """The next piece that is due, or ``b""``."""
        if self._held and self._held_until <= now:
            self._queue(self._held, self._held_until)
            self._held = []
        if not self._waiting or now < self._frozen_until or self._waiting[0][0] > now:
            return b""
        return heapq.heappop(self._waiting)[2]

    def next_time(self) -> float | None:
        """When `take` may have something, or None."""
        times = [self._waiting[0][0]] if self._waiting else []
        if self._held:
            times.append(self._held_until)
        return max(min(times), self._frozen_until) if times else None

    def clear(self) -> int:
        """Discard waiting units; returns the number of bytes discarded."""
        lost = sum(len(data) for _, _, data in self._waiting) + sum(map(len, self._held))
        self._waiting.clear()
        self._held = []
        self._not_before = self._frozen_until = 0.0
        return lost

    def _queue(self, pieces: list[bytes], due: float) -> None:
        if self._stream:
            due = self._not_before = max(due, self._not_before)
        for data in pieces:
            if len(self._waiting) >= _MOST_WAITING:
                self.counters.overflowed += 1
                continue
            heapq.heappush(self._waiting, (due, next(self._ranks), data))

    def _without_a_run(self, data: bytes, choice: random.Random) -> bytes:
        if not self._stream:
            return b""
        start, end = _run(data, choice)
        return data[:start] + data[end:]


def _run(data: bytes, choice: random.Random) -> tuple[int, int]:
    """Start and end of a random run of one to sixteen bytes."""
    length = choice.randint(1, min(16, len(data)))
    start = choice.randint(0, len(data) - length)
    return start, start + length


def _with_a_flip(data: bytes, choice: random.Random) -> bytes:
    at = choice.randrange(len(data))
    return data[:at] + bytes([data[at] ^ 1 << choice.randrange(8)]) + data[at + 1 :]


def _with_a_repeat(data: bytes, choice: random.Random) -> bytes:
    start, end = _run(data, choice)
    return data[:end] + data[start:]


def _pieces(data: bytes, choice: random.Random) -> list[bytes]:
    cuts = sorted(choice.sample(range(1, len(data)), min(choice.randint(1, 3), len(data) - 1)))
    return [data[start:end] for start, end in zip([0, *cuts], [*cuts, len(data)], strict=True)]


class ImpairedLink(Link):
    """A link on a bad line.

    What is late goes out, or comes in, during a later call: somebody has to be reading, as a session is.

    Args:
        inner: The link that carries the bytes; it is opened and closed with this one.
        sending: Impairment towards the peer.
        receiving: Impairment from the peer.
        seed: The same seed does the same to the same units.
        clock: Where the time comes from; by default the inner link's own clock if it has one, as links in
            simulated time do, else `time.monotonic`. Deadlines are on the same clock. In simulated time the inner
            link's `read` must move the clock on to its deadline when nothing comes.
    """

    def __init__(
        self,
        inner: Link,
        *,
        sending: Impairment = NOTHING,
        receiving: Impairment = NOTHING,
        seed: int = 0,
        clock: Callable[[], float] | None = None,
    ) -> None:
        self.inner = inner
        self.kind = inner.kind
        self.clock = clock or cast("Callable[[], float]", getattr(inner, "clock", monotonic))
        self.sent = Lane(sending, inner.kind, f"{seed} sending")
        self.received = Lane(receiving, inner.kind, f"{seed} receiving")
        self._sending = threading.Lock()

    @property
    def url(self) -> str:  # type: ignore[override]  # the inner link may learn its port when it opens
        """The inner link's address."""
        return self.inner.url

    def stalled(self, seconds: float) -> float:
        return self.inner.stalled(seconds)

    @property
    def max_message(self) -> int | None:  # type: ignore[override]  # likewise
        """The inner link's longest message."""
        return self.inner.max_message

    @property
    def is_open(self) -> bool:
        return self.inner.is_open

    def open(self) -> None:
        self.inner.open()

    def close(self) -> None:
        self.inner.close()
        self.sent.clear()
        self.received.clear()

    def wake(self) -> None:
        self.inner.wake()

    def confirm(self) -> None:
        self.inner.confirm()

    def flush_input(self) -> int:
        return self.inner.flush_input() + self.received.clear()

    def write(self, data: bytes, deadline: float | None = None) -> None:
        if not data or not self.is_open or (self.max_message is not None and len(data) > self.max_message):
            self.inner.write(data, deadline)  # nothing to impair, or an error that the link itself reports
            return
        with self._sending:
            self.sent.put(data, self.clock())
            self._pass_on(deadline)

    def read(self, deadline: float | None) -> bytes:
        looked = False
        while True:
            now = self.clock()
            self._pass_on_if_free(deadline)
            data = self.received.take(now)
            if data or (looked and deadline is not None and now >= deadline):
                return data
            times = [
                time for time in (deadline, self.sent.next_time(), self.received.next_time()) if time is not None
            ]
            until = min(times, default=None)
            data = self.inner.read(until)
            looked = True
            now = self.clock()
            if data:
                self.received.put(data, now)
            elif until is None or now < until:
                return b""  # woken

    def _pass_on_if_free(self, deadline: float | None) -> None:
        if self._sending.acquire(blocking=False):  # otherwise a writer does it
            try:
                self._pass_on(deadline)
            except LinkTimeoutError:
                self.sent.counters.overflowed += 1
            finally:
                self._sending.release()

    def _pass_on(self, deadline: float | None) -> None:
        while data := self.sent.take(self.clock()):
            self.inner.write(data, deadline)
