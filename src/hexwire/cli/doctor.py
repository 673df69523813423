"""`hexwire doctor`: everything that is known to go wrong, looked at in order, each with what to do.

Owns which ports are looked at, the order and the printing. Looks only, unless --fix is given, which writes a udev
rule and nothing else. What is good and bad is judged in `ipc.diagnose`, `drivers.checkup` and
`drivers.bus_checkup`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hexwire.errors import (
    DeviceError,
    HexwireError,
    LinkError,
    NotSupportedError,
    ReplyTimeoutError,
    UsageError,
    WrongDeviceError,
)
from hexwire.link.diagnose import Finding, Level

from .common import RobotOptions, attached, json_option, make_robot, robot_options
from .output import print_json, say, say_document

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.drivers.bus_arm import BusArm
    from hexwire.link.ports import PortInfo

__all__ = ["doctor"]

_MARKS = {Level.OK: "ok  ", Level.HINT: "hint", Level.BAD: "BAD ", Level.UNKNOWN: "?   "}
_BOARD_RATES = (57_600, 250_000, 500_000, 1_000_000)
_BOARD_PATIENCE = 0.6


@click.command()
@robot_options
@click.option("--fix", is_flag=True, help="Write the udev rule that is missing (needs root).")
@json_option
def doctor(options: RobotOptions, fix: bool, as_json: bool) -> None:
    """Look for what is wrong, from the plug to the servos. Read-only unless --fix.

    Looks at the port that --port names, else at all there are. Ends with status 1 if something is BAD.
    """
    from hexwire.drivers.bus_arm import BusArm
    from hexwire.drivers.registry import load_driver
    from hexwire.link.diagnose import diagnose_system, udev_rule, write_udev_rule
    from hexwire.link.ports import list_ports

    on_bus = issubclass(load_driver(options.robot), BusArm)
    if options.port:
        device = _device(options.port)
        ports = _found([device]) if device else []
        findings = _look(options, ports[0], on_bus) if ports else _ask(options)
    else:
        ports = list_ports()
        findings = []
        for port in ports:
            likely = port.likely_adapter if on_bus else port.likely_board
            rows = _look(replace(options, port=port.device), port, on_bus, ask=likely)
            findings += [replace(row, port=port.device) for row in rows]
        what = "adapter" if on_bus else "board"
        if not any(port.likely_adapter if on_bus else port.likely_board for port in ports):
            text = f"no likely {what} among the serial ports" if ports else "no serial port here"
            advice = f"plug the {what} in; try another cable; or name its --port"
            findings.append(Finding(Level.HINT, "ports", text, advice))
    findings += diagnose_system(ports)
    missing = sorted({p.usb_id for p in ports if p.usb_id and any("no udev rule" in f.text for f in findings)})
    _show(findings, as_json)
    if missing and fix:
        path = write_udev_rule(missing)
        say(f"wrote {path}; now: sudo udevadm control --reload, unplug, plug in")
    elif missing and not as_json:
        say("", "The udev rule that is missing (--fix writes it):", "")
        say_document(udev_rule(missing))
    bad = sum(finding.level is Level.BAD for finding in findings)
    if bad:
        raise DeviceError(f"{bad} thing{'s' if bad > 1 else ''} to put right, marked BAD above")


def _show(findings: list[Finding], as_json: bool) -> None:
    if as_json:
        rows = [
            {"level": f.level.value, "port": f.port, "about": f.about, "text": f.text, "advice": f.advice}
            for f in findings
        ]
        print_json(rows)
        return
    for finding in findings:
        label = f"{finding.port}: " if finding.port not in ("", finding.about) else ""
        say(f"{_MARKS[finding.level]}  {label}{finding.about}: {finding.text}")
        if finding.advice:
            say(f"      -> {finding.advice}")


def _device(port: str) -> str:
    """Path of a serial port; empty for another kind of link."""
    from hexwire.link.url import parse_url

    url = parse_url(port)
    return url.path if url.scheme == "serial" else ""


def _found(devices: list[str]) -> list[PortInfo]:
    """Ports that exist: opening one that does not says that, and which there are."""
    from hexwire.link.ports import find_port

    return [find_port(device) for device in devices if Path(device).exists()]


def _look(options: RobotOptions, port: PortInfo, on_bus: bool, *, ask: bool = True) -> list[Finding]:
    """One port: what it is, who may open it, and who is behind it."""
    from hexwire.link.diagnose import diagnose_baud, diagnose_port

    findings = diagnose_port(port)
    if any(row.level is Level.BAD and "may not open" in row.text for row in findings):
        return findings
    if ask and port.likely_board and not on_bus:
        findings.append(diagnose_baud(options.baud or 115200))
    return findings + (_ask(options) if ask else [])


def _ask(options: RobotOptions) -> list[Finding]:
    """Speak to the robot: nothing here moves anything.

    Raises:
        UsageError: The options make no sense.
    """
    from hexwire.drivers.bus_arm import BusArm

    robot = make_robot(options)
    try:
        with attached(robot):
            return _examine_bus(robot) if isinstance(robot, BusArm) else _examine(robot)
    except UsageError:
        raise
    except WrongDeviceError as error:
        return [Finding(Level.BAD, "device", str(error))]
    except ReplyTimeoutError as error:
        try:
            return _why_silent(robot) or [Finding(Level.BAD, "board", str(error))]
        except LinkError as lost:
            return [Finding(Level.BAD, "link", str(lost))]
    except LinkError as error:
        return [Finding(Level.BAD, "link", str(error))]
    except HexwireError as error:
        return [Finding(Level.BAD, "board", str(error))]


def _examine(robot: RobotDriver) -> list[Finding]:
    from hexwire.drivers.checkup import judge_board, judge_probe, judge_state

    report, state = robot.probe(), robot.read()
    findings = judge_board(report) + judge_probe(report)
    shaky = [joint.name for joint in report.joints if joint.present and joint.name in state.silent]
    if shaky:
        advice = "contacts, ground, supply of these servos"
        findings.append(Finding(Level.BAD, ", ".join(shaky), "answered once, but not again", advice))
    return findings + judge_state(state, report.joints)


def _examine_bus(arm: BusArm) -> list[Finding]:
    from hexwire.drivers.bus_checkup import explain_missing, judge_traffic
    from hexwire.drivers.checkup import judge_probe, judge_state
    from hexwire.link.adapter import inspect_adapter

    report, state, bus = arm.probe(), arm.read(), arm.bus
    silent = {joint.name for joint in report.joints if not joint.present} | set(state.silent)
    lost = explain_missing(bus, arm.model, [arm.model.joint(name) for name in arm.model.names if name in silent])
    findings = [Finding(Level.OK, "bus", f"{report.robot} at {bus.timing.baud} baud")]
    findings += judge_probe(report, missing=False) + lost + judge_state(state, report.joints)
    if not lost:
        # Who is missing is not the adapter's fault.
        findings += judge_traffic(bus, arm.model)
    device = getattr(bus.link, "device", None)
    if isinstance(device, str):
        advice = inspect_adapter(device, bus.timing.overhead, bus.timing.holds_back).advice
        if advice and bus.timing.holds_back:
            findings.append(Finding(Level.HINT, "adapter", "it holds answers back", advice))
    return findings


def _why_silent(robot: RobotDriver) -> list[Finding]:
    """Look further where nobody answers."""
    from hexwire.drivers.bus_arm import BusArm
    from hexwire.drivers.bus_checkup import SERVO_RATES, explain_chatter, explain_silence
    from hexwire.drivers.hex7bot import Hex7BotDriver
    from hexwire.ipc.mistaken import find_board, find_servos, is_servo_bus

    if isinstance(robot, BusArm):
        with robot.bus as bus:
            return explain_silence(bus, robot.model)
    if not isinstance(robot, Hex7BotDriver):
        return []
    link = robot.session.ipc.link
    if not hasattr(link, "set_baud"):
        return []
    with link:
        chatter = explain_chatter(link)
        if chatter is not None:
            return [chatter]
        for baud in _BOARD_RATES:
            try:
                board = find_board(link, baud=baud, patience=_BOARD_PATIENCE)
            except (UsageError, NotSupportedError):
                continue
            if board is not None:
                text = f"the board speaks at {baud} baud"
                return [Finding(Level.BAD, "rate", text, f"name it: --baud {baud}")]
        for baud in SERVO_RATES:
            servo_ids = find_servos(link, baud=baud)
            if servo_ids:
                return [Finding(Level.BAD, "device", str(is_servo_bus(link.url, servo_ids, baud=baud)))]
    return []
