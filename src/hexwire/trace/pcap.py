"""Capture files of Wireshark: writes pcapng with the direction of every transfer, reads pcapng and pcap.

Owns the two file formats. Must not know what the bytes mean.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from typing import BinaryIO, Literal, NamedTuple

from hexwire.link.tap import Direction, Passed

__all__ = ["USER0", "guess", "is_pcap", "read_pcap", "write_pcapng"]

USER0 = 147
"""Link type (DLT_USER0) of captures of a serial line; analyzers/wireshark decodes it."""

_SNAP = 0x40000
_NSEC = 1_000_000_000
_SECTION, _INTERFACE, _PACKET = 0x0A0D0D0A, 1, 6
_OPT_END, _OPT_COMMENT, _OPT_IF_NAME, _OPT_FLAGS, _OPT_IF_TSRESOL = 0, 1, 2, 2, 9
_OPT_IF_TSOFFSET = 14
_SIMPLE_PACKET = 3
_MAGIC = 0x1A2B3C4D
_CLASSIC = {0xA1B2C3D4: 1_000_000, 0xA1B23C4D: _NSEC}
"""Magic number of a pcap file, and its units of time a second."""
_USERS = range(USER0, USER0 + 16)
_FLAGS = {Direction.RECEIVED: 1, Direction.SENT: 2}


def write_pcapng(file: BinaryIO, traffic: Iterable[Passed], *, name: str = "") -> int:
    """Write serial traffic as pcapng, each transfer with its direction: sent is outbound.

    Args:
        file: Open for writing bytes.
        traffic: The transfers; their times are written unchanged.
        name: Name of the interface.

    Returns:
        Number of packets written.
    """
    file.write(_block(_SECTION, struct.pack("<IHHq", _MAGIC, 1, 0, -1)))
    options = [(_OPT_IF_TSRESOL, b"\x09")]
    if name:
        options.insert(0, (_OPT_IF_NAME, name.encode()))
    file.write(_block(_INTERFACE, struct.pack("<HHI", USER0, 0, _SNAP) + b"".join(_options(options))))
    count = 0
    for passed in traffic:
        stamp = round(passed.time * _NSEC)
        head = struct.pack("<IIIII", 0, stamp >> 32, stamp & 0xFFFFFFFF, len(passed.data), len(passed.data))
        flags = _options([(_OPT_FLAGS, struct.pack("<I", _FLAGS[passed.direction]))])
        file.write(_block(_PACKET, head + _padded(passed.data) + b"".join(flags)))
        count += 1
    return count


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)


def _block(kind: int, content: bytes) -> bytes:
    size = len(content) + 12
    return struct.pack("<II", kind, size) + content + struct.pack("<I", size)


def _options(options: Iterable[tuple[int, bytes]]) -> Iterator[bytes]:
    for code, value in options:
        yield struct.pack("<HH", code, len(value)) + _padded(value)
    yield struct.pack("<HH", _OPT_END, 0)


Order = Literal["<", ">"]


class _Interface(NamedTuple):
    """What an interface block says: link type, units of time a second, seconds to add."""

    link: int
    rate: int
    offset: int


def is_pcap(data: bytes) -> bool:
    """Whether a file begins like pcapng or pcap."""
    return _order_of(data) is not None or _classic_order(data) is not None


def read_pcap(data: bytes) -> Iterator[Passed | str]:
    """Read the serial traffic of a pcapng or pcap file (link types USER0 to USER15).

    Takes linear time and never raises, for any bytes.

    Args:
        data: The whole file; see `is_pcap`.

    Yields:
        A `Passed` for each packet, and sentences about what the file lacks or where it is damaged. Without a
        direction in the file, a packet counts as received if it begins like an answer, and as sent otherwise.
    """
    guessed, others = 0, 0
    for each in _blocks(data) if _order_of(data) is not None else _classic(data):
        if isinstance(each, str):
            yield each
            continue
        link, time, way, payload = each
        if link not in _USERS:
            others += 1
        elif payload:
            guessed += way is None
            yield Passed(way or guess(payload), payload, time, "")
    if guessed:
        yield f"{guessed} packets have no direction in the file: it is guessed from their bytes"
    if others:
        yield f"{others} packets are not of a serial line (link type USER0): open the file in Wireshark"


def guess(data: bytes) -> Direction:
    """The most likely direction, from src of a frame or the header of a legacy status packet."""
    if data.startswith(b"\xff\xf5"):
        return Direction.RECEIVED
    if data[:4] == b"\x5a\xfa\xfa\x5a" and data[16:20] == b"\x08\0\0\0":
        return Direction.RECEIVED
    return Direction.SENT


_Packet = tuple[int, float, Direction | None, bytes]


def _order_of(data: bytes, at: int = 0) -> Order | None:
    """Byte order of the section that begins there; None if none does."""
    orders: tuple[Order, Order] = ("<", ">")
    for order in orders:
        if data[at : at + 4] == struct.pack(order + "I", _SECTION) and data[at + 8 : at + 12] == struct.pack(
            order + "I", _MAGIC
        ):
            return order
    return None


def _blocks(data: bytes) -> Iterator[_Packet | str]:
    at = 0
    order: Order = "<"
    interfaces: list[_Interface] = []
    while at < len(data):
        if data[at : at + 4] == b"\x0a\x0d\x0d\x0a":
            order = _order_of(data, at) or order
            interfaces = []
        kind, size = struct.unpack_from(order + "II", data, at) if at + 12 <= len(data) else (0, 0)
        if size < 12 or at + size > len(data):
            yield f"the file is cut short or damaged at byte {at}"
            return
        content = data[at + 8 : at + size - 4]
        at += size
        if kind == _INTERFACE and len(content) >= 8:
            interfaces.append(_interface(content, order))
        elif kind == _PACKET and len(content) >= 20:
            number, high, low, length, _ = struct.unpack_from(order + "IIIII", content)
            if number >= len(interfaces) or 20 + length > len(content):
                yield f"a packet before byte {at} is damaged"
                continue
            link, rate, offset = interfaces[number]
            way = _way(_read_options(content, 20 + length + -length % 4, order).get(_OPT_FLAGS, b""), order)
            yield link, offset + (high << 32 | low) / rate, way, content[20 : 20 + length]
        elif kind == _SIMPLE_PACKET and len(content) >= 4 and interfaces:
            (length,) = struct.unpack_from(order + "I", content)
            yield interfaces[0].link, 0.0, None, content[4 : 4 + length]


def _interface(content: bytes, order: Order) -> _Interface:
    (link,) = struct.unpack_from(order + "H", content)
    options = _read_options(content, 8, order)
    code = (options.get(_OPT_IF_TSRESOL) or b"\x06")[0]
    rate = 2 ** min(code & 0x7F, 63) if code & 0x80 else 10 ** min(code, 19)
    shift = options.get(_OPT_IF_TSOFFSET, b"")
    return _Interface(link, rate, struct.unpack(order + "q", shift)[0] if len(shift) == 8 else 0)


def _read_options(content: bytes, at: int, order: Order) -> dict[int, bytes]:
    options: dict[int, bytes] = {}
    while at + 4 <= len(content):
        code, size = struct.unpack_from(order + "HH", content, at)
        if code == _OPT_END:
            break
        options[code] = content[at + 4 : at + 4 + size]
        at += 4 + size + -size % 4
    return options


def _way(flags: bytes, order: Order) -> Direction | None:
    if len(flags) != 4:
        return None
    (value,) = struct.unpack(order + "I", flags)
    return {1: Direction.RECEIVED, 2: Direction.SENT}.get(value & 3)


def _classic_order(data: bytes) -> Order | None:
    orders: tuple[Order, Order] = ("<", ">")
    return next((o for o in orders if len(data) >= 4 and struct.unpack_from(o + "I", data)[0] in _CLASSIC), None)


def _classic(data: bytes) -> Iterator[_Packet | str]:
    order, at = _classic_order(data), 24
    if order is None or len(data) < at:
        yield "the file is cut short at byte 0"
        return
    rate = _CLASSIC[struct.unpack_from(order + "I", data)[0]]
    link = struct.unpack_from(order + "I", data, 20)[0] & 0xFFFF
    while at < len(data):
        seconds, part, length, _ = (
            struct.unpack_from(order + "IIII", data, at) if at + 16 <= len(data) else (0,) * 4
        )
        if at + 16 + length > len(data) or at + 16 > len(data):
            yield f"the file is cut short or damaged at byte {at}"
            return
        yield link, seconds + part / rate, None, data[at + 16 : at + 16 + length]
        at += 16 + length
