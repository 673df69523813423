"""Teleoperation: from the state of a joystick to set-points of an arm, one cycle at a time.

Owns the rules that make it safe (the dead-man button, a lost channel, which axes count) and joint and Cartesian
jog. Time comes in as `now`. Knows no devices, channels or boards; axes and buttons are plain numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from hexwire.errors import LimitError, UsageError
from hexwire.model.arm import ArmModel
from hexwire.model.kinematics import KinematicModel
from hexwire.model.pose import Pose, multiply, rotation_x, rotation_y, rotation_z

from .moving import Pieces, brake, joint_limits
from .waypoints import Sample

__all__ = ["Action", "Jog", "JogMode", "StickMap", "Teleop", "within_limits"]

_LONGEST_STEP = 0.1
"""Longest time in seconds that one cycle integrates: a program that stalled must not catch up."""
_LOOK = 0.02
"""Seconds between two places of a brake that are checked before it begins."""
_MOST_LEAD = math.radians(10.0)
"""How far a set-point may run ahead of a blocked joint, which must not jump when it is released."""
_TRIES = (1.0, 0.5, 0.25)
"""Shares of a Cartesian step to try before it is refused."""
_ROUNDING = 1e-9
"""Radians in a step."""


class JogMode(Enum):
    """Meaning of the axes."""

    JOINT = "joint"
    CARTESIAN = "cartesian"


class Action(Enum):
    """What to do in this cycle."""

    IDLE = "idle"
    """Nothing: the arm holds already."""
    MOVE = "move"
    """Send the set-point."""
    HOLD = "hold"
    """Hold the present position, at once: where joints do not follow, or may not go on while they brake."""


@dataclass(frozen=True, slots=True)
class StickMap:
    """Assignment of axes and buttons; the defaults fit a common game pad.

    Attributes:
        axes: For each joint in joint jog, and for x, y, z and the turns about them in Cartesian jog, the axis that
            moves it; -1-n for axis n reversed; None for no axis.
        dead_man: Button that must be held for anything to move.
        mode: Button that switches between joint and Cartesian jog.
        close: Button that closes the gripper (the joint after those of the kinematics, if there is one).
        open: Button that opens it.
        dead_zone: Deflection that counts as zero.
    """

    axes: tuple[int | None, ...] = (0, -2, -5, 3, 6, 7)
    dead_man: int = 4
    mode: int = 7
    close: int = 0
    open: int = 1
    dead_zone: float = 0.12

    def __post_init__(self) -> None:
        if not 0.0 <= self.dead_zone < 1.0:
            raise UsageError(f"a dead zone must be from 0 to below 1, not {self.dead_zone:g}")


@dataclass(frozen=True, slots=True)
class Jog:
    """The outcome of one cycle.

    Attributes:
        action: What to do.
        positions: With MOVE the set-point, radians by joint name.
        note: Message for the user; may be empty.
    """

    action: Action
    positions: Mapping[str, float]
    note: str = ""


class Teleop:
    """The rules, and the set-point.

    The dead-man button counts only after it was released once: a stuck button, or one held while the channel comes
    back, moves nothing. An axis counts only after it was at rest while the button was held, so that a stick that is
    already deflected, or a trigger that rests at one end, moves nothing either. When the button is released, or the
    channel lost, the joints brake within their limits.

    Args:
        arm: Joints and limits.
        kinematics: For Cartesian jog; with None only joint jog is possible.
        stick: Assignment of axes and buttons.
        mode: Initial mode.
        share: Share of each joint's speed limit at full deflection.
        linear: Speed of the tool at full deflection, m/s.
        angular: The same for turns, rad/s.
        stale: Age of the joystick state in seconds from which the channel counts as lost.
        check: Called with the set-point before and a new one, radians by name; the new one has the joints within
            their limits. Raises LimitError where the arm must not go.
    """

    def __init__(
        self,
        arm: ArmModel,
        kinematics: KinematicModel | None = None,
        stick: StickMap | None = None,
        *,
        mode: JogMode = JogMode.JOINT,
        share: float = 0.3,
        linear: float = 0.05,
        angular: float = 0.4,
        stale: float = 0.25,
        check: Callable[[Mapping[str, float], Mapping[str, float]], object] = lambda before, goal: None,
    ) -> None:
        if not 0.0 < share <= 1.0:
            raise UsageError(f"the share of the speed limits must be above 0 and at most 1, not {share:g}")
        if mode is JogMode.CARTESIAN and kinematics is None:
            raise UsageError(f"no Cartesian jog for {arm.name}: its kinematics are unknown")
        self.arm = arm
        self.kinematics = kinematics
        self.stick = stick or StickMap()
        self.mode = mode
        self._share = share
        self._linear = linear
        self._angular = angular
        self._stale = stale
        self._check = check
        self._free = False
        self._active = False
        self._alive: set[int] = set()
        self._before = 0
        self._last = 0.0
        self._goal: dict[str, float] = {}
        # Of the last step, radians per second; no joint was held fast in it.
        self._speeds: dict[str, float] = {}
        self._follows = True
        # How the joints come to rest after the button was released, and since when.
        self._brake: Pieces | None = None
        self._released = 0.0

    def update(
        self, axes: Sequence[float], buttons: int, age: float, positions: Mapping[str, float], now: float
    ) -> Jog:
        """One cycle.

        Args:
            axes: Last received values, -1..1 each.
            buttons: Bit i is button i.
            age: Seconds since they were received; infinite if never.
            positions: Present joint positions, radians by name.
            now: Seconds, monotonic.
        """
        if not age < self._stale:
            self._free = False
            return self._let_go("no joystick" if math.isinf(age) else "the joystick's channel is silent", now)
        held = bool(buttons >> self.stick.dead_man & 1)
        pressed, self._before = buttons & ~self._before, buttons
        if not held:
            self._free = True
            self._change_mode(pressed)
            return self._let_go("", now)
        if not self._free:
            return self._let_go("release the dead-man button first", now)
        if self._brake is not None:
            return self._let_go("", now)
        if not all(math.isfinite(positions.get(name, math.nan)) for name in self.arm.names):
            return self._hold("the joint positions are unknown")
        if not self._active:
            self._active = True
            self._alive.clear()
            self._goal = {name: positions[name] for name in self.arm.names}
            self._last, self._speeds = now, {}
        step = min(max(now - self._last, 0.0), _LONGEST_STEP)
        self._last = now
        wanted = self._wanted(axes)
        before = dict(self._goal)
        note = self._joints(wanted, step) if self.mode is JogMode.JOINT else self._tool(wanted, step)
        self._gripper(buttons, step)
        self._follows = not self._keep_near(positions, before)
        if not self._follows:
            note = note or "the arm does not follow"
        if self._goal != before:
            try:
                self._check(before, within_limits(self.arm, self._goal))
            except LimitError as error:
                self._goal, note = before, str(error)
        if step > 0.0:
            self._speeds = {name: (goal - before[name]) / step for name, goal in self._goal.items()}
        return Jog(Action.MOVE, dict(self._goal), note)

    def drop(self) -> None:
        """Forget the motion, without a brake: the arm was stopped."""
        self._active, self._brake = False, None

    def _let_go(self, note: str, now: float) -> Jog:
        """The button is released, or nobody knows: the joints brake."""
        if self._active and any(self._speeds.values()):
            self._brake, self._released = self._allowed_brake(), self._last
        if (path := self._brake) is None:
            return self._hold(note)
        self._active = False
        since = now - self._released
        self._goal = dict(zip(path.names, path.sample(since).position, strict=True))
        if since >= path.duration:
            self._brake = None
        return Jog(Action.MOVE, dict(self._goal), note)

    def _allowed_brake(self) -> Pieces | None:
        """How the joints brake within their limits; None where they must not, or do not follow."""
        names, rest = self.arm.names, (0.0,) * len(self.arm.names)
        begin = Sample(tuple(self._goal.values()), tuple(self._speeds.values()), rest)
        path = brake(names, begin, joint_limits(self.arm, names))
        for joint, (low, high), at in zip(self.arm.joints, path.ranges(), begin.position, strict=True):
            if low < min(joint.minimum, at) or high > max(joint.maximum, at):
                return None
        before = self._goal
        try:
            for _, sample in path.samples(_LOOK):
                goal = dict(zip(names, sample.position, strict=True))
                self._check(before, within_limits(self.arm, goal))
                before = goal
        except LimitError:
            return None
        return path if self._follows else None

    def _hold(self, note: str) -> Jog:
        action = Action.HOLD if self._active else Action.IDLE
        self._active = False
        return Jog(action, {}, note)

    def _change_mode(self, pressed: int) -> None:
        # Only while nothing moves, because the meaning of the axes changes.
        if pressed >> self.stick.mode & 1 and self.kinematics is not None:
            self.mode = JogMode.JOINT if self.mode is JogMode.CARTESIAN else JogMode.CARTESIAN

    def _wanted(self, axes: Sequence[float]) -> list[float]:
        """Deflection for each direction, -1..1; axes that do not count give 0."""
        wanted = []
        zone = self.stick.dead_zone
        for source in self.stick.axes:
            axis = 0 if source is None else source if source >= 0 else -1 - source
            if source is None or axis >= len(axes) or not abs(axes[axis]) <= 1.0:
                wanted.append(0.0)
                continue
            value = axes[axis]
            if abs(value) <= zone:
                self._alive.add(axis)
                value = 0.0
            elif axis not in self._alive:
                value = 0.0
            else:
                # Zero at the edge of the dead zone, so that there is no jump.
                value = math.copysign((abs(value) - zone) / (1.0 - zone), value)
            wanted.append(value if source >= 0 else -value)
        return wanted

    def _joints(self, wanted: Sequence[float], step: float) -> str:
        stopped = []
        for joint, deflection in zip(self.arm.joints, wanted, strict=False):
            if not deflection:
                continue
            goal = self._goal[joint.name] + deflection * self._share * joint.max_speed * step
            # A joint outside its limits may move back, but not further out.
            low, high = (min(joint.minimum, self._goal[joint.name]), max(joint.maximum, self._goal[joint.name]))
            self._goal[joint.name] = max(low, min(high, goal))
            if goal != self._goal[joint.name]:
                stopped.append(joint.name)
        return f"{', '.join(stopped)} at the limit" if stopped else ""

    def _tool(self, wanted: Sequence[float], step: float) -> str:
        kinematics = self.kinematics
        if kinematics is None or not any(wanted[:6]) or not step:
            return ""
        here = kinematics.from_joints(self._goal)
        pose = kinematics.forward(here)
        move = [self._linear * step * v for v in wanted[:3]]
        turn = [self._angular * step * v for v in wanted[3:6]]
        problem = ""
        for share in _TRIES:
            goal = Pose(
                (
                    pose.position[0] + share * move[0],
                    pose.position[1] + share * move[1],
                    pose.position[2] + share * move[2],
                ),
                multiply(
                    rotation_z(share * turn[2]),
                    rotation_y(share * turn[1]),
                    rotation_x(share * turn[0]),
                    pose.rotation,
                ),
            )
            try:
                angles = kinematics.best(goal, here).angles
            except LimitError as error:
                problem = str(error)
                continue
            joints = kinematics.to_joints(angles)
            problem = self._too_fast(joints, step)
            if not problem:
                self._goal.update(joints)
                return ""
        return problem

    def _too_fast(self, joints: Mapping[str, float], step: float) -> str:
        """Why the joints cannot make this step; empty if they can. Near a singular pose they would have to jump."""
        for name, angle in joints.items():
            joint = self.arm.joint(name)
            if not abs(angle - self._goal[name]) <= joint.max_speed * step + _ROUNDING:
                return (
                    f"{name} would have to jump: near a singular pose; choose another direction, or move the joints"
                )
            if not joint.minimum <= angle <= joint.maximum:
                return f"{name} at the limit"
        return ""

    def _gripper(self, buttons: int, step: float) -> None:
        joints = len(self.kinematics.ranges) if self.kinematics is not None else len(self.stick.axes)
        for joint in self.arm.joints[joints : joints + 1]:
            direction = (buttons >> self.stick.close & 1) - (buttons >> self.stick.open & 1)
            goal = self._goal[joint.name] + direction * self._share * joint.max_speed * step
            self._goal[joint.name] = max(joint.minimum, min(joint.maximum, goal))

    def _keep_near(self, positions: Mapping[str, float], before: Mapping[str, float]) -> bool:
        """Undo a step that runs too far ahead of the joints; return whether there was one."""
        ahead = [
            name
            for name, goal in self._goal.items()
            if not abs(goal - positions[name]) <= max(_MOST_LEAD, abs(before[name] - positions[name]))
        ]
        if ahead and self.mode is JogMode.CARTESIAN:
            # Undo the whole step: the tool must not leave its line because one joint lags.
            self._goal = dict(before)
        for name in ahead:
            self._goal[name] = before[name]
        return bool(ahead)


def within_limits(arm: ArmModel, positions: Mapping[str, float]) -> dict[str, float]:
    """Those of these positions that are within their joint's limits, radians by name."""
    joints = {name: arm.joint(name) for name in positions}
    return {
        name: angle for name, angle in positions.items() if joints[name].minimum <= angle <= joints[name].maximum
    }
