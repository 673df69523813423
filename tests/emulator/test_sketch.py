from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from tests.frames import frame_bytes

from hexwire.emulator.sketch import SketchFrame, SketchReceiver
from hexwire.wire import servo_packet as sp


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
