"""Standing orders of a board, its watchdog and its reports, which a reset of the board clears.

Owns these orders, and the cause of a stop where the board no longer knows it. Must not know sessions, nor how a
reset is detected.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from hexwire.errors import NotSupportedError

if TYPE_CHECKING:
    from hexwire.model.state import JointState

    from .board import Board
    from .values import StopMode

__all__ = ["FLAGS_ONLY", "BoardOrders"]

FLAGS_ONLY = 0
"""Fields of the shortest state: positions and the board's flags."""


class BoardOrders:
    """The standing orders of one attached board.

    Attributes:
        watchdog: Seconds and mode; None if it is off.
        report: Seconds between reports, and their fields; None if reports are off.
        due: The board may have lost its orders; `give_back` sends them again.
        given_back: Number of times that the orders were sent again.
    """

    def __init__(self) -> None:
        self.watchdog: tuple[float, StopMode] | None = None
        self.report: tuple[float, int] | None = None
        self.due = False
        self.given_back = 0
        self._tripped = False

    def arm(self, board: Board, timeout: float, mode: StopMode) -> None:
        """Arm the board's watchdog, or disarm it with 0 s, and keep that as an order."""
        self._arm(board, timeout, mode)
        self.watchdog = (timeout, mode) if timeout else None

    def _arm(self, board: Board, timeout: float, mode: StopMode) -> None:
        """Send WATCHDOG. On older firmware it clears the flag of a tripped watchdog, so read the flag first."""
        if not board.keeps_trip:
            self.explain(board.read(FLAGS_ONLY))
            if self._tripped and not timeout:
                # The arm is stopped: keep the flag, so that other programs see the cause. `resume` clears both.
                return
        board.watchdog(timeout, mode)

    def give_back(self, board: Board) -> None:
        """Send all orders to a board that lost them; call it again until it succeeds.

        Raises:
            NotSupportedError: The reconnected board does not support them; the orders are dropped.
            HexwireError: The board does not answer, or refuses.
        """
        watchdog, report = self.watchdog, self.report
        if (watchdog and not board.has_watchdog) or (report and not board.reports_states):
            self.watchdog = self.report = None
            self.due = False
            raise NotSupportedError(
                f"the reconnected board speaks dialect {board.dialect}, which has no watchdog and no reports: "
                "both are off now"
            )
        if watchdog:
            self._arm(board, *watchdog)
        if report:
            board.report(*report)
        self.due = False
        self.given_back += 1

    def explain(self, state: JointState) -> JointState:
        """Return the state with the cause of a stop, even if the board no longer knows it."""
        self._tripped = state.stopped and (self._tripped or state.watchdog_tripped)
        return replace(state, watchdog_tripped=True) if self._tripped != state.watchdog_tripped else state

    def resumed(self) -> None:
        """Forget the cause of a stop that has ended."""
        self._tripped = False
