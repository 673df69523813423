"""The nouns every layer above the wire shares: joint states, joint targets, what was really sent.

Owns frozen values in SI units. Knows nothing of counts, frames or how a state came here.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import IntFlag

from hexwire.errors import UsageError

__all__ = ["LONGEST", "JointFlag", "JointReading", "JointState", "JointTarget", "SentTarget", "finite"]

NAN = math.nan

LONGEST = 3600.0
"""Seconds that a single motion may take. A longer one is a wrong unit or a damaged file."""
_MOST = 1e4
"""Radians that no joint has; what is beyond is a wrong unit or a damaged file."""


def finite(value: object, what: str) -> float:
    """A number that is neither infinite nor NaN, as a float.

    Args:
        value: Whatever a caller gave.
        what: What the error calls it.

    Raises:
        UsageError: It is something else: a text, a switch, nothing, or too large.
    """
    if isinstance(value, str | bytes | bytearray | bool) or value is None:
        raise UsageError(f"{what} must be a number, not {repr(value)[:40]}")
    try:
        number = float(value)  # type: ignore[arg-type]  # what float does not take is no number
    except OverflowError:
        raise UsageError(f"{what} is too large a number") from None
    except (TypeError, ValueError):
        raise UsageError(f"{what} must be a number, not a {type(value).__name__}") from None
    if not math.isfinite(number):
        raise UsageError(f"{what} is {number}, not a number")
    return number


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
    TORQUE_UNKNOWN = 0x100
    """Nobody has asked, and no board tells: it may have torque. Of this side only, not of the wire."""

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


@dataclass(frozen=True, slots=True, kw_only=True)
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

    def distances(self, goal: Mapping[str, float]) -> dict[str, float]:
        """How far joints are from where they shall be, radians; infinite where it is not known.

        Raises:
            UsageError: There is no such joint.
        """
        ways = {name: abs(angle - self[name].position) for name, angle in goal.items()}
        # NaN compares as false, so that a joint nobody knows of would pass for one that has arrived.
        return {name: way if math.isfinite(way) else math.inf for name, way in ways.items()}

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
        if not all(isinstance(name, str) for name in names):
            raise UsageError(f"a target names joints by text, not {names!r}")
        if len(set(names)) != len(names):
            raise UsageError(f"a target names a joint twice: {', '.join(names)}")
        positions = tuple((name, finite(value, f"target of {name}")) for name, value in self.positions)
        if not all(abs(value) <= _MOST for _, value in positions):
            name, value = next((name, value) for name, value in positions if not abs(value) <= _MOST)
            raise UsageError(f"target of {name} is {value:g}, which no joint can do; it is in radians")
        duration = finite(self.duration, "duration")
        if not 0 <= duration <= LONGEST:
            raise UsageError(f"a duration of {duration:g} s makes no sense; a motion takes 0 to {LONGEST:g} s")
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "duration", duration)

    @classmethod
    def of(cls, positions: Mapping[str, float], duration: float = 1.0) -> JointTarget:
        """Make a target from a mapping of joint name to radians.

        Raises:
            UsageError: No joint, one twice, or a value that is no number or makes no sense.
        """
        if not isinstance(positions, Mapping):
            raise UsageError(f"a target maps joint names to radians; this is {positions!r}")
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
