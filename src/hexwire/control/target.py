"""A single target: on a path of the board, sent once, or in short steps if there is no watchdog.

Owns what is sent when, and the result. Time comes in as an argument. Must not know robots or threads.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

from hexwire.model.state import JointTarget, SentTarget
from hexwire.motion.safety import StopReason, board_stop
from hexwire.motion.trajectory import quintic_share
from hexwire.motion.waypoints import Sample

from .arrival import Arrival, Deviation, Tolerance, Verdict

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel
    from hexwire.model.state import JointState

    from .outcomes import Ended, GoalListener

__all__ = ["AHEAD", "SingleMotion", "TargetController", "holding", "step_share"]

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


def step_share(since: float, step: float, duration: float) -> float:
    """Part of a straight line to which the next step leads, 0 to 1: slowly at both ends, with limited jerk.

    Args:
        since: Seconds since the motion began.
        step: Seconds between two steps.
        duration: Of the whole line, seconds.
    """
    return quintic_share((since + step) / duration)


class SingleMotion:
    """What the controllers of one motion share: it ends once, and never begins again.

    Args:
        joints: Names.

    Attributes:
        joints: As given.
        over: The motion has ended.
        reason: Why it was stopped, or None.
    """

    def __init__(self, joints: tuple[str, ...]) -> None:
        self.joints, self.over = joints, False
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
        if not self.over:
            self.reason, self.over = reason, True

    def reset(self) -> None:
        """Do nothing: an ended motion does not continue."""

    def brake(self, why: str) -> bool:
        """Same as `release`: the robot has the whole target, or is told where to hold."""
        self.release(why)
        return False

    def release(self, why: str) -> None:
        """End the motion."""
        self.over = True

    def take_ended(self) -> list[tuple[GoalListener, Ended]]:
        """Return nothing: the caller reads the attributes."""
        return []


class TargetController(SingleMotion):
    """Moves joints to one target, once.

    Args:
        target: Positions and duration, at least `smooth_duration`.
        here: Present positions, radians by name; NaN if unknown.
        tolerances: By joint of the target.
        grace: Seconds after its duration in which the joints must arrive.
        step: Seconds between two steps on the straight line; None to send the whole target at once.
        early: The target may count as reached before its duration is over.
        waits: Nothing is sent before `go`.

    Attributes:
        sent: The target as sent, once all of it was sent; or None.
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
    ) -> None:
        goal = dict(target.positions)
        super().__init__(tuple(goal))
        self.sent: SentTarget | None = None
        self.arrived = False
        self.off: tuple[Deviation, ...] = ()
        self.without_torque: tuple[str, ...] = ()
        self.ended = ""
        self._target, self._tolerances, self._grace, self._early = target, tolerances, grace, early
        self._step, self._waits = step, waits
        # A joint whose position is unknown cannot be interpolated: it is sent directly to its target.
        self._start = {name: here[name] if math.isfinite(here[name]) else goal[name] for name in goal}
        self._now = -math.inf
        self._last = False
        self._silent: dict[str, None] = {}
        self._arrival: Arrival | None = None

    def judge(self, state: JointState, velocity: Sequence[float], now: float) -> None:
        """Check the arrival."""
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
        goal, duration, since = dict(self._target.positions), self._target.duration, now - self._begun
        if since >= duration:
            self._last = True
            return JointTarget.of(goal, self._step)
        share = step_share(since, self._step, duration)
        place = {name: start + share * (goal[name] - start) for name, start in self._start.items()}
        return JointTarget.of(place, AHEAD * self._step)

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
        """Note how the last target was sent."""
        self._silent |= dict.fromkeys(sent.silent)
        if self._last:
            duration = sent.duration if self._step is None else self._target.duration
            self.sent = SentTarget(sent.positions, duration, sent.clamped, tuple(self._silent))
            ends = self._now + (duration if self._step is None else 0.0)
            self._arrival = Arrival(self._tolerances, ends, self._grace, early=self._early)
