"""The reference of the servo registers: a page for each series, from ``schema/registers.toml``.

Owns how a register row is shown. Must not know what the host does with it.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

__all__ = ["pages"]

FOLDER = "reference/registers"
_UNITS = {"count": "°", "degC": "°C", "percent": "%", "us": "µs", "deg_per_s": "°/s"}


def pages(schema: Path) -> dict[str, str]:
    """Page of the site -> its text.

    Args:
        schema: ``registers.toml``.
    """
    table = tomllib.loads(schema.read_text(encoding="utf-8"))
    made = {f"{FOLDER}/{name}.md": _series(name, series) for name, series in table["series"].items()}
    return {f"{FOLDER}/index.md": _index(table), **made}


def _index(table: dict[str, Any]) -> str:
    lines = [
        "# Servo registers",
        "",
        "The registers of every series that hexwire knows, as `hexwire bus read` and `hexwire bus write` name",
        'them. Python takes the same names: `bus.read(3, "present_position")`. [Servos on an',
        "adapter](../../bus.md) explains their use, and the [protocol](../../protocol.md) the packets around them.",
        "",
        "| series | servos | byte order | counts per turn | rate at delivery |",
        "|---|---|---|---|---|",
    ]
    for name, series in table["series"].items():
        turn = f"{series['counts'] * 360 / series['range_deg']:.0f}"
        order = f"{series['byte_order']}-endian"
        lines.append(f"| [`{name}`]({name}.md) | {series['title']} | {order} | {turn} | {series['baud']} |")
    lines += ["", "SMS servos, with RS-485, are delivered with a rate of 115200."]
    lines += ["", "## Codes of the rate", "", "Register `baud_code` of the Feetech series.", ""]
    lines += ["| code | baud |", "|---|---|"]
    lines += [f"| {code} | {baud} |" for code, baud in table["baud_codes"].items()]
    lines += ["", "## Instructions", ""]
    lines += ["| instruction | code | parameters | reply | note |", "|---|---|---|---|---|"]
    told = {"always": "always", "never": "never", "level": "with `status_return_level` 1"}
    for name, row in table["instructions"].items():
        note = _cell(row.get("note", ""))
        lines.append(f"| `{name}` | {row['code']:02X} | {_cell(row['params'])} | {told[row['reply']]} | {note} |")
    lines += ["", "## Error byte", "", "Bits of the error byte in a status packet.", ""]
    lines += ["| bit | fault |", "|---|---|"]
    lines += [f"| 0x{mask:02X} | {name} |" for name, mask in table["status_bits"].items()]
    return "\n".join([*lines, ""])


def _series(name: str, series: dict[str, Any]) -> str:
    lines = [
        "---",
        f"title: {name}",
        "hide: [toc]",
        "---",
        "",
        f"# {name}: {series['title']}",
        "",
        f"{series['byte_order'].capitalize()}-endian; {series['counts']} counts over {series['range_deg']:g}°,",
        f"the middle at {series['neutral']}; {series['baud']} baud at delivery.",
        f"Instructions: {', '.join(f'`{one}`' for one in series['instructions'])}.",
        "",
        "EEPROM keeps its values without power; RAM does not. A default, range or unit that is missing is unknown.",
        "The access is r for registers that are only read, rw for those that are also written.",
        "",
        "| address | register | bytes | memory | access | default | range | unit | note |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    lines += [f"| {' | '.join(_row(row))} |" for row in series["registers"]]
    return "\n".join([*lines, ""])


def _row(row: dict[str, Any]) -> list[str]:
    limits = f"{row['min']} to {row['max']}" if "min" in row and "max" in row else ""
    unit = ""
    if "unit" in row:
        name = _UNITS.get(row["unit"], row["unit"])
        unit = f"{row.get('scale', 1):.6g} {name}"
    notes = [row.get("note", "")]
    if "sign" in row:
        notes.append(f"bit {row['sign']} is the sign")
    if "bits" in row:
        notes.append(", ".join(f"bit {bit}: {meaning}" for bit, meaning in row["bits"].items()))
    return [
        str(row["at"]),
        f"`{row['name']}`",
        str(row["size"]),
        {"eeprom": "EEPROM", "ram": "RAM"}.get(row["area"], row["area"]),
        row["access"],
        str(row.get("default", "")),
        limits,
        unit,
        _cell("; ".join(note for note in notes if note)),
    ]


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("_", "\\_")
