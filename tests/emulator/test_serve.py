from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.emulator.loopback import Loopback

from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.serve import Arrivals, BoardLink, FakeClock, PacedLine, deliver
from hexwire.errors import (
    LinkBusyError,
    LinkClosedError,
    LinkLostError,
)
from hexwire.wire.command_frame import Command, Frame, serialize_frame

# --- PacedLine -------------------------------------------------------------------------------------------------


def test_who_sleeps_in_simulated_time_lets_it_pass() -> None:
    clock = FakeClock(5.0)
    clock.sleep(1.5)
    assert clock() == 6.5


def test_a_line_is_not_stopped_by_nothing() -> None:
    """A burst at another rate may be heard as no byte at all."""
    line = PacedLine(115200)
    line.put(b"", 0.0)
    line.put(b"here", 0.0)
    assert line.take(1.0) == b"here"


def test_a_paced_line_delivers_ten_bits_a_byte_exactly() -> None:
    line = PacedLine(115200)
    byte = 10 / 115200
    line.put(bytes(range(100)), 5.0)
    assert line.take(5.0) == b""
    assert line.take(5.0 + 0.999 * byte) == b""
    assert line.take(5.0 + byte) == b"\0"
    assert line.take(5.0 + 10.5 * byte) == bytes(range(1, 10))
    assert line.next_time() == pytest.approx(5.0 + 100 * byte)
    line.put(b"xy", 5.0 + 20 * byte)  # waits until the line is free
    assert line.take(5.0 + 100 * byte) == bytes(range(10, 100))
    assert line.take(5.0 + 101 * byte) == b"x"
    assert line.take(5.0 + 102 * byte) == b"y"
    assert line.next_time() is None


def test_what_was_put_in_together_can_be_taken_only_as_a_whole() -> None:
    line = PacedLine(115200)
    byte = 10 / 115200
    line.put(b"frame", 0.0)
    line.put(b"next", 0.0)
    assert line.take(4 * byte, whole=True) == b""
    assert line.take(5 * byte, whole=True) == b"frame"
    assert line.take(8 * byte, whole=True) == b""
    assert line.take(9 * byte, whole=True) == b"next"


def test_an_unpaced_line_costs_nothing_and_everything_can_be_taken() -> None:
    line = PacedLine(0)
    line.put(b"abc", 1.0)
    assert line.take(1.0) == b"abc"
    slow = PacedLine(9600)
    slow.put(b"abc", 1.0)
    assert slow.take(1.0, everything=True) == b"abc"


@given(
    st.lists(st.tuples(st.binary(min_size=1, max_size=50), st.floats(0, 0.01)), max_size=10),
    st.lists(st.floats(0, 0.005), max_size=40),
)
def test_a_paced_line_loses_nothing_and_is_never_early(puts: list[tuple[bytes, float]], takes: list[float]) -> None:
    line, now, got = PacedLine(115200), 0.0, b""
    for data, pause in puts:
        line.put(data, now)
        now += pause
    sent = b"".join(data for data, _ in puts)
    for pause in takes:
        now += pause
        got += line.take(now)
        assert len(got) <= now * 11520 + 1
    assert got + line.take(now + 10) == sent


def test_a_line_that_is_cut_keeps_what_came_first_and_is_free_after_it() -> None:
    line = PacedLine(10)
    line.put(b"abc", 0.0)
    line.put(b"def", 0.0)
    line.cut(4)
    line.put(b"g", 1.0)
    assert line.take(3.9) == b"abc"
    assert line.take(4.0) == b"d"
    assert line.take(4.9) == b""
    assert line.take(5.0) == b"g"
    line.cut(0)
    assert line.next_time() is None


# --- BoardLink -------------------------------------------------------------------------------------------------


def test_a_board_link_keeps_the_link_contract_in_simulated_time() -> None:
    clock = FakeClock()
    link = BoardLink(Loopback(), clock, baud=9600)
    with pytest.raises(LinkClosedError):
        link.read(clock() + 1)
    with link:
        with pytest.raises(LinkBusyError):
            link.open()
        begun = clock()
        assert link.read(begun + 2.5) == b""
        assert clock() == begun + 2.5
        link.write(b"hello")
        data = b""
        while len(data) < 5:
            data += link.read(clock() + 1)
        assert data == b"hello"
        assert clock() - begun - 2.5 == pytest.approx(10 * 10 / 9600, abs=0.003)
        link.wake()
        assert link.read(clock() + 1) == b""
        link.write(b"abc")
        link.read(clock() + 0.0035)
        clock.advance(1)
        link._run()
        assert link.flush_input() > 0
        link.lost = True
        with pytest.raises(LinkLostError):
            link.write(b"x")
        assert not link.is_open
        with pytest.raises(LinkLostError):
            link.open()


def test_reports_faster_than_the_line_are_left_out_not_queued() -> None:
    clock = FakeClock()
    board = make_hex7bot_board(start=clock())
    link = BoardLink(board, clock, baud=19200)
    link.open()
    body = (5).to_bytes(2, "little") + b"\x3f"
    frame = {"proto": 2, "seq": 1, "sn": 1, "src": 7, "dst": 8, "type": 3, "time_sec": 0, "time_nsec": 0}
    link.write(serialize_frame(Frame(cmd=Command.REPORT, body=body, **frame)))
    end = clock() + 20
    while clock() < end:
        link.read(end)
    assert len(link._to_host._queue) <= 2


# --- silence ---------------------------------------------------------------------------------------------------

WATCHDOG = 0.5


def ask(number: int, cmd: int = Command.IDENTIFY, body: bytes = b"") -> bytes:
    frame = Frame(proto=2, seq=number, sn=number, cmd=cmd, src=7, dst=8, type=3, time_sec=0, time_nsec=0, body=body)
    return serialize_frame(frame)


@pytest.mark.parametrize("baud", [0, 115200])
@given(
    silence=st.floats(0.0, 2.0),
    stall=st.floats(0.0, 2.0),
    late=st.floats(0.0, 3.0),
)
def test_an_emulated_board_waits_for_its_host_no_longer_than_a_real_one(
    baud: int, silence: float, stall: float, late: float
) -> None:
    """What came may have come at any time of a stall of the server; without one it is known when it came."""
    board, line, arrivals = make_hex7bot_board(start=0.0), PacedLine(baud), Arrivals()
    line.put(ask(1, Command.WATCHDOG, round(1000 * WATCHDOG).to_bytes(2, "little") + b"\0"), 0.0)
    fed = 0.1
    deliver(line, board, fed)
    board.step(fed)
    due = board.state.watchdog_due
    assert due is not None
    # The server waits for bytes, then does not run for a while, and then finds them.
    begun = fed
    arrivals.since(begun, 0.0, begun)
    found = begun + silence + stall
    earliest = arrivals.since(begun, silence, found)
    assert earliest == pytest.approx(found - stall if stall > 0.03 else found, abs=0.03)
    line.put(ask(2), earliest)
    now = found + (late if baud == 0 else 0.05)
    deliver(line, board, now)
    # A real board would have tripped even if they had come at the begin of the stall: so does this one.
    if earliest > due + 1e-6:
        assert board.state.watchdog_tripped
    if earliest < due - 0.01:
        assert not board.state.watchdog_tripped


def test_a_host_that_is_silent_in_simulated_time_trips_the_watchdog_however_the_time_passes() -> None:
    clock = FakeClock()
    board = make_hex7bot_board(start=clock())
    with BoardLink(board, clock) as link:
        link.write(ask(1, Command.WATCHDOG, round(1000 * WATCHDOG).to_bytes(2, "little") + b"\0"))
        clock.advance(WATCHDOG - 0.001)
        link.write(ask(2))
        assert not board.state.watchdog_tripped
        clock.advance(WATCHDOG + 0.001)
        link.write(ask(3))
        assert board.state.watchdog_tripped
