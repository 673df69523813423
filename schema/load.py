"""Reads the three schema files and checks them.

Owns what a valid schema is: no overlapping registers, widths and sign bits that fit, unique names and codes,
defaults inside their range. Knows nothing of what is written from it.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent

INTEGER_SIZES = {"u8": 1, "i8": 1, "u16": 2, "i16": 2, "u32": 4, "i32": 4}
ROW_KEYS = {
    "at",
    "name",
    "size",
    "area",
    "access",
    "default",
    "min",
    "max",
    "unit",
    "scale",
    "sign",
    "bits",
    "note",
}
UNITS = {
    None,
    "count",
    "count/s",
    "count/s^2",
    "ms",
    "us",
    "mA",
    "V",
    "degC",
    "percent",
    "percent PWM",
    "percent PWM duty",
}


CODE_TABLES = (
    "status",
    "series",
    "servo_flags",
    "board_flags",
    "capabilities",
    "state_fields",
    "trajectory_states",
    "trajectory_flags",
    "robot_flags",
    "robot_modes",
)


class SchemaError(Exception):
    """The schema contradicts itself; the text is one line that names file and row."""


@dataclass(frozen=True)
class Schema:
    """The parsed files, as plain tables."""

    session: dict[str, Any]
    commands: dict[str, Any]
    registers: dict[str, Any]


def load(folder: Path = HERE) -> Schema:
    """Read and check ``session.toml``, ``commands.toml`` and ``registers.toml``.

    Raises:
        SchemaError: A file is missing, is no TOML, or contradicts itself.
    """
    tables = []
    for name in ("session.toml", "commands.toml", "registers.toml"):
        try:
            tables.append(tomllib.loads((folder / name).read_text(encoding="utf-8")))
        except OSError as error:
            raise SchemaError(f"{name}: cannot be read ({error.strerror})") from error
        except tomllib.TOMLDecodeError as error:
            raise SchemaError(f"{name}: {error}") from error
    schema = Schema(*tables)
    check_session(schema.session)
    check_commands(schema.commands)
    check_registers(schema.registers)
    missing = set(schema.registers["series"]) - set(schema.commands["series"])
    if missing:
        raise SchemaError(f"commands.toml: [series] has no code for {', '.join(sorted(missing))}")
    return schema


def _unique(where: str, values: dict[str, Any]) -> None:
    seen: dict[Any, str] = {}
    for name, value in values.items():
        if value in seen:
            raise SchemaError(f"{where}: {name} and {seen[value]} are both {value}")
        seen[value] = name


def check_session(session: dict[str, Any]) -> None:
    """Check that the header fields fill the header without gap or overlap."""
    end = 0
    for name, kind, offset in session["header"]["fields"]:
        if kind not in INTEGER_SIZES:
            raise SchemaError(f"session.toml: header field {name}: unknown type {kind}")
        if offset != end:
            raise SchemaError(f"session.toml: header field {name}: at {offset}, but the field before ends at {end}")
        end += INTEGER_SIZES[kind]
    if end != session["header"]["size"]:
        raise SchemaError(f"session.toml: header fields end at {end}, size says {session['header']['size']}")
    for table in ("modules", "channels"):
        _unique(f"session.toml: [{table}]", session[table])
    bits = session["addresses"]["multicast_modules"]
    if session["addresses"]["multicast"] >> bits != 1 or bits > 30:
        raise SchemaError("session.toml: [addresses] multicast is not the bit above those of its modules")
    if max(session["modules"].values()) >= bits:
        raise SchemaError(f"session.toml: [modules] has an id above {bits - 1}, which multicast cannot name")


def check_commands(commands: dict[str, Any]) -> None:
    """Check codes, masks and body layouts."""
    for table in CODE_TABLES:
        _unique(f"commands.toml: [{table}]", commands[table])
    _unique("commands.toml", {name: entry["code"] for name, entry in commands["commands"].items()})
    for name, entry in commands["commands"].items():
        for part in ("request", "reply"):
            rows, count = body_rows(entry, part)
            where = f"commands.toml: {name} {part}"
            names = [field[0] for field in entry[part]]
            if len(set(names)) != len(names):
                raise SchemaError(f"{where}: a field name occurs twice")
            for field in [*entry[part], *rows]:
                _check_field(where, field, commands)
            if any(field[1] == "bytes" for field in [*entry[part][:-1], *rows]):
                raise SchemaError(f"{where}: only the last field may be bytes")
            if rows and count is None:
                raise SchemaError(f"{where}: rows without a count")
            if count is not None and count not in names and entry[part]:
                raise SchemaError(f"{where}: the count field {count} is not in the body")


def _check_field(where: str, field: list[str], commands: dict[str, Any]) -> None:
    name, kind = field[0], field[1]
    if kind != "bytes" and kind not in INTEGER_SIZES:
        raise SchemaError(f"{where}: field {name}: unknown type {kind}")
    if len(field) > 2 and field[2] not in commands["state_fields"]:
        raise SchemaError(f"{where}: field {name}: {field[2]} is not in [state_fields]")


def body_rows(entry: dict[str, Any], part: str) -> tuple[list[list[str]], str | None]:
    """The repeated fields of a request or reply, and the name of the field that counts them."""
    prefix = "request_" if part == "request" else ""
    return entry.get(f"{prefix}rows", []), entry.get(f"{prefix}count")


def check_registers(registers: dict[str, Any]) -> None:
    """Check instructions and every row of every series."""
    codes = {name: entry["code"] for name, entry in registers["instructions"].items()}
    _unique("registers.toml: [instructions]", codes)
    for series, table in registers["series"].items():
        unknown = set(table["instructions"]) - set(codes)
        if unknown:
            raise SchemaError(f"registers.toml: {series}: unknown instruction {', '.join(sorted(unknown))}")
        check_rows(series, table["registers"])


def check_rows(series: str, rows: list[dict[str, Any]]) -> None:
    """Check one series' register rows.

    Raises:
        SchemaError: Names the series, the register and what is wrong with it.
    """
    names: set[str] = set()
    owner: dict[int, str] = {}
    for row in rows:
        where = f"registers.toml: {series}.{row.get('name', '?')}"
        unknown = set(row) - ROW_KEYS
        if unknown:
            raise SchemaError(f"{where}: unknown key {', '.join(sorted(unknown))}")
        if row["name"] in names:
            raise SchemaError(f"{where}: the name occurs twice")
        names.add(row["name"])
        if row["size"] not in (1, 2):
            raise SchemaError(f"{where}: size {row['size']} is not 1 or 2 bytes")
        for address in range(row["at"], row["at"] + row["size"]):
            if address in owner:
                raise SchemaError(f"{where}: overlaps {owner[address]} at address {address}")
            if not 0 <= address <= 255:
                raise SchemaError(f"{where}: address {address} is not a byte")
            owner[address] = row["name"]
        _check_row_values(where, row)


def _check_row_values(where: str, row: dict[str, Any]) -> None:
    if row["area"] not in ("eeprom", "ram", "factory"):
        raise SchemaError(f"{where}: unknown area {row['area']}")
    if row["access"] not in ("r", "rw"):
        raise SchemaError(f"{where}: access {row['access']} is not r or rw")
    if row.get("unit") not in UNITS:
        raise SchemaError(f"{where}: unknown unit {row['unit']}")
    if ("unit" in row) != ("scale" in row):
        raise SchemaError(f"{where}: unit and scale belong together")
    width = 8 * row["size"]
    sign = row.get("sign")
    if sign is not None and not 0 < sign < width:
        raise SchemaError(f"{where}: sign bit {sign} is outside its {width} bits")
    low, high = (0, (1 << width) - 1) if sign is None else (1 - (1 << sign), (1 << sign) - 1)
    minimum, maximum = row.get("min", low), row.get("max", high)
    if not low <= minimum <= maximum <= high:
        raise SchemaError(f"{where}: range {minimum}..{maximum} does not fit its coding ({low}..{high})")
    default = row.get("default")
    if default is not None and not minimum <= default <= maximum:
        raise SchemaError(f"{where}: default {default} is outside {minimum}..{maximum}")
    for bit in row.get("bits", {}):
        if not 0 <= int(bit) < width:
            raise SchemaError(f"{where}: bit {bit} is outside its {width} bits")
