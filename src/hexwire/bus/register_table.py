"""The registers of a servo as a table for people: raw and SI values, ranges, and what differs from what.

Owns the rows and how all registers are read in few requests. A row is plain data, which the command line prints and
a page shows. Must not know either, nor how a register is changed (`register_edits`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from hexwire.errors import ServoError
from hexwire.wire.registers import Register, Series

from .servo_bus import ServoBus

__all__ = ["TableRow", "make_table", "people_unit", "read_table"]

_FROM_DEGREES = math.pi / 180.0


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
