"""The host's limits on targets: what is refused, and what is slowed down.

Owns the host's check of a target against an arm model. A position outside the limits is refused, never
silently changed; a motion that would be too fast is given more time, which the caller sees. The board checks
again with limits of its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from hexwire.errors import UsageError
from hexwire.model.arm import ArmModel
from hexwire.model.state import JointTarget

from .quintic import PEAK_ACCELERATION, PEAK_JERK, PEAK_SPEED
from .trajectory import Scaled, Trajectory

__all__ = [
    "Slower",
    "check_target",
    "needed_duration",
    "rest_duration",
    "resting_inside",
    "slow_enough",
    "smooth_duration",
]

_STEP, _ROUNDING = 0.001, 1.001
"""Seconds between samples of a trajectory that may be too fast, and the factor for what happens between them."""
_LONGEST_REST = 2.0
"""Most seconds in which a board comes to rest on a path: PROTOCOL.md 6.7."""
_AT_STOP = math.radians(1.5)
"""How far a joint that rests on its mechanical stop may be outside its limits, which end before the stop."""


def resting_inside(model: ArmModel, positions: Mapping[str, float]) -> dict[str, float]:
    """Positions from which a motion may begin: a joint that rests on its stop begins at its limit.

    Args:
        model: The arm.
        positions: Measured angles in radians by joint name; what is further outside, or unknown, stays as it is.
    """
    found = {}
    for name, angle in positions.items():
        joint = model.joint(name)
        nearest = max(joint.minimum, min(joint.maximum, angle))
        found[name] = nearest if abs(angle - nearest) <= _AT_STOP else angle
    return found


def needed_duration(model: ArmModel, start: Mapping[str, float], goal: Mapping[str, float]) -> float:
    """Shortest time in seconds in which no joint exceeds its speed limit at constant speed.

    Joints whose start position is missing or not a number do not count.
    """
    return max(
        (
            abs(angle - start[name]) / model.joint(name).max_speed
            for name, angle in goal.items()
            if math.isfinite(start.get(name, math.nan))
        ),
        default=0.0,
    )


def rest_duration(model: ArmModel, names: Iterable[str]) -> float:
    """Seconds in which a board lets a path come to rest by itself, where no host can plan that.

    The rate of the path's time falls as 1 - 3u^2 + 2u^3 (PROTOCOL.md 6.7). Its steepest slope is 3/2 at u = 1/2,
    and that changes by 6 at most: even motion at full speed is braked within the limits of acceleration and jerk.

    Args:
        model: The arm.
        names: Joints of the path.
    """
    joints = [model.joint(name) for name in names]
    needed = [
        max(1.5 * joint.max_speed / joint.max_acceleration, math.sqrt(6.0 * joint.max_speed / joint.max_jerk))
        for joint in joints
    ]
    return min(_LONGEST_REST, max(needed, default=_LONGEST_REST))


def smooth_duration(model: ArmModel, start: Mapping[str, float], goal: Mapping[str, float]) -> float:
    """Shortest time in seconds in which a quintic from rest to rest keeps the limits of speed, acceleration, jerk.

    Joints whose start position is missing or not a number do not count.
    """
    longest = 0.0
    for name, angle in goal.items():
        way, joint = abs(angle - start.get(name, math.nan)), model.joint(name)
        if math.isfinite(way):
            longest = max(
                longest,
                PEAK_SPEED * way / joint.max_speed,
                math.sqrt(PEAK_ACCELERATION * way / joint.max_acceleration),
                math.cbrt(PEAK_JERK * way / joint.max_jerk),
            )
    return longest


class Slower(Scaled):
    """A trajectory at a lower speed, because of one joint.

    Args:
        other: The trajectory.
        times: How many times slower.
        joint: Name of the joint.
        at: Where the joints are then, radians.

    Attributes:
        planned: Seconds of the trajectory without that.
        joint: Name of the joint.
        place: Radians by joint.
    """

    def __init__(self, other: Trajectory, times: float, joint: str, at: Sequence[float]) -> None:
        super().__init__(other, 1.0 / times)
        self.planned, self.joint, self.place = other.duration, joint, dict(zip(other.names, at, strict=True))


def slow_enough(model: ArmModel, trajectory: Trajectory) -> Trajectory:
    """A trajectory as fast as the limits of acceleration and jerk of its joints allow, and no faster than it is.

    A line has limits of the tip; near a singular pose the joints need more. Too high a speed is left to the check
    of the path, which refuses it by name.
    """
    joints = [model.joint(name) for name in trajectory.names]
    limits = [(joint.max_acceleration, _STEP * joint.max_jerk) for joint in joints]
    # Jerk falls with the cube of the speed; but where a cubic meets the next, with the square.
    worst, before, cause = 1.0, (0.0,) * len(joints), None
    for _, (position, _, now) in trajectory.samples(_STEP):
        for i, (most, change) in enumerate(limits):
            a = now[i]
            share = max(abs(a) / most, abs(a - before[i]) / change)
            if share > worst:
                worst, cause = share, (joints[i].name, position)
        before = now
    return trajectory if cause is None else Slower(trajectory, math.sqrt(worst) * _ROUNDING, *cause)


def check_target(model: ArmModel, target: JointTarget, start: Mapping[str, float]) -> JointTarget:
    """Check a target before it is encoded.

    Args:
        model: The arm.
        target: The requested target.
        start: Present positions in radians by joint name, as far as they are known.

    Returns:
        The target with the arm's own joint names, and a duration that respects every speed limit; that of a guided
        target is the speed of the servo.

    Raises:
        LimitError: A position is outside its limits; nothing may be sent.
        UsageError: A joint does not exist, or is named twice.
    """
    # Every target of every cycle comes here: it is made anew only if something changes.
    duration, renamed, joints = target.duration, False, model.by_name
    guided = target.guided
    for name, angle in target.positions:
        joint = joints.get(name) or model.joint(name)
        if not joint.minimum <= angle <= joint.maximum:
            joint.check(angle)
        own = joint.name
        renamed |= own != name
        most = joint.guided_speed if guided else joint.max_speed
        # False for a start that is missing, not a number or infinite.
        if duration < (needed := abs(angle - start.get(own, math.nan)) / most) < math.inf:
            duration = needed
    if duration == target.duration and not renamed:
        return target
    positions = {}
    for name, angle in target.positions:
        own = model.joint(name).name
        if own in positions:
            # A target itself refuses only the same spelling.
            raise UsageError(f"a target names {own} twice")
        positions[own] = angle
    return replace(target, positions=tuple(positions.items()), duration=duration)
