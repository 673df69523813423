"""The group `bus` and the parts that its commands share: port, series, opening the bus.

Owns the options of a bus and its opening. Must not know what a command does, nor packets.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from hexwire.errors import ServoError, StoppedError, UsageError
from hexwire.units import decimal

from .common import group_port_option, port_option, resolve_url
from .exits import note
from .output import plain

if TYPE_CHECKING:
    from hexwire.bus.servo_bus import ServoBus

__all__ = [
    "BusOptions",
    "bus",
    "bus_options",
    "bus_url",
    "known_servo",
    "open_bus",
    "refuse_if_stopped",
    "with_unit",
]


@dataclass(frozen=True, slots=True)
class BusOptions:
    """Which bus, and which servos are on it.

    Attributes:
        port: URL or path; the only likely adapter if None.
        series: Series of every servo; the servos are asked if None.
        baud: Line rate; the series' default if None and the URL names none.
    """

    port: str | None
    series: str | None
    baud: int | None


def bus_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """``--port``, ``--series`` and ``--baud``; the command gets them as ``options: BusOptions``."""

    @functools.wraps(command)
    def packed(*args: Any, port: str | None, series: str | None, baud: int | None, **rest: Any) -> Any:
        return command(*args, options=BusOptions(port, series, baud), **rest)

    baud_option = click.option(
        "--baud", type=click.IntRange(min=1), metavar="N", help="Line rate (1000000; 115200 for seven_bot)."
    )
    series_option = click.option(
        "--series", metavar="S", help="sts, sms, scs, hls or seven_bot. Optional: hexwire asks the servos."
    )
    return port_option(series_option(baud_option(packed)))


@contextmanager
def open_bus(options: BusOptions) -> Iterator[ServoBus]:
    """Open the bus that the options name.

    Raises:
        UsageError: The port or series is invalid.
        LinkError: The port cannot be opened.
        WrongDeviceError: No servo answered in this context, because the device is a controller board, or
            another robot.
    """
    from hexwire.bus.servo_bus import ServoBus
    from hexwire.bus.servos import as_series
    from hexwire.drivers.board_reset import note_servos, warn_of_reset
    from hexwire.ipc.board_search import explain_no_servo
    from hexwire.wire.registers import Series

    series = as_series(options.series) if options.series else Series.STS_SMS
    wire = ServoBus.from_url(bus_url(options), series=series)
    # A controller board may be there by mistake.
    warn_of_reset(wire.link)
    with wire as opened:
        try:
            yield opened
        except ServoError:
            wrong = None if opened.counters.answers else explain_no_servo(opened.link)
            if wrong is not None:
                raise wrong from None
            raise
        finally:
            note_servos(opened)
        _warn_of_latency(opened)


def bus_url(options: BusOptions) -> str:
    """The URL of the bus that the options name, or of the only likely adapter.

    Raises:
        UsageError: The port is invalid, or there are several adapters.
        LinkNotFoundError: No port is named, and there is no adapter.
    """
    return resolve_url(options.port or _only_adapter(), options.baud)


def refuse_if_stopped(opened: ServoBus, what: str) -> None:
    """Apply this user's stop: a bus cannot latch one, and a single write can move a servo.

    Raises:
        StoppedError: The arm on this bus is stopped.
    """
    from hexwire.drivers.stop_memory import StopMemory
    from hexwire.wire.command_frame import Status

    if StopMemory(opened.link.url).stopped:
        raise StoppedError.unsent(what, Status.STOPPED, "the arm is stopped; `hexwire resume` ends that")


def _only_adapter() -> str:
    from hexwire.errors import LinkNotFoundError
    from hexwire.link.ports import list_ports

    found = [port for port in list_ports() if port.likely_adapter]
    if len(found) == 1:
        return found[0].device
    if found:
        raise UsageError(f"several likely adapters: {', '.join(map(str, found))}; name one with --port")
    raise LinkNotFoundError("no likely servo adapter found: plug it in, or name a port with --port")


def _warn_of_latency(opened: ServoBus) -> None:
    from hexwire.link.adapter import inspect_adapter

    device = getattr(opened.link, "device", None)
    if isinstance(device, str):
        report = inspect_adapter(device, opened.timing.overhead, opened.timing.holds_back)
        if report.advice:
            note(f"warning: {report.advice}")


def known_servo(opened: ServoBus, servo_id: int, options: BusOptions) -> None:
    """Ask a servo for its series, unless the user gave it.

    Raises:
        ServoError: It does not answer.
    """
    if options.series:
        return
    from hexwire.bus.setup import identify

    if identify(opened, servo_id) is None:
        raise ServoError(
            f"servo {servo_id} does not answer: check cable, power, id and --baud; `hexwire bus scan` searches "
            "all ids",
            servo_id=servo_id,
        )


def with_unit(value: float, unit: str) -> str:
    """A value for display: angles in degrees, everything else in SI."""
    import math

    if unit.startswith("rad"):
        return f"{decimal(math.degrees(value))} deg{unit[3:]}"
    return f"{decimal(value)} {unit}".rstrip() if unit != "fraction" else f"{plain(100 * value, 1)}%"


@click.group()
@group_port_option
def bus(port: str | None) -> None:
    """Talk to bus servos through an adapter: find, read, write, set up, watch, test."""
