"""What is known of a robot's state, good enough to be passed on: fresh positions, velocities for all of them.

Owns the choice of joints, the estimate of velocities that a driver does not give, and the rule that time stamps
rise. Pure: time comes with the states. Must not know who gets it, nor drivers or clocks.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from hexwire.model.state import JointFlag, JointState

__all__ = ["KnownState", "SampleClock", "StateFilter"]

_WINDOW = 0.1
"""Seconds over which a velocity is estimated: short for a control loop, long against a count's worth of noise."""
_GAP = 1.0
"""Seconds without a sample after which an old one says nothing about the speed of now."""
_SAME = 0.0011
"""Two looks at one sample may seem so far apart: boards tell ages in whole milliseconds."""
_STEP = 1e-4
"""Seconds by which a stamp is later than the one before, so that no conversion between clocks makes them equal."""
_AGREE = 0.5
"""Steps of the host's and the board's clock that differ by more mean that the board's was set anew."""

_SILENT = int(JointFlag.SILENT)


@dataclass(frozen=True, slots=True)
class KnownState:
    """The joints that are known, at one time.

    Attributes:
        names: Joint names, in the order of the state; at least one.
        position: Radians.
        velocity: Radians per second.
        age: Seconds, not below 0: how long before the state's `stamp` the newest of these samples was taken.
    """

    names: tuple[str, ...]
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    age: float


class SampleClock:
    """When states were true, without the jitter of the line: told by the board's clock where it has one.

    The time starts at the first state's `stamp` and goes on by the board's steps; by the host's where the board has
    no clock, or where that was reset or wrapped around.
    """

    def __init__(self) -> None:
        self._last: tuple[float, float] | None = None
        self._time = 0.0

    def time(self, state: JointState) -> float:
        """Seconds; comparable only among states that this clock was shown, each once and in their order."""
        if self._last is None:
            self._time = state.stamp
        else:
            stamp, board_time = self._last
            step, board_step = state.stamp - stamp, state.board_time - board_time
            self._time += board_step if abs(board_step - step) < _AGREE else step
        self._last = (state.stamp, state.board_time)
        return self._time


class StateFilter:
    """Turns the states of one robot into what is known of it.

    A joint is left out while its position is not known, and when its servo has been silent for too long: an old
    position under a new stamp would be a lie, and a NaN spoils every transform behind the joint.

    Args:
        max_age: A silent joint counts as known for so long after its last sample, seconds.
    """

    def __init__(self, max_age: float = 0.5) -> None:
        self._max_age = max_age
        self._clock = SampleClock()
        self._slopes: dict[str, _Slope] = {}
        self._newest = -math.inf
        self._stamp = -math.inf

    def begin(self, max_age: float) -> None:
        """What comes now has nothing to do with what came before, but for time, which goes on.

        Args:
            max_age: As of the filter.
        """
        self._max_age = max_age
        self._clock = SampleClock()
        self._slopes.clear()
        self._newest = -math.inf

    def take(self, state: JointState) -> KnownState | None:
        """What is known now.

        Args:
            state: Its stamp is not before that of the state before.

        Returns:
            None if no joint is known, or if no sample is newer than what was returned before.
        """
        when = self._clock.time(state)
        names, positions, velocities, ages = [], [], [], []
        columns = zip(state.names, state.position, state.velocity, state.flags, state.age, strict=True)
        for name, position, velocity, flags, age in columns:
            if not math.isfinite(position) or not math.isfinite(age):
                continue
            if flags & _SILENT and age > self._max_age:
                continue
            slope = self._slopes.get(name)
            if slope is None:
                slope = self._slopes[name] = _Slope()
            slope.add(when - age, position)
            names.append(name)
            positions.append(position)
            velocities.append(velocity if math.isfinite(velocity) else slope.value)
            ages.append(age)
        if not names:
            return None
        age = max(0.0, min(ages))
        newest, stamp = when - age, state.stamp - age
        # Two states that waited in a buffer together have nearly one stamp, though their samples differ.
        if newest - self._newest < _SAME or stamp - self._stamp < _STEP:
            return None
        self._newest, self._stamp = newest, stamp
        return KnownState(tuple(names), tuple(positions), tuple(velocities), age)


class _Slope:
    """Speed of one joint from its positions."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, float]] = deque()
        self.value = 0.0

    def add(self, time: float, position: float) -> None:
        samples = self._samples
        if samples:
            since = time - samples[-1][0]
            # Also one from before: a clock that was set back a little.
            if since < _SAME and since > -_GAP:
                return
            if not 0 < since <= _GAP:
                samples.clear()
                self.value = 0.0
        samples.append((time, position))
        # The one before always counts, however slow the line is.
        while len(samples) > 2 and samples[0][0] < time - _WINDOW - _SAME:
            samples.popleft()
        if len(samples) > 1:
            first, start = samples[0]
            self.value = (position - start) / (time - first)
