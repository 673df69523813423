"""What answers, how it is and where: `ping`, `probe`, `ports`, `state`, `registers`, `tip`, `limits`, `poses`.

Nothing moves. Owns the presentation of the answers.
"""

from __future__ import annotations

import math
import time
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import click

from hexwire.errors import UsageError
from hexwire.units import decimal, plain

from .channel import all_option, probe_all
from .exits import note
from .options import (
    RobotOptions,
    attached,
    is_typed,
    json_option,
    links_option,
    make_robot,
    make_robot_with,
    number_option,
    on_terminal,
    open_robot,
    refuse_idle_force,
    robot_options,
    unit_of,
)
from .output import Column, RowType, answer, print_json, say, say_table, wants_json, with_unit

if TYPE_CHECKING:
    from hexwire.drivers.base import ProbeReport, RobotDriver
    from hexwire.drivers.values import JointProbe
    from hexwire.link.ports import PortInfo
    from hexwire.model.arm import ArmModel, JointModel
    from hexwire.model.state import JointReading, JointState
    from hexwire.wire.registers import Register

__all__ = ["joint_json", "limits", "ping", "ports", "poses", "probe", "registers", "state", "state_json", "tip"]

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


_PINGS: RowType[_Ping] = RowType(
    Column("servo_id"), Column("joint"), Column("present"), Column("faults"), Column("round_trip_s")
)


@click.command()
@click.argument("ids", metavar="[ID]...", nargs=-1, type=click.IntRange(0, 253))
@robot_options
@json_option
def ping(ids: tuple[int, ...], options: RobotOptions) -> None:
    """Check which servos answer: all servos of the robot, or those with the given bus IDs."""
    from hexwire.control.loop.reader import raise_if_silent

    with open_robot(options) as robot:
        wanted = ids or [joint.servo_id for joint in robot.model.joints]
        pings = _PINGS.tell(_ping(robot, servo_id) for servo_id in wanted)
    raise_if_silent([(row.servo_id, row.joint) for row in pings if not row.present])


def _ping(robot: RobotDriver, servo_id: int) -> _Ping:
    from hexwire.drivers.abilities import Counters, ServoPing
    from hexwire.model.state import fault_names

    error, counters = ServoPing.of(robot).ping(servo_id), Counters.find(robot)
    joint = robot.model.by_servo(servo_id)
    there = error is not None
    trips = () if counters is None else counters.round_trips
    trip = trips[-1] if there and trips else None
    return _Ping(servo_id, joint.name if joint else None, there, fault_names(error or 0), trip)


_JOINTS: RowType[JointProbe] = RowType(
    Column("name", "joint"),
    Column("servo_id", "servo"),
    Column("series", "series"),
    Column("present", "present", text=lambda joint: "yes" if joint.present else "NO ANSWER"),
    Column("remarks", "", text=lambda joint: joint.remarks),
)


@click.command()
@all_option
@robot_options
@json_option
def probe(everybody: bool, options: RobotOptions) -> None:
    """Show the identity and condition of the board and its servos."""
    if everybody:
        probe_all(options)
        return
    from hexwire.control.loop.reader import raise_if_silent

    with open_robot(options) as robot:
        report = robot.probe()
    if wants_json():
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
    _JOINTS.show(report.joints)
    counted = [f"{name.replace('_', ' ')} {count}" for name, count in report.counters.items() if count]
    say("", "counters  " + (", ".join(counted) or "all 0"))


_PORTS: RowType[PortInfo] = RowType(
    Column("device", "device"),
    *map(Column, ("vid", "pid", "serial_number", "description", "guess", "likely_board", "likely_adapter")),
    Column("usb_id", "usb id", lambda port: port.usb_id or None),
    Column("", "probably", text=lambda port: port.guess),
    Column("", "board?", text=lambda port: "yes" if port.likely_board else ""),
)


@click.command()
@click.option("--find", is_flag=True, help="Name a port by unplugging its cable and plugging it in again.")
@number_option("--timeout", "SECONDS", "With --find: how long to wait.", above=0, default=60.0)
@json_option
def ports(find: bool, timeout: float) -> None:
    """List serial ports and the devices they probably belong to."""
    from hexwire.link.ports import list_ports

    if is_typed("timeout") and not find:
        raise UsageError("--timeout is for --find")
    found = _unplugged(timeout) if find else list_ports()
    if found or wants_json():
        _PORTS.show(found)
    else:
        note("no serial port on this machine; 'hexwire sim board' creates one with an emulated board")


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
def state(watch: bool, rate: float, options: RobotOptions) -> None:
    """Show all joints, once or live."""
    from hexwire.control.loop.reader import raise_if_silent
    from hexwire.model.state import COLUMNS

    with open_robot(options) as robot:
        if watch:
            _watch(robot, rate)
        else:
            joints = robot.read()
            say_table(COLUMNS, [joint.cells for joint in joints])
            answer(state_json(joints, robot.model), *joints.remarks)
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


def _watch(robot: RobotDriver, rate: float) -> None:
    from hexwire.control.loop.loop import RateLoop
    from hexwire.model.state import COLUMNS, condition

    ticks = RateLoop(rate).ticks()
    if wants_json():
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


_REGISTERS: RowType[tuple[Register, int]] = RowType(
    Column("register", get=lambda row: row[0].name),
    Column("address", "address", lambda row: row[0].address),
    Column("", "register", text=lambda row: row[0].name),
    Column("raw", "raw", lambda row: row[1]),
    Column(
        "value",
        "value",
        lambda row: row[0].to_si(row[1]),
        text=lambda row: with_unit(row[0].to_si(row[1]), row[0].si_unit),
    ),
    Column("unit", get=lambda row: row[0].si_unit),
    keys=2,
)


@click.command()
@click.argument("joint", metavar="JOINT")
@click.argument("names", metavar="[REGISTER]...", nargs=-1)
@robot_options
@json_option
def registers(joint: str, names: tuple[str, ...], options: RobotOptions) -> None:
    """Show the registers of a joint's servo behind a board: all of them, or those that are named.

    The board reads the whole table by one request. For servos on a bus adapter use 'hexwire bus read'.
    """
    from hexwire.drivers.abilities import ServoTables
    from hexwire.wire.registers import Series

    with open_robot(options) as robot:
        row = robot.model.joint(joint)
        series = Series(row.series)
        wanted = [series.register(name) for name in names] or list(series.registers.values())
        first = min(register.address for register in wanted)
        end = max(register.address + register.size for register in wanted)
        table = ServoTables.of(robot).read_table(row.name, first, end - first)
    rows = [(register, register.decode(table[register.address - first :][: register.size])) for register in wanted]
    if wants_json():
        data = [_REGISTERS.as_json(found) for found in rows]
        print_json({"joint": row.name, "servo": row.servo_id, "series": series.value, "registers": data})
    else:
        _REGISTERS.show(rows)


@click.command()
@links_option
@robot_options
@json_option
def tip(links: str, options: RobotOptions) -> None:
    """Show where the tip of the tool is, and where the tool points, in the units and angles of `hexwire goto`."""
    from hexwire.arm.front import Front
    from hexwire.arm.verbs import Arm

    robot = make_robot_with(links, options)
    with attached(robot):
        found = Arm(robot, front=Front()).tip
    rpy = [math.degrees(angle) for angle in found.rpy]
    tilt = None if found.pitch_roll is None else [math.degrees(angle) for angle in found.pitch_roll]
    unit = unit_of(robot.model.name)
    name, digits = ("mm", 1) if unit == 1e-3 else ("m", 4)
    place = " ".join(plain(value / unit, digits) for value in found.position)
    aim = "rpy " + " ".join(plain(angle, 1) for angle in rpy)
    if tilt is not None:
        aim = f"pitch {plain(tilt[0], 1)}, roll {plain(tilt[1], 1)}"
    data = {"position_m": found.position, "rpy_deg": rpy, "pitch_roll_deg": tilt}
    answer(data, f"{place} {name}, {aim} deg")


_LIMITS: RowType[JointModel] = RowType(
    Column("name", "joint"),
    Column("minimum_deg", "from deg", lambda joint: math.degrees(joint.minimum), 1),
    Column("maximum_deg", "to deg", lambda joint: math.degrees(joint.maximum), 1),
    Column("speed_deg_per_s", "deg/s", lambda joint: math.degrees(joint.max_speed), 1),
    Column("acceleration_deg_per_s2", "deg/s2", lambda joint: math.degrees(joint.max_acceleration), 1),
)


@click.command()
@robot_options
@json_option
def limits(options: RobotOptions) -> None:
    """Show how far and how fast each joint may move."""
    from hexwire.arm.front import Front
    from hexwire.arm.verbs import Arm

    _LIMITS.show(list(Arm(make_robot(options), front=Front()).limits.values()))


@click.command()
@click.option("--save", metavar="NAME", help="Save where the joints are now.")
@click.option("--delete", metavar="NAME", help="Delete a pose.")
@click.option("--force", is_flag=True, help="With --save, replace a pose of that name.")
@robot_options
@json_option
def poses(save: str | None, delete: str | None, force: bool, options: RobotOptions) -> None:
    """List the poses of this kind of arm, to which `hexwire move` and `goto` go by name; save or delete one."""
    from hexwire.arm.front import Front
    from hexwire.arm.verbs import Arm
    from hexwire.control.requests.pose_file import PoseFile, check_pose_name, refuse_taken

    if save is not None and delete is not None:
        raise UsageError("--save and --delete contradict each other")
    if save is None:
        refuse_idle_force(force, "a pose of --save")
    robot = make_robot(options)
    arm = Arm(robot, front=Front())
    if save is not None:
        refuse_taken(check_pose_name(save), () if force else arm.poses, "--force replaces it")
        with attached(robot):
            arm.poses.save(save, force=force)
    elif delete is not None:
        PoseFile(robot.model).remove(delete)
    degrees = {name: {joint: math.degrees(a) for joint, a in arm.poses[name].items()} for name in arm.poses}
    lines = [
        f"{name}: " + " ".join(f"{j}={decimal(a)}" for j, a in angles.items()) for name, angles in degrees.items()
    ]
    if degrees or wants_json():
        answer(degrees, *lines)
