"""Waves with which one servo is tested: sine, triangle, step and sweep about the place where it stands.

Owns their shapes and bounds. Pure: time is an argument. Must not know servos or robots.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from hexwire.errors import UsageError

__all__ = ["LONGEST", "MOST_AMPLITUDE", "SHAPES", "SHORTEST_PERIOD", "Wave"]

SHAPES = ("sine", "step", "triangle", "sweep")
MOST_AMPLITUDE = math.radians(45.0)
"""Farthest that a wave goes to either side, radians."""
SHORTEST_PERIOD = 0.2
LONGEST = 600.0
"""Longest wave, seconds."""


@dataclass(frozen=True, slots=True)
class Wave:
    """A motion to both sides of the start. It begins at the start and, if whole periods fit, ends near it.

    - ``sine``: begins at the start with its highest speed.
    - ``triangle``: at constant speed from one side to the other.
    - ``step``: jumps to one side, and half a period later to the other.
    - ``sweep``: a sine whose frequency rises or falls by the same factor in each second, from that of `period` to
      that of `last_period`.

    Attributes:
        shape: One of `SHAPES`.
        amplitude: Distance to either side, radians.
        period: Seconds for a cycle; of a sweep, of its first.
        seconds: Duration.
        last_period: Seconds for the last cycle of a sweep; other shapes do not use it.

    Raises:
        UsageError: A value is out of bounds.
    """

    shape: str
    amplitude: float
    period: float
    seconds: float
    last_period: float = 0.25

    def __post_init__(self) -> None:
        if self.shape not in SHAPES:
            raise UsageError(f"there is no wave {self.shape!r}; choose {', '.join(SHAPES)}")
        # Written so that NaN is refused too.
        if not 0 < self.amplitude <= MOST_AMPLITUDE + 1e-9:
            most = math.degrees(MOST_AMPLITUDE)
            raise UsageError(f"an amplitude of {math.degrees(self.amplitude):g} deg is not in 0..{most:g}")
        if not 0 < self.seconds <= LONGEST:
            raise UsageError(f"a wave lasts up to {LONGEST:g} s, not {self.seconds:g}")
        periods = (self.period, self.last_period) if self.shape == "sweep" else (self.period,)
        for period in periods:
            if not SHORTEST_PERIOD <= period <= LONGEST:
                raise UsageError(f"a period lasts {SHORTEST_PERIOD:g} to {LONGEST:g} s, not {period:g}")

    def angle(self, t: float) -> float:
        """Distance from the start at a time since the beginning, radians."""
        cycles = self._cycles(t)
        phase = cycles % 1.0
        if self.shape in ("sine", "sweep"):
            return self.amplitude * math.sin(2 * math.pi * cycles)
        if self.shape == "step":
            return self.amplitude if phase < 0.5 else -self.amplitude
        # Up in the first quarter, down in the middle half, up again.
        return self.amplitude * (1.0 - 4.0 * abs((phase + 0.25) % 1.0 - 0.5))

    def frequency(self, t: float) -> float:
        """Cycles per second at a time since the beginning."""
        if self.shape != "sweep":
            return 1.0 / self.period
        return math.pow(self.period / self.last_period, t / self.seconds) / self.period

    @property
    def fastest(self) -> float:
        """The highest speed on the way, rad/s; infinite for steps."""
        if self.shape == "step":
            return math.inf
        if self.shape == "triangle":
            return 4 * self.amplitude / self.period
        period = min(self.period, self.last_period) if self.shape == "sweep" else self.period
        return 2 * math.pi * self.amplitude / period

    def _cycles(self, t: float) -> float:
        """Cycles completed since the beginning: the integral of the frequency."""
        if self.shape != "sweep" or math.isclose(self.period, self.last_period):
            return t / self.period
        growth = math.log(self.period / self.last_period)
        return math.expm1(growth * t / self.seconds) * self.seconds / (growth * self.period)
