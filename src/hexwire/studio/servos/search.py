"""The search for servos at all ids and rates, the list of those that were found, and what a chosen one is.

Owns which rates are searched, and what of a servo a page is told.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hexwire.bus import setup as servo_setup
from hexwire.bus.ids import parse_ids
from hexwire.drivers.checkup import SERVO_RATES
from hexwire.errors import ServoError, UsageError
from hexwire.studio.calls import Arguments, Asked, OfServo, call

if TYPE_CHECKING:
    from hexwire.bus.survey import Surveyed

__all__ = ["check_rate", "rate_words", "servos_of"]

_ALL = -1


class _Search(Arguments, frozen=True):
    rate: int
    ids: str


class _Rate(Arguments, frozen=True):
    baud: int


class _Torque(Arguments, frozen=True):
    servo: int
    on: bool


def rate_words(baud: int) -> str:
    """A rate in words; 0 is that of a line which has none of its own, such as a TCP adapter."""
    return f"{baud} baud" if baud else "the rate of the line"


@call("servos.list", Arguments)
def _list(asked: Asked, args: Arguments) -> dict[str, Any]:
    return servos_of(asked)


@call("servos.search", _Search, control=True)
def _search(asked: Asked, args: _Search) -> int:
    """Search; how many were found."""
    if args.rate not in (0, _ALL):
        check_rate(args.rate)
    wanted = [] if not args.rate else list(SERVO_RATES) if args.rate == _ALL else [args.rate]
    return len(asked.bus.search(wanted, list(dict.fromkeys(parse_ids(args.ids[:60])))))


@call("servos.rate", _Rate, control=True)
def _use_rate(asked: Asked, args: _Rate) -> None:
    check_rate(args.baud)
    asked.bus.use_rate(args.baud)


def check_rate(baud: int) -> None:
    """Raise `UsageError` for a rate that no servo has."""
    if baud not in SERVO_RATES:
        raise UsageError(f"there is no rate of {baud} baud")


@call("servos.cancel", Arguments)
def _cancel(asked: Asked, args: Arguments) -> None:
    """End what is under way, whoever has begun it."""
    asked.bus.bench.cancel()


@call("servos.torque", _Torque, control=True)
def _torque(asked: Asked, args: _Torque) -> None:
    asked.bus.switch_torque(args.on, asked.known(args.servo))


@call("servos.recover", OfServo, control=True)
def _recover(asked: Asked, args: OfServo) -> None:
    """End the protection of a servo from overload; without torque, until its fault is gone."""
    asked.known(args.servo)
    with asked.bus.bench.working(f"the recovery of servo {args.servo}"):
        left = servo_setup.recover(asked.bus.bus, args.servo)
    if left:
        raise ServoError(f"servo {args.servo} still reports {', '.join(left)}: remove the cause, try again")


@call("servos.middle", OfServo, control=True)
def _middle(asked: Asked, args: OfServo) -> int:
    """Make the present position the middle of the servo's turn; the counts that it reports here now."""
    asked.known(args.servo)
    with asked.bus.bench.working(f"the middle of servo {args.servo}", acts=True):
        return servo_setup.center(asked.bus.bus, args.servo)


def servos_of(asked: Asked) -> dict[str, Any]:
    """The servos that were found: those at the rate of the bus in full, the ids of others by their rate."""
    bus = asked.bus
    here = bus.bus.timing.baud
    elsewhere: dict[int, list[int]] = {}
    for row in bus.servos:
        if row.found.baud != here:
            elsewhere.setdefault(row.found.baud, []).append(row.found.servo_id)
    rates = [(0, f"{rate_words(here)} (now)"), (_ALL, "all rates")]
    return {
        "rates": [*rates, *((rate, f"{rate} baud") for rate in SERVO_RATES)],
        "rate": rate_words(here),
        "servos": [_servo(asked, row) for row in bus.servos if row.found.baud == here],
        "elsewhere": sorted(elsewhere.items()),
    }


def _servo(asked: Asked, row: Surveyed) -> dict[str, Any]:
    found, info = row.found, row.found.info
    firmware = info.firmware if info is not None else ""
    supply = row.kind
    # A setting whose read was not answered is not among them.
    if row.settings.keys() >= {"min_voltage", "max_voltage"}:
        low, high = row.settings["min_voltage"], row.settings["max_voltage"]
        supply = f"{row.kind or 'unknown'} (its limits: {low:.1f} to {high:.1f} V)"
    facts = (
        []
        if info is None
        else [
            ("Model", info.model_name or "not reported"),
            ("Series", info.series.title if info.series else "unknown"),
            ("Firmware", firmware or "not reported"),
            ("Voltage class", supply or "not reported"),
            ("Rate", f"{found.baud} baud"),
            ("Answers writes", "yes" if info.acknowledges else "no"),
        ]
    )
    return {
        "id": found.servo_id,
        "usable": found.servo_id in asked.bus.bench.servo_ids,
        "model": "?" if info is None else info.model_name or (info.series.value if info.series else "?"),
        "more": ", ".join(part for part in (f"fw {firmware}" if firmware else "", row.kind) if part),
        "level": "error" if row.bad else "warn" if row.remarks else "ok",
        "remarks": [{"text": remark.text, "bad": remark.bad} for remark in row.remarks],
        "facts": facts,
    }
