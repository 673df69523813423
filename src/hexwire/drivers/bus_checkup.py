"""Diagnosis of a bus on which servos of an arm do not answer: each cause in one line, with what to do.

Owns the order of the checks: shared ids, ids that the arm does not have, other rates, echo, other devices. Sends
only pings and reads; nothing is written and nothing moves. Must not know ports.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import monotonic
from typing import TYPE_CHECKING

from hexwire.bus import setup as servo_setup
from hexwire.errors import NotSupportedError, UsageError
from hexwire.link.adapter import inspect_adapter
from hexwire.link.diagnose import Finding, Level
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import iter_status, make_ping, strip_echo

from .checkup import judge_probe, judge_state

if TYPE_CHECKING:
    from hexwire.bus.servo_bus import ServoBus
    from hexwire.link.base import Link
    from hexwire.model.arm import ArmModel, JointModel
    from hexwire.model.state import JointState

    from .base import ProbeReport

__all__ = ["SERVO_RATES", "examine_bus", "explain_chatter", "explain_missing", "explain_silence", "judge_traffic"]

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
