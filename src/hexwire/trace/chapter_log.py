"""The log that the chapter's host prints: transfers, and the joint positions that it read.

A transfer has direction and length above, hex on the left, and text on the right.

Owns writing and reading this layout. Must not know what the bytes mean.

    SerialPort sent - Length=52
    5A FA FA 5A DB 9A 7A 68 E0 4E 00 0D 2E 00 00 00| Z  Z  zh N  .
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence

from hexwire.link.tap import Direction, Passed

__all__ = ["HEADLINE", "format_passed", "format_positions", "hex_rows", "parse_log"]

_WIDTH = 16
_WORDS = {Direction.SENT: "sent", Direction.RECEIVED: "receive"}
# The number of digits is bounded: parsing thousands of digits takes quadratic time, and no length has so many.
HEADLINE = re.compile(
    r"^\s*(?:(?P<time>[0-9]{1,12}\.[0-9]{1,12})\s+)?\S+ (?P<way>sent|receive) - Length=(?P<length>[0-9]{1,9})\s*$"
)
_HEX_ROW = re.compile(r"^\s*(?P<hex>[0-9A-Fa-f]{2}(?: [0-9A-Fa-f]{2})*)\s*(?:\|.*)?$")


def hex_rows(data: bytes) -> Iterator[str]:
    """Rows of 16 bytes: hex, a bar, and the printable bytes as text; all others are blanks."""
    for at in range(0, len(data), _WIDTH):
        row = data[at : at + _WIDTH]
        text = "".join(chr(b) if 0x21 <= b <= 0x7E else " " for b in row)
        yield f"{row.hex(' ').upper():<{_WIDTH * 3 - 1}}| {text}".rstrip()


def format_passed(passed: Passed, *, name: str = "SerialPort", start: float | None = None) -> Iterator[str]:
    """The lines of one transfer.

    Args:
        passed: The transfer.
        name: Name of the port there.
        start: If given, the headline begins with the seconds since then, which the host's own log does not have.
    """
    stamp = "" if start is None else f"{passed.time - start:.6f} "
    yield f"{stamp}{name} {_WORDS[passed.direction]} - Length={len(passed.data)}"
    yield from hex_rows(passed.data)


def format_positions(names: Sequence[str], degrees: Sequence[float], *, name: str) -> Iterator[str]:
    """The two lines of a state that was read, with six digits for each joint.

    Args:
        names: The joints.
        degrees: Their positions.
        name: Who read it.
    """
    yield f"{name}:: HW read (degree):"
    yield " ".join(f"{joint}={angle:g}" for joint, angle in zip(names, degrees, strict=True))


def parse_log(lines: Iterable[str]) -> Iterator[Passed | str]:
    """Read such a log from any program; other lines between transfers are ignored.

    Yields:
        A `Passed` for each transfer, with time 0 if the log has no times. If the number of bytes differs from the
        length in the headline, a sentence that says so precedes the transfer.
    """
    way, length, time = Direction.SENT, 0, 0.0
    data: bytearray | None = None
    for line in lines:
        head = HEADLINE.match(line)
        if head:
            yield from _finished(way, length, time, data)
            way = Direction.SENT if head["way"] == "sent" else Direction.RECEIVED
            length, time, data = int(head["length"]), float(head["time"] or 0.0), bytearray()
            continue
        row = _HEX_ROW.match(line)
        if row and data is not None and len(data) < length:
            data += bytes.fromhex(row["hex"])
        elif data is not None and line.strip():
            yield from _finished(way, length, time, data)
            data = None
    yield from _finished(way, length, time, data)


def _finished(way: Direction, length: int, time: float, data: bytearray | None) -> Iterator[Passed | str]:
    if data is None:
        return
    if len(data) != length:
        yield f"the log says {length} bytes, but has {len(data)}"
    if data:
        yield Passed(way, bytes(data), time, "")
