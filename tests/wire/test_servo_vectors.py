"""vectors/servo.jsonl both ways: the bytes mean what the line says, and the meaning builds the bytes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from hexwire.wire import servo_packet as sp
from hexwire.wire.registers import Series

FILE = Path(__file__).parents[2] / "vectors/servo.jsonl"
ROWS: list[dict[str, Any]] = [json.loads(line) for line in FILE.read_text().splitlines()]
BY_ADDRESS = {"read", "write", "sync_read", "sync_write"}


def of_kind(kind: str) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("row", [row for row in ROWS if row["kind"] == kind], ids=lambda row: row["name"])


def test_every_line_names_its_source() -> None:
    assert len(ROWS) >= 22
    assert all(row["source"] for row in ROWS)
    assert len({row["hex"] for row in ROWS}) == len(ROWS)


@of_kind("request")
def test_request_is_built_and_parsed(row: dict[str, Any]) -> None:
    data = bytes.fromhex(row["hex"])
    args = row["args"]
    packet = sp.parse_packet(data)
    assert packet.serialize() == data
    assert packet.instruction == sp.Instruction[row["make"].upper()]
    assert packet.servo_id == args.get("id", sp.BROADCAST_ID)
    if row["make"] in BY_ADDRESS:
        assert packet.params[0] == args["address"]
    make = getattr(sp, f"make_{row['make']}")
    if row["make"] == "sync_write":
        built = make(args["address"], [(servo_id, bytes.fromhex(text)) for servo_id, text in args["data"]])
    elif row["make"] == "sync_read":
        built = make(args["address"], args["count"], args["ids"])
    elif row["make"] == "read":
        built = make(args["id"], args["address"], args["count"])
    elif row["make"] == "write":
        built = make(args["id"], args["address"], bytes.fromhex(args["data"]))
    else:
        built = make(args["id"])
    assert built == data


@of_kind("status")
def test_status_is_built_and_parsed(row: dict[str, Any]) -> None:
    data = bytes.fromhex(row["hex"])
    params = bytes.fromhex(row["params"])
    status = sp.parse_status(data)
    assert status == sp.StatusPacket(row["id"], row["error"], params, row["legacy"])
    if row.get("quirk") == "ping":
        assert sp.make_legacy_ping_status(row["id"], row["error"]) == data
    elif row.get("quirk") == "board":
        assert sp.make_board_error(row["error"], row["id"]) == data
        assert sp.board_error_name(status) == row["board_error"]
    else:
        assert sp.make_status(row["id"], row["error"], params, legacy=row["legacy"]) == data
    if "register" in row:
        series, name, raw = row["register"]
        register = Series(series).register(name)
        assert register.decode(params) == raw
        assert register.encode(raw) == params


@of_kind("swapped")
def test_swapped_read_is_put_right(row: dict[str, Any]) -> None:
    data = bytes.fromhex(row["hex"])
    assert sp.parse_status(data).params[0] != row["value"]
    fixed = sp.undo_one_byte_swap(data)
    assert fixed == bytes.fromhex(row["fixed"])
    assert sp.parse_status(fixed).params[0] == row["value"]
