"""What is checked before an arm moves: the one list of checks, for every goal, target, set-point and command.

Owns the checks, in this order: stop latch; known positions and torque; limits; speeds, joint coupling limits and
table along the path; and, when the motion begins, the bridge from where the arm is then and the blend from a motion
under way. Must not know goals, time or what is followed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from hexwire.errors import GoalError, LimitError
from hexwire.model.state import JointFlag
from hexwire.motion.checks import check_move, check_trajectory
from hexwire.motion.fence import Fence
from hexwire.motion.waypoints import Spline, Tail

from .outcomes import Reason

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel
    from hexwire.model.kinematics import KinematicModel
    from hexwire.model.state import JointState
    from hexwire.motion.checks import MotionReport
    from hexwire.motion.safety import StopReason
    from hexwire.motion.waypoints import Trajectory

__all__ = ["PathCheck"]

_BRIDGE_SAMPLES = 20
_BRIDGE_STEP = 0.01
"""The way to the first point is looked at so often, but not at shorter steps of seconds."""
_LONGEST = 3600.0
"""Seconds; a longer trajectory would take too long to check, and is most often a unit that was mistaken."""
_BRIDGE_GRACE = 1.1
"""What the way to the first point may be faster than a joint's limit, since a motion at the limit begins late."""


class PathCheck:
    """Checks the paths of an arm.

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

    def stop_latch(self, reason: StopReason | None) -> None:
        """No stop is latched.

        Raises:
            GoalError: One is, for this reason.
        """
        if reason is not None:
            raise GoalError(f"the arm is stopped ({reason}); reset first", reason=Reason.STOPPED)

    def ready(self, names: Collection[str], state: JointState, max_age: float) -> None:
        """Joints answer and have torque; else the guard would stop the whole arm a moment later.

        Args:
            names: Those that are to move.
            state: The newest.
            max_age: Seconds after which a silent joint is lost.

        Raises:
            GoalError: One does not.
        """
        deaf = [name for name in names if state[name].flags & JointFlag.SILENT and state[name].age > max_age]
        if deaf:
            text = f"{', '.join(deaf)} has not been heard of for more than {max_age:g} s; see to the servo"
            raise GoalError(text, reason=Reason.NOT_READY)
        limp = [name for name in names if not state[name].flags & JointFlag.TORQUE_ON]
        if limp:
            raise GoalError(f"no torque on {', '.join(limp)}; enable it first", reason=Reason.NOT_READY)

    def limits(self, goal: Mapping[str, float]) -> None:
        """Every joint exists, and its angle in radians is within its limits.

        Raises:
            LimitError: One is not.
            UsageError: There is no such joint.
        """
        for name, angle in goal.items():
            self._arm.joint(name).check(angle)

    def target(self, here: Mapping[str, float], goal: Mapping[str, float]) -> None:
        """Limits; joint coupling limits and the table on the straight path of joints to a goal.

        Args:
            here: Where all joints are, radians.
            goal: Where some of them are to go, radians.

        Raises:
            LimitError: The path is not allowed.
            UsageError: It is unknown where a joint is.
        """
        self.limits(goal)
        if self._kinematics is not None:
            check_move(here, goal, self._kinematics, self._table)

    def posture(self, here: Mapping[str, float], goal: Mapping[str, float]) -> None:
        """Limits; joint coupling limits and the table where the arm is to stay.

        Args:
            here: Where all joints are, radians.
            goal: Where some of them are to go, radians.

        Raises:
            LimitError: It is not allowed there.
        """
        self.limits(goal)
        if self._kinematics is None or goal.keys().isdisjoint(self._kinematics.joint_names):
            return
        fence = Fence(self._kinematics, self._table)
        if found := fence.check_end(here, {**here, **goal}):
            raise LimitError(f"{'; '.join(found.values())}; nothing was sent")

    def trajectory(
        self, trajectory: Trajectory, others: Mapping[str, float], meanwhile: Sequence[Trajectory] = ()
    ) -> MotionReport:
        """Limits, speeds, joint coupling limits and the table all along a trajectory.

        Args:
            trajectory: What is to be followed.
            others: Where the arm's joints are, radians.
            meanwhile: What other joints do from its beginning on.

        Returns:
            What was found.

        Raises:
            GoalError: The path is not allowed.
        """
        if trajectory.duration > _LONGEST:
            text = f"the trajectory lasts {trajectory.duration:g} s; send at most {_LONGEST:g} s at a time"
            raise GoalError(text, reason=Reason.MALFORMED)
        try:
            return check_trajectory(
                trajectory, self._arm, self._kinematics, others=others, meanwhile=meanwhile, table=self._table
            ).require()
        except LimitError as error:
            raise GoalError(str(error), reason=Reason.PATH_NOT_ALLOWED) from None

    def bridge(
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

    def takeover(self, samples: Iterable[tuple[float, Mapping[str, float]]], others: Mapping[str, float]) -> None:
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
