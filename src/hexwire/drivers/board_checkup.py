"""Diagnosis of a port where no board answers: each cause in one line, with what to do.

Owns the order of the checks: a device that sends unrequested data, a board at another rate, servos without a board.
Sends only requests that read; nothing is written and nothing moves. Must not know which ports exist.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hexwire.errors import NotSupportedError, UsageError
from hexwire.ipc.board_search import find_board
from hexwire.ipc.mistaken import find_servos, is_servo_bus
from hexwire.link.diagnose import Finding, Level

from .bus_checkup import SERVO_RATES, explain_chatter
from .firmware import HOST_RATES

if TYPE_CHECKING:
    from hexwire.link.base import Link

__all__ = ["explain_no_board"]

_BOARD_RATES = (57_600, *HOST_RATES[1:])
_PATIENCE = 0.6
"""Seconds to wait for an answer at each rate."""


def explain_no_board(link: Link) -> list[Finding]:
    """Find out why no board answers; returns one finding, or none if no cause is found.

    Args:
        link: A closed link; it is opened for this and closed again.

    Raises:
        LinkError: It cannot be opened.
    """
    if not hasattr(link, "set_baud"):
        return []
    with link:
        chatter = explain_chatter(link)
        if chatter is not None:
            return [chatter]
        for baud in _BOARD_RATES:
            try:
                board = find_board(link, baud=baud, patience=_PATIENCE)
            except (UsageError, NotSupportedError):
                continue
            if board is not None:
                text = f"the board uses {baud} baud"
                return [Finding(Level.BAD, "rate", text, f"name it: --baud {baud}")]
        for baud in SERVO_RATES:
            servo_ids = find_servos(link, baud=baud)
            if servo_ids:
                return [Finding(Level.BAD, "device", str(is_servo_bus(link.url, servo_ids, baud=baud)))]
    return []
