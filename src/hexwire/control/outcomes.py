"""How a goal ends and why, who is told, and how far its joints are.

Owns the values that controllers hand out. Must not know controllers, messages, threads or clocks.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from hexwire.motion.waypoints import Sample

__all__ = ["Ended", "GoalListener", "Outcome", "Progress", "Reason"]


class Reason(StrEnum):
    """Why a goal was refused, or why it ended."""

    REACHED = "reached"
    REPLACED = "replaced"
    """Something else is followed, or the joints were told to hold."""
    CANCELLED = "cancelled"
    """Before it began."""
    MALFORMED = "malformed"
    """Values are missing, doubled, out of order or no numbers."""
    WRONG_JOINTS = "wrong joints"
    """A joint is unknown, missing or named twice."""
    TOO_LATE = "too late"
    NOT_READY = "not ready"
    """The joints cannot move now: no torque, position unknown, no connection, or teach mode."""
    PATH_NOT_ALLOWED = "path not allowed"
    """It leads outside limits, is too fast, or begins elsewhere."""
    PATH_TOLERANCE = "path tolerance"
    """The joints were too far off the path."""
    GOAL_TOLERANCE = "goal tolerance"
    """The joints did not get near enough to the goal in time."""
    STOPPED = "stopped"
    FAILED = "failed"
    """A fault of the program."""


class Outcome(Enum):
    """How a goal ended."""

    SUCCEEDED = "succeeded"
    PREEMPTED = "preempted"
    ABORTED = "aborted"


@dataclass(frozen=True, slots=True)
class Ended:
    """The end of a goal.

    Attributes:
        outcome: Which.
        reason: Why.
        text: In words; empty after a success.
    """

    outcome: Outcome
    reason: Reason
    text: str = ""


class GoalListener(Protocol):
    """Who wants to hear how a goal ends. The controller never calls it; whoever owns the controller does."""

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
