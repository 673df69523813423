"""Hold to run: a motion goes on only while signs of life of the person who began it arrive.

Owns which motion is held, its last sign of life, and that each one ends once, for one reason. Time comes from the
clock that it is given.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

__all__ = ["FINE", "SILENCE", "HeldMotion", "HoldToRun", "silence_for"]

FINE = frozenset({"released", "arrived", "complete"})
"""Why a motion ends that has ended as it was asked for: no news for anybody who looks for faults."""
SILENCE = 0.25
"""Seconds without a sign of life after which a held motion ends."""
_SLOW, _SHORT_SILENCE = 0.3, 0.15
"""Seconds between two targets from which a line is slow; the silence that is enough there."""


def silence_for(period: float, silence: float = SILENCE) -> float:
    """Seconds without a sign of life after which a held motion ends on a line of some speed.

    Args:
        period: Seconds between two targets.
        silence: Seconds on a fast line.
    """
    # Sending takes a good part of a second on a slow line, which leaves less for waiting.
    return min(silence, _SHORT_SILENCE) if period > _SLOW else silence


class HeldMotion:
    """One held motion. Any thread may call its methods; none of them waits.

    Args:
        who: Who attends to it.
        number: That person's number for it; greater for each.
        now: Its first sign of life, seconds.

    Attributes:
        who: Who attends to it.
        number: That person's number for it.
        ended: Why it has ended; empty while it lasts.
    """

    def __init__(self, who: str, number: int, now: float) -> None:
        self.who, self.number, self.ended = who, number, ""
        self._heard = now
        self._finish: Callable[[str], object] | None = None

    def age(self, now: float) -> float:
        """Seconds since the last sign of life; infinite when it has ended."""
        return math.inf if self.ended else now - self._heard


class HoldToRun:
    """At most one held motion at a time. Any thread may call its methods.

    Args:
        silence: Seconds without a sign of life after which a motion ends.
        clock: Monotonic seconds.
        on_end: Called with each motion that has ended, in the thread that ended it.

    Attributes:
        silence: Seconds without a sign of life after which a motion ends; may be changed.
        on_end: Called with each motion that has ended; may be changed.
    """

    def __init__(
        self,
        *,
        silence: float = SILENCE,
        clock: Callable[[], float] = time.monotonic,
        on_end: Callable[[HeldMotion], object] = lambda entry: None,
    ) -> None:
        self.silence, self._clock, self.on_end = silence, clock, on_end
        self._lock = threading.Lock()
        self._entry: HeldMotion | None = None
        # The greatest number of each person: an older one must not begin after a newer one has ended.
        self._last: dict[str, int] = {}

    @property
    def entry(self) -> HeldMotion | None:
        """The present motion, or None."""
        return self._entry

    def begin(self, who: str, number: int) -> HeldMotion | None:
        """Announce a motion, before it is checked and begun; ends the one before.

        Args:
            who: Who attends to it.
            number: Greater than all earlier ones of that person.

        Returns:
            Its entry; None if the number is not greater, so that a repeated message begins nothing.
        """
        with self._lock:
            if number <= self._last.get(who, -1):
                return None
            self._last[who] = number
            former, self._entry = self._entry, HeldMotion(who, number, self._clock())
            entry = self._entry
        self._end(former, "another motion was begun")
        return entry

    def begun(self, entry: HeldMotion, finish: Callable[[str], object]) -> None:
        """Note how a motion is ended, once it has begun; if it has ended meanwhile, it is ended at once.

        Args:
            entry: Of the motion.
            finish: Called once with the reason.
        """
        with self._lock:
            entry._finish = finish
            why = entry.ended
        if why:
            self._call(entry)

    def beat(self, who: str, number: int) -> bool:
        """Note a sign of life; returns whether that motion lasts. One that has ended does not come back."""
        entry = self._entry
        now = self._clock()
        if entry is None or entry.who != who or entry.number != number or entry.ended:
            return False
        if entry.age(now) > self.silence:
            # Too late: what moves by this entry has seen the silence already.
            self._end(entry, "whoever held it is heard no more")
            return False
        entry._heard = now
        return True

    def end(self, who: str, why: str, number: int | None = None) -> None:
        """End the motion of a person.

        Args:
            who: That person.
            why: In words.
            number: Only this one; any if None.
        """
        entry = self._entry
        if number is not None:
            with self._lock:
                # One whose beginning is still under way in another message must not begin later.
                self._last[who] = max(self._last.get(who, -1), number)
        if entry is not None and entry.who == who and number in (None, entry.number):
            self._end(entry, why)

    def end_all(self, why: str) -> None:
        """End the present motion, whoever attends to it."""
        self._end(self._entry, why)

    def check(self) -> float:
        """End a motion without signs of life.

        Returns:
            Seconds until the next check is due; infinite if nothing is held.
        """
        entry = self._entry
        if entry is None or entry.ended:
            return math.inf
        left = self.silence - entry.age(self._clock())
        if left > 0.0:
            return left
        self._end(entry, "whoever held it is heard no more")
        return math.inf

    def _end(self, entry: HeldMotion | None, why: str) -> None:
        if entry is None:
            return
        with self._lock:
            if entry.ended:
                return
            entry.ended = why
            if self._entry is entry:
                self._entry = None
        self._call(entry)
        self.on_end(entry)

    def _call(self, entry: HeldMotion) -> None:
        with self._lock:
            finish, entry._finish = entry._finish, None
        if finish is not None:
            finish(entry.ended)
