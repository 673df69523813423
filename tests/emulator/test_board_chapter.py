from __future__ import annotations

import pytest
from tests.emulator.boards import Bench
from tests.frames import frame_bytes

from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.serve import BoardLink, FakeClock
from hexwire.session.decoder import FrameDecoder
from hexwire.wire import servo_packet as sp
from hexwire.wire.command_frame import Command, Frame

# The chapter's log, the tails as they were before a port with ICRNL had its way with them.
LOG = [
    (
        """
        5A FA FA 5A DB 9A 7A 68 E0 4E 00 0D 2E 00 00 00 07 00 00 00 08 00 00 00 03 00 00 00 34 00 00 00
        82 01 2E 00 08 00 02 00 FF FF 06 04 02 3C 02 B5 14 22 0D 0A
        """,
        """
        5A FA FA 5A 0E 00 00 00 00 21 38 15 2D 00 00 00 08 00 00 00 00 00 00 00 08 00 00 00 34 00 00 00
        82 01 2D 00 08 00 02 00 FF FF 06 04 00 34 00 C1 FF FF 0D 0A
        """,
    ),
    (
        """
        5A FA FA 5A DB 9A 7A 68 08 B7 9E 10 2F 00 00 00 07 00 00 00 08 00 00 00 03 00 00 00 34 00 00 00
        82 01 2F 00 08 00 02 00 FF FF 00 04 02 38 02 BF 3D 86 0D 0A
        """,
        """
        5A FA FA 5A 0E 00 00 00 00 A8 CB 18 2E 00 00 00 08 00 00 00 00 00 00 00 08 00 00 00 34 00 00 00
        82 01 2E 00 08 00 02 00 FF F5 00 04 00 05 08 EE FF FF 0D 0A
        """,
    ),
]


def without_clock(data: bytes) -> bytes:
    return data[:4] + bytes(8) + data[12:]


@pytest.mark.parametrize("baud", [0, 115200])
@pytest.mark.parametrize("faults", [[], ["sketch"]])
def test_the_chapters_log_byte_for_byte(baud: int, faults: list[str]) -> None:
    board = make_hex7bot_board(dialect=1, baud=baud, faults=faults)
    board.connection.sn = 0x2C
    now = 14.0
    for request, reply in LOG:
        board.receive(bytes.fromhex(request), now)
        now += 0.06
        board.step(now)
        assert without_clock(board.data_to_send()) == without_clock(bytes.fromhex(reply))


def test_the_replies_clock_is_time_since_boot_in_milliseconds() -> None:
    bench = Bench(dialect=1, start=500.0)
    bench.now = 514.3567891
    bench.send(Command.PING, sp.make_ping(0), proto=1)
    (frame,) = bench.take()
    assert (frame.time_sec, frame.time_nsec) == (14, 356_000_000)


def test_a_dialect_1_board_says_unknown_to_identify() -> None:
    bench = Bench(dialect=1)
    bench.send(Command.IDENTIFY, proto=2)
    (frame,) = bench.take()
    assert (frame.proto, frame.cmd, frame.body) == (1, 2, bytes.fromhex("FF F5 FF 06 07 F3"))


def test_the_sketch_calls_a_frame_cut_in_its_header_short() -> None:
    bench = Bench(dialect=1, faults=["sketch"])
    data = bytearray.fromhex(LOG[0][0])
    data[8:10] = b"\r\n"
    bench.send_raw(bytes(data))
    (frame,) = bench.take()
    assert frame.body == bytes.fromhex("FF F5 FF 06 04 F6")


def test_a_board_without_the_sketch_cuts_by_size() -> None:
    bench = Bench(dialect=1)
    data = bytearray.fromhex(LOG[0][0])
    data[8:10] = b"\r\n"
    bench.send_raw(bytes(data))
    (frame,) = bench.take()
    assert frame.body == bytes.fromhex("FF FF 06 04 00 34 00 C1")


def round_trip(packet: bytes, cmd: int, faults: tuple[str, ...] = ()) -> float:
    """Milliseconds from the first byte of a request to the last of its answer, both lines at 115200."""
    clock = FakeClock(0.0)
    link = BoardLink(make_hex7bot_board(dialect=1, baud=115200, faults=faults), clock, baud=115200)
    link.open()
    decoder = FrameDecoder()
    clock.advance(1.0)
    start = clock()
    link.write(frame_bytes(cmd, packet, proto=1))
    while clock() < start + 1.0:
        decoder.receive(link.read(start + 1.0), clock())
        if isinstance(decoder.next_event(), Frame):
            return (clock() - start) * 1000
    raise AssertionError("no answer")


def test_delays_as_measured_on_the_simulated_chip() -> None:
    # Figures of the chapter's sketch on a simulated ATmega2560, servo return delay 250 us.
    assert round_trip(sp.make_read(0, 56, 2), Command.READ) == pytest.approx(35.85, abs=1.5)
    assert round_trip(sp.make_read(5, 56, 2), Command.READ) == pytest.approx(35.85, abs=1.5)
    assert round_trip(sp.make_read(3, 56, 2), Command.READ, ("silent:3",)) == pytest.approx(110.5, abs=3)
    assert round_trip(sp.make_ping(3), Command.PING, ("silent:3",)) == pytest.approx(49.2, abs=2)
    assert round_trip(sp.make_ping(0), Command.PING) == pytest.approx(31.5, abs=2)
    # A servo that needs more than 10 ms costs one poll of 20 ms more.
    assert round_trip(sp.make_read(2, 56, 2), Command.READ, ("late:2:0.011",)) == pytest.approx(55.9, abs=2)


def test_a_write_to_a_feetech_servo_through_command_02_works_and_takes_its_time() -> None:
    packet = sp.make_write(4, 0x28, b"\x01")
    assert round_trip(packet, Command.READ) == pytest.approx(112, abs=4)
    bench = Bench(dialect=1)
    assert bench.ask1(Command.READ, packet) == bytes.fromhex("FF FF 04 02 00 F9")
    assert bench.torques() == [False] * 4 + [True, False, False]


def test_a_one_byte_read_of_a_legacy_servo_has_value_and_checksum_exchanged() -> None:
    assert Bench(dialect=1).ask1(Command.READ, sp.make_read(1, 0x28, 1)) == bytes.fromhex("FF F5 01 03 00 FB 00")


def test_a_late_answer_goes_to_the_next_who_asks_as_the_sketch_never_drains() -> None:
    bench = Bench(dialect=1, baud=115200, faults=["late:1:0.3"])
    assert bench.ask1(Command.READ, sp.make_read(1, 56, 2))[4] == 1
    bench.run(0.3)
    first = bench.ask1(Command.READ, sp.make_read(0, 56, 2))
    assert first[2] == 1  # servo 1's old answer, and the host must see that


def test_the_chapters_sync_write_moves_legacy_servos_and_cannot_move_an_hls_servo() -> None:
    bench = Bench(dialect=1)
    rows = [(i, (2100).to_bytes(2, "little") + (0).to_bytes(2, "little")) for i in range(7)]
    bench.send(Command.SYNC_WRITE, sp.make_sync_write(0x2A, rows), proto=1)
    bench.run(1.5)
    assert bench.take() == []  # never answered
    positions = bench.true_positions()
    assert positions[:4] == pytest.approx([2100] * 4, abs=1)
    # The run time of 0 stands in its current ceiling.
    assert positions[4:] == pytest.approx([2083, 2046, 2047], abs=1)


def test_two_frames_back_to_back_get_one_reply_from_the_sketch() -> None:
    bench = Bench(dialect=1, baud=115200, faults=["sketch"])
    data = bytes.fromhex(LOG[1][0])
    bench.send_raw(data + data)
    bench.run(0.3)
    assert len(bench.take()) == 1
    calm = Bench(dialect=2, baud=115200)
    calm.run(0.2)
    calm.send_raw(data + data)
    calm.run(0.3)
    assert len(calm.take()) == 2


def test_a_command_of_more_than_63_bytes_hangs_the_sketch_until_reset() -> None:
    bench = Bench(dialect=1, faults=["sketch"])
    bench.send(Command.READ, bytes(64), proto=1)
    bench.send(Command.PING, sp.make_ping(0), proto=1)
    bench.run(0.5)
    assert bench.take() == []
    bench.board.reset(bench.now)
    assert bench.ask1(Command.PING, sp.make_ping(0)) == bytes.fromhex("FF F5 00 06 00 F9")


def test_behind_an_echoing_adapter_the_payload_is_echo_and_answer_and_the_swap_hits_the_echo() -> None:
    bench = Bench(dialect=1, baud=115200, faults=["echo"])
    legacy = bench.ask1(Command.READ, sp.make_read(0, 56, 2))
    assert legacy == bytes.fromhex("FF FF 00 04 02 02 38 BF FF F5 00 04 00 08 05 EE")
    hls = bench.ask1(Command.READ, sp.make_read(4, 56, 2))
    assert hls[:8] == sp.make_read(4, 56, 2)
    assert hls[8:] == bytes.fromhex("FF FF 04 04 00 23 08 CC")
