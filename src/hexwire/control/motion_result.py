"""How a motion of a program ended.

Owns the result as a value, and its words. Must not know how a motion is run.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from hexwire.errors import ServoError
from hexwire.motion.safety import StopReason

from .arrival import Deviation
from .loop import LoopCounters

if TYPE_CHECKING:
    from hexwire.model.state import JointState, SentTarget

    from .rest import Rest

__all__ = ["MotionResult"]


@dataclass(frozen=True, slots=True)
class MotionResult:
    """How a motion ended.

    Attributes:
        arrived: Whether the joints are at the goal; None if the call did not wait for it.
        stopped: Why the arm was stopped, or None.
        off: Joints that are not at their goal, worst first.
        without_torque: Joints that lost torque during the motion.
        cut: `until` ended the motion.
        powered: Joints whose torque was switched on for it.
        sent: A single target as sent, or None.
        seconds: Time limit for the arrival, from the beginning.
        state: The last state, or None.
        timing: Timing of the cycles.
        timed: The robot kept the time of the motion itself.
        ended: Why it gave up its path to a target, although it was not stopped; or empty.
        rest: Where the arm came to rest beside its goal, if that was waited for.
    """

    arrived: bool | None
    stopped: StopReason | None = None
    off: tuple[Deviation, ...] = ()
    without_torque: tuple[str, ...] = ()
    cut: bool = False
    powered: tuple[str, ...] = ()
    sent: SentTarget | None = None
    seconds: float = 0.0
    state: JointState | None = None
    timing: LoopCounters = field(default_factory=LoopCounters)
    timed: bool = False
    ended: str = ""
    rest: Rest | None = None

    @property
    def why(self) -> str:
        """Why the arm has not arrived; empty if it has."""
        if self.stopped is not None:
            return f"stopped: {self.stopped}"
        if self.without_torque:
            return f"{', '.join(self.without_torque)} lost torque before the arrival"
        if self.arrived is not False or self.cut:
            return ""
        parts = [
            f"{row.joint} is {math.degrees(row.by):.1f} deg{'/s' if row.of_speed else ''} off"
            if row.by < math.inf
            else f"the position of {row.joint} is unknown"
            for row in self.off
        ]
        text = f"did not arrive: {', '.join(parts) or 'some joints have not reported since the end'}"
        return f"{text}; {self.ended}" if self.ended else text

    def require(self) -> MotionResult:
        """Return itself, if the joints are at the goal or the call did not wait for it.

        Raises:
            ServoError: The arm was stopped, or did not arrive.
        """
        if self.why:
            raise ServoError(self.why)
        return self
