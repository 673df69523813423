"""What a board goes on doing once it was told: its watchdog and its reports, which it forgets at a reset.

Owns these orders, and why the board has stopped where it has been made to forget that. Must not know sessions, nor
how a reset is noticed.
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
    """The orders of one attached board.

    Attributes:
        watchdog: Seconds and mode; None if it is off.
        report: Seconds between two reports and their fields; None if there are none.
        due: The board may have forgotten its orders; `give_back` gives them.
        given_back: Number of times that they were.
    """

    def __init__(self) -> None:
        self.watchdog: tuple[float, StopMode] | None = None
        self.report: tuple[float, int] | None = None
        self.due = False
        self.given_back = 0
        self._tripped = False

    def arm(self, board: Board, timeout: float, mode: StopMode) -> None:
        """Arm the board's watchdog, or switch it off with 0 s, and keep that as an order."""
        self._arm(board, timeout, mode)
        self.watchdog = (timeout, mode) if timeout else None

    def _arm(self, board: Board, timeout: float, mode: StopMode) -> None:
        """WATCHDOG; on older firmware it clears the flag that the watchdog has tripped, so that is read first."""
        if not board.keeps_trip:
            self.explain(board.read(FLAGS_ONLY))
            if self._tripped and not timeout:
                # The arm is stopped: let the flag tell others why. `resume` ends both.
                return
        board.watchdog(timeout, mode)

    def give_back(self, board: Board) -> None:
        """Give a board that forgot its orders all of them; call it again until it works.

        Raises:
            NotSupportedError: The board that came back can do none of this; there are no orders now.
            HexwireError: The board does not answer, or refuses.
        """
        watchdog, report = self.watchdog, self.report
        if (watchdog and not board.has_watchdog) or (report and not board.reports_states):
            self.watchdog = self.report = None
            self.due = False
            raise NotSupportedError(
                f"the board that came back speaks dialect {board.dialect}: it has no watchdog and no reports, and "
                "they are off now"
            )
        if watchdog:
            self._arm(board, *watchdog)
        if report:
            board.report(*report)
        self.due = False
        self.given_back += 1

    def explain(self, state: JointState) -> JointState:
        """The state with the cause of a stop, also where the board has been made to forget it."""
        self._tripped = state.stopped and (self._tripped or state.watchdog_tripped)
        return replace(state, watchdog_tripped=True) if self._tripped != state.watchdog_tripped else state

    def resumed(self) -> None:
        """The stop is ended, and with it its cause."""
        self._tripped = False
