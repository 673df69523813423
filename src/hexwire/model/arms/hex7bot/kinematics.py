"""`Hex7BotModel`: kinematics of the 7Bot family, closed form, all branches.

Owns the geometry. Angles t0..t5 are the 7Bot's own: servo angles in radians, a quarter turn is neutral. The
forearm is part of a parallelogram, so t2 sets its pitch relative to the base, independent of t1. `from_joints` and
`to_joints` convert between servo angles and the driver's joint angles. Must not know counts.

With p = t2 - offset, in the plane of the arm (rho forward, z up):
wrist rho = d + a cos t1 + h sin p + c cos p, z = e + a sin t1 + h cos p - c sin p;
orientation R = Rz(t0) Ry(p) Rx(90 deg - t3) Ry(t4) Rz(-t5); tip = wrist + f times R's third column.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from hexwire.errors import UsageError
from hexwire.model.arm import ArmModel
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.arms.hex7bot.links import LINK_SETS, LinkSet
from hexwire.model.batch import hex7bot_forward_many, hex7bot_inverse_many
from hexwire.model.kinematics import (
    NEAR_SINGULAR,
    ONE_LINE,
    SINGULAR,
    JointRange,
    KinematicModel,
    Reach,
    Singularity,
    Solution,
    wrap,
)
from hexwire.model.pose import (
    Matrix,
    Pose,
    Vector,
    apply,
    column,
    cross,
    multiply,
    rotation_x,
    rotation_y,
    rotation_z,
    shifted,
    transpose,
)
from hexwire.units import decimal

__all__ = ["Hex7BotModel"]

_NEUTRAL = math.pi / 2
_ON_THE_AXIS = 1e-12


class Hex7BotModel(KinematicModel):
    """Kinematics with one link set; the chapter's HEX7BOT_RBT.

    Args:
        links: The link set; set A if None, since its library has the interface that the chapter uses.
        arm: The arm whose joint angles `from_joints` and `to_joints` convert.
    """

    name = "hex7bot"

    def __init__(self, links: LinkSet | None = None, arm: ArmModel = HEX7BOT) -> None:
        self.links = links or LINK_SETS["A"]
        self.arm = arm
        self._joints = tuple([(joint.name, joint.sign, joint.offset) for joint in arm.joints[:6]])
        self.ranges = self.links.ranges

    def within_arm(self) -> Hex7BotModel:
        """The same model with limits restricted to those of the arm's joints, for motion."""
        narrow = Hex7BotModel(self.links, self.arm)
        ranges = []
        for own, joint in zip(self.ranges, self.arm.joints, strict=False):
            ends = [_NEUTRAL + joint.sign * (end - joint.offset) for end in (joint.minimum, joint.maximum)]
            ranges.append(JointRange(own.name, max(own.minimum, min(ends)), min(own.maximum, max(ends))))
        narrow.ranges = tuple(ranges)
        return narrow

    # -- servo angles and joint angles ----------------------------------------------------------------

    def from_joints(self, positions: Mapping[str, float]) -> tuple[float, ...]:
        joints = self._joints
        try:
            return tuple([_NEUTRAL + sign * (positions[name] - offset) for name, sign, offset in joints])
        except KeyError:
            missing = [name for name, _, _ in joints if name not in positions]
            raise UsageError(f"the position of {', '.join(missing)} is missing") from None

    def to_joints(self, angles: Sequence[float]) -> dict[str, float]:
        self._finite(angles)
        return {
            joint.name: joint.sign * (angle - _NEUTRAL) + joint.offset
            for joint, angle in zip(self.arm.joints, angles, strict=False)
        }

    # -- forward ------------------------------------------------------------------------------------

    def wrist(self, angles: Sequence[float]) -> Vector:
        """Wrist centre of at least three servo angles, metres."""
        k = self.links
        t0, t1, p = angles[0], angles[1], angles[2] - k.offset
        rho = k.d + k.a * math.cos(t1) + k.h * math.sin(p) + k.c * math.cos(p)
        z = k.e + k.a * math.sin(t1) + k.h * math.cos(p) - k.c * math.sin(p)
        return (rho * math.cos(t0), rho * math.sin(t0), z)

    def elbow(self, angles: Sequence[float]) -> Vector:
        """Elbow axis of at least two servo angles, metres."""
        k = self.links
        rho = k.d + k.a * math.cos(angles[1])
        return (rho * math.cos(angles[0]), rho * math.sin(angles[0]), k.e + k.a * math.sin(angles[1]))

    def rotation(self, angles: Sequence[float]) -> Matrix:
        """Orientation of the tool."""
        t0, _, t2, t3, t4, t5 = angles
        return multiply(
            rotation_z(t0),
            rotation_y(t2 - self.links.offset),
            rotation_x(_NEUTRAL - t3),
            rotation_y(t4),
            rotation_z(-t5),
        )

    def forward(self, angles: Sequence[float]) -> Pose:
        self._finite(angles)
        rotation = self.rotation(angles)
        return Pose(shifted(self.wrist(angles), column(rotation, 2), self.links.f), rotation)

    def side(self, pose: Pose) -> Vector:
        """The side point of the tool, which shows its turn about its own axis, metres."""
        return shifted(pose.position, column(pose.rotation, 0), -self.links.g)

    def forward_many(self, angles: Sequence[Sequence[float]]) -> tuple[Any, Any]:
        return hex7bot_forward_many(self, self.links, angles)

    # -- inverse ------------------------------------------------------------------------------------

    def inverse(self, pose: Pose) -> tuple[Solution, ...]:
        solutions = []
        for arm_angles, branch in self._arm_branches(self._wrist_of(pose)):
            for wrist_angles, wrist, singular in self._wrist_branches(arm_angles, pose.rotation):
                angles = (*arm_angles, *wrist_angles)
                turned = tuple(r.nearest_turn(t) for r, t in zip(self.ranges, angles, strict=True))
                free = (0.0, 0.0, 0.0, 1.0, 0.0, -math.copysign(1.0, wrist_angles[1])) if wrist == ONE_LINE else ()
                found = self.violations(turned)
                solutions.append(Solution(turned, f"{branch}, {wrist}", found, singular, free))
        return self._sorted(solutions)

    def inverse_wrist(self, wrist: Vector) -> tuple[Solution, ...]:
        """All t0, t1, t2 that put the wrist centre at a position in metres; see `inverse`."""
        solutions = []
        for angles, branch in self._arm_branches(wrist):
            turned = tuple(r.nearest_turn(t) for r, t in zip(self.ranges, angles, strict=False))
            solutions.append(Solution(turned, branch, self._arm_violations(turned)))
        return self._sorted(solutions)

    def inverse_many(self, positions: Any, rotations: Any) -> Any:
        return hex7bot_inverse_many(self, self.links, positions, rotations)

    def _wrist_of(self, pose: Pose) -> Vector:
        return shifted(pose.position, column(pose.rotation, 2), -self.links.f)

    def _arm_branches(self, wrist: Vector) -> list[tuple[tuple[float, float, float], str]]:
        k = self.links
        x, y, z = wrist
        long = k.forearm
        found = []
        for facing, side_name in ((0.0, "front"), (math.pi, "back")):
            rho = math.hypot(x, y) * (1.0 if facing == 0.0 else -1.0)
            # On the base axis any t0 is correct: use straight ahead.
            t0 = (_NEUTRAL if abs(rho) < _ON_THE_AXIS else math.atan2(y, x)) + facing
            r, s = rho - k.d, z - k.e
            square = r * r + s * s
            line = math.sqrt(square)
            if line < _ON_THE_AXIS:
                continue
            cos_elbow = (k.a**2 + long**2 - square) / (2 * k.a * long)
            cos_shoulder = (k.a**2 + square - long**2) / (2 * k.a * line)
            if not (abs(cos_elbow) <= 1.0 + 1e-12 and abs(cos_shoulder) <= 1.0 + 1e-12):
                continue
            elbow = math.acos(max(-1.0, min(1.0, cos_elbow)))
            shoulder = math.acos(max(-1.0, min(1.0, cos_shoulder)))
            for side, bend in ((1.0, "elbow up"), (-1.0, "elbow down")):
                t1 = math.atan2(s, r) + side * shoulder
                p = k.forearm_angle - t1 + side * (math.pi - elbow)
                found.append(((t0, t1, p + k.offset), f"{side_name}, {bend}"))
        return found

    def _wrist_branches(
        self, arm_angles: Sequence[float], rotation: Matrix
    ) -> list[tuple[tuple[float, float, float], str, bool]]:
        t0, _, t2 = arm_angles
        m = multiply(transpose(multiply(rotation_z(t0), rotation_y(t2 - self.links.offset))), rotation)
        # m = Rx(roll) Ry(t4) Rz(-t5)
        off_axis = math.hypot(m[1][2], m[2][2])
        if off_axis < SINGULAR:
            # Roll and t5 turn about one line: the roll stays at neutral and t5 takes the whole turn.
            t4 = math.copysign(_NEUTRAL, m[0][2])
            return [((_NEUTRAL, t4, -math.atan2(m[1][0], m[1][1])), ONE_LINE, True)]
        found = []
        for sign, wrist in ((1.0, "wrist 1"), (-1.0, "wrist 2")):
            t4 = math.atan2(m[0][2], sign * off_axis)
            roll = math.atan2(-sign * m[1][2], sign * m[2][2])
            minus_t5 = math.atan2(-sign * m[0][1], sign * m[0][0])
            found.append(((_NEUTRAL - roll, t4, -minus_t5), wrist, off_axis < NEAR_SINGULAR))
        return found

    # -- reports ------------------------------------------------------------------------------------

    def reach(self, pose: Pose) -> Reach:
        return self.reach_wrist(self._wrist_of(pose))

    def reach_wrist(self, wrist: Vector) -> Reach:
        """Whether the links reach a position of the wrist centre, in metres."""
        k = self.links
        low, high = k.reach
        reports = []
        for rho in (math.hypot(wrist[0], wrist[1]), -math.hypot(wrist[0], wrist[1])):
            line = math.hypot(rho - k.d, wrist[2] - k.e)
            if line > high + 1e-12:
                cause = (
                    f"{1e3 * (line - high):.1f} mm beyond the {1e3 * high:.1f} mm that upper arm and forearm reach"
                )
                reports.append((line - high, line, cause))
            elif line < low - 1e-12:
                cause = f"{1e3 * (low - line):.1f} mm less than the {1e3 * low:.1f} mm of the folded arm"
                reports.append((low - line, line, cause))
            else:
                return Reach(True, 0.0, "")
        excess, line, cause = min(reports)
        return Reach(False, excess, f"the wrist would be {1e3 * line:.1f} mm from the shoulder, {cause}")

    def violations(self, angles: Sequence[float]) -> tuple[str, ...]:
        return super().violations(angles) + self._coupling_violations(angles[1], angles[2])

    def _arm_violations(self, angles: Sequence[float]) -> tuple[str, ...]:
        middle = [0.5 * (r.minimum + r.maximum) for r in self.ranges[3:]]
        return self.violations((*angles, *middle))

    def _coupling_violations(self, t1: float, t2: float) -> tuple[str, ...]:
        k = self.links
        elbow = self._elbow(t1, t2)
        found = []
        low, high = k.elbow
        if not low - 1e-9 <= elbow <= high + 1e-9:
            side = "open" if elbow > high else "folded"
            off = math.degrees(elbow - high if elbow > high else low - elbow)
            found.append(
                f"elbow {side} {decimal(off, 3)} deg too far: {decimal(math.degrees(elbow))} deg between upper arm "
                f"and forearm, {decimal(math.degrees(low))} to {decimal(math.degrees(high))} deg allowed"
            )
        limit = k.elevation
        if limit is not None and limit.elevation(t1, elbow) > limit.maximum + 1e-9:
            raised = math.degrees(limit.elevation(t1, elbow))
            found.append(
                f"arm raised {decimal(raised - math.degrees(limit.maximum), 3)} deg too far: {decimal(raised)} deg "
                f"from shoulder to wrist, {decimal(math.degrees(limit.maximum))} deg allowed"
            )
        return tuple(found)

    def _elbow(self, t1: float, t2: float) -> float:
        """Interior elbow angle within half a turn of the middle of its range; negative if folded past 0."""
        low, high = self.links.elbow
        return wrap(self.links.elbow_angle(t1, t2), 0.5 * (low + high))

    def points(self, angles: Sequence[float]) -> Mapping[str, Vector]:
        return {
            "elbow": self.elbow(angles),
            "wrist": self.wrist(angles),
            "tool": self.forward(angles).position,
        }

    def lowest(self, angles: Sequence[float]) -> tuple[str, float]:
        # The heights of `points`, without the rest of them: this takes most of the time of a check.
        self._finite(angles)
        k = self.links
        _, t1, t2, t3, t4, _ = angles
        p = t2 - k.offset
        elbow = k.e + k.a * math.sin(t1)
        wrist = elbow + k.h * math.cos(p) - k.c * math.sin(p)
        upward = math.cos(p) * math.cos(_NEUTRAL - t3) * math.cos(t4) - math.sin(p) * math.sin(t4)
        tool = wrist + k.f * upward
        if elbow <= min(wrist, tool):
            return "elbow", elbow
        return ("wrist", wrist) if wrist <= tool else ("tool", tool)

    def tool_down(self, position: Vector, angles: Sequence[float]) -> Matrix:
        # With the roll neutral R = Rz(t0) Ry(p + t4) Rz(-t5); down is p + t4 = 180 deg, and t5 stays.
        heading = math.atan2(position[1], position[0])
        return multiply(rotation_z(heading), rotation_y(math.pi), rotation_z(-angles[5]))

    def carried(self, position: Vector, angles: Sequence[float]) -> Matrix:
        # The tool turns with the base and keeps its angle to the arm's plane. The direction of the base depends on
        # the wrist, and the wrist on the tool: a few iterations converge, since the tool is short.
        first = self.rotation(angles)
        turned = first
        for _ in range(30):
            wrist = shifted(position, column(turned, 2), -self.links.f)
            turned = multiply(rotation_z(math.atan2(wrist[1], wrist[0]) - angles[0]), first)
        return turned

    def coupling_excess(self, angles: Sequence[float]) -> float:
        k = self.links
        elbow = self._elbow(angles[1], angles[2])
        excess = max(0.0, k.elbow[0] - elbow, elbow - k.elbow[1])
        if k.elevation is not None:
            excess = max(excess, k.elevation.elevation(angles[1], elbow) - k.elevation.maximum)
        return excess if excess > 1e-9 else 0.0

    def jacobian(self, angles: Sequence[float]) -> tuple[tuple[float, ...], ...]:
        self._finite(angles)
        k = self.links
        t0, t1, t2, t3, t4, _ = angles
        p = t2 - k.offset
        ahead = math.cos(t0), math.sin(t0)
        tip = self.forward(angles).position
        wrist = self.wrist(angles)
        tool = shifted(tip, wrist, -1.0)
        to_forearm = multiply(rotation_z(t0), rotation_y(p))
        rolled = multiply(to_forearm, rotation_x(_NEUTRAL - t3))
        pitch_axis = column(to_forearm, 1)
        # Rotation axes; t1 turns only the upper arm.
        axes: list[Vector] = [
            (0.0, 0.0, 1.0),
            (0.0, 0.0, 0.0),
            pitch_axis,
            _times(column(to_forearm, 0), -1.0),
            column(rolled, 1),
            _times(apply(multiply(rolled, rotation_y(t4)), (0.0, 0.0, 1.0)), -1.0),
        ]
        upper = (-k.a * math.sin(t1) * ahead[0], -k.a * math.sin(t1) * ahead[1], k.a * math.cos(t1))
        moves = [
            cross(axes[0], tip),
            upper,
            cross(pitch_axis, shifted(tip, self.elbow(angles), -1.0)),
            cross(axes[3], tool),
            cross(axes[4], tool),
            cross(axes[5], tool),
        ]
        return tuple(tuple(v[i] for v in part) for part in (moves, axes) for i in range(3))

    def singularity(self, angles: Sequence[float]) -> Singularity:
        self._finite(angles)
        k = self.links
        wrist = self.wrist(angles)
        from_axis = math.hypot(wrist[0], wrist[1])
        bend = abs(math.sin(k.elbow_angle(angles[1], angles[2]) + k.forearm_angle))
        # Roll and t5 are on one line if the tool is parallel to the forearm.
        wrist_bend = abs(math.cos(angles[4]))
        return Singularity(
            {"base axis": min(1.0, from_axis / k.reach[1]), "elbow": bend, "wrist": wrist_bend},
            from_axis * k.a * k.forearm * bend * wrist_bend,
        )


def _times(v: Vector, k: float) -> Vector:
    return (v[0] * k, v[1] * k, v[2] * k)
