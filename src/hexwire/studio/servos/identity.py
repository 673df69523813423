"""A change of id and rate, and the search for a servo whose change was cut off.

Owns which addresses may be chosen, and what a page is told meanwhile. The steps belong to `bus.identity`, which
cannot lose a servo.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hexwire.bus.identity import change_identity, find_again
from hexwire.errors import ServoError, UsageError
from hexwire.studio.calls import Arguments, Asked, OfServo, call

from .search import check_rate, rate_words

if TYPE_CHECKING:
    from collections.abc import Iterable

    from hexwire.bus.setup import Found, ServoInfo

__all__ = ["change", "look", "rates"]


class _Change(Arguments, frozen=True):
    servo: int
    new_id: int
    new_baud: int


class _Look(Arguments, frozen=True):
    ids: tuple[int, int]
    bauds: tuple[int, int]


@call("identity.rates", OfServo)
def _rates(asked: Asked, args: OfServo) -> dict[str, Any]:
    """The rate of the bus, and the rates to choose from, in words."""
    bus = asked.bus.bus
    here = bus.timing.baud
    return {"here": here, "rates": [*rates(here, bus.series_of(args.servo).baud_codes.values()).items()]}


@call("identity.change", _Change, control=True)
def _change(asked: Asked, args: _Change) -> str:
    told: list[str] = []

    def tell(words: str) -> None:
        told.append(words)
        asked.studio.live.tell({"kind": "steps", "rows": told}, asked.tab.key)

    asked.known(args.servo)
    change(asked, args.servo, args.new_id, args.new_baud, tell)
    return f"servo {args.new_id} answers at {rate_words(asked.bus.bus.timing.baud)}"


@call("identity.look", _Look, control=True)
def _look(asked: Asked, args: _Look) -> dict[str, Any]:
    for servo_id in args.ids:
        _check_id(servo_id)
    for baud in args.bauds:
        # At another rate no servo would hear a stop, and the line could be there for long.
        if baud != asked.bus.bus.timing.baud:
            check_rate(baud)
    found = look(asked, args.ids, args.bauds)
    return {"servo": found.servo_id, "told": f"servo {found.servo_id} answers at {rate_words(found.baud)}"}


def rates(here: int, known: Iterable[int]) -> dict[int, str]:
    """The rates to choose from, in words. A line without a rate could not follow a change of it."""
    if not here:
        return {here: rate_words(here)}
    found = {baud: rate_words(baud) for baud in sorted(known, reverse=True)}
    return found or {here: "the rate of this series is fixed"}


def change(asked: Asked, servo_id: int, new_id: int, new_baud: int, tell: Any) -> ServoInfo:
    """Give a servo another id and rate.

    Args:
        asked: Who asks.
        servo_id: Its id now.
        new_id: The id to get.
        new_baud: The rate to get.
        tell: Called with each step in words.

    Raises:
        UsageError: There is no such id.
        HexwireError: As `change_identity`.
    """
    bus = asked.bus
    _check_id(new_id)
    with bus.bench.working("a change of id and rate", acts=True, changes_rate=True):
        info = change_identity(bus.bus, servo_id, new_id=new_id, new_baud=new_baud, step=tell)
        bus.edits.moved(servo_id, new_id)
        bus.look_again(new_id, former=servo_id)
    return info


def _check_id(servo_id: int) -> None:
    if not 0 <= servo_id <= 253:
        raise UsageError(f"id {servo_id} is outside 0..253")


def look(asked: Asked, ids: tuple[int, int], bauds: tuple[int, int]) -> Found:
    """Look for a servo whose change was cut off.

    Raises:
        ServoError: It does not answer.
    """
    with asked.bus.bench.working("the search for a servo", changes_rate=True):
        found = find_again(asked.bus.bus, ids, bauds)
        if found is None:
            raise ServoError(f"it answers neither as {ids[0]} nor as {ids[1]}: switch its supply off and on")
        asked.bus.look_again(found.servo_id, former=next((i for i in ids if i != found.servo_id), None))
    return found
