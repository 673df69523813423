"""The bodies of SERVO_TABLE: as the schema says, there and back, and hostile ones."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import RemoteProtocolError
from hexwire.wire import tables
from hexwire.wire.servo_table import TABLE_HEAD_SIZE, ServoTable

SIZES = {"u8": 1, "u16": 2}


@pytest.mark.parametrize("part", ["request", "reply"])
def test_the_layout_is_that_of_the_schema(part: str) -> None:
    body: tables.Body = getattr(tables.COMMAND_ROWS["SERVO_TABLE"], part)
    assert [name for name, *_ in body.fields] == ["servo_id", "first", "count", "data"]
    assert sum(SIZES[kind] for _, kind, _ in body.fields[:-1]) == TABLE_HEAD_SIZE
    assert body.fields[-1][1] == "bytes"


@given(st.integers(0, 255), st.integers(0, 255), st.integers(0, 65535), st.binary(max_size=256))
def test_there_and_back(servo_id: int, first: int, count: int, data: bytes) -> None:
    table = ServoTable(servo_id, first, count, data)
    assert ServoTable.parse(table.serialize()) == table


def test_the_bytes_of_one() -> None:
    assert ServoTable(5, 0x15, 256).serialize() == b"\x05\x15\x00\x01"
    assert ServoTable(5, 0x15, 2, b"\x11\x22").serialize() == b"\x05\x15\x02\x00\x11\x22"


@pytest.mark.parametrize("length", range(TABLE_HEAD_SIZE))
def test_a_short_one_is_an_error(length: int) -> None:
    with pytest.raises(RemoteProtocolError, match="SERVO_TABLE"):
        ServoTable.parse(bytes(length))
