"""One trajectory controller: what its joints follow, for whom, and how that ended.

Owns the life of a goal: accepted, replaced, cancelled, within its tolerances or not, over. Time comes in as an
argument, and what was sent as plain values. Must not know messages, robots, threads or clocks.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hexwire.errors import GoalError, HexwireError
from hexwire.model.state import JointState, JointTarget
from hexwire.motion.follower import Follower, Mode
from hexwire.motion.safety import StopReason
from hexwire.motion.waypoints import Sample

from .arrival import Arrival, Deviation, Verdict
from .goals import check_goal
from .outcomes import Ended, GoalListener, Outcome, Progress, Reason
from .path_check import PathCheck
from .plan import Plan

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel
    from hexwire.model.kinematics import KinematicModel
    from hexwire.motion.safety import SafetyLimits
    from hexwire.motion.waypoints import Trajectory

    from .goals import Tolerances, TrajectoryGoal
    from .settings import ControllerSettings

__all__ = ["TrajectoryController"]

_STOPS_BY_PATH = frozenset({"following", "collision", "overload"})
"""Kinds of a `StopReason` that mean the arm left its path."""

_PAST = 1.0
"""Seconds back to which a question for the desired state is answered while the joints hold: messages take time."""
_TOGETHER = 0.03
"""Seconds between samples of joints that count as taken at once."""


@dataclass(slots=True)
class _Active:
    """What is being followed: with a listener somebody waits for its end, without one it is a mere command."""

    listener: GoalListener | None
    tolerances: Tolerances
    begins: float
    arrival: Arrival


def _active(listener: GoalListener | None, tolerances: Tolerances, begins: float, ends: float) -> _Active:
    return _Active(listener, tolerances, begins, Arrival(tolerances.goal, ends, tolerances.goal_time))


class TrajectoryController:
    """Follows trajectories and set-points with some joints of an arm.

    Args:
        settings: Name, joints and tolerances.
        arm: Limits and speeds.
        limits: When to stop by itself.
        kinematics: For gates and table; None to check neither.
        table: Height of the table above the base, metres; None for none.
        command_timeout: Seconds without a set-point after which the joints hold.

    Attributes:
        settings: As given.
        follower: What the joints are told.
        off: Joints that were not at the goal when that was judged last, worst first.
    """

    def __init__(
        self,
        settings: ControllerSettings,
        arm: ArmModel,
        limits: SafetyLimits,
        *,
        kinematics: KinematicModel | None = None,
        table: float | None = None,
        command_timeout: float = 0.5,
    ) -> None:
        self.settings = settings
        self.follower = Follower(arm, limits, lost_after=command_timeout)
        self._check = PathCheck(arm, kinematics, table)
        self.off: tuple[Deviation, ...] = ()
        self._places = tuple(arm.index(name) for name in settings.joints)
        self._active: _Active | None = None
        # A plan whose time has not come: what was under way goes on until then.
        self._pending: Plan | None = None
        self._ended: list[tuple[GoalListener, Ended]] = []
        self._progress: Progress | None = None

    @property
    def joints(self) -> tuple[str, ...]:
        """Names, in the order of all values."""
        return self.settings.joints

    @property
    def listener(self) -> GoalListener | None:
        """Who waits for the end of what is followed."""
        return self._active.listener if self._active else None

    @property
    def busy(self) -> bool:
        """Something is followed, or will be; or the end of a goal is still waited for."""
        return self._active is not None or self._pending is not None or not self.follower.done

    @property
    def moving(self) -> bool:
        """It sends its joints somewhere."""
        return not self.follower.done

    @property
    def reason(self) -> StopReason | None:
        """Why it is stopped, or None."""
        return self.follower.reason

    @property
    def words(self) -> str:
        """What it does, for people."""
        if self.follower.mode is Mode.STOPPED:
            return f"stopped: {self.follower.reason}"
        return "waiting for its time" if self._pending is not None else self.follower.mode.value

    @property
    def progress(self) -> Progress | None:
        """Of the last cycle; None before there was one with all joints."""
        return self._progress

    def take_ended(self) -> list[tuple[GoalListener, Ended]]:
        """Goals that have ended since the last call. They must be told outside any lock."""
        ended, self._ended = self._ended, []
        return ended

    # -- what others ask ----------------------------------------------------------------------------

    def start(self, delay: float, state: JointState, now: float) -> Sample:
        """Where the joints are meant to be when what is for `delay` seconds from now begins; now at the earliest.

        Raises:
            GoalError: Stopped, or not all of them have been heard of.
        """
        self._refuse_if_stopped()
        self.follower.observe(state)
        try:
            return self.follower.desired(self.joints, self.follower.next_start(now + max(0.0, delay)))
        except HexwireError as error:
            raise GoalError(str(error), reason=Reason.NOT_READY) from None

    def query(self, when: float, now: float, state: JointState) -> Sample:
        """Where the joints are meant to be at a time, as far as what is followed now says.

        Args:
            when: Seconds, host clock.
            now: Likewise.
            state: The newest.

        Raises:
            GoalError: Stopped, not all joints have been heard of, or the time is before what is followed began.
        """
        self._refuse_if_stopped()
        follows = self._active is not None and self._pending is None and self.follower.mode is Mode.TRAJECTORY
        begins = self._active.begins if self._active is not None and follows else now - _PAST
        if when < begins:
            text = f"{now - when:.3g} s ago something else was followed, or nothing"
            raise GoalError(text, reason=Reason.MALFORMED)
        self.follower.observe(state)
        try:
            return self.follower.desired(self.joints, when)
        except HexwireError as error:
            raise GoalError(str(error), reason=Reason.NOT_READY) from None

    def plan(self, goal: TrajectoryGoal, received: float) -> Plan:
        """What a goal makes the joints do; looks at nothing that changes, so needs no lock.

        Args:
            goal: What was sent.
            received: When `goal.delay` was true, seconds.

        Raises:
            GoalError: It is malformed or not for these joints.
        """
        check_goal(goal, self.joints, allow_partial=self.settings.allow_partial)
        return Plan(goal, self.joints, received)

    def check_path(self, trajectory: Trajectory, state: JointState, meanwhile: Sequence[Trajectory] = ()) -> None:
        """Limits, speeds, joint coupling limits and the table all along a trajectory, and that its joints can move.

        Args:
            trajectory: What is to be followed.
            state: The newest.
            meanwhile: What other controllers do from its beginning on.

        Raises:
            GoalError: The path is not allowed.
        """
        self._refuse_unready(trajectory.names, state)
        self._check.trajectory(trajectory, state.positions, meanwhile)

    def accept(
        self,
        plan: Plan,
        state: JointState,
        now: float,
        *,
        listener: GoalListener | None = None,
        tolerances: Tolerances | None = None,
        meanwhile: Sequence[Trajectory] = (),
    ) -> None:
        """Follow a goal that was planned and checked; what was followed before is preempted.

        Args:
            plan: Of the goal.
            state: The newest.
            now: Seconds.
            listener: Who wants to hear of its end.
            tolerances: In place of the controller's own.
            meanwhile: What other controllers do from now on.

        Raises:
            GoalError: Stopped, without torque, or too late by now; nothing was changed.
        """
        self._refuse_unready(self.joints, state)
        tolerances = tolerances or self.settings.tolerances
        if plan.goal.delay > 0.0 and plan.due > self.follower.next_start(now):
            self._preempt("replaced by a new one")
            self._pending = plan
            self._active = _active(listener, tolerances, plan.due, math.inf)
            return
        trajectory = self._due(plan, state, now, meanwhile)
        self.follow(trajectory, state, now, listener=listener, tolerances=tolerances)

    def follow(
        self,
        trajectory: Trajectory,
        state: JointState,
        now: float,
        *,
        listener: GoalListener | None = None,
        tolerances: Tolerances | None = None,
    ) -> None:
        """Follow a trajectory that begins where the joints are; otherwise as `accept`."""
        self._refuse_if_stopped()
        self.follower.observe(state)
        begins = self.follower.next_start(now)
        try:
            self._take_over(trajectory, state, now)
        except GoalError:
            raise
        except HexwireError as error:
            raise GoalError(str(error), reason=Reason.PATH_NOT_ALLOWED) from None
        self._preempt("replaced by a new one")
        ends = now + self.follower.remaining(now)
        self._active = _active(listener, tolerances or self.settings.tolerances, begins, ends)

    def set_points(self, positions: Mapping[str, float], state: JointState, now: float) -> None:
        """Pursue set-points, radians by joint; a goal under way is preempted.

        Raises:
            LimitError: Outside limits.
            GoalError: Stopped, or a joint has no torque or was never heard of.
        """
        self.check_set_points(positions, state)
        self.follower.set_point(positions, now)
        self._preempt("replaced by set-points")

    def check_set_points(self, positions: Mapping[str, float], state: JointState) -> None:
        """Refuse what `set_points` would; changes nothing."""
        self._refuse_unready(positions, state)
        self._check.limits(positions)
        self.follower.observe(state)
        try:
            self.follower.desired(tuple(positions), 0.0)
        except HexwireError as error:
            raise GoalError(str(error), reason=Reason.NOT_READY) from None

    def hold(self, why: str) -> None:
        """Stay where the last command was; a goal under way is preempted."""
        self.follower.hold()
        self._preempt(why)

    def cancel(self, listener: GoalListener) -> None:
        """Hold, if what is followed is this one's goal."""
        if self.listener is listener:
            self.hold("cancelled")

    def stop(self, reason: StopReason) -> None:
        """Latch a stop; a goal under way is aborted."""
        self.follower.stop(reason)
        why = Reason.PATH_TOLERANCE if reason.kind in _STOPS_BY_PATH else Reason.STOPPED
        self._end(Outcome.ABORTED, why, f"stopped: {reason}")

    def reset(self) -> None:
        """End a stop. Nothing moves by it."""
        self.follower.reset()

    def release(self, why: str) -> None:
        """The joints are no longer held: what was commanded is forgotten, a goal under way aborted."""
        self.follower.forget()
        self._end(Outcome.ABORTED, Reason.NOT_READY, why)

    # -- the cycle ----------------------------------------------------------------------------------

    def cycle(self, state: JointState, now: float, lead: float) -> JointTarget | StopReason | None:
        """One cycle; as `Follower.cycle`."""
        self._begin_pending(state, now)
        slips = self.follower.counters.slips
        order = self.follower.cycle(state, now, lead)
        active = self._active
        if isinstance(order, StopReason):
            self.stop(order)
        elif active is not None and self._pending is None:
            # The follower slips after a stall; so does the end.
            if self.follower.mode is Mode.TRAJECTORY:
                active.arrival.ends = now + self.follower.remaining(now)
            elif self.follower.counters.slips > slips:
                active.arrival.ends = now + lead
        return order

    def _begin_pending(self, state: JointState, now: float) -> None:
        pending, active = self._pending, self._active
        if pending is None or active is None or self.follower.next_start(now) < pending.due:
            return
        self._pending = None
        begins = self.follower.next_start(now)
        try:
            self._refuse_unready(self.joints, state)
            self._take_over(self._due(pending, state, now), state, now)
        except HexwireError as error:
            self.follower.hold()
            reason = Reason(error.reason) if isinstance(error, GoalError) else Reason.PATH_NOT_ALLOWED
            self._end(Outcome.ABORTED, reason, str(error))
        else:
            active.begins, active.arrival.ends = begins, now + self.follower.remaining(now)

    def _take_over(self, trajectory: Trajectory, state: JointState, now: float) -> None:
        self._check.takeover(self.follower.takeover(trajectory, now), state.positions)
        self.follower.follow(trajectory, now)

    def _due(self, plan: Plan, state: JointState, now: float, meanwhile: Sequence[Trajectory] = ()) -> Trajectory:
        """The trajectory of a plan whose time has come, from where the joints are; its points keep their times.

        Raises:
            GoalError: So late by now that the way to the next point would be too fast.
        """
        start, begins = self.start(0.0, state, now), self.follower.next_start(now)
        if plan.is_over(begins):
            # Well, if the joints are where it ends.
            with suppress(GoalError):
                return plan.end(start)
        trajectory = plan.trajectory(start, begins)
        self._check.bridge(trajectory, state.positions, meanwhile, late=plan.late(begins) > 0.0)
        return trajectory

    def judge(self, state: JointState, velocity: Sequence[float], now: float) -> None:
        """Compare measured with desired, at every state; ends a goal that is out of tolerance, or done.

        Args:
            state: Just read; its joints are the arm's.
            velocity: Of all the arm's joints, radians per second; NaN where it is not known.
            now: Seconds.
        """
        ages = [state.age[i] for i in self._places]
        sampled, oldest = state.stamp - min(ages), state.stamp - max(ages)
        try:
            desired = self._desired(ages, state.stamp, now)
        except HexwireError:
            return  # not all joints have been heard of
        position = tuple(state.position[i] for i in self._places)
        speed = tuple(velocity[i] for i in self._places)
        self._progress = Progress(self.joints, desired, position, speed, sampled)
        active = self._active
        if active is None or self._pending is not None:
            return
        if self.follower.mode is Mode.TRAJECTORY:
            # What was sampled before the trajectory began says nothing about it.
            if sampled > active.begins:
                wrong = active.tolerances.path_violation(self.joints, desired, position, speed)
                if wrong:
                    self.follower.hold()
                    self._end(Outcome.ABORTED, Reason.PATH_TOLERANCE, wrong)
        elif active.listener is None:
            self._active = None
        else:
            verdict = active.arrival.judge(now, self.joints, desired, position, speed, oldest)
            self.off = active.arrival.off
            if verdict is Verdict.ARRIVED:
                self._end(Outcome.SUCCEEDED, Reason.REACHED)
            elif verdict is Verdict.MISSED:
                self._end(Outcome.ABORTED, Reason.GOAL_TOLERANCE, active.arrival.why)

    def _desired(self, ages: Sequence[float], stamp: float, now: float) -> Sample:
        """Where each joint was meant to be when it was sampled; never further than it was told."""
        told = min(now, self.follower.next_start(-math.inf))
        youngest = min(ages)
        if not max(ages) - youngest > _TOGETHER:
            return self.follower.desired(self.joints, min(stamp - youngest, told))
        rows = [self.follower.desired(self.joints, min(stamp - age, told)) for age in ages]
        return Sample(*(tuple(row[k][i] for i, row in enumerate(rows)) for k in range(3)))

    # -- helpers --------------------------------------------------------------------------------------

    def _refuse_if_stopped(self) -> None:
        self._check.stop_latch(self.reason)

    def _refuse_unready(self, names: Collection[str], state: JointState) -> None:
        self._refuse_if_stopped()
        self._check.ready(names, state, self.follower.guard.limits.max_age)

    def _preempt(self, why: str) -> None:
        self._end(Outcome.PREEMPTED, Reason.REPLACED, why)

    def _end(self, outcome: Outcome, reason: Reason, text: str = "") -> None:
        active, self._active, self._pending = self._active, None, None
        if active is not None and active.listener is not None:
            self._ended.append((active.listener, Ended(outcome, reason, text)))
