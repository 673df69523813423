"""Taught motions: joint positions over time, edited and made into a trajectory.

Owns the edits: part, trim, smooth, speed. Pure; must not know files, robots or clocks.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from hexwire.errors import UsageError
from hexwire.model.arm import ArmModel
from hexwire.model.state import LONGEST
from hexwire.units import decimal

from .limits import resting_inside
from .through import arm_path
from .trajectory import Spline, Trajectory, Waypoint

__all__ = ["Edits", "Taught", "approach"]

_ACCELERATION = 4.0
"""Most radians per second squared of an approach, however fast a joint could be."""
_REST = math.radians(0.5)
_MOST_NEIGHBOURS = 50_000_000
"""Of all samples together, when they are smoothed: half a minute of computing."""


@dataclass(frozen=True, slots=True)
class Edits:
    """How a recording is played; what is recorded does not change.

    Attributes:
        begin: Its first second to play.
        end: Its last second to play.
        trim: Leave out pauses at both ends of that.
        smooth: Take away tremor that is shorter than this, seconds; both ends stay.
    """

    begin: float = 0.0
    end: float = math.inf
    trim: bool = False
    smooth: float = 0.0


@dataclass(frozen=True, slots=True)
class Taught:
    """Recorded joint positions. Edits return a new object.

    Attributes:
        names: Joint names.
        times: Seconds from the first sample, rising.
        rows: Positions in radians, one row per time.
    """

    names: tuple[str, ...]
    times: tuple[float, ...]
    rows: tuple[tuple[float, ...], ...]

    @classmethod
    def of(cls, names: Sequence[str], samples: Iterable[tuple[float, Sequence[float]]]) -> Taught:
        """From pairs of time and positions; times are shifted to start at 0.

        Samples that are not later than the previous one, for example after a clock was set back, are left out.

        Raises:
            UsageError: There is no sample, or one has a wrong number of values.
        """
        times: list[float] = []
        rows: list[tuple[float, ...]] = []
        first = None
        for time, row in samples:
            if len(row) != len(names):
                raise UsageError(f"a sample has {len(row)} values for {len(names)} joints")
            if not math.isfinite(time) or not all(map(math.isfinite, row)):
                continue
            first = time if first is None else first
            if times and time - first <= times[-1]:
                continue
            times.append(time - first)
            rows.append(tuple(row))
        if not times:
            raise UsageError("nothing was recorded")
        return cls(tuple(names), tuple(times), tuple(rows))

    @property
    def duration(self) -> float:
        """Seconds from the first to the last sample."""
        return self.times[-1]

    def part(self, joints: Sequence[str]) -> Taught:
        """Only some of the joints, in this order."""
        places = [self.names.index(name) for name in joints]
        return replace(self, names=tuple(joints), rows=tuple(tuple(row[i] for i in places) for row in self.rows))

    def trimmed(self, start: float = 0.0, end: float = math.inf) -> Taught:
        """Only the samples between two times, seconds.

        Raises:
            UsageError: Nothing is left.
        """
        low, high = bisect_left(self.times, start), bisect_right(self.times, end)
        if low >= high:
            raise UsageError(f"nothing is left between {start:g} and {end:g} s of {self.duration:.2f} s")
        return Taught(self.names, tuple(t - self.times[low] for t in self.times[low:high]), self.rows[low:high])

    def edited(self, edits: Edits) -> Taught:
        """As it is to be played.

        Raises:
            UsageError: Nothing is left, or a number is out of range.
        """
        taught = self
        if edits.begin or edits.end < math.inf:
            taught = taught.trimmed(edits.begin, edits.end)
        if edits.trim:
            taught = taught.without_stillness()
        return taught.smoothed(edits.smooth)

    def played(self, arm: ArmModel, edits: Edits) -> Callable[[float], Spline]:
        """The motion of an arm, by the factor of its speed; raises as `edited`, `within`, `trajectory`."""
        part = self.edited(edits).within(arm)
        return lambda factor: part.faster(factor).trajectory()

    @property
    def moves(self) -> bool:
        """Whether any joint moves by more than servos report at rest."""
        return any(_moved(row, self.rows[0]) for row in self.rows)

    def without_stillness(self) -> Taught:
        """Without the time before the first and after the last motion."""
        rows = self.rows
        first = next((i for i, row in enumerate(rows) if _moved(row, rows[0])), 0)
        last = next((i for i in range(len(rows) - 1, -1, -1) if _moved(rows[i], rows[-1])), len(rows) - 1)
        # A step between two samples, or a creep, differs from both ends only behind where it has left the first.
        low, high = max(0, min(first - 1, last)), min(len(rows), max(first + 1, last + 2))
        return Taught(self.names, tuple(t - self.times[low] for t in self.times[low:high]), rows[low:high])

    def within(self, arm: ArmModel) -> Taught:
        """With joints at their limits where they rested on their stops, a little outside (see `resting_inside`).

        Raises:
            UsageError: The arm lacks one of its joints.
        """
        inside = (resting_inside(arm, dict(zip(self.names, row, strict=True))) for row in self.rows)
        return Taught(self.names, self.times, tuple(tuple(row.values()) for row in inside))

    def faster(self, speed: float) -> Taught:
        """With another speed; a factor of 2 takes half the time."""
        if not 0 < speed < math.inf:
            raise UsageError(f"a speed factor must be finite and above 0, not {speed:g}")
        return Taught(self.names, tuple(t / speed for t in self.times), self.rows)

    def smoothed(self, width: float) -> Taught:
        """Without tremor: each value becomes the weighted mean of its neighbours, without delay.

        The ends do not change, since the window shrinks towards them.

        Args:
            width: Seconds to either side; 0 changes nothing.

        Raises:
            UsageError: The width is none, or takes in too many samples.
        """
        if not 0 <= width < math.inf:
            raise UsageError(f"a smoothing width must be finite and not negative, not {width:g} s")
        if width == 0:
            return self
        count = len(self.times)
        if 2 * min(width, self.duration) / (self.duration or 1.0) * count * count > _MOST_NEIGHBOURS:
            raise UsageError(
                f"{count} samples are too many to be smoothed by {width:g} s: take less, or a part of them"
            )
        out = []
        for t in self.times:
            reach = min(width, t, self.duration - t)
            low, high = bisect_left(self.times, t - reach - 1e-9), bisect_right(self.times, t + reach + 1e-9)
            # A raised cosine: smooth, and zero at its ends.
            weights = [
                1.0 + math.cos(math.pi * (s - t) / reach) if reach > 0 else 1.0 for s in self.times[low:high]
            ]
            total = sum(weights)
            columns = zip(*self.rows[low:high], strict=True)
            out.append(
                tuple(sum(w * v for w, v in zip(weights, column, strict=True)) / total for column in columns)
            )
        return Taught(self.names, self.times, tuple(out))

    def trajectory(self) -> Spline:
        """A trajectory through every sample, smooth in speed, at rest at both ends.

        Raises:
            UsageError: It is longer than the limit for a motion.
        """
        if not self.duration <= LONGEST:
            raise UsageError(
                f"the recording lasts {decimal(self.duration)} s, and a motion may take {LONGEST:g} s: "
                "was the clock changed while recording? Select a part with --from and --to"
            )
        n = len(self.times)
        rest = (0.0,) * len(self.names)
        points = []
        for i, (t, row) in enumerate(zip(self.times, self.rows, strict=True)):
            speed = rest
            if 0 < i < n - 1:
                span = self.times[i + 1] - self.times[i - 1]
                speed = tuple((b - a) / span for a, b in zip(self.rows[i - 1], self.rows[i + 1], strict=True))
            points.append(Waypoint(t, row, speed))
        return Spline(self.names, points)


def _moved(row: Sequence[float], rest: Sequence[float]) -> bool:
    return any(abs(a - b) > _REST for a, b in zip(row, rest, strict=True))


def approach(
    arm: ArmModel,
    names: Sequence[str],
    here: Sequence[float],
    goal: Sequence[float],
    *,
    speed: float = 0.5,
) -> Trajectory:
    """A slow motion to the start of another motion.

    Args:
        arm: Limits of speed, acceleration and jerk.
        names: Joint names.
        here: Present positions of the joints, radians.
        goal: Start positions of the other motion, radians.
        speed: Share of the speed limits.
    """
    return arm_path(arm, names, [here, goal], speed=speed, acceleration=_ACCELERATION)
