"""Is a controller board, or another robot, behind a link on which no servo answers?

Owns the search for it at the rate of boards. It leaves the link at the rate it had. Must not know joints.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hexwire.errors import DeviceError, WrongDeviceError

from .handle import IpcHandle
from .mistaken import find_robot, is_board
from .session import Session

if TYPE_CHECKING:
    from hexwire.link.base import Link
    from hexwire.session.negotiate import Negotiated

__all__ = ["BOARD_PATIENCE", "explain_no_servo", "find_board"]

BOARD_PATIENCE = 1.5
"""Seconds to wait for a board that the opening of its port may have reset."""


def find_board(link: Link, *, baud: int = 0, patience: float = BOARD_PATIENCE) -> Negotiated | None:
    """Search for a controller board.

    Args:
        link: An open link.
        baud: At which rate, where the link has one; 0 is the usual one of boards.
        patience: Seconds to go on asking.
    """
    # Here, since it needs termios: not every link is a serial one.
    from hexwire.link.serial_port import DEFAULT_BAUD

    set_baud = getattr(link, "set_baud", None)
    before = getattr(link, "baud", 0)
    if set_baud is not None:
        set_baud(baud or DEFAULT_BAUD)
    try:
        link.flush_input()
        session = Session(IpcHandle.from_link(link), clock=getattr(link, "clock", None))
        return session.negotiate(boot_window=patience, look=False)
    except DeviceError:
        return None
    finally:
        if set_baud is not None and before:
            set_baud(before)
        link.flush_input()


def explain_no_servo(link: Link) -> WrongDeviceError | None:
    """Search for what is there instead of servos.

    Args:
        link: An open link.

    Returns:
        The error that names it; None if nothing is found.
    """
    if not hasattr(link, "set_baud"):
        return find_robot(link, pings=True)
    board = find_board(link)
    return None if board is None else is_board(link.url, board)
