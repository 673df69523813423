"""What controllers share that a person guides without goals: by a joystick, or by another arm.

Owns when such a controller moves, what it says, and how long its last cycle took.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import TYPE_CHECKING

from ..loop.group import Goalless
from ..loop.loop import check_rate

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel
    from hexwire.motion.safety import StopReason

__all__ = ["OVERLAP", "Notes", "OperatorController"]

_FORGOTTEN = 1.0
"""Seconds without a note after which it is new again: at a limit it comes and goes."""
_NUMBER = re.compile(r"(?<![\w.])-?\d+(\.\d+)?")
OVERLAP = 2.5
"""Duration of a target in cycles, so that a late one does not pause the motion."""


class Notes:
    """Tells which notes are worth saying, where every cycle may have one.

    A note with other numbers, such as how deep below the table a joint would be, is the same note. It is new after
    a second without it.
    """

    def __init__(self) -> None:
        self._kind = ""
        self._at = -math.inf

    def is_new(self, note: str, now: float) -> bool:
        """Whether to say a note; never for an empty one, which says that there is none now.

        Args:
            note: What the cycle has to say.
            now: Seconds, monotonic.
        """
        if not note:
            return False
        kind = _NUMBER.sub("", note)
        new = kind != self._kind or not now - self._at < _FORGOTTEN
        self._kind, self._at = kind, now
        return new


class OperatorController(Goalless):
    """Moves all joints of an arm. A subclass has `cycle`.

    Args:
        arm: The arm.
        period: Least seconds between two cycles.
        on_note: Called with a new note for the operator, or with the reason for a stop.
    """

    def __init__(self, arm: ArmModel, period: float, on_note: Callable[[str | StopReason], object]) -> None:
        check_rate(1.0 / period)
        self._arm, self._least, self._on_note = arm, period, on_note
        self._last = math.nan
        self._notes = Notes()
        self._said: str | StopReason = ""
        self._stopped = False
        self.moving = False

    @property
    def joints(self) -> tuple[str, ...]:
        """Names."""
        return self._arm.names

    @property
    def busy(self) -> bool:
        """It is moving its joints."""
        return self.moving

    def stop(self, reason: StopReason) -> None:
        """Stop moving; the subclass decides what must happen before it moves again."""
        self._stopped, self.moving = True, False

    def brake(self, why: str) -> bool:
        """Same as `release`: its program brakes the joints before it ends."""
        self.release(why)
        return False

    def release(self, why: str) -> None:
        """Same as `stop`."""
        self._stopped, self.moving = True, False

    def _period(self, now: float) -> float:
        """Seconds since the last cycle, at least the wanted period; with a slow line, a cycle takes longer."""
        period = self._least if math.isnan(self._last) else max(self._least, now - self._last)
        self._last = now
        return period

    def _say(self, said: str | StopReason) -> None:
        if not isinstance(said, str):
            if said != self._said:
                self._on_note(said)
            self._said = said
        elif self._notes.is_new(said, self._last):
            self._said = said
            self._on_note(said)
        elif not said:
            self._said = said
