"""The rules for a joint trajectory as a goal, and its tolerances.

Owns the rules and the names of fields in error texts, which are those of the usual joint trajectory controllers.
Values come in as plain numbers and times as seconds from now. Must not know messages, clocks or robots.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

from hexwire.errors import GoalError
from hexwire.motion.trajectory import Sample

from ..loop.outcomes import Reason
from .arrival import Tolerance, deviations, in_words

__all__ = [
    "MAX_POINTS",
    "Component",
    "ComponentTolerance",
    "Point",
    "Tolerances",
    "TrajectoryGoal",
    "check_goal",
]

MAX_POINTS = 10_000
"""Most points of a trajectory. The owner of the robot computes its spline again when it begins, which takes about
0.1 s for this many points and must not delay a cycle longer."""
_MOST = 1e6
"""Greatest position, velocity and acceleration; greater ones are garbage, and would overflow the polynomials."""
_LONGEST = 2.0**31
"""Seconds; the limit of a duration with signed 32-bit seconds."""
_TICK = 1e-9
"""Seconds; times are whole nanoseconds. Times closer to now count as now."""
_ROUNDING = 1.2e-7
"""Numbers closer to 0, or to -1, count as that: the rounding of a 32-bit float."""
_SHOWN = 5
"""Most names or faults listed in a text."""


@dataclass(frozen=True, slots=True)
class Point:
    """One point, with values in the order of the goal's names; an empty tuple means not given.

    Attributes:
        time: Seconds from the goal's stamp (`time_from_start`).
        positions: Radians.
        velocities: Radians per second.
        accelerations: Radians per second squared; only with velocities.
        effort: Feed-forward, newton metres; only zeros are allowed, since no supported arm accepts it.
    """

    time: float
    positions: tuple[float, ...]
    velocities: tuple[float, ...] = ()
    accelerations: tuple[float, ...] = ()
    effort: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class TrajectoryGoal:
    """A trajectory to follow, as sent by a client.

    Attributes:
        names: Joint names, in any order.
        points: Values in the order of the names.
        delay: Seconds from now to the goal's stamp; 0 for no stamp, negative if it has passed.
        free: Names of further joints with several degrees of freedom each, for which the client wants a motion too.
            No supported arm has one, so such a goal is refused.
        early: Seconds before its start at which a robot that executes trajectories gets it, if it waits for that.
        gives_way: The joints press on something: they stand already, whatever was planned, and are relieved in the
            time of the points.
        start: Where the joints were to be at the beginning when it was planned, in the order of the names; empty if
            the way to its first point is free. Joints that have moved on since then join the path as they join one
            while they move, since its first point may be too near for a way of its own. Not of one with a delay.
    """

    names: tuple[str, ...]
    points: tuple[Point, ...]
    delay: float = 0.0
    free: tuple[str, ...] = ()
    early: float = 0.0
    gives_way: bool = False
    start: tuple[float, ...] = ()


class Component(IntEnum):
    """What of a joint's motion a tolerance is for, with the numbers of the usual messages."""

    X_AXIS = 1
    Y_AXIS = 2
    Z_AXIS = 3
    TRANSLATION = 4
    ROTATION = 5


@dataclass(frozen=True, slots=True)
class ComponentTolerance:
    """A client's tolerance for one component of a joint; 0 keeps the value, a negative number disables the check.

    Attributes:
        joint: Its name.
        component: One of `Component`; another number is refused.
        position: Radians for a rotation, metres otherwise.
        velocity: Per second.
        acceleration: Per second squared.
    """

    joint: str
    component: int
    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


@dataclass(frozen=True, slots=True)
class Tolerances:
    """How far the arm may deviate from its path and its goal.

    Attributes:
        path: By joint, while it moves; every joint of the controller has a row.
        goal: By joint, at the end; likewise. The velocity is that at which a joint counts as stopped.
        goal_time: Seconds after the end in which the goal must be reached; 0 means to wait forever.
    """

    path: Mapping[str, Tolerance]
    goal: Mapping[str, Tolerance]
    goal_time: float = 0.0

    def overridden(
        self,
        path: Sequence[tuple[str, float, float, float]],
        goal: Sequence[tuple[str, float, float, float]],
        goal_time: float,
        path_components: Sequence[ComponentTolerance] = (),
        goal_components: Sequence[ComponentTolerance] = (),
        *,
        only_minus_one: bool = False,
    ) -> Tolerances:
        """These tolerances, changed by those of a goal: 0 keeps the value, a negative number disables the check.

        Args:
            path: Joint, radians, radians per second, radians per second squared.
            goal: Those at the goal, in the same units.
            goal_time: Seconds.
            path_components: Like `path`, for components. The rotation of a joint is its angle; the joints of the
                supported arms have no other component.
            goal_components: Like `goal`, for components.
            only_minus_one: Of the negative numbers only -1 disables a check; others are refused.

        Raises:
            GoalError: WRONG_JOINTS for a joint that is unknown or given twice, MALFORMED for NaN, infinity, refused
                negative numbers, and components that the joint does not have.
        """
        if not math.isfinite(goal_time):
            raise GoalError(f"goal_time_tolerance is {goal_time}, not a number", reason=Reason.MALFORMED)
        if only_minus_one:
            _refuse_negative("goal_time_tolerance", goal_time)
        return Tolerances(
            _merged(self.path, path, path_components, "path_tolerance", only_minus_one),
            _merged(self.goal, goal, goal_components, "goal_tolerance", only_minus_one),
            _resolved(goal_time, self.goal_time),
        )

    def path_violation(
        self,
        names: Sequence[str],
        desired: Sample,
        actual_position: Sequence[float],
        actual_velocity: Sequence[float],
    ) -> str:
        """Describe deviations from the path, worst first; empty if there are none.

        Args:
            names: Joints, in the order of the other arguments.
            desired: Desired state.
            actual_position: Radians; NaN is a violation if the position is checked.
            actual_velocity: Radians per second; NaN is not checked.
        """
        return in_words(deviations(self.path, names, desired, actual_position, actual_velocity), "path")


def _resolved(asked: float, default: float) -> float:
    if asked == 0.0:
        return default
    return max(0.0, asked)


def _refuse_negative(what: str, value: float) -> None:
    if value < 0.0 and abs(value + 1.0) > _ROUNDING:
        text = f"{what} is {value:g}; 0 means the default, and only -1 disables the check"
        raise GoalError(text, reason=Reason.MALFORMED)


def _merged(
    defaults: Mapping[str, Tolerance],
    rows: Sequence[tuple[str, float, float, float]],
    components: Sequence[ComponentTolerance],
    field: str,
    only_minus_one: bool,
) -> dict[str, Tolerance]:
    merged: dict[str, Tolerance] = {}
    rotations = [_rotation(row, f"component_{field}") for row in components]
    for name, *values in (*rows, *rotations):
        if name not in defaults:
            text = f"{field} is for {_quoted(name)}; this controller has {_listed(defaults)}"
            raise GoalError(text, reason=Reason.WRONG_JOINTS)
        if name in merged:
            raise GoalError(f"{field} is given twice for {name}; give it once", reason=Reason.WRONG_JOINTS)
        old = defaults[name]
        kept = (old.position, old.velocity, old.acceleration)
        for kind, value in zip(("position", "velocity", "acceleration"), values, strict=True):
            if not math.isfinite(value):
                text = f"{field} for the {kind} of {name} is {value}, not a number; -1 disables the check"
                raise GoalError(text, reason=Reason.MALFORMED)
            if only_minus_one:
                _refuse_negative(f"{field} for the {kind} of {name}", value)
        merged[name] = Tolerance(*map(_resolved, values, kept))
    return {**defaults, **merged}


def _rotation(row: ComponentTolerance, field: str) -> tuple[str, float, float, float]:
    """A component tolerance as one of the joint's angle."""
    if row.component != Component.ROTATION:
        known = row.component in set(Component)
        what = Component(row.component).name if known else f"the unknown component {row.component}"
        text = f"{field} of {_quoted(row.joint)} is for {what}; joints of this arm have only ROTATION"
        raise GoalError(text, reason=Reason.MALFORMED)
    return row.joint, row.position, row.velocity, row.acceleration


def _quoted(name: str) -> str:
    """A client's name, shortened and escaped to stay on one line."""
    return ascii(name if len(name) <= 40 else name[:40] + "...")


def _listed(names: Iterable[str]) -> str:
    names = list(names)
    more = [f"{len(names) - _SHOWN} more"] if len(names) > _SHOWN else []
    return ", ".join(names[:_SHOWN] + more)


def check_goal(
    goal: TrajectoryGoal, joints: tuple[str, ...], *, allow_partial: bool, end_at_rest: bool = False
) -> None:
    """Refuse a goal that the rules forbid. One without points passes; the caller handles it.

    The path check (limits, speeds, joint coupling limits, table) is not done here.

    Args:
        goal: The goal.
        joints: Joints of the controller.
        allow_partial: Whether the goal may omit joints.
        end_at_rest: Whether the velocities of the last point must be 0.

    Raises:
        GoalError: WRONG_JOINTS if the names are wrong, MALFORMED for everything else. Points are counted from 0.
    """
    if goal.free:
        names = _listed([_quoted(name) for name in goal.free])
        raise _invalid(f"multi_dof_trajectory is for {names}; every joint of this arm has one axis")
    _check_names(goal.names, joints, allow_partial)
    if not math.isfinite(goal.delay):
        raise _invalid(f"header.stamp is {goal.delay} s from now, not a time")
    if len(goal.points) > MAX_POINTS:
        raise _invalid(f"the trajectory has {len(goal.points)} points; send at most {MAX_POINTS} at a time")
    before = -math.inf
    for i, point in enumerate(goal.points):
        _check_time(i, point.time, before)
        before = point.time
        _check_values(i, point, goal.names)
    if end_at_rest and goal.points:
        _check_rest(len(goal.points) - 1, goal.points[-1], goal.names)


def _invalid(text: str) -> GoalError:
    return GoalError(text, reason=Reason.MALFORMED)


def _check_names(names: tuple[str, ...], joints: tuple[str, ...], allow_partial: bool) -> None:
    known = set(joints)
    counts = Counter(names)
    faults = []
    if unknown := [_quoted(name) for name in counts if name not in known]:
        faults.append(f"{_listed(unknown)} unknown")
    if twice := [_quoted(name) for name, count in counts.items() if count > 1]:
        faults.append(f"{_listed(twice)} more than once")
    missing = [name for name in joints if name not in counts]
    if missing and not (allow_partial and names):
        faults.append(f"{_listed(missing)} missing")
    if faults:
        text = f"joint_names: {'; '.join(faults)}; this controller has {', '.join(joints)}"
        raise GoalError(text, reason=Reason.WRONG_JOINTS)


def _check_time(i: int, time: float, before: float) -> None:
    field = f"points[{i}].time_from_start"
    if not math.isfinite(time):
        raise _invalid(f"{field} is {time}, not a time")
    if not 0.0 <= time <= _LONGEST:
        raise _invalid(f"{field} is {time:g} s; it must be 0 or more, and no more than {_LONGEST:g} s")
    # Half a tick, because of rounding: as floats, two times one tick apart may be slightly closer.
    if time - before < _TICK / 2:
        raise _invalid(
            f"{field} is {time:.10g} s, not after the {before:.10g} s of points[{i - 1}]; times must increase"
        )


def _check_rest(i: int, point: Point, names: tuple[str, ...]) -> None:
    for name, value in zip(names, point.velocities, strict=False):
        if abs(value) > _ROUNDING:
            raise _invalid(f"points[{i}].velocities: {name} is {value:g}; the last point must have velocity 0")


def _check_values(i: int, point: Point, names: tuple[str, ...]) -> None:
    if not point.positions:
        raise _invalid(f"points[{i}].positions is empty; positions are needed, for {', '.join(names)}")
    if point.accelerations and not point.velocities:
        raise _invalid(f"points[{i}] has accelerations but no velocities; send both or neither")
    rows = (
        ("positions", point.positions, _MOST),
        ("velocities", point.velocities, _MOST),
        ("accelerations", point.accelerations, _MOST),
        ("effort", point.effort, 0.0),
    )
    for field, values, most in rows:
        if values and len(values) != len(names):
            text = f"points[{i}].{field} has {len(values)} values for the {len(names)} joints {', '.join(names)}"
            raise _invalid(text)
        for name, value in zip(names, values, strict=False):
            if abs(value) <= most:
                continue
            where = f"points[{i}].{field}: {name}"
            if not math.isfinite(value):
                raise _invalid(f"{where} is {value}, not a number")
            if most:
                raise _invalid(f"{where} is {value:g}, which no joint can do; check the unit, it is radians")
            raise _invalid(f"{where} is {value:g}; this arm accepts no feed-forward, leave effort empty")
