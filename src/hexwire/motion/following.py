"""Following: from the joints of a leader arm to set-points of a follower, one cycle at a time.

Owns the rules that make it safe: how the follower meets the leader, its limits and speeds, a leader that falls
silent, and how hard the gripper closes. Time comes in as `now`. Knows no robots, threads or clocks; positions and
loads are plain numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from hexwire.errors import LimitError, UsageError
from hexwire.model.arm import ArmModel, JointModel
from hexwire.model.gripper import Jaws

from .teleop import Action

__all__ = ["Follow", "Following", "GripForce"]

_LONGEST_STEP = 0.1
"""Longest time in seconds that one cycle integrates: a program that stalled must not catch up."""
_MET = math.radians(1.5)
"""Distance at which a joint of the follower has met the leader's."""
_MOST_LEAD = math.radians(12.0)
"""How far a set-point may run ahead of a blocked joint, which must not jump when it is released."""
_PUSHES, _STANDS = 0.1, math.radians(1.0)
"""Seconds of load without a motion of more than this, radians, after which jaws hold something: a servo reports
load while it accelerates, brakes or turns fast, too."""
_EASE_EVERY, _LEAST_SQUEEZE = 0.2, math.radians(0.3)
"""Seconds in which a servo answers a smaller squeeze with a smaller load; and the least squeeze, radians."""


@dataclass(frozen=True, slots=True)
class GripForce:
    """How hard the follower's gripper presses.

    Attributes:
        jaws: Its joint, closed and open.
        most: Load, as a fraction of full scale, at which it has something between its jaws, and with which it then
            presses.
        squeeze: How much further it then closes at most, radians: its servo presses in proportion to that.
    """

    jaws: Jaws
    most: float = 0.35
    squeeze: float = math.radians(3.0)

    def __post_init__(self) -> None:
        if not 0.0 < self.most <= 1.0:
            raise UsageError(f"the gripper's force must be above 0 and at most 1, not {self.most:g}")


@dataclass(frozen=True, slots=True)
class Follow:
    """The outcome of one cycle.

    Attributes:
        action: What to do.
        positions: With MOVE the set-point, radians by joint name.
        met: Every joint of the follower has met the leader's.
        note: Message for the user; may be empty.
        least: Least seconds that the set-point must take: a joint outside its limits goes back slowly.
    """

    action: Action
    positions: Mapping[str, float]
    met: bool = False
    note: str = ""
    least: float = 0.0


class Following:
    """The rules, and the set-point. The two arms have joints of the same names.

    A joint that has not met the leader's joint moves towards it at `share` of its speed limit; from then on it
    follows at the speed limit. After a pause of any kind the joints meet again.

    Args:
        leader: Joints of the leader.
        follower: Joints and limits of the follower.
        mirror: Joints that move the other way, for two arms that face each other.
        share: Share of each joint's speed limit at which the follower meets the leader.
        stale: Age of a leader's joint in seconds from which the follower holds.
        grip: How hard the gripper presses; None for no limit.
        check: Called with the set-point before and a new one, radians by name. Raises LimitError where the follower
            must not go.

    Raises:
        UsageError: The arms have different joints.
    """

    def __init__(
        self,
        leader: ArmModel,
        follower: ArmModel,
        *,
        mirror: frozenset[str] = frozenset(),
        share: float = 0.2,
        stale: float = 0.25,
        grip: GripForce | None = None,
        check: Callable[[Mapping[str, float], Mapping[str, float]], object] = lambda before, goal: None,
    ) -> None:
        if missing := [name for name in follower.names if name not in leader.names]:
            raise UsageError(
                f"{leader.name} cannot lead {follower.name}: it has no {', '.join(missing)}; the joints must match"
            )
        if not 0.0 < share <= 1.0:
            raise UsageError(f"the share of the speed limits must be above 0 and at most 1, not {share:g}")
        for name in mirror:
            follower.joint(name)
        self.arm = follower
        self._mirror, self._share, self._stale, self._grip, self._check = mirror, share, stale, grip, check
        self._leader = {name: leader.joint(name) for name in follower.names}
        # One cycle takes a few microseconds: what stays the same is looked up once.
        jaws = None if grip is None else grip.jaws.joint
        self._rows = [
            (one, one.name, one.minimum, one.maximum, one.max_speed, one.name == jaws) for one in follower.joints
        ]
        self._active = False
        self._last = 0.0
        self._goal: dict[str, float] = {}
        self._met: set[str] = set()
        # Where the jaws stood when they met something; None if they hold nothing.
        self._grasp: float | None = None
        self._squeeze = self._eased = 0.0
        # Since when, and where, the jaws push without moving.
        self._push: tuple[float, float] | None = None

    @property
    def holds(self) -> bool:
        """Whether the jaws hold something."""
        return self._active and self._grasp is not None

    def pause(self) -> None:
        """Forget the set-point: the joints meet the leader's again."""
        self._active = False

    def update(
        self,
        leader: Mapping[str, float],
        age: float,
        positions: Mapping[str, float],
        loads: Mapping[str, float],
        now: float,
    ) -> Follow:
        """One cycle.

        Args:
            leader: Positions of the leader, radians by name; what is not a number is unknown.
            age: Age of the oldest of them in seconds.
            positions: Positions of the follower.
            loads: Loads of the follower as signed fractions of full scale; NaN where unknown.
            now: Seconds, monotonic.
        """
        names = self.arm.names
        if not age < self._stale or not _known(leader, names):
            return self._hold("the leader is silent")
        if not _known(positions, names):
            return self._hold("the positions of the follower are unknown")
        if not self._active:
            self._active = True
            self._met.clear()
            self._grasp = self._push = None
            self._goal = {joint.name: _inside(joint, positions[joint.name]) for joint in self.arm.joints}
            self._last = now
        step = min(max(now - self._last, 0.0), _LONGEST_STEP)
        self._last = now
        before, goals, note, way_back = self._goal, {}, "", 0.0
        for joint, name, low, high, speed, jaws in self._rows:
            here, wanted = positions[name], leader[name]
            if jaws and self._grip is not None:
                load = loads.get(name, math.nan)
                wanted = self._gripped(self._grip, self._wanted(joint, wanted), here, load, now)
            elif self._mirror:
                wanted = self._wanted(joint, wanted)
            elif wanted < low:
                wanted = low
            elif wanted > high:
                wanted = high
            goals[name] = self._towards(joint, wanted, here, step)
            if not low <= here <= high:
                # Joints outside their limits return to them as slowly as they meet the leader.
                way_back = max(way_back, abs(_inside(joint, here) - here) / (self._share * speed))
        if goals != before:
            try:
                self._check(before, goals)
            except LimitError as error:
                goals, note = self._as_far_as_allowed(before, goals), str(error).removesuffix("; nothing was sent")
        self._goal = goals
        met = len(self._met) == len(names)
        # The caller gets them to read; the next cycle makes new ones.
        return Follow(Action.MOVE, goals, met, note, way_back)

    def _as_far_as_allowed(self, before: dict[str, float], wanted: dict[str, float]) -> dict[str, float]:
        """The joints that may move one after the other: a tool that touches the table slides along it."""
        goals = before
        for name, angle in wanted.items():
            step = {**goals, name: angle}
            if step != goals:
                try:
                    self._check(goals, step)
                except LimitError:
                    continue
                goals = step
        return goals

    def _hold(self, note: str) -> Follow:
        action = Action.HOLD if self._active else Action.IDLE
        self._active = False
        return Follow(action, {}, False, note)

    def _wanted(self, joint: JointModel, angle: float) -> float:
        """Where the leader's joint leads the follower's."""
        if self._grip is not None and joint.name == self._grip.jaws.joint:
            # Jaws have different travels: a leader's handle and the follower's fingers are open or closed alike.
            low, high = self._leader[joint.name].minimum, self._leader[joint.name].maximum
            angle = joint.minimum + (angle - low) / (high - low) * (joint.maximum - joint.minimum)
        if joint.name in self._mirror:
            angle = -angle
        return _inside(joint, angle)

    def _towards(self, joint: JointModel, wanted: float, here: float, step: float) -> float:
        name, most = joint.name, joint.max_speed * step
        goal = self._goal[name]
        way = wanted - goal
        if -_MET <= way <= _MET:
            self._met.add(name)
        elif name not in self._met:
            most *= self._share
        if way > most:
            wanted = goal + most
        elif way < -most:
            wanted = goal - most
        # A blocked joint keeps its set-point near; one outside its limits goes back to them.
        if wanted > here + _MOST_LEAD:
            wanted = here + _MOST_LEAD
        elif wanted < here - _MOST_LEAD:
            wanted = here - _MOST_LEAD
        return joint.minimum if wanted < joint.minimum else min(wanted, joint.maximum)

    def _gripped(self, grip: GripForce, wanted: float, here: float, load: float, now: float) -> float:
        """Where the jaws go: as the leader's do, but no further than to press on what is between them."""
        sign = math.copysign(1.0, grip.jaws.closed - grip.jaws.opened)
        if self._grasp is not None:
            slipped = sign * (here - self._grasp) > 2.0 * grip.squeeze
            if slipped or sign * (wanted - self._grasp) <= 0.0:
                self._grasp = None
        if self._grasp is None and self._pushes(grip, sign * (wanted - here), here, load, now):
            self._grasp, self._squeeze, self._eased = here, grip.squeeze, now
        if self._grasp is None:
            return wanted
        if sign * (here - self._grasp) < 0.0:
            # What it holds pushes the jaws open: it presses from there.
            self._grasp = here
        if abs(load) > grip.most and now - self._eased >= _EASE_EVERY:
            self._squeeze = max(self._squeeze * grip.most / abs(load), _LEAST_SQUEEZE)
            self._eased = now
        return grip.jaws.pressed(self._grasp, self._squeeze)

    def _pushes(self, grip: GripForce, ahead: float, here: float, load: float, now: float) -> bool:
        """Whether the jaws have been standing against something for long enough."""
        if math.isnan(load):
            return False
        if abs(load) < grip.most or ahead <= grip.squeeze:
            self._push = None
            return False
        if self._push is None or abs(here - self._push[1]) > _STANDS:
            self._push = (now, here)
        return now - self._push[0] >= _PUSHES


def _known(values: Mapping[str, float], names: tuple[str, ...]) -> bool:
    """Whether there is a finite value for each name."""
    get = values.get
    return all(map(math.isfinite, [get(name, math.nan) for name in names]))


def _inside(joint: JointModel, angle: float) -> float:
    return max(joint.minimum, min(joint.maximum, angle))
