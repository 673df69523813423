"""Writes capture files for Wireshark: pcap with nanoseconds, and pcapng with the direction of every transfer.

Owns the two file formats. Must not know what the bytes mean.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from typing import BinaryIO

from hexwire.link.tap import Direction, Passed

__all__ = ["USER0", "write_pcapng"]

USER0 = 147
"""Link type (DLT_USER0) of captures of a serial line; analyzers/wireshark decodes it."""

_SNAP = 0x40000
_NSEC = 1_000_000_000
_SECTION, _INTERFACE, _PACKET = 0x0A0D0D0A, 1, 6
_OPT_END, _OPT_COMMENT, _OPT_IF_NAME, _OPT_FLAGS, _OPT_IF_TSRESOL = 0, 1, 2, 2, 9
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
    file.write(_block(_SECTION, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)))
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
