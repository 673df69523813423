"""Traffic from files: the chapter's log text, a hex dump, a raw capture, a recording.

Owns telling the forms apart and turning each into transfers. Must not know what the bytes mean.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator

from hexwire.errors import UsageError
from hexwire.ipc.tap import Direction, Passed

from .capture import MAGIC, traffic_of
from .chapter_log import HEADLINE, parse_log

__all__ = ["read_traffic"]

_OFFSET = re.compile(r"^\s*(?:0x)?[0-9A-Fa-f]{4,16}:?\s+(?=[0-9A-Fa-f]{2}\b)")
_TEXT_COLUMN = re.compile(r"\s*(?:\||\s{2,}[^0-9A-Fa-f\s]).*$")
_BOARD_TO_HOST = b"\xff\xf5"


def read_traffic(data: bytes) -> Iterator[Passed | str]:
    """Read a file's bytes as traffic.

    Args:
        data: The whole file.

    Yields:
        A `Passed` for each transfer, and sentences about what is odd in the file itself.

    Raises:
        UsageError: The file is empty, or a recording and the package ``mcap`` is not installed.
    """
    if not data.strip():
        raise UsageError("the file is empty: there is nothing to decode")
    if data.startswith(MAGIC):
        yield from traffic_of(io.BytesIO(data), "the file")
        return
    text = _as_text(data)
    if text is None:
        yield Passed(_way(data), data, 0.0, "")
    elif any(HEADLINE.match(line) for line in text.splitlines()):
        yield from parse_log(text.splitlines())
    else:
        yield from _hex_dump(text)


def _as_text(data: bytes) -> str | None:
    """The file as text, or None if it is a raw capture."""
    if b"\0" in data:
        return None
    try:
        text = data.decode("ascii")
    except UnicodeDecodeError:
        try:
            text = data.decode("utf-8")
        except UnicodeDecodeError:
            return None
        if not any(HEADLINE.match(line) for line in text.splitlines()):
            return None
    return text


def _hex_dump(text: str) -> Iterator[Passed | str]:
    """Hex bytes, with or without offsets and a text column; a blank line or `<`, `>` ends a transfer."""
    way: Direction | None = None
    gathered = bytearray()
    for number, line in enumerate(text.splitlines(), start=1):
        line = line.partition("#")[0]
        marked = line.lstrip()[:1]
        if marked in ("<", ">") or not line.strip():
            yield from _gathered(gathered, way)
            gathered.clear()
            way = {">": Direction.SENT, "<": Direction.RECEIVED}.get(marked)
            line = line.lstrip().lstrip("<>")
        code = _TEXT_COLUMN.sub("", _OFFSET.sub("", line)).strip()
        if not code:
            continue
        words = code.replace(",", " ").replace("0x", " ").split()
        if not all(len(word) % 2 == 0 and re.fullmatch(r"[0-9A-Fa-f]+", word) for word in words):
            yield f"line {number} is neither hex nor a log line: {line.strip()[:60]}"
            continue
        gathered += bytes.fromhex("".join(words))
    yield from _gathered(gathered, way)


def _gathered(data: bytearray, way: Direction | None) -> Iterator[Passed]:
    if data:
        yield Passed(way or _way(bytes(data)), bytes(data), 0.0, "")


def _way(data: bytes) -> Direction:
    """Who most likely sent this: a frame says it in src, a legacy status in its header."""
    if data.startswith(_BOARD_TO_HOST):
        return Direction.RECEIVED
    if data[:4] == b"\x5a\xfa\xfa\x5a" and data[16:20] == b"\x08\0\0\0":
        return Direction.RECEIVED
    return Direction.SENT
