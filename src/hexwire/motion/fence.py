"""Where an arm as a whole must not be, whatever its single joints may: beyond a gate, below the table.

Owns the judgement of one posture after the other, and that an arm which is where it must not be may leave there.
Must not know time, trajectories or robots.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from hexwire.errors import UsageError
from hexwire.model.kinematics import KinematicModel

__all__ = ["Fence"]

_CREEP = 1e-6
"""Radians or metres that rounding is granted."""
_WAY_OUT_ANGLE = math.radians(0.5)
_WAY_OUT_HEIGHT = 0.002
"""What an arm that begins where it must not be may go further in on its way out, radians and metres."""
_SLACK_ANGLE = math.radians(0.5)
_SLACK_HEIGHT = 0.002
"""What an arm in motion may be beyond what its trajectory was checked for: that is looked at in steps, and joints
that are held sag."""


class Fence:
    """Judges postures, in the order in which the arm takes them.

    Args:
        model: The kinematics.
        table: Height above the base below which no point of the arm may come, metres; None for no table.
        moving: The postures are those of an arm in motion, not of a plan, and get a little more room: half a degree
            at a gate, 2 mm at the table. Nothing is said of a posture with a joint that nobody has heard of.

    Attributes:
        lowest: Height of the lowest of the arm's points in the last posture, metres.
    """

    def __init__(self, model: KinematicModel, table: float | None = 0.0, *, moving: bool = False) -> None:
        self.lowest = math.inf
        self._joints = frozenset(model.joint_names)
        self._model, self._table, self._moving = model, table, moving
        self._slack_angle = _SLACK_ANGLE if moving else _CREEP
        self._slack_height = _SLACK_HEIGHT if moving else _CREEP
        # How far in the arm may be: as far as it was at the start, and never again as far as it was before.
        self._gate, self._floor = 0.0, -math.inf
        self._resting = True
        self._told: dict[str, float] = {}

    def begin(self, here: Mapping[str, float]) -> None:
        """Start afresh from where the arm is, radians by the driver's joints.

        Raises:
            UsageError: It is not known where a joint is, and the arm is not `moving`.
        """
        # NaN compares with nothing: while a joint is not known, no more is allowed than to an arm that is inside.
        _, excess, _, height = self._look(here)
        self._gate = excess + _WAY_OUT_ANGLE if excess > 0.0 else 0.0
        if self._table is not None:
            self._floor = height - _WAY_OUT_HEIGHT if height < self._table else self._table

    def check(self, positions: Mapping[str, float]) -> dict[str, str]:
        """What speaks against the next posture.

        Args:
            positions: Radians, of all the model's joints by the driver's names.

        Returns:
            Texts by "gate" and "table"; empty if nothing does, and then the arm counts as having been there.

        Raises:
            UsageError: As `begin`.
        """
        found = {}
        angles, excess, name, self.lowest = self._look(positions)
        if excess > self._gate + self._slack_angle:
            own = [r.name for r in self._model.ranges]
            violations = self._model.violations(angles)
            found["gate"] = next((v for v in violations if v.split("=")[0] not in own), "a gate is shut")
        if self._table is not None and self.lowest < self._floor - self._slack_height:
            depth, level = 1e3 * (self._table - self.lowest), 1e3 * self._table
            found["table"] = f"the {name} would be {depth:.1f} mm below the table at {level:.0f} mm"
        if not found:
            self._gate = min(self._gate, excess)
            if self._table is not None:
                self._floor = min(self._table, max(self._floor, self.lowest))
        return found

    def check_end(self, here: Mapping[str, float], there: Mapping[str, float]) -> dict[str, str]:
        """As `begin` and `check`, for where the arm is to stay: no further in than it is, or it would creep in."""
        self.begin(here)
        self.check(here)
        return self.check(there)

    def follow(self, here: Mapping[str, float], target: Mapping[str, float]) -> str:
        """Watch over a motion, cycle by cycle.

        A joint is taken to be where it was told to be last, else where it is: a servo that holds droops.

        Args:
            here: Where all joints are, radians.
            target: Where some of them are sent next; if none that the model knows are, the arm rests.

        Returns:
            Why they must not be; empty if nothing speaks against it.
        """
        if self._joints.isdisjoint(target):
            self._resting = True
            return ""
        if self._resting:
            self._resting = False
            self.begin(here)
            if self._told:
                # An arm that leans on the table was told to be further in than it is, and sets out from there.
                gate, floor = self._gate, self._floor
                self.begin({**here, **self._told})
                self._gate, self._floor = max(gate, self._gate), min(floor, self._floor)
        self._told.update(target)
        return "; ".join(self.check({**here, **self._told}).values())

    def forget(self) -> None:
        """What `follow` was told means nothing now, as after a stop, or when a hand may move the joints."""
        self._told.clear()
        self._resting = True

    def _look(self, positions: Mapping[str, float]) -> tuple[tuple[float, ...], float, str, float]:
        """The model's angles, how far a gate is violated, which point is lowest and how high that is."""
        angles = self._model.from_joints(positions)
        if not all(map(math.isfinite, angles)):
            if not self._moving:
                unknown = ", ".join(sorted(name for name in self._joints if not math.isfinite(positions[name])))
                raise UsageError(f"it is not known where {unknown} is, so gates and table cannot be checked")
            return angles, math.nan, "", math.nan
        points = self._model.points(angles)
        name = min(points, key=lambda name: points[name][2])
        return angles, self._model.gate_excess(angles), name, points[name][2]
