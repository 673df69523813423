"""A tool that a person guides: its speed changes as the limits of the joints that carry it allow.

Owns the speed along and about the axes of the base, and what that asks of the joints. Must not know sticks, robots
or clocks.

The tool keeps its line, so its joints move as the kinematics say; the Jacobian gives their velocities and
accelerations.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from hexwire.errors import LimitError
from hexwire.model.arm import ArmModel
from hexwire.model.kinematics import KinematicModel
from hexwire.model.pose import Pose, dot, multiply, rotation_about

from .moving import State, change, joint_limits
from .speed_profile import JointLimits

__all__ = ["OperatorTool", "ToolStep"]

_AXES, _TURNS = 6, 3
"""Axes of a tool, and which is the first to turn about; the joints from that number on are its wrist."""
_FAST, _EASY = 0.8, 0.7
"""Shares of what a joint may do that a steady motion of the tool asks of it: of its speed, and of the speed at
which a turn of the joint by a radian takes all its acceleration or jerk."""
_RAMP = 0.5
"""The same of a change of speed: what the curve of a joint takes comes to it."""
_KEPT = 0.85
"""Share of a limit that counts as kept: it is compared at the end of a step."""
_OFF = 0.05
"""How far a joint may be from where its velocity and acceleration lead it, by jerk and time."""
_LEAST = 0.25
"""Share of the wanted speed below which a singular pose is too near for it."""
_AHEAD = 1e-4
"""Seconds ahead at which the joints' velocities are compared, for their accelerations."""
_NEARER = 0.01
"""Radians ahead at which it is seen whether a singular pose comes nearer."""
_ROUNDING = 1e-8
"""Radians by which the kinematics may be inexact."""
_DAMPING = 1e-10
"""Square of what counts as no motion of the tool by a joint: a singular pose has solutions, too."""


class ToolStep(NamedTuple):
    """The end of a step.

    Attributes:
        joints: States by joint name.
        speeds: Velocity and acceleration along x, y, z and about them, m/s, rad/s and by the second.
    """

    joints: dict[str, State]
    speeds: tuple[tuple[float, float], ...]


class OperatorTool:
    """The tool of an arm.

    Args:
        arm: Limits of its joints.
        kinematics: Of the arm.
    """

    def __init__(self, arm: ArmModel, kinematics: KinematicModel) -> None:
        self.names = kinematics.joint_names
        self._kinematics = kinematics
        self._joints = [arm.joint(name) for name in self.names]
        self._limits = joint_limits(arm, self.names)
        self._fastest = [
            min(_FAST * most.speed, _EASY * math.sqrt(most.acceleration), _EASY * math.cbrt(0.5 * most.jerk))
            for most in self._limits
        ]
        # Joints may turn the other way than the angles of the kinematics.
        zero, one = (kinematics.to_joints([x] * len(self.names)) for x in (0.0, 1.0))
        self._signs = [one[name] - zero[name] for name in self.names]

    def step(
        self,
        joints: Mapping[str, State],
        speeds: Sequence[tuple[float, float]],
        wanted: Sequence[float],
        seconds: float,
    ) -> ToolStep:
        """Change the tool's speed towards another one for a time.

        Args:
            joints: States of its joints at the begin, by name.
            speeds: Velocities and accelerations of the tool, as in `ToolStep`.
            wanted: Velocities along x, y, z and about them.
            seconds: Above 0.

        Raises:
            LimitError: The joints cannot do it within their limits, for example near a singular pose.
        """
        here = self._kinematics.from_joints({name: joints[name][0] for name in self.names})
        active = [k for k in range(_AXES) if wanted[k] or any(speeds[k])]
        if not active:
            return ToolStep({name: joints[name] for name in self.names}, tuple(speeds))
        *columns, towards_it = self._rates(here, [*([float(i == k) for i in range(_AXES)] for k in active), wanted])
        share = self._easy(here, towards_it, wanted)
        most = self._tool_limits(columns)
        ways, after = [0.0] * _AXES, [(0.0, 0.0)] * _AXES
        for k in active:
            ways[k], v, a = change(speeds[k], share * wanted[k], most, seconds)
            after[k] = v, a
        angles = self._kinematics.best(_moved(self._kinematics.forward(here), ways), here).angles
        found = self._states(angles, after)
        for name, joint, limits, state in zip(self.names, self._joints, self._limits, found, strict=True):
            if not joint.minimum <= state[0] <= joint.maximum:
                raise LimitError(f"{name} at the limit")
            if not _follows(joints[name], state, limits, seconds):
                raise _jump(name)
        return ToolStep(dict(zip(self.names, found, strict=True)), tuple(after))

    def _easy(self, here: Sequence[float], rates: Sequence[float], wanted: Sequence[float]) -> float:
        """The share of a wanted speed that the joints can do; near a singular pose they would have to be fast."""
        share, name = self._share(rates)
        if share < _LEAST:
            (then,) = self._rates(self._turned(here, rates, _NEARER / max(map(abs, rates))), [wanted])
            if self._share(then)[0] < share:
                raise _jump(name)
        return share

    def _share(self, rates: Sequence[float]) -> tuple[float, str]:
        shares = [
            (fastest / abs(rate), name)
            for rate, fastest, name in zip(rates, self._fastest, self.names, strict=True)
            if rate
        ]
        return min([(1.0, ""), *shares])

    def _tool_limits(self, columns: Sequence[Sequence[float]]) -> JointLimits:
        """Limits of each axis of the tool with which the joints keep theirs, although several change at once."""
        steep = [sum(map(abs, rates)) for rates in zip(*columns, strict=True)]
        return JointLimits(
            math.inf,
            min(_RAMP * most.acceleration / s for most, s in zip(self._limits, steep, strict=True) if s),
            min(_RAMP * most.jerk / s for most, s in zip(self._limits, steep, strict=True) if s),
        )

    def _states(self, angles: Sequence[float], speeds: Sequence[tuple[float, float]]) -> list[State]:
        """The joints of a tool that moves so."""
        speed, change = [v for v, _ in speeds], [a for _, a in speeds]
        velocity, acceleration = self._rates(angles, [speed, change])
        # What the curve of a joint asks of it comes to what the change of speed asks.
        (later,) = self._rates(self._turned(angles, velocity, _AHEAD), [speed])
        bend = [(w - v) / _AHEAD for v, w in zip(velocity, later, strict=True)]
        where = self._kinematics.to_joints(angles)
        return [
            (where[name], v, a + b) for name, v, a, b in zip(self.names, velocity, acceleration, bend, strict=True)
        ]

    def _turned(self, angles: Sequence[float], rates: Sequence[float], seconds: float) -> list[float]:
        return [x + seconds * sign * v for x, sign, v in zip(angles, self._signs, rates, strict=True)]

    def _rates(self, angles: Sequence[float], of_tool: Sequence[Sequence[float]]) -> list[list[float]]:
        """Velocities of the joints for each velocity of the tool, or those that come closest to it.

        An arm of five joints cannot turn as is wanted: it keeps the place of its tip and what its wrist can do.
        """
        rows = [list(row) for row in self._kinematics.jacobian(angles)]
        wrist = list(zip(*rows[_TURNS:], strict=True))[_TURNS:]
        matrix = [*rows[:_TURNS], *([dot(axis, c) for c in zip(*rows[_TURNS:], strict=True)] for axis in wrist)]
        wanted = [[*v[:_TURNS], *(dot(axis, v[_TURNS:]) for axis in wrist)] for v in of_tool]
        columns = list(zip(*matrix, strict=True))
        squares = [[dot(a, b) for b in columns] for a in columns]
        for i, row in enumerate(squares):
            row[i] += _DAMPING
        found = _solved(squares, [[dot(a, v) for v in wanted] for a in columns])
        return [
            [sign * x for sign, x in zip(self._signs, rates, strict=True)] for rates in zip(*found, strict=True)
        ]


def _jump(name: str) -> LimitError:
    return LimitError(
        f"{name} would have to jump: near a singular pose; choose another direction, or move the joints"
    )


def _follows(before: State, after: State, limits: JointLimits, seconds: float) -> bool:
    """Whether a joint comes from one state to the other within its limits, and to rest from there."""
    (p, v, a), (q, w, b) = before, after
    roughness = limits.jerk * seconds
    off = q - p - seconds * (0.5 * (v + w) + seconds * (a - b) / 12.0)
    return (
        max(abs(w), abs(w + 0.5 * b * abs(b) / limits.jerk)) <= _KEPT * limits.speed
        and abs(b) <= _KEPT * limits.acceleration
        and abs(b - a) <= _KEPT * roughness
        # Else it is another solution of the kinematics.
        and abs(off) <= _OFF * roughness * seconds * seconds + _ROUNDING
    )


def _moved(pose: Pose, ways: Sequence[float]) -> Pose:
    """A pose after ways along the axes of the base and about them."""
    x, y, z = (place + way for place, way in zip(pose.position, ways[:3], strict=True))
    angle = math.hypot(*ways[3:])
    if not angle:
        return Pose((x, y, z), pose.rotation)
    axis = (ways[3] / angle, ways[4] / angle, ways[5] / angle)
    return Pose((x, y, z), multiply(rotation_about(axis, angle), pose.rotation))


def _solved(rows: Sequence[Sequence[float]], sides: Sequence[Sequence[float]]) -> list[list[float]]:
    """Linear equations of a positive definite matrix with several right sides, by elimination."""
    left = [[*row, *side] for row, side in zip(rows, sides, strict=True)]
    size = len(left)
    for i, top in enumerate(left):
        for row in left[i + 1 :]:
            factor = row[i] / top[i]
            row[i:] = [x - factor * y for x, y in zip(row[i:], top[i:], strict=True)]
    found: list[list[float]] = [[]] * size
    for i in reversed(range(size)):
        row = left[i]
        behind = range(i + 1, size)
        found[i] = [
            (side - sum(row[k] * found[k][n] for k in behind)) / row[i] for n, side in enumerate(row[size:])
        ]
    return found
