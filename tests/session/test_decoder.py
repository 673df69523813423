"""The frame decoder: any split, any noise, any length; one outcome and a bounded buffer."""

from __future__ import annotations

import random
from collections.abc import Iterable

import pytest

from hexwire.session.decoder import FrameDecoder
from hexwire.session.events import BadFrame, Garbage
from hexwire.wire import tables
from hexwire.wire.command_frame import Frame, parse_frame, serialize_frame

SYNC = tables.SYNC_BYTES


def make(body: bytes = b"\xff\xff\x00\x04\x02\x38\x02\xbf", proto: int = 1, **changes: int) -> bytes:
    fields = {"cmd": 2, "seq": 1, "sn": 1, "src": 8, "dst": 0, "type": 8, "time_sec": 14, "time_nsec": 0} | changes
    return serialize_frame(Frame(proto=proto, body=body, **fields))  # type: ignore[arg-type]


def events(decoder: FrameDecoder) -> list[Frame | BadFrame | Garbage]:
    return list(iter(decoder.next_event, None))  # type: ignore[arg-type]


def feed(decoder: FrameDecoder, pieces: Iterable[bytes]) -> list[Frame | BadFrame | Garbage]:
    found = []
    for piece in pieces:
        decoder.receive(piece, 0.0)
        found += events(decoder)
    return found


@pytest.mark.parametrize("proto", [1, 2])
def test_frame_split_at_every_byte(proto: int) -> None:
    data = make(proto=proto)
    frame = parse_frame(data)
    for at in range(len(data) + 1):
        assert feed(FrameDecoder(), [data[:at], data[at:]]) == [frame]
    assert feed(FrameDecoder(), [data[i : i + 1] for i in range(len(data))]) == [frame]


def test_two_frames_in_one_read() -> None:
    one, two = make(), make(b"\0" * 7, proto=2, cmd=0x15)
    assert feed(FrameDecoder(), [one + two]) == [parse_frame(one), parse_frame(two)]
    # And one and a half.
    decoder = FrameDecoder()
    assert feed(decoder, [one + two[:20]]) == [parse_frame(one)]
    assert feed(decoder, [two[20:]]) == [parse_frame(two)]


@pytest.mark.parametrize(
    "prefix",
    [b"\0", b"boot: ok\r\n", SYNC[:3], SYNC[:2], SYNC[:1], bytes(range(256)), SYNC + b"\0" * 40, SYNC * 9],
)
def test_garbage_before_a_frame_is_one_event(prefix: bytes) -> None:
    data = make()
    decoder = FrameDecoder()
    assert feed(decoder, [prefix + data]) == [Garbage(len(prefix), prefix[:64]), parse_frame(data)]
    counters = decoder.counters
    assert (counters.frames, counters.bytes_dropped, counters.resyncs) == (1, len(prefix), 1)


def test_a_false_sync_three_bytes_early() -> None:
    data = make()
    for n in (1, 2, 3):
        assert feed(FrameDecoder(), [SYNC[:n] + data])[-1] == parse_frame(data)


def test_a_false_head_that_swallows_a_good_frame_is_bad_and_the_frame_survives() -> None:
    data = make()
    # A head with a size that fits, in front of a whole frame: its tail is in the wrong place.
    false = make(b"\0" * 60)[:40]
    decoder = FrameDecoder()
    found = feed(decoder, [false + data + b"\0" * 12])
    assert isinstance(found[0], BadFrame)
    assert found[0].reason.startswith("tail")
    assert parse_frame(data) in found


def test_nested_sync_words_in_a_body_are_data() -> None:
    inner = make()
    for outer in (make(inner + inner, proto=2), make(SYNC * 20, proto=1)):
        assert feed(FrameDecoder(), [outer]) == [parse_frame(outer)]


def test_a_frame_inside_a_frame_with_a_wrong_check_is_found() -> None:
    inner = make()
    outer = bytearray(make(inner, proto=2))
    outer[-4] ^= 1
    decoder = FrameDecoder()
    found = feed(decoder, [bytes(outer)])
    assert isinstance(found[0], BadFrame)
    assert found[0].reason.startswith("check")
    assert parse_frame(inner) in found
    assert (decoder.counters.bad_frames, decoder.counters.bad_checks) == (1, 1)


@pytest.mark.parametrize("size", [0, 31, 43, 51, 53, 254, 8192, 0x7FFFFFFF, 0xFFFFFFFF])
def test_a_size_that_cannot_be_costs_only_its_own_bytes(size: int) -> None:
    false = bytearray(make())
    false[28:32] = size.to_bytes(4, "little")
    good = make()
    decoder = FrameDecoder()
    found = feed(decoder, [bytes(false) + good])
    assert found[-1] == parse_frame(good)
    assert decoder.counters.bytes_dropped == len(false)
    assert decoder.next_timeout() is None


def test_0d_0a_anywhere_in_a_frame_is_data() -> None:
    data = make(b"\r\n" * 20, seq=0x0D, sn=0x0A0D0A0D, time_sec=0x0A0D0A0D, time_nsec=0x0D0A0D0A)
    assert data.count(b"\r\n") > 25
    for at in range(len(data)):
        assert feed(FrameDecoder(), [data[:at], data[at:]]) == [parse_frame(data)]


def test_an_unfinished_frame_is_given_up_after_silence() -> None:
    data = make()
    decoder = FrameDecoder()
    decoder.receive(data[:-1], 10.0)
    assert decoder.next_event() is None
    assert decoder.next_timeout() == 10.0 + tables.INTERBYTE_TIMEOUT
    assert decoder.handle_timeout(10.0) is None
    # A read that finds nothing does not put the end off.
    decoder.receive(b"", 10.04)
    assert decoder.next_event() is None
    assert decoder.next_timeout() == 10.05
    assert decoder.handle_timeout(10.05) == BadFrame("unfinished", data[:-1])
    assert events(decoder) == [Garbage(len(data) - 2, data[1:-1])]
    assert decoder.next_timeout() is None
    assert decoder.counters.bytes_dropped == len(data) - 1


def test_bytes_that_dribble_in_keep_a_frame_alive() -> None:
    data = make()
    decoder = FrameDecoder()
    for i in range(len(data)):
        assert decoder.handle_timeout(i * 0.049) is None
        decoder.receive(data[i : i + 1], i * 0.049)
        if i < len(data) - 1:
            assert decoder.next_event() is None
    assert decoder.next_event() == parse_frame(data)


def test_what_an_unfinished_frame_held_is_searched() -> None:
    inner = make()
    false = make(b"\0" * 200)[:40]
    decoder = FrameDecoder()
    decoder.receive(false + inner, 0.0)
    assert decoder.next_event() is None
    assert isinstance(decoder.handle_timeout(1.0), BadFrame)
    assert parse_frame(inner) in events(decoder)


def test_a_pile_of_unfinished_frames_ends_at_once() -> None:
    head = make(b"\0" * 200)[:40]
    decoder = FrameDecoder()
    decoder.receive(head * 6, 0.0)
    assert events(decoder) == []
    given_up = 0
    while decoder.handle_timeout(0.05) is not None:
        given_up += 1
        events(decoder)
        assert given_up <= 6
    assert given_up == 6
    assert decoder.next_timeout() is None


def test_part_of_a_sync_word_is_garbage_once_it_is_silent() -> None:
    decoder = FrameDecoder()
    decoder.receive(b"x" + SYNC[:2], 0.0)
    assert events(decoder) == [Garbage(1, b"x")]
    assert decoder.handle_timeout(0.05) == Garbage(2, SYNC[:2])
    assert decoder.next_timeout() is None


def test_end_of_message_leaves_nothing() -> None:
    data = make()
    for n in range(1, len(data)):
        decoder = FrameDecoder()
        decoder.receive(data[:n], 0.0)
        found = events(decoder)
        while (event := decoder.end_of_message()) is not None:
            found += [event, *events(decoder)]
        assert found
        assert not any(isinstance(event, Frame) for event in found)
        assert decoder.next_timeout() is None
        assert feed(decoder, [data]) == [parse_frame(data)]


def test_reset_forgets_what_is_held() -> None:
    data = make()
    decoder = FrameDecoder()
    decoder.receive(data[:30], 0.0)
    assert decoder.next_event() is None
    assert decoder.reset() == 30
    assert decoder.next_timeout() is None
    assert feed(decoder, [data]) == [parse_frame(data)]


def test_max_frame_bounds_what_is_believed() -> None:
    data = make(b"\0" * 300, proto=2)
    assert feed(FrameDecoder(8192), [data]) == [parse_frame(data)]
    assert feed(FrameDecoder(253), [data]) == [Garbage(len(data), data[:64])]


def test_a_caller_who_takes_nothing_costs_bounded_memory() -> None:
    decoder = FrameDecoder(max_buffer=1000)
    data = make()
    for _ in range(100):
        decoder.receive(data * 5, 0.0)
        assert len(decoder._data) <= 1000 + 5 * len(data)
    found = events(decoder)
    assert found[-1] == parse_frame(data)
    dropped = sum(event.count for event in found if isinstance(event, Garbage))
    assert decoder.counters.bytes_dropped == dropped
    assert dropped + 52 * decoder.counters.frames == decoder.counters.bytes_received


def test_one_long_read_is_not_cut() -> None:
    data = make()
    assert len(feed(FrameDecoder(max_buffer=1000), [data * 1000])) == 1000


def test_noise_of_megabytes_is_counted_to_the_byte() -> None:
    noise = random.Random(7).randbytes(2_000_000)
    decoder = FrameDecoder()
    found = feed(decoder, (noise[i : i + 997] for i in range(0, len(noise), 997)))
    assert decoder.reset() + sum(e.count for e in found if isinstance(e, Garbage)) == len(noise)


def test_sync_words_and_nothing_else() -> None:
    # Every candidate fails at its head: one event, not one for each.
    decoder = FrameDecoder()
    found = feed(decoder, [SYNC * 5000])
    assert len(found) == 1
    assert isinstance(found[0], Garbage)
    assert len(decoder._data) - decoder._pos <= 40


def test_a_mutable_buffer_may_be_reused_by_its_owner() -> None:
    data = make()
    buffer = bytearray(data)
    decoder = FrameDecoder()
    decoder.receive(buffer, 0.0)  # type: ignore[arg-type]  # a bytearray, as os.readv fills one
    buffer[:] = bytes(len(buffer))
    assert decoder.next_event() == parse_frame(data)


@pytest.mark.parametrize(
    "prefix",
    [
        SYNC * 20,
        SYNC * 15 + b"\1" * 100,
        b"x" * 62 + SYNC,
        b"x" * 63 + SYNC,
        b"x" * 64 + SYNC,
        b"x" * 65 + SYNC * 2,
    ],
)
def test_the_first_64_bytes_of_garbage_are_shown_in_however_many_pieces_it_is_found(prefix: bytes) -> None:
    decoder = FrameDecoder()
    assert feed(decoder, [prefix + make()]) == [Garbage(len(prefix), prefix[:64]), parse_frame(make())]
    assert decoder.counters.bytes_dropped == len(prefix)
    # And nothing of it is left for the next.
    assert feed(decoder, [b"y" + make()]) == [Garbage(1, b"y"), parse_frame(make())]
    assert (decoder.counters.resyncs, decoder.counters.frames) == (2, 2)


def test_a_bad_frame_shows_its_first_64_bytes() -> None:
    data = bytearray(make(bytes(range(100)), proto=2))
    data[-4] ^= 1
    found = feed(FrameDecoder(), [bytes(data)])
    assert isinstance(found[0], BadFrame)
    assert found[0].data == bytes(data[:64])
    assert found[1] == Garbage(len(data) - 1, bytes(data[1:65]))


def test_counters_to_the_byte() -> None:
    good, bad = make(), bytearray(make(proto=2))
    bad[-4] ^= 1
    tail = bytearray(make(proto=2))
    tail[-1] = 0
    decoder = FrameDecoder()
    feed(decoder, [b"xyz" + good + bytes(bad) + good, bytes(tail) + good])
    c = decoder.counters
    assert (c.bytes_received, c.frames, c.bad_frames, c.bad_checks, c.resyncs, c.bytes_dropped) == (
        3 + 5 * len(good), 3, 2, 1, 3, 3 + 2 * len(good),
    )  # fmt: skip


def test_what_is_over_the_buffer_is_dropped_from_the_front_and_reset_forgets_that_too() -> None:
    decoder = FrameDecoder(253, max_buffer=300)
    decoder.receive(bytes(400), 0.0)
    assert decoder.counters.bytes_dropped == 0, "one read is not cut"
    decoder.receive(b"x" * 50, 0.0)
    assert decoder.counters.bytes_dropped == 100
    assert len(decoder._data) == 350
    assert decoder.reset() == 350
    assert decoder.counters.bytes_dropped == 450
    assert decoder.next_event() is None
    assert feed(decoder, [b"y"]) == [Garbage(1, b"y")]


def test_the_buffer_is_never_smaller_than_a_frame() -> None:
    data = make(bytes(500), proto=2)
    decoder = FrameDecoder(8192, max_buffer=10)
    assert feed(decoder, [data[i : i + 1] for i in range(len(data))]) == [parse_frame(data)]


@pytest.mark.parametrize("kept", [1, 2, 3])
def test_the_beginning_of_a_sync_word_is_kept_and_no_more(kept: int) -> None:
    decoder = FrameDecoder()
    assert feed(decoder, [b"ab" + SYNC[:kept]]) == [Garbage(2, b"ab")]
    assert decoder.next_timeout() == pytest.approx(tables.INTERBYTE_TIMEOUT)
    assert feed(decoder, [make()[kept:]]) == [parse_frame(make())]
    assert decoder.next_timeout() is None
    decoder = FrameDecoder()
    assert feed(decoder, [SYNC[:kept], b"z"]) == [Garbage(kept + 1, SYNC[:kept] + b"z")]


def test_what_ends_a_message_says_so() -> None:
    data = make()
    decoder = FrameDecoder()
    assert decoder.end_of_message() is None
    decoder.receive(data[:-1], 0.0)
    decoder.next_event()
    assert decoder.end_of_message() == BadFrame("cut short", data[:-1])
    assert (decoder.counters.bad_frames, decoder.counters.bad_checks) == (1, 0)
