"""Writes the tables of PROTOCOL.md between their marks.

A block starts with ``<!-- generated:NAME -->`` and ends with ``<!-- /generated -->``; what is between is
replaced.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from load import INTEGER_SIZES, Schema, SchemaError, body_rows

BLOCK = re.compile(r"(<!-- generated:([a-z_]+) -->\n).*?(<!-- /generated -->)", re.DOTALL)


def table(head: tuple[str, ...], rows: list[tuple[Any, ...]]) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(_cell(cell) for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def _cell(value: Any) -> str:
    return "" if value is None else str(value).replace("|", "\\|")


def commands(schema: Schema) -> str:
    """Name, code and meaning of every command."""
    entries = schema.commands["commands"].items()
    return table(("command", "code", "does"), [(f"`{n}`", f"{e['code']:02X}", e["doc"]) for n, e in entries])


def _layout(entry: dict[str, Any], part: str) -> str:
    rows, count = body_rows(entry, part)
    fields = entry[part]
    text = ", ".join(_field(field) for field in fields) or ("" if rows else "empty")
    if rows:
        each = ", ".join(_field(field) for field in rows)
        known = any(field[0] == count for field in fields)
        text += (", then " if text else "") + (f"`{count}` times" if known else "to the end") + f" ({each})"
    return text


def _field(field: list[str]) -> str:
    return f"{field[0]} {field[1]}" + (" if asked" if len(field) > 2 else "")


def _size(entry: dict[str, Any], part: str) -> str:
    rows, _ = body_rows(entry, part)
    fixed = sum(INTEGER_SIZES.get(field[1], 0) for field in entry[part])
    each = [sum(INTEGER_SIZES[field[1]] for field in rows if len(field) == 2 or full) for full in (False, True)]
    text = str(fixed)
    if rows:
        text += f" + {each[0]}n" if each[0] == each[1] else f" + {each[0]}..{each[1]} n"
    if any(field[1] == "bytes" for field in entry[part]):
        text = f"{text} + n" if fixed else "n"
    return text


def bodies(schema: Schema) -> str:
    """Layout of every request and reply."""
    rows = [
        (f"`{name}`", part, _size(entry, part), _layout(entry, part))
        for name, entry in schema.commands["commands"].items()
        for part in ("request", "reply")
    ]
    return table(("command", "part", "bytes", "fields, little-endian"), rows)


def codes(schema: Schema) -> str:
    """Status codes and the bits of every mask."""
    titles = {
        "status": "status code",
        "servo_flags": "servo status bit",
        "board_flags": "board flag",
        "state_fields": "state field",
        "capabilities": "capability",
        "series": "series code",
        "trajectory_states": "trajectory state",
        "trajectory_flags": "trajectory flag",
        "robot_flags": "robot flag",
        "robot_modes": "robot mode",
    }
    parts = []
    for key, title in titles.items():
        spell = "{}" if key in ("status", "series", "trajectory_states", "robot_modes") else "0x{:02X}"
        rows = [(f"`{name}`", spell.format(value)) for name, value in schema.commands[key].items()]
        parts.append(table((title, "value"), rows))
    return "\n".join(parts)


def _range(row: dict[str, Any]) -> str:
    low, high = row.get("min"), row.get("max")
    return "" if low is None and high is None else f"{'?' if low is None else low}..{'?' if high is None else high}"


def registers(schema: Schema) -> str:
    """One table a series."""
    parts = []
    head = ("address", "name", "bytes", "area", "access", "default", "range", "unit", "sign bit", "notes")
    for name, series in schema.registers["series"].items():
        rows = []
        for row in series["registers"]:
            unit = row.get("unit")
            if unit == "count":
                unit = f"count, {row['scale']} deg"
            elif unit is not None and row["scale"] != 1:
                unit = f"{row['scale']} {unit}"
            bits = ", ".join(f"{bit} {text}" for bit, text in row.get("bits", {}).items())
            notes = "; ".join(part for part in (row.get("note"), bits and f"bits: {bits}") if part)
            default = row.get("default")
            cells = (row["at"], f"`{row['name']}`", row["size"], row["area"], row["access"])
            rows.append((*cells, default, _range(row), unit, row.get("sign"), notes))
        order = f"{series['byte_order']}-endian, {series['counts']} counts over {series['range_deg']:g} degrees"
        parts.append(
            f"**`{name}`**: {series['title']}; {order}, neutral {series['neutral']}.\n\n" + table(head, rows)
        )
    return "\n".join(parts)


BLOCKS: dict[str, Callable[[Schema], str]] = {
    "commands": commands,
    "bodies": bodies,
    "codes": codes,
    "registers": registers,
}


def fill(text: str, schema: Schema) -> str:
    """The document with every marked block renewed.

    Raises:
        SchemaError: A mark names a block that does not exist.
    """

    def renew(match: re.Match[str]) -> str:
        name = match[2]
        if name not in BLOCKS:
            raise SchemaError(f"PROTOCOL.md: no generated block {name}; known: {', '.join(BLOCKS)}")
        return f"{match[1]}{BLOCKS[name](schema)}{match[3]}"

    return BLOCK.sub(renew, text)
