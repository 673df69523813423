"""Diagnosis of a robot from its probe and its state, and of a line on which nothing answers; it says what to do.

Owns the judgement of values that were read, and the order of the checks on a line: shared ids, ids that the arm
does not have, other rates, echo, other devices. Sends only pings and reads; nothing is written and nothing moves.
`hexwire.link.diagnose` investigates ports.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import groupby
from time import monotonic
from typing import TYPE_CHECKING

from hexwire.bus import setup as servo_setup
from hexwire.errors import NotSupportedError, UsageError
from hexwire.ipc.board_search import find_board
from hexwire.ipc.mistaken import find_servos, is_servo_bus
from hexwire.link.adapter import inspect_adapter
from hexwire.link.diagnose import Finding, Level
from hexwire.model.state import JointFlag, JointReading, JointState
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import iter_status, make_ping, strip_echo

from .firmware import HOST_RATES

if TYPE_CHECKING:
    from hexwire.bus.servo_bus import ServoBus
    from hexwire.link.base import Link
    from hexwire.model.arm import ArmModel, JointModel

    from .values import JointProbe, ProbeReport

__all__ = [
    "SERVO_RATES",
    "examine",
    "examine_bus",
    "explain_chatter",
    "explain_missing",
    "explain_no_board",
    "explain_silence",
    "judge_board",
    "judge_probe",
    "judge_state",
    "judge_traffic",
    "together",
]

_BOARD_RATES = (57_600, *HOST_RATES[1:])
_PATIENCE = 0.6
"""Seconds to wait for an answer at each rate."""


def explain_no_board(link: Link) -> list[Finding]:
    """Find out why no board answers; returns one finding, or none if no cause is found.

    Args:
        link: A closed link; it is opened for this and closed again.

    Raises:
        LinkError: It cannot be opened.
    """
    if not hasattr(link, "set_baud"):
        return []
    with link:
        chatter = explain_chatter(link)
        if chatter is not None:
            return [chatter]
        for baud in _BOARD_RATES:
            try:
                board = find_board(link, baud=baud, patience=_PATIENCE)
            except (UsageError, NotSupportedError):
                continue
            if board is not None:
                text = f"the board uses {baud} baud"
                return [Finding(Level.BAD, "rate", text, f"name it: --baud {baud}")]
        for baud in SERVO_RATES:
            servo_ids = find_servos(link, baud=baud)
            if servo_ids:
                return [Finding(Level.BAD, "device", str(is_servo_bus(link.url, servo_ids, baud=baud)))]
    return []


SERVO_RATES = tuple(Series.STS_SMS.baud_codes.values())
"""Rates that a servo may be set to, of all series."""

_CHATTER_TIME = 0.4
_NOISE_TIME = 0.05
_NOISE_PINGS = 3
_ROUNDS = 30
_OK_LOST, _BAD_LOST = 0.01, 0.05
"""Fractions of answers lost: a computer that stalls for a moment costs one or two of 180."""


def examine_bus(bus: ServoBus, model: ArmModel, report: ProbeReport, state: JointState) -> list[Finding]:
    """Check an arm on a bus; each finding says what to do.

    Args:
        bus: The open bus.
        model: The arm.
        report: A probe of the arm.
        state: A state of the arm.
    """
    silent = {joint.name for joint in report.joints if not joint.present} | set(state.silent)
    lost = explain_missing(bus, model, [model.joint(name) for name in model.names if name in silent])
    findings = [Finding(Level.OK, "bus", f"{report.robot} at {bus.timing.baud} baud")]
    findings += judge_probe(report, missing=False) + lost + judge_state(state, report.joints)
    if not lost:
        # Missing servos would distort the statistics of the adapter.
        findings += judge_traffic(bus, model)
    device = getattr(bus.link, "device", None)
    if isinstance(device, str):
        advice = inspect_adapter(device, bus.timing.overhead, bus.timing.holds_back).advice
        if advice and bus.timing.holds_back:
            findings.append(Finding(Level.HINT, "adapter", "the adapter delays answers", advice))
    return findings


def explain_silence(bus: ServoBus, model: ArmModel) -> list[Finding]:
    """Find out why no servo of an arm answers; returns one finding.

    Args:
        bus: The open bus.
        model: The arm.
    """
    baud = bus.timing.baud
    other = explain_chatter(bus.link) or _explain_noise(bus, model)
    if other is not None:
        return [other]
    wanted = [joint.servo_id for joint in model.joints]
    rates = _at_other_rates(bus, wanted)
    if rates:
        return [_wrong_rate(ids, rate, baud, all_of_them=True) for rate, ids in rates.items()]
    found = [row.servo_id for row in servo_setup.scan(bus) if row.info is not None]
    if found:
        text = f"servos {_list(found)} answer, but none of {model.name}'s ({_list(wanted)})"
        advice = "check --robot; if it is right, connect one servo at a time and `hexwire bus set-id OLD NEW`"
        return [Finding(Level.BAD, "ids", text, advice)]
    advice = "switch the servos' supply on; check the cable to the first servo"
    if bus.echo or "echo" in bus.ping(wanted[0]).error:
        text = "it receives only its own echo: no servo has power, or none is connected"
        return [Finding(Level.BAD, "adapter", text, advice)]
    text = f"no servo answers at {baud} baud, nor at any other rate"
    return [Finding(Level.BAD, "adapter", text, f"{advice}; is this the adapter's --port?")]


def explain_chatter(link: Link) -> Finding | None:
    """Check for a device that sends unrequested data; servos and boards do not.

    Args:
        link: The open link.
    """
    clock = getattr(link, "clock", monotonic)
    link.flush_input()
    data, until = b"", clock() + _CHATTER_TIME
    while clock() < until:
        data += link.read(until)
    if not data:
        return None
    text = f"{len(data)} bytes arrived unrequested, such as {_shown(data)}"
    return Finding(Level.BAD, "device", text, "another device is on this port: give the right --port")


def _explain_noise(bus: ServoBus, model: ArmModel) -> Finding | None:
    """Check for a device that answers every ping, but not as a servo does."""
    noises = []
    for joint in model.joints[:_NOISE_PINGS]:
        ping = make_ping(joint.servo_id)
        bus.link.flush_input()
        data = strip_echo(bus.link.exchange(ping, _NOISE_TIME) + bus.link.read(bus.now() + _NOISE_TIME), ping)
        if data and not list(iter_status(data)):
            noises.append(data)
    if len(noises) < min(_NOISE_PINGS, len(model.joints)):
        return None
    text = f"the device that answers is not a servo: a ping returned {_shown(noises[0])}"
    return Finding(Level.BAD, "device", text, "another device is on this port: give the right --port")


def explain_missing(bus: ServoBus, model: ArmModel, missing: Sequence[JointModel]) -> list[Finding]:
    """Find out why some servos of an arm do not answer; returns a cause for each.

    Args:
        bus: The open bus.
        model: The arm.
        missing: The joints whose servo does not answer, or gives no readable answer.
    """
    gone = {joint.servo_id: joint for joint in missing}
    shared = [joint.servo_id for joint in model.joints if servo_setup.shares_id(bus, joint.servo_id)]
    for servo_id in shared:
        gone.pop(servo_id, None)
    if shared:
        # The missing servos are most likely among these: a new servo has id 1.
        lost = f"; {_joints(list(gone.values()))} may be among them" if gone else ""
        about = f"id{'s' if len(shared) > 1 else ''} {_list(shared)}"
        text = f"several servos seem to share an id, since their answers collide{lost}"
        advice = "connect them one at a time and `hexwire bus set-id OLD NEW`"
        return [Finding(Level.BAD, about, text, advice)]
    if not gone:
        return []
    findings: list[Finding] = []
    baud = bus.timing.baud
    for rate, ids in _at_other_rates(bus, list(gone)).items():
        findings.append(_wrong_rate(ids, rate, baud))
        for servo_id in ids:
            gone.pop(servo_id)
    if not gone:
        return findings
    ours = {joint.servo_id for joint in model.joints}
    rows = servo_setup.scan(bus, ids=[i for i in range(254) if i not in ours])
    strangers = [row.servo_id for row in rows if row.info is not None]
    for servo_id, joint in zip(strangers, list(gone.values()), strict=False):
        text = f"answers, but {model.name} has no such servo; {_joints([joint])} is missing"
        advice = f"if it belongs to that joint: `hexwire bus set-id {servo_id} {joint.servo_id}`"
        findings.append(Finding(Level.BAD, f"id {servo_id}", text, advice))
        gone.pop(joint.servo_id)
    if gone:
        joints = list(gone.values())
        advice = "check its power, the cable to it and to the servo before it; `hexwire bus scan --all-rates`"
        verb = "does" if len(joints) == 1 else "do"
        findings.append(Finding(Level.BAD, "servos", f"{_joints(joints)} {verb} not answer", advice))
    return findings


def judge_traffic(bus: ServoBus, model: ArmModel) -> list[Finding]:
    """Read positions repeatedly and check how many answers are lost; all servos must be present."""
    ids = tuple(joint.servo_id for joint in model.joints)
    before = bus.counters
    for _ in range(_ROUNDS):
        bus.sync_read("present_position", ids)
    counters = bus.counters
    asked, lost = _ROUNDS * len(ids), counters.lost - before.lost
    findings = []
    if counters.echoes:
        findings.append(Finding(Level.OK, "adapter", "it echoes what is sent, and the echo is removed"))
    text = f"{lost} of {asked} answers lost ({lost / asked:.1%})"
    level = Level.OK if lost <= _OK_LOST * asked else Level.BAD if lost > _BAD_LOST * asked else Level.HINT
    advice = "" if level is Level.OK else "check contacts, ground and supply: `hexwire bus stress` names the servo"
    return [*findings, Finding(level, "servo bus", text, advice)]


def _at_other_rates(bus: ServoBus, ids: Sequence[int]) -> dict[int, list[int]]:
    """Find the ids that answer at another rate, by rate."""
    found: dict[int, list[int]] = {}
    rates = [rate for rate in SERVO_RATES if rate != bus.timing.baud]
    try:
        rows = servo_setup.scan(bus, bauds=rates, ids=ids)
    except (UsageError, NotSupportedError):
        return {}  # a link without a rate, or without some of these rates
    for row in rows:
        if row.info is not None:
            found.setdefault(row.baud, []).append(row.servo_id)
    return found


def _wrong_rate(ids: Sequence[int], rate: int, wanted: int, *, all_of_them: bool = False) -> Finding:
    several = len(ids) > 1
    text = (
        f"servo{'s' if several else ''} {_list(ids)} answer{'' if several else 's'} at {rate} baud, not at {wanted}"
    )
    which = "ID" if several else str(ids[0])
    advice = f"`hexwire bus set-baud {which} {wanted} --baud {rate}`"
    if all_of_them:
        advice = f"give the rate, --baud {rate}; or {advice} for each"
    return Finding(Level.BAD, "rate", text, advice)


def _shown(data: bytes) -> str:
    line = data.strip().split(b"\n")[0].strip()[:24]
    text = line.decode("ascii", errors="replace")
    return repr(text) if text.isprintable() and text.isascii() else data[:12].hex(" ").upper()


def _joints(joints: Sequence[JointModel]) -> str:
    return ", ".join(f"{joint.name} (servo {joint.servo_id})" for joint in joints)


def _list(ids: Sequence[int]) -> str:
    return ", ".join(map(str, ids))


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
