"""The model of an arm: joints, their servos, the conversion of counts to angles, and limits.

Owns `JointModel` and `ArmModel`. Series are plain strings.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from hexwire.errors import LimitError, UsageError
from hexwire.units import decimal

__all__ = ["MAX_ACCELERATION", "MAX_JERK", "ArmModel", "JointModel"]

MAX_ACCELERATION = 6.0
"""Radians per second squared, where nothing else is said: a 7Bot joint is at full speed after 0.5 s."""
MAX_JERK = 60.0
"""Radians per second cubed, where nothing else is said: full acceleration takes a tenth of a second."""
_FINE = 1e-4
"""Radians per count of a joint that has no counts: an angle may be outside its limits by half of it."""


@dataclass(frozen=True, slots=True)
class JointModel:
    """One joint and its servo.

    Attributes:
        name: Name, such as ``J1``.
        servo_id: Bus id.
        series: Servo series: seven_bot, scs, sts_sms or hls.
        neutral: Count at which the joint is at `offset`.
        sign: 1 or -1.
        offset: Joint angle at the neutral count, radians.
        scale: Radians per count.
        minimum: Lower limit, radians.
        maximum: Upper limit, radians.
        max_speed: Radians per second.
        max_acceleration: Of planned motion, radians per second squared.
        max_jerk: Of planned motion, radians per second cubed: how fast the acceleration may change.
        free_speed: Radians per second that its servo reaches without a load, for set-points that follow a hand or a
            program of which nobody knows what it wants next; 0 for `max_speed`.
    """

    name: str
    servo_id: int
    series: str
    neutral: int
    sign: int
    offset: float
    scale: float
    minimum: float
    maximum: float
    max_speed: float
    max_acceleration: float = MAX_ACCELERATION
    max_jerk: float = MAX_JERK
    free_speed: float = 0.0

    @property
    def guided_speed(self) -> float:
        """Most radians per second of a guided target, see `JointTarget.guided`."""
        return self.free_speed or self.max_speed

    def counts_to_angle(self, counts: float) -> float:
        """Joint angle in radians of a servo position in counts."""
        return self.sign * (counts - self.neutral) * self.scale + self.offset

    def angle_to_counts(self, angle: float, parts: int = 1) -> int:
        """Nearest servo position of a joint angle in radians, in counts or in so many parts of a count."""
        return round(self.sign * (angle - self.offset) / self.scale * parts) + self.neutral * parts

    def speed_to_angle(self, counts_per_s: float) -> float:
        """Radians per second of a servo speed in counts per second."""
        return self.sign * counts_per_s * self.scale

    @property
    def count_limits(self) -> tuple[int, int]:
        """Lowest and highest count inside the limits."""
        a = self.sign * (self.minimum - self.offset) / self.scale + self.neutral
        b = self.sign * (self.maximum - self.offset) / self.scale + self.neutral
        return math.ceil(min(a, b)), math.floor(max(a, b))

    def inside(self, angle: float) -> float:
        """An angle that `check` allows, half a count outside, at its limit: a board takes no point beyond it."""
        return min(max(angle, self.minimum), self.maximum) if self._allows(angle) else angle

    def _allows(self, angle: float) -> bool:
        # A tolerance of half a count, so that the limit itself can be given in rounded degrees.
        grace = 0.5 * self.scale
        return self.minimum - grace <= angle <= self.maximum + grace

    def check(self, angle: float) -> None:
        """Refuse an angle outside the limits.

        Raises:
            LimitError: The text has the joint, the angle and the limits in degrees.
        """
        if not self._allows(angle):
            low, high = math.degrees(self.minimum), math.degrees(self.maximum)
            raise LimitError(
                f"{self.name}={decimal(math.degrees(angle))} deg is outside its limits {decimal(low)} to "
                f"{decimal(high)} deg; nothing was sent"
            )


@dataclass(frozen=True)
class ArmModel:
    """An arm: its joints in order.

    Attributes:
        name: Name, such as ``hex7bot``.
        joints: Joint models, in the order of every tuple of joint values.
        geometry: Robot whose geometry this arm has; empty if `name` says it.
        names: Joint names in order.
        by_name: The joints by name, for loops that look each of them up in every cycle; `joint` ignores case.
    """

    name: str
    joints: tuple[JointModel, ...]
    geometry: str = ""
    names: tuple[str, ...] = field(init=False, repr=False, compare=False)
    by_name: Mapping[str, JointModel] = field(init=False, repr=False, compare=False)
    _indices: Mapping[str, int] = field(init=False, repr=False, compare=False)
    _by_id: Mapping[int, int] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        indices = {joint.name: i for i, joint in enumerate(self.joints)}
        by_id = {joint.servo_id: i for i, joint in enumerate(self.joints)}
        if len(indices) != len(self.joints) or len(by_id) != len(self.joints):
            raise UsageError(f"{self.name}: two joints share a name or a servo id")
        # Stored, since every state is compared with them.
        object.__setattr__(self, "names", tuple(indices))
        object.__setattr__(self, "by_name", {joint.name: joint for joint in self.joints})
        object.__setattr__(self, "_indices", indices)
        object.__setattr__(self, "_by_id", by_id)

    @property
    def kind(self) -> str:
        """Name of the robot whose geometry, gripper and assembly this arm has, see `hexwire.model.arms`."""
        return self.geometry or self.name

    @classmethod
    def of(cls, name: str, limits: Mapping[str, tuple[float, float]], *, max_speed: float) -> ArmModel:
        """An arm whose driver speaks in angles: its joints have limits, but no counts.

        Args:
            name: Name of the arm.
            limits: Lower and upper limit by joint name, radians.
            max_speed: Of each joint, radians per second.

        Raises:
            UsageError: A lower limit is not below its upper one.
        """
        for joint, (low, high) in limits.items():
            if not low < high:
                raise UsageError(f"{name}: the limits of {joint} are {low:g} to {high:g} rad, not in this order")
        rows = [
            JointModel(joint, number, "none", 0, 1, 0.0, _FINE, low, high, max_speed)
            for number, (joint, (low, high)) in enumerate(limits.items(), 1)
        ]
        return cls(name, tuple(rows))

    def joint(self, name: str) -> JointModel:
        """A joint by name, ignoring case.

        Raises:
            UsageError: There is no such joint; the text lists the joints.
        """
        return self.by_name.get(name) or self.joints[self.index(name)]

    def index(self, name: str) -> int:
        """Index of a joint.

        Raises:
            UsageError: There is no joint of this name.
        """
        i = self._indices.get(name)
        if i is None:
            i = next((i for known, i in self._indices.items() if known.lower() == name.lower()), None)
        if i is None:
            raise UsageError(f"no joint {name!r}; {self.name} has {', '.join(self.names)}")
        return i

    def by_servo(self, servo_id: int) -> JointModel | None:
        """The joint of a servo id, or None."""
        i = self._by_id.get(servo_id)
        return None if i is None else self.joints[i]

    def mask(self, names: Sequence[str] | None = None) -> int:
        """Bit mask of joints, bit i for the i-th; all if None."""
        if names is None:
            return (1 << len(self.joints)) - 1
        mask = 0
        for name in names:
            mask |= 1 << self.index(name)
        return mask
