"""`hexwire doctor`: everything that is known to go wrong, looked at in order, each with what to do.

Owns the order and the printing. Looks only, unless --fix is given, which writes a udev rule and nothing else.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import click

from hexwire.errors import DeviceError, HexwireError, LinkError
from hexwire.ipc.diagnose import Finding, Level

from .common import RobotOptions, json_option, open_robot, print_json, robot_options

if TYPE_CHECKING:
    from hexwire.drivers.base import JointProbe
    from hexwire.model.state import JointState

__all__ = ["doctor"]

_MARKS = {Level.OK: "ok  ", Level.HINT: "hint", Level.BAD: "BAD "}
_LOW_VOLTAGE, _HIGH_VOLTAGE = 5.0, 8.4
_WARM = 60.0
_FRESH_BOOT = 3.0


@click.command()
@robot_options
@click.option("--fix", is_flag=True, help="Write the udev rule that is missing (needs root).")
@json_option
def doctor(options: RobotOptions, fix: bool, as_json: bool) -> None:
    """Look for what is wrong, from the plug to the servos. Read-only unless --fix.

    Ends with status 1 if something is BAD.
    """
    from hexwire.ipc.diagnose import diagnose_baud, diagnose_port, diagnose_system, udev_rule, write_udev_rule
    from hexwire.ipc.ports import list_ports

    ports = list_ports()
    findings: list[Finding] = []
    asked = bool(options.port) or any(port.likely_board for port in ports)
    if not asked:
        text = "no likely board among the serial ports" if ports else "no serial port here"
        findings.append(
            Finding(Level.HINT, "ports", text, "plug the board in; try another cable; or name its --port")
        )
    for port in ports:
        findings += diagnose_port(port)
    findings += diagnose_system(ports)
    findings.append(diagnose_baud(options.baud or 115200))
    if asked:
        findings += _ask_board(options)
    missing = sorted({p.usb_id for p in ports if p.usb_id and any("no udev rule" in f.text for f in findings)})
    if as_json:
        print_json(
            [{"level": f.level.value, "about": f.about, "text": f.text, "advice": f.advice} for f in findings]
        )
    else:
        for finding in findings:
            print(f"{_MARKS[finding.level]}  {finding.about}: {finding.text}")
            if finding.advice:
                print(f"      -> {finding.advice}")
    if missing and fix:
        path = write_udev_rule(missing)
        print(f"wrote {path}; now: sudo udevadm control --reload, unplug, plug in")
    elif missing and not as_json:
        print("\nThe udev rule that is missing (--fix writes it):\n\n" + udev_rule(missing))
    bad = sum(finding.level is Level.BAD for finding in findings)
    if bad:
        raise DeviceError(f"{bad} thing{'s' if bad > 1 else ''} to put right, marked BAD above")


def _ask_board(options: RobotOptions) -> list[Finding]:
    """Speak to the board: nothing here moves anything."""
    try:
        with open_robot(options) as robot:
            report = robot.probe()
            findings = [
                Finding(
                    Level.OK if report.dialect == 2 else Level.HINT,
                    "board",
                    f"{report.robot}, dialect {report.dialect}, firmware {report.firmware or 'unknown'}",
                    "" if report.dialect == 2 else "it speaks the chapter's dialect only; `hexwire firmware flash`",
                )
            ]
            uptime = report.counters.get("board_uptime_ms", math.inf) / 1000
            if uptime < _FRESH_BOOT:
                text = f"started {uptime:.1f} s ago: opening its port resets it"
                advice = "normal for an Arduino; a 10 uF capacitor from RESET to GND prevents it"
                findings.append(Finding(Level.HINT, "board", text, advice))
            if report.stopped:
                findings.append(Finding(Level.HINT, "board", "is stopped", "hexwire resume"))
            findings += _census(report.joints, report.missing)
            findings += _bus(report.counters)
            findings += _health(robot.read())
            return findings
    except LinkError as error:
        return [Finding(Level.BAD, "link", str(error))]
    except HexwireError as error:
        return [Finding(Level.BAD, "board", str(error))]


def _census(joints: tuple[JointProbe, ...], missing: tuple[str, ...]) -> list[Finding]:
    notes = [
        Finding(Level.BAD, j.name, j.note, "set the right servo, or the right model") for j in joints if j.note
    ]
    if missing:
        advice = "power, cable after the last servo that answers, id: `hexwire ping`"
        return [Finding(Level.BAD, "servos", f"{', '.join(missing)} not answering", advice), *notes]
    return [Finding(Level.OK, "servos", f"all {len(joints)} answer"), *notes]


def _bus(counters: dict[str, int]) -> list[Finding]:
    asked = counters.get("board_bus_transactions", 0)
    if not asked:
        return []
    failed = counters.get("board_bus_timeouts", 0) + counters.get("board_bus_bad", 0)
    rate = failed / asked
    text = f"{failed} of {asked} transactions failed since the board started ({rate:.2%})"
    if rate < 0.001:
        return [Finding(Level.OK, "servo bus", text)]
    return [Finding(Level.BAD if rate > 0.02 else Level.HINT, "servo bus", text, "cable length, ground, supply")]


def _health(state: JointState) -> list[Finding]:
    findings = []
    for joint in state:
        if joint.flags.faults:
            findings.append(Finding(Level.BAD, joint.name, f"reports {joint.flags.faults}", "see `hexwire state`"))
        if joint.voltage < _LOW_VOLTAGE or joint.voltage > _HIGH_VOLTAGE:
            advice = "a 6 V servo wants 4.5 to 7.4 V: check the supply under load"
            findings.append(Finding(Level.BAD, joint.name, f"supply {joint.voltage:.1f} V", advice))
        if joint.temperature > _WARM:
            findings.append(Finding(Level.HINT, joint.name, f"{joint.temperature:.0f} deg C", "let it rest"))
    if not findings:
        findings.append(Finding(Level.OK, "servos", "no fault bit, supply and temperature in order"))
    return findings
