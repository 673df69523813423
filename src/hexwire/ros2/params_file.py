"""Parameters in YAML, as `rcl` reads them: files with node names and wildcards, and the values of ``-p``.

Owns the reading of files, `rcl`'s meaning of a plain scalar, and which node a pattern is for.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any

from hexwire.errors import ConfigError, NotSupportedError
from hexwire.inputs import read_text
from zenoh_ros2 import UsageError as RosUsageError
from zenoh_ros2 import check_node_name

__all__ = ["KEY", "Overrides", "matches", "parse_value", "read_params_file"]

KEY = "ros__parameters"
_LARGEST = 256 * 1024
_DEEPEST = 32
_MOST = 10_000
"""Most values of a file."""
_TRUE = frozenset(["Y", "y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON"])
_FALSE = frozenset(["N", "n", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF"])
_INTEGER = re.compile(r"[+-]?(0[xX][0-9a-fA-F]{1,16}|0[0-7]{0,22}|[1-9][0-9]{0,19})", re.ASCII)
_FLOAT = re.compile(r"[+-]?([0-9]{1,400}(\.[0-9]{0,400})?|\.[0-9]{1,400})([eE][+-]?[0-9]{1,9})?", re.ASCII)
_SPECIAL = re.compile(r"([+-]?)\.?(inf|Inf|INF)|\.?(nan|NaN|NAN)")
_STRING_TAG = "tag:yaml.org,2002:str"
_SPACE = re.compile(r"\s+")

Overrides = dict[str, dict[str, Any]]
"""For each node pattern, such as ``/arm/driver`` or ``/**``, its parameters; their names have dots."""


def matches(pattern: str, full_name: str) -> bool:
    """Whether a pattern is for a node.

    Args:
        pattern: ``*`` stands for one part of the name, ``**`` for any number of parts; the first slash may be left
            out.
        full_name: Of the node, with its namespace.
    """
    name = full_name.strip("/").split("/")
    # Which beginnings of the name the pattern so far stands for: time is bounded for any pattern.
    reached = {0}
    for part in pattern.strip("/").split("/"):
        if part == "**":
            reached = set(range(min(reached), len(name) + 1))
        else:
            reached = {at + 1 for at in reached if at < len(name) and part in ("*", name[at])}
        if not reached:
            return False
    return len(name) in reached


def parse_value(text: str, what: str = "") -> Any:
    """The value in a short YAML text: a scalar, or a list of scalars of one type.

    Args:
        text: As after ``-p name:=``.
        what: What it is the value of, for errors.

    Raises:
        ConfigError: It is none.
    """
    reader = _YamlReader(text, what)
    value = reader.value(reader.next())
    reader.finish()
    return value


def read_params_file(path: str) -> Overrides:
    """Read a file of parameters.

    Raises:
        ConfigError: It cannot be read, or is not in ROS's form; with the line.
        NotSupportedError: PyYAML is not installed.
    """
    reader = _YamlReader(read_text(path, largest=_LARGEST), path)
    found: Overrides = {}
    event = reader.next()
    if event is not None:
        reader.nodes(event, (), found)
    reader.finish()
    return found


class _YamlReader:
    """Reads YAML event by event, so that nothing is built before its bounds are checked."""

    def __init__(self, text: str, file: str) -> None:
        try:
            import yaml
        except ImportError:
            raise NotSupportedError(
                "files of parameters need PyYAML, which is not installed: pip install 'hexwire[ros2]'"
            ) from None
        self._yaml, self._file = yaml, file
        self._events = self._bounded(text)
        self._count = 0

    def _bounded(self, text: str) -> Iterator[Any]:
        yaml, depth = self._yaml, 0
        try:
            for event in yaml.parse(text, yaml.SafeLoader):
                if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
                    raise self._fault(event, "Will not support aliasing")
                depth += isinstance(event, yaml.CollectionStartEvent)
                depth -= isinstance(event, yaml.CollectionEndEvent)
                if depth > _DEEPEST:
                    raise self._fault(event, f"is nested deeper than {_DEEPEST} levels")
                if isinstance(event, yaml.NodeEvent | yaml.CollectionEndEvent):
                    yield event
        except yaml.YAMLError as error:
            mark = getattr(error, "problem_mark", None)
            text = _SPACE.sub(" ", str(getattr(error, "problem", None) or error))[:200]
            raise ConfigError(text, file=self._file, line=mark.line + 1 if mark else 0) from None

    def next(self) -> Any:
        """The next event; None after the last one."""
        return next(self._events, None)

    def finish(self) -> None:
        """Check that nothing follows."""
        if (event := self.next()) is not None:
            raise self._fault(event, "has more than one document")

    def _fault(self, event: Any, text: str) -> ConfigError:
        return ConfigError(text, file=self._file, line=event.start_mark.line + 1 if self._file else 0)

    def _pairs(self, event: Any) -> Iterator[tuple[Any, Any]]:
        """Keys and first events of the values of a table, whose first event is `event`."""
        while not isinstance(key := self.next(), self._yaml.MappingEndEvent):
            if not isinstance(key, self._yaml.ScalarEvent):
                raise self._fault(key, "Sequences cannot be key")
            if not key.value:
                raise self._fault(key, "No key")
            yield key, self.next()

    def nodes(self, event: Any, parts: tuple[str, ...], found: Overrides) -> None:
        """Read a table of namespaces and nodes."""
        if not isinstance(event, self._yaml.MappingStartEvent):
            raise self._fault(event, f"Cannot have a value before {KEY}")
        for key, value in self._pairs(event):
            if key.value != KEY:
                self.nodes(value, (*parts, key.value), found)
                continue
            if not parts:
                raise self._fault(key, f"There are no node names before {KEY}")
            if not isinstance(value, self._yaml.MappingStartEvent):
                raise self._fault(value, f"{KEY} must be a table of parameters")
            self.parameters(value, "", found.setdefault(self._pattern(key, parts), {}))

    def _pattern(self, event: Any, parts: tuple[str, ...]) -> str:
        pattern = "/" + "/".join(part.strip("/") for part in parts if part != "/")
        try:
            for part in pattern[1:].split("/"):
                if part not in ("*", "**"):
                    check_node_name(part)
        except RosUsageError as error:
            raise self._fault(event, str(error)) from None
        return pattern

    def parameters(self, event: Any, prefix: str, found: dict[str, Any]) -> None:
        """Read a table of parameters; nested ones have names with dots."""
        for key, value in self._pairs(event):
            name = f"{prefix}{key.value}"
            if isinstance(value, self._yaml.MappingStartEvent):
                self.parameters(value, f"{name}.", found)
            else:
                found[name] = self.value(value)

    def value(self, event: Any) -> Any:
        """Read a value, whose first event is `event`."""
        if isinstance(event, self._yaml.ScalarEvent):
            return self._scalar(event)
        if not isinstance(event, self._yaml.SequenceStartEvent):
            raise (
                self._fault(event, "a value is a scalar or a list")
                if event is not None
                else ConfigError("No value", file=self._file)
            )
        values: list[Any] = []
        while not isinstance(item := self.next(), self._yaml.SequenceEndEvent):
            if not isinstance(item, self._yaml.ScalarEvent):
                raise self._fault(item, "a list may have scalars only")
            value = self._scalar(item)
            if values and type(value) is not type(values[0]):
                kind = {bool: "bool", int: "integer", float: "double", str: "string"}[type(value)]
                raise self._fault(item, f"Sequence should be of same type. Value type '{kind}' do not belong")
            values.append(value)
        return values

    def _scalar(self, event: Any) -> bool | int | float | str:
        self._count += 1
        if self._count > _MOST:
            raise self._fault(event, f"has more than {_MOST} values")
        if event.style in ("'", '"') or event.tag == _STRING_TAG:
            return str(event.value)
        if not event.value:
            raise self._fault(event, "No value")
        return _plain(event.value)


def _plain(text: str) -> bool | int | float | str:
    """What a scalar without quotes means to `rcl`."""
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    if _INTEGER.fullmatch(text):
        digits = text.lstrip("+-")
        octal = digits[0] == "0" and digits[1:2] not in ("", "x", "X")
        value = int(digits, 8 if octal else 0) * (-1 if text[0] == "-" else 1)
        if -(2**63) <= value < 2**63:
            return value
    if special := _SPECIAL.fullmatch(text):
        return math.nan if special[3] else -math.inf if special[1] == "-" else math.inf
    if _FLOAT.fullmatch(text) and math.isfinite(number := float(text)):
        return number
    return text
