"""Lines on which no board answers: the cause is named, in one line, with what to do."""

from __future__ import annotations

import pytest
from tests.drivers.test_bus_checkup import foreign, only
from tests.ipc.test_mistaken import board_link, bus_link

from hexwire.drivers.checkup import explain_no_board
from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.serve import BoardLink, FakeClock


def test_a_board_at_another_rate() -> None:
    link = board_link(board_rate=250_000)
    finding = only(explain_no_board(link))
    assert (finding.about, finding.text) == ("rate", "the board uses 250000 baud")
    assert finding.advice == "name it: --baud 250000"
    assert not link.is_open


@pytest.mark.parametrize("baud", [38_400, 1_000_000])
def test_servos_without_a_board(baud: int) -> None:
    finding = only(explain_no_board(bus_link((1, 2), baud=baud)))
    assert f"is a servo bus (servos 1, 2 answer at {baud} baud)" in finding.text


def test_a_device_that_sends_unasked() -> None:
    bus = foreign(chatter=b"$GPGGA,1\r\n")
    bus.close()
    finding = only(explain_no_board(bus.link))
    assert "bytes arrived unrequested, such as '$GPGGA,1'" in finding.text


def test_of_a_link_without_a_rate_no_more_is_known() -> None:
    clock = FakeClock()
    link = BoardLink(make_hex7bot_board(start=clock.time), clock)
    assert explain_no_board(link) == []
