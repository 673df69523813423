"""`ping`, `probe`, `ports`, `state` and `registers`: what answers, and how it is. Nothing moves.

Owns the presentation of the answers. Must not know how they are obtained.
"""

from __future__ import annotations

import math
import time
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import click

from hexwire.errors import UsageError
from hexwire.units import plain

from .channel import all_option, probe_all
from .exits import note
from .options import RobotOptions, is_typed, json_option, number_option, on_terminal, open_robot, robot_options
from .output import print_json, say, say_table, with_unit

if TYPE_CHECKING:
    from hexwire.drivers.base import ProbeReport, RobotDriver
    from hexwire.link.ports import PortInfo
    from hexwire.model.arm import ArmModel
    from hexwire.model.state import JointReading, JointState

__all__ = ["ping", "ports", "probe", "registers", "state", "state_json"]

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
    from hexwire.control.loop.reader import raise_if_silent
    from hexwire.model.state import fault_names

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
    from hexwire.control.loop.reader import raise_if_silent

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


@click.command()
@click.option("--watch", is_flag=True, help="Update until interrupted.")
@number_option("--rate", "HZ", "With --watch, the update rate.", above=0, default=5.0)
@robot_options
@json_option
def state(watch: bool, rate: float, options: RobotOptions, as_json: bool) -> None:
    """Show all joints, once or live."""
    from hexwire.control.loop.reader import raise_if_silent
    from hexwire.model.state import COLUMNS

    with open_robot(options) as robot:
        if watch:
            _watch(robot, rate, as_json)
        else:
            joints = robot.read()
            if as_json:
                print_json(state_json(joints, robot.model))
            else:
                say_table(COLUMNS, [joint.cells for joint in joints])
                for line in joints.remarks:
                    say(line)
            raise_if_silent([(robot.model.joint(name).servo_id, name) for name in joints.silent])


def joint_json(joint: JointReading, model: ArmModel) -> dict[str, object]:
    """One joint for JSON, each key with its unit."""
    from hexwire.model.state import JointFlag, fault_names

    return {
        "name": joint.name,
        "servo_id": model.joint(joint.name).servo_id,
        "position_rad": joint.position,
        "position_deg": math.degrees(joint.position),
        "velocity_rad_per_s": joint.velocity,
        "velocity_deg_per_s": math.degrees(joint.velocity),
        "load_fraction": joint.load,
        "current_a": joint.current,
        "voltage_v": joint.voltage,
        "temperature_degc": joint.temperature,
        "age_s": joint.age,
        "torque_on": {"on": True, "off": False}.get(joint.torque),
        "silent": bool(joint.flags & JointFlag.SILENT),
        "clamped": bool(joint.flags & JointFlag.CLAMPED),
        "faults": fault_names(joint.flags),
    }


def state_json(state: JointState, model: ArmModel) -> dict[str, object]:
    """A joint state for JSON, each key with its unit."""
    from hexwire.drivers.robot_state import RobotState

    return {
        "robot": model.name,
        "state": RobotState.of(state).name.lower(),
        "stopped": state.stopped,
        "watchdog_tripped": state.watchdog_tripped,
        "maintenance": state.maintenance,
        "board_time_s": state.board_time,
        "joints": [joint_json(joint, model) for joint in state],
    }


def _watch(robot: RobotDriver, rate: float, as_json: bool) -> None:
    from hexwire.control.loop.loop import RateLoop
    from hexwire.model.state import COLUMNS, condition

    ticks = RateLoop(rate).ticks()
    if as_json:
        for _ in ticks:
            print_json(state_json(robot.read(), robot.model), one_line=True)
    elif not on_terminal():
        for seconds in ticks:
            joints = robot.read()
            angles = "  ".join(f"{j.name} {plain(math.degrees(j.position), 2)}" for j in joints)
            odd = [f"{j.name} {condition(j)}" for j in joints if condition(j) != "ok"]
            say("; ".join([f"{seconds:8.1f} s  {angles} deg", *odd, *joints.remarks]), flush=True)
    else:
        from rich.console import Group
        from rich.text import Text

        from .draw import JointTable, live

        with live() as screen:
            for _ in ticks:
                joints = robot.read()
                faulty = [condition(joint) != "ok" for joint in joints]
                said = [Text(line, style="bold red") for line in joints.remarks]
                foot = Text(f"{robot.url}, {rate:g} Hz; Ctrl-C ends", style="dim")
                table = JointTable(COLUMNS, [joint.cells for joint in joints], faulty)
                screen.update(Group(table, *said, foot), refresh=True)


@click.command()
@click.argument("joint", metavar="JOINT")
@click.argument("names", metavar="[REGISTER]...", nargs=-1)
@robot_options
@json_option
def registers(joint: str, names: tuple[str, ...], options: RobotOptions, as_json: bool) -> None:
    """Show the registers of a joint's servo behind a board: all of them, or those that are named.

    The board reads the whole table by one request. For servos on a bus adapter use 'hexwire bus read'.
    """
    from hexwire.wire.registers import Series

    with open_robot(options) as robot:
        row = robot.model.joint(joint)
        series = Series(row.series)
        wanted = [series.register(name) for name in names] or list(series.registers.values())
        first = min(register.address for register in wanted)
        end = max(register.address + register.size for register in wanted)
        table = robot.read_table(row.name, first, end - first)
    data, rows = [], []
    for register in wanted:
        at = register.address - first
        raw = register.decode(table[at : at + register.size])
        value = register.to_si(raw)
        data.append({"register": register.name, "address": register.address, "raw": raw, "value": value})
        data[-1]["unit"] = register.si_unit
        rows.append((str(register.address), register.name, str(raw), with_unit(value, register.si_unit)))
    if as_json:
        print_json({"joint": row.name, "servo": row.servo_id, "series": series.value, "registers": data})
    else:
        say_table(("address", "register", "raw", "value"), rows, keys=2)
