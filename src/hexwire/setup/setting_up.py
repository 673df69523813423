"""Asks a servo bus for the set-up of an arm, and carries out its steps.

Owns where new servos are looked for, and what is read of them. The change itself is `bus.identity`'s, which cannot
lose a servo. Asks and shows nothing; that is the caller's task.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from hexwire.bus.identity import change_identity
from hexwire.bus.setup import ServoInfo, identify, scan, shares_id
from hexwire.bus.survey import Surveyed, remarks, survey
from hexwire.errors import NotSupportedError, ServoError, UsageError

from .arm_setup import ArmSetup, SeenServo, SetupStep, StepKind

if TYPE_CHECKING:
    from hexwire.bus.servo_bus import ServoBus


__all__ = ["assign", "look"]

_USUAL_IDS = range(21)


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
    setup.receive(found)
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
    setup.receive(found)


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
    known = survey(bus, rows)
    return [_seen(row, baud, [other.info for other in rows if other.info is not None]) for row in known]


def _seen(row: Surveyed, baud: int, others: list[ServoInfo]) -> SeenServo:
    info, shared = row.found.info, row.found.shared
    # What remains without the supply does not keep a setting from being stored.
    harmless = [] if info is None else remarks(info, row.settings, others=others)
    blocked = "" if shared else "; ".join(one.text for one in row.remarks if one.bad and one not in harmless)
    return SeenServo(row.found.servo_id, baud, shared, info, tuple(row.remarks), row.supply, row.kind, blocked)


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
    # A line without a rate, such as a bridge over TCP, has the servo's already.
    adjustable = _adjustable(bus)
    try:
        if adjustable and bus.timing.baud != servo.baud:
            bus.set_baud(servo.baud)
        new_baud = setup.baud if adjustable else None
        change_identity(bus, servo.servo_id, new_id=joint.servo_id, new_baud=new_baud, step=tell)
    finally:
        if adjustable and bus.timing.baud != setup.baud:
            bus.set_baud(setup.baud)
    info = identify(bus, joint.servo_id)
    if info is None or (info.baud and info.baud != setup.baud) or shares_id(bus, joint.servo_id):
        raise ServoError(f"servo {joint.servo_id} does not answer as it should after the change: look again")
    setup.assigned(joint, info)
