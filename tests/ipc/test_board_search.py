"""A board where servos were meant, in simulated time."""

from __future__ import annotations

import pytest
from tests.ipc.test_mistaken import BOARD_RATE, board_link, bus_link

from hexwire.ipc.board_search import find_board
from hexwire.ipc.mistaken import find_servos
from hexwire.session.negotiate import Negotiated


@pytest.mark.parametrize("dialect", [1, 2])
def test_a_board_is_found_from_another_rate(dialect: int) -> None:
    link = board_link(dialect=dialect, rate=1_000_000)
    link.open()
    found = find_board(link)
    assert isinstance(found, Negotiated)
    assert found.dialect == dialect
    assert link.baud == 1_000_000


@pytest.mark.parametrize("boot", [0.5, 1.2])
def test_a_board_that_boots_is_waited_for(boot: float) -> None:
    link = board_link(f"boot:{boot}", rate=1_000_000)
    link.open()
    assert find_board(link) is not None


def test_servos_are_no_board() -> None:
    link = bus_link((1, 2, 3), rate=1_000_000)
    link.open()
    assert find_board(link) is None
    assert link.baud == 1_000_000
    # And they are as they were.
    link.set_baud(BOARD_RATE)
    assert find_servos(link) == (1, 2, 3)
