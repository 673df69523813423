"""Both boards are what the protocol says."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from tests.drivers.arms import Arm

from hexwire.drivers.base import StopMode
from hexwire.drivers.board import Board, BoardFacts
from hexwire.drivers.board1 import Board1
from hexwire.drivers.board2 import Board2
from hexwire.errors import NotSupportedError

MEMBERS = sorted(name for name in vars(Board) if not name.startswith("_"))


def board_of(dialect: int) -> tuple[Arm, Board]:
    arm = Arm(dialect)
    board = arm.driver._board
    assert board is not None
    return arm, board


@pytest.mark.parametrize("kind", [Board1, Board2])
def test_a_board_has_every_member_itself(kind: type[Board]) -> None:
    _, board = board_of(1 if kind is Board1 else 2)
    assert type(board) is kind
    assert [name for name in MEMBERS if not hasattr(board, name)] == []


def test_what_a_board_says_of_itself() -> None:
    _, one = board_of(1)
    assert (one.dialect, one.command_rate, one.has_watchdog, one.reports_states) == (1, 1.5, False, False)
    assert (one.keeps_stop, one.unprotected) == (False, "no watchdog, no limits on this board")
    assert one.facts() == BoardFacts("", None, (), False, False)
    _, two = board_of(2)
    assert (two.dialect, two.command_rate, two.has_watchdog, two.reports_states) == (2, 20.0, True, True)
    assert (two.keeps_stop, two.keeps_trip, two.unprotected) == (True, True, "")
    facts = two.facts()
    assert (facts.firmware, facts.stopped, facts.maintenance) == ("2.1.0", False, False)
    assert {"joint_move", "watchdog"} <= set(facts.capabilities)


@pytest.mark.parametrize("dialect", [1, 2])
def test_a_stop_is_a_fact_once_the_board_is_probed(dialect: int) -> None:
    _, board = board_of(dialect)
    with board._session.epochs.stopping():  # type: ignore[attr-defined]  # as the driver does
        board.stop(StopMode.HOLD)
    board.probe_joints()
    assert board.facts().stopped
    board.resume()
    board.probe_joints()
    assert not board.facts().stopped


@pytest.mark.parametrize(
    ("what", "call"),
    [
        ("REPORT", lambda board: board.report(0.1)),
        ("WATCHDOG", lambda board: board.watchdog(1.0, StopMode.HOLD)),
        ("MAINTENANCE", lambda board: board.maintenance(True)),
        ("LIMITS", lambda board: board.limits()),
        ("LIMITS", lambda board: board.store_limits(())),
        ("OFFSETS", lambda board: board.offsets()),
        ("OFFSETS", lambda board: board.store_offsets(())),
        ("ioctl 0x12", lambda board: board.command(0x12, b"")),
    ],
)
def test_requests_that_dialect_1_lacks_are_refused_and_nothing_is_sent(
    what: str, call: Callable[[Board], object]
) -> None:
    arm, board = board_of(1)
    said = len(arm.link.written)
    with pytest.raises(NotSupportedError, match=f"{what} needs a board with dialect 2"):
        call(board)
    assert len(arm.link.written) == said
