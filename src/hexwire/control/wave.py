"""A controller that moves one joint back and forth about a position, and records how the joint follows.

Owns the targets, the samples and the end: time over, a fault, or silence. Time comes in as an argument. Must not
know robots, files or terminals, nor the shape of the wave.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from hexwire.model.state import JointFlag, JointTarget

if TYPE_CHECKING:
    from hexwire.model.state import JointReading, JointState
    from hexwire.motion.safety import StopReason

    from .outcomes import Ended, GoalListener

__all__ = ["WaveController"]


class WaveController:
    """Moves one joint for a time. Nothing is sent ahead: each target lasts one period.

    Args:
        start: The joint, where it stands.
        wave: Distance from there at a time since the beginning, radians.
        seconds: Duration.
        period: Seconds between two targets.
        most_silent: Number of states in a row without an answer of the joint that end the wave.
        on_sample: Called with the time of each answer since the beginning, the last target, and the answer.

    Attributes:
        over: The wave has ended.
        fault: Why it ended early; empty if it did not.
        missed: Number of states without an answer.
    """

    def __init__(
        self,
        start: JointReading,
        wave: Callable[[float], float],
        seconds: float,
        *,
        period: float,
        most_silent: int,
        on_sample: Callable[[float, float, JointReading], object],
    ) -> None:
        self.over, self.fault, self.missed = False, "", 0
        self._start, self._wave, self._seconds, self._period = start, wave, seconds, period
        self._most_silent, self._on_sample = most_silent, on_sample
        self._silent, self._begun, self._target = 0, math.nan, math.nan
        self._reason: StopReason | None = None

    @property
    def joints(self) -> tuple[str, ...]:
        """Name of the joint."""
        return (self._start.name,)

    @property
    def busy(self) -> bool:
        """The wave has not ended."""
        return not self.over

    @property
    def moving(self) -> bool:
        """The wave has begun and not ended."""
        return not self.over and math.isfinite(self._begun)

    @property
    def reason(self) -> StopReason | None:
        """Why it was stopped, or None."""
        return self._reason

    def judge(self, state: JointState, velocity: Sequence[float], now: float) -> None:
        """Record an answer; end at a fault, or if the joint stays silent."""
        joint = state[self._start.name]
        # Noise destroys an answer now and then; that is no reason to stop.
        self._silent = self._silent + 1 if joint.flags & JointFlag.SILENT else 0
        self.missed += bool(self._silent)
        if self._silent >= self._most_silent:
            self._end(f"fell silent: {self._silent} samples in a row are missing; check cable and power")
        elif faults := joint.flags.faults & ~JointFlag.SILENT:
            self._end(f"stopped: {faults}")
        elif not self._silent and self.moving:
            self._on_sample(now - self._begun, self._target, joint)

    def cycle(self, state: JointState, now: float, lead: float) -> JointTarget | None:
        """The next target."""
        if math.isnan(self._begun):
            self._begun = now
        if now - self._begun >= self._seconds:
            self.over = True
        if self.over:
            return None
        self._target = self._start.position + self._wave(now - self._begun)
        return JointTarget.of({self._start.name: self._target}, self._period)

    def stop(self, reason: StopReason) -> None:
        """End the wave."""
        if not self.over:
            self._reason, self.over = reason, True

    def reset(self) -> None:
        """Do nothing: an ended wave does not continue."""

    def release(self, why: str) -> None:
        """End the wave."""
        self.over = True

    def take_ended(self) -> list[tuple[GoalListener, Ended]]:
        """Return nothing: the caller reads the attributes."""
        return []

    def _end(self, fault: str) -> None:
        if not self.over:
            self.fault, self.over = fault, True
