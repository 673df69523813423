"""Bodies of the dialect-2 commands as frozen values.

Owns the packing of each body in PROTOCOL.md section 6; `schema/commands.toml` is the source, and a test compares
the two. Knows nothing of frames, joint names or SI units: the values are counts and codes.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from hexwire.errors import RemoteProtocolError

from .tables import (
    STATE_FIELD_AGE,
    STATE_FIELD_CURRENT,
    STATE_FIELD_LOAD,
    STATE_FIELD_SPEED,
    STATE_FIELD_TEMPERATURE,
    STATE_FIELD_VOLTAGE,
)

__all__ = [
    "AGE_NEVER",
    "ALL_FIELDS",
    "FRAGMENT_HEAD_SIZE",
    "STATS_FIELDS",
    "FragmentHead",
    "Identity",
    "JointReport",
    "JointRow",
    "LimitRow",
    "LimitTable",
    "MaintenanceReply",
    "MoveReply",
    "MoveRequest",
    "MoveRow",
    "OffsetRow",
    "OffsetTable",
    "SentRow",
    "Stats",
    "TransactRequest",
    "make_stop_reply",
    "parse_missing",
    "parse_stop_reply",
    "serialize_missing",
]

AGE_NEVER = 0xFFFF
"""Age of a joint that has not answered since the board started."""

ALL_FIELDS = (
    STATE_FIELD_SPEED
    | STATE_FIELD_LOAD
    | STATE_FIELD_VOLTAGE
    | STATE_FIELD_TEMPERATURE
    | STATE_FIELD_CURRENT
    | STATE_FIELD_AGE
)
_FIELD_ORDER = (
    (STATE_FIELD_SPEED, "h"),
    (STATE_FIELD_LOAD, "h"),
    (STATE_FIELD_VOLTAGE, "B"),
    (STATE_FIELD_TEMPERATURE, "b"),
    (STATE_FIELD_CURRENT, "h"),
    (STATE_FIELD_AGE, "H"),
)
_ROW_STRUCTS = tuple(
    struct.Struct("<hB" + "".join(code for bit, code in _FIELD_ORDER if mask & bit)) for mask in range(64)
)
_IDENTITY = struct.Struct("<4BIHHBB")
_IDENTITY_ROW = struct.Struct("<BBB")
_STATE_HEAD = struct.Struct("<IBBBB")
_MOVE_HEAD = struct.Struct("<HB")
_MOVE_ROW = struct.Struct("<Bh")
_SENT_ROW = struct.Struct("<BhB")
_LIMIT_ROW = struct.Struct("<hhH")
_OFFSET_ROW = struct.Struct("<hb")
_TABLE_HEAD = struct.Struct("<BB")
_MAINTENANCE_REPLY = struct.Struct("<BB")
_STOP_REPLY = struct.Struct("<BH")
_FRAGMENT = struct.Struct("<HHHBB")
_MISSING = struct.Struct("<HH")


def _rows_at(name: str, body: bytes, row: struct.Struct, offset: int, count: int) -> list[tuple[int, ...]]:
    if len(body) != offset + count * row.size:
        raise RemoteProtocolError(f"{name}: {len(body)} bytes do not hold {count} rows")
    return list(row.iter_unpack(body[offset:]))


def _need(name: str, body: bytes, size: int) -> None:
    if len(body) < size:
        raise RemoteProtocolError(f"{name}: {len(body)} bytes, at least {size} are needed")


class JointRow(NamedTuple):
    """One joint of an IDENTIFY reply: bus id, series code, and whether it answered last time."""

    servo_id: int
    series: int
    present: bool


class Identity(NamedTuple):
    """Reply to IDENTIFY."""

    protocol: int
    firmware: tuple[int, int, int]
    boot_id: int
    capabilities: int
    max_frame: int
    board_flags: int
    joints: tuple[JointRow, ...]

    def serialize(self) -> bytes:
        """Serialize the body."""
        head = _IDENTITY.pack(
            self.protocol,
            *self.firmware,
            self.boot_id,
            self.capabilities,
            self.max_frame,
            self.board_flags,
            len(self.joints),
        )
        return head + b"".join(_IDENTITY_ROW.pack(j.servo_id, j.series, j.present) for j in self.joints)

    @classmethod
    def parse(cls, body: bytes) -> Identity:
        """Parse the body; later firmware may send a longer head only with a higher protocol number."""
        _need("IDENTIFY", body, _IDENTITY.size)
        protocol, major, minor, patch, boot, caps, max_frame, flags, n = _IDENTITY.unpack_from(body)
        rows = _rows_at("IDENTIFY", body, _IDENTITY_ROW, _IDENTITY.size, n)
        joints = tuple(JointRow(i, series, bool(present)) for i, series, present in rows)
        return cls(protocol, (major, minor, patch), boot, caps, max_frame, flags, joints)


class JointReport(NamedTuple):
    """JOINT_STATE, as columns with one value per joint. A column that was not requested is None.

    Units are those of the wire: counts, counts/s, 0.1 % PWM, 0.1 V, deg C, mA, ms.
    """

    time_us: int
    board_flags: int
    position: tuple[int, ...]
    status: tuple[int, ...]
    speed: tuple[int, ...] | None = None
    load: tuple[int, ...] | None = None
    voltage: tuple[int, ...] | None = None
    temperature: tuple[int, ...] | None = None
    current: tuple[int, ...] | None = None
    age: tuple[int, ...] | None = None

    @property
    def fields(self) -> int:
        """Mask of the optional columns present."""
        mask = 0
        for (bit, _), column in zip(_FIELD_ORDER, self[4:], strict=True):
            if column is not None:
                mask |= bit
        return mask

    def serialize(self) -> bytes:
        """Serialize the body."""
        columns = [self.position, self.status, *(c for c in self[4:] if c is not None)]
        row = _ROW_STRUCTS[self.fields]
        head = _STATE_HEAD.pack(self.time_us, self.fields, self.board_flags, len(self.position), 0)
        return head + b"".join(row.pack(*values) for values in zip(*columns, strict=True))

    @classmethod
    def parse(cls, body: bytes) -> JointReport:
        """Parse the body."""
        if len(body) < 8:
            raise RemoteProtocolError(f"JOINT_STATE: {len(body)} bytes, at least 8 are needed")
        time_us, fields, flags, n, _ = _STATE_HEAD.unpack_from(body)
        if fields > ALL_FIELDS:
            raise RemoteProtocolError(f"JOINT_STATE: unknown fields 0x{fields:02X}")
        row = _ROW_STRUCTS[fields]
        if len(body) != 8 + n * row.size or n == 0:
            raise RemoteProtocolError(f"JOINT_STATE: {len(body)} bytes do not hold {n} rows")
        columns = list(zip(*row.iter_unpack(body[8:]), strict=True))
        if fields == ALL_FIELDS:
            return tuple.__new__(cls, (time_us, flags, *columns))
        wanted = iter(columns[2:])
        optional = [next(wanted) if fields & bit else None for bit, _ in _FIELD_ORDER]
        return tuple.__new__(cls, (time_us, flags, columns[0], columns[1], *optional))


class MoveRow(NamedTuple):
    """One target: bus id (0xFE for all) and position in counts."""

    servo_id: int
    position: int


class MoveRequest(NamedTuple):
    """Body of JOINT_MOVE."""

    duration_ms: int
    rows: tuple[MoveRow, ...]

    def serialize(self) -> bytes:
        """Serialize the body."""
        return _MOVE_HEAD.pack(self.duration_ms, len(self.rows)) + b"".join(_MOVE_ROW.pack(*r) for r in self.rows)

    @classmethod
    def parse(cls, body: bytes) -> MoveRequest:
        """Parse the body."""
        _need("JOINT_MOVE", body, _MOVE_HEAD.size)
        duration, n = _MOVE_HEAD.unpack_from(body)
        rows = _rows_at("JOINT_MOVE", body, _MOVE_ROW, _MOVE_HEAD.size, n)
        return cls(duration, tuple(MoveRow(*r) for r in rows))


class SentRow(NamedTuple):
    """One target as sent to the bus; `clamped` if it differs from the request."""

    servo_id: int
    position: int
    clamped: bool


class MoveReply(NamedTuple):
    """Reply to JOINT_MOVE: the targets that were sent."""

    duration_ms: int
    rows: tuple[SentRow, ...]

    def serialize(self) -> bytes:
        """Serialize the body."""
        return _MOVE_HEAD.pack(self.duration_ms, len(self.rows)) + b"".join(_SENT_ROW.pack(*r) for r in self.rows)

    @classmethod
    def parse(cls, body: bytes) -> MoveReply:
        """Parse the body."""
        _need("JOINT_MOVE reply", body, _MOVE_HEAD.size)
        duration, n = _MOVE_HEAD.unpack_from(body)
        rows = _rows_at("JOINT_MOVE reply", body, _SENT_ROW, _MOVE_HEAD.size, n)
        return cls(duration, tuple(SentRow(i, p, bool(flags & 1)) for i, p, flags in rows))


class LimitRow(NamedTuple):
    """Limits of one joint in counts and counts/s."""

    minimum: int
    maximum: int
    speed: int


class OffsetRow(NamedTuple):
    """Neutral count and sign (1 or -1) of one joint."""

    neutral: int
    sign: int


class LimitTable(NamedTuple):
    """Reply to LIMITS: one row per joint, with the version of the stored settings."""

    version: int
    rows: tuple[LimitRow, ...]

    def serialize(self) -> bytes:
        """Serialize the reply."""
        return _TABLE_HEAD.pack(self.version, len(self.rows)) + b"".join(_LIMIT_ROW.pack(*r) for r in self.rows)

    @staticmethod
    def serialize_request(rows: tuple[LimitRow, ...]) -> bytes:
        """Serialize a request that stores these rows."""
        return bytes([len(rows)]) + b"".join(_LIMIT_ROW.pack(*r) for r in rows)

    @staticmethod
    def parse_request(body: bytes) -> tuple[LimitRow, ...]:
        """Parse a request that stores rows."""
        _need("LIMITS", body, 1)
        return tuple(LimitRow(*r) for r in _rows_at("LIMITS", body, _LIMIT_ROW, 1, body[0]))

    @classmethod
    def parse(cls, body: bytes) -> LimitTable:
        """Parse a reply."""
        _need("LIMITS reply", body, 2)
        return cls(body[0], tuple(LimitRow(*r) for r in _rows_at("LIMITS reply", body, _LIMIT_ROW, 2, body[1])))


class OffsetTable(NamedTuple):
    """Reply to OFFSETS: one row per joint, with the version of the stored settings."""

    version: int
    rows: tuple[OffsetRow, ...]

    def serialize(self) -> bytes:
        """Serialize the reply."""
        return _TABLE_HEAD.pack(self.version, len(self.rows)) + b"".join(_OFFSET_ROW.pack(*r) for r in self.rows)

    @staticmethod
    def serialize_request(rows: tuple[OffsetRow, ...]) -> bytes:
        """Serialize a request that stores these rows."""
        return bytes([len(rows)]) + b"".join(_OFFSET_ROW.pack(*r) for r in rows)

    @staticmethod
    def parse_request(body: bytes) -> tuple[OffsetRow, ...]:
        """Parse a request that stores rows."""
        _need("OFFSETS", body, 1)
        return tuple(OffsetRow(*r) for r in _rows_at("OFFSETS", body, _OFFSET_ROW, 1, body[0]))

    @classmethod
    def parse(cls, body: bytes) -> OffsetTable:
        """Parse a reply."""
        _need("OFFSETS reply", body, 2)
        return cls(body[0], tuple(OffsetRow(*r) for r in _rows_at("OFFSETS reply", body, _OFFSET_ROW, 2, body[1])))


class TransactRequest(NamedTuple):
    """Body of TRANSACT: a servo packet, and the length and time-out of its answer."""

    reply_length: int
    timeout_ms: int
    packet: bytes

    def serialize(self) -> bytes:
        """Serialize the body."""
        return bytes([self.reply_length, self.timeout_ms]) + self.packet

    @classmethod
    def parse(cls, body: bytes) -> TransactRequest:
        """Parse the body."""
        _need("TRANSACT", body, 2)
        return cls(body[0], body[1], body[2:])


class MaintenanceReply(NamedTuple):
    """Reply to MAINTENANCE: whether it is on, and the board flags."""

    on: bool
    board_flags: int

    def serialize(self) -> bytes:
        """Serialize the body."""
        return _MAINTENANCE_REPLY.pack(*self)

    @classmethod
    def parse(cls, body: bytes) -> MaintenanceReply:
        """Parse the body."""
        if len(body) != _MAINTENANCE_REPLY.size:
            raise RemoteProtocolError(f"MAINTENANCE reply: {len(body)} bytes, not {_MAINTENANCE_REPLY.size}")
        on, flags = _MAINTENANCE_REPLY.unpack(body)
        return cls(bool(on), flags)


STATS_FIELDS = (
    "uptime_ms",
    "frames_received",
    "frames_sent",
    "bad_checks",
    "bad_frames",
    "resyncs",
    "bytes_dropped",
    "repeats",
    "bus_transactions",
    "bus_retries",
    "bus_timeouts",
    "bus_bad",
    "watchdog_trips",
    "queue_high_water",
    "loop_us_max",
)


class Stats(NamedTuple):
    """Reply to STATS: counters by name; unknown counters of a newer board are left out."""

    counters: dict[str, int]

    def serialize(self) -> bytes:
        """Serialize the body."""
        return struct.pack(
            f"<{len(STATS_FIELDS)}I", *(self.counters.get(name, 0) & 0xFFFFFFFF for name in STATS_FIELDS)
        )

    @classmethod
    def parse(cls, body: bytes) -> Stats:
        """Parse the body."""
        _need("STATS", body, 4)
        values = struct.unpack_from(f"<{len(body) // 4}I", body)
        return cls(dict(zip(STATS_FIELDS, values, strict=False)))


def make_stop_reply(mode: int, mask: int) -> bytes:
    """Serialize a TORQUE or STOP reply: the mode, and the mask of joints that confirmed it."""
    return _STOP_REPLY.pack(mode, mask)


def parse_stop_reply(body: bytes) -> tuple[int, int]:
    """Parse a TORQUE or STOP reply: the mode, and the mask of joints that confirmed it."""
    if len(body) != _STOP_REPLY.size:
        raise RemoteProtocolError(f"TORQUE or STOP reply: {len(body)} bytes, not {_STOP_REPLY.size}")
    mode, mask = _STOP_REPLY.unpack(body)
    return mode, mask


FRAGMENT_HEAD_SIZE = _FRAGMENT.size


class FragmentHead(NamedTuple):
    """Head of a FRAGMENT body: chunk `number` of `chunks`; the chunk follows."""

    message_id: int
    number: int
    chunks: int
    cmd: int
    cmd_ext: int

    def serialize(self) -> bytes:
        """Serialize the head, 8 bytes."""
        return _FRAGMENT.pack(*self)

    @classmethod
    def parse(cls, body: bytes) -> FragmentHead:
        """Parse the head; refuses a number outside the count."""
        _need("FRAGMENT", body, _FRAGMENT.size)
        head = cls(*_FRAGMENT.unpack_from(body))
        if head.number >= head.chunks:
            raise RemoteProtocolError(f"FRAGMENT: chunk {head.number} of {head.chunks}")
        return head


def serialize_missing(message_id: int, indexes: tuple[int, ...]) -> bytes:
    """Serialize FRAGMENT_MISSING; no indexes means that all chunks arrived."""
    return _MISSING.pack(message_id, len(indexes)) + struct.pack(f"<{len(indexes)}H", *indexes)


def parse_missing(body: bytes) -> tuple[int, tuple[int, ...]]:
    """Parse a FRAGMENT_MISSING body: the message id and the indexes of the chunks requested again."""
    _need("FRAGMENT_MISSING", body, _MISSING.size)
    message_id, count = _MISSING.unpack_from(body)
    if len(body) != _MISSING.size + 2 * count:
        raise RemoteProtocolError(f"FRAGMENT_MISSING: {len(body)} bytes do not hold {count} indexes")
    return message_id, struct.unpack_from(f"<{count}H", body, _MISSING.size)
