"""`PUMA260` and `Puma260Model`: the arm's joints, encoders and limits, and its kinematics in closed form.

Owns the constants of joints and encoders and where each comes from. Angles are radians about the zero pose in which
the forearm hangs down: axes z, y, y, z, y, x, between them the links of `links`. Another laboratory's model
has its zero with the forearm up. Knows no wire.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from hexwire.errors import UsageError
from hexwire.model.arm import ArmModel, JointModel
from hexwire.model.arms.puma260.links import DROP, FLANGE, FOREARM, SHOULDER, SIDE, UPPER
from hexwire.model.batch import puma260_forward_many, puma260_inverse_many
from hexwire.model.kinematics import (
    NEAR_SINGULAR,
    ONE_LINE,
    SINGULAR,
    JointRange,
    KinematicModel,
    Reach,
    Singularity,
    Solution,
)
from hexwire.model.pose import (
    Matrix,
    Pose,
    Vector,
    column,
    cross,
    multiply,
    rotation_x,
    rotation_y,
    rotation_z,
    shifted,
    transpose,
)

__all__ = ["PUMA260", "Puma260Model", "angles_to_counts", "counts_to_angles"]

# Degrees; the same source as the model.
_LIMITS = ((-5, 313), (-256, 76), (-214, 34), (-384, 194), (-32, 212), (-267, 267))

# Encoder counts per turn of the motor, and gear ratio with its sign: constants of a YARP robot whose measured
# ranges match this arm. They must be checked on the real arm.
_ENCODERS = ((1000, -46.72), (1000, 69.9733), (1000, -42.9867), (800, 43.5111), (800, 39.3846), (800, 31.7692))
# Turns of motor 5 per turn of joint 4, and of motor 6 per turn of joints 4 and 5, from the same source: the wrist's
# shafts are concentric.
_WRIST_5_4 = -9.8462 * 800 / math.tau
_WRIST_6_4 = 800 / math.tau
_WRIST_6_5 = -5.59999 * 800 / math.tau

# The laboratory that uses this arm limits it to 5 degrees every 100 ms.
_MAX_SPEED = math.radians(50.0)


def _joint(i: int) -> JointModel:
    turn, gear = _ENCODERS[i]
    low, high = _LIMITS[i]
    return JointModel(
        name=f"J{i + 1}",
        servo_id=i,
        series="encoder",
        neutral=0,
        sign=1 if gear > 0 else -1,
        offset=0.0,
        scale=math.tau / (turn * abs(gear)),
        minimum=math.radians(low),
        maximum=math.radians(high),
        max_speed=_MAX_SPEED,
    )


PUMA260 = ArmModel("puma260", tuple(_joint(i) for i in range(6)))
"""The PUMA 260. Encoders 5 and 6 also turn with joints 4 and 5: use `counts_to_angles`, not single joints."""


def counts_to_angles(counts: Sequence[float]) -> tuple[float, ...]:
    """Joint angles in radians of six encoder counts, with the wrist coupling removed.

    Raises:
        UsageError: There are not six counts.
    """
    if len(counts) != len(PUMA260.joints):
        raise UsageError(f"puma260 has {len(PUMA260.joints)} encoders, got {len(counts)} counts")
    first = [joint.counts_to_angle(n) for joint, n in zip(PUMA260.joints[:4], counts, strict=False)]
    j4 = first[3]
    j5 = PUMA260.joints[4].counts_to_angle(counts[4] - j4 * _WRIST_5_4)
    j6 = PUMA260.joints[5].counts_to_angle(counts[5] - j4 * _WRIST_6_4 - j5 * _WRIST_6_5)
    return (*first, j5, j6)


def angles_to_counts(angles: Sequence[float]) -> tuple[int, ...]:
    """Nearest encoder counts of six joint angles in radians, including the wrist coupling.

    Raises:
        UsageError: There are not six angles.
    """
    if len(angles) != len(PUMA260.joints):
        raise UsageError(f"puma260 has {len(PUMA260.joints)} joints, got {len(angles)} angles")
    own = [joint.sign * angle / joint.scale for joint, angle in zip(PUMA260.joints, angles, strict=True)]
    own[4] += angles[3] * _WRIST_5_4
    own[5] += angles[3] * _WRIST_6_4 + angles[4] * _WRIST_6_5
    return tuple(round(n) for n in own)


class Puma260Model(KinematicModel):
    """Kinematics of the PUMA 260. `forward` gives the flange."""

    name = "puma260"

    def __init__(self) -> None:
        self.ranges = tuple(JointRange(j.name, j.minimum, j.maximum) for j in PUMA260.joints)

    def wrist(self, angles: Sequence[float]) -> Vector:
        """Wrist centre of at least three joint angles, metres."""
        q1, q2, q3 = angles[:3]
        ahead = UPPER * math.cos(q2) + DROP * math.sin(q2) - FOREARM * math.sin(q2 + q3)
        up = SHOULDER - UPPER * math.sin(q2) + DROP * math.cos(q2) - FOREARM * math.cos(q2 + q3)
        c, s = math.cos(q1), math.sin(q1)
        return (c * ahead - s * SIDE, s * ahead + c * SIDE, up)

    def forward(self, angles: Sequence[float]) -> Pose:
        self._finite(angles)
        q1, q2, q3, q4, q5, q6 = angles
        rotation = multiply(rotation_z(q1), rotation_y(q2 + q3), rotation_z(q4), rotation_y(q5), rotation_x(q6))
        return Pose(shifted(self.wrist(angles), column(rotation, 0), FLANGE), rotation)

    def forward_many(self, angles: Sequence[Sequence[float]]) -> tuple[Any, Any]:
        return puma260_forward_many(self, angles)

    def inverse(self, pose: Pose) -> tuple[Solution, ...]:
        solutions = []
        for arm_angles, branch in self._arm_branches(self._wrist_of(pose)):
            for wrist_angles, wrist, singular in self._wrist_branches(arm_angles, pose.rotation):
                angles = (*arm_angles, *wrist_angles)
                turned = tuple(r.nearest_turn(q) for r, q in zip(self.ranges, angles, strict=True))
                free = (0.0, 0.0, 0.0, 1.0, 0.0, math.copysign(1.0, wrist_angles[1])) if wrist == ONE_LINE else ()
                found = self.violations(turned)
                solutions.append(Solution(turned, f"{branch}, {wrist}", found, singular, free))
        return self._sorted(solutions)

    def inverse_many(self, positions: Any, rotations: Any) -> Any:
        return puma260_inverse_many(self, positions, rotations)

    def _wrist_of(self, pose: Pose) -> Vector:
        return shifted(pose.position, column(pose.rotation, 0), -FLANGE)

    def _arm_branches(self, wrist: Vector) -> list[tuple[tuple[float, float, float], str]]:
        x, y, z = wrist
        square = x * x + y * y - SIDE * SIDE
        if square < -1e-15:
            return []
        up, away = z - SHOULDER, math.sqrt(max(0.0, square))
        upper, lean = math.hypot(UPPER, DROP), math.atan2(DROP, UPPER)
        cos_elbow = (upper**2 + FOREARM**2 - (away * away + up * up)) / (2 * upper * FOREARM)
        if abs(cos_elbow) > 1.0 + 1e-12:
            return []
        # Interior angles of the triangle of shoulder, elbow and wrist: at the elbow and at the shoulder.
        elbow = math.acos(max(-1.0, min(1.0, cos_elbow)))
        inner = math.atan2(FOREARM * math.sin(elbow), upper - FOREARM * math.cos(elbow))
        found = []
        for ahead, facing in ((away, "right"), (-away, "left")):
            q1 = math.atan2(y, x) - math.atan2(SIDE, ahead)
            for bent, bend in ((1.0, "elbow up"), (-1.0, "elbow down")):
                # Elevation of the upper arm, then of the forearm.
                raised = math.atan2(up, ahead) + bent * inner
                forearm = raised - bent * (math.pi - elbow)
                # Turning about y takes x towards -z.
                q2 = lean - raised
                # At q2 + q3 = 0 the forearm points to -z, an elevation of -90 deg.
                q3 = -math.pi / 2 - forearm - q2
                found.append(((q1, q2, q3), f"{facing}, {bend}"))
        return found

    def _wrist_branches(
        self, arm_angles: Sequence[float], rotation: Matrix
    ) -> list[tuple[tuple[float, float, float], str, bool]]:
        q1, q2, q3 = arm_angles
        m = multiply(transpose(multiply(rotation_z(q1), rotation_y(q2 + q3))), rotation)
        # m = Rz(q4) Ry(q5) Rx(q6)
        level = math.hypot(m[0][0], m[1][0])
        if level < SINGULAR:
            q5 = math.copysign(math.pi / 2, -m[2][0])
            # q4 and q6 turn about one line: q4 stays at zero.
            return [((0.0, q5, math.atan2(-m[1][2], m[1][1])), ONE_LINE, True)]
        found = []
        for sign, wrist in ((1.0, "wrist 1"), (-1.0, "wrist 2")):
            q5 = math.atan2(-m[2][0], sign * level)
            q4 = math.atan2(sign * m[1][0], sign * m[0][0])
            q6 = math.atan2(sign * m[2][1], sign * m[2][2])
            found.append(((q4, q5, q6), wrist, level < NEAR_SINGULAR))
        return found

    def reach(self, pose: Pose) -> Reach:
        x, y, z = self._wrist_of(pose)
        from_axis = math.hypot(x, y)
        if from_axis < abs(SIDE) - 1e-15:
            short = abs(SIDE) - from_axis
            cause = (
                f"the wrist would be {1e3 * from_axis:.1f} mm from the base axis, {1e3 * short:.1f} mm inside the "
                f"{1e3 * abs(SIDE):.1f} mm that the shoulder is set aside"
            )
            return Reach(False, short, cause)
        line = math.hypot(math.sqrt(max(0.0, from_axis**2 - SIDE**2)), z - SHOULDER)
        upper = math.hypot(UPPER, DROP)
        low, high = abs(upper - FOREARM), upper + FOREARM
        text = f"the wrist would be {1e3 * line:.1f} mm from the shoulder, "
        if line > high + 1e-12:
            text += f"{1e3 * (line - high):.1f} mm beyond the {1e3 * high:.1f} mm that upper arm and forearm reach"
            return Reach(False, line - high, text)
        if line < low - 1e-12:
            text += f"{1e3 * (low - line):.1f} mm less than the {1e3 * low:.1f} mm of the folded arm"
            return Reach(False, low - line, text)
        return Reach(True, 0.0, "")

    def points(self, angles: Sequence[float]) -> Mapping[str, Vector]:
        wrist = self.wrist(angles)
        forearm = column(multiply(rotation_z(angles[0]), rotation_y(angles[1] + angles[2])), 2)
        return {
            "elbow": shifted(wrist, forearm, FOREARM),
            "wrist": wrist,
            "tool": self.forward(angles).position,
        }

    def tool_down(self, position: Vector, angles: Sequence[float]) -> Matrix:
        # The tool is the x axis; its turn about the vertical is that of the base.
        return multiply(rotation_z(angles[0]), rotation_y(math.pi / 2))

    def jacobian(self, angles: Sequence[float]) -> tuple[tuple[float, ...], ...]:
        pose = self.forward(angles)
        q1, q2, q3, q4, q5, _ = angles
        base = rotation_z(q1)
        pitched = multiply(base, rotation_y(q2 + q3))
        turned = multiply(pitched, rotation_z(q4))
        sideways = column(base, 1)
        axes = [
            (0.0, 0.0, 1.0),
            sideways,
            sideways,
            column(pitched, 2),
            column(turned, 1),
            column(multiply(turned, rotation_y(q5)), 0),
        ]
        wrist = self.wrist(angles)
        elbow = shifted(wrist, column(pitched, 2), FOREARM)
        pivots: list[Vector] = [(0.0, 0.0, 0.0), (0.0, 0.0, SHOULDER), elbow, wrist, wrist, wrist]
        moves = [cross(axis, shifted(pose.position, pivot, -1.0)) for axis, pivot in zip(axes, pivots, strict=True)]
        return tuple(tuple(v[i] for v in part) for part in (moves, axes) for i in range(3))

    def singularity(self, angles: Sequence[float]) -> Singularity:
        self._finite(angles)
        _, q2, q3, _, q5, _ = angles
        upper = math.hypot(UPPER, DROP)
        ahead = UPPER * math.cos(q2) + DROP * math.sin(q2) - FOREARM * math.sin(q2 + q3)
        lean = math.atan2(DROP, UPPER)
        bend = abs(math.cos(q3 + lean))
        wrist_bend = abs(math.cos(q5))
        return Singularity(
            {"shoulder": min(1.0, abs(ahead) / (upper + FOREARM)), "elbow": bend, "wrist": wrist_bend},
            abs(ahead) * upper * FOREARM * bend * wrist_bend,
        )
