"""Straight lines in space: the tip moves on a line while the tool turns evenly.

Owns the line's time law and the choice of solution branch along it. Must not know particular arms or clocks.
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


class Line(Trajectory):
    """The tool tip on a straight line from the pose at `start` to a goal.

    Joint values are computed at every sample, so the tip is always on the line, not only at knots.

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
        steps = max(2, math.ceil(length / _STEP), math.ceil(turn / _TURN_STEP))
        self._knots = self._follow(tuple(start), steps)

    def pose(self, share: float) -> Pose:
        """Pose of the tip at a share of the line, 0..1."""
        a, b = self._from, self._goal
        x, y, z = (p + share * (q - p) for p, q in zip(a.position, b.position, strict=True))
        return Pose((x, y, z), slerp(a.rotation, b.rotation, share))

    def at(self, t: float) -> Sample:
        # Differences of exact positions; the step is small compared to any motion and large compared to rounding.
        h = min(1e-4, self.duration / 8) or 1e-4
        middle = min(max(t, h), max(self.duration - h, h))
        before, here, after = self._solve(middle - h), self._solve(middle), self._solve(middle + h)
        position = here if middle == t else self._solve(t)
        return Sample(
            position,
            tuple((b - a) / (2 * h) for a, b in zip(before, after, strict=True)),
            tuple((a - 2 * m + b) / (h * h) for a, m, b in zip(before, here, after, strict=True)),
        )

    def _solve(self, t: float) -> tuple[float, ...]:
        share = min(1.0, self._law.at(min(t, self.duration)).position[0])
        knots = self._knots
        at = share * (len(knots) - 1)
        i = min(int(at), len(knots) - 2)
        near = [a + (at - i) * (b - a) for a, b in zip(knots[i], knots[i + 1], strict=True)]
        return self._nearest(share, near)

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
