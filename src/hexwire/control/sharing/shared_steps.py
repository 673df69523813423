"""Sends a far target of a shared arm without a watchdog in short steps, as a command at the port does.

Owns when a target is far, and the path of each joint to it. If this program dies, at most a step and a half
remains. Must not know leases.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from hexwire.drivers.abilities import Watchdog
from hexwire.errors import StoppedError
from hexwire.model.state import JointTarget, SentTarget
from hexwire.motion.limits import check_target, smooth_duration
from hexwire.motion.set_point_generator import SetPointGenerator
from hexwire.motion.together import Together
from hexwire.motion.trajectory import Sample

from ..loop.group import Goalless
from ..loop.output import SETTLING
from ..loop.target import AHEAD, SteppedWay, beginning, straight

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    from hexwire.epochs import Token
    from hexwire.model.arm import ArmModel
    from hexwire.model.state import JointState
    from hexwire.motion.safety import StopReason
    from hexwire.motion.trajectory import Trajectory

    from ..loop.owner import RobotOwner

__all__ = ["JointSteps", "SteppedTargets"]

_SHORT = 1.1
"""Targets up to this many such durations, such as streamed set-points, are sent whole; more than 1 for rounding."""


class JointSteps(Goalless):
    """A controller of one joint that moves it to its target in steps, or does nothing.

    Args:
        joint: Name.
        arm: Limits within which it brakes.
    """

    def __init__(self, joint: str, arm: ArmModel) -> None:
        self.joints = (joint,)
        self._arm = arm
        # Shared with the other joints of the target.
        self._way: SteppedWay | None = None
        # The last target sent, and until when the joint may still move to it.
        self._aim, self._until = math.nan, -math.inf

    @property
    def busy(self) -> bool:
        """Whether there are steps to send."""
        return self._way is not None

    @property
    def moving(self) -> bool:
        """Whether these lead to a target."""
        return self._way is not None and not self._way.braking

    @property
    def way(self) -> SteppedWay | None:
        """Where the steps lead, or None."""
        return self._way

    def begin(self, way: SteppedWay) -> None:
        """Send the steps of a way, after the first one."""
        self._way = way
        self.aimed(self._place(way), way.told + (AHEAD - 1.0) * way.step)

    def _place(self, way: SteppedWay) -> float:
        return way.at(way.told).position[way.names.index(self.joints[0])]

    def aimed(self, angle: float, until: float) -> None:
        """Note a target that was sent, and when the joint reaches it."""
        self._aim, self._until = angle, until + SETTLING

    def aim(self, now: float) -> float | None:
        """Target to which the joint is moving, or None if it rests; a stream of targets continues from there."""
        return self._aim if now < self._until else None

    def left(self, now: float) -> float:
        """Seconds until the target is reached; 0 if there are no steps to send."""
        way = self._way
        if way is None:
            return 0.0
        return max(0.0, way.ends - now) + 2.0 * way.step + SETTLING

    def cycle(self, state: JointState, now: float, lead: float) -> JointTarget | None:
        """The next step."""
        way = self._way
        if way is None:
            return None
        (joint,), step = self.joints, way.next(now)
        if way.over:
            self._way = None
        place = dict(step.positions)[joint]
        self.aimed(place, now + step.duration)
        return JointTarget.of({joint: place}, step.duration)

    def stop(self, reason: StopReason) -> None:
        """End the motion. The other controllers latch the stop."""
        self._way, self._until = None, -math.inf

    def brake(self, why: str) -> bool:
        """Brake with the other joints of the target, which stay on their straight line; whether they do."""
        if self._way is not None and self._way.brake(self._arm):
            return True
        self.release(why)
        return False

    def release(self, why: str) -> None:
        """End the motion."""
        self._way, self._until = None, -math.inf


class SteppedTargets:
    """Sends targets through the owner of a robot, far ones in steps unless the robot has a watchdog.

    Args:
        owner: The owner; its robot need not be connected yet.
    """

    def __init__(self, owner: RobotOwner) -> None:
        self._owner = owner
        model = owner.model
        self._members = {name: JointSteps(name, model) for name in model.names}
        self._planner = SetPointGenerator(model, allowed=self._wrong)

    def send(self, target: JointTarget, here: Mapping[str, float], asked: Token) -> SentTarget:
        """Send a target; the caller has `RobotOwner.deciding`.

        A stop, a new target for the joint, or anything else that ends the motions of controllers ends the steps.

        Args:
            target: The caller has checked its path.
            here: Positions of the arm's joints in the newest state, radians.
            asked: As in `RobotOwner.send`.

        Returns:
            The target as sent, or as the steps will send it.

        Raises:
            HexwireError: As `RobotOwner.send`.
        """
        owner, robot = self._owner, self._owner.robot
        if Watchdog.find(robot) is not None:
            return owner.send(target, asked)
        now, step = owner.now(), owner.command_period
        here = self._told(here, [name for name, _ in target.positions], now)
        checked = check_target(robot.model, target, here)
        if checked.duration <= _SHORT * AHEAD * step:
            sent = owner.send(target, asked)
            for name, angle in sent.positions:
                self._members[name].aimed(angle, now + sent.duration)
            return sent
        way = self._plan(checked, here, now)
        first = owner.send(way.next(now), asked)
        with owner.locked():
            # A stop that came since then found no steps to end.
            robot.epochs.check(asked, "a move")
            if owner.group.reason is not None:
                raise StoppedError.unsent("a move", 0, f"the arm was stopped meanwhile ({owner.group.reason})")
            self._join()
            for name in way.names:
                self._members[name].begin(way)
        return SentTarget(checked.positions, way.ends - now, first.clamped, first.silent)

    def _plan(self, target: JointTarget, here: Mapping[str, float], now: float) -> SteppedWay:
        """The way to a far target; raises `LimitError` if none leads out of the present motion."""
        owner, model, goal = self._owner, self._owner.model, dict(target.positions)
        start = beginning(here, goal)
        duration = max(target.duration, smooth_duration(model, start, goal))
        running = {name: way for name in goal if (way := self._members[name].way) is not None}
        if not running:
            return SteppedWay(straight(start, goal, duration), now, owner.command_period)
        begins = max(way.told for way in running.values())
        rows = []
        for name in goal:
            if (way := running.get(name)) is None:
                rows.append((start[name], 0.0, 0.0))
            else:
                i, sample = way.names.index(name), way.at(begins)
                rows.append((sample.position[i], sample.velocity[i], sample.acceleration[i]))
        begin = Sample(*zip(*rows, strict=True))
        line = straight(dict(zip(goal, begin.position, strict=True)), goal, duration)
        self._planner.observe(owner.newest())
        ways = self._planner.ways(line, begin)
        return SteppedWay(Together(line.names, {line.names: ways}), begins, owner.command_period)

    def _wrong(self, path: Trajectory, others: Mapping[str, float]) -> str:
        check = self._owner.group.check
        return "" if check is None else check.unchecked(path, others)

    def release(self, joints: Collection[str]) -> None:
        """End the steps of joints that another controller takes over; the caller has `RobotOwner.locked`."""
        for name in joints:
            self._members[name].release("another motion was asked for")

    def time_left(self) -> float:
        """Seconds until the last joint has reached its target; 0 if there are no steps to send."""
        now = self._owner.now()
        return max(member.left(now) for member in self._members.values())

    def _told(self, here: Mapping[str, float], joints: Iterable[str], now: float) -> Mapping[str, float]:
        """Positions of the arm's joints; for one of these joints that moves to a target, that target."""
        model, told = self._owner.model, dict(here)
        for joint in joints:
            name = model.joint(joint).name
            if (aim := self._members[name].aim(now)) is not None:
                told[name] = aim
        return told

    def _join(self) -> None:
        group = self._owner.group
        if not any(member is own for member in group.members for own in self._members.values()):
            group.members = (*group.members, *self._members.values())
