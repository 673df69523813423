"""Starts the node from ROS's arguments, and shows its log on the console as ROS nodes do.

Owns the order of the first steps: arguments, parameters, the log, the node. Must not know what the node does.
"""

from __future__ import annotations

import json
import logging
import queue
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from logging.handlers import QueueHandler, QueueListener

from hexwire.errors import UsageError

from .arguments import LEVELS, RosArguments, domain_of, parse_arguments
from .hardware_interface import NAME, HardwareInterface
from .names import remap_node
from .node import NodeOptions
from .settings import load_settings
from .zenoh_session import ZenohSettings, load_zenoh

__all__ = ["run"]

_OVERRIDE = "ZENOH_CONFIG_OVERRIDE"
_SEVERITIES = {number: name for name, number in LEVELS.items()}


def run(words: Sequence[str], environ: Mapping[str, str]) -> int:
    """Run the node until a signal ends it.

    Args:
        words: ROS's arguments, without the program's name.
        environ: Environment variables.

    Returns:
        Exit status.

    Raises:
        UsageError: Arguments or parameters are wrong; the text names all wrong parameters.
        LinkError: The robot's port or the Zenoh session cannot be opened.
        DeviceError: Zenoh is not installed, the robot does not answer, or the node failed.
    """
    load_zenoh()
    arguments = parse_arguments(words)
    if arguments.others:
        hint = "ROS's arguments follow --ros-args, as in: hexwire-ros2 --ros-args -p port:=/dev/ttyUSB0"
        raise UsageError(f"no option {arguments.others[0]!r}; {hint}")
    namespace, name = remap_node("/", NAME, arguments.remaps)
    options = NodeOptions(
        NAME,
        domain=domain_of(environ),
        remaps=arguments.remaps,
        enclave=arguments.enclave,
        zenoh=_zenoh(environ.get(_OVERRIDE, "")),
    )
    settings, robot = load_settings(arguments.parameters(f"{namespace.rstrip('/')}/{name}"), environ)
    with _console(arguments, name):
        return HardwareInterface(options, settings, robot).run()


def _zenoh(override: str) -> ZenohSettings:
    """Zenoh's settings; `override` has the form of ``connect/endpoints=["tcp/host:7447"]``."""
    if not override:
        return ZenohSettings()
    key, _, value = override.partition("=")
    try:
        endpoints = json.loads(value)
    except ValueError:
        endpoints = None
    if key != "connect/endpoints" or not isinstance(endpoints, list) or not all(map(_is_text, endpoints)):
        raise UsageError(f"{_OVERRIDE} is {override[:100]!r}; only connect/endpoints=[...] can be set here")
    return ZenohSettings(connect=tuple(endpoints))


def _is_text(value: object) -> bool:
    return isinstance(value, str)


@contextmanager
def _console(arguments: RosArguments, name: str) -> Iterator[None]:
    """Show hexwire's log on standard error, in a thread of its own: the arm must not wait for a console."""
    logger = logging.getLogger("hexwire")
    lines: queue.SimpleQueue[logging.LogRecord | None] = queue.SimpleQueue()
    shown = logging.StreamHandler(sys.stderr)
    shown.setFormatter(_RosFormat(name))
    listener = QueueListener(lines, shown)
    # Without any handler, Python writes warnings to standard error all the same.
    handler = QueueHandler(lines) if arguments.stdout_logs else logging.NullHandler()
    before = logger.level, logger.propagate
    logger.addHandler(handler)
    logger.propagate = False
    logger.setLevel(arguments.level or logging.INFO)
    listener.start()
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.level, logger.propagate = before
        listener.stop()
        with suppress(OSError, ValueError):
            shown.flush()


class _RosFormat(logging.Formatter):
    """A line as ROS nodes write it: severity, time, name of the node, text."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self._name = name

    def format(self, record: logging.LogRecord) -> str:
        severity = _SEVERITIES.get(record.levelno, record.levelname)
        return f"[{severity}] [{record.created:.9f}] [{self._name}]: {super().format(record)}"
