"""The TOML form of `ipc_msg.conf`, for people who start new: a table ``[[channel]]`` for each channel.

Owns its keys and where in the text each value stands. The meaning is `hexwire.ipc.channel`'s.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping

from hexwire.errors import ConfigError
from hexwire.inputs import parse_toml as parse_tables
from hexwire.wire.modules import IpcType

from .channel import Cell, ChannelConf, Record, make_channels, rows_of

__all__ = ["parse_toml", "to_toml"]

# Key -> column. A serial port's rate and the user whose queue is trusted have names of their own here.
_KEYS = {
    "module": "module_name",
    "direction": "direction",
    "destination": "destination_module",
    "interface": "interface",
    "address": "address",
    "port": "port",
    "baud": "port",
    "peer": "peer",
    "trust": "peer",
}


def parse_toml(text: str, file: str = "") -> list[ChannelConf]:
    """Read the TOML form: a table ``[[channel]]`` for each channel.

    Keys: module, direction, destination, interface, address; where they apply port (for SERIAL: baud) and peer (for
    QUEUE: trust).

    Raises:
        ConfigError: As `parse_conf`, and for a key that is not known.
    """
    tables = parse_tables(text, file).value
    for name in tables:
        if name != "channel":
            line = _line_of(text, name)
            raise ConfigError(
                f"unknown key {name[:60]!r}; known: channel", file=file, line=line, column=1 if line else 0
            )
    entries = tables.get("channel", [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        line = _line_of(text, "channel")
        raise ConfigError("write each channel as a table [[channel]]", file=file, line=line, column=1)
    places = _key_places(text, len(entries))
    return make_channels([_from_table(entry, place, file) for entry, place in zip(entries, places, strict=True)])


def _line_of(text: str, key: str) -> int:
    """The first line that begins with a key or the header of its table; 0 if none does."""
    begins = (line.strip().lstrip("[").lstrip().strip("\"'") for line in text.split("\n"))
    return next((number for number, begin in enumerate(begins, 1) if begin.startswith(key)), 0)


def _key_places(text: str, count: int) -> list[Callable[[str, str], Cell]]:
    """For each channel a way to make a cell of a key's value, placed by the lines under its header."""
    lines = text.split("\n")
    headers = [number for number, line in enumerate(lines, 1) if re.match(r"\s*\[\[\s*channel\s*\]\]", line)]
    if len(headers) != count:  # written inline: the parser does not tell where
        return [lambda key, value: Cell(value, 0, 0)] * count

    ends = [*headers, len(lines) + 1][1:]

    def placer(first: int, last: int) -> Callable[[str, str], Cell]:
        def place(key: str, value: str) -> Cell:
            for number in range(first, last):
                name, equals, rest = lines[number - 1].partition("=")
                if equals and name.strip().strip("\"'") == key:
                    return Cell(value, number, len(name) + len(rest) - len(rest.lstrip()) + 2)
            return Cell(value, first, 1)

        return place

    return [placer(first, last) for first, last in zip(headers, ends, strict=True)]


def _from_table(entry: Mapping[str, object], place: Callable[[str, str], Cell], file: str) -> Record:
    cells: dict[str, Cell] = {}
    record = Record(cells, place("", ""), file)
    for key, value in entry.items():
        cell = place(key, str(value))

        def fault(message: str, cell: Cell = cell) -> ConfigError:
            return ConfigError(message, file=file, line=cell.line, column=cell.column)

        if key not in _KEYS:
            raise fault(f"unknown key {key[:60]!r}; known: {', '.join(_KEYS)}")
        if type(value) is not (int if _KEYS[key] == "port" else str):
            kind = "a number" if _KEYS[key] == "port" else "a text"
            raise fault(f"{key} must be {kind}, not {value!r:.60}")
        if re.search(r"\s", cell.text) or not cell.text or cell.text.startswith("#"):
            raise fault(f"{key} must be one word, not {cell.text[:60]!r}")
        if _KEYS[key] in cells:
            same = [other for other, column in _KEYS.items() if column == _KEYS[key]]
            raise fault(f"{' and '.join(same)} are the same thing: give one")
        if key in ("port", "baud") and (key == "baud") != (entry.get("interface") == IpcType.SERIAL.name):
            raise fault("baud belongs to SERIAL, port to TCP and UDP")
        if key in ("peer", "trust") and (key == "trust") != (entry.get("interface") == IpcType.QUEUE.name):
            raise fault("peer belongs to UDP, trust to QUEUE")
        cells[_KEYS[key]] = cell
    return record


def to_toml(channels: Iterable[ChannelConf]) -> str:
    """Write the TOML form; `parse_toml` reads the same channels back."""
    tables = []
    for row in rows_of(channels):
        # A JSON string of printable text is a TOML string.
        lines = [f"{key} = {json.dumps(value, ensure_ascii=False)}\n" for key, value in row.items()]
        tables.append("[[channel]]\n" + "".join(lines))
    return "\n".join(tables)
