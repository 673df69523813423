"""Values that all layers above the wire share: joint states, joint targets, targets as sent.

Owns frozen values in SI units, and their words and table for people, which a terminal and a notebook share. Knows
nothing of counts, frames or the source of a state.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from enum import IntFlag
from typing import TYPE_CHECKING, NamedTuple

from hexwire.errors import UsageError
from hexwire.units import plain

if TYPE_CHECKING:
    from .control_law import ControlLaw

__all__ = [
    "COLUMNS",
    "LONGEST",
    "JointFlag",
    "JointReading",
    "JointState",
    "JointTarget",
    "NewestState",
    "SentTarget",
    "condition",
    "fault_names",
    "finite",
]

NAN = math.nan

LONGEST = 3600.0
"""Longest duration of a single motion, seconds. A longer one is a wrong unit or a damaged file."""
_MOST = 1e4
"""Largest joint angle, radians. A larger one is a wrong unit or a damaged file."""


def finite(value: object, what: str) -> float:
    """Convert a value to a float that is neither infinite nor NaN.

    Args:
        value: A value of any type.
        what: Its name in the error text.

    Raises:
        UsageError: It is not a number, such as a text, a bool or None, or it is too large.
    """
    if isinstance(value, str | bytes | bytearray | bool) or value is None:
        raise UsageError(f"{what} must be a number, not {repr(value)[:40]}")
    try:
        number = float(value)  # type: ignore[arg-type]  # what float refuses is no number
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
    """The torque was not read, so the joint may have torque. Set by the host only; not on the wire."""

    @property
    def faults(self) -> JointFlag:
        """The bits that mean a fault."""
        return self & _FAULTS

    def __str__(self) -> str:
        """The flags in words; ``ok`` if none is set."""
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


# The members of an IntFlag are ten times as slow, and every cycle asks for these of every joint.
_SILENT, _TORQUE_ON = int(JointFlag.SILENT), int(JointFlag.TORQUE_ON)


COLUMNS = ("joint", "deg", "deg/s", "load %", "mA", "V", "degC", "age ms", "torque", "condition")
"""Titles of the columns of `JointReading.cells`."""


def fault_names(flags: int) -> list[str]:
    """Names of a servo's faults, such as ``overload``; silence does not count as a fault."""
    return [flag.name.lower() for flag in JointFlag(flags).faults & ~JointFlag.SILENT if flag.name]


def condition(joint: JointReading) -> str:
    """Condition of a joint in words: ``ok``, ``no answer`` or its faults."""
    if joint.flags & JointFlag.SILENT:
        return "no answer"
    words = fault_names(joint.flags)
    if joint.flags & JointFlag.CLAMPED:
        words.append("clamped to its limit")
    return ", ".join(words) or "ok"


@dataclass(frozen=True, slots=True)
class JointReading:
    """One joint of a `JointState`, in the same units."""

    name: str
    position: float
    velocity: float
    load: float
    current: float
    voltage: float
    temperature: float
    flags: JointFlag
    age: float

    @property
    def torque(self) -> str:
        """Its torque in words: ``on``, ``off`` or ``unknown``."""
        if self.flags & JointFlag.TORQUE_UNKNOWN:
            return "unknown"
        return "on" if self.flags & JointFlag.TORQUE_ON else "off"

    @property
    def cells(self) -> tuple[str, ...]:
        """Its row in a table with `COLUMNS`; ``-`` for what is unknown."""
        return (
            self.name,
            plain(math.degrees(self.position), 2),
            plain(math.degrees(self.velocity), 1),
            plain(100 * self.load, 1),
            plain(1000 * self.current, 0),
            plain(self.voltage, 1),
            plain(self.temperature, 0),
            plain(1000 * self.age, 0),
            "-" if self.torque == "unknown" else self.torque,
            condition(self),
        )


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class JointState:
    """All joints at one time: one value per joint in every tuple, in the order of `names`.

    A value that this board or dialect does not provide is NaN.

    Attributes:
        names: Joint names.
        position: Radians.
        velocity: Radians per second.
        load: Effort as a signed fraction of full scale (1.0 = full PWM).
        current: Amperes.
        voltage: Volts.
        temperature: Degrees Celsius.
        flags: Condition as `JointFlag` bits.
        age: Seconds from each joint's sample to `stamp`; infinite for a joint that was never sampled.
        stamp: Host clock (monotonic, seconds) at the newest sample.
        board_time: Board clock at the newest sample, seconds since its start; NaN without a board clock.
        stopped: A stop is latched: nothing moves until resume.
        watchdog_tripped: The board stopped the arm because the host fell silent.
        stalled: Seconds before that for which the program that emulates this arm did not run; 0 otherwise.
        maintenance: The board allows writes to servo settings, and no motion.
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
    stalled: float = 0.0
    maintenance: bool = False

    @classmethod
    def of(
        cls,
        positions: Mapping[str, float],
        *,
        stamp: float,
        torque: bool | None = None,
        flags: tuple[int, ...] | None = None,
        age: tuple[float, ...] | None = None,
        velocity: tuple[float, ...] | None = None,
        load: tuple[float, ...] | None = None,
        current: tuple[float, ...] | None = None,
        voltage: tuple[float, ...] | None = None,
        temperature: tuple[float, ...] | None = None,
        board_time: float = NAN,
        stopped: bool = False,
    ) -> JointState:
        """A state of which only the positions are known, and what else is given.

        Args:
            positions: Radians by joint name, in the order of the state.
            stamp: Host clock (monotonic, seconds) at the newest sample.
            torque: Whether the joints have torque, where no `flags` are given; None if that is unknown.
            flags: Condition of each joint as `JointFlag` bits.
            age: Seconds from each joint's sample to `stamp`; 0 if not given.
            velocity: Radians per second. What is not given from here on is NaN.
            load: Fractions of full scale.
            current: Amperes.
            voltage: Volts.
            temperature: Degrees Celsius.
            board_time: Board clock at the newest sample, seconds since its start.
            stopped: A stop is latched.
        """
        n = len(positions)
        unknown = (NAN,) * n
        if flags is None:
            flags = (int(JointFlag.TORQUE_UNKNOWN) if torque is None else _TORQUE_ON if torque else 0,) * n
        return cls(
            names=tuple(positions),
            position=tuple(positions.values()),
            velocity=unknown if velocity is None else velocity,
            load=unknown if load is None else load,
            current=unknown if current is None else current,
            voltage=unknown if voltage is None else voltage,
            temperature=unknown if temperature is None else temperature,
            flags=flags,
            age=(0.0,) * n if age is None else age,
            stamp=stamp,
            board_time=board_time,
            stopped=stopped,
        )

    @property
    def trip_reason(self) -> str:
        """Why the watchdog has tripped, in words, if it has."""
        if self.stalled:
            return f"this computer or program was too slow: nothing ran the emulated arm for {self.stalled:.1f} s"
        return "the host fell silent"

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
    def remarks(self) -> list[str]:
        """What is to be said of the whole arm below its table; nothing for an arm that is ready."""
        if self.watchdog_tripped:
            return [f"stopped by the board's watchdog, because {self.trip_reason}; 'hexwire resume' ends the stop"]
        if self.maintenance:
            return ["in maintenance: servo settings may be written, nothing moves"]
        return ["stopped; 'hexwire resume' ends the stop"] if self.stopped else []

    def __repr__(self) -> str:
        """In one line, for the Python prompt; `_repr_html_` has more."""
        angles = ", ".join(f"{n} {plain(math.degrees(a), 1)}" for n, a in self.positions.items())
        parts = [f"{angles} deg", f"torque on: {' '.join(self.torque_on) or 'none'}", *self.remarks]
        return f"<JointState: {'; '.join(parts)}>"

    def _repr_html_(self) -> str:
        """The table as HTML, without columns of which nothing is known; its style is that of the page."""
        # Only a notebook needs it, and every program starts with this file.
        from html import escape

        rows = [joint.cells for joint in self]
        kept = [i for i, column in enumerate(zip(*rows, strict=True)) if set(column) != {"-"}]
        titles = "".join(f"<th>{COLUMNS[i]}</th>" for i in kept)
        lines = [
            f"<tr><th>{escape(row[0])}</th>"
            + "".join(f'<td style="text-align:right">{escape(row[i])}</td>' for i in kept[1:])
            + "</tr>"
            for row in rows
        ]
        below = "".join(f"<p>{escape(remark)}</p>" for remark in self.remarks)
        return f"<table><thead><tr>{titles}</tr></thead><tbody>{''.join(lines)}</tbody></table>{below}"

    @property
    def silent(self) -> tuple[str, ...]:
        """Names of the joints whose servo did not answer."""
        return tuple(n for n, f in zip(self.names, self.flags, strict=True) if f & _SILENT)

    @property
    def torque_on(self) -> tuple[str, ...]:
        """Names of the joints that have torque."""
        return tuple(n for n, f in zip(self.names, self.flags, strict=True) if f & _TORQUE_ON)

    def distances(self, goal: Mapping[str, float]) -> dict[str, float]:
        """Distances of joints from their goals, radians; infinite for a joint whose position is unknown.

        Raises:
            UsageError: There is no such joint.
        """
        ways = {name: abs(angle - self[name].position) for name, angle in goal.items()}
        # NaN compares as false, so a joint whose position is unknown would count as arrived.
        return {name: way if math.isfinite(way) else math.inf for name, way in ways.items()}

    @property
    def positions(self) -> dict[str, float]:
        """Positions by joint name, radians."""
        return dict(zip(self.names, self.position, strict=True))


class NewestState(NamedTuple):
    """The newest state that is known of a robot.

    Attributes:
        state: All joints.
        age: Seconds since its newest sample.
    """

    state: JointState
    age: float


@dataclass(frozen=True, slots=True)
class JointTarget:
    """Target positions of joints, and the duration of the motion.

    Attributes:
        positions: Pairs of joint name and position in radians; any subset of the joints.
        duration: Duration of the motion, seconds.
        laws: Pairs of joint name and control law, for some of these joints of a robot that obeys them. Such a joint
            gets its position at once, whatever the duration is.
        guided: A set-point that follows a hand or another program, not a planned motion: its joints may be as fast
            as their servos are (`JointModel.free_speed`).
    """

    positions: tuple[tuple[str, float], ...]
    duration: float = 1.0
    laws: tuple[tuple[str, ControlLaw], ...] = ()
    guided: bool = False

    def __post_init__(self) -> None:
        if self.laws and not {name for name, _ in self.laws} <= {name for name, _ in self.positions}:
            raise UsageError("a target has gains for a joint without a position")
        if _plainly_right(self.positions, self.duration):
            return
        given = _pairs(self.positions)
        names = [name for name, _ in given if isinstance(name, str)]
        if not given:
            raise UsageError("a target names no joint")
        if len(names) < len(given):
            raise UsageError(f"a target names joints by text, not {[name for name, _ in given]!r}")
        if len(set(names)) != len(names):
            raise UsageError(f"a target names a joint twice: {', '.join(names)}")
        positions = tuple([(name, finite(value, f"target of {name}")) for name, value in given])
        if not all(abs(value) <= _MOST for _, value in positions):
            name, value = next((name, value) for name, value in positions if not abs(value) <= _MOST)
            raise UsageError(f"target of {name} is {value:g} rad, which no joint reaches; give radians")
        duration = finite(self.duration, "duration")
        if not 0 <= duration <= LONGEST:
            raise UsageError(f"a duration of {duration:g} s is invalid; a motion takes 0 to {LONGEST:g} s")
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "duration", duration)

    @classmethod
    def of(cls, positions: Mapping[str, float], duration: float = 1.0, *, guided: bool = False) -> JointTarget:
        """Make a target from a mapping of joint name to radians; the rest as its attributes.

        Raises:
            UsageError: There is no joint, a joint occurs twice, or a value is not a number or out of range.
        """
        if type(positions) is not dict and not isinstance(positions, Mapping):
            raise UsageError(f"a target maps joint names to radians; this is {positions!r}")
        return cls(tuple(positions.items()), duration, guided=guided)

    def part(self, names: Collection[str]) -> JointTarget | None:
        """The target of some of its joints; None if it has none of them."""
        kept = tuple([pair for pair in self.positions if pair[0] in names])
        laws = tuple([pair for pair in self.laws if pair[0] in names])
        return JointTarget(kept, self.duration, laws, self.guided) if kept else None


def _pairs(positions: object) -> list[tuple[object, object]]:
    try:
        if isinstance(positions, Mapping | str):
            raise TypeError
        found = list[tuple[object, object]]()
        for pair in positions:  # type: ignore[attr-defined]  # what cannot be iterated over is refused below
            if isinstance(pair, str):
                raise TypeError
            name, value = pair
            found.append((name, value))
    except (TypeError, ValueError):
        text = f"a target is pairs of name and radians; JointTarget.of takes a mapping: {positions!r}"
        raise UsageError(text) from None
    return found


def _plainly_right(positions: object, duration: object) -> bool:
    """Whether a target needs neither a conversion nor an error: targets are made in every cycle."""
    if type(duration) is not float or not 0.0 <= duration <= LONGEST or type(positions) is not tuple:
        return False
    names = set()
    for pair in positions:
        if type(pair) is not tuple or len(pair) != 2:
            return False
        name, value = pair
        # Neither NaN nor an infinite value passes the comparison.
        if type(name) is not str or type(value) is not float or not -_MOST <= value <= _MOST:
            return False
        names.add(name)
    return 0 < len(names) == len(positions)


@dataclass(frozen=True, slots=True)
class SentTarget:
    """The target that was actually sent to the servos.

    Attributes:
        positions: Pairs of joint name and position in radians, rounded to the servo's counts.
        duration: Seconds, lengthened if a speed limit requires it.
        clamped: Names of the joints whose target the board moved into its limits.
        silent: Names of the joints whose servo did not accept the target.
    """

    positions: tuple[tuple[str, float], ...]
    duration: float
    clamped: tuple[str, ...] = ()
    silent: tuple[str, ...] = ()
