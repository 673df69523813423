"""The nouns every layer above the wire shares: joint states, joint targets, what was really sent.

Owns frozen values in SI units. Knows nothing of counts, frames or how a state came here.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import IntFlag

from hexwire.errors import UsageError

__all__ = ["JointFlag", "JointReading", "JointState", "JointTarget", "SentTarget"]

NAN = math.nan


class JointFlag(IntFlag):
    """Condition of one joint; the fault bits are those of the servo's own status byte."""

    VOLTAGE = 0x01
    ENCODER = 0x02
    TEMPERATURE = 0x04
    CURRENT = 0x08
    CLAMPED = 0x10
    OVERLOAD = 0x20
    TORQUE_ON = 0x40
    SILENT = 0x80

    @property
    def faults(self) -> JointFlag:
        """Only the bits that mean something is wrong."""
        return self & _FAULTS

    def __str__(self) -> str:
        """The flags in words, ``ok`` if there is nothing to say."""
        words = [flag.name.lower().replace("_", " ") for flag in JointFlag if flag in self and flag.name]
        return ", ".join(words) or "ok"


_FAULTS = (
    JointFlag.VOLTAGE
    | JointFlag.ENCODER
    | JointFlag.TEMPERATURE
    | JointFlag.CURRENT
    | JointFlag.OVERLOAD
    | JointFlag.SILENT
)


@dataclass(frozen=True, slots=True)
class JointReading:
    """One joint of a `JointState`. Units as there."""

    name: str
    position: float
    velocity: float
    load: float
    current: float
    voltage: float
    temperature: float
    flags: JointFlag
    age: float


@dataclass(frozen=True, slots=True)
class JointState:
    """All joints at one time: one value a joint in every tuple, in the order of `names`.

    A value that this board or dialect does not give is NaN.

    Attributes:
        names: Joint names.
        position: Radians.
        velocity: Radians per second.
        load: Drive effort as a signed fraction of full scale (1.0 = full PWM).
        current: Amperes.
        voltage: Volts.
        temperature: Degrees Celsius.
        flags: Condition as `JointFlag` bits.
        age: Seconds since each joint was sampled, at `stamp`; infinite if it never was.
        stamp: Host clock (monotonic, seconds) at which this state was true.
        board_time: Board clock at the newest sample, seconds since its start; NaN if it has none.
        stopped: A stop is latched: nothing moves until resume.
        watchdog_tripped: The board stopped by itself because the host fell silent.
        maintenance: The board lets settings of servos be written, and nothing move.
    """

    names: tuple[str, ...]
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    load: tuple[float, ...]
    current: tuple[float, ...]
    voltage: tuple[float, ...]
    temperature: tuple[float, ...]
    flags: tuple[int, ...]
    age: tuple[float, ...]
    stamp: float
    board_time: float = NAN
    stopped: bool = False
    watchdog_tripped: bool = False
    maintenance: bool = False

    def __getitem__(self, name: str) -> JointReading:
        """One joint by name.

        Raises:
            UsageError: There is no such joint.
        """
        try:
            i = self.names.index(name)
        except ValueError:
            raise UsageError(f"no joint {name!r}; there are {', '.join(self.names)}") from None
        return self._reading(i)

    def __iter__(self) -> Iterator[JointReading]:
        return (self._reading(i) for i in range(len(self.names)))

    def __len__(self) -> int:
        return len(self.names)

    def _reading(self, i: int) -> JointReading:
        return JointReading(
            self.names[i],
            self.position[i],
            self.velocity[i],
            self.load[i],
            self.current[i],
            self.voltage[i],
            self.temperature[i],
            JointFlag(self.flags[i]),
            self.age[i],
        )

    @property
    def silent(self) -> tuple[str, ...]:
        """Names of the joints whose servo did not answer."""
        return tuple(n for n, f in zip(self.names, self.flags, strict=True) if f & JointFlag.SILENT)

    @property
    def torque_on(self) -> tuple[str, ...]:
        """Names of the joints that have torque."""
        return tuple(n for n, f in zip(self.names, self.flags, strict=True) if f & JointFlag.TORQUE_ON)

    @property
    def positions(self) -> dict[str, float]:
        """Positions by joint name, radians."""
        return dict(zip(self.names, self.position, strict=True))


@dataclass(frozen=True, slots=True)
class JointTarget:
    """Where joints shall go, and in what time.

    Attributes:
        positions: Pairs of joint name and position in radians; any subset of the joints.
        duration: Seconds the motion shall take.
    """

    positions: tuple[tuple[str, float], ...]
    duration: float = 1.0

    def __post_init__(self) -> None:
        names = [name for name, _ in self.positions]
        if not names:
            raise UsageError("a target names no joint")
        if len(set(names)) != len(names):
            raise UsageError(f"a target names a joint twice: {', '.join(names)}")
        for name, value in self.positions:
            if not math.isfinite(value):
                raise UsageError(f"target of {name} is {value}, not a number")
        if not 0 <= self.duration < math.inf:
            raise UsageError(f"duration {self.duration} s makes no sense")

    @classmethod
    def of(cls, positions: Mapping[str, float], duration: float = 1.0) -> JointTarget:
        """Make a target from a mapping of joint name to radians."""
        return cls(tuple(positions.items()), duration)


@dataclass(frozen=True, slots=True)
class SentTarget:
    """What really went to the servos.

    Attributes:
        positions: Pairs of joint name and position in radians, as the servo's counts round them.
        duration: Seconds, lengthened where a speed limit asks for it.
        clamped: Names of the joints whose target the board moved into its limits.
        silent: Names of the joints whose servo did not take it.
    """

    positions: tuple[tuple[str, float], ...]
    duration: float
    clamped: tuple[str, ...] = ()
    silent: tuple[str, ...] = ()
