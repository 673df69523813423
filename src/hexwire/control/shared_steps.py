"""Sends a far target of a shared arm without a watchdog in short steps, as a command at the port does.

Owns when a target is far, and the path of each joint to it. If this program dies, at most a step and a half
remains. Must not know leases, nor who sends targets.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from hexwire.errors import StoppedError
from hexwire.model.state import JointTarget, SentTarget
from hexwire.motion.limits import check_target, smooth_duration

from .output import SETTLING
from .target import AHEAD, step_share

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from hexwire.epochs import Token
    from hexwire.model.state import JointState
    from hexwire.motion.safety import StopReason

    from .outcomes import Ended, GoalListener
    from .owner import RobotOwner

__all__ = ["JointSteps", "SteppedTargets"]

_SHORT = 1.1
"""Targets up to this many such durations, such as streamed set-points, are sent whole; more than 1 for rounding."""


class _Line(NamedTuple):
    """The straight line of a joint: radians, seconds of the owner's clock."""

    start: float
    goal: float
    began: float
    duration: float
    step: float

    def place(self, now: float) -> float:
        """Target of a step that is sent now."""
        share = step_share(now - self.began, self.step, self.duration)
        return self.start + share * (self.goal - self.start)


class JointSteps:
    """A controller of one joint that moves it to its target in steps, or does nothing.

    Args:
        joint: Name.
    """

    def __init__(self, joint: str) -> None:
        self.joints = (joint,)
        self.reason: StopReason | None = None
        self._line: _Line | None = None
        # The last target sent, and until when the joint may still move to it.
        self._aim, self._until = math.nan, -math.inf

    @property
    def busy(self) -> bool:
        """Whether there are steps to send."""
        return self._line is not None

    moving = busy

    def begin(self, start: float, goal: float, began: float, duration: float, step: float) -> None:
        """Move on a straight line, after its first step was sent."""
        self._line = line = _Line(start, goal, began, duration, step)
        self.aimed(line.place(began), began + AHEAD * step)

    def aimed(self, angle: float, until: float) -> None:
        """Note a target that was sent, and when the joint reaches it."""
        self._aim, self._until = angle, until + SETTLING

    def aim(self, now: float) -> float | None:
        """Target to which the joint is moving, or None if it rests; a stream of targets continues from there."""
        return self._aim if now < self._until else None

    def left(self, now: float) -> float:
        """Seconds until the target is reached; 0 if there are no steps to send."""
        line = self._line
        if line is None:
            return 0.0
        return max(0.0, line.began + line.duration - now) + 2.0 * line.step + SETTLING

    def judge(self, state: JointState, velocity: Sequence[float], now: float) -> None:
        """Do nothing: the sender of the target checks the arrival."""

    def cycle(self, state: JointState, now: float, lead: float) -> JointTarget | None:
        """The next step."""
        line = self._line
        if line is None:
            return None
        place, duration = line.place(now), AHEAD * line.step
        if now - line.began >= line.duration:
            self._line, duration = None, line.step
        self.aimed(place, now + duration)
        return JointTarget.of({self.joints[0]: place}, duration)

    def stop(self, reason: StopReason) -> None:
        """End the motion. The other controllers latch the stop."""
        self._line, self._until = None, -math.inf

    def reset(self) -> None:
        """Do nothing: an ended motion does not continue."""

    def brake(self, why: str) -> bool:
        """Same as `release`: what a target asks of the joints is the sender's choice."""
        self.release(why)
        return False

    def release(self, why: str) -> None:
        """End the motion."""
        self._line, self._until = None, -math.inf

    def take_ended(self) -> list[tuple[GoalListener, Ended]]:
        """Return nothing: steps have no goal."""
        return []


class SteppedTargets:
    """Sends targets through the owner of a robot, far ones in steps unless the robot has a watchdog.

    Args:
        owner: The owner; its robot need not be connected yet.
    """

    def __init__(self, owner: RobotOwner) -> None:
        self._owner = owner
        self._members = {name: JointSteps(name) for name in owner.robot.model.names}

    def send(self, target: JointTarget, asked: Token) -> SentTarget:
        """Send a target; the caller has `RobotOwner.deciding`.

        A stop, a new target for the joint, or anything else that ends the motions of controllers ends the steps.

        Args:
            target: The caller has checked its path.
            asked: As in `RobotOwner.send`.

        Returns:
            The target as sent, or as the steps will send it.

        Raises:
            HexwireError: As `RobotOwner.send`.
        """
        owner, robot = self._owner, self._owner.robot
        if robot.has_watchdog:
            return owner.send(target, asked)
        now, step = owner.now(), owner.command_period
        here = self._here(now)
        checked = check_target(robot.model, target, here)
        if checked.duration <= _SHORT * AHEAD * step:
            sent = owner.send(target, asked)
            for name, angle in sent.positions:
                self._members[name].aimed(angle, now + sent.duration)
            return sent
        smooth = smooth_duration(robot.model, here, dict(checked.positions))
        checked = replace(checked, duration=max(checked.duration, smooth))
        # A joint whose position is unknown cannot be interpolated: it is sent directly to its target.
        start = {name: here[name] if math.isfinite(here[name]) else goal for name, goal in checked.positions}
        lines = {name: _Line(start[name], goal, now, checked.duration, step) for name, goal in checked.positions}
        first = owner.send(
            JointTarget.of({name: line.place(now) for name, line in lines.items()}, AHEAD * step), asked
        )
        with owner.locked():
            # A stop that came since then found no steps to end.
            robot.epochs.check(asked, "a move")
            if owner.group.reason is not None:
                raise StoppedError.unsent("a move", 0, f"the arm was stopped meanwhile ({owner.group.reason})")
            self._join()
            for name, line in lines.items():
                self._members[name].begin(*line)
        return SentTarget(checked.positions, checked.duration, first.clamped, first.silent)

    def release(self, joints: Collection[str]) -> None:
        """End the steps of joints that another controller takes over; the caller has `RobotOwner.locked`."""
        for name in joints:
            self._members[name].release("another motion was asked for")

    def time_left(self) -> float:
        """Seconds until the last joint has reached its target; 0 if there are no steps to send."""
        now = self._owner.now()
        return max(member.left(now) for member in self._members.values())

    def _here(self, now: float) -> Mapping[str, float]:
        """Positions of the joints; for a joint that moves to a target, that target."""
        here = dict(self._owner.newest().positions)
        for name, member in self._members.items():
            aim = member.aim(now)
            if aim is not None:
                here[name] = aim
        return here

    def _join(self) -> None:
        group = self._owner.group
        if not any(member is own for member in group.members for own in self._members.values()):
            group.members = (*group.members, *self._members.values())
