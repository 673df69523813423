from __future__ import annotations

from hexwire.emulator.board_jobs import BusBuffer


def test_bytes_are_there_from_their_time_on_and_are_read_once() -> None:
    buffer = BusBuffer()
    buffer.put(b"ab", 1.0)
    buffer.put(b"c", 2.0)
    assert (buffer.waiting(0.9), buffer.read(0.9)) == (0, b"")
    assert (buffer.waiting(1.0), buffer.waiting(2.0)) == (2, 3)
    assert buffer.read(1.5) == b"ab"
    assert buffer.read(1.5) == b""
    assert (buffer.waiting(3.0), buffer.read(3.0)) == (1, b"c")
