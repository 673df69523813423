"""How a goal ends, who is told, and how far its joints are on the way.

Owns the values that controllers hand out. Must not know controllers, ROS, threads or clocks.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from hexwire.motion.waypoints import Sample

    from .goals import ErrorCode

__all__ = ["Ended", "Goal", "Outcome", "Progress"]


class Outcome(Enum):
    """How a goal ended, in ROS's words."""

    SUCCEEDED = "succeeded"
    PREEMPTED = "preempted"
    ABORTED = "aborted"


@dataclass(frozen=True, slots=True)
class Ended:
    """The end of a goal.

    Attributes:
        outcome: Which.
        code: Of ROS's FollowJointTrajectoryResult.
        text: In words; empty after a success.
    """

    outcome: Outcome
    code: ErrorCode
    text: str = ""


class Goal(Protocol):
    """Who wants to hear how an order ends. The controller never calls it; whoever owns the controller does."""

    def ended(self, ended: Ended) -> None:
        """It is over."""


@dataclass(frozen=True, slots=True)
class Progress:
    """Where the joints are meant to be and where they are, in radians and seconds.

    Attributes:
        names: Joints, in the order of all values.
        desired: What was planned for `stamp`.
        position: Measured.
        velocity: Measured; NaN where it is not known.
        stamp: When it was measured, host clock.
    """

    names: tuple[str, ...]
    desired: Sample
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    stamp: float

    @property
    def error(self) -> tuple[float, ...]:
        """Desired less measured position, radians."""
        return tuple(d - p for d, p in zip(self.desired.position, self.position, strict=True))
