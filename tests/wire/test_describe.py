"""Any bytes in one line: readable for good ones, never an error for bad ones."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.wire import servo_packet as sp
from hexwire.wire.command_frame import Command, Frame, serialize_frame
from hexwire.wire.describe import describe, describe_servo, describe_status
from hexwire.wire.registers import Series

VECTORS = Path(__file__).parents[2] / "vectors"
COMMANDS: list[dict[str, Any]] = [json.loads(line) for line in (VECTORS / "command.jsonl").read_text().splitlines()]
SESSIONS: list[dict[str, Any]] = [json.loads(line) for line in (VECTORS / "session.jsonl").read_text().splitlines()]
BY_NAME = {row["name"]: bytes.fromhex(row["hex"]) for row in COMMANDS + SESSIONS}


def frame_of(name: str) -> bytes:
    row = next(row for row in COMMANDS if row["name"] == name)
    src, dst, ext = (7, 8, 0) if row["part"] == "request" else (8, 7, 0x80)
    return serialize_frame(Frame(
        proto=2, cmd=Command[row["command"]], cmd_ext=ext, body=BY_NAME[name], seq=5, sn=1, src=src, dst=dst,
        type=3, time_sec=0, time_nsec=0,
    ))  # fmt: skip


HOST, BOARD = "ARM_7BOT_SERIAL_TRX", "ARM_7BOT_ARDUINO_TRX"


@pytest.mark.parametrize(
    ("name", "line"),
    [
        (
            "the chapter's host asks for the position of id 0",
            f"{HOST} -> {BOARD} #47 dialect 1 READ seq 47: read 2 bytes at 0x38 of servo 0",
        ),
        (
            "the chapter's board answers with position 2053, swapped",
            f"{BOARD} -> ROS1_HOST #46 dialect 1 READ seq 46: servo 0 (legacy) ok: 05 08 (little-endian 2053)",
        ),
        ("board error: unknown command", "#258 dialect 1 READ seq 2: board error: unknown command"),
        (
            "sync write of two legacy servos, 2 pad bytes",
            "SYNC_WRITE seq 3: sync write 0x2A 0: FF 07 E8 03, 1: 00 08 88 13",
        ),
        ("refused: stopped, empty body", "dialect 2 JOINT_MOVE reply, stopped, seq 10"),
        ("unsolicited state, position and status of one joint", "JOINT_STATE unsolicited, seq 77: positions 2047"),
        ("the load answer as the log shows it", "bad frame, tail is 0A 0A, not 0D 0A: 5A FA FA 5A"),
        ("last byte missing", "frame cut short, 43 of 44 bytes: 5A FA FA 5A"),
        ("one byte too many", "IDENTIFY request, seq 1 (+ 1 bytes after it)"),
        ("a size of 4 GB", "bad frame, size 4294967295 is over 8192"),
        ("no sync word", "44 bytes, no frame: 5A FA FA 5B"),
    ],
)
def test_frames(name: str, line: str) -> None:
    assert line in describe(BY_NAME[name])


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("a board of two joints, one silent", "firmware 2.1.0, boot 3735928559, 1 of 2 servos present"),
        ("state, position and status only", "positions 2047, -100 [stopped]"),
        ("state, every field", "positions -32768 [watchdog tripped]"),
        ("report every 10 ms with speed", "every 10 ms, fields 01"),
        ("report is off", "REPORT reply, ok, seq 5: off"),
        ("move two joints in 1.5 s", "0 to 2053, 6 to -100 in 1500 ms"),
        ("move all joints", "all to 2047 in 3338 ms"),
        ("what was sent, the second clamped", "sent 0 to 2053, 6 to 0 (clamped) in 1500 ms"),
        ("torque on for all seven", "on, joints 1111111"),
        ("stop and hold", "STOP request, seq 5: hold"),
        ("stopped, torque off, all", "torque off, joints 1111111"),
        ("watchdog 500 ms, torque off", "after 500 ms, torque off"),
        ("stored limits of two joints", "0..4095, -100..100"),
        ("raw read of servo 4", "read 2 bytes at 0x38 of servo 4, 8 bytes expected"),
        ("raw answer", "servo 4 ok: 00 08 (little-endian 2048)"),
        ("counters, each its own place", "uptime_ms 16777217, frames_received 33554434"),
        ("second of three chunks of a READ", "chunk 2 of 3, 2 bytes of READ"),
        ("chunks 0 and 258 are missing", "message 4660: chunks 0, 258 missing"),
        ("all arrived", "message 4660: complete"),
        ("outputs", "IO reply, ok, seq 5: 07 01"),
        ("maintenance on", "MAINTENANCE request, seq 5: on"),
        ("in maintenance, settings default", "MAINTENANCE reply, ok, seq 5: on [settings default, maintenance]"),
        ("IDENTIFY reply cut in its head", "IDENTIFY: 3 bytes, at least 14 are needed: 02 02 01"),
        ("chunk 3 of 3", "FRAGMENT: chunk 3 of 3"),
    ],
)
def test_bodies(name: str, line: str) -> None:
    assert line in describe(frame_of(name))


@pytest.mark.parametrize(
    ("data", "line"),
    [
        (sp.make_ping(3), "ping servo 3"),
        (sp.make_action(), "action all servos"),
        (sp.make_write(4, 0x28, b"\1"), "write servo 4 0x28 = 01"),
        (sp.make_sync_read(0x38, 2, (4, 5)), "sync read 2 bytes at 0x38 of 4, 5"),
        (sp.make_status(2, 0x21, b"", legacy=True), "servo 2 (legacy) error voltage, overload"),
        (sp.make_status(2, 0x40), "servo 2 error 0x40"),
        (sp.make_board_error(5, 3), "board error: ping not answered (servo 3)"),
        (sp.make_board_error(1, 3), "board error: read not answered (servo 3)"),
        (sp.make_board_error(4), "board error: frame too short"),
        (sp.make_ping(3)[:-1] + b"\0", "bad servo packet, checksum is 00, should be f9: FF FF 03 02 01 00"),
        (b"\xff\xf5", "bad servo packet, status packet of 2 bytes; the shortest has 6: FF F5"),
        (sp.make_packet(0xFE, 0x83, b"\x2a\x04\x00"), "bad servo packet, the rows of a sync write do not fill it"),
        (b"", "no bytes"),
        (b"boot: ok\r\n", "10 bytes, no frame: 62 6F 6F 74 3A 20 6F 6B 0D 0A"),
        (bytes(300), "300 bytes, no frame: " + "00 " * 24 + "..."),
    ],
)
def test_servo_packets_and_others(data: bytes, line: str) -> None:
    assert line in describe(data)


def test_registers_have_names_where_the_series_is_known() -> None:
    hls = Series.HLS
    move = sp.make_write(4, 0x29, bytes.fromhex("32 64 80 2C 01 3C 00"))
    assert describe_servo(move, hls) == (
        "write servo 4 acceleration (0x29) = acceleration 50, goal_position -100, goal_torque 300, goal_speed 60"
    )
    assert describe_servo(sp.make_read(0, 0x38, 2), hls) == "read 2 bytes at present_position (0x38) of servo 0"
    status = sp.parse_status(bytes.fromhex("FF FF 06 04 00 34 00 C1"))
    assert describe_status(status, hls, 60) == "servo 6 ok: present_load 52"
    # Half a register, and one that is not there.
    assert describe_servo(sp.make_write(4, 0x2A, b"\1"), hls) == "write servo 4 goal_position (0x2A) = 0x01"
    assert "0xFE" in describe_servo(sp.make_write(4, 0xFE, b"\1\2\3"), hls)


def test_what_nobody_knows_is_still_described() -> None:
    unknown = sp.make_packet(3, 0x77, b"\1")
    assert describe_servo(unknown, reply=False) == "instruction 0x77 to servo 3 01"
    assert describe_servo(b"\0\0", reply=False).startswith("bad servo packet, servo packet of 2 bytes")
    data = serialize_frame(
        Frame(
            proto=2,
            cmd=0x7F,
            cmd_ext=0xBF,
            body=b"\1",
            seq=5,
            sn=1,
            src=99,
            dst=-1,
            type=0,
            time_sec=0,
            time_nsec=0,
        )
    )
    assert describe(data) == "module 99 -> INVALID_MODULE #1 dialect 2 command 0x7F reply, status 63, seq 5: 01"


def is_one_line(text: str) -> bool:
    return isinstance(text, str) and bool(text) and text.isprintable()


U8 = st.integers(0, 255)
HEADS = st.sampled_from((b"", b"\x5a\xfa\xfa\x5a", b"\xff\xff", b"\xff\xf5"))


@given(HEADS, st.binary(max_size=300))
def test_any_bytes_are_one_line(head: bytes, data: bytes) -> None:
    assert is_one_line(describe(head + data))
    assert is_one_line(describe(bytearray(head + data)))  # type: ignore[arg-type]


@given(
    st.sampled_from(sorted(BY_NAME.values())),
    st.lists(st.tuples(st.integers(0, 10_000), st.integers(0, 255)), max_size=4),
    st.integers(0, 300),
)
def test_a_damaged_vector_is_one_line(data: bytes, changes: list[tuple[int, int]], length: int) -> None:
    damaged = bytearray(data)
    for at, value in changes:
        if damaged:
            damaged[at % len(damaged)] = value
    assert is_one_line(describe(bytes(damaged[:length])))


@given(
    st.integers(0, 255), st.integers(0, 255), st.binary(max_size=250), st.sampled_from((1, 2)), st.integers(0, 9)
)
def test_any_body_of_any_command_is_one_line(cmd: int, ext: int, body: bytes, proto: int, src: int) -> None:
    data = serialize_frame(
        Frame(
            proto=proto,
            cmd=cmd,
            cmd_ext=ext,
            body=body,
            seq=5,
            sn=1,
            src=src,
            dst=8,
            type=3,
            time_sec=0,
            time_nsec=0,
        )
    )
    assert is_one_line(describe(data))


@given(
    st.integers(0, 255), st.integers(0, 255), st.binary(max_size=60),
    st.sampled_from((None, *Series)), st.sampled_from((None, True, False)), st.booleans(),
)  # fmt: skip
def test_any_servo_packet_is_one_line(
    servo_id: int, inst: int, params: bytes, series: Series | None, reply: bool | None, legacy: bool
) -> None:
    for data in (sp.make_status(servo_id, inst, params, legacy=legacy), params):
        assert is_one_line(describe_servo(data, series, reply=reply))
    status = sp.StatusPacket(servo_id, inst, params, legacy)
    assert is_one_line(describe_status(status, series, servo_id))
