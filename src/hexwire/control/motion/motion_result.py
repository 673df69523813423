"""How a motion of a program ended.

Owns the result as a value, and its words.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from hexwire.errors import ServoError
from hexwire.model.state import condition
from hexwire.motion.safety import StopReason

from ..loop.loop import LoopCounters
from .arrival import Deviation

if TYPE_CHECKING:
    from hexwire.model.state import JointState, SentTarget

    from .rest import Rest

__all__ = ["MotionResult"]


@dataclass(frozen=True, slots=True, repr=False)
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
        seconds: How long it took; of one that the call did not wait for, how long it takes.
        state: The last state, or None.
        timing: Timing of the cycles.
        timed: The robot kept the time of the motion itself.
        ended: Why it was cancelled, or gave up its path to a target, although it was not stopped; or empty.
        rest: Where the arm came to rest beside its goal, if that was waited for.
        slowed: Why it took much longer than was planned; empty if it did not.
        holds: The gripper moved, and there is an object between its jaws.
        opening: How far it is open then: 0 is closed, 1 fully open; NaN if it did not move, or that is unknown.
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
    slowed: str = ""
    holds: bool = False
    opening: float = math.nan

    @property
    def why(self) -> str:
        """Why the arm has not arrived; empty if it has, or if what ended the motion was wanted."""
        if self.stopped is not None:
            return self.stopped.outcome
        if self.without_torque:
            return f"{', '.join(self.without_torque)} lost torque before the arrival"
        if self.cut:
            return self.ended
        if self.arrived is not False:
            return ""
        parts = []
        for row in self.off:
            known = f"{row.joint} is {math.degrees(row.by):.1f} deg{'/s' if row.of_speed else ''} off"
            how = "ok" if self.state is None else condition(self.state[row.joint])
            words = known if row.by < math.inf else f"the position of {row.joint} is unknown"
            parts.append(words if how == "ok" else f"{words} ({how})")
        text = f"did not arrive: {', '.join(parts) or 'some joints have not reported since the end'}"
        return f"{text}; {self.ended}" if self.ended else text

    def __repr__(self) -> str:
        how = self.why or {None: "sent", True: "arrived", False: "ended before the goal"}[self.arrived]
        parts = [f"{how}; {self.seconds:.2f} s"]
        if self.rest is not None:
            parts.append(f"{self.rest.joint} {math.degrees(self.rest.off):.2f} deg off")
            if self.rest.tip is not None:
                parts.append(f"tip {1000 * self.rest.tip:.1f} mm off")
        if not math.isnan(self.opening):
            parts.append(f"gripper {round(100 * self.opening)} % open{' with an object' if self.holds else ''}")
        return f"<MotionResult: {', '.join(parts)}>"

    def require(self) -> MotionResult:
        """Return itself, if the joints are at the goal or the call did not wait for it.

        Raises:
            ServoError: The arm was stopped, or did not arrive.
        """
        if self.why and not self.cut:
            raise ServoError(self.why)
        return self
