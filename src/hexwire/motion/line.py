"""Straight lines in space: the tip moves on a line while the tool turns evenly.

Owns the line's time law and the choice of solution branch along it. Must not know particular arms or clocks.

The inverse kinematics are solved at knots, once. Between them the joints follow cubics through the knots, which
leave the line by less than a micrometre, because the knots are close together where the joints turn unevenly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from hexwire.errors import LimitError, UsageError
from hexwire.model.kinematics import KinematicModel
from hexwire.model.pose import Pose, distance, rotation_between, slerp
from hexwire.units import decimal

from .optimal import Trapezoid
from .waypoints import Sample, Trajectory

__all__ = ["Line"]

_STEP = 0.002
"""Metres between points at which the branch is chosen."""
_TURN_STEP = math.radians(1.0)
_JUMP = math.radians(15.0)
"""Turn of a joint in one step above which the motion is not smooth."""
_LEAST_STEPS = 8
_BEND = 2e-4
"""Greatest change of a joint's turn from one step to the next, radians; with more, the steps are halved."""
_HALVINGS = 4
_INSIDE = 1e-9
"""Seconds."""


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
        for value in (speed, acceleration, turn_speed):
            if not 0 < value < math.inf:
                raise UsageError(f"speeds and accelerations must be finite and above 0, not {value:g}")
        self.names = tuple(r.name for r in model.ranges)
        self._model, self._goal = model, goal
        self._from = model.forward(start)
        length = distance(self._from.position, goal.position)
        _, turn = rotation_between(self._from.rotation, goal.rotation)
        # The time law runs over the share of the line, 0 to 1; the slower of moving and turning sets its limits.
        self._law = Trapezoid(
            ("share",),
            (0.0,),
            (1.0 if length or turn else 0.0,),
            (1.0 / max(length / speed, turn / turn_speed, 1e-9),),
            (1.0 / max(length / acceleration, turn * speed / (turn_speed * acceleration), 1e-9),),
        )
        self.duration = self._law.duration
        steps = max(_LEAST_STEPS, math.ceil(length / _STEP), math.ceil(turn / _TURN_STEP))
        self._knots = self._follow(tuple(start), steps)
        for _ in range(_HALVINGS):
            if _bend(self._knots) <= _BEND:
                break
            steps *= 2
            self._knots = self._follow(tuple(start), steps)
        self._slopes = _slopes(self._knots)

    def pose(self, share: float) -> Pose:
        """Pose of the tip at a share of the line, 0..1."""
        a, b = self._from, self._goal
        x, y, z = (p + share * (q - p) for p, q in zip(a.position, b.position, strict=True))
        return Pose((x, y, z), slerp(a.rotation, b.rotation, share))

    def at(self, t: float) -> Sample:
        # At its ends the line has the acceleration of the moment after or before.
        h = min(_INSIDE, self.duration / 8)
        law = self._law.at(min(max(t, h), self.duration - h))
        count = len(self._knots) - 1
        # In knots instead of seconds: place, speed, acceleration.
        place = (law.position[0] if h <= t <= self.duration - h else self._law.at(max(t, 0.0)).position[0]) * count
        speed = law.velocity[0] * count
        acceleration = law.acceleration[0] * count
        i = min(int(place), count - 1)
        u = place - i
        position, velocity, accelerations = [], [], []
        for a, b, m, n in zip(
            self._knots[i], self._knots[i + 1], self._slopes[i], self._slopes[i + 1], strict=True
        ):
            c2, c3 = 3.0 * (b - a) - 2.0 * m - n, m + n - 2.0 * (b - a)
            slope = m + u * (2.0 * c2 + 3.0 * c3 * u)
            position.append(a + u * (m + u * (c2 + c3 * u)))
            velocity.append(slope * speed)
            accelerations.append((2.0 * c2 + 6.0 * c3 * u) * speed * speed + slope * acceleration)
        return Sample(tuple(position), tuple(velocity), tuple(accelerations))

    def _nearest(self, share: float, near: Sequence[float]) -> tuple[float, ...]:
        pose = self.pose(share)
        solutions = self._model.inverse(pose)
        if not solutions:
            raise LimitError(f"at {share:.0%} of the line: out of reach, {self._model.reach(pose).cause}")
        return min(
            (s.slid(near) for s in solutions), key=lambda a: max(abs(x - y) for x, y in zip(a, near, strict=True))
        )

    def _follow(self, start: tuple[float, ...], steps: int) -> list[tuple[float, ...]]:
        model = self._model
        model.check(start)
        knots = [start]
        for i in range(1, steps + 1):
            share = i / steps
            angles = self._nearest(share, knots[-1])
            found = model.violations(angles)
            if found:
                raise LimitError(f"at {share:.0%} of the line: {found[0]}")
            jump = max(abs(a - b) for a, b in zip(angles, knots[-1], strict=True))
            if jump > _JUMP:
                joint = max(zip(angles, knots[-1], self.names, strict=True), key=lambda row: abs(row[0] - row[1]))[
                    2
                ]
                raise LimitError(
                    f"at {share:.0%} of the line: {joint} would have to turn {decimal(math.degrees(jump), 3)} deg "
                    "at once; the line passes a singularity, choose another line or move the joints"
                )
            knots.append(angles)
        return knots


def _bend(knots: Sequence[tuple[float, ...]]) -> float:
    """Greatest change of a joint's turn from one step to the next, radians."""
    return max(
        abs(a - 2.0 * b + c)
        for first, second, third in zip(knots, knots[1:], knots[2:], strict=False)
        for a, b, c in zip(first, second, third, strict=True)
    )


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
