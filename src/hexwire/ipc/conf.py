"""`ipc_msg.conf`: the modules and the channels between them, as the chapter writes them or as TOML.

Owns the columns of one form, the keys of the other, the choice between the two, and the address of a channel in
such a file: ``conf:///etc/ipc_msg.conf?module=NAME``, or the file's path. `hexwire.ipc.channel` owns the meaning of
a channel, `hexwire.link` makes the link.

Its format (PROTOCOL.md, the section on `ipc_msg.conf`)::

    # module_name   direction   destination_module  interface  address         [port]
    ARM_7BOT_SERIAL_TRX  CLIENT_TRX  ARM_7BOT_ARDUINO_TRX  SERIAL  /dev/ttyUSB0  115200

A record starts in the first column and continues on indented lines; so does a comment. Modules may be given by id,
and interfaces by the names there, such as IPC_SERIAL_PORT. For SERIAL the port number is the baud rate. A UDP
server that is not on loopback names the host it accepts in one more column.

In TOML, for people who start new, each channel is a table ``[[channel]]``.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from hexwire.errors import ConfigError, UsageError
from hexwire.inputs import Item, read_text
from hexwire.inputs import parse_toml as parse_tables
from hexwire.wire.modules import IpcType, ModuleType, module_name, module_named

from .channel import (
    COLUMNS,
    NEEDED,
    Cell,
    ChannelConf,
    ChannelDirection,
    Record,
    interface_named,
    link_url,
    make_channels,
    module_by_text,
    rows_of,
)

if TYPE_CHECKING:
    from hexwire.link.base import Link
    from hexwire.link.url import LinkUrl

__all__ = [
    "ChannelConf",
    "ChannelDirection",
    "channel_of",
    "conf_parts",
    "device_url",
    "link_url",
    "load_conf",
    "make_conf_link",
    "parse_conf",
    "parse_toml",
    "to_conf",
    "to_toml",
]

_TRUST = "trust="
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


def parse_conf(text: str, file: str = "") -> list[ChannelConf]:
    """Parse the format of `ipc_msg.conf`.

    Args:
        text: Contents of the file.
        file: Its name, for errors.

    Raises:
        ConfigError: With file, line and column: an unknown name, a bad address or port, an unexpected word, a
            record that ends early, two channels that exclude each other.
    """
    records: list[list[Cell]] = []
    open_record: list[Cell] | None = None
    after_comment = False
    for number, line in enumerate(text.split("\n"), 1):
        if not line.strip():
            open_record, after_comment = None, False
            continue
        cells = _cells(line, number)
        if not cells:
            # A comment line ends nothing: it may be inside a record.
            after_comment = True
        elif not line[0].isspace():
            open_record, after_comment = cells, False
            records.append(cells)
        elif open_record is not None and (not after_comment or len(open_record) < NEEDED):
            open_record.extend(cells)
        elif after_comment and module_named(cells[0].text) is None:
            pass  # the comment continues, as in the printed file
        else:
            raise ConfigError(
                "an indented line continues a record, but there is none; start the line in the first column",
                file=file,
                line=number,
                column=cells[0].column,
            )
    return make_channels([_from_columns(cells, file) for cells in records])


def _cells(line: str, number: int) -> list[Cell]:
    code = re.split(r"(?:^|(?<=\s))#", line, maxsplit=1)[0]
    return [Cell(found[0], number, found.start() + 1) for found in re.finditer(r"\S+", code)]


def _from_columns(cells: list[Cell], file: str) -> Record:
    named = dict(zip(COLUMNS, cells, strict=False))
    port = named.get("port")
    if (
        port is not None
        and interface_named(named["interface"].text) is IpcType.QUEUE
        and port.text.startswith(_TRUST)
    ):
        # A queue has no port; this column may name a trusted user instead.
        named.pop("port")
        named["peer"] = Cell(port.text.removeprefix(_TRUST), port.line, port.column + len(_TRUST))
    record = Record(named, cells[0], file)
    if len(cells) > len(COLUMNS):
        extra = cells[len(COLUMNS)]
        raise ConfigError(f"unexpected word {extra.text!r}", file=file, line=extra.line, column=extra.column)
    return record


def load_conf(path: str | Path) -> list[ChannelConf]:
    """Read a configuration file in either format.

    A file is TOML if its name ends in ``.toml`` or its first line that is not empty or a comment starts with ``[``.

    Raises:
        ConfigError: The file cannot be read or is wrong.
    """
    file = str(path)
    text = read_text(path)
    lines = (line.strip() for line in text.split("\n"))
    first = next((line for line in lines if line and not line.startswith("#")), "")
    is_toml = Path(path).suffix == ".toml" or first.startswith("[")
    return parse_toml(text, file) if is_toml else parse_conf(text, file)


def to_conf(channels: Iterable[ChannelConf]) -> str:
    """Write the format of `ipc_msg.conf`; `parse_conf` reads the same channels back."""
    table = [["# module_name", *COLUMNS[1:5], "[port]"]]
    table += [
        [f"{_TRUST}{value}" if key == "trust" else str(value) for key, value in row.items()]
        for row in rows_of(channels)
    ]
    widths = [max(len(row[i]) for row in table if i < len(row)) for i in range(max(map(len, table)))]
    lines = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=False)) for row in table)
    return "".join(f"{line.rstrip()}\n" for line in lines)


def parse_toml(text: str, file: str = "") -> list[ChannelConf]:
    """Read the TOML form: a table ``[[channel]]`` for each channel.

    Keys: module, direction, destination, interface, address; where they apply port (for SERIAL: baud) and peer (for
    QUEUE: trust).

    Raises:
        ConfigError: As `parse_conf`, and for a key that is not known.
    """
    root = parse_tables(text, file).table((), ("channel",))
    if "channel" not in root:
        return []
    channels = root["channel"]
    if not isinstance(channels.value, list) or not all(isinstance(entry, dict) for entry in channels.value):
        raise channels.fault("must be tables [[channel]], one for each channel")
    return make_channels([_from_table(entry) for entry in channels.rows()])


def _from_table(entry: Item) -> Record:
    cells: dict[str, Cell] = {}
    for key, item in entry.table((), _KEYS).items():
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


def conf_parts(url: LinkUrl, default: ModuleType = ModuleType.ARM_7BOT_SERIAL_TRX) -> tuple[Path, ModuleType]:
    """The file that an address names, and our module in it.

    Raises:
        UsageError: The address names no file, or an unknown module.
    """
    url.check_keys(("module",))
    file = f"{url.netloc}{url.path}"
    if not file:
        raise UsageError(f"{url.text}: the file is missing, as in conf:///etc/ipc_msg.conf")
    text = url.query.get("module")
    if text is None:
        return Path(file), default
    module = module_by_text(text)
    if module is None:
        raise UsageError(f"{url.text}: unknown module {text!r}")
    return Path(file), module


def channel_of(file: Path, module: ModuleType) -> ChannelConf:
    """The channel of a module.

    Raises:
        ConfigError: The file cannot be read, is wrong, or does not name this module.
    """
    channels = load_conf(file)
    for channel in channels:
        if channel.module == module:
            return channel
    named = ", ".join(sorted({module_name(c.module) for c in channels})) or "none"
    raise ConfigError(f"there is no channel for {module_name(module)}; the file has {named}", file=str(file))


def device_url(port: str) -> LinkUrl:
    """The address of the link itself: of the channel, if `port` names one in a configuration file.

    Raises:
        UsageError: As `parse_url` and `conf_parts`.
        ConfigError: As `channel_of`.
    """
    from hexwire.link.url import parse_url

    url = parse_url(port)
    return parse_url(link_url(channel_of(*conf_parts(url)))) if url.scheme == "conf" else url


def make_conf_link(url: LinkUrl) -> Link:
    """Make the link of a channel; for `hexwire.link.open.make_link`.

    A bare link carries bytes both ways: a servo bus, or a board behind a gateway, is asked and answers. A `Session`
    keeps the direction itself.

    Raises:
        UsageError: As `conf_parts`.
        ConfigError: As `channel_of`, or the channel goes one way only.
    """
    from hexwire.link.open import build_link

    file, module = conf_parts(url)
    channel = channel_of(file, module)
    if not (channel.direction.sends and channel.direction.receives):
        raise ConfigError(
            f"{module_name(module)} is {channel.direction.value}, but what is there is asked and answers; "
            f"write {channel.direction.side}_TRX",
            file=str(file),
            line=channel.line,
            column=1,
        )
    return build_link(link_url(channel))
