"""Writes tables as YAML, the same text for the same table.

Owns the form: mappings over lines, lists of plain values on one line, text quoted where YAML would read something
else.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import TypeAlias

__all__ = ["Value", "yaml_text"]

Value: TypeAlias = "str | int | float | bool | Sequence[Value] | Mapping[str, Value]"

# What no reader of YAML 1.1 or 1.2 takes for anything but text.
_PLAIN = re.compile(r"[A-Za-z_/~][A-Za-z0-9_./:]*[A-Za-z0-9_]", re.ASCII)
_OTHER = {"true", "false", "yes", "no", "on", "off", "null", "nan", "inf"}


def yaml_text(table: Mapping[str, Value], *, head: Sequence[str] = ()) -> str:
    """A table as a YAML document.

    Args:
        table: Keys and values; lists hold plain values only.
        head: Lines of a comment before it.
    """
    return "".join(f"{line}\n" for line in [*(f"# {line}" for line in head), *_lines(table, "")])


def _lines(table: Mapping[str, Value], indent: str) -> list[str]:
    rows = []
    for key, value in table.items():
        if isinstance(value, Mapping) and value:
            rows += [f"{indent}{_word(key)}:", *_lines(value, indent + "  ")]
        else:
            rows.append(f"{indent}{_word(key)}: {_scalar(value)}")
    return rows


def _scalar(value: Value) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return _word(value)
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return _number(value)
    if isinstance(value, Mapping):
        return "{}"
    return "[" + ", ".join(_scalar(item) for item in value) + "]"


def _number(value: float) -> str:
    if not math.isfinite(value):
        return ".nan" if math.isnan(value) else ".inf" if value > 0 else "-.inf"
    text = repr(value + 0.0)
    # YAML 1.1 reads a number without a point as text if it has an exponent.
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


def _word(text: str) -> str:
    plain = _PLAIN.fullmatch(text) and text.lower() not in _OTHER and not text.endswith(":")
    return text if plain else '"' + "".join(map(_escaped, text)) + '"'


def _escaped(letter: str) -> str:
    if letter in '"\\':
        return "\\" + letter
    return letter if " " <= letter <= "~" else f"\\U{ord(letter):08x}"
