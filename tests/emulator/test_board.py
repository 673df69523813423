from __future__ import annotations

import pytest
from tests.emulator.boards import Bench, u16

from hexwire.emulator.board import EmulatedBoard, make_hex7bot_board
from hexwire.emulator.servo_wire import ServoWire
from hexwire.wire import servo_packet as sp
from hexwire.wire import tables
from hexwire.wire.command_frame import Command
from hexwire.wire.commands import Identity


@pytest.mark.parametrize("dialect", [1, 2])
@pytest.mark.parametrize("baud", [pytest.param(0, marks=pytest.mark.slow), 115200])
def test_the_same_however_time_is_cut(dialect: int, baud: int) -> None:
    def story(slice: float) -> list[tuple[int, bytes]]:
        bench = Bench(dialect=dialect, baud=baud, faults=["bus.flip:0.02", "late:5:0.01:0.1"])
        bench.run(0.3, slice=slice)
        heard = []
        for i in range(25):
            bench.send(Command.READ, sp.make_read(i % 7, 56, 2), proto=1)
            if dialect == 2:
                bench.send(Command.TORQUE, bytes((1, 1 << i % 7, 0)))
                bench.send(Command.JOINT_MOVE, u16(300) + b"\1" + bytes((i % 7,)) + u16(2000 + 10 * i))
            bench.run(0.2, slice=slice)
            heard += [(f.cmd, f.body) for f in bench.take()]
        return heard

    whole = story(1e9)
    assert len(whole) >= 25
    assert story(0.0005) == whole


def test_every_reset_has_a_boot_id_of_its_own_and_so_has_every_start() -> None:
    ids = []
    for start in (0.0, 5.0):
        bench = Bench(start=start)
        bench.now = start
        for _ in range(3):
            ids.append(Identity.parse(bench.ask(Command.IDENTIFY).body).boot_id)
            bench.board.reset(bench.now)
    assert len(set(ids)) == 6


def test_a_reset_forgets_stop_watchdog_reports_and_what_was_queued_and_moves_nothing() -> None:
    bench = Bench(baud=115200)
    bench.run(0.2)
    bench.ask(Command.STOP, b"\1")
    bench.ask(Command.WATCHDOG, u16(100) + b"\1")
    bench.ask(Command.REPORT, u16(10) + b"\0")
    bench.send(Command.STATS)
    bench.take()
    positions = bench.true_positions()
    bench.board.reset(bench.now)
    bench.run(2.0)
    assert bench.take() == []
    state = bench.state()
    assert not state.board_flags & (tables.BOARD_FLAGS_STOPPED | tables.BOARD_FLAGS_WATCHDOG_TRIPPED)
    assert bench.true_positions() == positions


def test_the_reset_fault_restarts_the_board_in_time() -> None:
    bench = Bench(faults=["reset:2"])
    bench.run(1.0)
    before = Identity.parse(bench.ask(Command.IDENTIFY).body).boot_id
    bench.run(1.5)
    reply = bench.ask(Command.IDENTIFY)
    identity = Identity.parse(reply.body)
    assert identity.boot_id != before
    assert reply.time_sec == 0
    assert not identity.board_flags & tables.BOARD_FLAGS_UNDER_VOLTAGE_RESET


def test_a_brown_out_takes_torque_and_answers_and_says_so() -> None:
    bench = Bench(baud=115200, faults=["brownout:2:0.5"])
    bench.run(0.5)
    bench.torque()
    bench.run(1.6)
    bench.send(Command.IDENTIFY)
    bench.run(0.2)
    assert bench.take() == []
    bench.run(1.0)
    identity = Identity.parse(bench.ask(Command.IDENTIFY).body)
    assert identity.board_flags & tables.BOARD_FLAGS_UNDER_VOLTAGE_RESET
    assert bench.state(0).status == (0,) * 7
    assert bench.torques() == [False] * 7


def test_a_booting_board_is_deaf() -> None:
    bench = Bench(faults=["boot:1.5"])
    bench.send(Command.IDENTIFY)
    bench.run(1.4)
    assert bench.take() == []
    bench.run(0.2)
    assert bench.ask(Command.IDENTIFY).status == 0


def test_an_echo_on_the_host_line_comes_first() -> None:
    board = make_hex7bot_board(dialect=1, faults=["host.echo"])
    bench = Bench(board)
    packet = sp.make_ping(0)
    bench.send(Command.PING, packet, proto=1)
    first, second = bench.take()
    assert first.body == packet
    assert second.body == bytes.fromhex("FF F5 00 06 00 F9")


def test_a_longer_frame_than_the_board_takes_is_not_acted_on() -> None:
    board = EmulatedBoard(ServoWire([]), max_frame=128)
    bench = Bench(board)
    bench.send(Command.TRANSACT, bytes(100))
    bench.run(0.2)
    assert bench.take() == []
    assert bench.ask(Command.STATS).status == 0


def test_a_body_in_fragments_is_put_together_and_answered_in_fragments() -> None:
    board = EmulatedBoard(make_hex7bot_board().wire, max_frame=128)
    from hexwire.session.connection import Connection, Role
    from hexwire.session.events import Reply
    from hexwire.wire.commands import LimitRow, LimitTable

    host = Connection(Role.HOST, local=7, remote=8, type=3, max_frame=96)
    rows = tuple(LimitRow(10 + i, 4000, 500) for i in range(7))
    host.request(Command.LIMITS, LimitTable.serialize_request(rows), 0.0)
    replies = []
    now = 0.0
    while not replies and now < 2:
        for data in host.data_to_send():
            board.receive(data, now)
        now += 0.01
        board.step(now)
        host.receive(board.data_to_send(), now)
        host.handle_timeout(now)
        while (event := host.next_event()) is not None:
            replies += [event] if isinstance(event, Reply) else []
    assert LimitTable.parse(replies[0].body).rows == rows


def test_replies_are_stamped_with_the_boards_own_clock() -> None:
    board = make_hex7bot_board(start=50.0)
    bench = Bench(board)
    bench.now = 53.25
    seq = bench.send(Command.STATS)
    frame = bench.wait(Command.STATS, seq)
    assert (frame.time_sec, frame.time_nsec) == (3, 250_000_000)
    assert (frame.src, frame.dst, frame.type, frame.proto) == (8, 7, 8, 2)


def test_nothing_to_do_means_no_next_event() -> None:
    board = make_hex7bot_board()
    board.step(1.0)
    assert board.next_event_time() is None
