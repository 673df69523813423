"""Whole frames of both dialects: layout, round trips, and what makes a frame bad."""

from __future__ import annotations

import struct
import tomllib
from binascii import crc_hqx
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import LocalProtocolError, RemoteProtocolError
from hexwire.wire import tables
from hexwire.wire.command_frame import (
    Command,
    Frame,
    Status,
    command_name,
    examine,
    max_body,
    parse_frame,
    serialize_frame,
    status_name,
)

U8, U32 = st.integers(0, 255), st.integers(0, 2**32 - 1)
I32 = st.integers(-(2**31), 2**31 - 1)
BODIES = st.binary(max_size=300) | st.integers(0, 150).map(lambda n: b"\r\n" * n)
FRAMES = st.builds(Frame, U32, U32, U32, I32, I32, I32, st.sampled_from((1, 2)), U8, U8, BODIES, U8)
HEADER: dict[str, Any] = tomllib.loads((Path(__file__).parents[2] / "schema/session.toml").read_text())["header"]


def make(**changes: Any) -> bytes:
    fields: dict[str, Any] = {
        "proto": 2, "cmd": 0x15, "body": b"\0", "seq": 9, "sn": 1, "src": 7, "dst": 8, "type": 3, "time_sec": 0,
        "time_nsec": 0,
    }  # fmt: skip
    return serialize_frame(Frame(**fields | changes))


@given(FRAMES)
def test_round_trip_and_layout(frame: Frame) -> None:
    data = serialize_frame(frame)
    assert parse_frame(data) == frame
    n = len(frame.body)
    pad = -n % 4
    assert len(data) == frame.size == 44 + n + pad
    assert data[32:36] == bytes((0x82, frame.proto, frame.seq, pad))
    assert struct.unpack_from("<HBB", data, 36) == (n, frame.cmd, frame.cmd_ext)
    assert data[42 + n :] == b"\xaa" * pad + b"\r\n"
    crc = crc_hqx(data[: 40 + n], 0xFFFF)
    check = 0xFFFF if frame.proto == 1 else crc % 0xFFFF
    assert struct.unpack_from("<H", data, 40 + n)[0] == check


@given(FRAMES)
def test_every_field_of_the_header_is_where_the_schema_puts_it(frame: Frame) -> None:
    data = serialize_frame(frame)
    codes = {"u32": "<I", "i32": "<i"}
    for name, kind, offset in HEADER["fields"]:
        value = HEADER["sync"] if name == "sync" else getattr(frame, name)
        assert struct.unpack_from(codes[kind], data, offset)[0] == value, name
    assert offset + 4 == HEADER["size"] == 32


def test_sync_bytes_read_the_same_from_both_ends() -> None:
    assert bytes.fromhex("5AFAFA5A") == tables.SYNC_BYTES == tables.SYNC_BYTES[::-1]


def test_a_billion_nanoseconds_are_one_more_second() -> None:
    # The chapter's board sends them now and then.
    assert parse_frame(make(time_sec=14, time_nsec=1_000_000_000)).time == 15.0
    assert parse_frame(make(time_sec=14, time_nsec=356_000_000)).time == pytest.approx(14.356)


@given(FRAMES)
def test_the_log_line_of_any_frame_is_one_line(frame: Frame) -> None:
    text = str(frame)
    assert "\n" not in text
    assert f"dialect {frame.proto}" in text


@given(FRAMES.filter(lambda f: f.proto == 2), st.data())
def test_any_flipped_bit_of_dialect_2_is_noticed(value: Frame, data: st.DataObject) -> None:
    frame = bytearray(serialize_frame(value))
    pad = -len(value.body) % 4
    # The pad bytes carry nothing and are not looked at.
    places = [i for i in range(len(frame)) if not len(frame) - 2 - pad <= i < len(frame) - 2]
    at = data.draw(st.sampled_from(places))
    bit = data.draw(st.integers(0, 7))
    frame[at] ^= 1 << bit
    with pytest.raises(RemoteProtocolError):
        parse_frame(bytes(frame))


@given(FRAMES, st.binary(max_size=4))
def test_cut_anywhere_it_asks_for_more(frame: Frame, more: bytes) -> None:
    data = serialize_frame(frame)
    for n in {0, 3, 4, 31, 39, 40, len(data) // 2, len(data) - 1}:
        if n >= len(data):
            continue
        with pytest.raises(RemoteProtocolError):
            parse_frame(data[:n])
    if more:
        with pytest.raises(RemoteProtocolError, match=f"{len(more)} bytes after"):
            parse_frame(data + more)


def test_flipping_dialect_2_to_1_needs_two_bits() -> None:
    assert bin(tables.PROTO_CHAPTER ^ tables.PROTO_HEXWIRE).count("1") == 2


def test_a_crc_of_ffff_is_sent_as_0000_and_only_so_accepted() -> None:
    nsec = next(n for n in range(10**6) if _crc_of(make(cmd=0x1B, body=b"", time_nsec=n)) == 0xFFFF)
    data = make(cmd=0x1B, body=b"", time_nsec=nsec)
    assert data[40:42] == b"\0\0"
    assert parse_frame(data).time_nsec == nsec
    with pytest.raises(RemoteProtocolError, match="check is FFFF, not 0000"):
        parse_frame(data[:40] + b"\xff\xff" + data[42:])
    # And 0000 is not a way round the check of any other frame.
    other = make(cmd=0x1B, body=b"", time_nsec=nsec + 1)
    with pytest.raises(RemoteProtocolError, match="check is 0000"):
        parse_frame(other[:40] + b"\0\0" + other[42:])


def _crc_of(data: bytes) -> int:
    return crc_hqx(data[:40], 0xFFFF)


def test_unchecked_is_dialect_1_only() -> None:
    body = b"\xff\xff\x00\x02\x01\xfc"
    one = make(proto=1, cmd=1, body=body)
    assert one[46:48] == b"\xff\xff"
    assert parse_frame(one).body == body
    # Whatever stands there in dialect 1 is not looked at: the chapter's host sends what nobody can compute.
    assert parse_frame(one[:46] + b"\x14\x22" + one[48:]) == parse_frame(one)
    two = make()
    with pytest.raises(RemoteProtocolError, match="check is FFFF"):
        parse_frame(two[:41] + b"\xff\xff" + two[43:])


@pytest.mark.parametrize(
    ("at", "value", "reason"),
    [
        (31, b"\xff", "size 4278190128 is over 8192"),
        (28, b"\x2c", "size 44 does not fit length 1 and pad 3"),
        (28, b"\x00", "size 0 does not fit"),
        (32, b"\x00", "flag 0x00"),
        (33, b"\x00", "unknown dialect 0"),
        (35, b"\x02", "does not fit length 1 and pad 2"),
        (36, b"\x05", "does not fit length 5"),
        (37, b"\xff", "does not fit length 65281"),
    ],
)
def test_heads_that_cannot_be(at: int, value: bytes, reason: str) -> None:
    data = make()
    with pytest.raises(RemoteProtocolError, match=reason):
        parse_frame(data[:at] + value + data[at + 1 :])


def test_pad_must_be_the_one_the_length_asks_for() -> None:
    # Length, pad and size agree with each other, but the pad is four bytes too many.
    data = bytearray(make(body=b"1234"))
    data[35] = 4
    data[28] += 4
    data[-2:] = b"\xaa\xaa\xaa\xaa\r\n"
    with pytest.raises(RemoteProtocolError, match="pad 4"):
        parse_frame(bytes(data))


def test_limits_of_length() -> None:
    assert max_body(253) == 208
    assert max_body(8192) == 8148
    longest = parse_frame(make(body=bytes(208)))
    assert len(serialize_frame(longest, 253)) == 252
    with pytest.raises(LocalProtocolError, match="frame of 256 bytes, the line takes 253"):
        serialize_frame(longest._replace(body=bytes(209)), 253)
    with pytest.raises(LocalProtocolError, match="STOP needs"):
        make(body=bytes(70000))
    assert parse_frame(make(body=bytes(8148))).size == 8192
    with pytest.raises(RemoteProtocolError, match="over 253"):
        parse_frame(make(body=bytes(212)), max_frame=253)


@given(st.binary(max_size=600), st.integers(0, 100))
def test_examine_never_raises(data: bytes, start: int) -> None:
    stream = bytes(start) + b"\x5a\xfa\xfa\x5a" + data
    result = examine(stream, start, 8192)
    if isinstance(result, int):
        assert 40 <= result <= 8192
        assert result > len(stream) - start
    elif isinstance(result, str):
        assert result
    else:
        assert result.size <= len(stream) - start


def test_names_of_codes() -> None:
    assert command_name(0x13) == "JOINT_MOVE"
    assert command_name(0x7F) == "command 0x7F"
    assert status_name(Status.SERVO_SILENT) == "servo silent"
    assert status_name(42) == "status 42"


def test_what_a_frame_says_of_itself() -> None:
    reply = parse_frame(make(cmd=Command.STOP, cmd_ext=0x80 | Status.BUSY, body=b""))
    assert (reply.is_reply, reply.is_unsolicited, reply.status) == (True, False, Status.BUSY)
    report = parse_frame(make(cmd=Command.JOINT_STATE, cmd_ext=0x40))
    assert (report.is_reply, report.is_unsolicited, report.status) == (False, True, 0)
    assert "reply busy" in str(reply)
    assert "report" in str(report)
    assert isinstance(report, Frame)
    assert report.time == 0.0


def test_the_line_of_a_frame_for_several_names_them() -> None:
    frame = Frame(0, 0, 1, 7, -1, 3, 2, 1, Command.STATS, b"")
    assert "ARM_7BOT_SERIAL_TRX -> all modules dialect 2" in str(frame)
    assert "-> ARM_7BOT_ARDUINO_TRX, module 9 " in str(frame._replace(dst=0x40000300))
    assert "-> INVALID_MODULE " in str(frame._replace(proto=1))
