"""The registers of a servo as a table for people, and their edits: checked, read back, and undone on request.

Owns the rows and how all registers are read in few requests, what a person may type, which registers are not edited
like this and why, and the history. A row is plain data, which the command line prints and a page shows. Must not
know either, and asks for no confirmation: `Edit.warning` says what to confirm.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from hexwire.errors import ServoError, UsageError
from hexwire.units import decimal
from hexwire.wire.registers import Register, Series

from .servo_bus import ServoBus
from .setup import write_setting

__all__ = [
    "MOVING",
    "Edit",
    "RegisterEdits",
    "TableRow",
    "in_people_unit",
    "make_table",
    "parse_value",
    "people_unit",
    "prepare_edit",
    "read_table",
    "why_not",
]

_FROM_DEGREES = math.pi / 180.0
MOVING = frozenset(
    ("goal_position", "target_position", "goal_speed", "target_speed", "goal_pwm_or_time", "goal_time", "run_time")
)
"""Registers whose write may set a servo in motion."""
_MOST_UNDONE = 100
_LONGEST = 40
_WARNINGS = {
    "mode": "another mode: a goal of the old mode may then turn the servo without end",
    "phase": "the drive's own wiring: a wrong value makes the servo run away or not at all",
    "byte_order": "the order of its bytes: hexwire then no longer understands it",
    "status_return_level": "whether it answers writes",
    "position_offset": "the zero of its positions: a calibration of the arm is then wrong",
    "protection_switch": "which faults switch it off",
    "max_voltage": "its protection against a wrong supply",
    "min_voltage": "its protection against a wrong supply",
    "max_temperature": "its protection against heat",
    "protection_current": "its protection against a blocked joint",
    "overload_torque": "its protection against a blocked joint",
    "overload_time": "its protection against a blocked joint",
    "min_position_limit": "how far it may turn",
    "max_position_limit": "how far it may turn",
}


@dataclass(frozen=True, slots=True)
class TableRow:
    """One register of one servo.

    Attributes:
        register: The register: name, address, access, area, bits, note.
        raw: Its raw value; None if the servo did not tell it.
        value: Its value in `unit`; NaN without one.
        unit: A unit for people: deg, deg/s, deg/s², A, V, °C, s, % or empty for a bare number.
        low: Lowest value in `unit`; None if unknown.
        high: Highest value in `unit`; None if unknown.
        saved: Its raw value in a backup; None without one.
        differs_from_factory: It is stored, and not as it left the factory, as far as that is known.
        differs_from_backup: The backup has another value.
        words: Names of the bits that are set.
    """

    register: Register
    raw: int | None
    value: float
    unit: str
    low: float | None
    high: float | None
    saved: int | None
    differs_from_factory: bool
    differs_from_backup: bool
    words: tuple[str, ...]

    @property
    def stored(self) -> bool:
        """Whether it survives power-off."""
        return self.register.area == "eeprom"

    @property
    def writable(self) -> bool:
        """Whether the servo accepts writes."""
        return self.register.access == "rw"


def people_unit(si_unit: str) -> tuple[str, float]:
    """Return the unit in which people read and type a value, and the SI value of one such unit."""
    return {
        "rad": ("deg", _FROM_DEGREES),
        "rad/s": ("deg/s", _FROM_DEGREES),
        "rad/s^2": ("deg/s²", _FROM_DEGREES),
        "fraction": ("%", 0.01),
        "degC": ("°C", 1.0),
    }.get(si_unit, (si_unit, 1.0))


def in_people_unit(register: Register, raw: int) -> str:
    """A raw value as people read it, with its unit: ``80 %``; the raw value itself of a register without one."""
    unit, si = people_unit(register.si_unit)
    return f"{decimal(raw * register.si_factor / si)} {unit}" if unit else str(raw)


def make_table(series: Series, raws: Mapping[str, int], saved: Mapping[str, int] | None = None) -> list[TableRow]:
    """Make the rows of all registers of a series, in order of address.

    Args:
        series: The series.
        raws: Raw values by register name; others are unknown.
        saved: Raw values of a backup by register name.
    """
    rows = []
    for register in series.registers.values():
        raw, backup = raws.get(register.name), (saved or {}).get(register.name)
        unit, si = people_unit(register.si_unit)
        step = register.si_factor / si
        default = register.default
        rows.append(
            TableRow(
                register,
                raw,
                math.nan if raw is None else raw * step,
                unit,
                None if register.minimum is None else register.minimum * step,
                None if register.maximum is None else register.maximum * step,
                backup,
                register.area == "eeprom"
                and register.access == "rw"
                # Every servo of an arm has an id of its own.
                and register.name != "id"
                and default is not None
                and raw is not None
                and raw != default,
                backup is not None and raw is not None and raw != backup,
                tuple(word for bit, word in register.bits.items() if (raw or 0) >> bit & 1),
            )
        )
    return rows


def read_table(bus: ServoBus, servo_id: int, saved: Mapping[str, int] | None = None) -> list[TableRow]:
    """Read all registers of a servo, in as few requests as its series allows.

    Args:
        bus: The bus, which knows the servo's series.
        servo_id: The servo.
        saved: Raw values of a backup by register name.

    Raises:
        ServoError: The servo does not answer.
    """
    series = bus.series_of(servo_id)
    raws: dict[str, int] = {}
    for rows in _neighbours(list(series.registers.values()), series.max_read):
        if len(rows) == 1 or series is Series.SEVEN_BOT:
            for row in rows:
                reading = bus.read(servo_id, row.name)
                if reading.raw is None:
                    raise _silent(servo_id, row.name, reading.error)
                raws[row.name] = reading.raw
            continue
        first, end = rows[0].address, rows[-1].address + rows[-1].size
        block = bus.read_block(servo_id, first, end - first)
        for row in rows:
            raw = block.raw(row)
            if raw is None:
                raise _silent(servo_id, row.name, block.error)
            raws[row.name] = raw
    return make_table(series, raws, saved)


def _neighbours(registers: Sequence[Register], most: int) -> list[list[Register]]:
    """Group registers that can be read at once; a gap between them ends a group, since a servo may refuse it."""
    groups: list[list[Register]] = []
    for register in registers:
        last = groups[-1] if groups else []
        if (
            last
            and register.address <= last[-1].address + last[-1].size
            and register.address + register.size - last[0].address <= most
        ):
            last.append(register)
        else:
            groups.append([register])
    return groups


def _silent(servo_id: int, name: str, error: str) -> ServoError:
    return ServoError(
        f"servo {servo_id}: {error or 'no answer'} to {name} (check cable and power)", servo_id=servo_id
    )


class Edit(NamedTuple):
    """A change of one register.

    Attributes:
        servo_id: The servo.
        register: The register.
        before: Its raw value before.
        after: Its raw value afterwards.
    """

    servo_id: int
    register: Register
    before: int
    after: int

    @property
    def stored(self) -> bool:
        """Whether the new value survives power-off."""
        return self.register.area == "eeprom"

    @property
    def warning(self) -> str:
        """What the change means, for a question before it; empty for a harmless value that power-off forgets."""
        what = _WARNINGS.get(self.register.name, "")
        if not self.stored:
            return what
        kept = f"{self.register.name} is stored in servo {self.servo_id} and survives power-off"
        return f"{kept}. It is {what}" if what else kept

    def __str__(self) -> str:
        return f"servo {self.servo_id} {self.register.name}: {self.before} → {self.after}"

    def for_people(self) -> str:
        """The change in the unit in which people read the register, as `str` says it in raw values."""
        before, after = (in_people_unit(self.register, raw) for raw in (self.before, self.after))
        return f"servo {self.servo_id} {self.register.name}: {before} → {after}"


def why_not(register: Register) -> str:
    """Say why a register is not edited as a number; empty if it may be."""
    if register.access != "rw":
        return "the servo only reports it"
    if register.name == "id":
        return "change the id: that is checked, and goes back if the servo does not answer"
    if register.name == "baud_code":
        return "change the rate: that is checked, and goes back if the servo does not answer"
    if register.name == "lock":
        return "stored settings are unlocked and locked again by hexwire"
    if register.name == "torque_enable":
        return "switch the torque: on, the servo then holds where it is"
    if register.name in MOVING:
        return "it would move the servo: a wave moves it only while somebody holds it"
    return ""


def parse_value(register: Register, text: str, *, raw: bool) -> int:
    """Parse what a person typed for a register, and check it against the servo's own range.

    Args:
        register: The register.
        text: A whole number (also ``0x1f``) if raw; else a number in the unit of `people_unit`.
        raw: See above.

    Raises:
        UsageError: It is not such a number, or out of range; the text says the range.
    """
    text = text.strip().replace(",", ".")
    unit, si = people_unit(register.si_unit)
    try:
        if len(text) > _LONGEST:
            raise ValueError
        if raw or not register.si_unit:
            value = int(text, 0)
        else:
            number = float(text)
            if not math.isfinite(number):
                raise ValueError
            value = register.from_si(number * si)
    except UsageError:
        raise
    except (ValueError, OverflowError):
        kind = "a whole number" if raw or not register.si_unit else f"a number in {unit}"
        raise UsageError(f"{register.name}: {text[:_LONGEST]!r} is not {kind}") from None
    low = register.fits[0] if register.minimum is None else register.minimum
    high = register.fits[-1] if register.maximum is None else register.maximum
    if not low <= value <= high:
        step = register.si_factor / si
        told = f"{low}..{high}" if raw or not unit else f"{low * step:.4g}..{high * step:.4g} {unit}"
        raise UsageError(f"{register.name} takes {told}, not {text}")
    return value


class RegisterEdits:
    """The edits of one session at a bus, and the way back. Its callers take turns.

    Attributes:
        done: Edits that can be undone, newest last; the oldest are forgotten after a hundred.
    """

    def __init__(self) -> None:
        self.done: deque[Edit] = deque(maxlen=_MOST_UNDONE)

    def prepare(self, bus: ServoBus, servo_id: int, name: str, text: str, *, raw: bool) -> Edit:
        """Check an edit and read the value before it; nothing is written.

        Raises:
            UsageError: The register is not edited like this, or the value is not accepted.
            ServoError: The servo does not answer.
        """
        series = bus.series_of(servo_id)
        return prepare_edit(series, servo_id, name, text, raw=raw, read=lambda each: _read(bus, servo_id, each))

    def apply(self, bus: ServoBus, edit: Edit) -> None:
        """Write an edit and verify it.

        Raises:
            ServoError: The register changed since `prepare`, or has another value afterwards.
        """
        _expect(bus, edit, edit.before, "since it was shown")
        _write(bus, edit.servo_id, edit.register, edit.after)
        self.done.append(edit)

    def undo(self, bus: ServoBus) -> Edit:
        """Undo the last edit and verify it; it stays in the history if that fails.

        Returns:
            The edit that was undone.

        Raises:
            UsageError: There is none.
            ServoError: The register was changed by something else since, or the servo does not answer.
        """
        if not self.done:
            raise UsageError("there is nothing to undo")
        edit = self.done[-1]
        _expect(bus, edit, edit.after, "since that edit")
        _write(bus, edit.servo_id, edit.register, edit.before)
        self.done.pop()
        return edit

    def moved(self, old: int, new: int) -> None:
        """Follow a servo to its new id."""
        rows = [edit._replace(servo_id=new) if edit.servo_id == old else edit for edit in self.done]
        self.done = deque(rows, maxlen=_MOST_UNDONE)


def prepare_edit(
    series: Series, servo_id: int, name: str, text: str, *, raw: bool, read: Callable[[str], int]
) -> Edit:
    """Check an edit and read the value before it; nothing is written.

    Args:
        series: Of the servo.
        servo_id: The servo.
        name: The register.
        text: As in `parse_value`.
        raw: As in `parse_value`.
        read: Reads a register, raw.

    Raises:
        UsageError: The register is not edited like this, or the value is not accepted.
        HexwireError: As `read`.
    """
    register = series.register(name)
    if refusal := why_not(register):
        raise UsageError(f"{name}: {refusal}")
    after = parse_value(register, text, raw=raw)
    other = _other_limit(series, register, read)
    if other is not None and (after >= other if name.startswith("min") else after <= other):
        raise UsageError(f"{name}: {after} leaves no range, the other limit is {other}")
    return Edit(servo_id, register, read(name), after)


def _other_limit(series: Series, register: Register, read: Callable[[str], int]) -> int | None:
    """The other end of a range of two registers: without a range between them a servo refuses goals, or turns."""
    name = register.name
    pair = name.replace("min_", "max_") if name.startswith("min_") else name.replace("max_", "min_")
    # An SCS with both limits at 0 is a wheel on purpose.
    if pair == name or pair not in (known := series.registers) or series is Series.SCS:
        return None
    return read(pair) if known[pair].si_unit == register.si_unit else None


def _read(bus: ServoBus, servo_id: int, name: str) -> int:
    reading = bus.read(servo_id, name)
    if reading.raw is None:
        raise ServoError(f"servo {servo_id}: {reading.error} to {name} (check cable and power)", servo_id=servo_id)
    return reading.raw


def _expect(bus: ServoBus, edit: Edit, raw: int, when: str) -> None:
    now = _read(bus, edit.servo_id, edit.register.name)
    if now != raw:
        what = f"servo {edit.servo_id} {edit.register.name}"
        raise ServoError(
            f"{what} changed {when}: it is {now}, not {raw}; nothing was written", servo_id=edit.servo_id
        )


def _write(bus: ServoBus, servo_id: int, register: Register, raw: int) -> None:
    if register.area == "eeprom":
        write_setting(bus, servo_id, register.name, raw)
        return
    answer = bus.write_raw(servo_id, register.name, raw)
    if answer.error:
        answer.check()
    now = _read(bus, servo_id, register.name)
    if now != raw:
        raise ServoError(f"servo {servo_id} has {register.name} = {now} after a write of {raw}", servo_id=servo_id)
