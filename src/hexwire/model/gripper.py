"""The joint that opens and closes a gripper: how far it is open at an angle, and the angle for an opening.

Which joint it is, says the arm's record. Must not know servos.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from hexwire.errors import UsageError

from .arm import ArmModel
from .arms import record_of

__all__ = ["OPENINGS", "Jaws", "Opening", "jaws_of"]

Opening = float | Literal["open", "close"]
"""How far a gripper is open: 0 is closed, 1 fully open; or a word."""
OPENINGS: dict[str, float] = {"open": 1.0, "close": 0.0}


@dataclass(frozen=True, slots=True)
class Jaws:
    """A gripper that one joint opens and closes.

    Attributes:
        joint: Name of the joint.
        closed: Its angle when closed, radians.
        opened: Its angle when fully open, radians.
    """

    joint: str
    closed: float
    opened: float

    def angle(self, share: float) -> float:
        """Angle of the joint for an opening, radians: 0 is closed, 1 fully open.

        Raises:
            UsageError: The opening is not within 0..1.
        """
        if not 0.0 <= share <= 1.0:
            raise UsageError(f"a gripper's opening is from 0 (closed) to 1 (fully open), not {share:g}")
        return self.closed + share * (self.opened - self.closed)

    def share(self, angle: float) -> float:
        """Opening at an angle of the joint in radians; outside 0..1 where the joint is outside its limits."""
        return (angle - self.closed) / (self.opened - self.closed)

    def pressed(self, angle: float, squeeze: float) -> float:
        """Angle that lies by `squeeze`, radians, further closed than `angle`, but not beyond closed."""
        step = math.copysign(squeeze, self.closed - self.opened)
        return min(angle + step, self.closed) if step > 0 else max(angle + step, self.closed)


def jaws_of(arm: ArmModel) -> Jaws | None:
    """The gripper of an arm; None if it has none, or if nobody knows how it opens."""
    record = record_of(arm.kind)
    if record is None or record.gripper not in arm.names:
        return None
    joint = arm.joint(record.gripper)
    ends = (joint.maximum, joint.minimum) if record.closed_at_maximum else (joint.minimum, joint.maximum)
    return Jaws(joint.name, *ends)
