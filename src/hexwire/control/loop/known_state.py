"""The part of a robot's state that is fit to publish: fresh positions, with velocities for all of them.

Owns the choice of joints, the estimate of velocities that a driver does not give, the rule that time stamps
increase, for how long what was read counts as known, and the newest of these for one thread that writes states and
others that read. Time comes with the states. Must not know drivers or clocks.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hexwire.model.state import JointFlag, JointState

from .rate import Periodic, RateMeter

if TYPE_CHECKING:
    from hexwire.model.state import JointState

__all__ = ["KNOWN_FOR", "KnownState", "LatestState", "SampleClock", "StateFilter", "known_joints"]

KNOWN_FOR = 0.7
"""Seconds after which no person is shown a sample as the present: within a second all that is old is grey, and the
slowest robot, a board of the chapter with three states a second, may lose one."""

_WINDOW = 0.1
"""Seconds over which a velocity is estimated: short for a control loop, long enough to average noise."""
_GAP = 1.0
"""Seconds after which a sample is too old for an estimate of the present velocity."""
_SAME = 0.0011
"""Seconds by which two readings of one sample may differ: boards report ages in whole milliseconds."""
_KEPT = _WINDOW + _SAME
"""Seconds for which samples are kept, but at least two: a window, of which the ends are rounded."""
_STEP = 1e-4
"""Least seconds between two stamps, so that conversion between clocks cannot make them equal."""
_AGREE = 0.5
"""Seconds; if steps of the host's and the board's clock differ by more, the board's clock was reset."""

_SILENT = int(JointFlag.SILENT)


def known_joints(state: JointState | None, now: float) -> tuple[str, ...]:
    """The joints of which somebody who looks now may be told what they do; the others are unknown.

    Args:
        state: The newest state; None if there is none, or if the robot is not connected.
        now: The clock of the state's `stamp`.
    """
    if state is None:
        return ()
    latest = KNOWN_FOR - max(0.0, now - state.stamp)
    columns = zip(state.names, state.flags, state.age, strict=True)
    return tuple(name for name, flags, age in columns if age <= latest and not flags & _SILENT)


@dataclass(frozen=True, slots=True)
class KnownState:
    """The joints with known positions, at one time.

    Attributes:
        names: Joint names, in the order of the state; at least one.
        position: Radians.
        velocity: Radians per second.
        age: Seconds, 0 or more: the state's `stamp` minus the time of the newest of these samples.
    """

    names: tuple[str, ...]
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    age: float


class SampleClock:
    """The time of states without the jitter of the line, from the board's clock if it has one.

    The time starts at the first state's `stamp` and advances by steps of the board's clock; by steps of the host's
    clock if the board has no clock, or if its clock was reset or wrapped around.
    """

    def __init__(self) -> None:
        self._last: tuple[float, float] | None = None
        self._time = 0.0

    def time(self, state: JointState) -> float:
        """Time of a state, seconds; comparable only for states passed to this clock, each once and in order."""
        if self._last is None:
            self._time = state.stamp
        else:
            stamp, board_time = self._last
            step, board_step = state.stamp - stamp, state.board_time - board_time
            self._time += board_step if abs(board_step - step) < _AGREE else step
        self._last = (state.stamp, state.board_time)
        return self._time


class StateFilter:
    """Filters the states of one robot.

    A joint is omitted while its position is unknown, and when its servo has been silent for too long: an old
    position with a new stamp would be wrong, and a NaN invalidates every transform after the joint.

    Args:
        max_age: Seconds after its last sample for which a silent joint counts as known.
    """

    def __init__(self, max_age: float = 0.5) -> None:
        self._max_age = max_age
        self._clock = SampleClock()
        self._slopes = _Slopes()
        self._newest = -math.inf
        self._stamp = -math.inf

    def begin(self, max_age: float) -> None:
        """Start again after a new connection; time continues.

        Args:
            max_age: As for the filter.
        """
        self._max_age = max_age
        self._clock = SampleClock()
        self._slopes = _Slopes()
        self._newest = -math.inf

    def take(self, state: JointState) -> KnownState | None:
        """Filter a state.

        Args:
            state: Its stamp is not before that of the previous state.

        Returns:
            None if no joint is known, or if no sample is newer than the last result.
        """
        when = self._clock.time(state)
        if when - min(state.age, default=0.0) - self._newest < _SAME:
            # A state that is passed on again: no sample is newer.
            return None
        velocity = self._velocities(state, when)
        if self._complete(state):
            age = max(0.0, min(state.age))
            known: KnownState | None = KnownState(state.names, state.position, velocity, age)
        else:
            known = self._part(state, velocity)
        if known is None:
            return None
        newest, stamp = when - known.age, state.stamp - known.age
        # Two states from one buffer have almost the same stamp, although their samples differ.
        if newest - self._newest < _SAME or stamp - self._stamp < _STEP:
            return None
        self._newest, self._stamp = newest, stamp
        return known

    def _complete(self, state: JointState) -> bool:
        """Whether all joints are known: the usual case, in which nothing is to be filtered."""
        finite = math.isfinite
        return (
            bool(state.names)
            and all(map(finite, state.position))
            and all(map(finite, state.age))
            and max(state.age) <= self._max_age
        )

    def _velocities(self, state: JointState, when: float) -> tuple[float, ...]:
        """Those that the driver gives; where it gives none, out of the positions."""
        measured, finite = state.velocity, math.isfinite
        if all(map(finite, measured)):
            return measured
        slopes = self._slopes.add(state, when)
        if not any(map(finite, measured)):
            return slopes
        return tuple([own if finite(own) else slope for own, slope in zip(measured, slopes, strict=True)])

    def _part(self, state: JointState, velocity: tuple[float, ...]) -> KnownState | None:
        finite, oldest = math.isfinite, self._max_age
        columns = zip(state.names, state.position, velocity, state.age, state.flags, strict=True)
        known = [
            (name, position, speed, age)
            for name, position, speed, age, flags in columns
            if finite(position) and finite(age) and not (flags & _SILENT and age > oldest)
        ]
        if not known:
            return None
        names, positions, velocities, ages = zip(*known, strict=True)
        return KnownState(names, positions, velocities, max(0.0, min(ages)))


class _Slopes:
    """Velocities of joints out of their positions in successive states."""

    def __init__(self) -> None:
        # Of the states within the window: time, ages and positions; the one before the newest always stays, even on
        # a slow line.
        self._rows: deque[tuple[float, tuple[float, ...], tuple[float, ...]]] = deque()
        self._names: tuple[str, ...] = ()
        self._last: tuple[float, ...] = ()

    def add(self, state: JointState, when: float) -> tuple[float, ...]:
        """Take a state with its time; returns a velocity for each joint, 0 if nothing is known of it yet."""
        rows, names = self._rows, state.names
        if names != self._names or not rows or abs(when - rows[-1][0]) > _GAP:
            rows.clear()
            self._names, self._last = names, (0.0,) * len(names)
        rows.append((when, state.age, state.position))
        while rows[0][0] < when - _KEPT and len(rows) > 2:
            rows.popleft()
        first, ages, starts = rows[0]
        elapsed, columns = when - first, zip(state.age, ages, state.position, starts, self._last, strict=True)
        # The last one counts where there is no new sample, but not after a long silence.
        slopes = [
            (position - start) / time
            if _SAME <= (time := elapsed - age + before) <= _GAP
            else last * (time < _SAME)
            for age, before, position, start, last in columns
        ]
        if not math.isfinite(sum(slopes)):
            # A position was unknown.
            slopes = [slope if math.isfinite(slope) else 0.0 for slope in slopes]
        self._last = found = tuple(slopes)
        return found


class LatestState:
    """The newest state of a robot.

    Args:
        rate: Most states published per second.

    Attributes:
        state: The newest state, or None.
        heard: When it arrived, seconds; minus infinity before the first.
    """

    def __init__(self, rate: float) -> None:
        self.state: JointState | None = None
        self.heard = -math.inf
        self._period = 1.0 / rate
        self._between = self._period
        self._when_known = -math.inf
        self._known: KnownState | None = None
        self._filter = StateFilter()
        self._periodic, self._meter = Periodic(), RateMeter()
        self._lock = threading.Lock()

    def begin(self, between: float, max_age: float) -> None:
        """Start again after a new connection.

        Args:
            between: Seconds between two states.
            max_age: As in `StateFilter`.
        """
        self._between = between
        self._filter.begin(max_age)

    def take(self, state: JointState, now: float) -> KnownState | None:
        """Take the next state; returns the part of it to publish, or None."""
        with self._lock:
            self.state, self.heard = state, now
            known = self._filter.take(state)
            if known is None:
                return None
            self._when_known = now
            self._known = known
            # States up to half a period early are due, to keep the average rate.
            if self._between < self._period and not self._periodic.due(now, self._period, 0.5 * self._between):
                return None
            self._meter.count(now)
            return known

    def speeds(self, names: tuple[str, ...]) -> list[float]:
        """Velocities of these joints, radians per second; NaN if unknown."""
        known = self._known
        if known is None:
            return [math.nan] * len(names)
        if known.names == names:
            return list(known.velocity)
        speeds = dict(zip(known.names, known.velocity, strict=True))
        return [speeds.get(name, math.nan) for name in names]

    def rate(self, now: float) -> float:
        """States published per second, over the last seconds."""
        with self._lock:
            return self._meter.rate(now)

    def age(self, now: float) -> float:
        """Seconds since the last state with a new sample; infinite before the first."""
        return now - self._when_known
