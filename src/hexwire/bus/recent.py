"""The newest values that were read, for a servo that does not answer.

Owns raw values and their times by register and servo. No I/O; times are monotonic seconds that the caller gives.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .plan import ReadPlan
    from .values import Readings

__all__ = ["RecentValues"]


class RecentValues:
    """What was read last. The fast path leaves its values where it has them; here they are found again.

    Attributes:
        syncs: Newest result of a sync read, by register name; its user sets it.
    """

    def __init__(self) -> None:
        self.syncs: dict[str, Readings] = {}
        self._single: dict[tuple[str, int], tuple[int, float]] = {}

    def keep(self, name: str, servo_id: int, raw: int, stamp: float) -> None:
        """A value was read at that time."""
        self._single[name, servo_id] = (raw, stamp)

    def last(self, name: str, servo_id: int, plan: ReadPlan | None) -> tuple[int, float] | None:
        """Newest value of a register of a servo, and when it was read; None if it never was.

        Args:
            name: Register name.
            servo_id: Whose.
            plan: The plan of a single read of it, if there is one: it holds the value that was read last.
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
