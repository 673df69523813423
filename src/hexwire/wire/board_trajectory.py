"""Bodies of the commands for a trajectory on the board, as frozen values (PROTOCOL.md section 6.7).

Owns their packing; `schema/commands.toml` is the source, and a test compares the two. Knows nothing of frames, of
joint names or SI units: positions are counts, velocities counts per second, times those of the wire.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import NamedTuple

from hexwire.errors import RemoteProtocolError

from .tables import (
    TRAJECTORY_FLAG_FINE,
    TRAJECTORY_FLAG_HERMITE,
    TRAJECTORY_FLAG_OUTLIVES_HOST,
    TRAJECTORY_STATES,
)

__all__ = [
    "POINTS_HEAD_SIZE",
    "POINT_TIME",
    "BeginReply",
    "BeginRequest",
    "PathFlag",
    "PathPoint",
    "PathState",
    "PathStatus",
    "PointsRequest",
    "StartReply",
    "StartRequest",
    "parse_points",
    "point_size",
    "serialize_points",
]

POINT_TIME = 1e-4
"""Seconds of one unit of a point's time."""

_BEGIN = struct.Struct("<BBHH")
_BEGIN_REPLY = struct.Struct("<BBHH")
_POINTS = struct.Struct("<BBHB")
POINTS_HEAD_SIZE = _POINTS.size
"""Bytes of TRAJECTORY_POINTS before the points."""
_STATUS = struct.Struct("<BBHHHHI")
_START = struct.Struct("<BBI")
_START_REPLY = struct.Struct("<BBI")


class PathState(IntEnum):
    """State of a board's trajectory."""

    NONE = TRAJECTORY_STATES["none"]
    LOADING = TRAJECTORY_STATES["loading"]
    WAITING = TRAJECTORY_STATES["waiting"]
    RUNNING = TRAJECTORY_STATES["running"]
    BRAKING = TRAJECTORY_STATES["braking"]
    DONE = TRAJECTORY_STATES["done"]
    DRY = TRAJECTORY_STATES["dry"]
    ABORTED = TRAJECTORY_STATES["aborted"]
    STOPPED = TRAJECTORY_STATES["stopped"]
    FAULT = TRAJECTORY_STATES["fault"]

    @property
    def over(self) -> bool:
        """It has ended."""
        return self >= PathState.DONE


class PathFlag(IntFlag):
    """Flags of TRAJECTORY_BEGIN."""

    HERMITE = TRAJECTORY_FLAG_HERMITE
    OUTLIVES_HOST = TRAJECTORY_FLAG_OUTLIVES_HOST
    FINE = TRAJECTORY_FLAG_FINE


def _unpack(name: str, layout: struct.Struct, body: bytes) -> tuple[int, ...]:
    if len(body) != layout.size:
        raise RemoteProtocolError(f"{name}: {len(body)} bytes instead of {layout.size}")
    return layout.unpack(body)


class BeginRequest(NamedTuple):
    """Body of TRAJECTORY_BEGIN."""

    id: int
    flags: int
    mask: int
    brake_ms: int

    def serialize(self) -> bytes:
        """Serialize the body."""
        return _BEGIN.pack(*self)

    @classmethod
    def parse(cls, body: bytes) -> BeginRequest:
        """Parse the body."""
        return cls(*_unpack("TRAJECTORY_BEGIN", _BEGIN, body))


class BeginReply(NamedTuple):
    """Reply to TRAJECTORY_BEGIN: points that fit, and how far ahead of the clock targets are sent."""

    id: int
    state: PathState
    capacity: int
    lead_ms: int

    def serialize(self) -> bytes:
        """Serialize the body."""
        return _BEGIN_REPLY.pack(*self)

    @classmethod
    def parse(cls, body: bytes) -> BeginReply:
        """Parse the body."""
        number, state, capacity, lead = _unpack("TRAJECTORY_BEGIN", _BEGIN_REPLY, body)
        return cls(number, _state(state), capacity, lead)


class PathPoint(NamedTuple):
    """A point of a path.

    Attributes:
        ticks: Time since the point before, in 0.1 ms; 0 for the first.
        positions: Counts, with the flag `FINE` eighths of a count, of the joints of the mask from the lowest bit
            on.
        velocities: Counts per second, of the same; empty without the flag `HERMITE`.
    """

    ticks: int
    positions: tuple[int, ...]
    velocities: tuple[int, ...] = ()


def point_size(joints: int, *, hermite: bool) -> int:
    """Bytes of a point of so many joints."""
    return 2 + joints * (4 if hermite else 2)


def serialize_points(points: Iterable[PathPoint]) -> bytes:
    """Points as they are in a body."""
    data = bytearray()
    for ticks, positions, velocities in points:
        data += ticks.to_bytes(2, "little")
        if velocities:
            both = [value for pair in zip(positions, velocities, strict=True) for value in pair]
            data += struct.pack(f"<{len(both)}h", *both)
        else:
            data += struct.pack(f"<{len(positions)}h", *positions)
    return bytes(data)


def parse_points(data: bytes, joints: int, *, hermite: bool) -> tuple[PathPoint, ...]:
    """Parse the points of a body.

    Raises:
        RemoteProtocolError: The length is not that of whole points.
    """
    size = point_size(joints, hermite=hermite)
    if joints <= 0 or len(data) % size:
        raise RemoteProtocolError(f"TRAJECTORY_POINTS: {len(data)} bytes are no whole points of {size}")
    row = struct.Struct(f"<H{(size - 2) // 2}h")
    if not hermite:
        return tuple(PathPoint(ticks, tuple(values)) for ticks, *values in row.iter_unpack(data))
    return tuple(PathPoint(ticks, tuple(v[::2]), tuple(v[1::2])) for ticks, *v in row.iter_unpack(data))


@dataclass(frozen=True, slots=True)
class PointsRequest:
    """Body of TRAJECTORY_POINTS; `data` as of `serialize_points`."""

    id: int
    last: int
    first: int
    count: int
    data: bytes

    @classmethod
    def of(cls, number: int, first: int, points: Sequence[PathPoint], *, last: bool) -> PointsRequest:
        """A request for these points."""
        return cls(number, int(last), first & 0xFFFF, len(points), serialize_points(points))

    def serialize(self) -> bytes:
        """Serialize the body."""
        return _POINTS.pack(self.id, self.last, self.first, self.count) + self.data

    @classmethod
    def parse(cls, body: bytes) -> PointsRequest:
        """Parse the body; the points themselves are not checked."""
        if len(body) < _POINTS.size:
            raise RemoteProtocolError(f"TRAJECTORY_POINTS: {len(body)} bytes, at least {_POINTS.size} are needed")
        number, last, first, count = _POINTS.unpack_from(body)
        return cls(number, last, first, count, bytes(body[_POINTS.size :]))


class PathStatus(NamedTuple):
    """Reply to TRAJECTORY_STATUS and TRAJECTORY_POINTS, as in PROTOCOL.md; `towards` is its `index`."""

    id: int
    state: PathState
    next: int
    towards: int
    free: int
    late: int
    time_us: int

    def serialize(self) -> bytes:
        """Serialize the body."""
        return _STATUS.pack(*self)

    @classmethod
    def parse(cls, body: bytes) -> PathStatus:
        """Parse the body."""
        number, state, *rest = _unpack("TRAJECTORY_STATUS", _STATUS, body)
        return cls(number, _state(state), *rest)


class StartRequest(NamedTuple):
    """Body of TRAJECTORY_START."""

    id: int
    now: int
    time_us: int

    def serialize(self) -> bytes:
        """Serialize the body."""
        return _START.pack(*self)

    @classmethod
    def parse(cls, body: bytes) -> StartRequest:
        """Parse the body."""
        return cls(*_unpack("TRAJECTORY_START", _START, body))


class StartReply(NamedTuple):
    """Reply to TRAJECTORY_START, with the time of the start on the board's clock."""

    id: int
    state: PathState
    time_us: int

    def serialize(self) -> bytes:
        """Serialize the body."""
        return _START_REPLY.pack(*self)

    @classmethod
    def parse(cls, body: bytes) -> StartReply:
        """Parse the body."""
        number, state, time_us = _unpack("TRAJECTORY_START", _START_REPLY, body)
        return cls(number, _state(state), time_us)


def _state(code: int) -> PathState:
    try:
        return PathState(code)
    except ValueError:
        raise RemoteProtocolError(f"the board's trajectory is in state {code}, which is unknown") from None
