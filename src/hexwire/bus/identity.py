"""A guided change of a servo's id and line rate that cannot lose it.

Owns the order of the steps, what is told of each, and where a servo is looked for after a step that failed. `setup`
owns the steps themselves: each is checked before, read back, and goes back. Must not know terminals or pages.

**Why nothing is lost.** The id is changed first, at the old rate, then the rate. So at any moment the servo has the
old or the new id and the old or the new rate, whatever is cut off or falls silent; `find_again` looks in these four
places. Nothing is written before the servo answers, is the only one with its id, and the new id is free.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hexwire.errors import ServoError, UsageError

from .servo_bus import ServoBus
from .setup import Found, ServoInfo, identify, scan, set_baud, set_id, shares_id

__all__ = ["change_identity", "find_again"]


def change_identity(
    bus: ServoBus,
    servo_id: int,
    *,
    new_id: int | None = None,
    new_baud: int | None = None,
    step: Callable[[str], object] = lambda words: None,
) -> ServoInfo:
    """Change the id of a servo, then its rate; each is verified, and undone if it fails.

    Args:
        bus: The bus, at the servo's present rate. It is at the servo's new rate afterwards.
        servo_id: Its present id.
        new_id: Its new id; None keeps it.
        new_baud: Its new rate; None keeps it.
        step: Called with each step in words, before it.

    Returns:
        Its identity afterwards.

    Raises:
        UsageError: An id or rate is invalid; nothing was changed.
        NotSupportedError: The series or the link has no adjustable rate.
        ServoError: A step failed; the text says what the servo has now, and if the id was already changed.
    """
    step(f"ask servo {servo_id} who it is, and whether it is the only one with this id")
    info = identify(bus, servo_id)
    if info is None:
        raise ServoError(f"servo {servo_id} does not answer: check cable, power, id and rate", servo_id=servo_id)
    wants_baud = new_baud is not None and new_baud != bus.timing.baud
    if wants_baud:
        # Before the id is written: a change of which only half is possible is not begun.
        rates = sorted(bus.series_of(servo_id).baud_codes.values())
        if rates and new_baud not in rates:
            known = ", ".join(map(str, rates))
            raise UsageError(f"{bus.series_of(servo_id).value} servos support {known} baud, not {new_baud}")
    if new_id is not None and new_id != servo_id:
        step(f"check that id {new_id} is free, write it, and ask under {new_id} and {servo_id}")
        info = set_id(bus, servo_id, new_id)
        servo_id = new_id
    if wants_baud and new_baud is not None:
        step(f"write {new_baud} baud, change to it, and ask there")
        try:
            set_baud(bus, servo_id, new_baud)
        except ServoError as error:
            if info.servo_id == new_id:
                raise ServoError(f"its id is {new_id} now, but {error}", servo_id=servo_id) from None
            raise
        info = info._replace(baud=new_baud)
    step(f"done: servo {servo_id} answers at {bus.timing.baud} baud")
    return info


def find_again(bus: ServoBus, servo_ids: Sequence[int], bauds: Sequence[int]) -> Found | None:
    """Look for a servo under its possible ids and rates, after a change that was cut off.

    Args:
        bus: The bus; it stays at the rate at which the servo answers, or keeps its rate.
        servo_ids: Its old and its new id.
        bauds: Its old and its new rate.

    Returns:
        Where it answers; None if nowhere. Switching its supply off and on ends a setting that was only half made.
    """
    ids, rates = list(dict.fromkeys(servo_ids)), list(dict.fromkeys(bauds))
    if getattr(bus.link, "set_baud", None) is None:
        rates = [bus.timing.baud]
    found = scan(bus, bauds=rates, ids=ids)
    for row in found:
        if row.info is None:
            continue
        if row.baud != bus.timing.baud:
            bus.set_baud(row.baud)
        # The scan ended at another rate: what it knew of the servo is asked again at this one.
        info = identify(bus, row.servo_id)
        return row._replace(info=info, shared=shares_id(bus, row.servo_id))
    return None
