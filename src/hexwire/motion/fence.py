"""Checks of the whole arm beyond the limits of its single joints: joint coupling limit and table.

Owns the check of successive postures, and the rule that an arm in a forbidden posture may move out of it. Must not
know time, trajectories or robots.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from hexwire.errors import UsageError
from hexwire.model.kinematics import KinematicModel

__all__ = ["Fence"]

_CREEP = 1e-6
"""Tolerance for rounding, radians or metres."""
_WAY_OUT_ANGLE = math.radians(0.5)
_WAY_OUT_HEIGHT = 0.002
"""How much further in an arm that starts in a forbidden posture may go while it moves out, radians and metres."""
_SLACK_ANGLE = math.radians(0.5)
_SLACK_HEIGHT = 0.002
"""Tolerance for an arm in motion: its trajectory was checked in steps, and joints that are held sag."""


class Fence:
    """Checks postures, in the order in which the arm takes them.

    Args:
        model: The kinematics.
        table: Height above the base below which no point of the arm may come, metres; None for no table.
        moving: The postures are those of an arm in motion, not of a plan, and get a tolerance: half a degree at the
            joint coupling limit, 2 mm at the table. A posture with a joint of unknown position is not checked.

    Attributes:
        lowest: Height of the lowest point of the arm in the last posture, metres.
    """

    def __init__(self, model: KinematicModel, table: float | None = 0.0, *, moving: bool = False) -> None:
        self.lowest = math.inf
        self._joints = frozenset(model.joint_names)
        self._model, self._table, self._moving = model, table, moving
        self._slack_angle = _SLACK_ANGLE if moving else _CREEP
        self._slack_height = _SLACK_HEIGHT if moving else _CREEP
        # How far in the arm may be: as far as at the start, and never further in than its last posture.
        self._excess, self._floor = 0.0, -math.inf
        self._resting = True
        self._told: dict[str, float] = {}
        self._levers = {} if table is None or model.has_coupling else model.levers
        # The last end that was checked, and how far above the table its lowest point was: a posture so near to it
        # that it cannot have come down to the table needs no other look.
        self._end: Mapping[str, float] = {}
        self._clear = -math.inf
        # The newest look: a motion goes on from the posture that was looked at last.
        self._seen: tuple[tuple[float, ...], tuple[float, str, float]] | None = None

    def begin(self, here: Mapping[str, float]) -> None:
        """Restart at the arm's present posture, in radians by the driver's joints.

        Raises:
            UsageError: The position of a joint is unknown, and the arm is not `moving`.
        """
        # Comparisons with NaN are false: while a position is unknown, no way out of a forbidden posture is granted.
        _, excess, _, height = self._look(here)
        self._excess = excess + _WAY_OUT_ANGLE if excess > 0.0 else 0.0
        if self._table is not None:
            self._floor = height - _WAY_OUT_HEIGHT if height < self._table else self._table

    def check(self, positions: Mapping[str, float]) -> dict[str, str]:
        """Check the next posture.

        Args:
            positions: Radians, of all the model's joints by the driver's names.

        Returns:
            Violations by "coupling" (the joint coupling limit) and "table"; empty if there are none, and then the
            posture becomes the last one.

        Raises:
            UsageError: As `begin`.
        """
        found = {}
        angles, excess, name, self.lowest = self._look(positions)
        if excess > self._excess + self._slack_angle:
            own = [r.name for r in self._model.ranges]
            violations = self._model.violations(angles)
            found["coupling"] = next(
                (v for v in violations if v.split("=")[0] not in own), "the joint coupling limit is violated"
            )
        if self._table is not None and self.lowest < self._floor - self._slack_height:
            depth, level = 1e3 * (self._table - self.lowest), 1e3 * self._table
            found["table"] = f"the {name} would be {depth:.1f} mm below the table at {level:.0f} mm"
        if not found:
            self._excess = min(self._excess, excess)
            if self._table is not None:
                self._floor = min(self._table, max(self._floor, self.lowest))
        return found

    @property
    def below(self) -> str:
        """That the last posture that passed is below the table, in words; empty if it is not."""
        if self._table is None or not self.lowest < self._table - self._slack_height:
            return ""
        depth, level = 1e3 * (self._table - self.lowest), 1e3 * self._table
        return f"the arm would still be {depth:.1f} mm below the table at {level:.0f} mm"

    def check_end(self, here: Mapping[str, float], there: Mapping[str, float]) -> dict[str, str]:
        """Like `begin` and `check`, for a posture where the arm stays: not further in, or it would creep in."""
        if self._clear > 0.0:
            end = self._end
            # Nobody needs to know where the arm is now: so near to the last end it is allowed from anywhere.
            way = 0.0
            for name, lever in self._levers.items():
                way += lever * abs(there[name] - end[name])
            if way < self._clear:
                return {}
        if not math.isfinite(sum(here.values())):
            # A joint whose position is unknown is refused here; otherwise only the end matters.
            self._angles(here)
        self._excess, self._floor = 0.0, -math.inf if self._table is None else self._table
        if not (found := self.check(there)):
            # Allowed wherever the arm is now.
            if self._levers and self._table is not None:
                self._end, self._clear = dict(there), self.lowest - self._table
            return found
        _, excess, _, height = self._look(here)
        # As `begin`, without what it grants for a way out.
        self._excess = excess if excess > 0.0 else 0.0
        if self._table is not None:
            self._floor = height if height < self._table else self._table
        return self.check(there)

    def follow(self, here: Mapping[str, float], target: Mapping[str, float]) -> str:
        """Supervise a motion, cycle by cycle.

        The position of a joint is its last target, otherwise its present position: a servo that holds sags.

        Args:
            here: Present positions of all joints, radians.
            target: Next targets of some joints; without any joint that the model knows, the arm rests.

        Returns:
            The violations; empty if there are none.
        """
        if self._joints.isdisjoint(target):
            self._resting = True
            return ""
        if self._resting:
            self._resting = False
            self.begin(here)
            if self._told:
                # The last target of an arm that leans on the table is further in than its position.
                excess, floor = self._excess, self._floor
                self.begin({**here, **self._told})
                self._excess, self._floor = max(excess, self._excess), min(floor, self._floor)
        self._told.update(target)
        return "; ".join(self.check({**here, **self._told}).values())

    def forget(self) -> None:
        """Forget the targets given to `follow`, for example after a stop or before motion by hand."""
        self._told.clear()
        self._resting = True

    def _look(self, positions: Mapping[str, float]) -> tuple[tuple[float, ...], float, str, float]:
        """The model's angles, the excess over the joint coupling limit, the lowest point and its height."""
        angles = self._angles(positions)
        if angles is None:
            return (), math.nan, "", math.nan
        if self._seen is None or self._seen[0] != angles:
            self._seen = angles, (self._model.coupling_excess(angles), *self._model.lowest(angles))
        return angles, *self._seen[1]

    def _angles(self, positions: Mapping[str, float]) -> tuple[float, ...] | None:
        """The model's angles; None if one is unknown and the arm is `moving`, otherwise that is a `UsageError`."""
        angles = self._model.from_joints(positions)
        if math.isfinite(sum(angles)) or all(map(math.isfinite, angles)):
            return angles
        if self._moving:
            return None
        unknown = ", ".join(sorted(name for name in self._joints if not math.isfinite(positions[name])))
        raise UsageError(f"the position of {unknown} is unknown, so the path cannot be checked")
