"""The interface of a view of the demo, and the view that prints plain lines.

Owns the interface and its values. Must not know robots, nor how a terminal is drawn.
"""

from __future__ import annotations

import math
from contextlib import nullcontext
from typing import TYPE_CHECKING, NamedTuple, Protocol

from .output import say

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from hexwire.model.state import JointState

__all__ = ["PlainView", "Sample", "View", "in_degrees"]


class Sample(NamedTuple):
    """One cycle, for the view. Angles in radians, loads as fractions, times in seconds.

    Attributes:
        time: Time since the start of the motion.
        duration: Duration of the whole motion.
        state: State of the joints.
        target: Desired positions at that time.
        rate: Achieved cycles per second.
        round_trip: Round trip of the last request.
        retries: Retries since the start of the motion.
    """

    time: float
    duration: float
    state: JointState
    target: tuple[float, ...]
    rate: float
    round_trip: float
    retries: int


class View(Protocol):
    """Shows the progress of the demo."""

    def say(self, phase: str, text: str) -> None:
        """Show the result of a phase."""

    def moving(self) -> AbstractContextManager[object]:
        """A context for the time in which the arm moves."""

    def show(self, sample: Sample) -> None:
        """Show a cycle."""


class PlainView:
    """Prints plain lines for a log: one per phase, and one per second while the arm moves."""

    def __init__(self) -> None:
        self._next = 0.0

    def say(self, phase: str, text: str) -> None:
        say(f"{phase}: {text}", flush=True)

    def moving(self) -> AbstractContextManager[object]:
        return nullcontext()

    def show(self, sample: Sample) -> None:
        if sample.time < self._next:
            return
        self._next = math.floor(sample.time) + 1.0
        error = max(abs(a - b) for a, b in zip(sample.state.position, sample.target, strict=True))
        pose = in_degrees(sample.state)
        self.say(f"{sample.time:5.1f} s", f"{pose} deg, off by at most {math.degrees(error):.1f}")


def in_degrees(state: JointState) -> str:
    """The position of each joint in degrees, on one line."""
    return "  ".join(f"{joint.name} {math.degrees(joint.position):.1f}" for joint in state)
