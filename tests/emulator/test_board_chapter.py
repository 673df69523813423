from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.emulator.boards import Bench
from tests.frames import frame_bytes

from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.board_chapter import (
    SketchFrame,
    SketchReceiver,
    is_packet,
    no_answer,
    status_bytes,
    sync_write_rows,
)
from hexwire.emulator.serve import BoardLink, FakeClock
from hexwire.session.decoder import FrameDecoder
from hexwire.wire import servo_packet as sp
from hexwire.wire.command_frame import Command, Frame


def test_a_silent_servo() -> None:
    assert no_answer(3, ping=True) == bytes.fromhex("FF F5 03 06 05 F1")
    assert no_answer(5, ping=False) == bytes.fromhex("FF F5 05 04 01 00 00 F5")


@pytest.mark.parametrize(
    ("request_", "answer", "sent"),
    [
        (sp.make_ping(0), sp.StatusPacket(0, 0, b"", legacy=True), "FF F5 00 06 00 F9"),
        (sp.make_ping(4), sp.StatusPacket(4, 0, b"", legacy=False), "FF FF 04 02 00 F9"),
        (sp.make_read(0, 56, 2), sp.StatusPacket(0, 0, b"\x08\x05", legacy=True), "FF F5 00 04 00 05 08 EE"),
        (sp.make_read(4, 56, 2), sp.StatusPacket(4, 0, b"\x08\x05", legacy=False), "FF FF 04 04 00 08 05 EA"),
    ],
)
def test_an_answer(request_: bytes, answer: sp.StatusPacket, sent: str) -> None:
    assert status_bytes(sp.parse_packet(request_), answer) == bytes.fromhex(sent)


def test_rows_end_at_an_id_that_is_no_joint() -> None:
    rows = {0: b"\x34\x08\x64\x00", 1: b"\x35\x08\x65\x00", 7: b"\x00\x08\x00\x00", 2: b"\x00\x08\x00\x00"}
    packet = sp.make_sync_write(0x2A, rows)
    for verified in (True, False):
        assert sync_write_rows(packet, 7, verified=verified) == [(0, 0x834, 100), (1, 0x835, 101)]


def test_only_one_board_looks_at_register_and_checksum() -> None:
    elsewhere = sp.make_sync_write(0x30, {0: b"\x34\x08\x64\x00"})
    damaged = sp.make_sync_write(0x2A, {0: b"\x34\x08\x64\x00"})[:-1] + b"\0"
    for packet in (elsewhere, damaged):
        assert sync_write_rows(packet, 7, verified=False) == [(0, 0x834, 100)]
        assert sync_write_rows(packet, 7, verified=True) == []
    assert not is_packet(damaged)
    assert sync_write_rows(sp.make_ping(0), 7, verified=False) == []


def frame(cmd: int = 2, body: bytes = b"", nsec: int = 0) -> bytes:
    return frame_bytes(cmd, body, proto=1, time_nsec=nsec)


def frames_of(receiver: SketchReceiver, data: bytes) -> list[SketchFrame]:
    receiver.put(data, busy=False)
    found = []
    while (one := receiver.next_frame()) is not None:
        found.append(one)
        receiver.put(b"", busy=False)
    return found


def test_a_clean_frame_is_taken_as_it_is() -> None:
    body = sp.make_read(6, 0x3C, 2)
    (one,) = frames_of(SketchReceiver(), b"noise" + frame(2, body))
    assert (one.cmd, one.body, one.length, one.short, one.hangs) == (2, body, 52, False, False)


def test_0d_0a_in_the_header_makes_a_short_frame_and_leaves_the_rest_as_noise() -> None:
    receiver = SketchReceiver()
    (one,) = frames_of(receiver, frame(2, sp.make_ping(0), nsec=0x0A0D))
    assert one.short
    assert receiver.waiting == 0


def test_0d_0a_in_the_body_executes_the_half_with_stale_bytes() -> None:
    receiver = SketchReceiver()
    old = sp.make_sync_write(0x2A, dict.fromkeys(range(7), b'\x11"3D'))
    frames_of(receiver, frame(3, old))
    new = sp.make_sync_write(0x2A, {0: b"\x55\x66\x77\x00", 1: b"\x0d\x0a\x77\x00", 2: b"\x55\x66\x77\x00"})
    (one,) = frames_of(receiver, frame(3, new))
    assert one.body[7:12] == b"\x00\x55\x66\x77\x00"
    assert one.body[17:22] == b"\x02\x11\x22\x33\x44"


def test_a_full_buffer_hangs_it_for_ever() -> None:
    receiver = SketchReceiver()
    assert frames_of(receiver, b"\x5a\xfa\xfa\x5a" + bytes(250)) == []
    assert receiver.hung
    assert frames_of(receiver, frame()) == []


def test_a_long_packet_would_hang_it() -> None:
    (one,) = frames_of(SketchReceiver(), frame(2, bytes(64)))
    assert one.hangs
    (one,) = frames_of(SketchReceiver(), frame(3, bytes(64)))
    assert not one.hangs


def test_while_it_is_busy_the_ring_holds_63_bytes() -> None:
    receiver = SketchReceiver()
    receiver.put(frame(3, bytes(44)), busy=True)
    assert (receiver.waiting, receiver.lost) == (63, 88 - 63)
    assert receiver.next_frame() is None


def test_what_came_behind_a_frame_waits_in_the_ring() -> None:
    receiver = SketchReceiver()
    receiver.put(frame() + frame(3, bytes(60)), busy=False)
    assert receiver.next_frame() is not None
    assert receiver.waiting == 63
    assert receiver.lost == 104 - 63


@given(st.lists(st.binary(max_size=120), max_size=20), st.booleans())
def test_any_bytes_in_any_pieces_are_bounded_and_raise_nothing(pieces: list[bytes], busy: bool) -> None:
    receiver = SketchReceiver()
    for piece in pieces:
        receiver.put(piece, busy=busy)
        if busy:
            assert receiver.waiting <= 63
        while (one := receiver.next_frame()) is not None:
            assert len(one.data) == 254
            assert one.length <= 254
            assert isinstance(one.body, bytes)


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
