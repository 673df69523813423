"""The one list of checks of an arm's motion, for every goal, target, set-point and command.

Owns the checks, in this order: stop latch; known positions and torque; limits; speeds, joint coupling limits and
table along the path; when the motion begins, the bridge from the present position and the blend from the running
motion; and while it runs, the combined targets of all controllers. Must not know goals or time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Self

from hexwire.errors import GoalError, LimitError
from hexwire.model.state import JointFlag
from hexwire.motion.checks import check_move, check_trajectory
from hexwire.motion.fence import Fence
from hexwire.motion.trajectory import Sample, Spline, Tail, Trajectory

from ..loop.outcomes import Reason

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.arm import ArmModel
    from hexwire.model.kinematics import KinematicModel
    from hexwire.model.state import JointState
    from hexwire.motion.checks import MotionReport
    from hexwire.motion.safety import StopReason

__all__ = ["CheckedPath", "PathCheck"]

_BRIDGE_SAMPLES = 20
_BRIDGE_STEP = 0.01
"""Number of samples of the path to the first point, and their least distance in seconds."""
_NOWHERE = (math.inf, -math.inf)
_LONGEST = 3600.0
"""Seconds; a longer trajectory takes too long to check, and is usually given in the wrong unit."""
_BRIDGE_GRACE = 1.1
"""Factor on a joint's speed limit on the path to the first point, since a motion at the limit begins late."""


class _While(Trajectory):
    """A trajectory whose samples end with an error when nobody wants them any more."""

    def __init__(self, of: Trajectory, wanted: Callable[[], bool]) -> None:
        self.names, self.duration = of.names, of.duration
        self._of, self._wanted = of, wanted

    def at(self, t: float) -> Sample:
        if not self._wanted():
            raise GoalError("cancelled before it began", reason=Reason.CANCELLED)
        return self._of.at(t)


@dataclass(frozen=True, slots=True)
class CheckedPath:
    """Trajectories that passed the path check, to run one after the other.

    Attributes:
        legs: The trajectories; each begins where the previous one ends.
        reports: The result of the path check for each.
        start: Where all joints are at the beginning, radians.
        grip: How far the gripper opens or closes meanwhile: 0 is closed, 1 fully open; None if it stays. Jaws that
            meet an object hold it with little force.
        slowed: How long it takes, and why, if that is much longer than was asked for; else empty.
    """

    legs: tuple[Trajectory, ...]
    reports: tuple[MotionReport, ...]
    start: Mapping[str, float]
    grip: float | None = None
    slowed: str = ""


class PathCheck:
    """Checks the paths of one arm; its controllers share it.

    Args:
        arm: Limits and speeds.
        kinematics: For joint coupling limits and table; None to check neither.
        table: Height of the table above the base, metres; None for no table.
    """

    def __init__(self, arm: ArmModel, kinematics: KinematicModel | None, table: float | None) -> None:
        self._arm, self._kinematics, self._table = arm, kinematics, table
        self._bounds = {joint.name: (joint.minimum, joint.maximum) for joint in arm.joints}
        self._known = frozenset(() if kinematics is None else kinematics.joint_names)
        self._running = None if kinematics is None else Fence(kinematics, table, moving=True)
        # Without a table, an arm without a joint coupling limit has only the limits of its joints.
        self._fenced = kinematics is not None and (table is not None or kinematics.has_coupling)
        self._bridge_arm = replace(
            arm, joints=tuple(replace(joint, max_speed=_BRIDGE_GRACE * joint.max_speed) for joint in arm.joints)
        )

    @classmethod
    def of(cls, robot: RobotDriver, table: float | None = 0.0) -> Self:
        """The checks of a robot with its own geometry, as far as it is known."""
        return cls(robot.model, robot.kinematics, table)

    @classmethod
    def limits_only(cls, arm: ArmModel) -> Self:
        """Checks of single joints only: neither joint coupling limits nor table."""
        return cls(arm, None, None)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The joints on which joint coupling limits and table depend; empty if they are not checked."""
        return self._kinematics.joint_names if self._kinematics is not None else ()

    def stop_latch(self, reason: StopReason | None) -> None:
        """Check that no stop is latched.

        Raises:
            GoalError: A stop is latched; the text has its reason.
        """
        if reason is not None:
            raise GoalError(f"the arm is stopped ({reason}); reset first", reason=Reason.STOPPED)

    def ready(self, names: Collection[str], state: JointState, max_age: float) -> None:
        """Check that joints answer and have torque; otherwise the guard would soon stop the whole arm.

        Args:
            names: Joints that will move.
            state: The newest state.
            max_age: Seconds after which a silent joint is lost.

        Raises:
            GoalError: A joint does not answer, or has no torque.
        """
        silent = [name for name in names if state[name].flags & JointFlag.SILENT and state[name].age > max_age]
        if silent:
            text = f"no answer from {', '.join(silent)} for more than {max_age:g} s; check the servo"
            raise GoalError(text, reason=Reason.NOT_READY)
        without_torque = [name for name in names if not state[name].flags & JointFlag.TORQUE_ON]
        if without_torque:
            raise GoalError(f"no torque on {', '.join(without_torque)}; enable it first", reason=Reason.NOT_READY)

    def limits(self, goal: Mapping[str, float]) -> None:
        """Check that every joint exists, and that its angle in radians is within its limits.

        Raises:
            LimitError: An angle is outside its limits.
            UsageError: There is no such joint.
        """
        bounds = self._bounds
        for name, angle in goal.items():
            low, high = bounds.get(name, _NOWHERE)
            if not low <= angle <= high:
                self._arm.joint(name).check(angle)

    def target(self, here: Mapping[str, float], goal: Mapping[str, float]) -> None:
        """Check limits, and joint coupling limits and the table on the straight path of joints to a goal.

        Args:
            here: Positions of all joints, radians.
            goal: Target positions of some joints, radians.

        Raises:
            LimitError: The path is not allowed.
            UsageError: The position of a joint is unknown.
        """
        self.limits(goal)
        if self._kinematics is not None:
            check_move(here, goal, self._kinematics, self._table)

    def posture(self, here: Mapping[str, float], goal: Mapping[str, float]) -> None:
        """Check limits, and joint coupling limits and the table at the goal only.

        Args:
            here: Positions of all joints, radians.
            goal: Target positions of some joints, radians.

        Raises:
            LimitError: The goal is not allowed.
        """
        self.limits(goal)
        self.guided()(here, goal)

    def guided(self) -> Callable[[Mapping[str, float], Mapping[str, float]], None]:
        """`posture` for a stream of set-points in one thread: each begins where the last one ended.

        Its caller keeps each joint within its limits, or asks `limits`.
        """
        if self._kinematics is None or not self._fenced:
            return lambda here, goal: None
        return partial(self._posture, Fence(self._kinematics, self._table))

    def _posture(self, fence: Fence, here: Mapping[str, float], goal: Mapping[str, float]) -> None:
        if goal.keys().isdisjoint(self._known):
            return
        if found := fence.check_end(here, goal if len(goal) == len(here) else {**here, **goal}):
            raise LimitError(f"{'; '.join(found.values())}; nothing was sent")

    def trajectory(
        self,
        trajectory: Trajectory,
        others: Mapping[str, float],
        meanwhile: Sequence[Trajectory] = (),
        *,
        wanted: Callable[[], bool] = lambda: True,
        goes_on: bool = False,
    ) -> MotionReport:
        """Check limits, speeds, joint coupling limits and the table along a trajectory.

        Args:
            trajectory: The trajectory.
            others: Positions of the arm's joints, radians.
            meanwhile: Trajectories of other joints, from its beginning on.
            wanted: Asked again and again, since the check may take long: whether the result is still wanted.
            goes_on: As in `check_trajectory`.

        Returns:
            The result of the check.

        Raises:
            GoalError: The path is not allowed; CANCELLED if it is no longer wanted.
        """
        if trajectory.duration > _LONGEST:
            text = f"the trajectory lasts {trajectory.duration:g} s; send at most {_LONGEST:g} s at a time"
            raise GoalError(text, reason=Reason.MALFORMED)
        try:
            return check_trajectory(
                _While(trajectory, wanted),
                self._arm,
                self._kinematics,
                others=others,
                meanwhile=meanwhile,
                table=self._table,
                goes_on=goes_on,
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
        """Check the path to the first point again, since time has passed and points may have been dropped.

        Args:
            trajectory: The trajectory.
            others: Positions of the arm's joints, radians.
            meanwhile: Trajectories of other joints, from its beginning on.
            late: The trajectory begins after its time.

        Raises:
            GoalError: The path is not allowed.
        """
        bridge = Spline(trajectory.names, trajectory.waypoints[:2])
        step = max(_BRIDGE_STEP, bridge.duration / _BRIDGE_SAMPLES)
        findings = check_trajectory(
            bridge,
            self._bridge_arm,
            self._kinematics,
            others=others,
            meanwhile=[Tail(path, 0.0, bridge.duration) for path in meanwhile],
            table=self._table,
            step=step,
            goes_on=True,
        ).findings
        if findings:
            why = "too late" if late else "the path is no longer allowed"
            reason = Reason.TOO_LATE if late else Reason.PATH_NOT_ALLOWED
            raise GoalError(f"{why}: before the next point, {'; '.join(map(str, findings))}", reason=reason)

    def unchecked(
        self, trajectory: Trajectory, others: Mapping[str, float], meanwhile: Sequence[Trajectory] = ()
    ) -> str:
        """Check motion from a running path to another or to rest, which is on no path that was checked before.

        Its limits are kept by its planning. As of all motion that has begun, the tolerance of `running` counts.

        Args:
            trajectory: The motion.
            others: Positions of the arm's joints, radians.
            meanwhile: Trajectories of other joints, from its beginning on.

        Returns:
            What is wrong with it; empty if nothing is.
        """
        if self._kinematics is None or not self._fenced:
            return ""
        fence = Fence(self._kinematics, self._table, moving=True)
        for t, sample in trajectory.samples(_BRIDGE_STEP):
            positions = dict(zip(trajectory.names, sample.position, strict=True))
            where = dict(others)
            for other in meanwhile:
                where.update(zip(other.names, other.sample(t).position, strict=True))
            if found := fence.follow({**where, **positions}, positions):
                return f"{t:.2f} s after it begins, {found}"
        return ""

    def running(self, here: Mapping[str, float], target: Mapping[str, float]) -> str:
        """Check the next combined target, since each controller checks only its own path; returns the violations.

        The limits of its joints were checked with each path, and the driver checks them again.

        Args:
            here: Present positions of all joints, radians.
            target: Next targets of some joints, radians; empty while the arm rests.
        """
        return "" if self._running is None else self._running.follow(here, target)

    def forget(self) -> None:
        """Forget the targets given to `running`, for example after a stop or before motion by hand."""
        if self._running is not None:
            self._running.forget()
