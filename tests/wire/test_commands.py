"""Bodies of dialect 2 against the schema and against vectors/command.jsonl."""

from __future__ import annotations

import contextlib
import json
import struct
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import RemoteProtocolError
from hexwire.wire import commands as c
from hexwire.wire import tables
from hexwire.wire.board_trajectory import PathPoint, PointsRequest, parse_points
from hexwire.wire.command_frame import Command, Status

ROOT = Path(__file__).parents[2]
SCHEMA: dict[str, Any] = tomllib.loads((ROOT / "schema/commands.toml").read_text())
ROWS: list[dict[str, Any]] = [
    json.loads(line) for line in (ROOT / "vectors/command.jsonl").read_text().splitlines()
]
GOOD = [row for row in ROWS if "error" not in row]
CODES = {"u8": "B", "u16": "H", "u32": "I", "i8": "b", "i16": "h", "i32": "i"}


def encode(row: dict[str, Any]) -> bytes:
    """Build a body by the schema alone, knowing nothing of the code under test."""
    spec = SCHEMA["commands"][row["command"]]
    prefix = "request_" if row["part"] == "request" else ""
    mask = row["fields"].get("fields", 0) if row["command"] == "JOINT_STATE" else 0
    return b"".join(
        _encode(spec.get(part, []), values, mask)
        for part, values in [
            (row["part"], row["fields"]),
            *((f"{prefix}rows", values) for values in row.get("rows", [])),
        ]
    )


def _encode(layout: list[list[str]], values: dict[str, Any], mask: int) -> bytes:
    out = b""
    for name, kind, *condition in layout:
        if condition and not mask & SCHEMA["state_fields"][condition[0]]:
            assert name not in values
        elif kind == "bytes":
            out += bytes.fromhex(values[name])
        else:
            out += struct.pack("<" + CODES[kind], values[name])
    return out


def value_of(row: dict[str, Any]) -> Any:
    """The typed value that the code should give for a line, with the function that reads and writes it."""
    f, rows = row["fields"], row.get("rows", [])
    match row["command"], row["part"]:
        case "IDENTIFY", "reply":
            joints = tuple(c.JointRow(r["servo_id"], r["series"], bool(r["present"])) for r in rows)
            firmware = (f["fw_major"], f["fw_minor"], f["fw_patch"])
            return c.Identity(
                f["protocol"], firmware, f["boot_id"], f["capabilities"], f["max_frame"], f["board_flags"], joints
            )
        case "JOINT_STATE", "reply":
            names = ("position", "status", "speed", "load", "voltage", "temperature", "current", "age")
            columns = [tuple(r[name] for r in rows) if name in rows[0] else None for name in names]
            return c.JointReport(f["time_us"], f["board_flags"], *columns)  # type: ignore[arg-type]
        case "JOINT_MOVE", "request":
            return c.MoveRequest(f["duration_ms"], tuple(c.MoveRow(r["servo_id"], r["position"]) for r in rows))
        case "JOINT_MOVE", "reply":
            sent = tuple(c.SentRow(r["servo_id"], r["position"], bool(r["flags"])) for r in rows)
            return c.MoveReply(f["duration_ms"], sent)
        case "LIMITS", "reply":
            return c.LimitTable(
                f["version"], tuple(c.LimitRow(r["minimum"], r["maximum"], r["speed"]) for r in rows)
            )
        case "OFFSETS", "reply":
            return c.OffsetTable(f["version"], tuple(c.OffsetRow(r["neutral"], r["sign"]) for r in rows))
        case "TRANSACT", "request":
            return c.TransactRequest(f["reply_length"], f["timeout_ms"], bytes.fromhex(f["packet"]))
        case "MAINTENANCE", "reply":
            return c.MaintenanceReply(bool(f["on"]), f["board_flags"])
        case "STATS", "reply":
            return c.Stats(f)
        case "TRAJECTORY_POINTS", "request":
            return PointsRequest(f["id"], f["last"], f["first"], f["count"], bytes.fromhex(f["points"]))
    return None


READERS = {
    ("IDENTIFY", "reply"): c.Identity.parse,
    ("JOINT_STATE", "reply"): c.JointReport.parse,
    ("JOINT_MOVE", "request"): c.MoveRequest.parse,
    ("JOINT_MOVE", "reply"): c.MoveReply.parse,
    ("LIMITS", "request"): c.LimitTable.parse_request,
    ("LIMITS", "reply"): c.LimitTable.parse,
    ("OFFSETS", "request"): c.OffsetTable.parse_request,
    ("OFFSETS", "reply"): c.OffsetTable.parse,
    ("TORQUE", "reply"): c.parse_stop_reply,
    ("STOP", "reply"): c.parse_stop_reply,
    ("TRANSACT", "request"): c.TransactRequest.parse,
    ("MAINTENANCE", "reply"): c.MaintenanceReply.parse,
    ("STATS", "reply"): c.Stats.parse,
    ("FRAGMENT", "request"): c.FragmentHead.parse,
    ("FRAGMENT_MISSING", "request"): c.parse_missing,
}


def test_every_line_names_its_source_and_every_command_is_there() -> None:
    assert all(row["source"] for row in ROWS)
    board = {name for name, spec in SCHEMA["commands"].items() if spec["code"] <= Command.MAINTENANCE}
    assert {row["command"] for row in ROWS} == board | {"TRAJECTORY_POINTS"}
    assert {(row["command"], row["part"]) for row in GOOD} >= set(READERS)


@pytest.mark.parametrize("row", GOOD, ids=lambda row: row["name"])
def test_vector_follows_the_schema(row: dict[str, Any]) -> None:
    assert encode(row) == bytes.fromhex(row["hex"])


@pytest.mark.parametrize("row", [r for r in GOOD if value_of(r) is not None], ids=lambda row: row["name"])
def test_typed_body_is_read_and_written(row: dict[str, Any]) -> None:
    data, value = bytes.fromhex(row["hex"]), value_of(row)
    assert type(value).parse(data) == value
    assert value.serialize() == data


def test_points_are_as_the_table_of_the_protocol_gives_them() -> None:
    """Every byte range of the table, in both forms, and the example below it, which is a vector."""
    by_name = {row["name"]: bytes.fromhex(row["fields"]["points"]) for row in GOOD if "points" in row["fields"]}
    with_velocities = by_name["two joints, two points with velocities"]
    assert parse_points(with_velocities, 2, hermite=True) == (
        PathPoint(0, (2048, -1), (0, 0)),
        PathPoint(500, (2100, 1), (300, -300)),
    )
    assert parse_points(by_name["three joints, one point without velocities"], 3, hermite=False) == (
        PathPoint(1000, (100, -50, 16384)),
    )
    text = (ROOT / "PROTOCOL.md").read_text(encoding="utf-8")
    block = text.partition("which are the last:\n\n```text\n")[2].partition("```")[0]
    shown = " ".join(line.split("   ")[0].split("    ")[0] for line in block.splitlines())
    assert bytes.fromhex(shown) == bytes.fromhex(
        next(row["hex"] for row in GOOD if row["name"] == "two joints, two points with velocities")
    )


def test_bodies_that_are_functions_rather_than_types() -> None:
    by_name = {row["name"]: bytes.fromhex(row["hex"]) for row in GOOD}
    assert c.parse_stop_reply(by_name["stopped, torque off, all"]) == (1, 0x7F)
    assert c.make_stop_reply(1, 0x3F) == by_name["torque confirmed by six"]
    limits = (c.LimitRow(0, 4095, 4096),)
    assert c.LimitTable.serialize_request(limits) == by_name["limits of one joint"]
    assert c.LimitTable.parse_request(by_name["limits of one joint"]) == limits
    offsets = (c.OffsetRow(2047, 1), c.OffsetRow(2048, -1))
    assert c.OffsetTable.serialize_request(offsets) == by_name["offsets to store"]
    assert c.OffsetTable.parse_request(by_name["offsets to store"]) == offsets
    chunk = by_name["second of three chunks of a READ"]
    head = c.FragmentHead(0x1234, 1, 3, 2, 0)
    assert c.FragmentHead.parse(chunk) == head
    assert head.serialize() == chunk[: c.FRAGMENT_HEAD_SIZE]
    assert c.parse_missing(by_name["chunks 0 and 258 are missing"]) == (0x1234, (0, 258))
    assert c.serialize_missing(0x1234, (0, 258)) == by_name["chunks 0 and 258 are missing"]
    assert c.serialize_missing(0x1234, ()) == by_name["all arrived"]


@pytest.mark.parametrize("row", [row for row in ROWS if "error" in row], ids=lambda row: row["name"])
def test_bad_body_is_refused(row: dict[str, Any]) -> None:
    with pytest.raises(RemoteProtocolError, match=r"^[A-Z_]+"):
        READERS[row["command"], row["part"]](bytes.fromhex(row["hex"]))


@pytest.mark.parametrize("key", READERS, ids=" ".join)
def test_an_empty_body_is_refused_by_the_name_of_its_command(key: tuple[str, str]) -> None:
    with pytest.raises(RemoteProtocolError, match=rf"\b{key[0]}\b.*: 0 bytes"):
        READERS[key](b"")


@pytest.mark.parametrize("row", [r for r in GOOD if (r["command"], r["part"]) in READERS], ids=lambda r: r["name"])
def test_a_body_cut_or_lengthened_anywhere_is_refused(row: dict[str, Any]) -> None:
    read, data = READERS[row["command"], row["part"]], bytes.fromhex(row["hex"])
    # Shortest body where anything may follow the head: a packet, further counters, a chunk.
    open_ended = {"TRANSACT": 2, "STATS": 4, "FRAGMENT": c.FRAGMENT_HEAD_SIZE}
    shortest = open_ended.get(row["command"], len(data))
    for body in (data[:n] for n in range(shortest)):
        with pytest.raises(RemoteProtocolError):
            read(body)
    read(data[:shortest])
    if row["command"] not in open_ended:
        with pytest.raises(RemoteProtocolError):
            read(data + b"\0")


@pytest.mark.parametrize(
    "empty",
    [
        c.LimitTable(7, ()),
        c.OffsetTable(7, ()),
        c.MoveRequest(500, ()),
        c.MoveReply(500, ()),
        c.Identity(2, (1, 2, 3), 4, 5, 253, 0, ()),
    ],
    ids=lambda value: type(value).__name__,
)
def test_a_table_of_no_rows_is_its_head_alone(empty: Any) -> None:
    assert type(empty).parse(empty.serialize()) == empty
    with pytest.raises(RemoteProtocolError):
        type(empty).parse(empty.serialize()[:-1])


def test_a_request_may_store_no_rows() -> None:
    assert c.LimitTable.parse_request(b"\0") == c.OffsetTable.parse_request(b"\0") == ()


@pytest.mark.parametrize("fields", [64, 128, 255])
def test_a_state_with_fields_that_nobody_knows_is_refused(fields: int) -> None:
    with pytest.raises(RemoteProtocolError, match=f"unknown fields 0x{fields:02X}"):
        c.JointReport.parse(struct.pack("<IBBBB", 0, fields, 0, 1, 0) + bytes(13))


def test_a_state_of_no_joints_is_refused() -> None:
    with pytest.raises(RemoteProtocolError, match="do not hold 0 rows"):
        c.JointReport.parse(struct.pack("<IBBBB", 0, 63, 0, 0, 0))


@pytest.mark.parametrize("key", READERS, ids=" ".join)
@given(body=st.binary(max_size=260))
def test_any_body_is_read_or_refused(key: tuple[str, str], body: bytes) -> None:
    with contextlib.suppress(RemoteProtocolError):
        value = READERS[key](body)
        if hasattr(value, "serialize") and key not in {("STATS", "reply"), ("FRAGMENT", "request")}:
            assert type(value).parse(value.serialize()) == value  # type: ignore[attr-defined]


def test_codes_are_those_of_the_schema() -> None:
    assert {m.name: m.value for m in Command} == {name: row["code"] for name, row in SCHEMA["commands"].items()}
    assert {m.name.lower(): m.value for m in Status} == SCHEMA["status"]
    assert {m.name: m.value for m in Command} == tables.COMMANDS
    assert tuple(name for name, _ in SCHEMA["commands"]["STATS"]["reply"]) == c.STATS_FIELDS
    assert sum(SCHEMA["state_fields"].values()) == c.ALL_FIELDS


def test_every_field_mask_has_the_rows_of_the_schema() -> None:
    layout = SCHEMA["commands"]["JOINT_STATE"]["rows"]
    for mask in range(64):
        wanted = [name for name, _, *cond in layout if not cond or mask & SCHEMA["state_fields"][cond[0]]]
        rows = [{name: 10 * (i + 1) + j for j, name in enumerate(wanted)} for i in range(2)]
        fields = {"time_us": 5, "fields": mask, "board_flags": 0, "joints": 2, "spare": 0}
        line = {"command": "JOINT_STATE", "part": "reply", "fields": fields, "rows": rows}
        report = c.JointReport.parse(encode(line))
        assert report == value_of(line), f"mask {mask:#x}"
        assert report.fields == mask
        assert report.serialize() == encode(line), f"mask {mask:#x}"


def test_a_newer_board_may_append_counters() -> None:
    stats = c.Stats.parse(struct.pack("<17I", *range(1, 18)))
    assert list(stats.counters) == list(c.STATS_FIELDS)
    assert stats.counters["loop_us_max"] == 15
    assert c.Stats.parse(struct.pack("<2I", 7, 8)).counters == {"uptime_ms": 7, "frames_received": 8}
    wrapped = c.Stats({"uptime_ms": 2**32 + 5}).serialize()
    assert c.Stats.parse(wrapped).counters["uptime_ms"] == 5
