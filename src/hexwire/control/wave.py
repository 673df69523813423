"""A controller that moves one joint back and forth about a position, and records how the joint follows.

Owns the targets, the samples and the end: time over, a fault, or silence. Time comes in as an argument. Must not
know robots, files or terminals, nor the shape of the wave.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from hexwire.model.state import JointFlag, JointTarget

from .target import SingleMotion

if TYPE_CHECKING:
    from hexwire.model.state import JointReading, JointState

__all__ = ["WaveController"]


class WaveController(SingleMotion):
    """Moves one joint for a time. Nothing is sent ahead: each target lasts one period.

    Args:
        start: The joint, where it stands.
        wave: Distance from there at a time since the beginning, radians.
        seconds: Duration.
        period: Seconds between two targets.
        most_silent: Number of states in a row without an answer of the joint that end the wave.
        on_sample: Called with the time of each answer since the beginning, the last target, and the answer.

    Attributes:
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
        super().__init__((start.name,))
        self.fault, self.missed = "", 0
        self._start, self._wave, self._seconds, self._period = start, wave, seconds, period
        self._most_silent, self._on_sample = most_silent, on_sample
        self._silent, self._target = 0, math.nan

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
        if self._begun == -math.inf:
            self._begun = now
        if now - self._begun >= self._seconds:
            self.over = True
        if self.over:
            return None
        self._target = self._start.position + self._wave(now - self._begun)
        return JointTarget.of({self._start.name: self._target}, self._period)

    def _end(self, fault: str) -> None:
        if not self.over:
            self.fault, self.over = fault, True
