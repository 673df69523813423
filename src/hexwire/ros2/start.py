"""Starts the node from ROS's arguments, and shows its log on the console as ROS nodes do.

Owns the order of the first steps: arguments, parameters, the log, the node.
"""

from __future__ import annotations

import logging
import queue
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from logging.handlers import QueueHandler, QueueListener
from typing import Any

from hexwire.errors import UsageError
from zenoh_ros2 import NodeOptions, domain_of, full_name, load_zenoh, logger_name, remap_node

from .arguments import LEVELS, RosArguments, parse_arguments
from .hardware_interface import NAME, HardwareInterface
from .secure_settings import SecureSettings
from .settings import load_settings
from .wire import LOGGERS, own_errors

__all__ = ["run"]

_FILE = "ZENOH_SESSION_CONFIG_URI"
_OPTIONS = {"--router": "connect", "--ca": "ca", "--cert": "cert", "--key": "key"}
"""Options of the program and the settings that they give."""
_SWITCH = 0.0005
"""Seconds for which one thread may run while others wait. The owner of an arm gives its turn away with every
message that it publishes, and servos that are asked one by one on a slow line seem silent if it comes back late."""
_SEVERITIES = {number: name for name, number in LEVELS.items()}


@own_errors()
def run(words: Sequence[str], environ: Mapping[str, str]) -> int:
    """Run the node until a signal ends it.

    Args:
        words: The program's own options and ROS's arguments, without its name.
        environ: Environment variables.

    Returns:
        Exit status.

    Raises:
        UsageError: Arguments or parameters are wrong; the text names the first ones.
        LinkError: The robot's port or the Zenoh session cannot be opened.
        DeviceError: The robot does not answer, or the node failed.
    """
    load_zenoh()
    arguments = parse_arguments(words)
    zenoh = _zenoh(arguments.others, environ)
    namespace, name = remap_node("/", NAME, arguments.remaps)
    settings, robot = load_settings(arguments.parameters(full_name(namespace, name)), environ)
    options = NodeOptions(
        NAME,
        domain=domain_of(environ),
        remaps=arguments.remaps,
        enclave=arguments.enclave,
        zenoh=zenoh,
        rosout=arguments.rosout_logs,
        loggers=LOGGERS,
        type_descriptions=settings.describes_types,
    )
    sys.setswitchinterval(_SWITCH)
    with _console(arguments, logger_name(full_name(namespace, name))):
        return HardwareInterface(options, settings, robot).run()


def _zenoh(words: Sequence[str], environ: Mapping[str, str]) -> SecureSettings:
    """How the node reaches its router, from its own options and `rmw_zenoh`'s environment variables."""
    given: dict[str, list[str]] = {}
    rest = list(words)
    while rest:
        option, found, value = rest.pop(0).partition("=")
        if option not in _OPTIONS:
            raise UsageError(
                f"no option {option[:100]!r}; ROS's arguments follow --ros-args, as in: hexwire-ros2 --ros-args "
                "-p port:=/dev/ttyUSB0"
            )
        if not found and not rest:
            raise UsageError(f"{option} needs a value")
        given.setdefault(_OPTIONS[option], []).append(value if found else rest.pop(0))
    routers = given.pop("connect", [])
    more: dict[str, Any] = {name: values[-1] for name, values in given.items()}
    if routers:
        more["connect"] = tuple(routers)
    if more and environ.get(_FILE):
        raise UsageError(f"{_FILE} names the router and its certificates; leave out the options for them")
    return SecureSettings.from_environment(environ, **more)


@contextmanager
def _console(arguments: RosArguments, name: str) -> Iterator[None]:
    """Show the program's log on standard error, in a thread of its own: the arm must not wait for a console.

    Args:
        arguments: Which of it.
        name: Of the node's logger.
    """
    loggers = [logging.getLogger(each) for each in LOGGERS]
    lines: queue.SimpleQueue[logging.LogRecord | None] = queue.SimpleQueue()
    shown = logging.StreamHandler(sys.stderr)
    shown.setFormatter(_RosFormat(name))
    listener = QueueListener(lines, shown)
    # Without any handler, Python writes warnings to standard error all the same.
    handler = QueueHandler(lines) if arguments.stdout_logs else logging.NullHandler()
    before = [(logger.level, logger.propagate) for logger in loggers]
    for logger in loggers:
        logger.addHandler(handler)
        logger.propagate = False
        logger.setLevel(arguments.level_of(name) or logging.INFO)
    listener.start()
    try:
        yield
    finally:
        for logger, (level, propagate) in zip(loggers, before, strict=True):
            logger.removeHandler(handler)
            logger.level, logger.propagate = level, propagate
        listener.stop()
        with suppress(OSError, ValueError):
            shown.flush()


class _RosFormat(logging.Formatter):
    """A line as ROS nodes write it: severity, time, name of the node's logger, text."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self._name = name

    def format(self, record: logging.LogRecord) -> str:
        severity = _SEVERITIES.get(record.levelno, record.levelname)
        return f"[{severity}] [{record.created:.9f}] [{self._name}]: {super().format(record)}"
