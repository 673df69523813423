"""Detects the wrong kind of device: a servo bus instead of a board, or a board instead of servos.

Owns a short search for servos on an open link on which no board answers, and the errors that name the device. It
restores the rate of the link. Must not know joints, nor its callers.

The search sends a few pings at the servos' factory rate. They are harmless: servos only answer them, and a board at
its own, slower rate receives a byte or two of noise per ping, outside any frame. It is only used on a silent line,
never with a board that answers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from time import monotonic
from typing import TYPE_CHECKING

from hexwire.errors import UsageError, WrongDeviceError
from hexwire.session.negotiate import Negotiated
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import BROADCAST_ID, iter_status, make_ping

if TYPE_CHECKING:
    from hexwire.link.base import Link

__all__ = ["find_servos", "is_board", "is_puma", "is_servo_bus"]

_SERVO_RATE = Series.STS_SMS.baud
_NEAR = 0.1
"""Share by which rates must differ so that a receiver gets no valid packet."""
_FIRST_IDS = range(9)
_MORE_IDS = range(9, 32)
_PING_TIME = 0.003
"""Seconds for one ping and its answer on the line: 0.12 ms of bytes at 1 Mbaud, and a return delay of 0.5 ms."""
_LAST_TIME = 0.035
"""Seconds for the last answers: an adapter with a latency timer delays them by 16 ms."""
_WRITE_TIME = 1.0


def find_servos(link: Link, *, baud: int = _SERVO_RATE) -> tuple[int, ...]:
    """Search for servos, by default at their factory rate, for a tenth of a second.

    Args:
        link: An open link.
        baud: The rate.

    Returns:
        Ids of servos that answered; empty if none did, or if the link's rate cannot be changed or is already this
        rate: then a board would receive the pings, and servos answer those in the board's frames.
    """
    set_baud = getattr(link, "set_baud", None)
    before = getattr(link, "baud", 0)
    if set_baud is None or not before or abs(before - baud) < _NEAR * baud:
        return ()
    try:
        set_baud(baud)
    except UsageError:
        return ()
    try:
        link.flush_input()
        found, heard = _ping(link, (BROADCAST_ID, *_FIRST_IDS))
        if not found and heard:
            # Something answers at this rate, perhaps several servos at the same time.
            found, _ = _ping(link, (BROADCAST_ID, *_MORE_IDS))
        return found
    finally:
        set_baud(before)
        link.flush_input()


def _ping(link: Link, ids: Iterable[int]) -> tuple[tuple[int, ...], bool]:
    """Ids that answered, and whether anything other than echoes arrived."""
    clock: Callable[[], float] = getattr(link, "clock", monotonic)
    data = b""
    pings = [make_ping(servo_id) for servo_id in ids]
    for ping in pings:
        link.write(ping, clock() + _WRITE_TIME)
        data += _listen(link, clock() + _PING_TIME, clock)
    data += _listen(link, clock() + _LAST_TIME, clock)
    if make_ping(BROADCAST_ID) in data:
        # No servo has that id, so the adapter echoes. Otherwise bytes equal to a ping are the answer of a servo
        # with a low supply.
        for ping in pings:
            data = data.replace(ping, b"", 1)
    found = {status.servo_id for status in iter_status(data) if not status.params}
    return tuple(sorted(found)), bool(data)


def _listen(link: Link, until: float, clock: Callable[[], float]) -> bytes:
    data = b""
    while True:
        more = link.read(until)
        data += more
        if not more or clock() >= until:
            return data


def is_servo_bus(url: str, servo_ids: Iterable[int], *, baud: int = 0) -> WrongDeviceError:
    """The error for a servo bus where a board is expected.

    Args:
        url: URL of the link.
        servo_ids: Ids of the servos that answered.
        baud: The rate, if it must be given on the command line; otherwise 0.
    """
    ids = sorted(servo_ids)
    who = f"servo {ids[0]} answers" if len(ids) == 1 else f"servos {', '.join(map(str, ids))} answer"
    at, robot, rate = (f" at {baud} baud", "robot and rate", f" --baud {baud}") if baud else ("", "robot", "")
    return WrongDeviceError(
        f"{url} is a servo bus ({who}{at}), not a board: name its {robot}, as in --robot so101{rate}, or try "
        f"`hexwire bus scan{rate}`"
    )


def is_board(url: str, board: Negotiated, wanted: str = "a servo bus") -> WrongDeviceError:
    """The error for a board where something else is expected, such as a servo bus."""
    firmware = f", firmware {'.'.join(map(str, board.identity.firmware))}" if board.identity else ""
    return WrongDeviceError(
        f"{url} is a controller board (dialect {board.dialect}{firmware}), not {wanted}: use --robot hex7bot, "
        "or `hexwire probe`"
    )


def is_puma(url: str, wanted: str) -> WrongDeviceError:
    """The error for the controller of a PUMA 260 where something else is expected."""
    return WrongDeviceError(f"{url} is a puma260, not {wanted}: use --robot puma260")
