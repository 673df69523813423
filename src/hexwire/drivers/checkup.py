"""Diagnosis of a robot from its probe and its state; each finding says what to do.

Owns the judgement of values that were read. `bus_checkup` and `board_checkup` investigate further on the line,
`hexwire.link.diagnose` investigates ports.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import groupby
from typing import TYPE_CHECKING

from hexwire.link.diagnose import Finding, Level
from hexwire.model.state import JointFlag

if TYPE_CHECKING:
    from hexwire.model.state import JointReading, JointState

    from .values import JointProbe, ProbeReport

__all__ = ["examine", "judge_board", "judge_probe", "judge_state", "together"]

_FRESH_BOOT = 3.0
_SUPPLY = (5.0, 8.4)
"""Volts for a servo that does not report its range: 6 V class, up to a full 2S battery."""
_WARM = 60.0
"""Degrees Celsius for a servo that does not report its limit."""
_COOLER = 10.0
"""Degrees below its limit from which a servo counts as warm."""
_OK_FAILURES, _BAD_FAILURES = 0.001, 0.02

_FAULT_ADVICE = {
    JointFlag.OVERLOAD: "it was blocked: free the joint, hold the arm, switch the joint's torque off and on again",
    JointFlag.TEMPERATURE: "let it cool with the torque off, then lower the load",
    JointFlag.CURRENT: "it was blocked or is shorted: free the joint, then switch its torque off and on again",
    JointFlag.ENCODER: "its position sensor fails: replace the servo",
}


def examine(report: ProbeReport, state: JointState) -> list[Finding]:
    """Check a robot with a controller by its probe and its state."""
    findings = judge_board(report) + judge_probe(report)
    shaky = [joint.name for joint in report.joints if joint.present and joint.name in state.silent]
    if shaky:
        advice = "check contacts, ground and supply of these servos"
        findings.append(Finding(Level.BAD, ", ".join(shaky), "answered the probe, but not the next read", advice))
    return findings + judge_state(state, report.joints)


def judge_board(report: ProbeReport) -> list[Finding]:
    """Check what a controller reports about itself: dialect, start, failure counts."""
    firmware = f", firmware {report.firmware}" if report.firmware else ""
    text = report.robot + (f", dialect {report.dialect}" if report.dialect else "") + firmware
    if report.dialect == 1:
        findings = [
            Finding(Level.HINT, "board", text, "it speaks the chapter's dialect only; `hexwire firmware flash`")
        ]
    else:
        findings = [Finding(Level.OK, "board", text)]
    uptime = report.counters.get("board_uptime_ms", math.inf) / 1000
    if uptime < _FRESH_BOOT:
        text = f"started {uptime:.1f} s ago: opening its port resets it"
        advice = "normal for an Arduino; a 10 uF capacitor from RESET to GND prevents it"
        findings.append(Finding(Level.HINT, "board", text, advice))
    asked = report.counters.get("board_bus_transactions", 0)
    failed = report.counters.get("board_bus_timeouts", 0) + report.counters.get("board_bus_bad", 0)
    if asked and not report.missing:
        # Requests to a missing servo fail, which does not show that the line is bad.
        rate = failed / asked
        text = f"{failed} of {asked} transactions failed since the board started ({rate:.2%})"
        level = Level.OK if rate < _OK_FAILURES else Level.BAD if rate > _BAD_FAILURES else Level.HINT
        advice = "" if level is Level.OK else "check cable length, ground and supply"
        findings.append(Finding(level, "servo bus", text, advice))
    return findings


def judge_probe(report: ProbeReport, *, missing: bool = True) -> list[Finding]:
    """Check which servos answer, and whether they are the expected ones.

    Args:
        report: The probe.
        missing: Report missing servos too; False if the caller has findings with the reason.
    """
    findings = []
    if report.stopped:
        findings.append(Finding(Level.HINT, report.robot, "is stopped", "hexwire resume"))
    silent = [joint for joint in report.joints if not joint.present]
    if not silent:
        findings.append(Finding(Level.OK, "servos", f"all {len(report.joints)} answer"))
    elif missing:
        names = ", ".join(f"{joint.name} (servo {joint.servo_id})" for joint in silent)
        advice = "check power, the cable after the last servo that answers, and the id: `hexwire ping`"
        verb = "do" if len(silent) > 1 else "does"
        findings.append(Finding(Level.BAD, "servos", f"{names} {verb} not answer", advice))
    advice = "use the right servo, or the right model"
    findings += [Finding(Level.BAD, joint.name, joint.note, advice) for joint in report.joints if joint.note]
    return findings


def judge_state(state: JointState, joints: Sequence[JointProbe]) -> list[Finding]:
    """Check faults, supply and temperature of the joints that answered.

    Args:
        state: The state.
        joints: The probe of each joint.
    """
    known = {joint.name: joint for joint in joints}
    findings: list[Finding] = []
    if state.watchdog_tripped:
        text = f"the board's watchdog stopped the arm because {state.trip_reason}"
        findings.append(Finding(Level.HINT, "stop", text, "hexwire resume"))
    here = [joint for joint in state if not joint.flags & JointFlag.SILENT]
    for joint in here:
        findings += _judge_supply(joint, known.get(joint.name))
        findings += _judge_heat(joint, known.get(joint.name))
        for flag, advice in _FAULT_ADVICE.items():
            if joint.flags & flag and not (flag is JointFlag.TEMPERATURE and _heat_said(findings, joint.name)):
                findings.append(Finding(Level.BAD, joint.name, f"reports {_words(flag)}", advice))
    findings = together(findings)
    if here and not any(finding.level is Level.BAD for finding in findings):
        findings.append(Finding(Level.OK, "servos", "no servo reports a fault"))
    supplies = {probe.supply for probe in joints if probe.supply is not None}
    limits = {probe.max_temperature for probe in joints if probe.max_temperature is not None}
    wanted = "; the servos need {:.1f} to {:.1f} V".format(*supplies.pop()) if len(supplies) == 1 else ""
    limit = f"; the limit is {limits.pop():.0f}" if len(limits) == 1 else ""
    findings += _measured(here, lambda joint: joint.voltage, "supply", "{:.1f} V", wanted)
    findings += _measured(here, lambda joint: joint.temperature, "temperature", "{:.0f} deg C", limit)
    return findings


def together(findings: Sequence[Finding]) -> list[Finding]:
    """Merge findings that differ only in the joint, in the order of the first."""
    order = {(f.level, f.text, f.advice): place for place, f in reversed(list(enumerate(findings)))}
    ranked = sorted(findings, key=lambda f: order[f.level, f.text, f.advice])
    merged = []
    for _, group in groupby(ranked, key=lambda f: (f.level, f.text, f.advice)):
        rows = list(group)
        merged.append(Finding(rows[0].level, ", ".join(row.about for row in rows), rows[0].text, rows[0].advice))
    return merged


def _judge_supply(joint: JointReading, probe: JointProbe | None) -> list[Finding]:
    reported = bool(joint.flags & JointFlag.VOLTAGE)
    if not math.isfinite(joint.voltage):
        if not reported:
            return []
        return [Finding(Level.BAD, joint.name, "reports voltage", "measure its supply, under load too")]
    low, high = _SUPPLY if probe is None or probe.supply is None else probe.supply
    wants = f"a servo that needs {low:.1f} to {high:.1f} V"
    if joint.voltage < low:
        advice = "use a stronger supply, or thicker or shorter wires; measure it under load"
        return [Finding(Level.BAD, joint.name, f"supply {joint.voltage:.1f} V, too low for {wants}", advice)]
    if joint.voltage > high:
        advice = "switch the supply off: it is for servos of another voltage class"
        return [Finding(Level.BAD, joint.name, f"supply {joint.voltage:.1f} V, too high for {wants}", advice)]
    if reported:
        text = f"reports a voltage fault, but its supply is {joint.voltage:.1f} V now"
        return [Finding(Level.BAD, joint.name, text, "the supply sags: measure it under load")]
    return []


def _judge_heat(joint: JointReading, probe: JointProbe | None) -> list[Finding]:
    limit = None if probe is None else probe.max_temperature
    heat = joint.temperature
    if not math.isfinite(heat):
        return []
    cool = _FAULT_ADVICE[JointFlag.TEMPERATURE]
    if joint.flags & JointFlag.TEMPERATURE and (limit is None or heat < limit):
        return [Finding(Level.BAD, joint.name, f"reports temperature, {heat:.0f} deg C now", cool)]
    if limit is None:
        return [Finding(Level.HINT, joint.name, f"{heat:.0f} deg C", "let it rest")] if heat > _WARM else []
    if heat >= limit:
        return [Finding(Level.BAD, joint.name, f"{heat:.0f} deg C, its limit is {limit:.0f}", cool)]
    if heat > limit - _COOLER:
        return [Finding(Level.HINT, joint.name, f"{heat:.0f} deg C, its limit is {limit:.0f}", "let it rest")]
    return []


def _heat_said(findings: Sequence[Finding], name: str) -> bool:
    """Whether a bad finding about a joint's temperature exists already."""
    return any(f.about == name and f.level is Level.BAD and "deg C" in f.text for f in findings)


def _measured(
    joints: Sequence[JointReading], value: Callable[[JointReading], float], what: str, form: str, rated: str
) -> list[Finding]:
    """Report the range of the values read, and the joints without a value."""
    values = [value(joint) for joint in joints if math.isfinite(value(joint))]
    unknown = [joint.name for joint in joints if not math.isfinite(value(joint))]
    findings = []
    if values:
        low, high = form.format(min(values)), form.format(max(values))
        span = low if low == high else f"{low.split()[0]} to {high}"
        findings.append(Finding(Level.OK, what, span + rated))
    if unknown:
        who = "no servo" if len(unknown) == len(joints) else ", ".join(unknown)
        text = "unknown: the servos do not report it" if who == "no servo" else f"unknown for {who}"
        findings.append(Finding(Level.UNKNOWN, what, text))
    return findings


def _words(flag: JointFlag) -> str:
    return (flag.name or "").lower()
