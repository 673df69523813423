"""Asks a servo bus for the set-up of an arm, and carries out its steps.

Owns where new servos are looked for, and what is read of them. The change itself is `bus.identity`'s, which cannot
lose a servo. Asks and shows nothing; that is the caller's task.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from hexwire.bus.identity import change_identity
from hexwire.bus.servo_facts import remarks, voltage_class
from hexwire.bus.setup import identify, scan, shares_id
from hexwire.errors import NotSupportedError, ServoError, UsageError

from .arm_setup import SeenServo, StepKind

if TYPE_CHECKING:
    from hexwire.bus.servo_bus import ServoBus
    from hexwire.bus.setup import Found, ServoInfo

    from .arm_setup import ArmSetup, SetupStep

__all__ = ["assign", "look"]

_USUAL_IDS = range(21)
_SETTINGS = ("max_voltage", "min_voltage", "mode")


def look(
    bus: ServoBus,
    setup: ArmSetup,
    *,
    everywhere: bool = False,
    progress: Callable[[int, int, int], None] | None = None,
) -> None:
    """Look for servos, and tell the set-up. Nothing is written. The bus is at the arm's rate afterwards.

    First at the arm's rate with the usual ids; if there is no new servo, at all rates. One servo alone is found
    under any id.

    Args:
        bus: The open bus.
        setup: The set-up.
        everywhere: Try every id at every rate, which takes about 20 s.
        progress: As for `bus.setup.scan`.

    Raises:
        LinkError: The line has a fault.
    """
    if bus.timing.baud != setup.baud and _adjustable(bus):
        bus.set_baud(setup.baud)
    found = _found(bus, setup.baud, range(254) if everywhere else _USUAL_IDS, progress)
    _tell(bus, setup, found)
    if not _adjustable(bus) or (setup.step.kind is not StepKind.CONNECT):
        return
    rates = sorted(set(bus.series.baud_codes.values()) - {setup.baud}, reverse=True)
    for baud in rates:
        try:
            bus.set_baud(baud)
        except (UsageError, NotSupportedError):
            continue  # the adapter does not have this rate
        try:
            found += _found(bus, baud, range(254) if everywhere else _USUAL_IDS, progress)
        finally:
            bus.set_baud(setup.baud)
    _tell(bus, setup, found)


def _adjustable(bus: ServoBus) -> bool:
    return getattr(bus.link, "set_baud", None) is not None


def _found(
    bus: ServoBus, baud: int, ids: Iterable[int], progress: Callable[[int, int, int], None] | None
) -> list[SeenServo]:
    """The servos that answer at the present rate."""
    rows = scan(bus, ids=ids, progress=progress)
    if not rows:
        # One servo alone answers a ping of all, whatever its id.
        alone, _ = bus.broadcast_ping(1)
        rows = scan(bus, ids=alone)
    return [_seen(bus, row, baud) for row in rows]


def _seen(bus: ServoBus, row: Found, baud: int) -> SeenServo:
    info = row.info
    if info is None or info.series is None or row.shared:
        return SeenServo(row.servo_id, baud, row.shared, info)
    settings: dict[str, float] = {}
    registers = bus.series_of(row.servo_id).registers
    for name in _SETTINGS:
        if name in registers:
            settings[name] = bus.read(row.servo_id, name).value
    supply = bus.read(row.servo_id, "present_voltage").value if "present_voltage" in registers else math.nan
    kind = voltage_class(settings.get("max_voltage", math.nan))
    known = remarks(info, settings)
    found = tuple(remarks(info, settings, supply))
    blocked = "; ".join(remark.text for remark in found if remark.bad and remark not in known)
    return SeenServo(row.servo_id, baud, False, info, found, supply, kind, blocked)


def _tell(bus: ServoBus, setup: ArmSetup, found: list[SeenServo]) -> None:
    """Tell the set-up, with the remarks that concern several servos together."""
    infos = [row.info for row in found if row.info is not None]
    versions = {info.firmware for info in infos if info.model_name}
    if len(versions) > 1:
        found = [row if row.info is None else _mixed(row, row.info, infos) for row in found]
    setup.receive(found)


def _mixed(row: SeenServo, info: ServoInfo, infos: list[ServoInfo]) -> SeenServo:
    others = [other for other in infos if other is not info]
    more = [remark for remark in remarks(info, {}, others=others) if remark not in row.remarks]
    return row._replace(remarks=(*row.remarks, *more))


def assign(
    bus: ServoBus, setup: ArmSetup, step: SetupStep, *, tell: Callable[[str], object] = lambda words: None
) -> None:
    """Give the servo of an ASSIGN step the id and rate of its joint; both are read back.

    Whatever goes wrong, the servo has its old or its new id, and its old or its new rate: the next `look` finds it.

    Args:
        bus: The open bus. It is at the arm's rate afterwards.
        setup: The set-up.
        step: Its present step.
        tell: Called with each part in words, before it.

    Raises:
        UsageError: It is another step, or the step is blocked.
        ServoError: It failed; the text says what the servo has now.
    """
    servo, joint = step.servo, step.joint
    if step.kind is not StepKind.ASSIGN or servo is None or joint is None:
        raise UsageError("there is no servo to set up at this step")
    if step.blocked:
        raise UsageError(f"servo {servo.servo_id} is not changed: {step.blocked}")
    if servo.baud != setup.baud:
        # Another servo that has this id at the arm's rate would be changed too when the rates meet.
        for servo_id in {joint.servo_id, servo.servo_id}:
            if scan(bus, ids=(servo_id,)):
                raise ServoError(f"another servo has id {servo_id} at {setup.baud} baud: unplug one of them")
    try:
        if bus.timing.baud != servo.baud:
            bus.set_baud(servo.baud)
        change_identity(bus, servo.servo_id, new_id=joint.servo_id, new_baud=setup.baud, step=tell)
    finally:
        if bus.timing.baud != setup.baud and _adjustable(bus):
            bus.set_baud(setup.baud)
    info = identify(bus, joint.servo_id)
    if info is None or (info.baud and info.baud != setup.baud) or shares_id(bus, joint.servo_id):
        raise ServoError(f"servo {joint.servo_id} does not answer as it should after the change: look again")
    setup.assigned(joint, info)
