"""The interface of every arm's kinematics: forward, inverse, reach, Jacobian and singularities.

Owns the shared values and the parts that are the same for all arms. Knows no particular arm; angles are radians,
lengths metres.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from hexwire.errors import LimitError, UsageError
from hexwire.units import decimal

from .pose import Matrix, Pose, Vector

if TYPE_CHECKING:
    from .arm import ArmModel

__all__ = ["JointRange", "KinematicModel", "Reach", "Singularity", "Solution", "numpy_or_none", "wrap"]

ONE_LINE = "wrist singular"
"""Branch name of a wrist in which two joints turn about one line."""


@dataclass(frozen=True, slots=True)
class JointRange:
    """Limits of one joint.

    Attributes:
        name: Name in messages.
        minimum: Radians.
        maximum: Radians.
    """

    name: str
    minimum: float
    maximum: float

    def excess(self, angle: float) -> float:
        """How far an angle is outside: negative below, positive above, 0 inside; radians."""
        if angle < self.minimum - _GRACE:
            return angle - self.minimum
        if angle > self.maximum + _GRACE:
            return angle - self.maximum
        return 0.0

    def nearest_turn(self, angle: float) -> float:
        """The angle plus whole turns, so that it is inside the limits or as close to them as possible."""
        turned = wrap(angle, 0.5 * (self.minimum + self.maximum))
        return min(
            (turned, turned - math.tau, turned + math.tau), key=lambda a: (abs(self.excess(a)), abs(a - turned))
        )


_GRACE = 1e-9
"""Tolerance for rounding, radians."""
SINGULAR = 1e-12
"""Sine between two joint axes below which they are one line."""
NEAR_SINGULAR = 1e-6
"""Below this, the split between the two joints is mostly rounding, although the pose is correct."""


def wrap(angle: float, centre: float = 0.0) -> float:
    """The angle plus whole turns, within half a turn of `centre`, radians."""
    return centre + math.remainder(angle - centre, math.tau)


@dataclass(frozen=True, slots=True)
class Solution:
    """One solution of the inverse kinematics.

    Attributes:
        angles: Joint angles, radians.
        branch: Description of the branch, such as ``front, elbow up, wrist 1``.
        violations: Descriptions of violated limits; empty if there are none.
        singular: Two joints turn about one line here, so the split of the turn between them is arbitrary.
        free: Change of the joints that does not change the pose, if they are exactly on one line; otherwise empty.
    """

    angles: tuple[float, ...]
    branch: str
    violations: tuple[str, ...] = ()
    singular: bool = False
    free: tuple[float, ...] = ()

    def slid(self, near: Sequence[float]) -> tuple[float, ...]:
        """The angles for the same pose that are nearest to `near`: on a singular wrist there is a choice."""
        if not self.free:
            return self.angles
        apart = [b - a for a, b in zip(self.angles, near, strict=True)]
        share = sum(f * d for f, d in zip(self.free, apart, strict=True)) / sum(f * f for f in self.free)
        return tuple(a + share * f for a, f in zip(self.angles, self.free, strict=True))

    @property
    def allowed(self) -> bool:
        """Whether no limit is violated."""
        return not self.violations

    def distance(self, angles: Sequence[float]) -> float:
        """Largest turn of a joint from `angles` to this solution, radians."""
        return max(abs(a - b) for a, b in zip(self.angles, angles, strict=True))


@dataclass(frozen=True, slots=True)
class Reach:
    """Whether the links can reach a position.

    Attributes:
        reachable: Whether they can, regardless of joint limits.
        excess: Missing distance in metres; 0 if reachable.
        cause: Description of the cause; empty if reachable.
    """

    reachable: bool
    excess: float
    cause: str


@dataclass(frozen=True, slots=True)
class Singularity:
    """How close a pose is to a singularity, where the arm cannot move in some direction.

    Attributes:
        measures: By name of the kind of singularity: 0 is singular, 1 is as far away as possible.
        manipulability: Absolute determinant of the Jacobian, metres cubed; of position, pitch and
            roll for an arm of five joints.
        near: Names of the measures below a twentieth.
    """

    measures: Mapping[str, float]
    manipulability: float

    @property
    def near(self) -> tuple[str, ...]:
        """Names of the singularities that are close."""
        return tuple(name for name, value in self.measures.items() if value < _NEAR)


_NEAR = 0.05


class KinematicModel(ABC):
    """Kinematics of one arm.

    Attributes:
        name: Name, such as ``hex7bot``.
        ranges: Limits of the joints in order.
    """

    name: str
    ranges: tuple[JointRange, ...]

    @abstractmethod
    def forward(self, angles: Sequence[float]) -> Pose:
        """Pose of the tool tip at joint angles.

        Raises:
            UsageError: The angles are not one finite number for each joint.
        """

    @abstractmethod
    def inverse(self, pose: Pose) -> tuple[Solution, ...]:
        """All solutions for a pose of the tool tip, regardless of limits; those within the limits come first.

        Empty if the links cannot reach the pose: `reach` gives the cause.
        """

    @abstractmethod
    def reach(self, pose: Pose) -> Reach:
        """Whether the links reach a pose of the tool tip; if not, the missing distance and the cause."""

    @abstractmethod
    def jacobian(self, angles: Sequence[float]) -> tuple[tuple[float, ...], ...]:
        """Six rows: velocity of the tip x, y, z (m/s), then turning rate x, y, z (rad/s), per joint speed."""

    @abstractmethod
    def singularity(self, angles: Sequence[float]) -> Singularity:
        """How close joint angles are to a singularity."""

    @abstractmethod
    def forward_many(self, angles: Sequence[Sequence[float]]) -> tuple[Any, Any]:
        """Positions (N, 3) and rotations (N, 3, 3) of the tip: arrays with numpy, otherwise nested lists."""

    @abstractmethod
    def inverse_many(self, positions: Any, rotations: Any) -> Any:
        """Joint angles (N, branches, joints), within half a turn; NaN if the links do not reach.

        An array with numpy, otherwise nested lists.
        """

    @abstractmethod
    def points(self, angles: Sequence[float]) -> Mapping[str, Vector]:
        """Points of the arm that may hit the table, by name, metres."""

    def lowest(self, angles: Sequence[float]) -> tuple[str, float]:
        """Name and height of the lowest of these points, metres; every set-point is checked with it."""
        points = self.points(angles)
        name = min(points, key=lambda name: points[name][2])
        return name, points[name][2]

    @property
    def levers(self) -> Mapping[str, float]:
        """Most metres by which a radian of each of the driver's joints moves the lowest point up or down.

        Empty if nobody has worked it out.
        """
        return {}

    def from_joints(self, positions: Mapping[str, float]) -> tuple[float, ...]:
        """The model's angles for the driver's joint positions, radians.

        Raises:
            UsageError: A joint is missing.
        """
        try:
            return tuple([positions[limit.name] for limit in self.ranges])
        except KeyError:
            missing = [limit.name for limit in self.ranges if limit.name not in positions]
            raise UsageError(f"the position of {', '.join(missing)} is missing") from None

    def to_joints(self, angles: Sequence[float]) -> dict[str, float]:
        """The driver's joint positions for the model's angles, radians."""
        self._finite(angles)
        return {limit.name: angle for limit, angle in zip(self.ranges, angles, strict=True)}

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The driver's names of the joints that the model knows."""
        return tuple(self.to_joints([0.0] * len(self.ranges)))

    @abstractmethod
    def tool_down(self, position: Vector, angles: Sequence[float]) -> Matrix:
        """A rotation with the tool pointing straight down at a position in metres, with the smallest turn."""

    def carried(self, position: Vector, angles: Sequence[float]) -> Matrix:
        """The tool's rotation after the arm carries it from `angles` to a position in metres."""
        return self.forward(angles).rotation

    def aimed(self, position: Vector, pitch: float, roll: float, angles: Sequence[float]) -> Matrix:
        """The tool's rotation at a position in metres with a pitch and a roll, when the heading follows from them.

        Args:
            position: Of the tip, metres.
            pitch: Of the tool, radians: 0 is level and ahead, a quarter turn is straight down.
            roll: About the tool's axis, radians.
            angles: Present joint angles.

        Raises:
            UsageError: The arm has six joints, and its heading is free.
        """
        raise UsageError(f"{self.name} has six joints: give its rotation, not only pitch and roll")

    def pitch_and_roll(self, angles: Sequence[float]) -> tuple[float, float] | None:
        """Pitch and roll that `aimed` takes, radians, at joint angles; None for an arm of six joints."""
        return None

    def within_arm(self) -> KinematicModel:
        """The same model with limits restricted to those of the robot's joints, for motion."""
        return self

    def for_arm(self, arm: ArmModel) -> KinematicModel:
        """The same model with the limits of one arm's joints, if its joints are the model's."""
        return self

    # -- shared -------------------------------------------------------------------------------------

    def violations(self, angles: Sequence[float]) -> tuple[str, ...]:
        """Descriptions of the limits that joint angles violate; empty if there are none."""
        self._finite(angles)
        found = []
        for limit, angle in zip(self.ranges, angles, strict=True):
            excess = limit.excess(angle)
            if excess:
                found.append(
                    f"{limit.name}={decimal(math.degrees(angle))} deg is {decimal(math.degrees(abs(excess)), 3)} "
                    f"deg {'above' if excess > 0 else 'below'} its limits {decimal(math.degrees(limit.minimum))} "
                    f"to {decimal(math.degrees(limit.maximum))} deg"
                )
        return tuple(found)

    def coupling_excess(self, angles: Sequence[float]) -> float:
        """Excess over the joint coupling limit in radians; 0 if it is not violated, or there is none."""
        return 0.0

    @property
    def has_coupling(self) -> bool:
        """Whether the arm has a joint coupling limit, so that `coupling_excess` may be above 0."""
        return type(self).coupling_excess is not KinematicModel.coupling_excess

    def check(self, angles: Sequence[float]) -> None:
        """Refuse joint angles that violate limits.

        Raises:
            LimitError: The text lists each violation.
        """
        found = self.violations(angles)
        if found:
            raise LimitError("; ".join(found))

    def best(self, pose: Pose, near: Sequence[float] | None = None) -> Solution:
        """The allowed solution for a pose with the smallest joint motion.

        Args:
            pose: Pose of the tool tip.
            near: Present joint angles; the middle of the limits if None.

        Raises:
            LimitError: There is no allowed solution; the text gives the excess and the cause.
        """
        solutions = self.inverse(pose)
        if not solutions:
            raise LimitError(f"out of reach: {self.reach(pose).cause}")
        allowed = [s for s in solutions if s.allowed]
        if not allowed:
            least = min(solutions, key=lambda s: (len(s.violations), self._worst(s.angles)))
            raise LimitError(
                f"no joint angles within limits; nearest is {least.branch}: {'; '.join(least.violations)}"
            )
        start = near or [0.5 * (r.minimum + r.maximum) for r in self.ranges]
        best = min(allowed, key=lambda s: s.distance(start))
        slid = best.slid(start)
        return best if self.violations(slid) else replace(best, angles=slid)

    def _worst(self, angles: Sequence[float]) -> float:
        return max(abs(r.excess(a)) for r, a in zip(self.ranges, angles, strict=True))

    def _sorted(self, solutions: Iterable[Solution]) -> tuple[Solution, ...]:
        return tuple(sorted(solutions, key=lambda s: not s.allowed))

    def _finite(self, angles: Sequence[float]) -> None:
        if len(angles) != len(self.ranges):
            raise UsageError(f"{self.name} has {len(self.ranges)} joints here, got {len(angles)} angles")
        if math.isfinite(sum(angles)):
            return
        for limit, angle in zip(self.ranges, angles, strict=True):
            if not math.isfinite(angle):
                raise UsageError(f"{limit.name} is {angle}, not a number")


def numpy_or_none() -> Any:
    """The numpy module if it is installed, otherwise None. Imported on first use, never with the package."""
    try:
        import numpy
    except ImportError:
        return None
    return numpy
