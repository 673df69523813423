"""A trajectory controller: moves joints along trajectories and set-points, and decides how goals end.

Owns the life of a goal: accepted, replaced, cancelled, within its tolerances or not, ended. Time comes in as an
argument, and goals as plain values. Must not know messages, robots, threads or clocks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hexwire.errors import GoalError, HexwireError
from hexwire.model.state import JointState, JointTarget
from hexwire.motion.moving import joint_limits
from hexwire.motion.safety import StopReason
from hexwire.motion.set_point_generator import Mode, SetPointGenerator, Ways
from hexwire.motion.takeover import take_over
from hexwire.motion.trajectory import Sample

from ..motion.arrival import Arrival, Deviation, Verdict, off_goal
from ..motion.goals import check_goal
from ..motion.path_check import PathCheck
from .outcomes import Ended, GoalListener, Outcome, Progress, Reason
from .plan import Plan

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel
    from hexwire.model.control_law import Laws
    from hexwire.motion.safety import SafetyLimits
    from hexwire.motion.trajectory import Trajectory

    from ..motion.goals import Tolerances, TrajectoryGoal
    from ..requests.settings import ControllerSettings

__all__ = ["TrajectoryController"]

_STOPS_BY_PATH = frozenset({"following", "collision", "overload"})
"""Kinds of a `StopReason` that mean the arm left its path."""

_PAST = 1.0
"""Seconds in the past for which a query is answered while the joints hold, since messages take time."""
_TOGETHER = 0.03
"""Seconds between samples of joints that count as simultaneous."""


@dataclass(slots=True)
class _Active:
    """The active goal. Without a listener, nothing waits for its end."""

    listener: GoalListener | None
    tolerances: Tolerances
    begins: float
    arrival: Arrival


@dataclass(frozen=True, slots=True)
class Outline:
    """What a goal begins with, if it begins at a time.

    Attributes:
        plan: Of the goal.
        begins: Seconds, host clock.
        start: How its joints move then.
        here: The same, as the generator begins there.
        changes: `SetPointGenerator.changes`.
        others: Positions of the arm's joints, radians.
        meanwhile: Trajectories of other controllers, from then on.
        streamed: Nobody waits for its end.
    """

    plan: Plan
    begins: float
    start: Sample
    here: Sample
    changes: int
    others: Mapping[str, float]
    meanwhile: Sequence[Trajectory]
    streamed: bool


@dataclass(frozen=True, slots=True)
class Ready:
    """A goal that may begin as soon as it is known that it still begins as in its outline."""

    outline: Outline
    trajectory: Trajectory
    ways: Ways


def _active(listener: GoalListener | None, tolerances: Tolerances, begins: float, ends: float) -> _Active:
    return _Active(listener, tolerances, begins, Arrival(tolerances.goal, ends, tolerances.goal_time))


class TrajectoryController:
    """Follows trajectories and set-points with some joints of an arm.

    Args:
        settings: Name, joints and tolerances.
        arm: Limits and speeds.
        limits: Thresholds that stop the arm automatically.
        check: The checks of the arm.
        command_timeout: Seconds without a set-point after which the joints hold.
        monitored: Keep `progress` up to date between goals too, which costs a third of an idle cycle.

    Attributes:
        settings: Name, joints and tolerances.
        monitored: Whether `progress` is kept up to date between goals too; may be changed at any time.
        generator: Computes the set-points.
        planning: Seconds that the last `prepare` took.
        off: Joints that were not at the goal at the last check of the arrival, worst first.
    """

    def __init__(
        self,
        settings: ControllerSettings,
        arm: ArmModel,
        limits: SafetyLimits,
        *,
        check: PathCheck,
        command_timeout: float = 0.5,
        monitored: bool = True,
    ) -> None:
        self.settings = settings
        self.monitored = monitored
        self._check = check
        self.generator = SetPointGenerator(arm, limits, lost_after=command_timeout, allowed=self._wrong)
        self.off: tuple[Deviation, ...] = ()
        self.planning = 0.0
        # What other controllers do while a goal begins.
        self._meanwhile: Sequence[Trajectory] = ()
        self._places = tuple(arm.index(name) for name in settings.joints)
        self._active: _Active | None = None
        # A plan that begins later: the running motion continues until then.
        self._pending: Plan | None = None
        self._ended: list[tuple[GoalListener, Ended]] = []
        self._progress: Progress | None = None

    @property
    def joints(self) -> tuple[str, ...]:
        """Names, in the order of all values."""
        return self.settings.joints

    @property
    def listener(self) -> GoalListener | None:
        """The listener of the active goal, or None."""
        return self._active.listener if self._active else None

    @property
    def begins(self) -> float:
        """When the active goal began or begins, seconds; infinite if there is none."""
        return self._active.begins if self._active else math.inf

    @property
    def busy(self) -> bool:
        """A goal is active or planned, or the joints are moving."""
        return self._active is not None or self._pending is not None or not self.generator.done

    @property
    def moving(self) -> bool:
        """The generator is moving the joints."""
        return not self.generator.done

    @property
    def waiting(self) -> bool:
        """A goal waits for its start, and its trajectory is not made yet."""
        return self._pending is not None

    @property
    def reason(self) -> StopReason | None:
        """Why it is stopped, or None."""
        return self.generator.reason

    @property
    def words(self) -> str:
        """The state of the controller in words."""
        if self.generator.mode is Mode.STOPPED:
            return f"stopped: {self.generator.reason}"
        return "waiting for the start time" if self.waiting else self.generator.mode.value

    @property
    def progress(self) -> Progress | None:
        """Progress at the last state; None before the first state with all joints, and at rest if unmonitored."""
        return self._progress

    def take_ended(self) -> list[tuple[GoalListener, Ended]]:
        """Goals that have ended since the last call. Call their listeners without holding a lock."""
        ended, self._ended = self._ended, []
        return ended

    # -- requests -----------------------------------------------------------------------------------

    def start(self, delay: float, state: JointState, now: float) -> Sample:
        """Desired state at the start of a motion that begins in `delay` seconds; now at the earliest.

        Raises:
            GoalError: The arm is stopped, or the position of a joint is unknown.
        """
        return self._planned(self.generator.desired, delay, state, now)

    def rest(self, state: JointState, now: float) -> Sample:
        """Desired state at the start of a motion that is planned now and begins at some later time.

        For joints that brake it is where they come to rest: however long the planning takes, they are there by
        then, or on their way there. Raises as `start`.
        """
        return self._planned(self.generator.rest, 0.0, state, now)

    def _planned(
        self, where: Callable[[tuple[str, ...], float], Sample], delay: float, state: JointState, now: float
    ) -> Sample:
        self._refuse_if_stopped()
        self.generator.observe(state)
        try:
            return where(self.joints, max(now + delay, self.generator.next_start(now)))
        except HexwireError as error:
            raise GoalError(str(error), reason=Reason.NOT_READY) from None

    def query(self, when: float, now: float, state: JointState) -> Sample:
        """Desired state at a time, according to the running motion.

        Args:
            when: Seconds, host clock.
            now: Seconds, host clock.
            state: The newest state.

        Raises:
            GoalError: The arm is stopped, the position of a joint is unknown, or the time is before the start of
                the running motion.
        """
        self._refuse_if_stopped()
        follows = self._active is not None and self._pending is None and self.generator.mode is Mode.TRAJECTORY
        begins = self._active.begins if self._active is not None and follows else now - _PAST
        if when < begins:
            text = f"the desired state of {now - when:.3g} s ago is not available"
            raise GoalError(text, reason=Reason.MALFORMED)
        self.generator.observe(state)
        try:
            return self.generator.desired(self.joints, when)
        except HexwireError as error:
            raise GoalError(str(error), reason=Reason.NOT_READY) from None

    def plan(self, goal: TrajectoryGoal, received: float, *, streamed: bool = False) -> Plan:
        """Plan a goal; reads nothing that changes, so it needs no lock.

        Args:
            goal: The goal.
            received: Time to which `goal.delay` refers, seconds.
            streamed: Nobody waits for its end, since the next is to follow: it may end in motion.

        Raises:
            GoalError: It is malformed or not for these joints.
        """
        check_goal(
            goal,
            self.joints,
            allow_partial=self.settings.allow_partial,
            end_at_rest=self.settings.end_at_rest and not streamed,
        )
        return Plan(goal, self.joints, received, streamed=streamed)

    def check_path(
        self,
        trajectory: Trajectory,
        state: JointState,
        meanwhile: Sequence[Trajectory] = (),
        *,
        wanted: Callable[[], bool] = lambda: True,
        streamed: Sample | None = None,
    ) -> None:
        """Check a trajectory's limits, speeds, joint coupling limits and table, and that its joints can move.

        One of a stream is checked as it will be followed: the way to its first point takes as long as it needs,
        since points without velocities are followed with a delay.

        Args:
            trajectory: The trajectory.
            state: The newest state.
            meanwhile: Trajectories of other controllers, from its beginning on.
            wanted: As in `PathCheck.trajectory`.
            streamed: The state in which it begins, if it is one of a stream.

        Raises:
            GoalError: The path is not allowed; CANCELLED if it is no longer wanted.
        """
        self._refuse_unready(trajectory.names, state)
        if streamed is not None:
            trajectory = take_over(streamed, trajectory, joint_limits(self.generator.arm, trajectory.names))
        self._check.trajectory(trajectory, state.positions, meanwhile, wanted=wanted, goes_on=streamed is not None)

    def accept(
        self,
        plan: Plan,
        state: JointState,
        now: float,
        *,
        listener: GoalListener | None = None,
        tolerances: Tolerances | None = None,
        meanwhile: Sequence[Trajectory] = (),
        ready: Ready | None = None,
    ) -> None:
        """Follow a planned and checked goal; the active goal is preempted.

        Args:
            plan: Plan of the goal.
            state: The newest state.
            now: Seconds.
            listener: Notified of its end.
            tolerances: Instead of the controller's own.
            meanwhile: Trajectories of other controllers, from now on.
            ready: The goal, if `is_current`; otherwise its way out of the running motion is planned here.

        Raises:
            GoalError: Stopped, without torque, or too late; nothing was changed.
        """
        self._refuse_unready(self.joints, state)
        tolerances = tolerances or self.settings.tolerances
        if ready is not None:
            self.follow(ready.trajectory, state, now, listener=listener, tolerances=tolerances, ready=ready)
            return
        if plan.goal.delay > 0.0 and plan.due > self.generator.next_start(now):
            self._preempt("replaced by a new goal")
            self._pending = plan
            self._active = _active(listener, tolerances, plan.due, math.inf)
            return
        trajectory = self._due(
            plan, state, now, self.generator.next_start(now), meanwhile, streamed=listener is None
        )
        self._meanwhile = meanwhile
        try:
            self.follow(
                trajectory, state, now, listener=listener, tolerances=tolerances, at_once=plan.goal.gives_way
            )
        finally:
            self._meanwhile = ()

    def outline(
        self,
        plan: Plan,
        state: JointState,
        now: float,
        begins: float,
        meanwhile: Sequence[Trajectory],
        *,
        streamed: bool,
    ) -> Outline:
        """What a goal begins with at a time; arguments as of `accept`, raises as `start`."""
        start, generator = self.start(begins - now, state, now), self.generator
        here = generator.here(self.joints, begins)
        return Outline(plan, begins, start, here, generator.changes, state.positions, meanwhile, streamed)

    def prepare(self, outline: Outline) -> Ready:
        """Plan and check how a goal begins. This takes long, and changes nothing: it needs no lock.

        Raises:
            GoalError: The goal is refused.
        """

        def allowed(trajectory: Trajectory, others: Mapping[str, float]) -> str:
            return self._check.unchecked(trajectory, others, outline.meanwhile)

        at_once = outline.plan.goal.gives_way
        path = self._path(
            outline.plan,
            outline.start,
            outline.begins,
            outline.others,
            outline.meanwhile,
            streamed=outline.streamed,
        )
        try:
            ways = self.generator.ways(
                path, outline.here, passes=outline.streamed, at_once=at_once, allowed=allowed
            )
        except GoalError:
            raise
        except HexwireError as error:
            raise GoalError(str(error), reason=Reason.PATH_NOT_ALLOWED) from None
        return Ready(outline, path, ways)

    def is_current(self, ready: Ready, now: float) -> bool:
        """Whether a goal still begins as it was prepared: nothing else was begun, and its joints move the same."""
        outline, generator = ready.outline, self.generator
        begins = max(outline.begins, generator.next_start(now))
        dated = bool(outline.plan.goal.delay) or outline.streamed
        if generator.changes != outline.changes or (dated and begins > outline.begins):
            return False
        return generator.here(self.joints, begins) == outline.here

    def follow(
        self,
        trajectory: Trajectory,
        state: JointState,
        now: float,
        *,
        listener: GoalListener | None = None,
        tolerances: Tolerances | None = None,
        at_once: bool = False,
        ready: Ready | None = None,
    ) -> None:
        """Follow a trajectory that begins at the present position; see `accept`, `SetPointGenerator.follow`."""
        self._refuse_unready(trajectory.names, state)
        self.generator.observe(state)
        begins, ways = self.generator.next_start(now), None
        if ready is not None:
            begins, ways = max(begins, ready.outline.begins), ready.ways
        try:
            # Without somebody who waits for its end it is one of a stream.
            self.generator.follow(trajectory, now, begins, passes=listener is None, at_once=at_once, ways=ways)
        except GoalError:
            raise
        except HexwireError as error:
            raise GoalError(str(error), reason=Reason.PATH_NOT_ALLOWED) from None
        self._preempt("replaced by a new goal")
        ends = now + self.generator.remaining(now)
        self._active = _active(listener, tolerances or self.settings.tolerances, begins, ends)

    def check_set_points(self, positions: Mapping[str, float], state: JointState, near: float = math.inf) -> None:
        """Check that joints can follow set-points now; changes nothing.

        Args:
            positions: Radians by joint.
            state: The newest state.
            near: A joint that follows no set-points must be this close to its first one, radians.

        Raises:
            GoalError: Stopped, or a joint has no torque, its position is unknown, or it is too far away.
        """
        self._refuse_unready(positions, state)
        self.generator.observe(state)
        try:
            self.generator.desired(tuple(positions), 0.0)
        except HexwireError as error:
            raise GoalError(str(error), reason=Reason.NOT_READY) from None
        if near < math.inf:
            self._refuse_far(positions, state, near)

    def _refuse_far(self, positions: Mapping[str, float], state: JointState, near: float) -> None:
        following, far = self.generator.streaming, []
        for name, angle in positions.items():
            if name not in following:
                # A joint under load is some way off its last command; both are where it is.
                (told,) = self.generator.desired((name,), 0.0).position
                gap = min(abs(angle - told), abs(angle - state.positions[name]))
                if gap > near:
                    far.append(f"{name} by {gap:.3g} rad")
        if far:
            text = f"the first set-point is away from the arm: {', '.join(far)}; it must be within {near:g} rad"
            raise GoalError(text, reason=Reason.PATH_NOT_ALLOWED)

    def follow_set_points(self, positions: Mapping[str, float], now: float, laws: Laws = None) -> None:
        """Follow set-points after `check_set_points`, as `SetPointGenerator.set_point`; the goal is preempted."""
        self.generator.set_point(positions, now, laws)
        self._preempt("replaced by set-points")

    def hold(self, why: str) -> None:
        """Hold the last set-point; the active goal is preempted."""
        self.generator.hold()
        self._preempt(why)

    def cancel(self, listener: GoalListener) -> None:
        """Hold, if the active goal is this listener's."""
        if self.listener is listener:
            self.generator.hold()
            self._end(Outcome.PREEMPTED, Reason.CANCELLED, "cancelled")

    def stop(self, reason: StopReason) -> None:
        """Latch a stop; the active goal is aborted."""
        self.generator.stop(reason)
        why = Reason.PATH_TOLERANCE if reason.kind in _STOPS_BY_PATH else Reason.STOPPED
        self._end(Outcome.ABORTED, why, reason.outcome)

    def reset(self) -> None:
        """Clear a stop. Nothing moves."""
        self.generator.reset()

    def brake(self, why: str) -> bool:
        """End the motion within all limits; the active goal is aborted. Whether the joints still move."""
        # What a robot has been sent ahead is ended there.
        if not self.generator.onboard:
            self.generator.hold()
        if self.generator.onboard or not self.generator.braking:
            self.release(why)
            return False
        self._end(Outcome.ABORTED, Reason.NOT_READY, why)
        return True

    def brakes(self, now: float) -> bool:
        """Whether joints that brake still move at a time."""
        return self.generator.braking or now < self.generator.due

    def release(self, why: str) -> None:
        """Forget the set-points, since the joints are no longer held; the active goal is aborted."""
        self.generator.forget()
        self._end(Outcome.ABORTED, Reason.NOT_READY, why)

    # -- the cycle ----------------------------------------------------------------------------------

    def cycle(self, state: JointState, now: float, lead: float) -> JointTarget | StopReason | None:
        """Run one cycle; see `SetPointGenerator.cycle`."""
        self._begin_pending(state, now)
        followed = self.generator.mode is Mode.TRAJECTORY
        order = self.generator.cycle(state, now, lead)
        active = self._active
        if isinstance(order, StopReason):
            self.stop(order)
        elif active is not None and self._pending is None and followed:
            # When the loop is late, the generator shifts the trajectory; the end shifts too.
            active.arrival.ends = self.generator.ends
        # A robot that executes trajectories itself is only watched.
        return order if self.generator.waits or isinstance(order, StopReason) else None

    def _begin_pending(self, state: JointState, now: float) -> None:
        pending, active = self._pending, self._active
        if pending is None or active is None:
            return
        soonest, settled = self.generator.next_start(now), self.generator.settled
        # A robot that executes trajectories itself is told early, and begins exactly then.
        early = max(settled, pending.goal.early) if settled else 0.0
        if soonest + early < pending.due:
            return
        self._pending = None
        begins = max(soonest, pending.due)
        try:
            self._refuse_unready(self.joints, state)
            streamed = active.listener is None
            path = self._due(pending, state, now, begins, streamed=streamed)
            self.generator.follow(path, now, begins, passes=streamed)
        except HexwireError as error:
            self.generator.hold()
            reason = Reason(error.reason) if isinstance(error, GoalError) else Reason.PATH_NOT_ALLOWED
            self._end(Outcome.ABORTED, reason, str(error))
        else:
            active.begins, active.arrival.ends = begins, now + self.generator.remaining(now)

    def _due(
        self,
        plan: Plan,
        state: JointState,
        now: float,
        begins: float,
        meanwhile: Sequence[Trajectory] = (),
        *,
        streamed: bool,
    ) -> Trajectory:
        """The trajectory of a plan from the position at its beginning on; its points keep their times.

        Raises:
            GoalError: It is so late that the path to the next point would be too fast.
        """
        start = self.start(begins - now, state, now)
        return self._path(plan, start, begins, state.positions, meanwhile, streamed=streamed)

    def _path(
        self,
        plan: Plan,
        start: Sample,
        begins: float,
        others: Mapping[str, float],
        meanwhile: Sequence[Trajectory],
        *,
        streamed: bool,
    ) -> Trajectory:
        if plan.is_over(begins):
            # Allowed if the joints are at its end already.
            with suppress(GoalError):
                return plan.end(start)
        trajectory = plan.trajectory(start, begins)
        # One that keeps its planned start was checked from there, and what leads to it is checked as it is made.
        if not streamed and not plan.goal.start:
            self._check.bridge(trajectory, others, meanwhile, late=plan.late(begins) > 0.0)
        return trajectory

    def judge(self, state: JointState, velocity: Sequence[float], now: float) -> None:
        """Compare a state with the desired state; end the active goal if it is reached or out of tolerance.

        Args:
            state: Just read, with all joints of the arm.
            velocity: Velocities of all joints of the arm, radians per second; NaN if unknown.
            now: Seconds.
        """
        active = self._active
        self.generator.observe(state, now)
        if active is None and not self.monitored:
            self._progress = None
            return
        ages = [state.age[i] for i in self._places]
        sampled, oldest = state.stamp - min(ages), state.stamp - max(ages)
        try:
            desired = self._desired(ages, state.stamp, now)
        except HexwireError:
            return  # the position of a joint is unknown
        position = tuple([state.position[i] for i in self._places])
        speed = tuple([velocity[i] for i in self._places])
        self._progress = Progress(self.joints, desired, position, speed, sampled)
        if active is None or self._pending is not None:
            return
        if self.generator.mode is Mode.TRAJECTORY:
            # Samples from before the trajectory do not count.
            if sampled > active.begins:
                wrong = active.tolerances.path_violation(self.joints, desired, position, speed)
                if wrong:
                    self.generator.hold()
                    self._end(Outcome.ABORTED, Reason.PATH_TOLERANCE, wrong)
        elif self.generator.onboard:
            # The robot has not said yet how its path has ended: it may rest where it ran out of points.
            return
        elif active.listener is None:
            self._active = None
        else:
            verdict = active.arrival.judge(now, self.joints, desired, position, speed, oldest)
            self.off = active.arrival.off
            if verdict is Verdict.ARRIVED:
                self._end(Outcome.SUCCEEDED, Reason.REACHED, off_goal(self.joints, desired.position, position))
            elif verdict is Verdict.MISSED:
                self._end(Outcome.ABORTED, Reason.GOAL_TOLERANCE, active.arrival.why)

    def _desired(self, ages: Sequence[float], stamp: float, now: float) -> Sample:
        """Desired state of each joint at the time of its sample; not beyond the last set-point."""
        told = min(now, self.generator.due)
        youngest = min(ages)
        if not max(ages) - youngest > _TOGETHER:
            return self.generator.desired(self.joints, min(stamp - youngest, told))
        rows = [self.generator.desired(self.joints, min(stamp - age, told)) for age in ages]
        return Sample(*(tuple(row[k][i] for i, row in enumerate(rows)) for k in range(3)))

    # -- helpers --------------------------------------------------------------------------------------

    def _wrong(self, trajectory: Trajectory, others: Mapping[str, float]) -> str:
        return self._check.unchecked(trajectory, others, self._meanwhile)

    def _refuse_if_stopped(self) -> None:
        self._check.stop_latch(self.reason)

    def _refuse_unready(self, names: Collection[str], state: JointState) -> None:
        self._refuse_if_stopped()
        self._check.ready(names, state, self.generator.guard.limits.max_age)

    def _preempt(self, why: str) -> None:
        self._end(Outcome.PREEMPTED, Reason.REPLACED, why)

    def _end(self, outcome: Outcome, reason: Reason, text: str = "") -> None:
        active, self._active, self._pending = self._active, None, None
        if active is not None and active.listener is not None:
            self._ended.append((active.listener, Ended(outcome, reason, text)))
