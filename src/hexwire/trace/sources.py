"""Reads traffic from files: the chapter's log, a hex dump, a raw capture, a recording, a pcap; makes files of it.

Owns detecting the format and converting each to transfers, in pieces, however long a line is: no step keeps other
threads waiting for long. Must not know what the bytes mean, nor where those of a file go.
"""

from __future__ import annotations

import codecs
import io
import re
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from hexwire.errors import UsageError
from hexwire.link.tap import Direction, Passed

from .capture import Capture, traffic_of
from .chapter_log import HEADLINE, parse_log
from .mcap_file import MAGIC
from .pcap import guess, is_pcap, read_pcap, write_pcapng

__all__ = ["FORMATS", "LARGEST", "read_traffic", "saved_traffic"]

LARGEST = 64 * 1024 * 1024
"""Greatest size of a file of traffic in bytes; the user must split a larger one."""

_PIECE = 1 << 14
"""Bytes that are looked at in one step, and letters of a line that are."""
_RETURN = 0x0D
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
    if all(part.isspace() for part in _pieces(data)):
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
    elif _has_headline(text):
        yield from parse_log(_short(text, at, end) for at, end in _lines(text))
    else:
        yield from _hex_dump(text)


def _pieces(data: bytes) -> Iterator[bytes]:
    return (data[at : at + _PIECE] for at in range(0, len(data), _PIECE))


def _lines(text: bytes) -> Iterator[tuple[int, int]]:
    """Where each line begins and ends: a list of all lines would take many times the memory of the text."""
    at = 0
    while at < len(text):
        end = text.find(b"\n", at)
        end = len(text) if end < 0 else end
        yield at, end - (end > at and text[end - 1] == _RETURN)
        at = end + 1


def _short(text: bytes, at: int, end: int) -> str:
    """A line of a log; of one that is too long for that, its beginning, which is of no log either."""
    return text[at : min(end, at + _PIECE)].decode(errors="replace")


def _has_headline(text: bytes) -> bool:
    return any(HEADLINE.match(_short(text, at, end)) for at, end in _lines(text))


def _as_text(data: bytes) -> bytes | None:
    """The file as UTF-8 without a mark of byte order, or None if it is a raw capture."""
    decoder, only_ascii = codecs.getincrementaldecoder("utf-8-sig")(), True
    try:
        for part in _pieces(data):
            if b"\0" in part:
                return None
            only_ascii &= decoder.decode(part).isascii()
        decoder.decode(b"", final=True)
    except UnicodeDecodeError:
        return None
    text = data.removeprefix(codecs.BOM_UTF8)
    return text if only_ascii or _has_headline(text) else None


def _hex_dump(text: bytes) -> Iterator[Passed | str]:
    """Hex bytes, with or without offsets and a text column; a blank line or `<`, `>` ends a transfer."""
    direction: Direction | None = None
    gathered = bytearray()
    for number, (at, end) in enumerate(_lines(text), start=1):
        at = _after(text, at, end)
        first = text[at : min(end, at + 1)]
        if first in (b"<", b">", b"#", b""):
            yield from _gathered(gathered, direction)
            gathered.clear()
            direction = {b">": Direction.SENT, b"<": Direction.RECEIVED}.get(first)
            at = _after(text, _after(text, at, end, b"<>"), end)
        try:
            gathered += _bytes_of(text, at, end)
        except ValueError:
            yield f"line {number} is neither hex nor a log line: {_shown(text, at, end)}"
    yield from _gathered(gathered, direction)


def _shown(text: bytes, at: int, end: int) -> str:
    return _short(text, at, end).partition("#")[0].rstrip()[:60]


def _after(text: bytes, at: int, end: int, over: bytes | None = None) -> int:
    """Where the blanks end that begin at `at`, or other letters."""
    while at < end:
        part = text[at : min(end, at + _PIECE)]
        left = part.lstrip(over)
        at += len(part) - len(left)
        if left:
            break
    return at


def _bytes_of(text: bytes, at: int, end: int) -> bytearray:
    """The bytes of a line of hex; raises `ValueError` if it is none."""
    found = bytearray()
    for number, piece in enumerate(_parts_of(text, at, end)):
        line, remark, _ = piece.partition("#")
        if number == 0 and (offset := _OFFSET.match(line)):
            line = line[offset.end() :]
        column = _TEXT_COLUMN.search(line)
        if column:
            line = line[: column.start()]
        found += bytes.fromhex(line.replace(",", " ").replace("0x", " "))
        if remark or column:
            break
    return found


def _parts_of(text: bytes, at: int, end: int) -> Iterator[str]:
    """A line in parts: each ends before a blank or a comma where there is one, else with a byte."""
    while end - at > _PIECE:
        part = text[at : at + _PIECE]
        count = len(part.rstrip())
        if count == _PIECE:
            count = max(part.rfind(each) for each in (b" ", b"\t", b","))
            count = len(part[:count].rstrip()) if count > 0 else 0
            count = count or _PIECE
        elif not count:
            # Two of them are left for the text column, which begins with two.
            at += _PIECE - 2
            continue
        yield part[:count].decode(errors="replace")
        at += count
    yield text[at:end].rstrip().decode(errors="replace")


def _gathered(data: bytearray, direction: Direction | None) -> Iterator[Passed]:
    if data:
        whole = bytes(data)
        yield Passed(direction or guess(whole), whole, 0.0, "")


FORMATS = ("mcap", "pcapng")


def saved_traffic(traffic: Iterable[Passed], form: str, *, offset: float = 0.0) -> bytes:
    """A file of this traffic.

    Args:
        traffic: The transfers, in order.
        form: One of `FORMATS`.
        offset: Seconds to add to their times for seconds since 1970.

    Raises:
        UsageError: There is no traffic, it is not such a format, or the package ``mcap`` is not installed.
    """
    kept = list(traffic)
    if form not in FORMATS:
        raise UsageError(f"traffic is saved as {' or '.join(FORMATS)}, not as {form[:20]!r}")
    if not kept:
        raise UsageError("there is no traffic to save yet")
    if form == "pcapng":
        file = io.BytesIO()
        write_pcapng(file, (each._replace(time=each.time + offset) for each in kept), name="hexwire")
        return file.getvalue()
    with tempfile.TemporaryDirectory(prefix="hexwire-") as folder:
        path = Path(folder) / "traffic.mcap"
        with Capture(path, offset=offset) as capture:
            for each in kept:
                capture.passed(each)
        return path.read_bytes()
