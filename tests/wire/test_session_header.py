"""The session header: offsets, byte order, and a clock that may be a second too long."""

from __future__ import annotations

import struct
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import RemoteProtocolError
from hexwire.wire.session_header import HEADER, SYNC_BYTES, SessionHeader

SCHEMA: dict[str, Any] = tomllib.loads((Path(__file__).parents[2] / "schema/session.toml").read_text())["header"]
U32 = st.integers(0, 2**32 - 1)
I32 = st.integers(-(2**31), 2**31 - 1)
HEADERS = st.builds(SessionHeader, U32, U32, U32, I32, I32, I32, U32)


@given(HEADERS)
def test_round_trip(header: SessionHeader) -> None:
    data = header.serialize()
    assert len(data) == SCHEMA["size"] == HEADER.size
    assert SessionHeader.parse(data) == header
    assert SessionHeader.parse(data + b"what follows") == header


@given(HEADERS)
def test_every_field_is_where_the_schema_puts_it(header: SessionHeader) -> None:
    data = header.serialize()
    codes = {"u32": "<I", "i32": "<i"}
    for name, kind, offset in SCHEMA["fields"]:
        value = SCHEMA["sync"] if name == "sync" else getattr(header, name)
        assert struct.unpack_from(codes[kind], data, offset)[0] == value, name


def test_sync_bytes_read_the_same_from_both_ends() -> None:
    assert bytes.fromhex("5AFAFA5A") == SYNC_BYTES == SYNC_BYTES[::-1]


def test_a_billion_nanoseconds_are_one_more_second() -> None:
    assert SessionHeader(14, 1_000_000_000, 1, 8, 0, 8, 52).time == 15.0
    assert SessionHeader(14, 356_000_000, 1, 8, 0, 8, 52).time == pytest.approx(14.356)


@given(st.binary(max_size=31))
def test_too_short(data: bytes) -> None:
    with pytest.raises(RemoteProtocolError, match=f"here are {len(data)}"):
        SessionHeader.parse(data)


@given(st.binary(min_size=32, max_size=40).filter(lambda data: not data.startswith(SYNC_BYTES)))
def test_no_sync_word(data: bytes) -> None:
    with pytest.raises(RemoteProtocolError, match="no sync word"):
        SessionHeader.parse(data)
