"""Every byte belongs to exactly one field, whatever the bytes are; the fields are where PROTOCOL.md puts them."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from tests.analyzers.lines import readings_table
from tests.frames import frame_bytes

from hexwire.link.tap import Direction, Passed
from hexwire.trace.explain import Explainer, Part, doubt
from hexwire.trace.line_reader import LineReader
from hexwire.wire import tables as t
from hexwire.wire.command_frame import Command
from hexwire.wire.commands import JointReport
from hexwire.wire.robot_bodies import COMMAND_ARRAYS, JointCommands, TrajectoryPoints
from hexwire.wire.servo_packet import (
    make_ping,
    make_read,
    make_status,
    make_sync_read,
    make_sync_write,
    make_write,
)

SENT, RECEIVED = Direction.SENT, Direction.RECEIVED
MOST_PARTS = 3 * t.MAX_NETWORK_FRAME


def check(tree: Part, size: int) -> None:
    """Ranges nest, and the leaves cover every byte once, in order."""
    assert (tree.start, tree.end) == (0, size)
    leaves = list(tree.leaves())
    assert [leaf.start for leaf in leaves] == [0, *(leaf.end for leaf in leaves[:-1])]
    assert leaves[-1].end == size
    parts = [part for _, part in tree.rows()]
    assert len(parts) <= MOST_PARTS
    for part in parts:
        assert part.start < part.end
        if part.parts:
            assert (part.parts[0].start, part.parts[-1].end) == (part.start, part.end)
    for i in (0, size // 2, size - 1):
        assert tree.path(i)[-1] in leaves


def trees(*transfers: tuple[Direction, bytes], series: str = "board", bus: bool | None = None) -> list[Part]:
    reader, dissector, found = LineReader(series, bus=bus), Explainer(series), []
    readings = [r for way, data in transfers for r in reader.feed(Passed(way, data, 0.0, ""))]
    for reading in [*readings, *reader.finish()]:
        tree = dissector.dissect(reading)
        check(tree, len(reading.data))
        assert tree.problem == doubt(reading)
        found.append(tree)
    return found


def frame(cmd: int, body: bytes, *, proto: int = 2, src: int = 7, ext: int = 0, seq: int = 1) -> bytes:
    return frame_bytes(cmd, body, proto=proto, seq=seq, src=src, dst=15 - src, cmd_ext=ext)


def fields(tree: Part) -> dict[str, tuple[int, int, str]]:
    return {part.name: (part.start, part.end, part.words) for _, part in tree.rows()}


def test_a_header_has_its_fields_where_the_protocol_puts_them() -> None:
    (tree,) = trees((SENT, frame(Command.JOINT_STATE, b"\x03", seq=9)))
    found = fields(tree)
    for name, _, at in t.HEADER_FIELDS:
        assert found[name][:2] == (at, at + 4)
    assert found["src"][2] == "7 ARM_7BOT_SERIAL_TRX"
    (tree,) = trees((SENT, frame_bytes(Command.STATS, proto=2, src=7, dst=-1)))
    assert fields(tree)["dst"][2] == "-1 INVALID_MODULE"
    assert found["sync"][2] == "5A FA FA 5A"
    assert [found[name][:2] for name in ("flag", "proto", "seq", "pad", "len", "cmd", "cmd_ext")] == [
        (32, 33),
        (33, 34),
        (34, 35),
        (35, 36),
        (36, 38),
        (38, 39),
        (39, 40),
    ]
    assert found["seq"][2] == "9"
    assert found["cmd"][2] == "11 JOINT_STATE"
    assert found["fields"] == (40, 41, "0x03 = speed, load")
    assert found["check"][0:2] == (41, 43)
    assert found["check"][2].endswith("good")
    assert found["padding"] == (43, 46, "AA AA AA")
    assert found["tail"] == (46, 48, "0D 0A")


def test_the_rows_of_a_body_are_groups_with_units() -> None:
    report = JointReport(0, 1, (2047, 100), (0x40, 0x80), voltage=(74, 75)).serialize()
    (tree,) = trees((RECEIVED, frame(Command.JOINT_STATE, report, src=8, ext=0x80)))
    (body,) = [part for _, part in tree.rows() if part.name == "body"]
    assert body.meaning == t.COMMAND_DOCS["JOINT_STATE"]
    assert body.words.endswith("[stopped]")
    row = body.parts[-1]
    assert (row.name, row.end - row.start) == ("row 1", 4)
    assert [part.words for part in row.parts] == ["100 encoder count", "0x80 = silent", "75 = 7.5 V"]


def test_a_sync_write_has_a_group_for_each_servo() -> None:
    packet = make_sync_write(0x2A, {0: b"\xff\x07\xe8\x03", 4: b"\x00\x08\xe8\x03"})
    (tree,) = trees((SENT, frame(Command.SYNC_WRITE, packet, proto=1)))
    first, second = [part for _, part in tree.rows() if part.name == "row"]
    assert [(part.name, part.start, part.words) for part in first.parts] == [
        ("id", 47, "servo 0"),
        ("target_position", 48, "2047 = 179.912 deg"),
        ("run_time", 50, "1000 = 1000 ms"),
    ]
    assert second.parts[2].name == "goal_torque"
    assert "current ceiling" in tree.problem


def test_an_answer_on_a_bus_names_the_registers_that_were_asked_for_in_their_byte_order() -> None:
    asked, answered = trees((SENT, make_read(4, 0x38, 4)), (RECEIVED, make_status(4, 0, b"\x00\x08\x05\x80")))
    assert fields(asked)["address"] == (5, 6, "0x38 present_position")
    assert fields(answered)["present_position"] == (5, 7, "2048 = 180 deg")
    assert fields(answered)["present_speed"] == (7, 9, "-5 = -250 count/s")
    # A big-endian series.
    _, answered = trees((SENT, make_read(4, 0x38, 2)), (RECEIVED, make_status(4, 0, b"\x02\x01")), series="scs")
    assert fields(answered)["present_position"][2].startswith("513 ")


def test_the_swapped_answer_of_a_legacy_servo_is_little_endian_behind_a_board() -> None:
    request = frame(Command.READ, make_read(0, 0x38, 2), proto=1)
    reply = frame(Command.READ, make_status(0, 0, b"\x05\x08", legacy=True), proto=1, src=8)
    _, answered = trees((SENT, request), (RECEIVED, reply))
    assert fields(answered)["present_position"] == (45, 47, "2053 = 180.439 deg")


def test_a_packet_in_transact_comes_after_its_two_fields() -> None:
    request = frame(Command.TRANSACT, b"\x08\x14" + make_read(4, 0x38, 2))
    reply = frame(Command.TRANSACT, make_status(4, 0, b"\x00\x08"), src=8, ext=0x80)
    asked, answered = trees((SENT, request), (RECEIVED, reply))
    assert fields(asked)["timeout_ms"] == (41, 42, "20 = 0.02 s")
    words = "reply_length 8, timeout_ms 20; read 4: present_position, 2 bytes"
    assert fields(asked)["servo packet"] == (42, 50, words)
    assert fields(answered)["present_position"] == (45, 47, "2048 = 180 deg")


def test_sync_read_and_write_name_their_servos_and_registers() -> None:
    sent = make_sync_read(0x38, 2, (4, 5)) + make_write(9, 0x28, b"\x01") + make_ping(1)
    read, write, restart = trees((SENT, sent), series="sts_sms")
    assert [part.words for part in read.leaves() if part.name == "id"] == ["all servos", "servo 4", "servo 5"]
    assert fields(write)["torque_enable"] == (6, 7, "1")
    assert fields(restart)["instruction"] == (4, 5, "ping")


def test_the_arrays_of_a_robot_controller_are_named_by_joint() -> None:
    command = JointCommands(("shoulder", "elbow"), position=(0.5, -0.25), i_effort_max=(1.0, 2.0))
    (tree,) = trees((SENT, frame(Command.JOINT_COMMANDS, command.serialize())))
    data = next(part for _, part in tree.rows() if part.name == "data")
    assert [part.name for part in data.parts] == ["shoulder", "elbow", COMMAND_ARRAYS[0], COMMAND_ARRAYS[-1]]
    assert [(part.name, part.value) for part in data.parts[2].parts] == [("shoulder", 0.5), ("elbow", -0.25)]
    points = TrajectoryPoints((0.0, 1.5), ((0.0, 1.0), (0.25, 0.75)), ((0.0, 0.0), (0.5, 0.5)))
    (tree,) = trees((SENT, frame(Command.JOINT_TRAJECTORY, points.serialize())))
    second = next(part for _, part in tree.rows() if part.name == "point 1")
    assert [part.words for part in second.parts] == ["1.5 s", "0.25 rad", "0.75 rad", "0.5 rad/s", "0.5 rad/s"]


def test_the_wrong_field_of_a_damaged_frame_says_so() -> None:
    good = frame(Command.JOINT_STATE, b"\x3f")
    flipped = bytearray(good)
    flipped[40] ^= 1
    (tree,) = trees((SENT, bytes(flipped)))
    (check_field,) = [part for part in tree.leaves() if part.problem]
    assert (check_field.name, check_field.start) == ("check", 41)
    assert check_field.problem.startswith("check is")
    (tree,) = trees((SENT, good[:-2] + b"xy"))
    (tail,) = [part for part in tree.leaves() if part.problem]
    assert (tail.name, tail.problem) == ("tail", "is 78 79, not 0D 0A")
    (tree,) = trees((SENT, good[:35]))
    assert [part.name for part in tree.leaves()][-3:] == ["flag", "proto", "seq"]
    assert "cut short" in tree.problem
    (tree,) = trees((SENT, make_ping(4)[:-1] + b"\x00"), bus=True)
    (checksum,) = [part for part in tree.leaves() if part.problem]
    assert (checksum.name, checksum.problem) == ("checksum", "checksum 00, not F8")


def test_what_is_not_understood_is_still_one_field() -> None:
    (tree,) = trees((SENT, frame(Command.LIMITS, b"\x02\x00")))
    (body,) = [part for part in tree.leaves() if part.name == "body"]
    assert body.problem == "the body does not fit the command"
    (tree,) = trees((SENT, frame(Command.READ, b"\xff\xff\x01", proto=1)))
    (packet,) = [part for part in tree.leaves() if part.name == "packet"]
    assert packet.problem == "no header"
    (tree,) = trees((SENT, frame(0x7E, b"abc")))
    assert fields(tree)["body"][2] == "61 62 63"
    (tree,) = trees((SENT, b"noise"))
    assert [(part.name, part.problem) for part in tree.leaves()] == [("garbage", "")]
    assert tree.problem


def test_every_line_of_the_table_is_covered() -> None:
    ways = {"host": SENT, "board": RECEIVED}
    for row in readings_table():
        transfers = [(ways[way], bytes.fromhex(data)) for way, data in row["transfers"]]
        found = trees(*transfers, series=row.get("series", "board"), bus=row["line"] == "bus")
        assert [tree.words for tree in found] == row["readings"], row["name"]


commands = st.sampled_from([*Command, 0, 0x7E])
exts = st.sampled_from([0, 0x40, 0x80, 0x86])
bodies = st.one_of(
    st.binary(max_size=120),
    st.sampled_from([make_read(0, 0x38, 2), make_sync_write(0x2A, {1: b"abcd", 5: b"efgh"}), make_status(3, 1)]),
    st.builds(lambda head, tail: head + tail, st.sampled_from([b"\x02\x01\x00", b"\x01\x01\x02\x00"]), st.binary()),
)
frames = st.builds(
    lambda cmd, body, proto, src, ext: frame(cmd, body, proto=proto, src=src, ext=ext),
    commands,
    bodies,
    st.sampled_from([1, 2]),
    st.sampled_from([7, 8]),
    exts,
)


@given(st.lists(st.tuples(st.sampled_from(Direction), st.one_of(frames, bodies)), max_size=5), st.data())
def test_any_bytes_are_covered_exactly_once(transfers: list[tuple[Direction, bytes]], data: st.DataObject) -> None:
    spoilt = []
    for way, good in transfers:
        changed = bytearray(good)
        for _ in range(data.draw(st.integers(0, 2)) if changed else 0):
            changed[data.draw(st.integers(0, len(changed) - 1))] = data.draw(st.integers(0, 255))
        spoilt.append((way, bytes(changed)))
    bus = data.draw(st.sampled_from([None, True, False]))
    series = data.draw(st.sampled_from(["board", "seven_bot", "scs", "sts_sms", "hls"]))
    found = trees(*spoilt, series=series, bus=bus)
    assert sum(tree.end for tree in found) == sum(len(each) for _, each in spoilt)


def test_the_largest_frames_stay_bounded() -> None:
    rows = 4000
    missing = frame(Command.FRAGMENT_MISSING, b"\x01\x00" + rows.to_bytes(2, "little") + b"\x02\x00" * rows)
    (tree,) = trees((SENT, missing))
    assert len(list(tree.leaves())) > rows
    trees((SENT, b"\xff" * 100_000), bus=True)
