"""Filters for a list of frames, in simple words: ``servo 3``, ``joint_move``, ``bad``, ``slow 20``, ``not sent``.

Owns the language.

Conditions are separated by blanks, and all of them must hold:

    servo 3        names servo 3, also in a mask of the board's joints; servo 3,4 one of both
    joint_move     that command or instruction; a word that is none is searched for in the text
    "two words"    searched for in the text
    bad            no valid frame or packet
    doubt          bad, with a remark, or an answer that reports an error
    problem        the same, or a request that was not answered
    sent received request answer unanswered report frame packet
    dialect 2      frames of that dialect
    slow 20        an answer that took more than 20 ms, and its request
    bytes 0D0A     has these bytes
    not ...        the next condition must not hold; -... is the same
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from hexwire.errors import UsageError
from hexwire.wire import tables as t

from .reading import FrameReading
from .traffic import Entry

__all__ = ["Filter", "is_unanswered", "parse_filter"]

_Condition = Callable[[Entry], bool]

_LONGEST = 200
_TOKEN = re.compile(r'(-?)(?:"([^"]*)"?|([^\s"]+))')
_ANSWERED_BY_ALL = ("ping", "sync_read")
_NAMES = {name.lower() for name in (*t.COMMANDS, *t.INSTRUCTIONS)} | {"status"}


def _is_answer(entry: Entry) -> bool:
    return entry.reading.kind in ("frame", "packet") and entry.reading.answer


def _is_request(entry: Entry) -> bool:
    reading = entry.reading
    return reading.kind in ("frame", "packet") and not reading.answer and not _is_report(reading)


def _is_awaited(entry: Entry) -> bool:
    """Whether somebody answers it: no servo answers what goes to all, but for a ping and a read of several."""
    reading = entry.reading
    if reading.kind == "packet":
        return reading.data[2] != t.BROADCAST_ID or entry.name in _ANSWERED_BY_ALL
    return not (reading.data[33] == t.PROTO_CHAPTER and entry.name == "sync_write")


def is_unanswered(entry: Entry) -> bool:
    """Whether an answer is due to it that has not come, or not yet."""
    return _is_request(entry) and entry.answered is None and _is_awaited(entry)


def _is_report(reading: FrameReading) -> bool:
    """Whether it is a frame that a board sends by itself: it asks nothing, and answers nothing."""
    return reading.kind == "frame" and reading.data[33] == 2 and reading.data[39] & 0xC0 == 0x40


_WORDS: dict[str, _Condition] = {
    "bad": lambda entry: entry.bad,
    "doubt": lambda entry: bool(entry.problem),
    "sent": lambda entry: entry.sent,
    "received": lambda entry: not entry.sent,
    "frame": lambda entry: entry.reading.kind == "frame",
    "packet": lambda entry: entry.reading.kind == "packet",
    "request": _is_request,
    "answer": _is_answer,
    "report": lambda entry: _is_report(entry.reading),
    "unanswered": is_unanswered,
    "problem": lambda entry: bool(entry.problem) or is_unanswered(entry),
}


_OF_ANSWERS = frozenset(("unanswered", "problem", "slow"))


@dataclass(frozen=True, slots=True)
class Filter:
    """Says whether an entry passes.

    Attributes:
        of_answers: Whether a request passes may depend on its answer, so it is known only when that is overdue.
    """

    _conditions: tuple[_Condition, ...]
    of_answers: bool

    def __call__(self, entry: Entry) -> bool:
        return all(condition(entry) for condition in self._conditions)


def parse_filter(text: str) -> Filter:
    """Parse a filter.

    Args:
        text: See the module; empty for everything.

    Raises:
        UsageError: A word lacks its number, or the filter is too long.
    """
    if len(text) > _LONGEST:
        raise UsageError(f"a filter has at most {_LONGEST} characters")
    words = {match[3].lower() for match in _TOKEN.finditer(text) if match[3] is not None}
    return Filter(tuple(_conditions(text)), not words.isdisjoint(_OF_ANSWERS))


def _conditions(text: str) -> Iterator[_Condition]:
    tokens = [(bool(m[1]), m[2] if m[3] is None else m[3], m[3] is None) for m in _TOKEN.finditer(text)]
    at, negative = 0, False
    while at < len(tokens):
        minus, word, quoted = tokens[at]
        negative = negative != minus
        at += 1
        if not quoted and word.lower() == "not":
            negative = not negative
            if at == len(tokens):
                raise UsageError("what follows 'not'? For example: not servo 3")
            continue
        following = tokens[at][1] if at < len(tokens) else ""
        condition, used = (_text(word), 0) if quoted else _condition(word, following)
        at += used
        yield _inverted(condition) if negative else condition
        negative = False


def _condition(word: str, following: str) -> tuple[_Condition, int]:
    """The condition of a word, and how many of the following words belong to it."""
    name = word.lower()
    if name in _WORDS:
        return _WORDS[name], 0
    if name == "servo":
        wanted = frozenset(_whole(each, "servo 3, or servo 3,4", 254) for each in following.split(","))
        return lambda entry: not wanted.isdisjoint(entry.servos), 1
    if name == "dialect":
        dialect = _whole(following, "dialect 2", 255)
        return lambda entry: entry.reading.kind == "frame" and entry.reading.data[33] == dialect, 1
    if name == "slow":
        least = _whole(following, "slow 20, in milliseconds", 1_000_000) / 1000
        return lambda entry: entry.took is not None and entry.took > least, 1
    if name == "bytes":
        try:
            pattern = bytes.fromhex(following)
        except ValueError:
            pattern = b""
        if not pattern:
            raise UsageError("bytes needs pairs of hex digits, such as bytes 0D0A")
        return lambda entry: pattern in entry.reading.data, 1
    if name in _NAMES:
        return lambda entry: entry.name == name, 0
    return _text(word), 0


def _text(wanted: str) -> _Condition:
    low = wanted.lower()
    return lambda entry: low in entry.reading.text.lower()


def _inverted(condition: _Condition) -> _Condition:
    return lambda entry: not condition(entry)


def _whole(text: str, example: str, most: int) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 9 and int(text) <= most):
        raise UsageError(f"{example.split()[0]} needs a number up to {most}: {example}")
    return int(text)
