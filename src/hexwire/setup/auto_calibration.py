"""An automatic calibration: a controller that moves each joint of an arm gently to its mechanical stops.

Owns what counts as a stop, and what ends it early; the arm's assembly says in which order they are found, and how
strong each joint may push. Time comes in as an argument. Must not know robots, threads or registers. Angles of
states and targets are those of a servo: counts from 0, as radians, without the limit of a turn (see `calibrating`).

A target never leads a joint by more than `_Push.lead`: if the host dies, this is how far a joint may still go.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from hexwire.control.loop.target import SingleMotion
from hexwire.model.arms import Go, Seek, assembly_of
from hexwire.model.state import JointFlag, JointReading, JointState, JointTarget

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel, JointModel

__all__ = ["COUNT", "AutoCalibration"]

COUNT = math.tau / 4096
"""Radians per count."""
_DEGREE = 4096 / 360
_FULL_DRIVE = 64.0
"""Counts of error at which a servo with a position gain of 32 gives its full torque."""
_USUAL_GAIN = 32
_SLACK = 12.0
"""Counts that a target may lead a joint beyond what its torque limit needs."""
_FAST, _SLOW = 340.0, 100.0
"""Counts per second: 30 and 9 degrees per second."""
_BACK = 80.0
"""Counts by which a joint backs off from a stop."""
_STILL, _STILL_TIME = 2.0, 0.25
"""A joint that moved no more counts than this in this time stands still."""
_PUSHES = 0.6
"""Share of its torque limit that a joint gives at a stop."""
_DRIVEN = 0.05
"""Amperes that flow at least in a motor that pushes."""
_SAME = 3.0
"""Greatest difference of two measurements of a stop, counts."""
_MOST_TRIES = 4
_SHORTEST, _LONGEST = 0.9, 1.15
"""Range from stop to stop, compared with the usual one."""
_DRIFT = 8 * _DEGREE
"""Counts by which a joint that holds may give way."""
_JUMP = 300.0
"""Counts that no joint moves between two states."""
_SILENT = 0.3
"""Seconds without an answer of a joint."""
_MOST_MISSED = 5
"""States in a row without an answer of a joint."""
_HOT = 65.0
_PATIENCE = 3.0
"""Seconds that a motion may take longer than planned."""
_LONGEST_CYCLE = 0.06
_LOOK_BACK, _TOO_SLOW = 5.0, 0.3
"""Seconds before a fault that count, and how many of them this computer must have lost to be its cause."""
_NO_SERVO = (
    "no servo answers any more: check the adapter, the first cable and the supply; "
    "or the program of an emulated arm was suspended, or had no processor time"
)
_INSET = 6
"""Counts from a mechanical stop to the end of the calibrated range: a joint at its end does not push."""


@dataclass(slots=True)
class _Push:
    """How a joint is driven, and where it is.

    Attributes:
        joint: The joint.
        force: Its torque limit.
        lead: Counts by which a target may lead it.
        aim: Target, counts.
        position: Newest position, counts; NaN before the first.
        effort: Newest load.
        current: Newest current, amperes; NaN if unknown.
        heard: Time of the newest position.
        missed: States since then without a position.
        stops: Stops found, by direction of the counts.
        recent: Times and positions of the last moments.
    """

    joint: JointModel
    force: float
    lead: float
    aim: float = math.nan
    position: float = math.nan
    effort: float = 0.0
    current: float = math.nan
    heard: float = -math.inf
    missed: int = 0
    stops: dict[int, float] = field(default_factory=dict)
    recent: deque[tuple[float, float]] = field(default_factory=deque)

    def still(self, now: float) -> bool:
        """Whether it stood still for a while."""
        places = [place for _, place in self.recent]
        lasts = bool(self.recent) and now - self.recent[0][0] >= _STILL_TIME
        return lasts and max(places) - min(places) <= _STILL

    def mean(self) -> float:
        """Mean of its last positions."""
        return sum(place for _, place in self.recent) / len(self.recent)


class AutoCalibration(SingleMotion):
    """Finds the stops of the joints of an arm, all of which have torque, and puts the arm down.

    Args:
        model: The arm as it usually is; its limits say how far a joint usually goes.
        plan: The motions; those of the arm's assembly if None.
        gains: Position gain of each servo, by joint name; 32 for others.

    Attributes:
        fault: Why it ended early; empty if it did not.
        step: Number of motions done.
    """

    def __init__(
        self,
        model: ArmModel,
        *,
        plan: Sequence[Seek | Go] | None = None,
        gains: Mapping[str, int] | None = None,
    ) -> None:
        super().__init__(model.names)
        self.fault, self.step = "", 0
        assembly = assembly_of(model)
        self._plan = assembly.search if plan is None else tuple(plan)
        self._pushes = {}
        for joint in model.joints:
            force = assembly.joint(joint.name).force
            gain = max(1, (gains or {}).get(joint.name, _USUAL_GAIN))
            lead = force * _FULL_DRIVE * _USUAL_GAIN / gain + _SLACK
            self._pushes[joint.name] = _Push(joint, force, lead)
        self._task: _Seeking | _Going | None = None
        self._now = self._judged = -math.inf
        # Time of a state, and by how much it was later than the longest cycle.
        self._lost: deque[tuple[float, float]] = deque()

    @property
    def steps(self) -> int:
        """Number of motions."""
        return len(self._plan)

    @property
    def doing(self) -> str:
        """The present motion in words; empty at the end."""
        return "" if self.over or self.step >= len(self._plan) else str(self._plan[self.step])

    @property
    def ranges(self) -> dict[str, tuple[int, int]]:
        """Ends of each joint whose two stops are known, counts as the servo reports them, a little inside."""
        return {
            name: (math.ceil(push.stops[-1]) + _INSET, math.floor(push.stops[1]) - _INSET)
            for name, push in self._pushes.items()
            if len(push.stops) == 2
        }

    @property
    def positions(self) -> dict[str, float]:
        """Newest position of each joint, counts."""
        return {name: push.position for name, push in self._pushes.items()}

    def fail(self, fault: str) -> None:
        """End it for a reason that only the caller sees."""
        if not self.over:
            self.fault, self.over = fault, True

    # -- controller -------------------------------------------------------------------------------------

    def judge(self, state: JointState, velocity: Sequence[float], now: float) -> None:
        """Take a state; end at anything odd."""
        if self.over:
            return
        self._note_delay(now)
        fault = "the arm was stopped" if state.stopped else self._odd(state, now)
        if fault:
            self.fail(fault)
        elif self._task is not None and self._task.done:
            self._task = None
            self.step += 1
            self.over = self.step >= len(self._plan)

    def cycle(self, state: JointState, now: float, lead: float) -> JointTarget | None:
        """The next target of the joints that move."""
        if self.over or any(math.isnan(push.position) for push in self._pushes.values()):
            return None
        if self._begun == -math.inf:
            self._begun = self._now = now
            for push in self._pushes.values():
                push.aim = push.position
        step, self._now = min(now - self._now, _LONGEST_CYCLE), now
        if self._task is None:
            task = self._plan[self.step]
            pushes = self._pushes
            self._task = (
                _Seeking(pushes[task.joint], task.direction, now)
                if isinstance(task, Seek)
                else _Going([(pushes[name], angle) for name, angle in task.angles.items()], now)
            )
        self._task.advance(step, now)
        # The others hold; a goal would give its full torque to a servo that was without supply for a moment.
        return JointTarget.of({name: self._pushes[name].aim * COUNT for name in self._task.joints}, lead)

    def _note_delay(self, now: float) -> None:
        """Note by how much this state is late; what is long ago does not count."""
        if now - self._judged > _LONGEST_CYCLE and self._judged > -math.inf:
            self._lost.append((now, now - self._judged - _LONGEST_CYCLE))
        self._judged = now
        while self._lost and self._lost[0][0] < now - _LOOK_BACK:
            self._lost.popleft()

    def _odd(self, state: JointState, now: float) -> str:
        """Take the state; returns what is wrong, or nothing."""
        for joint in state:
            if fault := _reported(joint):
                return f"{joint.name} {fault}"
        fault = next((f"{joint.name} {fault}" for joint in state if (fault := self._take(joint, now))), "")
        if fault and len(self._pushes) > 1 and all(push.missed for push in self._pushes.values()):
            fault = _NO_SERVO
        if not fault and (task := self._task) is not None:
            held = (push for name, push in self._pushes.items() if name not in task.joints)
            moved = [push.joint.name for push in held if abs(push.position - push.aim) > _DRIFT + push.lead]
            pushed = f"{moved[0]} moved although it holds: it was pushed, or has lost its torque" if moved else ""
            fault = pushed or task.judge(now)
        lost = sum(min(seconds, end - now + _LOOK_BACK) for end, seconds in self._lost)
        if fault and lost >= _TOO_SLOW:
            # Then nothing is known about the arm: answers, targets and looks were all late.
            span = f"{lost:.1f} of the last {_LOOK_BACK:g} s"
            return f"this computer is too slow: it lost {span}; close other programs, then try again"
        return fault

    def _take(self, joint: JointReading, now: float) -> str:
        push = self._pushes[joint.name]
        if joint.flags & JointFlag.SILENT:
            push.missed += 1
            # Both: this computer may have stalled, and then one answer is late.
            if push.heard > -math.inf and now - push.heard > _SILENT and push.missed >= _MOST_MISSED:
                return "fell silent: check cable and power"
            return ""
        push.missed = 0
        counts = joint.position / COUNT
        if abs(counts - push.position) > _JUMP:
            return "jumped: it was pushed, or its servo was without supply for a moment"
        push.position, push.heard = counts, now
        push.effort, push.current = abs(joint.load), abs(joint.current)
        push.recent.append((now, counts))
        while len(push.recent) > 1 and push.recent[1][0] <= now - _STILL_TIME:
            push.recent.popleft()
        return ""


def _reported(joint: JointReading) -> str:
    """What a servo itself reports, if that is a reason to end."""
    if joint.flags & JointFlag.SILENT:
        return ""
    if faults := joint.flags.faults & ~JointFlag.SILENT:
        return f"reports {faults}".lower()
    return f"is {joint.temperature:.0f} deg C hot: let it cool" if joint.temperature > _HOT else ""


class _Seeking:
    """Finds one stop: approaches it, backs off, and measures it twice slowly."""

    def __init__(self, push: _Push, direction: int, now: float) -> None:
        self.joints: Collection[str] = (push.joint.name,)
        self.done = False
        self._push = push
        self._direction = direction * push.joint.sign
        self._found: list[float] = []
        self._approaches = 0
        self._approach(now)

    def _approach(self, now: float) -> None:
        self._speed = _SLOW if self._approaches else _FAST
        self._approaches += 1
        self._backing, self._from, self._since = False, self._push.position, now
        self._push.recent.clear()

    def advance(self, step: float, now: float) -> None:
        """Move the target on."""
        push = self._push
        if self._backing:
            goal = self._from - self._direction * _BACK
            push.aim = _toward(push.aim, goal, _FAST * step)
        else:
            push.aim += self._direction * self._speed * step
        push.aim = max(push.position - push.lead, min(push.position + push.lead, push.aim))

    def judge(self, now: float) -> str:
        """Look at the newest position; returns a fault, or nothing."""
        push, took = self._push, now - self._since
        gone = (push.position - self._from) * self._direction
        name = push.joint.name
        if self._backing:
            if gone < -_BACK / 2 and push.still(now):
                return self._next(now)
            if took > _PATIENCE:
                return f"{name} does not come away from its stop: is it stuck?"
            return ""
        if gone < -(push.lead + _DRIFT):
            return f"{name} moves the wrong way: somebody moves the arm"
        longest = _LONGEST * _usual(push.joint)
        if gone > longest:
            return f"{name} turned by {gone / _DEGREE:.0f} deg without meeting a stop: is its horn loose?"
        if took > longest / self._speed + _PATIENCE:
            return f"{name} does not reach its stop in time: something brakes it"
        if (push.aim - push.position) * self._direction < 0.85 * push.lead or not push.still(now):
            return ""
        if push.effort < _PUSHES * push.force or push.current < _DRIVEN:
            return f"{name} stands still but does not push: has it lost its torque?"
        if self._approaches > 1:
            self._found.append(push.mean())
        self._backing, self._from, self._since = True, push.position, now
        push.recent.clear()
        return ""

    def _next(self, now: float) -> str:
        found, push = self._found, self._push
        if len(found) >= 2 and abs(found[-1] - found[-2]) <= _SAME:
            push.stops[self._direction] = (found[-1] + found[-2]) / 2
            self.done = True
            return _range_fault(push) if len(push.stops) == 2 else ""
        if self._approaches >= _MOST_TRIES:
            return f"{push.joint.name} stops elsewhere each time: is something soft in its way?"
        self._approach(now)
        return ""


class _Going:
    """Moves joints to angles of the profile, reckoned from the stops that are known."""

    def __init__(self, goals: Sequence[tuple[_Push, float]], now: float) -> None:
        self.joints: Collection[str] = tuple(push.joint.name for push, _ in goals)
        self.done = False
        self._goals = [(push, _count(push, math.radians(angle))) for push, angle in goals]
        farthest = max(abs(goal - push.position) for push, goal in self._goals)
        self._until = now + farthest / _FAST + _PATIENCE
        for push, _ in self._goals:
            push.recent.clear()

    def advance(self, step: float, now: float) -> None:
        """Move the targets on."""
        for push, goal in self._goals:
            aim = _toward(push.aim, goal, _FAST * step)
            push.aim = max(push.position - push.lead, min(push.position + push.lead, aim))

    def judge(self, now: float) -> str:
        """Look at the newest positions; returns a fault, or nothing."""
        self.done = all(push.aim == goal and push.still(now) for push, goal in self._goals)
        if now > self._until and not self.done:
            late = next(push for push, goal in self._goals if push.aim != goal or not push.still(now))
            return f"{late.joint.name} does not get where it should: something is in its way"
        return ""


def _range_fault(push: _Push) -> str:
    travel, usual = push.stops[1] - push.stops[-1], _usual(push.joint)
    if _SHORTEST * usual <= travel <= _LONGEST * usual:
        return ""
    return (
        f"{push.joint.name} turns by {travel / _DEGREE:.0f} deg and not by about {usual / _DEGREE:.0f}: it met "
        "something before its stop; clear the space around the arm and put it down folded"
    )


def _toward(here: float, goal: float, step: float) -> float:
    return goal if abs(goal - here) <= step else here + math.copysign(step, goal - here)


def _usual(joint: JointModel) -> float:
    """Usual distance from end to end, counts."""
    return (joint.maximum - joint.minimum) / joint.scale


def _count(push: _Push, angle: float) -> float:
    """Count of a joint angle of the profile, reckoned from the stops."""
    joint, stops = push.joint, push.stops
    middle = (joint.minimum + joint.maximum) / 2
    if len(stops) == 2:
        return (stops[-1] + stops[1]) / 2 + joint.sign * (angle - middle) / joint.scale
    side, stop = next(iter(stops.items()))
    # The stop lies a little beyond the published end of the range.
    end = joint.maximum if side * joint.sign > 0 else joint.minimum
    return stop + joint.sign * (angle - end) / joint.scale
