"""Newest values read, for a servo that no longer answers.

Owns raw values and their times by register and servo. No I/O; the caller gives times, in monotonic seconds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .plan import ReadPlan
    from .values import Readings

__all__ = ["RecentValues"]


class RecentValues:
    """Newest values of registers. Values of the fast path stay in its plans and results, which are searched here.

    Attributes:
        syncs: Newest result of a sync read, by register name; set by the user of this object.
    """

    def __init__(self) -> None:
        self.syncs: dict[str, Readings] = {}
        self._single: dict[tuple[str, int], tuple[int, float]] = {}

    def keep(self, name: str, servo_id: int, raw: int, stamp: float) -> None:
        """Store a value and its time."""
        self._single[name, servo_id] = (raw, stamp)

    def last(self, name: str, servo_id: int, plan: ReadPlan | None) -> tuple[int, float] | None:
        """Return the newest value of a register of a servo and its time; None if it was never read.

        Args:
            name: Register name.
            servo_id: The servo.
            plan: The plan of a single read of it, if there is one; it holds the last value.
        """
        last = self._single.get((name, servo_id))
        if plan is not None and plan.latest is not None and (last is None or plan.stamp > last[1]):
            last = plan.latest, plan.stamp
        newest = self.syncs.get(name)
        if newest is not None and servo_id in newest.ids:
            raw = newest.raw[newest.ids.index(servo_id)]
            if raw is not None and (last is None or newest.stamp > last[1]):
                return raw, newest.stamp
        return last
