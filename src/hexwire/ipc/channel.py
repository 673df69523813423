"""One channel of `ipc_msg.conf`: its fields, their validation, and the link it needs.

Owns the meaning shared by both formats of the file, the wording of its errors, and the module types that other
packages add through the entry-point group ``hexwire.modules``: the value of an entry point is an `IntEnum`, or a
mapping from name to id. Must not know the file formats, nor open a link.
"""

from __future__ import annotations

import enum
import ipaddress
import re
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from urllib.parse import quote

from hexwire.errors import ConfigError, UsageError
from hexwire.extras import installed
from hexwire.link.url import is_loopback
from hexwire.wire.modules import MAX_MODULE, IpcType, ModuleType, known_modules, module_named, register_module

__all__ = [
    "ENTRY_POINT_GROUP",
    "Cell",
    "ChannelConf",
    "ChannelDirection",
    "Record",
    "interface_named",
    "link_url",
    "load_own_modules",
    "make_channels",
    "module_by_text",
    "rows_of",
]

ENTRY_POINT_GROUP = "hexwire.modules"
DEFAULT_BAUD = 115200
COLUMNS = ("module_name", "direction", "destination_module", "interface", "address", "port", "peer")
NEEDED = 5
_HOST = re.compile(r"(?!-)[A-Za-z0-9_-]{1,63}(?:\.(?!-)[A-Za-z0-9_-]{1,63})*")
_QUEUE = re.compile(r"/?[A-Za-z0-9_.-]{1,200}")
_USER = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,31}")


def load_own_modules() -> None:
    """Register the modules of all installed packages. It takes time only at the first call.

    Raises:
        UsageError: A package names something else, or an id or a name that another module has.
    """
    _load_modules(tuple(sys.path))


@cache
def _load_modules(path: tuple[str, ...]) -> None:
    for point in installed(ENTRY_POINT_GROUP):
        found = point.load()
        if isinstance(found, type) and issubclass(found, enum.Enum):
            found = {name: member.value for name, member in found.__members__.items()}
        if not isinstance(found, Mapping):
            raise UsageError(
                f"entry point {point.value!r} of {ENTRY_POINT_GROUP} is neither an enumeration nor a mapping"
            )
        for name, number in found.items():
            register_module(str(name), number)


def module_by_text(text: str) -> ModuleType | None:
    """The module that a file names, by name or by id; None if there is none.

    Raises:
        UsageError: A package with modules of its own is wrong.
    """
    if re.fullmatch(r"[0-9]{1,10}", text):
        return ModuleType(int(text)) if int(text) <= MAX_MODULE else None
    if module_named(text) is None:
        load_own_modules()
    return module_named(text)


def interface_named(text: str) -> IpcType | None:
    """The interface of a name, ``TCP`` or the chapter's ``IPC_TCP_SOCKET``; None if there is none."""
    return IpcType.__members__.get(text)


class ChannelDirection(enum.Enum):
    """Which side opens the channel, and in which direction it carries data."""

    CLIENT_TX = "CLIENT_TX"
    CLIENT_RX = "CLIENT_RX"
    CLIENT_TRX = "CLIENT_TRX"
    SERVER_TX = "SERVER_TX"
    SERVER_RX = "SERVER_RX"
    SERVER_TRX = "SERVER_TRX"

    @property
    def is_server(self) -> bool:
        """Whether the module listens."""
        return self.side == "SERVER"

    @property
    def side(self) -> str:
        """Which side the module is: ``CLIENT`` or ``SERVER``."""
        return self.value.partition("_")[0]

    @property
    def sends(self) -> bool:
        """Whether the module sends on this channel."""
        return self.value.endswith(("_TX", "_TRX"))

    @property
    def receives(self) -> bool:
        """Whether the module receives on this channel."""
        return self.value.endswith(("_RX", "_TRX"))


@dataclass(frozen=True)
class ChannelConf:
    """One channel of the file.

    Attributes:
        module: The module that owns the channel; the file names it by name or id.
        direction: Client or server; sends, receives or both.
        destination: The module at the other end.
        interface: Queue, TCP, UDP or serial.
        address: Host, device path or queue name; for a server the address to bind.
        port: TCP or UDP port; baud rate of a serial port; None for a queue.
        peer: Host that a UDP server accepts; user whose queue is trusted besides this user's own; otherwise empty.
        line: Line of the file where it starts; 0 if it does not come from a file. Ignored in comparisons.
    """

    module: ModuleType
    direction: ChannelDirection
    destination: ModuleType
    interface: IpcType
    address: str
    port: int | None = None
    peer: str = ""
    line: int = field(default=0, compare=False)


@dataclass(frozen=True)
class Cell:
    """A word of the file and its line and column, both from 1."""

    text: str
    line: int
    column: int


class Record:
    """The words of one channel by column name; all errors about them are made here."""

    def __init__(self, cells: Mapping[str, Cell], start: Cell, file: str) -> None:
        self.cells = cells
        self.start = start
        self.file = file

    def error(self, column: str, message: str) -> ConfigError:
        cell = self.cells.get(column, self.start)
        return ConfigError(message, file=self.file, line=cell.line, column=cell.column)

    def text(self, column: str) -> str:
        return self.cells[column].text if column in self.cells else ""

    def one_of(self, column: str, known: Iterable[str]) -> str:
        text, names = self.text(column), list(known)
        if text not in names:
            raise self.error(column, f"unknown {column} {text!r}; known: {', '.join(names)}")
        return text

    def module(self, column: str) -> ModuleType:
        text = self.text(column)
        found = module_by_text(text)
        if found is None:
            names = ", ".join(module.name for module in known_modules())
            raise self.error(column, f"unknown {column} {text!r}; known: {names}, and ids from 0 to {MAX_MODULE}")
        return found

    def host(self, column: str) -> str:
        text = self.text(column)
        if _is_address(text):
            return text
        if not _HOST.fullmatch(text) or re.fullmatch(r"[0-9.]+", text):
            raise self.error(column, f"bad {column} {text!r}: neither an IP address nor a host name")
        return text

    def number(self, column: str, what: str, low: int, high: int) -> int:
        text = self.text(column)
        if not re.fullmatch(r"[0-9]{1,9}", text) or not low <= int(text) <= high:
            raise self.error(column, f"bad {what} {text!r}: a number from {low} to {high} is needed")
        return int(text)

    def channel(self) -> ChannelConf:
        for column in COLUMNS[:NEEDED]:
            if column not in self.cells:
                raise self.error(
                    "", f"the record ends before its {column}; columns: {' '.join(COLUMNS[:5])} [port]"
                )
        module = self.module("module_name")
        direction = ChannelDirection(self.one_of("direction", (member.value for member in ChannelDirection)))
        destination = self.module("destination_module")
        interface = IpcType[self.one_of("interface", IpcType.__members__)]
        address, port, peer = self._endpoint(interface, direction)
        return ChannelConf(module, direction, destination, interface, address, port, peer, self.start.line)

    def _endpoint(self, interface: IpcType, direction: ChannelDirection) -> tuple[str, int | None, str]:
        """Address, port and peer, as the interface requires."""
        listens = interface is IpcType.UDP and direction.is_server
        if "peer" in self.cells and not listens and interface is not IpcType.QUEUE:
            raise self.error("peer", f"unexpected word {self.text('peer')!r}: only a UDP server names its peer")
        if interface is IpcType.QUEUE:
            name = self.text("address")
            if not _QUEUE.fullmatch(name):
                raise self.error("address", f"bad address {name!r}: a queue is named by letters, digits, . _ and -")
            if "port" in self.cells:
                raise self.error("port", f"a queue has no port; unexpected word {self.text('port')!r}")
            if "peer" in self.cells and not _USER.fullmatch(self.text("peer")):
                raise self.error("peer", f"bad user {self.text('peer')!r}: trust takes the name of one user")
            return name, None, self.text("peer")
        if interface is IpcType.SERIAL:
            if direction.is_server:
                ways = direction.value.partition("_")[2]
                raise self.error(
                    "direction", f"a serial port has no server: write CLIENT_{ways} at both ends of the line"
                )
            device = self.text("address")
            if not device.startswith("/") or device.endswith("/") or not device.isprintable():
                raise self.error("address", f"bad address {device!r}: a device path such as /dev/ttyUSB0 is needed")
            baud = self.number("port", "baud rate", 50, 12_000_000) if "port" in self.cells else DEFAULT_BAUD
            return device, baud, ""
        host = self.host("address")
        if "port" not in self.cells:
            raise self.error("", f"the record ends before its port; {interface.name} needs one")
        port = self.number("port", "port", 1, 65535)
        peer = self.host("peer") if "peer" in self.cells else ""
        if listens and not peer and not is_loopback(host):
            raise self.error(
                "address",
                f"a UDP server on {host} must name the host it accepts, in a column after the port",
            )
        return host, port, peer


def _is_address(text: str) -> bool:
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return False
    return True


def make_channels(records: list[Record]) -> list[ChannelConf]:
    """Create the channels and check them against each other."""
    channels: list[ChannelConf] = []
    taken: dict[tuple[object, ...], ChannelConf] = {}
    for record in records:
        channel = record.channel()
        claims: list[tuple[str, tuple[object, ...], str]] = [
            ("module_name", ("module", channel.module), f"{channel.module.name} has a channel")
        ]
        if channel.interface is IpcType.SERIAL:
            claims.append(("address", ("port", channel.address), f"{channel.address} is in use"))
        elif channel.direction.is_server:
            where = channel.address if channel.port is None else f"{channel.address} port {channel.port}"
            claims.append(("address", (channel.interface, where), f"{where} has a server"))
        for column, claim, what in claims:
            if claim in taken:
                raise record.error(column, f"duplicate: {what} already, in line {taken[claim].line}")
            taken[claim] = channel
        channels.append(channel)
    return channels


def link_url(channel: ChannelConf) -> str:
    """URL of the link that a channel needs, for `make_link`."""
    listen = channel.direction.is_server
    if channel.interface is IpcType.SERIAL:
        return f"serial://{quote(channel.address)}?baud={channel.port}"
    if channel.interface is IpcType.QUEUE:
        options = (["role=server"] if listen else []) + ([f"trust={channel.peer}"] if channel.peer else [])
        return f"mq:///{channel.address.removeprefix('/')}" + ("?" if options else "") + "&".join(options)
    host = f"[{channel.address}]" if ":" in channel.address else channel.address
    if channel.interface is IpcType.TCP:
        return f"{'tcp-listen' if listen else 'tcp'}://{host}:{channel.port}"
    peer = f"[{channel.peer}]" if ":" in channel.peer else channel.peer
    return f"{'udp-listen' if listen else 'udp'}://{host}:{channel.port}" + (f"?peer={peer}" if peer else "")


def rows_of(channels: Iterable[ChannelConf]) -> list[dict[str, str | int]]:
    """The fields of each channel in order, by their TOML keys, for the writers of both formats."""
    rows = []
    for channel in channels:
        row: dict[str, str | int] = {
            "module": channel.module.name,
            "direction": channel.direction.value,
            "destination": channel.destination.name,
            "interface": channel.interface.name,
            "address": channel.address,
        }
        if channel.port is not None:
            row["baud" if channel.interface is IpcType.SERIAL else "port"] = channel.port
        if channel.peer:
            row["trust" if channel.interface is IpcType.QUEUE else "peer"] = channel.peer
        rows.append(row)
    return rows
