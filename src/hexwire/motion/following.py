"""Following: from the joints of a leader arm to set-points of a follower, one cycle at a time.

Owns the rules that make it safe: how the follower meets the leader, its limits and speeds, a leader that falls
silent, and how hard the gripper closes. Time comes in as `now`. Knows no robots, threads or clocks; positions and
loads are plain numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType
from typing import NamedTuple

from hexwire.errors import LimitError, UsageError
from hexwire.model.arm import ArmModel, JointModel
from hexwire.model.gripper import Jaws

from .teleop import Action

__all__ = ["Behind", "FollowStep", "Following", "GripForce"]

_new = tuple.__new__
_LONGEST_STEP = 0.1
"""Longest time in seconds that one cycle integrates: a program that stalled must not catch up."""
_MET = math.radians(1.5)
"""Distance at which a joint of the follower has met the leader's."""
_MOST_LEAD, _LEAD_TIME = math.radians(12.0), 0.1
"""How far a set-point may run ahead of a blocked joint, which must not jump when it is released; and the seconds of
its motion by which it may be further ahead of a joint that moves, since a servo with a load lags."""
_TRAIL = 0.03
"""Least seconds between the positions that tell how fast a joint moves."""
_PUSHES, _STANDS = 0.1, math.radians(1.0)
"""Seconds of load without a motion of more than this, radians, after which jaws hold something: a servo reports
load while it accelerates, brakes or turns fast, too."""
_EASE_EVERY, _LEAST_SQUEEZE = 0.2, math.radians(0.3)
"""Seconds in which a servo answers a smaller squeeze with a smaller load; and the least squeeze, radians."""
_GONE_WAY, _GONE_LOAD = 0.7, 0.5
"""Shares of the squeeze and of the most load: jaws that close by more than the first, with less load than the
second, hold nothing any more."""


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


class Behind(Enum):
    """Why a joint is not sent where its leader's is; the value says it of the joint."""

    LIMITS = "is led beyond its limits"
    SPEED = "is led faster than it may move, and comes later"
    ACCELERATION = "is led with more acceleration than it may have, and comes later"
    HELD = "does not get on, so its set-point waits for it"
    GRIP = "holds something, and closes no further"
    FORBIDDEN = "is led where the arm must not go"
    MEETING = "goes slowly to where it is led, at first"
    """Of those whose caller has to know it: `FollowStep.behind` is about joints that have met the leader's."""
    DISTANCE = "is led further at once than it may go"
    """By a limit of the caller's."""


class FollowStep(NamedTuple):
    """The outcome of one cycle.

    Attributes:
        action: What to do.
        positions: With MOVE the set-point, radians by joint name.
        met: Every joint of the follower has met the leader's.
        note: Message for the user; may be empty.
        least: Least seconds that the set-point must take: a joint outside its limits goes back slowly.
        behind: Why joints that have met the leader's are not sent where it leads them, by name.
    """

    action: Action
    positions: Mapping[str, float]
    met: bool = False
    note: str = ""
    least: float = 0.0
    behind: Mapping[str, Behind] = MappingProxyType({})


class Following:
    """The rules, and the set-point. The two arms have joints of the same names.

    A joint that has not met the leader's joint moves towards it at `share` of its speed limit; from then on it
    follows as fast as its servo can. After a pause of any kind the joints meet again.

    Args:
        leader: Joints of the leader.
        follower: Joints and limits of the follower.
        mirror: Joints that move the other way, for two arms that face each other.
        share: Share of each joint's speed limit at which the follower meets the leader.
        speeds: Most radians per second of joints by name; others are as fast as their servos are.
        accelerations: Most radians per second squared, likewise.
        stale: Age of a leader's joint in seconds from which the follower holds.
        grip: How hard the gripper presses; None for no limit.
        check: Called with the set-point before and a new one, radians by name. Raises LimitError where the follower
            must not go.

    Attributes:
        presses: Whether the jaws hold something, or may: then the next cycle needs their load.

    Raises:
        UsageError: The arms have different joints; or a joint does not exist, or is to be faster than its servo.
    """

    def __init__(
        self,
        leader: ArmModel,
        follower: ArmModel,
        *,
        mirror: frozenset[str] = frozenset(),
        share: float = 0.2,
        speeds: Mapping[str, float] | None = None,
        accelerations: Mapping[str, float] | None = None,
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
        self.arm, self._names = follower, follower.names
        self._stale, self._grip, self._check = stale, grip, check
        # One cycle takes a few microseconds: what stays the same is looked up once.
        jaws = None if grip is None else grip.jaws.joint
        fastest = {one.name: one.guided_speed for one in follower.joints} | _checked_speeds(follower, speeds or {})
        self._accelerations = _checked(follower, accelerations or {}, "acceleration")
        self._rows = [
            (
                one,
                one.name,
                *_way_to(one, leader.joint(one.name), jaws=one.name == jaws, mirror=one.name in mirror),
                one.minimum,
                one.maximum,
                min(share * one.max_speed, fastest[one.name]),
                fastest[one.name],
                one.name in self._accelerations,
                one.name == jaws,
            )
            for one in follower.joints
        ]
        self._active = False
        self._last = 0.0
        self._goal: dict[str, float] = {}
        self._met: set[str] = set()
        # Of set-points that have a limit of acceleration, radians per second.
        self._velocities: dict[str, float] = {}
        # Two times, and the positions of the follower then.
        self._trail: list[tuple[float, Mapping[str, float]]] = []
        # Where the jaws stood when they met something; None if they hold nothing.
        self._grasp: float | None = None
        self._squeeze = self._eased = 0.0
        self.presses = False
        # Since when, and where, the jaws push without moving.
        self._push: tuple[float, float] | None = None

    def pause(self) -> None:
        """Forget the set-point: the joints meet the leader's again."""
        self._active = False

    def led(self, leader: Mapping[str, float]) -> dict[str, float]:
        """Where a leader leads each joint, within the follower's limits: radians by name, NaN where unknown.

        Args:
            leader: Positions of the leader, radians by name.
        """
        found = {}
        for joint, name, factor, shift, *_ in self._rows:
            wanted = factor * leader.get(name, math.nan) + shift
            found[name] = _inside(joint, wanted) if math.isfinite(wanted) else math.nan
        return found

    def update(
        self,
        leader: Mapping[str, float],
        age: float,
        positions: Mapping[str, float],
        loads: Mapping[str, float],
        now: float,
    ) -> FollowStep:
        """One cycle.

        Args:
            leader: Positions of the leader, radians by name; what is not a number is unknown.
            age: Age of the oldest of them in seconds.
            positions: Positions of the follower.
            loads: Loads of the follower as signed fractions of full scale; NaN where unknown.
            now: Seconds, monotonic.
        """
        names = self._names
        try:
            led, standing = [*map(leader.__getitem__, names)], [*map(positions.__getitem__, names)]
        except KeyError:
            led = standing = [math.nan]
        # One that is not finite makes the sum so.
        if not (age < self._stale and math.isfinite(sum(led) + sum(standing))):
            return self._unknown(leader, age)
        if not self._active:
            self._active = True
            self._met.clear()
            self._grasp = self._push = None
            self._goal = {joint.name: _inside(joint, positions[joint.name]) for joint in self.arm.joints}
            self._velocities.clear()
            self._trail = [(now, dict(positions))] * 2
            self._last = now
        step = now - self._last
        if not 0.0 <= step <= _LONGEST_STEP:
            step = 0.0 if step < 0.0 else _LONGEST_STEP
        self._last = now
        if now - self._trail[1][0] >= _TRAIL:
            self._trail = [self._trail[1], (now, dict(positions))]
        before, goals, note, way_back = self._goal, {}, "", 0.0
        behind: dict[str, Behind] = {}
        met = self._met
        for row, leading, here, goal in zip(self._rows, led, standing, before.values(), strict=True):
            joint, name, factor, shift, low, high, meeting, fastest, eased, jaws = row
            wanted = factor * leading + shift
            if not low <= wanted <= high:
                wanted = low if wanted < low else high
                if name in met and not jaws:
                    behind[name] = Behind.LIMITS
            if jaws and (loads or self._grasp is not None):
                asked = wanted
                wanted = self._gripped(asked, here, loads.get(name, math.nan), now)
                if wanted != asked:
                    behind[name] = Behind.GRIP
            way = wanted - goal
            if name in met:
                most = fastest * step
            elif -_MET <= way <= _MET:
                met.add(name)
                most = fastest * step
            else:
                most = meeting * step
            if -most <= way <= most and -_MOST_LEAD <= wanted - here <= _MOST_LEAD and not eased:
                # Nearly every joint in nearly every cycle.
                goals[name] = wanted
            else:
                goals[name], why = self._towards(joint, wanted, here, most, step)
                if why is not None and name in met:
                    behind[name] = why
            if not low <= here <= high:
                # Joints outside their limits return to them as slowly as they meet the leader.
                way_back = max(way_back, abs(_inside(joint, here) - here) / meeting)
        if goals != before:
            try:
                self._check(before, goals)
            except LimitError as error:
                wished, note = goals, str(error).removesuffix("; nothing was sent")
                goals = self._as_far_as_allowed(before, wished)
                behind.update({name: Behind.FORBIDDEN for name in met if goals[name] != wished[name]})
        if (accelerations := self._accelerations) and step > 0.0:
            self._velocities = {name: (goals[name] - before[name]) / step for name in accelerations}
        self._goal = goals
        if (grip := self._grip) is not None:
            jaw = grip.jaws.joint
            self.presses = self._grasp is not None or abs(goals[jaw] - positions[jaw]) > grip.squeeze
        # The caller gets them to read; the next cycle makes new ones.
        return _new(FollowStep, (Action.MOVE, goals, len(met) == len(goals), note, way_back, behind))

    def _unknown(self, leader: Mapping[str, float], age: float) -> FollowStep:
        """A cycle in which the value of a joint of either arm is missing, not finite or too old."""
        known = age < self._stale and math.isfinite(sum([leader.get(name, math.nan) for name in self._names]))
        return self._hold("the positions of the follower are unknown" if known else "the leader is silent")

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

    def _hold(self, note: str) -> FollowStep:
        action = Action.HOLD if self._active else Action.IDLE
        self._active = False
        return FollowStep(action, {}, False, note)

    def _towards(
        self, joint: JointModel, wanted: float, here: float, most: float, step: float
    ) -> tuple[float, Behind | None]:
        """The next set-point of a joint, and why it is not where the joint is wanted.

        Args:
            joint: The joint.
            wanted: Where the leader leads it.
            here: Where it is.
            most: Most radians in this cycle.
            step: Seconds of it.
        """
        name, why = joint.name, None
        goal = self._goal[name]
        way = wanted - goal
        if not -most <= way <= most:
            way, why = math.copysign(most, way), Behind.SPEED
        if step > 0.0 and name in self._accelerations:
            eased = self._eased_way(name, wanted - goal, way, step)
            if eased != way:
                way, why = eased, Behind.ACCELERATION
        place = goal + way if why is not None else wanted
        if step <= 0.0:
            # The first cycle has no time for a way, which is nobody's limit.
            place, why = goal, None
        lead = place - here
        if not -_MOST_LEAD <= lead <= _MOST_LEAD:
            # A blocked joint keeps its set-point near; one outside its limits goes back to them.
            further = _MOST_LEAD + _LEAD_TIME * max(0.0, math.copysign(1.0, lead) * self._velocity(name, here))
            if abs(lead) > further:
                place, why = here + math.copysign(further, lead), Behind.HELD
        return _inside(joint, place), why

    def _eased_way(self, name: str, whole: float, way: float, step: float) -> float:
        """The way of a set-point in a cycle, with a limited acceleration and the whole way to go."""
        most, before = self._accelerations[name], self._velocities.get(name, 0.0)
        change = most * step
        # The highest speed from which it still stops there, in whole cycles.
        slowing = (math.sqrt(change * change + 8.0 * most * abs(whole)) - change) / 2.0
        wanted = math.copysign(min(abs(way) / step, slowing), way)
        return step * min(max(wanted, before - change), before + change)

    def _velocity(self, name: str, here: float) -> float:
        """How fast a joint of the follower moves, radians per second."""
        since, then = self._trail[0]
        seconds = self._last - since
        return (here - then[name]) / seconds if seconds > 0.0 else 0.0

    def _gripped(self, wanted: float, here: float, load: float, now: float) -> float:
        """Where the jaws go: as the leader's do, but no further than to press on what is between them."""
        grip = self._grip
        assert grip is not None
        sign = math.copysign(1.0, grip.jaws.closed - grip.jaws.opened)
        if self._grasp is not None:
            closed = sign * (here - self._grasp)
            gone = closed > _GONE_WAY * self._squeeze and abs(load) < _GONE_LOAD * grip.most
            if gone or sign * (wanted - self._grasp) <= 0.0:
                self._grasp = None
            if gone:
                # Perhaps a hand has taken it: the jaws close slowly.
                self._met.discard(grip.jaws.joint)
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


def _checked(arm: ArmModel, limits: Mapping[str, float], what: str) -> dict[str, float]:
    for name, most in limits.items():
        arm.joint(name)
        if not 0.0 < most < math.inf:
            raise UsageError(f"the {what} of {name} must be above 0, not {math.degrees(most):g}")
    return dict(limits)


def _checked_speeds(arm: ArmModel, speeds: Mapping[str, float]) -> dict[str, float]:
    for name, most in _checked(arm, speeds, "speed").items():
        if most > (able := arm.joint(name).guided_speed) * (1.0 + 1e-9):
            fast, able = math.degrees(most), math.degrees(able)
            raise UsageError(
                f"{name} reaches {able:g} degrees a second, not {fast:g}; an arm file may give another "
                "free_speed_deg_per_s"
            )
    return dict(speeds)


def _way_to(joint: JointModel, leader: JointModel, *, jaws: bool, mirror: bool) -> tuple[float, float]:
    """Factor and summand that make a follower's angle of its leader's."""
    factor, shift = 1.0, 0.0
    if jaws:
        # Jaws have different travels: a leader's handle and the follower's fingers are open or closed alike.
        factor = (joint.maximum - joint.minimum) / (leader.maximum - leader.minimum)
        shift = joint.minimum - factor * leader.minimum
    return (-factor, -shift) if mirror else (factor, shift)


def _inside(joint: JointModel, angle: float) -> float:
    return max(joint.minimum, min(joint.maximum, angle))
