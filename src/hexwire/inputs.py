"""Reads what people and programs write: files within bounds, parsed, and every value with the place of its faults.

Owns the opening of files, the size limits, the refusal of pipes and devices, text encodings, JSON and TOML, and
`Item`, by which readers take values out of a parsed file, a request or a parameter. Whatever is written there, the
outcome is a value or a `ConfigError`, and time and memory are proportional to its length.
"""

from __future__ import annotations

import json
import math
import os
import re
import reprlib
import stat
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, BinaryIO, TypeVar

from hexwire.errors import ConfigError
from hexwire.system import BINARY, CLOSE_ON_EXEC, NO_FOLLOW, NO_WAIT

__all__ = [
    "LARGEST_DATA",
    "LARGEST_MESSAGE",
    "LARGEST_TEXT",
    "MOST_FAULTS",
    "Item",
    "decode_text",
    "first_faults",
    "open_file",
    "parse_json",
    "parse_message",
    "parse_toml",
    "read_bytes",
    "read_stream",
    "read_text",
]

LARGEST_TEXT = 1024 * 1024
"""Most bytes of a file that people write: an arm, a calibration, channels, certificates."""
LARGEST_DATA = 16 * 1024 * 1024
"""Most bytes of a file that programs write and that is read as a whole: waypoints, settings of servos."""
LARGEST_MESSAGE = 1024 * 1024
"""Most bytes of one message of a recording: parsed JSON can take 30 times the memory that its text takes."""
MOST_FAULTS = 10
"""Most faults that are told at once."""

_MOST_DIGITS = 20
"""Most digits of a whole number: parsing takes the square of their number, and longer ones mean nothing here."""
_MOST_DOTS = 32
"""Most dots in a line of TOML: parsing a key of thousands of parts takes the square of their number."""
_LONG_NUMBER = re.compile(rf"[0-9_]{{{_MOST_DIGITS + 1},}}")
_LONG_CODE = re.compile(r"\b0[xob][0-9A-Fa-f_]{40,}")
_TOML_PLACE = re.compile(r"(.*) \(at line ([0-9]+), column ([0-9]+)\)", re.DOTALL)
_PLAIN_KEY = re.compile(r"[A-Za-z0-9_/-]{1,60}")
_SHOWN = 40

_T = TypeVar("_T")


# -- bytes and text -----------------------------------------------------------------------------------------


def open_file(path: str | Path, *, links: bool = True) -> BinaryIO:
    """Open a plain file for reading.

    Args:
        path: The file.
        links: Whether it may be a symbolic link.

    Raises:
        ConfigError: It cannot be opened, or is a folder, a pipe or a device; at once.
    """
    flags = os.O_RDONLY | NO_WAIT | CLOSE_ON_EXEC | BINARY | (0 if links else NO_FOLLOW)

    def opener(name: str, _: int) -> int:
        # Before it is opened: opening a serial port resets the board behind it.
        _refuse_pipe(Path(name).stat(follow_symlinks=links).st_mode, name)
        fd = os.open(name, flags)
        try:
            # Another one may have taken its place meanwhile.
            _refuse_pipe(os.fstat(fd).st_mode, name)
        except BaseException:
            os.close(fd)
            raise
        return fd

    try:
        return open(path, "rb", opener=opener)  # `Path.open` has no opener; the caller closes
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror or error}", file=str(path)) from None
    except ValueError as error:  # a name with a NUL in it
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f"cannot be read: {error}", file=repr(str(path))) from None


def _refuse_pipe(mode: int, path: str | Path) -> None:
    """A pipe or a device may never come to an end. A folder and a symbolic link are refused by the opening."""
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode) or stat.S_ISLNK(mode)):
        raise ConfigError("is a pipe or a device, not a file", file=str(path))


def read_bytes(path: str | Path, *, largest: int = LARGEST_TEXT) -> bytes:
    """All bytes of a plain file.

    Args:
        path: The file.
        largest: Most bytes it may have.

    Raises:
        ConfigError: As `open_file`, or it cannot be read or is larger.
    """
    with open_file(path) as stream:
        try:
            return read_stream(stream, str(path), largest=largest)
        except OSError as error:
            raise ConfigError(f"cannot be read: {error.strerror or error}", file=str(path)) from None


def read_stream(stream: IO[bytes], name: str, *, largest: int) -> bytes:
    """All bytes of an open file or pipe.

    Raises:
        ConfigError: There are more than `largest`.
        OSError: It cannot be read.
    """
    parts, left = [], largest + 1
    while left and (part := stream.read(min(left, 1 << 20))):
        parts.append(part)
        left -= len(part)
    if not left:
        room = f"{largest >> 20} MiB" if largest >= 1 << 20 else f"{largest >> 10} KiB"
        raise ConfigError(f"is larger than {room}, the limit for this kind of file", file=name)
    return b"".join(parts)


def read_text(path: str | Path, *, largest: int = LARGEST_TEXT) -> str:
    """The text of a plain file: see `read_bytes` and `decode_text`."""
    return decode_text(read_bytes(path, largest=largest), str(path))


def decode_text(data: bytes, file: str = "") -> str:
    r"""Decode UTF-8 text, with or without a byte order mark; line ends become ``\n``.

    Raises:
        ConfigError: It is not UTF-8 text; with line and column.
    """
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise ConfigError("is UTF-16 text; save it as UTF-8", file=file, line=1, column=1)
    try:
        text = data.decode("utf-8")
        bad = data.find(b"\0")
    except UnicodeDecodeError as error:
        text, bad = "", error.start
    if bad >= 0:
        line = data.count(b"\n", 0, bad) + 1
        raise ConfigError("not UTF-8 text", file=file, line=line, column=bad - data.rfind(b"\n", 0, bad))
    return text.removeprefix("\ufeff").replace("\r\n", "\n")


# -- JSON and TOML ------------------------------------------------------------------------------------------


def parse_message(data: bytes, file: str, where: str) -> Item:
    """Parse a message of a recording, as `parse_json`.

    Raises:
        ConfigError: As `parse_json`, or it has more than `LARGEST_MESSAGE` bytes.
    """
    if len(data) > LARGEST_MESSAGE:
        raise ConfigError(f"{where} has {len(data)} bytes; no message has more than 1 MiB", file=file)
    return parse_json(data, file, where)


def parse_json(content: str | bytes, file: str = "", where: str = "") -> Item:
    """Parse JSON.

    NaN and Infinity, which JSON does not have, and whole numbers of more than 20 digits become floats that are not
    finite, so that `Item` can name their place.

    Args:
        content: The text; bytes are UTF-8.
        file: Its name, for errors.
        where: Prefix of every place in an error, such as ``message 7``.

    Raises:
        ConfigError: It is not JSON, a table has a key twice, or brackets are nested hundreds deep.
    """
    text = decode_text(content, file) if isinstance(content, bytes) else content.removeprefix("\ufeff")
    prefix = f"{where}: " if where else ""
    try:
        value = json.loads(text, parse_int=_integer, object_pairs_hook=_table)
    except json.JSONDecodeError as error:
        line, column = (0, 0) if where else (error.lineno, error.colno)
        raise ConfigError(f"{prefix}not JSON: {error.msg}", file=file, line=line, column=column) from None
    except RecursionError:
        raise ConfigError(f"{prefix}brackets are nested too deeply", file=file) from None
    except _TwiceError as error:
        raise ConfigError(f"{prefix}the key {error.key!r} occurs twice in one table", file=file) from None
    return Item(value, file, where)


class _TwiceError(Exception):
    def __init__(self, key: str) -> None:
        super().__init__(key)
        self.key = key[:_SHOWN]


def _integer(digits: str) -> int | float:
    if len(digits) > _MOST_DIGITS:
        return -math.inf if digits[0] == "-" else math.inf
    return int(digits)


def _table(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        seen = set()
        for key, _ in pairs:
            if key in seen:
                raise _TwiceError(key)
            seen.add(key)
    return table


def parse_toml(text: str, file: str = "") -> Item:
    """Parse TOML.

    Raises:
        ConfigError: It is not TOML, or brackets or keys are nested too deeply; with line and column.
    """
    if code := _LONG_CODE.search(text):
        raise _at(text, code.start(), "a number with too many digits", file)
    for i, row in enumerate(text.split("\n"), 1):
        if row.count(".") > _MOST_DOTS and not row.lstrip().startswith("#"):
            raise ConfigError(f"more than {_MOST_DOTS} dots in a line; split it", file=file, line=i, column=1)
    try:
        return Item(tomllib.loads(text), file, "", _toml_places(text))
    except tomllib.TOMLDecodeError as error:
        found = _TOML_PLACE.fullmatch(str(error))
        message, line, column = (found[1], int(found[2]), int(found[3])) if found else (str(error), 0, 0)
        raise ConfigError(f"not TOML: {message}", file=file, line=line, column=column) from None
    except RecursionError:
        raise ConfigError("brackets are nested too deeply", file=file) from None
    except ValueError:
        # A whole number of thousands of digits, which Python does not parse.
        digits = _LONG_NUMBER.search(text)
        raise _at(text, digits.start() if digits else 0, "a number with too many digits", file) from None


def _toml_places(text: str) -> dict[str, tuple[int, int]]:
    """Line and column of each table's header and each key's value, by the place that `Item` gives it.

    tomllib does not report them. A value inside brackets has the place of its key. A line of a multi-line string
    may look like a key: an error that names this key then has the wrong line.
    """
    places: dict[str, tuple[int, int]] = {}
    last: dict[str, int] = {}  # array of tables -> index of its last one
    above = ""
    for number, line in enumerate(text.split("\n"), 1):
        name, equals, rest = line.partition("=")
        head = line.lstrip()
        if not head.startswith("["):
            if equals and (steps := _steps(name)):
                column = len(name) + len(rest) - len(rest.lstrip()) + 2
                places.setdefault(_joined(above, steps, last), (number, column))
            continue
        is_array = head.startswith("[[")
        if steps := _steps(head.lstrip("[").partition("]")[0]):
            place = number, len(line) - len(head) + 1
            above = _joined("", steps[:-1], last)
            above += _step(steps[-1], above)
            places.setdefault(above, place)
            if is_array:
                last[above] = last.get(above, -1) + 1
                above += f"[{last[above]}]"
                places.setdefault(above, place)
    return places


def _steps(name: str) -> list[str]:
    """The parts of a key; none unless all are plain names."""
    steps = [part.strip().strip("\"'") for part in name.split(".")]
    return steps if all(_PLAIN_KEY.fullmatch(step) for step in steps) else []


def _joined(above: str, steps: Sequence[str], last: Mapping[str, int]) -> str:
    for step in steps:
        above += _step(step, above)
        if above in last:
            above += f"[{last[above]}]"
    return above


def _at(text: str, place: int, message: str, file: str) -> ConfigError:
    before = text[:place]
    return ConfigError(message, file=file, line=before.count("\n") + 1, column=place - before.rfind("\n"))


# -- values -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Item:
    """A value of a file, with its place.

    Attributes:
        value: As it was parsed.
        file: The file's name.
        where: Its place, such as ``points[3].positions``; empty for the whole file.
        places: Line and column of such places, as far as they are known.
    """

    value: Any
    file: str = ""
    where: str = ""
    places: Mapping[str, tuple[int, int]] = field(default_factory=dict, repr=False, compare=False)

    @property
    def line_and_column(self) -> tuple[int, int]:
        """Its line and column in the file, or those of what contains it, both from 1; 0, 0 if unknown."""
        where = self.where
        while where and where not in self.places:
            where = where[: max(where.rfind("."), where.rfind("["), 0)]
        return self.places.get(where, (0, 0))

    def fault(self, text: str) -> ConfigError:
        """The error with this text about the value, and its place."""
        line, column = self.line_and_column
        return ConfigError(f"{self.where} {text}" if self.where else text, file=self.file, line=line, column=column)

    def table(self, needed: Collection[str] = (), optional: Collection[str] | None = None) -> dict[str, Item]:
        """The values of a table by key.

        Args:
            needed: The keys it must have.
            optional: The other keys it may have; any if None.

        Raises:
            ConfigError: It is not a table, or a key is unknown or missing.
        """
        if not isinstance(self.value, Mapping):
            raise self.wrong_kind("a table")
        known = None if optional is None else dict.fromkeys((*needed, *optional))
        for key in self.value:
            if known is not None and key not in known:
                # Loaded late: every program imports this module, and few files have such a key.
                from difflib import get_close_matches

                near = get_close_matches(str(key)[:_SHOWN], known, n=1)
                hint = f", did you mean {near[0]}?" if near else f"; known: {', '.join(known)}"
                raise self.step(str(key)).fault(f"is an unknown key{hint}")
        for key in needed:
            if key not in self.value:
                raise self.step(key).fault("is missing")
        return {key: self.step(str(key), value) for key, value in self.value.items()}

    def rows(self, most: int | None = None, least: int = 0) -> Iterator[Item]:
        """The values of a list, one after the other.

        Raises:
            ConfigError: It is not a list, or has too many or too few values.
        """
        if not isinstance(self.value, list | tuple):
            raise self.wrong_kind("a list")
        if len(self.value) < least or (most is not None and len(self.value) > most):
            wanted = f"{least}" if least == most else f"at least {least}" if most is None else f"{least} to {most}"
            raise self.fault(f"has {len(self.value)} values, but must have {wanted}")
        return (self.step(i, value) for i, value in enumerate(self.value))

    def each(self, read: Callable[[Item], _T], most: int | None = None, least: int = 0) -> list[_T]:
        """What `read` makes of each value of a list; the first ten faults are told together, each with its place.

        Raises:
            ConfigError: As `rows` and `read`.
        """
        found, faults = list[_T](), list[ConfigError]()
        for row in self.rows(most, least):
            try:
                found.append(read(row))
            except ConfigError as error:
                faults.append(error)
        if len(faults) == 1:
            raise faults[0]
        if faults:
            told = [str(error).removeprefix(f"{self.file}:").strip() for error in faults]
            raise ConfigError("; ".join(first_faults(told)), file=self.file)
        return found

    def numbers(self, count: int, low: float, high: float, unit: str = "") -> tuple[float, ...]:
        """A list of so many finite numbers within bounds.

        Raises:
            ConfigError: It is not.
        """
        return tuple([row.number(low, high, unit) for row in self.rows(count, count)])

    def number(self, low: float = -math.inf, high: float = math.inf, unit: str = "") -> float:
        """A finite number within bounds.

        Raises:
            ConfigError: It is not.
        """
        value = self.value
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.wrong_kind("a number")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise self.fault("must be a finite number")
        if not low <= number <= high:
            raise self.fault(f"is {number:.6g}, but must be {_bounds(low, high)}{f' {unit}' if unit else ''}")
        return number

    def integer(self, low: int, high: int) -> int:
        """A whole number within bounds; a float is refused.

        Raises:
            ConfigError: It is not.
        """
        value = self.value
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.wrong_kind("a whole number")
        if not low <= value <= high:
            shown = value if abs(value) < 10**_MOST_DIGITS else "too large"
            raise self.fault(f"is {shown}, but must be {low} to {high}")
        return value

    def text(self, most: int = 1000, *, least: int = 0) -> str:
        """A line of text with `least` to `most` characters.

        Raises:
            ConfigError: It is not text, is too short or too long, or has characters that cannot be printed.
        """
        if not isinstance(self.value, str):
            raise self.wrong_kind("text")
        if not least <= len(self.value) <= most:
            raise self.fault(f"has {len(self.value)} characters, but must have {least} to {most}")
        if not self.value.isprintable():
            raise self.fault("has characters that cannot be printed")
        return self.value

    def flag(self) -> bool:
        """True or false; not 0 or 1.

        Raises:
            ConfigError: It is neither.
        """
        if not isinstance(self.value, bool):
            raise self.wrong_kind("true or false")
        return self.value

    def choice(self, known: Collection[str]) -> str:
        """One of these texts.

        Raises:
            ConfigError: It is not.
        """
        if not isinstance(self.value, str) or self.value not in known:
            raise self.wrong_kind(f"one of {', '.join(known)}")
        return self.value

    def step(self, key: str | int, value: Any = None) -> Item:
        """The value under a key or an index, or without `value` only its place."""
        step = f"[{key}]" if isinstance(key, int) else _step(str(key), self.where)
        return Item(value, self.file, f"{self.where}{step}", self.places)

    def wrong_kind(self, wanted: str) -> ConfigError:
        """The error that says which kind of value is needed and which this is."""
        value = self.value
        if isinstance(value, Mapping):
            got = "a table"
        elif isinstance(value, list | tuple):
            got = f"the list {reprlib.repr(list(value[:_SHOWN]))}"
        elif isinstance(value, bool) or value is None:
            got = {True: "true", False: "false", None: "nothing"}[value]
        elif isinstance(value, str):
            got = f"the text {value[:_SHOWN]!r}"
        elif isinstance(value, int) and abs(value) >= 10**_MOST_DIGITS:
            got = "a number with too many digits"
        else:
            got = f"{value}"[:_SHOWN]
        return self.fault(f"must be {wanted}, not {got}")


def first_faults(texts: Sequence[str]) -> list[str]:
    """The first faults, and how many others there are: nobody reads ten thousand at once."""
    if len(texts) <= MOST_FAULTS:
        return list(texts)
    return [*texts[:MOST_FAULTS], f"and {len(texts) - MOST_FAULTS} more"]


def _step(key: str, where: str) -> str:
    """The part of a place that names a key; an unusual key is quoted, so that it cannot break an error's line."""
    shown = key if _PLAIN_KEY.fullmatch(key) else repr(key[:_SHOWN])
    return f".{shown}" if where else shown


def _bounds(low: float, high: float) -> str:
    if high == math.inf:
        return f"{low:g} or more"
    return f"{high:g} or less" if low == -math.inf else f"{low:g} to {high:g}"
