"""All output of the command line.

Owns the format of lines, tables and JSON: a command describes its rows once, as a `RowType`. With ``--json``,
standard output has nothing but JSON, and what is said to people is left out. External text (names in files, strings
of devices, file names, errors that quote them) is harmless to a terminal: unprintable characters are shown as their
code. Must not know any one command. Live views are in `draw`, which cleans its text here.
"""

from __future__ import annotations

import json
import math
import re
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from operator import attrgetter
from typing import IO, TYPE_CHECKING, Any, Generic, TypeVar

from hexwire.units import decimal, plain

if TYPE_CHECKING:
    from hexwire.control.requests.setting import Setting

__all__ = [
    "DEGREES",
    "Column",
    "RowType",
    "answer",
    "folded",
    "format_table",
    "line_width",
    "print_json",
    "printing_json",
    "say",
    "say_document",
    "say_finding",
    "say_table",
    "settings_text",
    "shown",
    "split_columns",
    "wants_json",
    "with_unit",
    "write",
]

_GAP = "  "
_DIGITS = 12
"""Decimals of a number in JSON: smaller digits are rounding errors, such as 1e-17 instead of 0."""
_NARROWEST = 10
_HELP_WIDTH = 112
_LONGEST_NAME = 40
"""Longest name in the help of a node; a longer one has a line of its own."""
_PAIR = re.compile(r"(?<! )\S+ -?[0-9.]+(?= |$)")
_TIE = "\0"
"""Placeholder for a space at which a line must not be folded; it never occurs in text from `shown`."""
_SHORT = {"\n": "\\n", "\r": "\\r", "\t": "\\t"}
DEGREES = math.degrees(1.0)
"""Scale of a `Column` that shows radians in degrees."""
_R = TypeVar("_R")
_for_programs = False
"""Whether the command prints JSON: as standard output itself, one for all threads."""


@contextmanager
def printing_json(on: bool) -> Iterator[None]:
    """In this context, standard output has JSON only, if `on`: `say` and its like print nothing."""
    global _for_programs
    before, _for_programs = _for_programs, on
    try:
        yield
    finally:
        _for_programs = before


def wants_json() -> bool:
    """Whether standard output is for a program, see `printing_json`."""
    return _for_programs


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
    """Print lines, each folded between words to the terminal's width; without any, an empty line. Not with JSON.

    Args:
        lines: The lines. A line break inside one is shown as its code.
        flush: Flush the output at once.
    """
    if wants_json():
        return
    width = line_width()
    out = [part for line in lines or ("",) for part in folded(shown(str(line)), width)]
    write(sys.stdout, "\n".join(out) + "\n", flush=flush)


def say_document(text: str) -> None:
    """Print lines for a program: a file, or a command. They are not folded."""
    write(sys.stdout, "".join(f"{shown(line)}\n" for line in text.removesuffix("\n").split("\n")), flush=True)


def say_finding(level: str, text: str, advice: str) -> None:
    """Print what a check has found, and what to do about it.

    Args:
        level: ok, hint, bad or unknown.
        text: The finding.
        advice: Empty if there is none.
    """
    mark = {"bad": "BAD", "unknown": "?"}.get(level, level)
    say(f"{mark:4}  {text}")
    if advice:
        say(f"      -> {advice}")


def say_table(head: Sequence[str], rows: Sequence[Sequence[str]], *, keys: int = 1, flush: bool = False) -> None:
    """Print a table; see `format_table`. Not with JSON."""
    if not wants_json():
        write(sys.stdout, format_table(head, rows, keys=keys, width=line_width()) + "\n", flush=flush)


def print_json(value: object, *, one_line: bool = False) -> None:
    """Print a value as JSON; NaN and infinity become null."""
    text = json.dumps(_finite(value), indent=None if one_line else 2, ensure_ascii=False, allow_nan=False)
    if not text.replace("\n", "").isprintable():
        text = "".join(map(_json_code, text))
    write(sys.stdout, text + "\n", flush=one_line)


def answer(value: object, *lines: str) -> None:
    """Print the result of a command: one JSON document for a program, or lines of text."""
    if wants_json():
        print_json(value)
    elif lines:
        say(*lines)


class Column(Generic[_R]):
    """One fact of a row: its key in JSON, its column in a table.

    Args:
        key: Key in JSON; empty if only people see it; ``**`` for a mapping whose items are keys of their own.
        title: Title of the column; None if only programs see it.
        get: Where the value is: an attribute of the row, perhaps of an attribute, or a function of the row. The
            attribute named as the key if empty.
        digits: Decimals of a number in the table.
        scale: Factor of a number in the table, as 1000 for milliseconds.
        text: The cell, from the row; the value in words if None: "-" for what is not known, "yes" or "no".
    """

    def __init__(
        self,
        key: str,
        title: str | None = None,
        get: str | Callable[[_R], object] = "",
        digits: int = 0,
        scale: float = 1.0,
        text: Callable[[_R], str] | None = None,
    ) -> None:
        self.key, self.title = key, title
        self._get: Callable[[_R], object] = get if callable(get) else attrgetter(get or key)
        self._digits, self._scale, self._text = digits, scale, text

    def value(self, row: _R) -> object:
        """The value for JSON."""
        return self._get(row)

    def cell(self, row: _R) -> str:
        """The text in a table."""
        if self._text is not None:
            return self._text(row)
        value = self.value(row)
        if value is None or value == "":
            return "-"
        if isinstance(value, bool):
            return "yes" if value else "no"
        return plain(self._scale * value, self._digits) if isinstance(value, float) else str(value)


class RowType(Generic[_R]):
    """What a command prints of each of its things: JSON, table and line follow from the same columns.

    Args:
        columns: In the order of JSON and table.
        keys: Number of leading columns that identify a row of the table.
        words: A row as a line; `str` if none is given.
    """

    def __init__(self, *columns: Column[_R], keys: int = 1, words: Callable[[_R], str] = str) -> None:
        self._columns, self._leading, self._words = columns, keys, words
        self.titles = tuple(column.title for column in columns if column.title is not None)
        """Titles of the table."""
        self.keys = tuple(column.key for column in columns if column.key)
        """Keys in JSON."""

    def as_json(self, row: _R) -> dict[str, Any]:
        """A row for JSON."""
        made: dict[str, Any] = {}
        for column in self._columns:
            value = column.value(row) if column.key else None
            made |= value if column.key == "**" and isinstance(value, Mapping) else {column.key: value}
        made.pop("", None)
        return made

    def cells(self, row: _R) -> tuple[str, ...]:
        """A row of the table."""
        return tuple(column.cell(row) for column in self._columns if column.title is not None)

    def show(self, rows: Sequence[_R]) -> None:
        """Print all rows: a list for a program, or a table."""
        if wants_json():
            print_json([self.as_json(row) for row in rows])
        else:
            say_table(self.titles, [self.cells(row) for row in rows], keys=self._leading)

    def tell(self, rows: Iterable[_R]) -> list[_R]:
        """Print each row when it comes, as a line; for a program, a list of all at the end. Returns them."""
        told = []
        for row in rows:
            told.append(row)
            say(self._words(row), flush=True)
        if wants_json():
            print_json([self.as_json(row) for row in told])
        return told

    def answer(self, row: _R) -> None:
        """Print the only row: an object for a program, or a line."""
        answer(self.as_json(row), self._words(row))


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


def settings_text(rows: Iterable[tuple[str, Setting]]) -> str:
    """The parameters of a ROS node, for its help.

    Args:
        rows: How users write each parameter with its default, and the parameter.
    """
    rows = list(rows)
    width = max(len(name) for name, _ in rows if len(name) <= _LONGEST_NAME) + 4
    lines = []
    for name, row in rows:
        first = f"  {name}".ljust(width)
        if len(first) > width:
            lines.append(first)
            first = " " * width
        lines += textwrap.wrap(row.description, _HELP_WIDTH, initial_indent=first, subsequent_indent=" " * width)
    return "\n".join(lines)
