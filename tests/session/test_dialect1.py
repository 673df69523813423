"""Frames an old board survives, and answers known by servo id and length."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from itertools import product
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import LocalProtocolError
from hexwire.session.dialect1 import (
    MAX_PACKET,
    SHORT_FRAME_PACKET,
    UNKNOWN_COMMAND_PACKET,
    Pending1,
    match_reply,
)
from hexwire.session.frame_maker import clean_frame
from hexwire.wire import servo_packet as sp
from hexwire.wire.command_frame import Command, Frame, parse_frame, serialize_frame

READ = sp.make_read(0, 0x38, 2)
MARK = 0x0A0D
"""0D 0A as a little-endian number."""


def build(**changes: Any) -> tuple[Frame, bytes]:
    fields: dict[str, Any] = {
        "proto": 1, "cmd": 2, "body": READ, "seq": 1, "sn": 1, "src": 7, "dst": 8, "type": 3,
        "time_sec": 1752865499, "time_nsec": 5,
    }  # fmt: skip
    return clean_frame(Frame(**fields | changes), 253)


def marked(bits: int) -> st.SearchStrategy[int]:
    """Numbers of so many bits that hold 0D 0A somewhere, or the bytes next to it at an end."""
    return st.builds(
        lambda shift, rest, mark: ((mark << 8 * shift) | (rest & ~(0xFFFF << 8 * shift))) & (2**bits - 1),
        st.integers(0, bits // 8 - 1),
        st.integers(0, 2**bits - 1),
        st.sampled_from((MARK, 0x0D0D, 0x0A0A, 0x0D0A)),
    )


U32 = st.integers(0, 2**32 - 1) | marked(32)
NSEC = st.integers(0, 10**9) | marked(32).map(lambda n: n % (10**9 + 1))
PACKETS = st.builds(
    sp.make_packet, st.integers(0, 253), st.just(3), st.binary(max_size=40) | st.just(b"\x0d" * 5)
).filter(lambda packet: b"\r\n" not in packet)


@given(
    sec=U32,
    nsec=NSEC,
    sn=U32,
    seq=st.integers(0, 255),
    proto_cmd=st.sampled_from(((1, 1), (1, 2), (1, 3), (2, 0x10))),
    body=PACKETS,
    ids=st.sampled_from(((7, 8, 3), (0, 8, 3), (-1, 8, 0))),
)
def test_no_clock_and_no_count_can_put_the_marker_in(
    sec: int, nsec: int, sn: int, seq: int, proto_cmd: tuple[int, int], body: bytes, ids: tuple[int, int, int]
) -> None:
    (proto, cmd), (src, dst, kind) = proto_cmd, ids
    asked = Frame(
        proto=proto, cmd=cmd, body=body, seq=seq, sn=sn, src=src, dst=dst, type=kind, time_sec=sec, time_nsec=nsec
    )
    frame, data = clean_frame(asked, 253)
    assert b"\r\n" not in data[4:-2]
    assert parse_frame(data) == frame
    # Nothing but the clock and the count may differ from what was asked.
    assert frame == asked._replace(time_sec=frame.time_sec, time_nsec=frame.time_nsec, sn=frame.sn)
    plain = serialize_frame(asked)
    if b"\r\n" not in plain[4:-2]:
        assert data == plain
    assert abs(frame.time_nsec - nsec) <= 70_000
    if sec < 2**31:
        assert 0 <= sec - frame.time_sec <= 256 or b"\x0d\x0a" in sec.to_bytes(4, "little")[2:]


@pytest.mark.parametrize("low", [0, 0xFF, 0x1234, 0xFFFF])
@pytest.mark.parametrize("shift", [0, 8, 16])
def test_every_place_in_every_field(shift: int, low: int) -> None:
    value = (MARK << shift) | (low & ((1 << shift) - 1))
    for name in ("time_sec", "time_nsec", "sn"):
        frame, data = build(**{name: value})
        assert b"\r\n" not in data[4:-2], name
        moved = getattr(frame, name) - value
        # Nanoseconds by whole microseconds, the count forward, the clock never ahead.
        assert moved
        assert moved % 1000 == 0 if name == "time_nsec" else moved > 0 if name == "sn" else moved < 0


def test_the_clock_stands_still_rather_than_jump() -> None:
    times = [build(time_sec=(MARK << 8) + i)[0].time_sec for i in range(-2, 260)]
    assert times == sorted(times)
    assert max(b - a for a, b in itertools.pairwise(times)) <= 257


@pytest.mark.parametrize(
    ("sec", "nsec", "sn"),
    [(0x0D000001, 10, 1), (1, 0x0D000003, 0x1230A), (1, 0x0D000003, 0x0A), (1, 1, 0x0D00000A), (1, 999_999_754, 1)],
)
def test_the_marker_across_two_fields(sec: int, nsec: int, sn: int) -> None:
    assert b"\r\n" not in build(time_sec=sec, time_nsec=nsec, sn=sn)[1][4:-2]


def test_the_last_sn_wraps() -> None:
    frame, data = build(sn=0xFFFFFFFF)
    assert frame.sn == 0xFFFFFFFF
    assert build(sn=0x0A0D0A0D)[0].sn == sn_without(0x0A0D0A0D)
    assert b"\r\n" not in data[4:-2]


def sn_without(sn: int) -> int:
    while b"\r\n" in sn.to_bytes(4, "little"):
        sn += 1
    return sn


@pytest.mark.parametrize("changes", [{"body": b"\r\n"}, {"src": MARK}, {"dst": MARK << 8}, {"type": MARK}])
def test_what_is_not_free_is_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(LocalProtocolError, match="0D 0A"):
        build(**changes)


@pytest.mark.parametrize(
    ("cmd", "packet", "reason"),
    [
        (Command.IDENTIFY, READ, "IDENTIFY does not exist in dialect 1"),
        (Command.READ, b"", "servo packets only"),
        (Command.READ, READ[:-1] + b"\0", "servo packets only: checksum"),
        (Command.READ, sp.make_write(0, 0x2A, bytes(60)), f"{MAX_PACKET} is the most"),
        (Command.READ, sp.make_read(0, 0x38, 1), "a read of other than 2 bytes"),
        (Command.READ, sp.make_read(0, 0x38, 8), "a read of other than 2 bytes"),
        (Command.READ, sp.make_packet(0, 2), "a read of other than 2 bytes"),
        (Command.READ, sp.make_action(), "to all servos"),
        (Command.READ, sp.make_sync_read(0x38, 2, (4, 5)), "to all servos"),
        (Command.PING, sp.make_ping(0xFE), "to all servos"),
        (Command.PING, READ, "PING carries a ping only"),
        (Command.READ, sp.make_write(0, 0x2A, b"\r\n"), "0D 0A inside"),
        (Command.SYNC_WRITE, READ, "SYNC_WRITE carries a sync write only"),
        (
            Command.SYNC_WRITE,
            sp.make_sync_write(0x28, {0: b"\0"}),
            "writes 4 bytes at 0x2A per servo",
        ),
        (
            Command.SYNC_WRITE,
            sp.make_sync_write(0x30, {0: bytes(4)}),
            "writes 4 bytes at 0x2A per servo",
        ),
        (Command.SYNC_WRITE, sp.make_packet(0xFE, 0x83, b"\x2a\x04"), "for any sync write"),
        (Command.SYNC_WRITE, sp.make_sync_write(0x2A, {i: bytes(4) for i in range(41)}), "208 is the most"),
    ],
)
def test_requests_that_would_harm_an_old_board_are_refused(cmd: Command, packet: bytes, reason: str) -> None:
    with pytest.raises(LocalProtocolError, match=reason):
        Pending1(1, cmd, packet, 0.2, 3)


def pending(packet: bytes = READ, cmd: Command = Command.READ) -> Pending1:
    return Pending1(1, cmd, packet, 0.2, 3)


def test_the_longest_that_goes() -> None:
    assert pending(sp.make_write(0, 0x2A, bytes(56))).answered
    assert len(pending(sp.make_write(0, 0x2A, bytes(56))).body) == MAX_PACKET
    sync = sp.make_sync_write(0x2A, {i: bytes(4) for i in range(40)})
    assert len(sync) == 208
    assert not pending(sync, Command.SYNC_WRITE).answered


ANSWER = sp.make_status(0, 0, b"\x05\x08", legacy=True)
ANSWER_ON_THE_BUS = sp.make_status(0, 0, b"\x08\x05", legacy=True)


def as_sent(heard: bytes) -> bytes:
    """What the chapter's board makes of what it heard after a command 02 to a legacy servo."""
    return heard[:5] + heard[6:7] + heard[5:6] + heard[7:] if len(heard) > 6 else heard


WRITE = sp.make_write(4, 0x28, b"\1")


@pytest.mark.parametrize(
    ("request_", "body", "found"),
    [
        (READ, ANSWER, ANSWER),
        (READ, as_sent(READ + ANSWER_ON_THE_BUS), ANSWER),
        (READ, as_sent(b"\0\xff" + READ + ANSWER_ON_THE_BUS), ANSWER),
        (READ, b"\xff\xff\x00" + ANSWER + b"\0", None),  # a board that exchanges bytes would not send that
        (READ, sp.make_status(0, 0x20, b"\x05\x08"), sp.make_status(0, 0x20, b"\x05\x08")),
        # These are also the bytes of a read, but of none that was sent.
        (READ, sp.make_status(0, 0x02, b"\x05\x08"), sp.make_status(0, 0x02, b"\x05\x08")),
        (READ, sp.make_board_error(1, 0), sp.make_board_error(1, 0)),
        (READ, UNKNOWN_COMMAND_PACKET, UNKNOWN_COMMAND_PACKET),
        (READ, SHORT_FRAME_PACKET, SHORT_FRAME_PACKET),
        (READ, READ, None),  # an echo and nothing else, though it is a good status packet of servo 0
        (READ, sp.make_status(1, 0, b"\x05\x08", legacy=True), None),
        (READ, sp.make_status(0, 0, b"", legacy=True), None),
        (READ, sp.make_status(0, 0, bytes(3), legacy=True), None),
        (READ, ANSWER[:-1] + b"\0", None),
        (READ, ANSWER[:-1], None),
        (READ, sp.make_board_error(1, 3), None),
        (READ, sp.make_board_error(5, 0), None),
        (READ, b"", None),
        (WRITE, sp.make_status(4), sp.make_status(4)),
        (WRITE, WRITE + sp.make_status(4), sp.make_status(4)),
        (WRITE, sp.make_board_error(1, 4), sp.make_board_error(1, 4)),
        (WRITE, sp.make_status(4, 0, b"\0\0"), None),  # the late answer to a read
        (WRITE, sp.make_status(4, 1, b"\0\0"), None),
        (WRITE, sp.make_status(5), None),
        (sp.make_ping(2), sp.make_legacy_ping_status(2), sp.make_legacy_ping_status(2)),
        (sp.make_ping(2), sp.make_status(2, legacy=True), sp.make_status(2, legacy=True)),
        (sp.make_ping(2), sp.make_board_error(5, 2), sp.make_board_error(5, 2)),
        (sp.make_ping(2), sp.make_board_error(1, 2), None),
        (sp.make_ping(2), sp.make_legacy_ping_status(3), None),
    ],
)
def test_answers(request_: bytes, body: bytes, found: bytes | None) -> None:
    cmd = Command.PING if request_[4] == sp.Instruction.PING else Command.READ
    assert match_reply(body, pending(request_, cmd)) == found


@given(st.binary(max_size=80), st.sampled_from((READ, WRITE)))
def test_any_bytes_give_an_answer_of_the_right_servo_or_none(body: bytes, request_: bytes) -> None:
    found = match_reply(body, pending(request_))
    if found is not None and found not in (UNKNOWN_COMMAND_PACKET, SHORT_FRAME_PACKET):
        assert sp.parse_status(found).servo_id == request_[2]
        assert found in body or as_sent(found) in as_sent(body)


LEGACY_READ = bytes.fromhex("FF FF 00 04 02 38 02 BF")
SWAPPED_ECHO = bytes.fromhex("FF FF 00 04 02 02 38 BF")
BIG_ENDIAN = bytes.fromhex("FF F5 00 04 00 08 05 EE")
LITTLE_ENDIAN = bytes.fromhex("FF F5 00 04 00 05 08 EE")


def test_an_echo_with_two_bytes_exchanged_is_no_answer() -> None:
    # It is a well-formed status packet of the right id and length.
    assert match_reply(SWAPPED_ECHO, Pending1(1, Command.READ, LEGACY_READ, 0.2, 3)) is None


def test_behind_an_exchanged_echo_the_answer_is_still_big_endian() -> None:
    pending = Pending1(1, Command.READ, LEGACY_READ, 0.2, 3)
    assert match_reply(SWAPPED_ECHO + BIG_ENDIAN, pending) == LITTLE_ENDIAN
    assert match_reply(bytes(7) + BIG_ENDIAN, pending) == LITTLE_ENDIAN


def test_wherever_the_exchanged_bytes_lie_the_value_is_right() -> None:
    echoes = b"", LEGACY_READ, LEGACY_READ * 2
    for filler, junk, echo in product((b"\0", b"\xff", b"\xf5", b"\x04"), range(9), echoes):
        before = filler * junk + echo
        payload = as_sent(before + BIG_ENDIAN)
        assert match_reply(payload, Pending1(1, Command.READ, LEGACY_READ, 0.2, 3)) == LITTLE_ENDIAN, before
        assert match_reply(as_sent(before), Pending1(1, Command.READ, LEGACY_READ, 0.2, 3)) is None, before


def test_an_answer_followed_by_noise_is_accepted_the_second_time() -> None:
    pending = Pending1(1, Command.READ, LEGACY_READ, 0.2, 3)
    assert match_reply(LITTLE_ENDIAN + bytes(3), pending) is None
    assert match_reply(LITTLE_ENDIAN + bytes(3), pending) == LITTLE_ENDIAN
    other = as_sent(sp.make_status(0, 0, b"\x08\x06", legacy=True))
    assert match_reply(other + bytes(3), pending) is None


def test_two_answers_that_differ_are_none() -> None:
    late = sp.make_status(0, 0, b"\x01\x02", legacy=True)
    assert match_reply(as_sent(late + BIG_ENDIAN), Pending1(1, Command.READ, LEGACY_READ, 0.2, 3)) is None
    same = match_reply(as_sent(BIG_ENDIAN + BIG_ENDIAN), Pending1(1, Command.READ, LEGACY_READ, 0.2, 3))
    assert same == LITTLE_ENDIAN


@given(st.integers(0, 0xFFFF), st.binary(max_size=10), st.integers(0, 2), st.integers(0, 255))
def test_any_noise_before_an_echo_gives_the_value_or_none(
    value: int, noise: bytes, echoes: int, servo_id: int
) -> None:
    request = sp.make_read(servo_id % 4, 0x38, 2)
    answer = sp.make_status(servo_id % 4, 0, value.to_bytes(2, "big"), legacy=True)
    found = match_reply(as_sent(noise + request * echoes + answer), Pending1(1, Command.READ, request, 0.2, 3))
    assert found is None or sp.parse_status(found).params == value.to_bytes(2, "little")
    if b"\xff" not in noise:
        assert found is not None


@pytest.mark.parametrize(
    ("body", "check"),
    [(b"x\r", lambda check: check & 0xFF == 0x0A), (b"x", lambda check: check == MARK)],
    ids=["with the last byte of the body", "by itself"],
)
def test_a_check_that_makes_the_marker_is_made_another_by_the_clock(
    body: bytes, check: Callable[[int], bool]
) -> None:
    def stamped(nsec: int) -> Frame:
        return Frame(0, nsec, 1, 7, 8, 3, 2, 1, 0x10, body)

    end = 40 + len(body)
    nsec = next(
        n for n in range(10**6) if check(int.from_bytes(serialize_frame(stamped(n))[end : end + 2], "little"))
    )
    assert b"\r\n" in serialize_frame(stamped(nsec))[4:-2]
    frame, data = clean_frame(stamped(nsec), 253)
    assert b"\r\n" not in data[4:-2]
    assert frame == stamped(frame.time_nsec)
    assert 0 < frame.time_nsec - nsec <= 70_000
