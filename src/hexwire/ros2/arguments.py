"""The command line of a ROS 2 node: what stands after ``--ros-args``, as `rcl` reads it, and ROS_DOMAIN_ID.

Owns the grammar of these arguments and the order in which parameters override each other.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from hexwire.errors import UsageError
from zenoh_ros2 import Remap, parse_remap
from zenoh_ros2 import UsageError as RosUsageError

from .params_file import Overrides, matches, parse_value, read_params_file

__all__ = ["LEVELS", "RosArguments", "parse_arguments"]

_log = logging.getLogger(__name__)

LEVELS = {"UNSET": 0, "DEBUG": 10, "INFO": 20, "WARN": 30, "ERROR": 40, "FATAL": 50}
"""ROS's severities; the numbers are those of Python's, too."""

_START, _END = "--ros-args", "--"
_PARAM = re.compile(r"(?:([A-Za-z0-9_]+):(?!=))?([A-Za-z0-9_/]+(?:\.[A-Za-z0-9_/]+)*):=(.*)", re.ASCII | re.DOTALL)
_ENCLAVE = re.compile(r"/|(/[A-Za-z_][A-Za-z0-9_]*){1,32}", re.ASCII)
_LARGEST_VALUE = 64 * 1024
_SWITCHES = ("stdout-logs", "rosout-logs", "external-lib-logs")


@dataclass(frozen=True, slots=True)
class RosArguments:
    """What a command line says.

    Attributes:
        remaps: Rules, in order.
        overrides: Parameters for each node pattern, in the order in which patterns first appeared.
        enclave: Security enclave.
        level: Severity from which all loggers log; None if not given.
        levels: That of single loggers.
        stdout_logs: Whether to log to the console.
        rosout_logs: Whether to log to ``/rosout``.
        log_file: Prefix of the name of a log file; empty if not given.
        others: What is not for ROS.
    """

    remaps: tuple[Remap, ...] = ()
    overrides: Overrides = field(default_factory=dict)
    enclave: str = "/"
    level: int | None = None
    levels: Mapping[str, int] = field(default_factory=dict)
    stdout_logs: bool = True
    rosout_logs: bool = True
    log_file: str = ""
    others: tuple[str, ...] = ()

    def parameters(self, full_name: str) -> dict[str, Any]:
        """The parameters for a node; later patterns override earlier ones.

        Args:
            full_name: With its namespace, after remapping.
        """
        found: dict[str, Any] = {}
        for pattern, values in self.overrides.items():
            if matches(pattern, full_name):
                found |= values
        return found

    def level_of(self, logger: str) -> int:
        """The severity from which a logger logs: its own, else that of the nearest logger above it; 0 for none.

        Args:
            logger: Its name, such as ``left.driver``, which is below ``left``.
        """
        while logger:
            if level := self.levels.get(logger):
                return level
            logger = logger.rpartition(".")[0]
        return self.level or 0


def parse_arguments(words: Sequence[str]) -> RosArguments:
    """Read a command line without the name of the program.

    Raises:
        ConfigError: A file of parameters cannot be used.
        UsageError: An argument after ``--ros-args`` is not one of ROS, or is not valid.
    """
    return _Parser(words).parse()


class _Parser:
    def __init__(self, words: Sequence[str]) -> None:
        self._words = list(words)
        self._remaps: list[Remap] = []
        self._overrides: Overrides = {}
        self._levels: dict[str, int] = {}
        self._level: int | None = None
        self._enclave, self._log_file = "/", ""
        self._switches = dict.fromkeys(_SWITCHES, True)
        self._others: list[str] = []
        self._unknown: list[str] = []

    def parse(self) -> RosArguments:
        """Read all words."""
        ours = False
        while self._words:
            word = self._words.pop(0)
            if word == _START:
                ours = True
            elif not ours:
                self._other(word)
            elif word == _END:
                ours = False
            else:
                self._ros(word)
        if self._unknown:
            names = ", ".join(f"'{word[:100]}'" for word in self._unknown)
            raise UsageError(f"found unknown ROS arguments: {names}")
        return RosArguments(
            tuple(self._remaps),
            self._overrides,
            self._enclave,
            self._level,
            self._levels,
            self._switches["stdout-logs"],
            self._switches["rosout-logs"],
            self._log_file,
            tuple(self._others),
        )

    def _other(self, word: str) -> None:
        try:
            rule = parse_remap(word)
        except RosUsageError:
            self._others.append(word)
            return
        self._remaps.append(rule)
        _log.warning(
            "Found remap rule '%s'. This syntax is deprecated. Use '%s --remap %s' instead.", word, _START, word
        )

    def _ros(self, flag: str) -> None:
        """Read one argument of ROS."""
        for switch in _SWITCHES:
            if flag in (f"--enable-{switch}", f"--disable-{switch}"):
                self._switches[switch] = flag.startswith("--enable")
                return
        match flag:
            case "-r" | "--remap":
                self._remaps.append(self._read(flag, "remap rule", parse_remap))
            case "-p" | "--param":
                self._read(flag, "parameter override rule", self._parameter)
            case "--params-file":
                self._merge(self._read(flag, "params file", read_params_file, "file path"))
            case "--log-level":
                self._read(flag, "log level", self._severity)
            case "-e" | "--enclave":
                self._enclave = self._read(flag, "enclave name", _enclave, "enclave path")
            case "--log-file-name":
                self._log_file = self._read(flag, "log file name prefix", str, "string prefix")
            case "--log-config-file":
                self._read(flag, "log configuration file", _no_config, "file path")
            case _:
                self._unknown.append(flag)

    def _read(self, flag: str, what: str, read: Any, missing: str = "") -> Any:
        if not self._words:
            found = "provided" if missing or what == "log level" else "found"
            raise UsageError(f"Couldn't parse trailing {flag} flag. No {missing or what} {found}.")
        word = self._words.pop(0)
        try:
            return read(word)
        except (UsageError, RosUsageError) as error:
            shown = word if len(word) <= 200 else f"{word[:200]}..."
            raise UsageError(f"Couldn't parse {what}: '{flag} {shown}'. Error: {error}") from None

    def _parameter(self, text: str) -> None:
        match = _PARAM.fullmatch(text) if len(text) <= _LARGEST_VALUE else None
        if match is None:
            raise UsageError("a parameter override has the form NAME:=VALUE or NODE:NAME:=VALUE")
        node, name, value = match.groups()
        self._merge({node or "/**": {name: parse_value(value, name)}})

    def _merge(self, more: Overrides) -> None:
        for pattern, values in more.items():
            self._overrides.setdefault("/" + pattern.lstrip("/"), {}).update(values)

    def _severity(self, text: str) -> None:
        name, found, level = text.rpartition(":=")
        if level.upper() not in LEVELS:
            raise UsageError("Argument does not use a valid severity level")
        if not found:
            self._level = LEVELS[level.upper()]
        elif not name:
            raise UsageError("Argument has an invalid logger item that name is empty")
        else:
            self._levels[name] = LEVELS[level.upper()]


def _enclave(text: str) -> str:
    if not _ENCLAVE.fullmatch(text):
        raise UsageError("an enclave is an absolute name, as in /arm/driver")
    return text


def _no_config(text: str) -> str:
    raise UsageError("there is no external logging library here")
