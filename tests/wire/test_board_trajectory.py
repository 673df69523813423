"""The bodies of a trajectory on the board: as the schema says, there and back, and hostile ones."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import RemoteProtocolError
from hexwire.wire import board_trajectory as bodies
from hexwire.wire.board_trajectory import (
    BeginReply,
    BeginRequest,
    PathFlag,
    PathPoint,
    PathState,
    PathStatus,
    PointsRequest,
    StartReply,
    StartRequest,
    parse_points,
    point_size,
    serialize_points,
)
from hexwire.wire.tables import COMMAND_ROWS

_SIZES = {"u8": 1, "u16": 2, "u32": 4}


def size(command: str, part: str) -> int:
    return sum(_SIZES.get(kind, 0) for _, kind, _ in getattr(COMMAND_ROWS[command], part).fields)


@pytest.mark.parametrize(
    ("layout", "command", "part"),
    [
        (bodies._BEGIN, "TRAJECTORY_BEGIN", "request"),
        (bodies._BEGIN_REPLY, "TRAJECTORY_BEGIN", "reply"),
        (bodies._POINTS, "TRAJECTORY_POINTS", "request"),
        (bodies._STATUS, "TRAJECTORY_POINTS", "reply"),
        (bodies._STATUS, "TRAJECTORY_STATUS", "reply"),
        (bodies._START, "TRAJECTORY_START", "request"),
        (bodies._START_REPLY, "TRAJECTORY_START", "reply"),
    ],
)
def test_the_sizes_are_those_of_the_schema(layout: object, command: str, part: str) -> None:
    assert layout.size == size(command, part)  # type: ignore[attr-defined]  # a Struct


def test_bytes_as_the_protocol_gives_them() -> None:
    assert BeginRequest(7, PathFlag.HERMITE, 0x7F, 200).serialize() == bytes.fromhex("07 01 7f 00 c8 00")
    points = [PathPoint(0, (2048, -1), (0, 0)), PathPoint(500, (2100, 1), (300, -300))]
    request = PointsRequest.of(7, 0x10002, points, last=True)
    assert request.serialize() == bytes.fromhex(
        "07 01 02 00 02  00 00 00 08 00 00 ff ff 00 00  f4 01 34 08 2c 01 01 00 d4 fe"
    )
    assert StartRequest(7, 0, 0x12345678).serialize() == bytes.fromhex("07 00 78 56 34 12")


@pytest.mark.parametrize(
    "value",
    [
        BeginRequest(1, 3, 0x55, 2000),
        BeginReply(1, PathState.LOADING, 64, 24),
        PathStatus(1, PathState.BRAKING, 65535, 3, 60, 2, 0xFFFFFFFF),
        StartRequest(1, 1, 0),
        StartReply(1, PathState.WAITING, 5),
        PointsRequest(1, 0, 5, 1, b"\1\2\3"),
    ],
)
def test_each_body_comes_back(value: BeginRequest) -> None:
    data = value.serialize()
    assert type(value).parse(data) == value
    for cut in range(len(data) if not isinstance(value, PointsRequest) else 5):
        with pytest.raises(RemoteProtocolError, match="bytes"):
            type(value).parse(data[:cut])


@pytest.mark.parametrize("kind", [BeginReply, PathStatus, StartReply])
def test_an_unknown_state_is_an_error(kind: type[BeginReply]) -> None:
    layout = {BeginReply: bodies._BEGIN_REPLY, PathStatus: bodies._STATUS, StartReply: bodies._START_REPLY}[kind]
    raw = bytearray(layout.size)
    raw[1] = 77
    with pytest.raises(RemoteProtocolError, match="77"):
        kind.parse(bytes(raw))


@given(st.data(), st.integers(1, 7), st.booleans())
def test_points_come_back(data: st.DataObject, joints: int, hermite: bool) -> None:
    count = st.integers(-32768, 32767)
    row = st.tuples(*[count] * joints)
    point = st.builds(PathPoint, st.integers(0, 65535), row, row if hermite else st.just(()))
    points = tuple(data.draw(st.lists(point, max_size=6)))
    raw = serialize_points(points)
    assert len(raw) == len(points) * point_size(joints, hermite=hermite)
    assert parse_points(raw, joints, hermite=hermite) == points


@given(st.binary(max_size=260), st.integers(-1, 8), st.booleans())
def test_hostile_points_have_one_outcome(raw: bytes, joints: int, hermite: bool) -> None:
    try:
        points = parse_points(raw, joints, hermite=hermite)
    except RemoteProtocolError:
        return
    assert serialize_points(points) == raw


def test_which_states_are_ends() -> None:
    ends = {state for state in PathState if state.over}
    assert ends == {PathState.DONE, PathState.DRY, PathState.ABORTED, PathState.STOPPED, PathState.FAULT}
