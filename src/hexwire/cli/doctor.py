"""`doctor` and `loopback`: checks for all known problems, each with a remedy, and of a cable at several rates.

Owns the choice of ports, the order and the printing. Read-only unless --fix is given, which writes a udev rule and
nothing else. The findings come from `link.diagnose`, `RobotDriver.examine` and `SilenceCheck.explain_silence`, the
test of a cable is `link.loopback`.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hexwire.errors import DeviceError, HexwireError, LinkError, ReplyTimeoutError, UsageError, WrongDeviceError
from hexwire.link.diagnose import Finding, Level

from .exits import note
from .options import (
    RobotOptions,
    attached,
    json_option,
    make_robot,
    on_terminal,
    port_option,
    resolve_url,
    robot_options,
)
from .output import Column, RowType, print_json, say, say_document, say_finding, wants_json

if TYPE_CHECKING:
    from hexwire.link.loopback import LoopbackResult
    from hexwire.link.ports import PortInfo

__all__ = ["doctor", "loopback"]

_FINDINGS: RowType[Finding] = RowType(
    Column("level", get="level.value"), *map(Column, ("port", "about", "text", "advice"))
)


@click.command()
@robot_options
@click.option("--fix", is_flag=True, help="Write the missing udev rule (needs root).")
@json_option
def doctor(options: RobotOptions, fix: bool) -> None:
    """Diagnose problems, from the USB port to the servos. Read-only unless --fix.

    Checks the port that --port names, otherwise all ports. Exit status 1 if something is BAD.
    """
    from hexwire.drivers.registry import is_address, load_driver
    from hexwire.link.diagnose import diagnose_system, udev_rule, write_udev_rule
    from hexwire.link.ports import list_ports

    # The robot behind a shared arm may be unknown here, and its port is at its server.
    what = "board" if options.port and is_address(options.port) else load_driver(options.robot).port_leads_to
    on_bus = what == "adapter"
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
        if not any(port.likely_adapter if on_bus else port.likely_board for port in ports):
            text = f"no likely {what} among the serial ports" if ports else "no serial port found"
            advice = f"plug the {what} in; try another cable; or name the port with --port"
            findings.append(Finding(Level.HINT, "ports", text, advice))
    findings += diagnose_system(ports)
    missing = sorted({p.usb_id for p in ports if p.usb_id and any("no udev rule" in f.text for f in findings)})
    if wants_json():
        print_json([_FINDINGS.as_json(row) for row in findings])
    for row in findings:
        label = f"{row.port}: " if row.port not in ("", row.about) else ""
        say_finding(row.level.value, f"{label}{row.about}: {row.text}", row.advice)
    if missing and fix:
        path = write_udev_rule(missing)
        note(f"wrote {path}; now run 'sudo udevadm control --reload', unplug the device, and plug it in")
    elif missing and not wants_json():
        say("", "The missing udev rule (--fix writes it):", "")
        say_document(udev_rule(missing))
    bad = sum(finding.level is Level.BAD for finding in findings)
    if bad:
        raise DeviceError(f"{bad} problem{'s' if bad > 1 else ''} found, marked BAD above")


def _device(port: str) -> str:
    """Path of a serial port; empty for another kind of link."""
    from hexwire.drivers.registry import is_address
    from hexwire.ipc.conf import device_url

    if is_address(port):
        return ""
    url = device_url(port)
    return url.path if url.scheme == "serial" else ""


def _found(devices: list[str]) -> list[PortInfo]:
    """Ports that exist. Opening a missing port gives an error that lists the existing ports."""
    from hexwire.link.ports import find_port

    return [find_port(device) for device in devices if Path(device).exists()]


def _look(options: RobotOptions, port: PortInfo, on_bus: bool, *, ask: bool = True) -> list[Finding]:
    """Check one port: its identity, its permissions, and the device on it."""
    from hexwire.link.diagnose import diagnose_baud, diagnose_port

    findings = diagnose_port(port)
    if any(row.level is Level.BAD and "may not open" in row.text for row in findings):
        return findings
    if ask and port.likely_board and not on_bus:
        findings.append(diagnose_baud(options.baud or 115200))
    return findings + (_ask(options) if ask else [])


def _ask(options: RobotOptions) -> list[Finding]:
    """Ask the robot; nothing moves.

    Raises:
        UsageError: The options are invalid.
    """
    from hexwire.drivers.abilities import SilenceCheck

    robot = make_robot(options)
    try:
        with attached(robot):
            return robot.examine()
    except UsageError:
        raise
    except WrongDeviceError as error:
        return [Finding(Level.BAD, "device", str(error))]
    except ReplyTimeoutError as error:
        try:
            silence = SilenceCheck.find(robot)
            found = [] if silence is None else silence.explain_silence()
            return found or [Finding(Level.BAD, "board", str(error))]
        except LinkError as lost:
            return [Finding(Level.BAD, "link", str(lost))]
    except LinkError as error:
        return [Finding(Level.BAD, "link", str(error))]
    except HexwireError as error:
        return [Finding(Level.BAD, "board", str(error))]


_RESULTS: RowType[LoopbackResult] = RowType(
    Column("baud", "baud"),
    Column("sent", "sent"),
    Column("returned", "back"),
    Column("wrong", "wrong"),
    *map(Column, ("wrong_bits", "good", "seconds")),
    Column("", "verdict", text=lambda result: result.verdict),
)


@click.command()
@port_option
@click.option(
    "--baud",
    "rates",
    type=click.IntRange(min=300),
    multiple=True,
    metavar="N",
    help="Test only this rate; repeatable.",
)
@click.option(
    "--bytes",
    "count",
    type=click.IntRange(64, 10_000_000),
    default=2048,
    show_default=True,
    help="How many to send at each rate.",
)
@json_option
def loopback(port: str | None, rates: tuple[int, ...], count: int) -> None:
    """Test a cable and adapter: connect TX to RX, and every byte must come back.

    Tries the rates that servos and boards use, slowest first. Exit status 1 if one of them fails.
    """
    from hexwire.drivers.board_reset import warn_of_reset
    from hexwire.drivers.checkup import SERVO_RATES
    from hexwire.link.loopback import try_loopback
    from hexwire.link.open import make_link
    from hexwire.link.url import parse_url

    url = resolve_url(port)
    if parse_url(url).scheme != "serial":
        raise UsageError(f"a loopback test needs a serial port, not {url}")
    if "baud=" in url:
        raise UsageError("give the rate with --baud, not in the port")
    warn_of_reset(make_link(url))
    results = []
    for baud in sorted(set(rates or SERVO_RATES)):
        if on_terminal() and not wants_json():
            note(f"{baud} baud ...")
        with make_link(f"{url}{'&' if '?' in url else '?'}baud={baud}") as link:
            results.append(try_loopback(link, baud, count, time.monotonic))
    _RESULTS.show(results)
    bad = [str(r.baud) for r in results if not r.good]
    if bad:
        raise LinkError(f"the loopback fails at {', '.join(bad)} baud", url=url)
