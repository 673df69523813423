from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.emulator.boards import Bench

from hexwire.wire import servo_packet as sp
from hexwire.wire.command_frame import Command


@pytest.mark.parametrize("dialect", [1, 2])
def test_error_packets_of_both_boards(dialect: int) -> None:
    bench = Bench(dialect=dialect, faults=["silent:3", "silent:5"])
    assert bench.ask1(Command.PING, sp.make_ping(3)) == bytes.fromhex("FF F5 03 06 05 F1")
    assert bench.ask1(Command.PING, sp.make_ping(5)) == bytes.fromhex("FF F5 05 06 05 EF")
    assert bench.ask1(Command.READ, sp.make_read(5, 56, 2)) == bytes.fromhex("FF F5 05 04 01 00 00 F5")
    assert bench.ask1(Command.READ, sp.make_read(3, 56, 2)) == bytes.fromhex("FF F5 03 04 01 00 00 F7")
    for cmd in (0x00, 0x04, 0x10, 0x1B, 0xFF):
        assert bench.ask1(cmd, b"") == bytes.fromhex("FF F5 FF 06 07 F3")
    assert bench.ask1(Command.PING, sp.make_ping(0)) == bytes.fromhex("FF F5 00 06 00 F9")
    assert bench.ask1(Command.PING, sp.make_ping(4)) == bytes.fromhex("FF FF 04 02 00 F9")


def test_the_chapters_sync_write_looks_at_neither_register_nor_checksum_and_ends_at_an_unknown_id() -> None:
    rows = [(0, b"\x34\x08\x64\x00"), (9, b"\x34\x08\x64\x00"), (1, b"\x34\x08\x64\x00")]
    packet = bytearray(sp.make_sync_write(0x30, rows))
    packet[-1] ^= 0xFF
    for dialect, expected in ((1, 0x0834), (2, 2053)):
        bench = Bench(dialect=dialect)
        bench.send(Command.SYNC_WRITE, bytes(packet), proto=1)
        bench.run(1.0)
        assert bench.true_positions()[0] == pytest.approx(expected, abs=1)
        assert bench.true_positions()[1] == pytest.approx(2043, abs=1)


def test_hexwires_board_moves_every_series_by_the_chapters_sync_write_inside_the_limits() -> None:
    bench = Bench(dialect=2)
    rows = [(i, (2200).to_bytes(2, "little") + (300).to_bytes(2, "little")) for i in range(7)]
    bench.send(Command.SYNC_WRITE, sp.make_sync_write(0x2A, rows), proto=1)
    bench.run(2.0)
    assert bench.true_positions() == pytest.approx([2200] * 7, abs=2)
    assert all(flags & 0x40 for flags in bench.state().status)


def test_hexwires_board_stopped_lets_no_dialect_1_write_through() -> None:
    bench = Bench(dialect=2)
    assert bench.ask(Command.STOP, b"\0").status == 0
    rows = [(0, b"\x00\x09\x64\x00")]
    bench.send(Command.SYNC_WRITE, sp.make_sync_write(0x2A, rows), proto=1)
    no = bytes.fromhex("FF F5 04 04 01 00 00 F6")
    assert bench.ask1(Command.READ, sp.make_write(4, 0x28, b"\1")) == no
    assert bench.ask1(Command.READ, sp.make_write(4, 0x2A, b"\x00\x09")) == no
    bench.run(1.0)
    assert bench.torques() == [False] * 7
    assert bench.true_positions() == [2053, 2043, 2035, 2039, 2083, 2046, 2047]
    assert bench.ask1(Command.READ, sp.make_read(0, 56, 2)) == bytes.fromhex("FF F5 00 04 00 05 08 EE")


def test_hexwires_board_refuses_a_raw_target_outside_the_limits_in_dialect_1() -> None:
    bench = Bench(dialect=2)
    limits = b"\x07" + b"".join(
        (1900).to_bytes(2, "little") + (2200).to_bytes(2, "little") + b"\0\x10" for _ in range(7)
    )
    assert bench.ask(Command.LIMITS, limits).status == 0
    bench.ask1(Command.READ, sp.make_write(4, 0x2A, (3000).to_bytes(2, "little")))
    bench.run(1.0)
    assert bench.true_positions()[4] == 2083


def test_hexwires_board_verifies_the_answers_it_passes_on() -> None:
    bench = Bench(dialect=2, faults=["bus.flip:0.2"], seed=3)
    good = bytes.fromhex("FF F5 00 04 00 05 08 EE")
    silent = bytes.fromhex("FF F5 00 04 01 00 00 FA")
    answers = {bench.ask1(Command.READ, sp.make_read(0, 56, 2)) for _ in range(300)}
    assert answers == {good, silent}


@settings(max_examples=150, deadline=None)
@given(
    st.sampled_from([1, 2]),
    st.sampled_from([[], ["sketch"]]),
    st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=80), st.sampled_from([1, 2])), max_size=6),
)
def test_no_command_and_no_body_breaks_a_board(
    dialect: int, faults: list[str], commands: list[tuple[int, bytes, int]]
) -> None:
    bench = Bench(dialect=dialect, faults=faults)
    for cmd, body, proto in commands:
        if not (faults and (b"\r\n" in body or len(body) > 63)):
            bench.send(cmd, body, proto=proto)
        bench.run(0.01)
    bench.run(0.5)
    if faults and bench.board._sketch is not None and bench.board._sketch.hung:
        return
    bench.take()
    # A servo that was told to restart, or to be another, is not what this is about.
    assert bench.ask1(0x77, b"") == bytes.fromhex("FF F5 FF 06 07 F3")


@settings(max_examples=150, deadline=None)
@given(st.sampled_from([1, 2]), st.lists(st.binary(min_size=1, max_size=300), max_size=8))
def test_no_noise_breaks_a_board(dialect: int, noise: list[bytes]) -> None:
    bench = Bench(dialect=dialect)
    for data in noise:
        bench.board.receive(data, bench.now)
        bench.run(0.02)
    bench.run(0.3)
    bench.take()
    assert bench.ask1(0x77, b"") == bytes.fromhex("FF F5 FF 06 07 F3")
