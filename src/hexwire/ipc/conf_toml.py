"""The TOML form of `ipc_msg.conf`, for people who start new: a table ``[[channel]]`` for each channel.

Owns its keys. The meaning is `hexwire.ipc.channel`'s.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable

from hexwire.inputs import Item
from hexwire.inputs import parse_toml as parse_tables
from hexwire.wire.modules import IpcType

from .channel import Cell, ChannelConf, Record, interface_named, make_channels, rows_of

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
_BY_ID = ("module_name", "destination_module")
"""Columns whose value may be a number or a name."""
_MOST = 2**30 - 1
_LONGEST = 4000


def parse_toml(text: str, file: str = "") -> list[ChannelConf]:
    """Read the TOML form: a table ``[[channel]]`` for each channel.

    Keys: module, direction, destination, interface, address; where they apply port (for SERIAL: baud) and peer (for
    QUEUE: trust).

    Raises:
        ConfigError: As `parse_conf`, and for a key that is not known.
    """
    root = parse_tables(text, file).table(("channel",))
    if "channel" not in root:
        return []
    channels = root["channel"]
    if not isinstance(channels.value, list) or not all(isinstance(entry, dict) for entry in channels.value):
        raise channels.fault("must be tables [[channel]], one for each channel")
    return make_channels([_from_table(entry) for entry in channels.rows()])


def _from_table(entry: Item) -> Record:
    cells: dict[str, Cell] = {}
    for key, item in entry.table(_KEYS).items():
        column = _KEYS[key]
        number = column == "port" or (column in _BY_ID and isinstance(item.value, int))
        text = str(item.integer(0, _MOST)) if number else item.text(_LONGEST)
        if re.search(r"\s", text) or not text or text.startswith("#"):
            raise item.fault(f"must be one word, not {text[:60]!r}")
        if column in cells:
            same = [other for other, known in _KEYS.items() if known == column]
            raise item.fault(f"is one too many: {' and '.join(same)} are the same thing")
        interface = interface_named(str(entry.value.get("interface")))
        if key in ("port", "baud") and (key == "baud") != (interface is IpcType.SERIAL):
            raise item.fault("does not fit the interface: baud belongs to SERIAL, port to TCP and UDP")
        if key in ("peer", "trust") and (key == "trust") != (interface is IpcType.QUEUE):
            raise item.fault("does not fit the interface: peer belongs to UDP, trust to QUEUE")
        cells[column] = Cell(text, *item.line_and_column)
    return Record(cells, Cell("", *entry.line_and_column), entry.file)


def to_toml(channels: Iterable[ChannelConf]) -> str:
    """Write the TOML form; `parse_toml` reads the same channels back."""
    tables = []
    for row in rows_of(channels):
        # A JSON string of printable text is a TOML string.
        lines = [f"{key} = {json.dumps(value, ensure_ascii=False)}\n" for key, value in row.items()]
        tables.append("[[channel]]\n" + "".join(lines))
    return "\n".join(tables)
