"""What speaks against a way before the arm takes it: all of it when it comes, its beginning again when it begins.

Owns the two looks and the reasons they give. Must not know goals, time or what is followed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from hexwire.errors import GoalError, LimitError
from hexwire.motion.checks import check_trajectory
from hexwire.motion.fence import Fence
from hexwire.motion.waypoints import Spline, Tail

from .outcomes import Reason

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel
    from hexwire.model.kinematics import KinematicModel
    from hexwire.motion.waypoints import Trajectory

__all__ = ["Ways"]

_BRIDGE_SAMPLES = 20
_BRIDGE_STEP = 0.01
"""The way to the first point is looked at so often, but not at shorter steps of seconds."""
_LONGEST = 3600.0
"""Seconds; a longer trajectory would take too long to check, and is most often a unit that was mistaken."""
_BRIDGE_GRACE = 1.1
"""What the way to the first point may be faster than a joint's limit, since a motion at the limit begins late."""


class Ways:
    """Checks ways of an arm.

    Args:
        arm: Limits and speeds.
        kinematics: For gates and table; None to check neither.
        table: Height of the table above the base, metres; None for none.
    """

    def __init__(self, arm: ArmModel, kinematics: KinematicModel | None, table: float | None) -> None:
        self._arm, self._kinematics, self._table = arm, kinematics, table
        self._bridge_arm = replace(
            arm, joints=tuple(replace(joint, max_speed=_BRIDGE_GRACE * joint.max_speed) for joint in arm.joints)
        )

    def check(
        self, trajectory: Trajectory, others: Mapping[str, float], meanwhile: Sequence[Trajectory] = ()
    ) -> None:
        """Limits, speeds, gates and the table all along a trajectory.

        Args:
            trajectory: What shall be followed.
            others: Where the arm's joints are, radians.
            meanwhile: What other joints do from its beginning on.

        Raises:
            GoalError: It must not be run.
        """
        if trajectory.duration > _LONGEST:
            text = f"the trajectory lasts {trajectory.duration:g} s; send at most {_LONGEST:g} s at a time"
            raise GoalError(text, reason=Reason.MALFORMED)
        try:
            check_trajectory(
                trajectory, self._arm, self._kinematics, others=others, meanwhile=meanwhile, table=self._table
            ).require()
        except LimitError as error:
            raise GoalError(str(error), reason=Reason.PATH_NOT_ALLOWED) from None

    def check_bridge(
        self,
        trajectory: Spline,
        others: Mapping[str, float],
        meanwhile: Sequence[Trajectory] = (),
        *,
        late: bool,
    ) -> None:
        """The way to the first point is not the one that was checked: time has passed, and points with it.

        Args:
            trajectory: What shall be followed.
            others: Where the arm's joints are, radians.
            meanwhile: What other joints do from its beginning on.
            late: It comes after its time.

        Raises:
            GoalError: It must not be run.
        """
        bridge = Spline(trajectory.names, trajectory.waypoints[:2])
        step = max(_BRIDGE_STEP, bridge.duration / _BRIDGE_SAMPLES)
        findings = check_trajectory(
            bridge,
            self._bridge_arm,
            self._kinematics,
            others=others,
            meanwhile=[Tail(way, 0.0, bridge.duration) for way in meanwhile],
            table=self._table,
            step=step,
        ).findings
        if findings:
            why = "too late" if late else "not any more"
            reason = Reason.TOO_LATE if late else Reason.PATH_NOT_ALLOWED
            raise GoalError(f"{why}: on the way to the next point, {'; '.join(map(str, findings))}", reason=reason)

    def check_takeover(
        self, samples: Iterable[tuple[float, Mapping[str, float]]], others: Mapping[str, float]
    ) -> None:
        """Between a motion under way and a new one the arm is on neither of the ways that were checked.

        Args:
            samples: As `Follower.takeover` gives them.
            others: Where the arm's joints are, radians.

        Raises:
            GoalError: It must not be run.
        """
        if self._kinematics is None:
            return
        fence = Fence(self._kinematics, self._table, moving=True)
        for t, positions in samples:
            if found := fence.follow({**others, **positions}, positions):
                text = f"{t:.2f} s after it takes over from the motion under way, {found}; let that end first"
                raise GoalError(text, reason=Reason.PATH_NOT_ALLOWED)
