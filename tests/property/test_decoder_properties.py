"""One sentence each about the decoder, for any bytes in any pieces."""

from __future__ import annotations

import itertools
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from hexwire.session.decoder import FrameDecoder
from hexwire.session.events import BadFrame, Garbage
from hexwire.wire.command_frame import Frame, parse_frame, serialize_frame
from hexwire.wire.tables import INTERBYTE_TIMEOUT, SYNC_BYTES

U32 = st.integers(0, 2**32 - 1)
BODIES = st.binary(max_size=60) | st.lists(
    st.sampled_from((SYNC_BYTES, b"\r\n", b"\xff\xff", b"\x82", b"\x02")), max_size=15
).map(b"".join)


@st.composite
def frames(draw: st.DrawFn) -> bytes:
    fields: dict[str, Any] = {name: draw(U32) for name in ("time_sec", "time_nsec", "sn")}
    module = st.sampled_from((-1, 0, 7, 8))
    return serialize_frame(
        Frame(
            proto=draw(st.sampled_from((1, 2))),
            cmd=draw(st.integers(0, 255)),
            cmd_ext=draw(st.sampled_from((0, 0x40, 0x80))),
            seq=draw(st.integers(0, 255)),
            body=draw(BODIES),
            src=draw(module),
            dst=draw(module),
            type=draw(module),
            **fields,
        )
    )


# Bytes that are hard: heads, parts of heads, heads with a size field of any kind.
HEADS = st.builds(
    lambda size, flag, proto, pad, length: (
        SYNC_BYTES + bytes(24) + size.to_bytes(4, "little") + bytes((flag, proto, 0, pad)) + length + b"\0\0"
    ),
    U32 | st.integers(0, 300),
    st.sampled_from((0x82, 0)),
    st.integers(0, 3),
    st.integers(0, 4),
    st.binary(min_size=2, max_size=2),
)
NOISE = (
    st.binary(max_size=120)
    | HEADS
    | st.lists(st.sampled_from((SYNC_BYTES, SYNC_BYTES[:2], b"\x82\x01", b"\0")), max_size=30).map(b"".join)
)


def pieces(data: bytes, cuts: list[int]) -> list[bytes]:
    places = sorted({min(cut, len(data)) for cut in cuts} | {0, len(data)})
    return [data[a:b] for a, b in itertools.pairwise(places)]


def decode(decoder: FrameDecoder, parts: list[bytes]) -> list[Frame | BadFrame | Garbage]:
    found: list[Frame | BadFrame | Garbage] = []
    for part in parts:
        decoder.receive(part, 0.0)
        found += iter(decoder.next_event, None)  # type: ignore[arg-type]
        assert len(decoder._data) - decoder._pos <= decoder.max_frame
    return found


@given(st.lists(frames(), max_size=6), st.lists(st.integers(0, 700)))
def test_good_frames_come_out_however_they_are_cut(good: list[bytes], cuts: list[int]) -> None:
    assert decode(FrameDecoder(), pieces(b"".join(good), cuts)) == [parse_frame(data) for data in good]


@given(st.lists(NOISE | frames(), max_size=8), st.lists(st.integers(0, 900)))
def test_the_cuts_never_change_what_is_found(parts: list[bytes], cuts: list[int]) -> None:
    data = b"".join(parts)
    whole, cut = FrameDecoder(), FrameDecoder()
    found_whole = [e for e in decode(whole, [data]) if not isinstance(e, Garbage)]
    found_cut = [e for e in decode(cut, pieces(data, cuts)) if not isinstance(e, Garbage)]
    # A bad frame shows the bytes that were there when it was judged; all else is equal.
    assert [(type(e), getattr(e, "reason", e)) for e in found_whole] == [
        (type(e), getattr(e, "reason", e)) for e in found_cut
    ]
    assert whole.counters.bytes_dropped == cut.counters.bytes_dropped


@given(st.lists(NOISE | frames(), max_size=8), st.lists(st.integers(0, 900)))
def test_every_byte_is_accounted_for(parts: list[bytes], cuts: list[int]) -> None:
    data = b"".join(parts)
    decoder = FrameDecoder()
    found = decode(decoder, pieces(data, cuts))
    counters = decoder.counters
    in_frames = sum(e.size for e in found if isinstance(e, Frame))
    in_garbage = sum(e.count for e in found if isinstance(e, Garbage))
    bad = sum(isinstance(e, BadFrame) for e in found)
    assert counters.bytes_received == len(data)
    assert counters.bytes_dropped == in_garbage + bad
    assert counters.bad_frames == bad
    assert in_frames + in_garbage + bad + decoder.reset() == len(data)


@given(NOISE, frames(), st.lists(st.integers(0, 300)))
def test_a_frame_after_noise_and_silence_is_found(noise: bytes, good: bytes, cuts: list[int]) -> None:
    decoder = FrameDecoder()
    decode(decoder, [noise])
    while (due := decoder.next_timeout()) is not None:
        assert due == INTERBYTE_TIMEOUT
        assert decoder.handle_timeout(due) is not None
        list(iter(decoder.next_event, None))
    assert decode(decoder, pieces(good, cuts)) == [parse_frame(good)]


@given(st.lists(NOISE, min_size=1, max_size=5))
def test_timeouts_make_progress_until_nothing_is_held(parts: list[bytes]) -> None:
    decoder = FrameDecoder()
    decode(decoder, parts)
    rounds = 0
    while (due := decoder.next_timeout()) is not None:
        held = len(decoder._data) - decoder._pos
        assert decoder.handle_timeout(due) is not None
        list(iter(decoder.next_event, None))
        assert len(decoder._data) - decoder._pos < held
        rounds += 1
    assert decoder._pos == len(decoder._data)


@given(frames(), st.integers(0, 10_000), st.integers(1, 255))
def test_one_damaged_byte_never_gives_another_dialect_2_frame(good: bytes, at: int, change: int) -> None:
    damaged = bytearray(good)
    damaged[at % len(good)] ^= change
    for event in decode(FrameDecoder(), [bytes(damaged)]):
        if isinstance(event, Frame) and event.proto == 2 and good[33] == 2:
            # Only a pad byte may be damaged unseen: it carries nothing.
            assert event == parse_frame(good)
