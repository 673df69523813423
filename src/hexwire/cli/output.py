"""All output of the command line.

Owns the format of lines, tables and JSON, and makes external text (names in files, strings of devices, file names,
errors that quote them) harmless to a terminal: unprintable characters are shown as their code. Must not know any
one command. Live views are in `draw`, which cleans its text here.
"""

from __future__ import annotations

import json
import math
import re
import shutil
import sys
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import IO

from hexwire.units import decimal, plain

__all__ = [
    "answer",
    "folded",
    "format_table",
    "line_width",
    "print_json",
    "say",
    "say_document",
    "say_table",
    "shown",
    "split_columns",
    "with_unit",
    "write",
]

_GAP = "  "
_DIGITS = 12
"""Decimals of a number in JSON: smaller digits are rounding errors, such as 1e-17 instead of 0."""
_NARROWEST = 10
_PAIR = re.compile(r"(?<! )\S+ -?[0-9.]+(?= |$)")
_TIE = "\0"
"""Placeholder for a space at which a line must not be folded; it never occurs in text from `shown`."""
_SHORT = {"\n": "\\n", "\r": "\\r", "\t": "\\t"}


def shown(text: str) -> str:
    """Text on one line that is safe for a terminal.

    Unprintable characters are shown as their code: control characters, escape sequences, marks that change the
    writing direction, invisible characters, and bytes of file names that are not text.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else _SHORT.get(c) or _code(ord(c)) for c in text)


def _code(number: int) -> str:
    if 0xDC80 <= number <= 0xDCFF:
        # Python's representation of a byte that is not UTF-8.
        number -= 0xDC00
    return f"\\x{number:02x}" if number < 0x100 else f"\\u{number:04x}" if number < 0x10000 else f"\\U{number:08x}"


def with_unit(value: float, unit: str) -> str:
    """A value for display: angles in degrees, everything else in SI."""
    if unit.startswith("rad"):
        return f"{decimal(math.degrees(value))} deg{unit[3:]}"
    return f"{decimal(value)} {unit}".rstrip() if unit != "fraction" else f"{plain(100 * value, 1)}%"


def write(stream: IO[str], text: str, *, flush: bool = False) -> None:
    """Write clean text; characters missing in the stream's encoding are shown as their code.

    Raises:
        OSError: The stream is closed, or its disk or pipe is full.
    """
    encoding = getattr(stream, "encoding", None) or "utf-8"
    try:
        text.encode(encoding)
    except UnicodeEncodeError:
        text = text.encode(encoding, "backslashreplace").decode(encoding)
    stream.write(text)
    if flush:
        stream.flush()


def say(*lines: object, flush: bool = False) -> None:
    """Print lines, each folded between words to the terminal's width; without any, an empty line.

    Args:
        lines: The lines. A line break inside one is shown as its code.
        flush: Flush the output at once.
    """
    width = line_width()
    out = [part for line in lines or ("",) for part in folded(shown(str(line)), width)]
    write(sys.stdout, "\n".join(out) + "\n", flush=flush)


def say_document(text: str) -> None:
    """Print lines for a program: a file, or a command. They are not folded."""
    write(sys.stdout, "".join(f"{shown(line)}\n" for line in text.removesuffix("\n").split("\n")), flush=True)


def say_table(head: Sequence[str], rows: Sequence[Sequence[str]], *, keys: int = 1, flush: bool = False) -> None:
    """Print a table; see `format_table`."""
    write(sys.stdout, format_table(head, rows, keys=keys, width=line_width()) + "\n", flush=flush)


def print_json(value: object, *, one_line: bool = False) -> None:
    """Print a value as JSON; NaN and infinity become null."""
    text = json.dumps(_finite(value), indent=None if one_line else 2, ensure_ascii=False, allow_nan=False)
    if not text.replace("\n", "").isprintable():
        text = "".join(map(_json_code, text))
    write(sys.stdout, text + "\n", flush=one_line)


def answer(as_json: bool, value: object, *lines: str) -> None:
    """Print the result of a command: one JSON document for a program, or lines of text."""
    if as_json:
        print_json(value)
    else:
        say(*lines)


def _json_code(c: str) -> str:
    # Outside of strings, a JSON document has only printable characters and line breaks.
    return c if c.isprintable() or c == "\n" else json.dumps(c)[1:-1]


def _finite(value: object) -> object:
    if isinstance(value, float):
        return round(value, _DIGITS) + 0.0 if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value


def line_width() -> int | None:
    """Columns of the terminal, or COLUMNS if that is set; None if the output is not a terminal."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def folded(line: str, width: int | None) -> list[str]:
    """The line, folded between words into several if it is longer than `width`."""
    if width is None or len(line) <= width:
        return [line]
    indent = " " * (len(line) - len(line.lstrip()) + 2)
    # Keep a name and its number together if a line has several of them.
    bound = _PAIR.sub(lambda pair: pair[0].replace(" ", _TIE), line) if _GAP in line.strip() else line
    parts = textwrap.wrap(bound, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)
    return [part.replace(_TIE, " ") for part in parts] or [""]


def format_table(
    head: Sequence[str], rows: Sequence[Sequence[str]], *, keys: int = 1, width: int | None = None
) -> str:
    """Format a table; a column of numbers is aligned to the right.

    Args:
        head: Titles.
        rows: Cells.
        keys: Number of leading columns that identify a row.
        width: Columns of the terminal. A wider table is shown in parts below each other, each with its key columns,
            so that no column is lost and no number is split.
    """
    table = [[shown(cell) for cell in row] for row in (head, *rows)]
    columns = list(zip(*table, strict=True))
    widths = [max(map(len, column)) for column in columns]
    blocks = []
    for part in split_columns(widths, keys, width, len(_GAP)):
        room = {i: widths[i] for i in part}
        if width is not None and len(part) == keys + 1:
            last = part[-1]
            room[last] = min(room[last], max(_NARROWEST, width - sum(widths[i] + len(_GAP) for i in part[:-1])))
        blocks.append("\n".join(_lines(table, columns, room)))
    return "\n\n".join(blocks)


def split_columns(widths: Sequence[int], keys: int, width: int | None, gap: int) -> Iterator[list[int]]:
    """The columns of each part of a table that may be too wide; every part begins with the key columns."""
    front = list(range(min(keys, len(widths))))
    part, used = list(front), sum(widths[i] + gap for i in front)
    for i in range(len(front), len(widths)):
        if width is not None and len(part) > len(front) and used + widths[i] > width:
            yield part
            part, used = list(front), sum(widths[k] + gap for k in front)
        part.append(i)
        used += widths[i] + gap
    yield part


def _lines(table: list[list[str]], columns: Sequence[Sequence[str]], room: Mapping[int, int]) -> Iterator[str]:
    """Rows of these columns with these widths; longer text continues on the next line."""
    right = {i for i in room if all(_is_number(cell) for cell in columns[i][1:])}
    for row in table:
        cells = {i: _fitted(row[i], room[i]) for i in room}
        for n in range(max(map(len, cells.values()))):
            words = {i: lines[n] if n < len(lines) else "" for i, lines in cells.items()}
            yield _GAP.join(
                word.rjust(room[i]) if i in right else word.ljust(room[i]) for i, word in words.items()
            ).rstrip()


def _fitted(cell: str, width: int) -> list[str]:
    return [cell] if len(cell) <= width else textwrap.wrap(cell, width, break_on_hyphens=False)


def _is_number(cell: str) -> bool:
    return cell == "-" or cell.lstrip("+-").replace(".", "", 1).isdigit()
