"""What was answered once is answered again, to a driver that does not know the difference."""

from __future__ import annotations

import pytest

from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.replay import RecordedTransfer, ReplayedBoard
from hexwire.emulator.serve import BoardLink, FakeClock
from hexwire.errors import CommandRefusedError, UsageError
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session
from hexwire.link.tap import Direction, Passed, TapLink
from hexwire.model.state import JointTarget


def recorded(dialect: int) -> tuple[list[RecordedTransfer], list[tuple[float, ...]]]:
    """Three states on the way of a move, with everything that went over the line."""
    clock = FakeClock()
    seen: list[RecordedTransfer] = []

    def watch(passed: Passed) -> None:
        seen.append(RecordedTransfer(passed.direction is Direction.SENT, passed.data, passed.time))

    link = BoardLink(make_hex7bot_board(dialect=dialect, start=clock.time), clock)
    states = []
    with Hex7BotDriver(Session(IpcHandle.from_link(TapLink(link, watch)))) as driver:
        driver.torque(True)
        driver.write(JointTarget.of({"J1": 0.2}, duration=1.0))
        for _ in range(3):
            clock.advance(0.3)
            states.append(driver.read().position)
    assert len(set(states)) == 3
    return seen, states


def replayed(transfers: list[RecordedTransfer]) -> tuple[Hex7BotDriver, ReplayedBoard]:
    clock = FakeClock(5000.0)
    board = ReplayedBoard(transfers, start=clock.time)
    return Hex7BotDriver(Session(IpcHandle.from_link(BoardLink(board, clock)))), board


def test_states_come_again_in_their_order_and_then_from_the_start() -> None:
    transfers, states = recorded(2)
    driver, board = replayed(transfers)
    with driver:
        # The move itself read the joints first.
        got = [driver.read().position for _ in range(8)]
    assert [p for p in got if p in states][:3] == states
    assert board.unknown == 0


def test_dialect_1_comes_again_too() -> None:
    transfers, states = recorded(1)
    driver, _ = replayed(transfers)
    with driver:
        assert driver.dialect == 1
        got = {driver.read().position[0] for _ in range(12)}
    assert {state[0] for state in states} <= got


def test_a_request_that_is_not_in_the_recording_is_refused_and_counted() -> None:
    transfers, _ = recorded(2)
    driver, board = replayed(transfers)
    with driver:
        driver.torque(True)
        with pytest.raises(CommandRefusedError, match="not supported"):
            driver.limits()
    assert board.unknown == 1


def test_reports_are_sent_again_at_their_pace() -> None:
    clock = FakeClock()
    seen: list[RecordedTransfer] = []
    link = BoardLink(make_hex7bot_board(start=clock.time), clock)
    tap = TapLink(link, lambda p: seen.append(RecordedTransfer(p.direction is Direction.SENT, p.data, p.time)))
    with Hex7BotDriver(Session(IpcHandle.from_link(tap))) as driver:
        stream = driver.stream(0.05)
        for _ in range(4):
            next(stream)
        stream.close()
    driver, _ = replayed(seen)
    with driver:
        start = driver.session.now()
        stream = driver.stream(0.05)
        for _ in range(8):
            next(stream)
        assert driver.session.now() - start == pytest.approx(0.35, abs=0.1)
        stream.close()


def test_traffic_without_an_answer_is_an_error() -> None:
    with pytest.raises(UsageError, match="contains no answered request"):
        ReplayedBoard([RecordedTransfer(True, b"noise", 0.0)])
    with pytest.raises(UsageError, match="contains no answered request"):
        ReplayedBoard([])
