"""`ping`, `probe` and `ports`: which devices answer. Nothing moves.

Owns the presentation of the answers. Must not know how they are obtained.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import click

from hexwire.errors import UsageError

from .channel import all_option, probe_all
from .common import RobotOptions, fault_names, is_typed, json_option, open_robot, raise_if_silent, robot_options
from .exits import note
from .numbers import number_option
from .output import print_json, say, say_table

if TYPE_CHECKING:
    from hexwire.drivers.base import ProbeReport
    from hexwire.link.ports import PortInfo

__all__ = ["ping", "ports", "probe"]

_LOOK = 0.25
"""Seconds between two looks at the ports."""


@dataclass(frozen=True, slots=True)
class _Ping:
    servo_id: int
    joint: str | None
    present: bool
    faults: list[str]
    round_trip_s: float | None

    def __str__(self) -> str:
        name = f"servo {self.servo_id}" + (f" ({self.joint})" if self.joint else "")
        if not self.present:
            return f"{name}: no answer"
        trip = f", {1000 * self.round_trip_s:.1f} ms" if self.round_trip_s is not None else ""
        return f"{name}: {', '.join(self.faults) or 'ok'}{trip}"


@click.command()
@click.argument("ids", metavar="[ID]...", nargs=-1, type=click.IntRange(0, 253))
@robot_options
@json_option
def ping(ids: tuple[int, ...], options: RobotOptions, as_json: bool) -> None:
    """Check which servos answer: all servos of the robot, or those with the given bus IDs."""
    pings = []
    with open_robot(options) as robot:
        for servo_id in ids or [joint.servo_id for joint in robot.model.joints]:
            error = robot.ping(servo_id)
            joint = robot.model.by_servo(servo_id)
            there = error is not None
            trip = robot.round_trips[-1] if there and robot.round_trips else None
            row = _Ping(servo_id, joint.name if joint else None, there, fault_names(error or 0), trip)
            pings.append(row)
            if not as_json:
                say(row, flush=True)
    if as_json:
        print_json([asdict(row) for row in pings])
    raise_if_silent([(row.servo_id, row.joint) for row in pings if not row.present])


@click.command()
@all_option
@robot_options
@json_option
def probe(everybody: bool, options: RobotOptions, as_json: bool) -> None:
    """Show the identity and condition of the board and its servos."""
    if everybody:
        probe_all(options, as_json)
        return
    with open_robot(options) as robot:
        report = robot.probe()
    if as_json:
        print_json(asdict(report))
    else:
        _say_report(report)
    raise_if_silent([(joint.servo_id, joint.name) for joint in report.joints if not joint.present])


def _say_report(report: ProbeReport) -> None:
    facts = [
        ("robot", report.robot),
        ("link", report.link),
        ("dialect", f"{report.dialect}" + (" (the chapter's)" if report.chapter else "")),
        ("firmware", report.firmware),
        ("boot id", "" if report.boot_id is None else f"{report.boot_id:08x}"),
        ("supports", ", ".join(report.capabilities).replace("_", " ")),
        ("stopped", "yes; 'hexwire resume' ends the stop" if report.stopped else "no"),
        ("state", "in maintenance: servo settings may be written, nothing moves" if report.maintenance else ""),
    ]
    say(*(f"{name:9} {value}" for name, value in facts if value), "")
    rows = [
        (j.name, str(j.servo_id), j.series, "yes" if j.present else "NO ANSWER", j.remarks) for j in report.joints
    ]
    say_table(("joint", "servo", "series", "present", ""), rows)
    counted = [f"{name.replace('_', ' ')} {count}" for name, count in report.counters.items() if count]
    say("", "counters  " + (", ".join(counted) or "all 0"))


@click.command()
@click.option("--find", is_flag=True, help="Name a port by unplugging its cable and plugging it in again.")
@number_option("--timeout", "SECONDS", "With --find: how long to wait.", above=0, default=60.0)
@json_option
def ports(find: bool, timeout: float, as_json: bool) -> None:
    """List serial ports and the devices they probably belong to."""
    from hexwire.link.ports import list_ports

    if is_typed("timeout") and not find:
        raise UsageError("--timeout is for --find")
    found = _unplugged(timeout) if find else list_ports()
    if as_json:
        print_json([asdict(port) | {"usb_id": port.usb_id or None} for port in found])
    elif not found:
        note("no serial port on this machine; 'hexwire sim board' creates one with an emulated board")
    else:
        rows = [(p.device, p.usb_id or "-", p.guess, "yes" if p.likely_board else "") for p in found]
        say_table(("device", "usb id", "probably", "board?"), rows)


def _unplugged(timeout: float) -> list[PortInfo]:
    """The ports of the device whose cable somebody unplugs and plugs in again.

    Raises:
        LinkNotFoundError: Nothing came in time.
    """
    from hexwire.errors import LinkNotFoundError
    from hexwire.link.ports import PortFinder, list_ports

    finder, said = PortFinder(list_ports()), ""
    end = time.monotonic() + timeout
    while not finder.over:
        if finder.asks != said:
            note(said := finder.asks)
        if time.monotonic() >= end:
            raise LinkNotFoundError(f"no port came within {timeout:g} s: is the cable one for data?")
        time.sleep(_LOOK)
        finder.receive(list_ports(), time.monotonic())
    return list(finder.found)
