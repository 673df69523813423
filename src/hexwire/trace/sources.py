"""Reads traffic from files: the chapter's log, a hex dump, a raw capture, a recording, a capture of Wireshark.

Owns detecting the format and converting each to transfers. Must not know what the bytes mean.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator

from hexwire.errors import UsageError
from hexwire.link.tap import Direction, Passed

from .capture import traffic_of
from .chapter_log import HEADLINE, parse_log
from .mcap_file import MAGIC
from .pcap import guess, is_pcap, read_pcap

__all__ = ["LARGEST", "read_traffic"]

LARGEST = 64 * 1024 * 1024
"""Greatest size of a file of traffic in bytes; the user must split a larger one."""

_OFFSET = re.compile(r"(?:0x)?[0-9A-Fa-f]{4,16}:?\s+(?=[0-9A-Fa-f]{2}\b)")
_TEXT_COLUMN = re.compile(r"\||\s\s[^0-9A-Fa-f\s|]")


def read_traffic(data: bytes, name: str = "the file") -> Iterator[Passed | str]:
    """Read a file's bytes as traffic.

    Takes linear time for any contents.

    Args:
        data: The whole file.
        name: Name of the file in errors.

    Yields:
        A `Passed` for each transfer, and sentences about irregularities of the file.

    Raises:
        UsageError: The file is empty or larger than `LARGEST`; or it is a recording that cannot be read at all, or
            the package ``mcap`` is not installed.
    """
    if not data.strip():
        raise UsageError(f"{name} is empty: there is nothing to decode")
    if len(data) > LARGEST:
        raise UsageError(f"{name} is larger than {LARGEST >> 20} MiB: split it, for example with split -C 32M")
    if data.startswith(MAGIC):
        yield from traffic_of(io.BytesIO(data), name)
        return
    if is_pcap(data):
        yield from read_pcap(data)
        return
    text = _as_text(data)
    if text is None:
        yield Passed(guess(data), data, 0.0, "")
    elif any(HEADLINE.match(line) for line in _lines(text)):
        yield from parse_log(_lines(text))
    else:
        yield from _hex_dump(text)


def _lines(text: str) -> Iterator[str]:
    """Yield line by line: a list of all lines would take many times the memory of the text."""
    at = 0
    while at < len(text):
        end = text.find("\n", at)
        end = len(text) if end < 0 else end
        yield text[at:end].removesuffix("\r")
        at = end + 1


def _as_text(data: bytes) -> str | None:
    """The file as text, or None if it is a raw capture."""
    if b"\0" in data:
        return None
    try:
        return data.decode("ascii")
    except UnicodeDecodeError:
        pass
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return None
    return text if text.isascii() or any(HEADLINE.match(line) for line in _lines(text)) else None


def _hex_dump(text: str) -> Iterator[Passed | str]:
    """Hex bytes, with or without offsets and a text column; a blank line or `<`, `>` ends a transfer."""
    direction: Direction | None = None
    gathered = bytearray()
    for number, line in enumerate(_lines(text), start=1):
        line = line.partition("#")[0].strip()
        if line[:1] in ("<", ">", ""):
            yield from _gathered(gathered, direction)
            gathered.clear()
            direction = {">": Direction.SENT, "<": Direction.RECEIVED}.get(line[:1])
            line = line.lstrip("<>").lstrip()
        try:
            gathered += _bytes_of(line)
        except ValueError:
            yield f"line {number} is neither hex nor a log line: {line[:60]}"
    yield from _gathered(gathered, direction)


def _bytes_of(line: str) -> bytes:
    offset = _OFFSET.match(line)
    if offset:
        line = line[offset.end() :]
    column = _TEXT_COLUMN.search(line)
    if column:
        line = line[: column.start()]
    return bytes.fromhex(line.replace(",", " ").replace("0x", " "))


def _gathered(data: bytearray, direction: Direction | None) -> Iterator[Passed]:
    if data:
        yield Passed(direction or guess(bytes(data)), bytes(data), 0.0, "")
