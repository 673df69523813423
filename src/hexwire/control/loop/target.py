"""A single target: on a path of the board, sent once, or in short steps if there is no watchdog.

Owns what is sent when, and the result. Time comes in as an argument. Must not know robots or threads.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

from hexwire.model.state import JointTarget, SentTarget
from hexwire.motion.moving import brake, joint_limits
from hexwire.motion.safety import StopReason, board_stop
from hexwire.motion.trajectory import Sample, Spline, Waypoint

from ..motion.arrival import Arrival, Deviation, Tolerance, Verdict
from .group import Goalless

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel
    from hexwire.model.state import JointState
    from hexwire.motion.trajectory import Trajectory

    from ..motion.jaws import Closing

__all__ = ["AHEAD", "SingleMotion", "SteppedWay", "TargetController", "beginning", "holding", "straight"]

AHEAD = 1.5
"""Duration of a step's target in steps, so that a late step does not pause the motion."""
_SETTLE = 0.05
"""Duration of a target that holds the joints, seconds."""
_CUT = 0.3
"""Seconds after the end of a path that was cut short in which a state tells what is wrong with a joint."""
_BACK = 0.2
"""Share of its speed limit at which a joint outside its limits goes back to them when it is held."""


def holding(arm: ArmModel, state: JointState, joints: Collection[str] | None = None) -> JointTarget | None:
    """A target at the present positions; None if no position is known. A joint outside its limits goes back slowly.

    Args:
        arm: Limits.
        state: Where they are.
        joints: Only these; all if None.
    """
    inside, duration = {}, _SETTLE
    for joint in state:
        limits = arm.joint(joint.name)
        if math.isfinite(joint.position) and (joints is None or joint.name in joints):
            inside[joint.name] = max(limits.minimum, min(limits.maximum, joint.position))
            duration = max(duration, abs(inside[joint.name] - joint.position) / (_BACK * limits.max_speed))
    return JointTarget.of(inside, duration) if inside else None


def beginning(here: Mapping[str, float], goal: Mapping[str, float]) -> dict[str, float]:
    """Where the way to a goal begins. A joint of unknown position has no way: it is sent to its goal at once."""
    return {name: here[name] if math.isfinite(here[name]) else angle for name, angle in goal.items()}


def straight(start: Mapping[str, float], goal: Mapping[str, float], duration: float) -> Spline:
    """A straight line of joints, slow at both ends and with limited jerk.

    Args:
        start: Radians by joint.
        goal: Radians by joint, of some of these joints.
        duration: Seconds; 0 for a step.
    """
    if not duration:
        return Spline(tuple(goal), [Waypoint(0.0, tuple(goal.values()))])
    rest = (0.0,) * len(goal)
    ends = ((0.0, tuple([start[name] for name in goal])), (duration, tuple(goal.values())))
    return Spline(tuple(goal), [Waypoint(time, place, rest, rest) for time, place in ends])


class SteppedWay:
    """The way of joints to a target that is sent in steps, each for the time of the next one.

    Args:
        path: The way.
        began: When it begins, seconds.
        step: Seconds between two steps.

    Attributes:
        step: Seconds between two steps.
        told: The time for which the last step was.
        braking: The joints brake instead.
        over: The last step was the last one.
    """

    def __init__(self, path: Trajectory, began: float, step: float) -> None:
        self._path, self._began = path, began
        self.step, self.told, self.braking, self.over = step, began, False, False

    @property
    def ends(self) -> float:
        """When it ends, seconds."""
        return self._began + self._path.duration

    @property
    def names(self) -> tuple[str, ...]:
        """Joints."""
        return self._path.names

    def at(self, time: float) -> Sample:
        """How the joints move at a time."""
        return self._path.sample(time - self._began)

    def next(self, now: float) -> JointTarget:
        """The target of the next step. It lasts for longer than the step, but for the last one.

        Where a step is later than the last target lasted, the joints rest there: the way goes on from it, and ends
        later. To catch up, they would have to be faster than was asked for.
        """
        self._began += max(0.0, now - (self.told + (AHEAD - 1.0) * self.step))
        self.over = now >= self.ends
        self.told = now + self.step
        places = zip(self._path.names, self.at(self.told).position, strict=True)
        return JointTarget.of(dict(places), self.step if self.over else AHEAD * self.step)

    def brake(self, arm: ArmModel) -> bool:
        """Brake all joints after the last step; False where that would lead beyond the limits of one."""
        if not self.braking:
            names = self._path.names
            path = brake(names, self.at(self.told), joint_limits(arm, names))
            for name, (low, high) in zip(names, path.ranges(), strict=True):
                if low < arm.joint(name).minimum or high > arm.joint(name).maximum:
                    return False
            self._path, self._began, self.braking = path, self.told, True
        return True


class SingleMotion(Goalless):
    """What the controllers of one motion share: it ends once, and never begins again.

    Args:
        joints: Names.

    Attributes:
        joints: Names.
        over: The motion has ended.
        void: It was stopped or released, if need be after its end.
        reason: Why it was stopped, or None.
    """

    def __init__(self, joints: tuple[str, ...]) -> None:
        self.joints, self.over, self.void = joints, False, False
        self.reason: StopReason | None = None
        self._begun = -math.inf

    @property
    def busy(self) -> bool:
        """The motion has not ended."""
        return not self.over

    @property
    def moving(self) -> bool:
        """The motion has begun and not ended."""
        return self._begun > -math.inf and not self.over

    def stop(self, reason: StopReason) -> None:
        """End the motion."""
        self.void = True
        if not self.over:
            self.reason, self.over = reason, True

    def brake(self, why: str) -> bool:
        """Same as `release`: the robot has the whole target, or is told where to hold."""
        self.release(why)
        return False

    def release(self, why: str) -> None:
        """End the motion."""
        self.over = self.void = True


class TargetController(SingleMotion):
    """Moves joints to one target, once.

    Jaws that meet an object hold it with little force from then on, which ends the motion too.

    Args:
        target: Positions and duration, at least `smooth_duration`.
        here: Present positions, radians by name; NaN if unknown.
        tolerances: By joint of the target.
        grace: Seconds after its duration in which the joints must arrive.
        step: Seconds between two steps on the straight line; None to send the whole target at once.
        early: The target may count as reached before its duration is over.
        waits: Nothing is sent before `go`.
        arm: Limits within which steps can be braked; None if they cannot.
        closing: Of a target of the jaws alone: whether they hold an object.
        eases: Seconds between two steps in which they are relieved; None for at once.

    Attributes:
        sent: The target as sent, once all of it was sent; or None. That jaws are relieved does not count.
        arrived: The joints are at the target.
        off: Joints that are not, as of the last state.
        without_torque: Joints that have lost torque.
        ended: Why the robot has ended the path that it followed, or empty.
    """

    def __init__(
        self,
        target: JointTarget,
        here: Mapping[str, float],
        tolerances: Mapping[str, Tolerance],
        *,
        grace: float,
        step: float | None = None,
        early: bool = True,
        waits: bool = False,
        arm: ArmModel | None = None,
        closing: Closing | None = None,
        eases: float | None = None,
    ) -> None:
        super().__init__(tuple([name for name, _ in target.positions]))
        self.sent: SentTarget | None = None
        self.arrived = False
        self.without_torque: tuple[str, ...] = ()
        self.ended = ""
        self._tolerances, self._grace, self._early = tolerances, grace, early
        self._waits, self._arm, self._closing, self._eases = waits, arm, closing, eases
        self._now = -math.inf
        self._silent: dict[str, None] = {}
        self._aim(target, here, step)

    def _aim(self, target: JointTarget, here: Mapping[str, float], step: float | None) -> None:
        """Go to a target, instead of to the one before; arguments as of the controller."""
        self.over = self._last = False
        self.off: tuple[Deviation, ...] = ()
        self._target, self._step = target, step
        self._start = beginning(here, dict(target.positions))
        self._way: SteppedWay | None = None
        self._arrival: Arrival | None = None

    def judge(self, state: JointState, velocity: Sequence[float], now: float) -> None:
        """Check the arrival, and whether jaws have met an object."""
        closing = self._closing
        # Those that have arrived may press all the same.
        goes_on = (self.arrived or not self.over) and not (self.void or self._braking)
        if closing is not None and goes_on and closing.see(state):
            self._aim(closing.gripper.grasp(state), state.positions, self._eases)
        if self.over or self._arrival is None or self.sent is None:
            return
        names = tuple(name for name, _ in self.sent.positions)
        goal = tuple(angle for _, angle in self.sent.positions)
        rest = (0.0,) * len(names)
        places = [state.names.index(name) for name in names]
        verdict = self._arrival.judge(
            now,
            names,
            Sample(goal, rest, rest),
            [state.position[i] for i in places],
            [velocity[i] for i in places],
            state.stamp - max(state.age[i] for i in places),
        )
        self.off = self._arrival.off
        self.arrived = verdict is Verdict.ARRIVED
        if not self.arrived:
            self.reason = board_stop(state)
            self.without_torque = tuple(name for name in names if name not in state.torque_on)
        self.over = (
            self.arrived or verdict is Verdict.MISSED or self.reason is not None or bool(self.without_torque)
        )

    def cycle(self, state: JointState, now: float, lead: float) -> JointTarget | None:
        """The target to send now."""
        if self.over or self._last or self._waits:
            return None
        self._now, self._begun = now, now if self._begun == -math.inf else self._begun
        if self._step is None:
            self._last = True
            return self._target
        if self._way is None:
            path = straight(self._start, dict(self._target.positions), self._target.duration)
            self._way = SteppedWay(path, now, self._step)
        step = self._way.next(now)
        self._last = self._way.over
        return step

    @property
    def holds(self) -> bool:
        """There is an object between the jaws."""
        return self._closing is not None and self._closing.holds

    @property
    def moving(self) -> bool:
        return super().moving and not self._braking

    @property
    def _braking(self) -> bool:
        return self._way is not None and self._way.braking

    def brake(self, why: str) -> bool:
        """Brake, if the target is sent in steps; otherwise the robot has all of it, or is told where to hold."""
        if self._way is None or self._arm is None or self.over or self._last or not self._way.brake(self._arm):
            return super().brake(why)
        return True

    def brakes(self, now: float) -> bool:
        """Whether joints that brake still move at a time."""
        return self._way is not None and self._way.braking and (not self._last or now < self._way.told)

    def go(self) -> None:
        """Send the target from the next cycle on."""
        self._waits = False

    def on_path(self, sent: SentTarget, begins: float) -> None:
        """Nothing needs to be sent: the robot follows a path to the target, from a time on."""
        self.sent, self._begun = sent, begins
        self._arrival = Arrival(self._tolerances, begins + sent.duration, self._grace, early=self._early)

    def cut(self, why: str, now: float) -> None:
        """The robot has ended that path: the joints are at rest, and the next states say where."""
        if not (self.ended or self.over):
            self.ended = why
            self._arrival = Arrival(self._tolerances, now, _CUT, early=self._early)

    def was_sent(self, sent: SentTarget) -> None:
        """Note how the last target was sent, perhaps together with those of other joints."""
        own = tuple([pair for pair in sent.positions if pair[0] in self.joints])
        self._silent |= dict.fromkeys([name for name in sent.silent if name in self.joints])
        if not own or not self._last or self._braking:
            return
        if self.holds:
            self.over = True
        else:
            duration = sent.duration if self._step is None else self._target.duration
            self.sent = SentTarget(own, duration, sent.clamped, tuple(self._silent))
            ends = self._now + (duration if self._step is None else 0.0)
            self._arrival = Arrival(self._tolerances, ends, self._grace, early=self._early)
