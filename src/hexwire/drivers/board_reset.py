"""Warns before a link is opened whose board may move the arm by itself.

The chapter's sketch drives the arm to its middle pose whenever the board starts, and the opening of a port resets a
board. Nobody knows which firmware is there before the port is open, so the warning comes unless hexwire's firmware
has been seen there. Owns that warning, for drivers, commands and pages alike.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from hexwire.errors import HexwireError
from hexwire.link.open import build_link

from .stop_memory import CalmBoard

if TYPE_CHECKING:
    from hexwire.bus.servo_bus import ServoBus
    from hexwire.link.base import Link

__all__ = ["RESET_WARNING", "note_servos", "reset_hazard", "warn_of_reset"]

_log = logging.getLogger(__name__)

RESET_WARNING = (
    "opening it may reset the board, and the chapter's firmware then drives the arm to its middle pose: keep "
    "clear. 10 uF from RESET to GND prevents the reset; hexwire's firmware moves nothing"
)


def reset_hazard(url: str) -> str:
    """What a person must know before opening an address; empty if opening it moves nothing, or is no link.

    For pages, which are read before anything is opened.
    """
    try:
        link = build_link(url)
    except HexwireError:
        return ""
    return "" if CalmBoard(link).known else RESET_WARNING


def warn_of_reset(link: Link) -> bool:
    """Log a warning if opening a link may move the arm; returns whether it did.

    A port that is not there is not warned of: whoever tries it again asks again.
    """
    if CalmBoard(link).known:
        return False
    _log.warning("%s: %s", link.url, RESET_WARNING)
    return True


def note_servos(bus: ServoBus) -> None:
    """Remember that servos answer on a link themselves: there is no board that could move them."""
    if bus.counters.answers:
        CalmBoard(bus.link).note(calm=True)
