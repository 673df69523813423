"""What is plugged into this machine: each port, what it probably is, and why it cannot be opened.

Owns joining what `hexwire ports` and `hexwire doctor` find without opening anything. Its call may take a moment.
Must not know pages.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from hexwire.drivers.board_reset import reset_hazard
from hexwire.drivers.registry import bus_arm_names, robot_names
from hexwire.link.diagnose import Finding, Level, diagnose_port, diagnose_system
from hexwire.link.owner import device_owner
from hexwire.link.ports import PortInfo, list_ports
from hexwire.model.arms import arm_record, simulated_arms

__all__ = ["Plugged", "emulated", "find_plugged", "robots"]


@dataclass(frozen=True, slots=True)
class Plugged:
    """A port.

    Attributes:
        device: What to open.
        guess: What it probably is.
        robots: Robots that it may lead to, the likely one first; empty if it is probably something else.
        obstacle: Why it cannot be opened; empty if it can.
        advice: What to do about it, what opening it may move, or what else to mend.
    """

    device: str
    guess: str
    robots: tuple[str, ...] = ()
    obstacle: str = ""
    advice: str = ""


def robots() -> tuple[str, ...]:
    """Names of the robots that may be on a port."""
    return robot_names()


def emulated() -> tuple[Plugged, ...]:
    """Arms that need no hardware."""
    rows = []
    for record in map(arm_record, simulated_arms()):
        rows.append(Plugged(record.emulated, f"an emulated {record.title}", (record.name,)))
        if record.assembly is not None and not record.emulate:
            words = f"an emulated {record.title}, just assembled: its horns are anywhere"
            rows.append(Plugged(f"{record.emulated}?any_horns=1", words, (record.name,)))
    return tuple(rows)


def find_plugged(
    *,
    ports: Callable[[], Sequence[PortInfo]] = list_ports,
    owner: Callable[[str], str] = device_owner,
    diagnose: Callable[[PortInfo], Sequence[Finding]] = diagnose_port,
    system: Callable[[Sequence[PortInfo]], Sequence[Finding]] = diagnose_system,
    hazard: Callable[[str], str] = reset_hazard,
) -> list[Plugged]:
    """The ports of this machine, likely ones first. Opens nothing.

    Args:
        ports: Lists the ports.
        owner: Names the program that has a port open.
        diagnose: Checks one port.
        system: Checks for programs that open the ports of others.
        hazard: Says what opening a port may move.
    """
    found = list(ports())
    meddlers = [each for each in system(found) if each.level is Level.BAD]
    rows = [_row(port, owner(port.device), diagnose(port), meddlers, hazard) for port in found]
    return sorted(rows, key=lambda row: not row.robots)


def _row(
    port: PortInfo,
    owner: str,
    findings: Sequence[Finding],
    meddlers: Sequence[Finding],
    hazard: Callable[[str], str],
) -> Plugged:
    bad = [each for each in findings if each.level is Level.BAD]
    # A slow adapter is bad, too, but can be opened.
    closed = [each for each in bad if "may not" in each.text or "cannot" in each.text]
    hints = [each for each in findings if each.advice and each not in closed]
    obstacle = f"it is open in {owner}" if owner else closed[0].text if closed else ""
    advice = []
    if owner:
        advice.append("end that program, or open its arm by the address zenoh:NAME if it is 'hexwire serve'")
    advice += [each.advice for each in closed]
    advice += [f"{each.text}: {each.advice}" for each in hints]
    if port.usb_id:
        advice += [f"{each.about} {each.text}: {each.advice}" for each in meddlers]
    if not obstacle and (moves := hazard(port.device)):
        advice.insert(0, moves)
    likely = []
    if port.likely_board:
        likely.append("hex7bot")
    if port.likely_adapter:
        likely += bus_arm_names()
    usb = f" (USB {port.usb_id})" if port.usb_id else ""
    return Plugged(port.device, port.guess + usb, tuple(dict.fromkeys(likely)), obstacle, "; ".join(advice))
