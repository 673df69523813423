"""What every arm's kinematics can answer: where the tool is, which joint angles take it there, and how well.

Owns the values that are shared and the parts that no arm does its own way. Knows no arm; angles are radians,
lengths metres.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from hexwire.errors import LimitError, UsageError
from hexwire.units import decimal

from .pose import Matrix, Pose, Vector

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = ["JointRange", "KinematicModel", "Reach", "Singularity", "Solution", "numpy_or_none", "wrap"]

ONE_LINE = "wrist singular"
"""Branch of a wrist of which two joints turn about one line."""


@dataclass(frozen=True, slots=True)
class JointRange:
    """Limits of one joint.

    Attributes:
        name: As messages name it.
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
        """The angle, turned by whole turns to where the limits are or, if it never is, as near as can be."""
        turned = wrap(angle, 0.5 * (self.minimum + self.maximum))
        return min(
            (turned, turned - math.tau, turned + math.tau), key=lambda a: (abs(self.excess(a)), abs(a - turned))
        )


_GRACE = 1e-9
"""Rounding is no violation, radians."""
SINGULAR = 1e-12
"""Sine between two joint axes below which they are one line."""
NEAR_SINGULAR = 1e-6
"""Below this the share of the two joints is mostly rounding, though the pose is right."""


def wrap(angle: float, centre: float = 0.0) -> float:
    """The angle by whole turns within half a turn of `centre`, radians."""
    return centre + math.remainder(angle - centre, math.tau)


@dataclass(frozen=True, slots=True)
class Solution:
    """One way to reach a pose.

    Attributes:
        angles: Joint angles, radians.
        branch: Words for the choices, as in ``front, elbow up, wrist 1``.
        violations: What forbids it, in words; empty if nothing does.
        singular: Two joints turn about one line here, so their share of the turn was chosen.
        free: Change of the joints that leaves the pose as it is, where they are exactly one line; else empty.
    """

    angles: tuple[float, ...]
    branch: str
    violations: tuple[str, ...] = ()
    singular: bool = False
    free: tuple[float, ...] = ()

    def slid(self, near: Sequence[float]) -> tuple[float, ...]:
        """The angles of the same pose that are nearest to `near`: where joints are one line, there is a choice."""
        if not self.free:
            return self.angles
        apart = [b - a for a, b in zip(self.angles, near, strict=True)]
        share = sum(f * d for f, d in zip(self.free, apart, strict=True)) / sum(f * f for f in self.free)
        return tuple(a + share * f for a, f in zip(self.angles, self.free, strict=True))

    @property
    def allowed(self) -> bool:
        """No limit forbids it."""
        return not self.violations

    def distance(self, angles: Sequence[float]) -> float:
        """Largest turn of a joint from `angles` to here, radians."""
        return max(abs(a - b) for a, b in zip(self.angles, angles, strict=True))


@dataclass(frozen=True, slots=True)
class Reach:
    """Whether the links are long, and short, enough for a place.

    Attributes:
        reachable: They are. Limits of joints are another matter.
        excess: Metres by which they are not; 0 if they are.
        cause: What is at fault, in words; empty if nothing is.
    """

    reachable: bool
    excess: float
    cause: str


@dataclass(frozen=True, slots=True)
class Singularity:
    """How near a pose is to where the arm cannot move in some direction.

    Attributes:
        measures: By name of the kind of singularity: 0 is singular, 1 as far off as can be.
        manipulability: Absolute determinant of the Jacobian, metres cubed.
        near: Names of the measures below a twentieth.
    """

    measures: Mapping[str, float]
    manipulability: float

    @property
    def near(self) -> tuple[str, ...]:
        """Names of the singularities that are near."""
        return tuple(name for name, value in self.measures.items() if value < _NEAR)


_NEAR = 0.05


class KinematicModel(ABC):
    """Kinematics of one arm of six joints.

    Attributes:
        name: As in ``hex7bot``.
        ranges: Limits of the joints in order.
    """

    name: str
    ranges: tuple[JointRange, ...]

    @abstractmethod
    def forward(self, angles: Sequence[float]) -> Pose:
        """Pose of the tool tip at joint angles.

        Raises:
            UsageError: Not six finite numbers.
        """

    @abstractmethod
    def inverse(self, pose: Pose) -> tuple[Solution, ...]:
        """Every way to reach a pose of the tool tip, limits or not; those that limits allow come first.

        Empty if the links do not reach it: `reach` says why.
        """

    @abstractmethod
    def reach(self, pose: Pose) -> Reach:
        """Whether the links reach a pose of the tool tip, and if not, by how much and why."""

    @abstractmethod
    def jacobian(self, angles: Sequence[float]) -> tuple[tuple[float, ...], ...]:
        """Six rows: velocity of the tip x, y, z (m/s), then turning rate x, y, z (rad/s), per joint speed."""

    @abstractmethod
    def singularity(self, angles: Sequence[float]) -> Singularity:
        """How near joint angles are to a singularity."""

    @abstractmethod
    def forward_many(self, angles: Sequence[Sequence[float]]) -> tuple[Any, Any]:
        """Positions (N, 3) and rotations (N, 3, 3) of the tip: arrays where numpy is there, else nested lists."""

    @abstractmethod
    def inverse_many(self, positions: Any, rotations: Any) -> Any:
        """Joint angles (N, 8, 6), one row a branch, within half a turn; NaN where the links do not reach.

        An array where numpy is there, else nested lists.
        """

    @abstractmethod
    def points(self, angles: Sequence[float]) -> Mapping[str, Vector]:
        """Places of the arm that may hit the table, by name, metres."""

    @abstractmethod
    def from_joints(self, positions: Mapping[str, float]) -> tuple[float, ...]:
        """The model's angles of joint positions as the driver names and gives them, radians.

        Raises:
            UsageError: A joint is missing.
        """

    @abstractmethod
    def to_joints(self, angles: Sequence[float]) -> dict[str, float]:
        """Joint positions for the driver of the model's angles, radians."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The driver's names of the joints that the model knows."""
        return tuple(self.to_joints([0.0] * len(self.ranges)))

    @abstractmethod
    def tool_down(self, position: Vector, angles: Sequence[float]) -> Matrix:
        """A rotation with the tool pointing straight down at a place in metres, its turn as near as can be."""

    def carried(self, position: Vector, angles: Sequence[float]) -> Matrix:
        """The tool's rotation at `angles` when the arm carries it to a place in metres."""
        return self.forward(angles).rotation

    # -- shared -------------------------------------------------------------------------------------

    def violations(self, angles: Sequence[float]) -> tuple[str, ...]:
        """What limits say against joint angles, in words; empty if nothing."""
        self._six(angles)
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

    def gate_excess(self, angles: Sequence[float]) -> float:
        """How far a gate that is no single joint's limit is violated, radians; 0 if it is not, or there is none."""
        return 0.0

    def check(self, angles: Sequence[float]) -> None:
        """Refuse joint angles that limits forbid.

        Raises:
            LimitError: With each violation.
        """
        found = self.violations(angles)
        if found:
            raise LimitError("; ".join(found))

    def best(self, pose: Pose, near: Sequence[float] | None = None) -> Solution:
        """The allowed way to reach a pose that turns the joints least.

        Args:
            pose: Of the tool tip.
            near: Present joint angles; the middle of the limits if None.

        Raises:
            LimitError: No way; the text says by how much and what the cause is.
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

    def _six(self, angles: Sequence[float]) -> None:
        if len(angles) != len(self.ranges):
            raise UsageError(f"{self.name} has {len(self.ranges)} joints here, got {len(angles)} angles")
        for limit, angle in zip(self.ranges, angles, strict=True):
            if not math.isfinite(angle):
                raise UsageError(f"{limit.name} is {angle}, not a number")


def numpy_or_none() -> Any:
    """The numpy module where it is installed, else None. Imported on first use, never with the package."""
    try:
        import numpy
    except ImportError:
        return None
    return numpy
