"""A trajectory is checked as a whole before anything moves.

Owns the check: limits and speeds of joints, the gates of the arm, the table. Must not know robots, nor how a
trajectory came to be.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from hexwire.errors import LimitError
from hexwire.model.arm import ArmModel
from hexwire.model.kinematics import KinematicModel

from .waypoints import Sample, Trajectory

__all__ = ["Finding", "InJoints", "MotionReport", "check_trajectory"]

_STEP = 0.01
"""Seconds between checks: 1.5 degrees of the fastest 7Bot joint."""
_CREEP = 1e-6
"""Radians or metres that rounding is granted."""
_WAY_OUT_ANGLE = math.radians(0.5)
_WAY_OUT_HEIGHT = 0.002
"""What an arm that begins where it must not be may go further in on its way out, radians and metres."""


class InJoints(Trajectory):
    """A trajectory in a model's own angles as one of the driver's joints.

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
            tuple(o + f * q for o, f, q in zip(self._offsets, k, position, strict=True)),
            tuple(f * v for f, v in zip(k, velocity, strict=True)),
            tuple(f * a for f, a in zip(k, acceleration, strict=True)),
        )


@dataclass(frozen=True, slots=True)
class Finding:
    """What is wrong, and when it first is.

    Attributes:
        time: Seconds from the start.
        text: In words.
    """

    time: float
    text: str

    def __str__(self) -> str:
        return f"at {self.time:.2f} s: {self.text}"


@dataclass(frozen=True, slots=True)
class MotionReport:
    """What a check found.

    Attributes:
        duration: Seconds.
        peak_speed: Highest speed of each joint, radians per second.
        lowest: Height of the lowest of the arm's points, metres; infinite without a model.
        findings: The first of each kind; empty if the trajectory may be run.
    """

    duration: float
    peak_speed: Mapping[str, float]
    lowest: float
    findings: tuple[Finding, ...]

    def require(self) -> MotionReport:
        """Refuse a trajectory that must not be run.

        Raises:
            LimitError: With every finding; nothing was sent.
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
    table: float | None = 0.0,
    step: float = _STEP,
) -> MotionReport:
    """Check a trajectory of driver joints from start to end.

    An arm that begins beyond a gate or below the table, as one that has sunk without torque, may leave there: it
    must not get further in, nor come back.

    Args:
        trajectory: What shall be run; its names are the arm's, any subset.
        arm: Limits and speeds.
        model: Kinematics, for gates and table; without it neither is checked.
        others: Positions of joints that the trajectory leaves where they are, radians.
        table: Height above the base below which no point of the arm may come, metres; None for no table.
        step: Seconds between two samples that are looked at.
    """
    joints = [arm.joint(name) for name in trajectory.names]
    found: dict[str, Finding] = {}
    peak = [0.0] * len(joints)
    lowest = math.inf
    # How far in the arm may be: as far as it was at the start, and never again as far as it was before.
    gate, floor = 0.0, -math.inf
    last: tuple[float, tuple[float, ...]] | None = None

    def note(kind: str, t: float, text: str) -> None:
        found.setdefault(kind, Finding(t, text))

    for t, sample in trajectory.samples(step):
        since = t - last[0] if last else 0.0
        for i, (joint, angle) in enumerate(zip(joints, sample.position, strict=True)):
            try:
                joint.check(angle)
            except LimitError as error:
                advice = "" if last else f"; bring it back first: hexwire move {joint.name}=..."
                note(joint.name, t, str(error).partition(";")[0] + advice)
            speed = abs(sample.velocity[i])
            if last and since > 1e-6:
                speed = max(speed, abs(angle - last[1][i]) / since)
            peak[i] = max(peak[i], speed)
            # A thousandth of grace: an optimal motion runs at its limit.
            if speed > joint.max_speed * 1.001:
                note(
                    f"{joint.name} speed",
                    t,
                    f"{joint.name} would turn at {math.degrees(speed):.4g} deg/s, "
                    f"{math.degrees(joint.max_speed):.4g} are allowed",
                )
        if model is not None:
            where = {**(others or {}), **dict(zip(trajectory.names, sample.position, strict=True))}
            angles = model.from_joints(where)
            excess = model.gate_excess(angles)
            if last is None and excess:
                gate = excess + _WAY_OUT_ANGLE
            if excess > gate + _CREEP:
                own = [r.name for r in model.ranges]
                text = next((v for v in model.violations(angles) if v.split("=")[0] not in own), "a gate is shut")
                note("gate", t, text)
            gate = min(gate, excess)
            name, height = min(((n, p[2]) for n, p in model.points(angles).items()), key=lambda row: row[1])
            lowest = min(lowest, height)
            if table is not None:
                if last is None:
                    floor = table if height >= table else height - _WAY_OUT_HEIGHT
                if height < floor - _CREEP:
                    depth, level = 1e3 * (table - height), 1e3 * table
                    note("table", t, f"the {name} would be {depth:.1f} mm below the table at {level:.0f} mm")
                floor = min(table, max(floor, height))
        last = (t, sample.position)
    findings = tuple(sorted(found.values(), key=lambda f: f.time))
    return MotionReport(trajectory.duration, dict(zip(trajectory.names, peak, strict=True)), lowest, findings)
