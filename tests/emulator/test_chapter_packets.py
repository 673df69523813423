from __future__ import annotations

import pytest

from hexwire.emulator.chapter_packets import is_packet, no_answer, status_bytes, sync_write_rows
from hexwire.wire import servo_packet as sp


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
