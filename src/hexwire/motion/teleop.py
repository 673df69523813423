"""Teleoperation: what a joystick asks of an arm, one cycle at a time.

Owns the rules that make it safe (the dead-man button, what a lost channel means, which axes count) and joint and
Cartesian jog. Time comes in as `now`. Knows no devices, channels or boards; axes and buttons are plain numbers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from hexwire.errors import LimitError, UsageError
from hexwire.model.arm import ArmModel
from hexwire.model.kinematics import KinematicModel
from hexwire.model.pose import Pose, multiply, rotation_x, rotation_y, rotation_z

from .fence import Fence

__all__ = ["Action", "Jog", "JogMode", "StickMap", "Teleop"]

_LONGEST_STEP = 0.1
"""Seconds that one cycle integrates at most: a program that stood still must not make up for it."""
_MOST_LEAD = math.radians(10.0)
"""How far a set-point runs ahead of a joint that does not follow: it must not leap when it is let go."""
_TRIES = (1.0, 0.5, 0.25)
"""Shares of a Cartesian step that are tried before it is refused."""
_STRAIN = 1.5
"""How much over its speed a joint may be for a Cartesian step."""


class JogMode(Enum):
    """What the axes move."""

    JOINT = "joint"
    CARTESIAN = "cartesian"


class Action(Enum):
    """What to do now."""

    IDLE = "idle"
    """Nothing: the arm holds already."""
    MOVE = "move"
    """Send the set-point."""
    HOLD = "hold"
    """Hold where the joints are, at once."""


@dataclass(frozen=True, slots=True)
class StickMap:
    """Which axis and button does what; the numbers of a common game pad.

    Attributes:
        axes: For each joint in joint jog, and for x, y, z and the turns about them in Cartesian jog, the axis that
            moves it; negative -1-n for axis n the other way round; None for none.
        dead_man: Button that must be held for anything to move.
        mode: Button that changes between joint and Cartesian jog.
        close: Button that closes the gripper (the joint behind the kinematics' own, if there is one).
        open: Button that opens it.
        dead_zone: Deflection that counts as none.
    """

    axes: tuple[int | None, ...] = (0, -2, -5, 3, 6, 7)
    dead_man: int = 4
    mode: int = 7
    close: int = 0
    open: int = 1
    dead_zone: float = 0.12

    def __post_init__(self) -> None:
        if not 0.0 <= self.dead_zone < 1.0:
            raise UsageError(f"a dead zone of {self.dead_zone:g} makes no sense; 0 to below 1 does")


@dataclass(frozen=True, slots=True)
class Jog:
    """The outcome of one cycle.

    Attributes:
        action: What to do.
        positions: With MOVE the set-point, radians by joint name.
        note: For the person who holds the stick, in words; empty if there is nothing to say.
    """

    action: Action
    positions: Mapping[str, float]
    note: str = ""


class Teleop:
    """The rules, and the set-point.

    The dead-man button counts only after it was seen released: a button that is stuck, or held while the channel
    comes back, moves nothing. An axis counts only after it was seen at rest with the button held, so that a stick
    that is deflected already, or a trigger that rests at one end, moves nothing either.

    Args:
        arm: Joints and limits.
        kinematics: For Cartesian jog; None allows joint jog only.
        stick: Which axis does what.
        mode: How it begins.
        share: Part of each joint's speed limit at full deflection.
        linear: Speed of the tool at full deflection, m/s.
        angular: The same for turns, rad/s.
        stale: Age of the stick's state in seconds from which the channel counts as lost.
        fence: Where the arm as a whole must not be; None for nowhere.
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
        fence: Fence | None = None,
    ) -> None:
        if not 0.0 < share <= 1.0:
            raise UsageError(f"a share of {share:g} of the speed limits makes no sense; above 0 to 1 does")
        if mode is JogMode.CARTESIAN and kinematics is None:
            raise UsageError(f"no Cartesian jog for {arm.name}: its kinematics are not known")
        self.arm = arm
        self.kinematics = kinematics
        self.stick = stick or StickMap()
        self.mode = mode
        self._share = share
        self._linear = linear
        self._angular = angular
        self._stale = stale
        self._fence = fence
        self._free = False
        self._active = False
        self._alive: set[int] = set()
        self._before = 0
        self._last = 0.0
        self._goal: dict[str, float] = {}

    def update(
        self, axes: Sequence[float], buttons: int, age: float, positions: Mapping[str, float], now: float
    ) -> Jog:
        """One cycle.

        Args:
            axes: -1..1 each, as last heard.
            buttons: Bit i is button i.
            age: Seconds since they were heard; infinite if never.
            positions: Where the joints are, radians by name.
            now: Seconds, monotonic.
        """
        if not age < self._stale:
            self._free = False
            return self._hold("no joystick" if math.isinf(age) else "the joystick's channel is silent")
        held = bool(buttons >> self.stick.dead_man & 1)
        pressed, self._before = buttons & ~self._before, buttons
        if not held:
            self._free = True
            self._change_mode(pressed)
            return self._hold("")
        if not self._free:
            return self._hold("release the dead-man button first")
        if not all(math.isfinite(positions.get(name, math.nan)) for name in self.arm.names):
            return self._hold("the joints' positions are not known")
        if not self._active:
            self._active = True
            self._alive.clear()
            self._goal = {name: positions[name] for name in self.arm.names}
            self._last = now
            if self._fence is not None:
                self._fence.begin(self._goal)
        step = min(max(now - self._last, 0.0), _LONGEST_STEP)
        self._last = now
        wanted = self._wanted(axes)
        before = dict(self._goal)
        note = self._joints(wanted, step) if self.mode is JogMode.JOINT else self._tool(wanted, step)
        self._gripper(buttons, step)
        if self._keep_near(positions, before):
            note = note or "the arm does not follow"
        if self._fence is not None and self._goal != before and (found := self._fence.check(self._goal)):
            self._goal = before
            note = "; ".join(found.values())
        return Jog(Action.MOVE, dict(self._goal), note)

    def _hold(self, note: str) -> Jog:
        action = Action.HOLD if self._active else Action.IDLE
        self._active = False
        return Jog(action, {}, note)

    def _change_mode(self, pressed: int) -> None:
        # Only while nothing moves: the axes mean something else afterwards.
        if pressed >> self.stick.mode & 1 and self.kinematics is not None:
            self.mode = JogMode.JOINT if self.mode is JogMode.CARTESIAN else JogMode.CARTESIAN

    def _wanted(self, axes: Sequence[float]) -> list[float]:
        """Deflection asked of each direction, -1..1, without what does not count."""
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
                # From nothing at the edge of the dead zone, so that there is no jump.
                value = math.copysign((abs(value) - zone) / (1.0 - zone), value)
            wanted.append(value if source >= 0 else -value)
        return wanted

    def _joints(self, wanted: Sequence[float], step: float) -> str:
        stopped = []
        for joint, deflection in zip(self.arm.joints, wanted, strict=False):
            if not deflection:
                continue
            goal = self._goal[joint.name] + deflection * self._share * joint.max_speed * step
            # A joint that stands outside its limits may come back, but go no further out.
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
        """Why the joints cannot go there in one step: near a singular pose they would have to jump."""
        for name, angle in joints.items():
            joint = self.arm.joint(name)
            if not abs(angle - self._goal[name]) <= _STRAIN * joint.max_speed * step:
                return f"{name} would have to jump: near a singular pose; go another way, or by joints"
            if not joint.minimum <= angle <= joint.maximum:
                return f"{name} at the limit"
        return ""

    def _gripper(self, buttons: int, step: float) -> None:
        joints = len(self.kinematics.ranges) if self.kinematics is not None else len(self.stick.axes)
        for joint in self.arm.joints[joints : joints + 1]:
            way = (buttons >> self.stick.close & 1) - (buttons >> self.stick.open & 1)
            goal = self._goal[joint.name] + way * self._share * joint.max_speed * step
            self._goal[joint.name] = max(joint.minimum, min(joint.maximum, goal))

    def _keep_near(self, positions: Mapping[str, float], before: Mapping[str, float]) -> bool:
        """Take a step back that runs too far ahead; whether there was one."""
        ahead = [
            name
            for name, goal in self._goal.items()
            if not abs(goal - positions[name]) <= max(_MOST_LEAD, abs(before[name] - positions[name]))
        ]
        if ahead and self.mode is JogMode.CARTESIAN:
            # All of it: the tool must not leave its line because one joint lags.
            self._goal = dict(before)
        for name in ahead:
            self._goal[name] = before[name]
        return bool(ahead)
