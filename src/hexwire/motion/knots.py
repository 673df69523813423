"""Joint angles along a path of the tip: inverse kinematics solved at knots, and cubics between them.

Owns the choice of solution branch along the path, and the interpolation. Must not know particular arms, nor where
the path leads or how fast.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

from hexwire.errors import LimitError
from hexwire.model.kinematics import KinematicModel
from hexwire.model.pose import Pose
from hexwire.units import decimal

from .trajectory import Sample

__all__ = ["Knots"]

_JUMP = math.radians(15.0)
"""Turn of a joint in one step above which the motion is not smooth."""
_BEND = 2e-4
"""Greatest difference of a joint's turns, radians; with more, the steps are halved."""
_HALVINGS = 4


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
        for _ in range(_HALVINGS):
            if _bend(self._knots, order) <= _BEND:
                break
            self.steps *= 2
            self._knots = self._follow(tuple(start))
        self._slopes = _slopes(self._knots)

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
