"""Checks of a complete trajectory or path before anything moves.

Owns the checks of joint limits, joint speeds, the joint coupling limit and the table, and at which speed a motion
that has times of its own passes them. Must not know robots.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count

from hexwire.errors import LimitError
from hexwire.model.arm import ArmModel
from hexwire.model.kinematics import KinematicModel
from hexwire.model.state import LONGEST
from hexwire.units import decimal

from .fence import Fence
from .trajectory import Sample, Trajectory

__all__ = ["SLOWEST", "InJoints", "MotionReport", "PathFault", "check_move", "check_trajectory", "speed_that_fits"]

_TURN = math.radians(1.0)
"""Radians between two checks of a move."""
_STEP = 0.01
"""Seconds between checks: 1.5 degrees of the fastest 7Bot joint."""
_ROUNDING = 1.001
"""Times its speed limit that a joint may turn: an optimal motion runs at its limit."""
SLOWEST = 0.1
"""Least factor at which a motion is offered; one that is still too fast has a jump in it."""
_FACTORS = 1000
"""Factors to 1 that may be offered: three digits can be read and typed."""
_GUESSES = 6
"""Of the largest of them; then half of those that are left are ruled out each time."""


class InJoints(Trajectory):
    """Converts a trajectory in a model's own angles to the driver's joints.

    Args:
        other: The trajectory, in the model's angles.
        model: The kinematics.
    """

    def __init__(self, other: Trajectory, model: KinematicModel) -> None:
        zero = model.to_joints([0.0] * len(other.names))
        one = model.to_joints([1.0] * len(other.names))
        self.names = tuple(zero)
        self.duration = other.duration
        self._other = other
        self._offsets = tuple(zero.values())
        self._factors = tuple(one[name] - zero[name] for name in zero)

    def at(self, t: float) -> Sample:
        position, velocity, acceleration = self._other.at(t)
        k = self._factors
        return Sample(
            tuple([o + f * q for o, f, q in zip(self._offsets, k, position, strict=True)]),
            tuple([f * v for f, v in zip(k, velocity, strict=True)]),
            tuple([f * a for f, a in zip(k, acceleration, strict=True)]),
        )


@dataclass(frozen=True, slots=True)
class PathFault:
    """A violation, and when it first occurs.

    Attributes:
        time: Seconds from the start.
        text: Description.
    """

    time: float
    text: str

    def __str__(self) -> str:
        return f"at {self.time:.2f} s: {self.text}"


@dataclass(frozen=True, slots=True)
class MotionReport:
    """Result of a check.

    Attributes:
        duration: Seconds.
        peak_speed: Highest speed of each joint, radians per second.
        lowest: Height of the lowest point of the arm, metres; infinite without a model.
        findings: The first violation of each kind; empty if the trajectory is allowed.
    """

    duration: float
    peak_speed: Mapping[str, float]
    lowest: float
    findings: tuple[PathFault, ...]

    def require(self) -> MotionReport:
        """Refuse a trajectory that is not allowed.

        Raises:
            LimitError: There are findings; the text lists them all. Nothing was sent.
        """
        if self.findings:
            raise LimitError("; ".join(map(str, self.findings)) + "; nothing was sent")
        return self


def check_trajectory(
    trajectory: Trajectory,
    arm: ArmModel,
    model: KinematicModel | None = None,
    *,
    others: Mapping[str, float] | None = None,
    meanwhile: Sequence[Trajectory] = (),
    table: float | None = 0.0,
    step: float = _STEP,
    goes_on: bool = False,
) -> MotionReport:
    """Check a trajectory of driver joints from start to end.

    An arm that starts beyond the joint coupling limit or below the table, because it has sunk without torque, may
    move out of the forbidden region, but neither further in nor back in. A trajectory that begins below the table
    must end above it.

    Args:
        trajectory: The trajectory; its joints are any subset of the arm's.
        arm: Limits and speeds.
        model: Kinematics, for the joint coupling limit and the table; without it, or if it knows none of the
            joints, neither is checked.
        others: Positions of joints that the trajectory does not move, radians.
        meanwhile: Trajectories of other joints that start at the same time. The trajectory's own joints rest at
            their end until these have ended too.
        table: Height above the base below which no point of the arm may come, metres; None for no table.
        step: Seconds between two samples.
        goes_on: It is a part of a motion, which may end where the arm does not stay.
    """
    joints = [arm.joint(name) for name in trajectory.names]
    found: dict[str, PathFault] = {}
    peak = [0.0] * len(joints)
    lowest = math.inf
    known = set(trajectory.names).intersection(model.joint_names) if model is not None else set()
    fence = Fence(model, table) if model is not None and known else None
    last: tuple[float, tuple[float, ...]] | None = None

    def note(kind: str, t: float, text: str) -> None:
        found.setdefault(kind, PathFault(t, text))

    for t, sample in _samples(trajectory, max((other.duration for other in meanwhile), default=0.0), step):
        # Two samples may be a rounding error apart; a distance covered in no time is still a jump.
        since = max(t - last[0], 1e-6) if last else 0.0
        # A trajectory may be passed at its end, with the speed that it has there.
        velocity = trajectory.at(t).velocity if t == trajectory.duration else sample.velocity
        for i, (joint, angle) in enumerate(zip(joints, sample.position, strict=True)):
            if not joint.minimum <= angle <= joint.maximum:
                try:
                    joint.check(angle)
                except LimitError as error:
                    advice = "" if last else f"; bring it back first: hexwire move {joint.name}=..."
                    note(joint.name, t, str(error).partition(";")[0] + advice)
            speed = abs(velocity[i])
            if last and (mean := abs(angle - last[1][i]) / since) > speed:
                speed = mean
            if math.isnan(speed):
                # Of values so far apart that their difference is none.
                speed = math.inf
            if speed > peak[i]:
                peak[i] = speed
            if not speed <= joint.max_speed * _ROUNDING:
                note(
                    f"{joint.name} speed",
                    t,
                    f"{joint.name} would turn at {decimal(math.degrees(speed))} deg/s, "
                    f"its limit is {decimal(math.degrees(joint.max_speed))} deg/s",
                )
        if fence is not None:
            where = dict(others or {})
            for other in meanwhile:
                where.update(zip(other.names, other.sample(t).position, strict=True))
            where.update(zip(trajectory.names, sample.position, strict=True))
            if last is None:
                fence.begin(where)
            for kind, text in fence.check(where).items():
                note(kind, t, text)
            lowest = min(lowest, fence.lowest)
        last = (t, sample.position)
    if fence is not None and not goes_on and trajectory.duration and (still := fence.below):
        note("table", trajectory.duration, still)
    findings = tuple(sorted(found.values(), key=lambda f: f.time))
    return MotionReport(trajectory.duration, dict(zip(trajectory.names, peak, strict=True)), lowest, findings)


def speed_that_fits(make: Callable[[float], Trajectory], arm: ArmModel, most: float = 1.0) -> float | None:
    """The largest factor of its speed at which a motion keeps the speed limits, in thousandths.

    It is found by the check that decides whether the motion may begin: at this factor that allows it, a thousandth
    above it does not. Positions, which no speed changes, are not looked at.

    Args:
        make: Makes the motion at a factor of its speed.
        arm: Limits of its joints.
        most: The factor that is wanted.

    Returns:
        The factor: `most` if the motion keeps the limits at that, None if it needs less than `SLOWEST`, or longer
        than a motion may take.
    """

    def over(factor: float) -> float:
        """Times its limit that the fastest joint turns."""
        peak = check_trajectory(make(factor), arm, table=None).peak_speed
        return max((speed / arm.joint(name).max_speed for name, speed in peak.items()), default=0.0)

    now = over(most)
    if now <= _ROUNDING:
        return most
    # In thousandths: the greatest that is allowed, and the least that is not.
    least = max(SLOWEST, most * make(most).duration / LONGEST)
    low, high = math.ceil(least * _FACTORS) - 1, math.ceil(most * _FACTORS)
    here, found = high, None
    for tries in count():
        if high - low <= 1:
            break
        # The speed is nearly proportional to the factor. But a check sees samples, and not all of the motion.
        near = math.floor(here * _ROUNDING / now) if tries < _GUESSES else (low + high) // 2
        here = min(max(near, low + 1), high - 1)
        now = over(here / _FACTORS)
        if now <= _ROUNDING:
            low, found = here, here / _FACTORS
        else:
            high = here
    return found


def check_move(
    here: Mapping[str, float], goal: Mapping[str, float], model: KinematicModel, table: float | None = 0.0
) -> None:
    """Check the straight path of joints to a goal against the joint coupling limit and the table.

    Args:
        here: Present positions of all joints, radians.
        goal: Goal positions of some joints, radians.
        model: Kinematics.
        table: Height above the base below which no point of the arm may come, metres; None for no table.

    Raises:
        LimitError: The path is not allowed; nothing was sent.
        UsageError: The position of a joint is unknown.
    """
    goal = {name: goal[name] for name in model.joint_names if name in goal}
    if not goal:
        return
    fence = Fence(model, table)
    fence.begin(here)
    steps = max(math.ceil(abs(angle - here[name]) / _TURN) for name, angle in goal.items())
    for i in range(1, steps + 1):
        moved = {name: here[name] + i / steps * (angle - here[name]) for name, angle in goal.items()}
        posture = {**here, **moved}
        if found := fence.check(posture) if i < steps else Fence(model, table).check_end(here, posture):
            where = "at the goal" if i == steps else f"after {100 * i // steps} % of the path"
            raise LimitError(f"{'; '.join(found.values())}, {where}; nothing was sent")


def _samples(trajectory: Trajectory, until: float, step: float) -> Iterator[tuple[float, Sample]]:
    """Samples of a trajectory, and of its end while other trajectories continue."""
    yield from trajectory.samples(step)
    for i in range(1, math.ceil((until - trajectory.duration) / step) + 1):
        t = trajectory.duration + i * step
        yield t, trajectory.sample(t)
