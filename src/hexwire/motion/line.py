"""Straight lines in space: the tip moves on a line while the tool turns evenly.

Owns the time laws of one line and of several with rounded corners, and the joint angles along them: the choice of
solution branch, and the interpolation. Must not know particular arms or clocks.

The inverse kinematics are solved at knots, once. Between them the joints follow cubics through the knots, which
leave the line by less than a micrometre, because the knots are close together where the joints turn unevenly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from hexwire.errors import LimitError, UsageError
from hexwire.model.kinematics import KinematicModel
from hexwire.model.pose import Pose, multiply, rotation_between, slerp, transpose
from hexwire.units import decimal

from .speed_profile import JointLimits, change_time
from .through import Through
from .trajectory import Sample, Trajectory

__all__ = ["Knots", "Line", "Lines"]

_JUMP = math.radians(15.0)
"""Turn of a joint in one step above which the motion is not smooth."""
_BEND = 2e-4
"""Greatest difference of a joint's turns, radians; with more, the steps are halved."""
_KNOT_HALVINGS = 4


class Knots:
    """Joint angles of a model at even steps along a path, which cubics join.

    The steps are halved until the joints turn evenly.

    Args:
        model: Kinematics.
        pose: Pose of the tip at a share of the path, 0..1.
        start: Joint angles of the model at its start, radians.
        steps: Least number of steps, at least 5.
        order: Of the differences that must be small: 2 where speeds along the path are even, 4 where they vary.

    Attributes:
        steps: Number of steps.

    Raises:
        LimitError: A point of the path is out of reach or limits, or it passes a singularity; the text says how far
            along.
    """

    def __init__(
        self,
        model: KinematicModel,
        pose: Callable[[float], Pose],
        start: Sequence[float],
        steps: int,
        *,
        order: int = 2,
    ) -> None:
        self._model, self._pose = model, pose
        self._names = tuple(r.name for r in model.ranges)
        self.steps = steps
        self._knots = self._follow(tuple(start))
        for _ in range(_KNOT_HALVINGS):
            if _bend(self._knots, order) <= _BEND:
                break
            self.steps *= 2
            self._knots = self._follow(tuple(start))
        slopes = _slopes(self._knots)
        self._cubics = [
            [_cubic(*ends) for ends in zip(*four, strict=True)]
            for four in zip(self._knots, self._knots[1:], slopes, slopes[1:], strict=False)
        ]
        """By step and joint."""

    def at(self, place: float, speed: float, acceleration: float) -> Sample:
        """Angles at a place.

        Args:
            place: In steps from the start.
            speed: Steps per second.
            acceleration: Steps per second squared.
        """
        i = max(0, min(int(place), self.steps - 1))
        u = place - i
        position, velocity, accelerations = [], [], []
        for a, m, c2, c3 in self._cubics[i]:
            slope = m + u * (2.0 * c2 + 3.0 * c3 * u)
            position.append(a + u * (m + u * (c2 + c3 * u)))
            velocity.append(slope * speed)
            accelerations.append((2.0 * c2 + 6.0 * c3 * u) * speed * speed + slope * acceleration)
        return Sample(tuple(position), tuple(velocity), tuple(accelerations))

    def _nearest(self, share: float, near: Sequence[float]) -> tuple[float, ...]:
        pose = self._pose(share)
        solutions = self._model.inverse(pose)
        if not solutions:
            raise LimitError(f"at {share:.0%} of the line: out of reach, {self._model.reach(pose).cause}")
        return min(
            (s.slid(near) for s in solutions), key=lambda a: max(abs(x - y) for x, y in zip(a, near, strict=True))
        )

    def _follow(self, start: tuple[float, ...]) -> list[tuple[float, ...]]:
        model = self._model
        model.check(start)
        knots, steps = [start], self.steps
        for i in range(1, steps + 1):
            share = i / steps
            angles = self._nearest(share, knots[-1])
            found = model.violations(angles)
            if found:
                raise LimitError(f"at {share:.0%} of the line: {found[0]}")
            jump = max(abs(a - b) for a, b in zip(angles, knots[-1], strict=True))
            if jump > _JUMP:
                joint = max(zip(angles, knots[-1], self._names, strict=True), key=lambda row: abs(row[0] - row[1]))[
                    2
                ]
                raise LimitError(
                    f"at {share:.0%} of the line: {joint} would have to turn {decimal(math.degrees(jump), 3)} deg "
                    "at once; the line passes a singularity, choose another line or move the joints"
                )
            knots.append(angles)
        return knots


def _cubic(a: float, b: float, m: float, n: float) -> tuple[float, float, float, float]:
    """Factors of the cubic from one value to another with these slopes, in one step."""
    return a, m, 3.0 * (b - a) - 2.0 * m - n, m + n - 2.0 * (b - a)


def _bend(knots: Sequence[tuple[float, ...]], order: int) -> float:
    """Greatest difference of an order, radians."""
    rows: Sequence[tuple[float, ...]] = knots
    for _ in range(order):
        rows = [tuple(b - a for a, b in zip(one, two, strict=True)) for one, two in pairwise(rows)]
    return max(abs(value) for row in rows for value in row)


def _slopes(knots: Sequence[tuple[float, ...]]) -> list[tuple[float, ...]]:
    """Derivatives at even knots, per step, of fourth order; at the ends from one side."""
    last = len(knots) - 1
    slopes = []
    for i in range(last + 1):
        at = min(max(i, 2), last - 2) - 2
        weights = _WEIGHTS[i - at]
        slopes.append(
            tuple(
                sum(w * knot for w, knot in zip(weights, five, strict=True))
                for five in zip(*knots[at : at + 5], strict=True)
            )
        )
    return slopes


_WEIGHTS = (
    (-25 / 12, 4.0, -3.0, 4 / 3, -1 / 4),
    (-1 / 4, -5 / 6, 3 / 2, -1 / 2, 1 / 12),
    (1 / 12, -2 / 3, 0.0, 2 / 3, -1 / 12),
    (-1 / 12, 1 / 2, -3 / 2, 5 / 6, 1 / 4),
    (1 / 4, -4 / 3, 3.0, -4.0, 25 / 12),
)
"""Of five even knots, for the derivative at each of them: the textbook's finite differences of fourth order."""


_STEP = 0.002
"""Metres between points at which the branch is chosen."""
_TURN_STEP = math.radians(1.0)
_LEAST_STEPS = 8
_HALVINGS = 40
"""Of the time by which two lines overlap."""
_RAMP = 0.1
"""Seconds in which the full acceleration is reached: the limit of jerk."""


class Line(Trajectory):
    """The tool tip on a straight line from the pose at `start` to a goal.

    Args:
        model: Kinematics.
        start: Joint angles of the model at the start, radians.
        goal: Pose of the tip at the end.
        speed: Of the tip, metres per second.
        acceleration: Of the tip, metres per second squared.
        turn_speed: Of the tool, radians per second.

    Raises:
        LimitError: A point of the line is out of reach or limits, or the line passes a singularity; the text says
            how far along.
    """

    def __init__(
        self,
        model: KinematicModel,
        start: Sequence[float],
        goal: Pose,
        *,
        speed: float = 0.1,
        acceleration: float = 0.5,
        turn_speed: float = 1.0,
    ) -> None:
        _check(speed, acceleration, turn_speed)
        self.names = tuple(r.name for r in model.ranges)
        self._from, self._goal = model.forward(start), goal
        # The time law runs over the share of the line, 0 to 1.
        self._law = _law(self._from, goal, speed, acceleration, turn_speed).share
        self.duration = self._law.duration
        length, turn = _size(self._from, goal)
        steps = max(_LEAST_STEPS, math.ceil(length / _STEP), math.ceil(turn / _TURN_STEP))
        self._knots = Knots(model, self.pose, start, steps)

    def pose(self, share: float) -> Pose:
        """Pose of the tip at a share of the line, 0..1."""
        a, b = self._from, self._goal
        x, y, z = (p + share * (q - p) for p, q in zip(a.position, b.position, strict=True))
        return Pose((x, y, z), slerp(a.rotation, b.rotation, share))

    def at(self, t: float) -> Sample:
        law, count = self._law.at(max(t, 0.0)), self._knots.steps
        return self._knots.at(law.position[0] * count, law.velocity[0] * count, law.acceleration[0] * count)


class Lines(Trajectory):
    """The tool tip on straight lines through several poses, without a stop: corners are rounded.

    The next line begins while the one before it still slows down, so the tip leaves the lines near a corner, but
    nowhere else.

    Args:
        model: Kinematics.
        start: Joint angles of the model at the start, radians.
        goals: Poses of the tip at the corners and at the end.
        rounding: How far before and after a corner the tip may leave the lines, metres; 0 stops at every corner.
        speed: Of the tip, metres per second.
        acceleration: Of the tip, metres per second squared; in a corner up to twice as much.
        turn_speed: Of the tool, radians per second.

    Raises:
        LimitError: A point is out of reach or limits, or a line passes a singularity; the text says how far along.
    """

    def __init__(
        self,
        model: KinematicModel,
        start: Sequence[float],
        goals: Sequence[Pose],
        *,
        rounding: float = 0.01,
        speed: float = 0.1,
        acceleration: float = 0.5,
        turn_speed: float = 1.0,
    ) -> None:
        _check(speed, acceleration, turn_speed)
        if not 0.0 <= rounding < math.inf:
            raise UsageError(f"corners cannot be rounded by {rounding:g} m")
        self.names = tuple(r.name for r in model.ranges)
        corners = [model.forward(start), *goals]
        # Only the first is there in any case: a corner that repeats is no corner.
        corners = [corners[0], *(b for a, b in pairwise(corners) if max(_size(a, b)) > 0.0)]
        laws = [_law(a, b, speed, acceleration, turn_speed) for a, b in pairwise(corners)]
        self._here = corners[0]
        self._legs: list[tuple[float, Through, Pose, Pose]] = []
        self.duration = 0.0
        for i, law in enumerate(laws):
            begin = self.duration - (_overlap(laws[i - 1], law, rounding) if i else 0.0)
            self._legs.append((begin, law.share, corners[i], corners[i + 1]))
            self.duration = begin + law.share.duration
        # Even steps in time; at full speed not longer than those of one line.
        steps = max(_LEAST_STEPS, math.ceil(self.duration * max(speed / _STEP, turn_speed / _TURN_STEP)))
        self._knots = Knots(model, self.pose, start, steps, order=4)

    def pose(self, share: float) -> Pose:
        """Pose of the tip at a share of the time, 0..1."""
        t = share * self.duration
        (x, y, z), rotation = self._here.position, self._here.rotation
        for begin, law, a, b in self._legs:
            if t <= begin:
                break
            part = law.at(t - begin).position[0]
            dx, dy, dz = (q - p for p, q in zip(a.position, b.position, strict=True))
            x, y, z = x + part * dx, y + part * dy, z + part * dz
            if part >= 1.0:
                rotation = b.rotation
            else:
                # The turn of this line, after what is done of the turn before it.
                rotation = multiply(slerp(a.rotation, b.rotation, part), transpose(a.rotation), rotation)
        return Pose((x, y, z), rotation)

    def at(self, t: float) -> Sample:
        if not self.duration:
            return self._knots.at(0.0, 0.0, 0.0)
        speed = self._knots.steps / self.duration
        return self._knots.at(min(max(t, 0.0), self.duration) * speed, speed, 0.0)


def _check(speed: float, acceleration: float, turn_speed: float) -> None:
    for value in (speed, acceleration, turn_speed):
        if not 0 < value < math.inf:
            raise UsageError(f"speeds and accelerations must be finite and above 0, not {value:g}")


@dataclass(frozen=True, slots=True)
class _Law:
    """Share of a line over time, from 0 to 1; its length in metres; seconds in which the tip gets faster."""

    share: Through
    length: float
    ramp: float


def _size(a: Pose, b: Pose) -> tuple[float, float]:
    """Metres and radians between two poses."""
    return math.dist(a.position, b.position), rotation_between(a.rotation, b.rotation)[1]


def _law(a: Pose, b: Pose, speed: float, acceleration: float, turn_speed: float) -> _Law:
    """The time law of a line; the slower of moving and turning sets its limits."""
    length, turn = _size(a, b)
    fastest = 1.0 / max(length / speed, turn / turn_speed, 1e-9)
    gain = 1.0 / max(length / acceleration, turn * speed / (turn_speed * acceleration), 1e-9)
    end = 1.0 if length or turn else 0.0
    limits = JointLimits(fastest, gain, gain / _RAMP)
    law = Through(("share",), ((0.0,), (end,)), *([limit] for limit in limits))
    return _Law(law, length, change_time(law.at(0.5 * law.duration).velocity[0], limits))


def _overlap(first: _Law, second: _Law, rounding: float) -> float:
    """Seconds that the second of two lines may begin before the first has ended."""

    def inside(seconds: float) -> bool:
        # A law is symmetric: what is left of the first line is what it had done after this time.
        return all(law.length * law.share.at(seconds).position[0] <= rounding for law in (first, second))

    least, most = 0.0, min(first.ramp, second.ramp)
    if inside(most):
        return most
    for _ in range(_HALVINGS):
        middle = 0.5 * (least + most)
        least, most = (middle, most) if inside(middle) else (least, middle)
    return least
