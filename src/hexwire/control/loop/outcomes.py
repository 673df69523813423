"""Outcomes of goals, their reasons, their listeners, and progress.

Owns the values that controllers return. Must not know controllers, messages, threads or clocks.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from hexwire.motion.trajectory import Sample

__all__ = ["Ended", "GoalListener", "Outcome", "Progress", "Reason"]


class Reason(StrEnum):
    """Why a goal was refused, or why it ended."""

    REACHED = "reached"
    REPLACED = "replaced"
    """Another goal is active, or the joints hold."""
    CANCELLED = "cancelled"
    """Cancelled by its client."""
    MALFORMED = "malformed"
    """Values are missing, duplicated, out of order or not numbers."""
    WRONG_JOINTS = "wrong joints"
    """A joint is unknown, missing or named twice."""
    TOO_LATE = "too late"
    NOT_READY = "not ready"
    """The joints cannot move now: no torque, position unknown, no connection, or teach mode."""
    PATH_NOT_ALLOWED = "path not allowed"
    """The path violates limits, is too fast, or begins elsewhere."""
    PATH_TOLERANCE = "path tolerance"
    """The joints were too far off the path."""
    GOAL_TOLERANCE = "goal tolerance"
    """The joints did not reach the goal in time."""
    STOPPED = "stopped"
    FAILED = "failed"
    """A programming error."""


class Outcome(StrEnum):
    """How a goal ended."""

    SUCCEEDED = "succeeded"
    PREEMPTED = "preempted"
    ABORTED = "aborted"


@dataclass(frozen=True, slots=True)
class Ended:
    """The end of a goal.

    Attributes:
        outcome: How it ended.
        reason: Why.
        text: The reason in words; after a success how far off the goal the worst joint is, empty if it is not.
    """

    outcome: Outcome
    reason: Reason
    text: str = ""


class GoalListener(Protocol):
    """Is notified of the end of a goal, by the owner of the controller, not by the controller."""

    def ended(self, ended: Ended) -> None:
        """The goal has ended."""


@dataclass(frozen=True, slots=True)
class Progress:
    """Desired and measured state of joints, in radians and seconds.

    Attributes:
        names: Joints, in the order of all values.
        desired: Desired state at `stamp`.
        position: Measured.
        velocity: Measured; NaN if unknown.
        stamp: Time of the measurement, host clock.
    """

    names: tuple[str, ...]
    desired: Sample
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    stamp: float

    @property
    def error(self) -> tuple[float, ...]:
        """Desired minus measured position, radians."""
        return tuple(d - p for d, p in zip(self.desired.position, self.position, strict=True))
