"""`SoArmModel`: kinematics of the SO-100 and the SO-101, five joints, closed form, all branches.

Owns the geometry. Angles are the driver's joint angles in radians, as in LeRobot after its calibration: zero is the
middle of each range, the upper arm upright, the forearm and the tool level and ahead. Positive angles turn the base
to the right, bend shoulder, elbow and wrist down, and turn the tool counter-clockwise as seen from behind. Must not
know counts, nor the gripper, which does not move the tool's frame.

Five joints reach a position, a pitch, which is the sum of the three bends, and a roll, which is wrist_roll; the
heading follows from the position. With heading h = -shoulder_pan and pitch p:
orientation R = Rz(h) Ry(p + 90 deg) Rz(twist - wrist_roll); the third column of R points along the tool.
The tip is beside the roll axis, so the roll moves it; `_plane` takes this out before the arm is solved.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from hexwire.errors import UsageError
from hexwire.model.arm import ArmModel
from hexwire.model.arms.so_arm.links import SO_ARMS, SoArmLinks
from hexwire.model.kinematics import JointRange, KinematicModel, Reach, Singularity, Solution, numpy_or_none, wrap
from hexwire.model.pose import (
    Matrix,
    Pose,
    Vector,
    apply,
    column,
    cross,
    multiply,
    rotation_y,
    rotation_z,
    transpose,
)

__all__ = ["SoArmModel"]

_BRANCHES = 4
_SAME = 1e-12
_ROUNDS = 50
"""Most corrections of a heading; a few suffice unless the tip is next to the base axis."""


class SoArmModel(KinematicModel):
    """Kinematics of one arm. `forward` gives the tip of the fixed jaw, with z along the tool.

    A pose is reached in position and pitch. Its heading is not free: `inverse` takes the heading that the position
    needs, with the roll that keeps the tool as close to the pose's orientation as possible. A tool that points
    straight down, and every pose of `forward`, is kept exactly.

    Any finite angles have a pose, and any finite pose has solutions or is out of reach. Other numbers are
    refused by `UsageError`.

    Args:
        links: The links; those of the SO-101 if None.
    """

    def __init__(self, links: SoArmLinks | None = None) -> None:
        self.links = links or SO_ARMS["so101"]
        self.name = self.links.name
        self.ranges = self.links.ranges

    def for_arm(self, arm: ArmModel) -> SoArmModel:
        narrow = SoArmModel(self.links)
        joints = [arm.joint(r.name) for r in self.ranges]
        # An arm's own limits, which its calibration found, replace those of the published model.
        narrow.ranges = tuple(JointRange(joint.name, joint.minimum, joint.maximum) for joint in joints)
        return narrow

    # -- forward ------------------------------------------------------------------------------------

    def forward(self, angles: Sequence[float]) -> Pose:
        self._finite(angles)
        rho, side, z = self._tip(angles)
        return Pose(self._place(angles[0], rho, side, z), self.rotation(angles))

    def rotation(self, angles: Sequence[float]) -> Matrix:
        """Orientation of the tool."""
        return self._rotation(-angles[0], self.pitch(angles), angles[4])

    def pitch(self, angles: Sequence[float]) -> float:
        """Pitch of the tool, radians: 0 is level and ahead, a quarter turn is straight down."""
        return _sum(angles[1:4])

    def wrist(self, angles: Sequence[float]) -> Vector:
        """The wrist_flex axis, in the plane of the roll axis, metres."""
        rho, z = self._wrist(angles)
        return self._place(angles[0], rho, self.links.side, z)

    def elbow(self, angles: Sequence[float]) -> Vector:
        """The elbow_flex axis, in the plane of the roll axis, metres."""
        rho, z = _plus(self.links.shoulder, _bent(self.links.upper, angles[1]))
        return self._place(angles[0], rho, self.links.side, z)

    def _wrist(self, angles: Sequence[float]) -> tuple[float, float]:
        k = self.links
        elbow = _plus(k.shoulder, _bent(k.upper, angles[1]))
        return _plus(elbow, _bent(k.forearm, _sum(angles[1:3])))

    def _tip(self, angles: Sequence[float]) -> tuple[float, float, float]:
        """Ahead of the pan axis, to its left, and up."""
        hand, side = self._tool(angles[4])
        rho, z = _plus(self._wrist(angles), _bent(hand, self.pitch(angles)))
        return rho, side, z

    def _tool(self, roll: float) -> tuple[tuple[float, float], float]:
        """The tip from the wrist at a roll: ahead and up with a level tool, and to the left of the pan axis."""
        k = self.links
        turn = roll - k.twist
        ahead, below, left = k.tip
        up = -below * math.cos(turn) - left * math.sin(turn)
        return (k.hand + ahead, up), k.side - below * math.sin(turn) + left * math.cos(turn)

    def _place(self, pan: float, rho: float, side: float, z: float) -> Vector:
        c, s = math.cos(pan), math.sin(pan)
        return (self.links.pan[0] + c * rho + s * side, c * side - s * rho, z)

    def _rotation(self, heading: float, pitch: float, roll: float) -> Matrix:
        return multiply(rotation_z(heading), rotation_y(pitch + math.pi / 2), rotation_z(self.links.twist - roll))

    def forward_many(self, angles: Sequence[Sequence[float]]) -> tuple[Any, Any]:
        poses = [self.forward([float(a) for a in row]) for row in angles]
        table = [list(p.position) for p in poses], [[list(row) for row in p.rotation] for p in poses]
        np = numpy_or_none()
        return table if np is None else (np.array(table[0]).reshape(-1, 3), np.array(table[1]).reshape(-1, 3, 3))

    # -- inverse ------------------------------------------------------------------------------------

    def inverse(self, pose: Pose) -> tuple[Solution, ...]:
        solutions = []
        for facing, heading, pitch, roll in self._planes(pose):
            for bends, bend in self._bends(self._wrist_of(pose, heading, pitch, roll)):
                angles = (-heading, *bends, pitch - bends[0] - bends[1], roll)
                turned = tuple(r.nearest_turn(a) for r, a in zip(self.ranges, angles, strict=True))
                solutions.append(Solution(turned, f"{facing}, {bend}", self.violations(turned)))
        return self._sorted(solutions)

    def inverse_many(self, positions: Any, rotations: Any) -> Any:
        table = []
        for place, rows in zip(positions, rotations, strict=True):
            x, y, z = (float(v) for v in place)
            a, b, c = (tuple(float(v) for v in row) for row in rows)
            found = self.inverse(Pose((x, y, z), (a, b, c)))  # type: ignore[arg-type]  # three each
            lines = [[math.remainder(angle, math.tau) for angle in s.angles] for s in found]
            table.append(lines + [[math.nan] * 5] * (_BRANCHES - len(lines)))
        np = numpy_or_none()
        return table if np is None else np.array(table, float).reshape(-1, _BRANCHES, 5)

    def _planes(self, pose: Pose) -> list[tuple[str, float, float, float]]:
        """Facing, heading, pitch and roll of the arm's plane: in front of the base axis, and behind it."""
        _check(pose)
        found: list[tuple[str, float, float, float]] = []
        for facing, side in (("front", 1.0), ("back", -1.0)):
            plane = self._plane(pose, side)
            # From far off, both may end in the same plane.
            if plane is not None and all(abs(wrap(plane[0] - other)) > 1e-9 for _, other, _, _ in found):
                found.append((facing, *plane))
        return found

    def _plane(self, pose: Pose, facing: float) -> tuple[float, float, float] | None:
        k = self.links
        # The heading if the arm can take the pose's orientation; otherwise an estimate, which is corrected.
        ahead, below, left = k.tip
        x, y, _ = apply(pose.rotation, (below, left, k.hand + ahead))
        x, y = pose.position[0] - k.pan[0] - x, pose.position[1] - y
        heading = _turned(x, y, k.side, facing * math.sqrt(max(0.0, x * x + y * y - k.side * k.side)))
        pitch, roll = self._aim(pose.rotation, heading)
        if _differ(self._rotation(heading, pitch, roll), pose.rotation) < _SAME:
            return heading, pitch, roll
        for _ in range(_ROUNDS):
            last, found = heading, self._heading(pose.position, roll, heading)
            if found is None:
                return None
            if abs(wrap(found - last)) < _SAME:
                break
            heading = found
            pitch, roll = self._aim(pose.rotation, heading)
        # Whether or not it has settled: with this roll, the tip is where it is to be.
        found = self._heading(pose.position, roll, heading)
        return None if found is None else (found, pitch, roll)

    def _heading(self, position: Vector, roll: float, near: float) -> float | None:
        """The heading that brings the tip to a position, of the two the one that is closer to `near`."""
        side = self._tool(roll)[1]
        x, y = position[0] - self.links.pan[0], position[1]
        square = x * x + y * y - side * side
        if square < 0.0:
            return None
        return _turned(x, y, side, math.copysign(math.sqrt(square), x * math.cos(near) + y * math.sin(near)))

    def _aim(self, rotation: Matrix, heading: float) -> tuple[float, float]:
        """Pitch of an orientation, and the roll that comes closest to it at a heading."""
        x, y, z = column(rotation, 2)
        ahead = math.copysign(math.hypot(x, y), x * math.cos(heading) + y * math.sin(heading))
        pitch = math.atan2(-z, ahead)
        m = multiply(transpose(multiply(rotation_z(heading), rotation_y(pitch + math.pi / 2))), rotation)
        return pitch, self.links.twist - math.atan2(m[1][0] - m[0][1], m[0][0] + m[1][1])

    def _wrist_of(self, pose: Pose, heading: float, pitch: float, roll: float) -> tuple[float, float]:
        """The wrist from the shoulder_lift axis: ahead and up."""
        k = self.links
        x, y, z = pose.position
        rho = (x - k.pan[0]) * math.cos(heading) + y * math.sin(heading)
        ahead, up = _bent(self._tool(roll)[0], pitch)
        return rho - ahead - k.shoulder[0], z - up - k.shoulder[1]

    def _bends(self, wrist: tuple[float, float]) -> list[tuple[tuple[float, float], str]]:
        k = self.links
        upper, forearm = k.lengths
        line = math.hypot(*wrist)
        low, high = k.reach
        # The two lengths differ, so that the wrist is never at the shoulder.
        if not low - 1e-12 <= line <= high + 1e-12:
            return []
        cos_elbow = (upper**2 + forearm**2 - line**2) / (2 * upper * forearm)
        cos_shoulder = (upper**2 + line**2 - forearm**2) / (2 * upper * line)
        inner = math.acos(max(-1.0, min(1.0, cos_elbow)))
        shoulder = math.acos(max(-1.0, min(1.0, cos_shoulder)))
        found = []
        for side, bend in ((1.0, "elbow up"), (-1.0, "elbow down")):
            # Elevations of upper arm and forearm; a joint that bends down lowers them.
            raised = math.atan2(wrist[1], wrist[0]) + side * shoulder
            lift = math.atan2(k.upper[1], k.upper[0]) - raised
            elbow = math.atan2(k.forearm[1], k.forearm[0]) - (raised - side * (math.pi - inner)) - lift
            found.append(((lift, elbow), bend))
        return found

    # -- reports ------------------------------------------------------------------------------------

    def reach(self, pose: Pose) -> Reach:
        low, high = self.links.reach
        reports = []
        for _, heading, pitch, roll in self._planes(pose):
            line = math.hypot(*self._wrist_of(pose, heading, pitch, roll))
            if low - 1e-12 <= line <= high + 1e-12:
                return Reach(True, 0.0, "")
            off, cause = low - line, f"less than the {1e3 * low:.1f} mm of the folded arm"
            if line > high:
                off, cause = line - high, f"beyond the {1e3 * high:.1f} mm that upper arm and forearm reach"
            text = f"the wrist would be {1e3 * line:.1f} mm from the shoulder, {1e3 * off:.1f} mm {cause}"
            reports.append((off, text))
        if not reports:
            away = math.hypot(pose.position[0] - self.links.pan[0], pose.position[1])
            aside = math.hypot(*self.links.tip[1:]) + abs(self.links.side)
            cause = f"the tip would be {1e3 * away:.1f} mm from the base axis, but the roll sets it aside by more"
            return Reach(False, aside - away, cause)
        return Reach(False, *min(reports))

    def points(self, angles: Sequence[float]) -> Mapping[str, Vector]:
        return {
            "elbow": self.elbow(angles),
            "wrist": self.wrist(angles),
            "tool": self.forward(angles).position,
        }

    def lowest(self, angles: Sequence[float]) -> tuple[str, float]:
        # The heights of `points`, each link bent once.
        self._finite(angles)
        k, bend, least, lowest = self.links, 0.0, math.inf, ""
        height, hand = k.shoulder[1], self._tool(angles[4])[0]
        for name, link, angle in (
            ("elbow", k.upper, angles[1]),
            ("wrist", k.forearm, angles[2]),
            ("tool", hand, angles[3]),
        ):
            bend += angle if -1e3 < angle < 1e3 else math.remainder(angle, math.tau)
            height += link[1] * math.cos(bend) - link[0] * math.sin(bend)
            if height < least:
                least, lowest = height, name
        return lowest, least

    @property
    def levers(self) -> Mapping[str, float]:
        k = self.links
        ahead, *aside = k.tip
        hand = math.hypot(k.hand + ahead, *aside)
        forearm = hand + math.hypot(*k.forearm)
        most = (0.0, forearm + math.hypot(*k.upper), forearm, hand, math.hypot(*aside))
        return {r.name: lever for r, lever in zip(self.ranges, most, strict=True)}

    def aimed(self, position: Vector, pitch: float, roll: float, angles: Sequence[float]) -> Matrix:
        # The arm keeps facing as it does now.
        ahead = math.copysign(1.0, self._tip(angles)[0])
        side = self._tool(roll)[1]
        x, y = position[0] - self.links.pan[0], position[1]
        away = math.sqrt(max(0.0, x * x + y * y - side * side))
        return self._rotation(_turned(x, y, side, ahead * away), pitch, roll)

    def pitch_and_roll(self, angles: Sequence[float]) -> tuple[float, float]:
        return self.pitch(angles), angles[4]

    def tool_down(self, position: Vector, angles: Sequence[float]) -> Matrix:
        return self.aimed(position, math.pi / 2, angles[4], angles)

    def carried(self, position: Vector, angles: Sequence[float]) -> Matrix:
        return self.aimed(position, self.pitch(angles), angles[4], angles)

    def jacobian(self, angles: Sequence[float]) -> tuple[tuple[float, ...], ...]:
        pose = self.forward(angles)
        left: Vector = (math.sin(angles[0]), math.cos(angles[0]), 0.0)
        x, y, z = column(pose.rotation, 2)
        axes: list[Vector] = [(0.0, 0.0, -1.0), left, left, left, (-x, -y, -z)]
        wrist = self.wrist(angles)
        pan = (self.links.pan[0], 0.0, 0.0)
        lift = self._place(angles[0], self.links.shoulder[0], self.links.side, self.links.shoulder[1])
        pivots: list[Vector] = [pan, lift, self.elbow(angles), wrist, wrist]
        moves = [
            cross(axis, [a - b for a, b in zip(pose.position, pivot, strict=True)])
            for axis, pivot in zip(axes, pivots, strict=True)
        ]
        return tuple(tuple(v[i] for v in part) for part in (moves, axes) for i in range(3))

    def singularity(self, angles: Sequence[float]) -> Singularity:
        self._finite(angles)
        k = self.links
        rho = abs(self._tip(angles)[0])
        upper, forearm = k.lengths
        straight = math.atan2(*k.upper[::-1]) - math.atan2(*k.forearm[::-1]) + angles[2]
        bend = abs(math.sin(straight))
        return Singularity({"base axis": min(1.0, rho / k.reach[1]), "elbow": bend}, rho * upper * forearm * bend)


def _sum(angles: Sequence[float]) -> float:
    """Sum of angles. Whole turns are left out, since the sum of huge angles is not finite."""
    return sum([a if -1e3 < a < 1e3 else math.remainder(a, math.tau) for a in angles])


def _plus(a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float]:
    return a[0] + b[0], a[1] + b[1]


def _bent(link: tuple[float, float], down: float) -> tuple[float, float]:
    """A link, ahead and up, after it was bent down by an angle."""
    c, s = math.cos(down), math.sin(down)
    return link[0] * c + link[1] * s, link[1] * c - link[0] * s


def _turned(x: float, y: float, side: float, ahead: float) -> float:
    """The heading with which a point `ahead` and to the `side` of the pan axis is at x, y."""
    return math.atan2(y, x) - math.atan2(side, ahead)


def _differ(a: Matrix, b: Matrix) -> float:
    return max(abs(x - y) for row, other in zip(a, b, strict=True) for x, y in zip(row, other, strict=True))


def _check(pose: Pose) -> None:
    if not all(map(math.isfinite, (*pose.position, *(v for row in pose.rotation for v in row)))):
        raise UsageError("the pose has a number that is not finite")
