"""Is it the other kind of device? A servo bus where a board was meant, or a board where servos were meant.

Owns a short look for servos on an open link where no board answers, and the errors that say what is there. It
leaves the link at the rate it had. Must not know joints, nor who asks.

The look for servos is a few pings at their factory rate. They harm nobody: servos only answer them, and a board at
its own, slower rate hears a byte or two of noise a ping, outside any frame. It is for a line that is silent: a
board that speaks is never looked at like this.
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

__all__ = ["find_servos", "is_board", "is_servo_bus"]

_SERVO_RATE = Series.STS_SMS.baud
_NEAR = 0.1
"""Share by which rates must differ for a receiver to hear nothing sound."""
_FIRST_IDS = range(9)
_MORE_IDS = range(9, 32)
_PING_TIME = 0.003
"""Seconds for one ping and its answer on the line: 0.12 ms of bytes at 1 Mbaud, and a return delay of 0.5 ms."""
_LAST_TIME = 0.035
"""Seconds for the last answers: an adapter with a latency timer holds them back for 16 ms."""
_WRITE_TIME = 1.0


def find_servos(link: Link, *, baud: int = _SERVO_RATE) -> tuple[int, ...]:
    """Look for servos, by default at their factory rate, for a tenth of a second.

    Args:
        link: An open link.
        baud: At which rate.

    Returns:
        Ids of servos that answered; empty if none did, the link has no rate that could be changed, or has this very
        rate: there a board would hear the pings, and servos answer those in the board's frames.
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
            # Something is there at this rate: several servos that answer at once sound like this.
            found, _ = _ping(link, (BROADCAST_ID, *_MORE_IDS))
        return found
    finally:
        set_baud(before)
        link.flush_input()


def _ping(link: Link, ids: Iterable[int]) -> tuple[tuple[int, ...], bool]:
    """Ids that answered, and whether anything came but echoes."""
    clock: Callable[[], float] = getattr(link, "clock", monotonic)
    data = b""
    pings = [make_ping(servo_id) for servo_id in ids]
    for ping in pings:
        link.write(ping, clock() + _WRITE_TIME)
        data += _listen(link, clock() + _PING_TIME, clock)
    data += _listen(link, clock() + _LAST_TIME, clock)
    if make_ping(BROADCAST_ID) in data:
        # Nobody has that id: the adapter hears itself. Elsewhere what equals a ping is the answer of a servo with
        # a low supply.
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
    """The error of a board that is a servo bus.

    Args:
        url: Of the link.
        servo_ids: Who answered.
        baud: At which rate, where it has to be named; 0 where it goes without saying.
    """
    ids = sorted(servo_ids)
    who = f"servo {ids[0]} answers" if len(ids) == 1 else f"servos {', '.join(map(str, ids))} answer"
    at, robot, rate = (f" at {baud} baud", "robot and rate", f" --baud {baud}") if baud else ("", "robot", "")
    return WrongDeviceError(
        f"{url} is a servo bus ({who}{at}), not a board: name its {robot}, as in --robot so101{rate}, or look with "
        f"`hexwire bus scan{rate}`"
    )


def is_board(url: str, board: Negotiated) -> WrongDeviceError:
    """The error of a servo bus that is a board."""
    firmware = f", firmware {'.'.join(map(str, board.identity.firmware))}" if board.identity else ""
    return WrongDeviceError(
        f"{url} is a controller board (dialect {board.dialect}{firmware}), not a servo bus: use --robot hex7bot, "
        "or `hexwire probe`"
    )
