"""The whole frame: session header, command header, body, check, pad and tail.

Owns the frame as a value, the layout of both dialects and the rules for a valid frame. Knows nothing of streams:
`session.decoder` finds frames among other bytes and calls `examine` here.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

from hexwire.errors import LocalProtocolError, RemoteProtocolError

from . import tables
from .addresses import destination_name
from .modules import module_name
from .tables import (
    EXT_REPLY,
    EXT_STATUS_MASK,
    EXT_UNSOLICITED,
    FRAME_FLAG,
    FRAME_OVERHEAD,
    HEADER_SIZE,
    MAX_NETWORK_FRAME,
    PROTO_CHAPTER,
    PROTO_HEXWIRE,
    SYNC,
    SYNC_BYTES,
    TAIL,
    UNCHECKED,
)

__all__ = [
    "BODY_OFFSET",
    "Command",
    "Frame",
    "Status",
    "command_name",
    "examine",
    "frame_check",
    "max_body",
    "parse_frame",
    "serialize_frame",
    "status_name",
]


def frame_check(data: bytes | bytearray | memoryview) -> int:
    """Compute the check field of a dialect-2 frame, from byte 0 to the end of the body.

    CRC-16/IBM-3740: poly 1021, init FFFF, not reflected, no final xor. FFFF means "not checked" on
    the wire, so a CRC of FFFF is sent as 0000.
    """
    crc = crc_hqx(data, 0xFFFF)
    return 0 if crc == 0xFFFF else crc


BODY_OFFSET = HEADER_SIZE + 8
_HEAD = struct.Struct("<IIIIiiiIBBBBHBB")
_pack_head = _HEAD.pack
_unpack_head = _HEAD.unpack_from
_pack_check = struct.Struct("<H").pack
_PADS = tuple(bytes([tables.PAD_BYTE]) * n + TAIL for n in range(4))


class Command(IntEnum):
    """Command codes; 1 to 3 are the chapter's, the rest are dialect 2."""

    PING = 0x01
    READ = 0x02
    SYNC_WRITE = 0x03
    IDENTIFY = 0x10
    JOINT_STATE = 0x11
    REPORT = 0x12
    JOINT_MOVE = 0x13
    TORQUE = 0x14
    STOP = 0x15
    RESUME = 0x16
    WATCHDOG = 0x17
    LIMITS = 0x18
    OFFSETS = 0x19
    TRANSACT = 0x1A
    STATS = 0x1B
    FRAGMENT = 0x1C
    FRAGMENT_MISSING = 0x1D
    IO = 0x1E
    MAINTENANCE = 0x1F
    TRAJECTORY_BEGIN = 0x20
    TRAJECTORY_POINTS = 0x21
    TRAJECTORY_START = 0x22
    TRAJECTORY_STATUS = 0x23
    TRAJECTORY_ABORT = 0x24
    HOST_BAUD = 0x25
    SERVO_TABLE = 0x26
    ROBOT_PROBE = 0x30
    ROBOT_SIGNAL = 0x31
    ROBOT_MODE = 0x32
    JOINT_COMMANDS = 0x33
    JOINT_STATES = 0x34
    JOINT_TRAJECTORY = 0x35
    JOYSTICK = 0x38


class Status(IntEnum):
    """Status codes of dialect-2 replies."""

    OK = 0
    BAD_LENGTH = 1
    BAD_RANGE = 2
    UNKNOWN_COMMAND = 3
    BUSY = 4
    STOPPED = 5
    SERVO_SILENT = 6
    SERVO_FAULT = 7
    TORQUE_OFF = 8
    STORAGE = 9
    NOT_SUPPORTED = 10
    FORBIDDEN = 11
    UNREACHABLE = 12


_COMMAND_NAMES = {c.value: c.name for c in Command}
_STATUS_NAMES = {s.value: s.name.lower().replace("_", " ") for s in Status}


def command_name(code: int) -> str:
    """Return the name of a command code, or ``command 0x7F`` for an unknown one."""
    return _COMMAND_NAMES.get(code) or f"command 0x{code:02X}"


def status_name(code: int) -> str:
    """Return the name of a status code, or ``status 42`` for an unknown one."""
    return _STATUS_NAMES.get(code) or f"status {code}"


class Frame(NamedTuple):
    """One whole frame, as `serialize_frame` takes it and the decoder returns it. Equal if all fields are.

    Values that follow from the fields (lengths, pad, check) are not stored. A flat tuple, because programs make
    a hundred thousand per second.

    Attributes:
        time_sec: Whole seconds of the sender's clock.
        time_nsec: Nanoseconds; the chapter's board sometimes sends 1,000,000,000 of them.
        sn: The sender's frame counter.
        src: Module id of the sender.
        dst: Module id of the receiver.
        type: 3 from a host on a serial line, 8 from a board; over datagrams the number of the conversation.
        proto: Dialect, 1 or 2.
        seq: Command counter; a reply in dialect 2 has that of its request.
        cmd: Command code.
        body: Bytes of the body.
        cmd_ext: Flags and status, in dialect 2.
    """

    time_sec: int
    time_nsec: int
    sn: int
    src: int
    dst: int
    type: int
    proto: int
    seq: int
    cmd: int
    body: bytes
    cmd_ext: int = 0

    @property
    def size(self) -> int:
        """Bytes of the whole frame."""
        return FRAME_OVERHEAD + (len(self.body) + 3 & ~3)

    @property
    def time(self) -> float:
        """The sender's clock in seconds."""
        return self.time_sec + self.time_nsec / 1e9

    @property
    def is_reply(self) -> bool:
        """Whether a dialect-2 frame answers a request."""
        return bool(self.cmd_ext & EXT_REPLY)

    @property
    def is_unsolicited(self) -> bool:
        """Whether a dialect-2 frame is unsolicited."""
        return bool(self.cmd_ext & EXT_UNSOLICITED)

    @property
    def status(self) -> int:
        """Status code of a dialect-2 reply."""
        return self.cmd_ext & EXT_STATUS_MASK

    def __str__(self) -> str:
        """One short line; never raises, whatever the fields hold."""
        kind = ""
        if self.proto == PROTO_HEXWIRE:
            if self.is_reply:
                kind = f" reply {status_name(self.status)}"
            elif self.is_unsolicited:
                kind = " report"
        dst = destination_name(self.dst) if self.proto == PROTO_HEXWIRE else module_name(self.dst)
        text = (
            f"#{self.sn} {module_name(self.src)} -> {dst} "
            f"dialect {self.proto} seq {self.seq} {command_name(self.cmd)}{kind} {len(self.body)} bytes"
        )
        return text if len(self.body) == 0 else f"{text}: {self.body[:16].hex(' ').upper()}"


def max_body(max_frame: int) -> int:
    """Longest body, in bytes, that fits a frame of `max_frame` bytes with its padding."""
    return (max_frame - FRAME_OVERHEAD) & ~3


def serialize_frame(frame: Frame, max_frame: int = MAX_NETWORK_FRAME) -> bytes:
    """Build a frame's bytes; the check is FF FF in dialect 1 and the CRC in dialect 2.

    Raises:
        LocalProtocolError: The frame would be longer than `max_frame`.
    """
    sec, nsec, sn, src, dst, kind, proto, seq, cmd, body, ext = frame
    length = len(body)
    pad = -length & 3
    size = FRAME_OVERHEAD + length + pad
    if size > max_frame:
        raise LocalProtocolError(f"{command_name(cmd)} needs a frame of {size} bytes, the line takes {max_frame}")
    data = (
        _pack_head(SYNC, sec, nsec, sn, src, dst, kind, size, FRAME_FLAG, proto, seq, pad, length, cmd, ext) + body
    )
    check = frame_check(data) if proto == PROTO_HEXWIRE else UNCHECKED
    return data + _pack_check(check) + _PADS[pad]


_new_frame: Callable[..., Frame] = tuple.__new__


def examine(data: bytes, start: int, max_frame: int) -> Frame | str | int:
    """Check the bytes at `start`, which begin with the sync word.

    Returns:
        A `Frame` if the bytes hold a whole valid frame; a reason (str) that starts with ``head:`` if the header is
        invalid, or with other words if a whole frame is invalid; else the number of bytes (int) needed for the next
        check.
    """
    available = len(data) - start
    if available < BODY_OFFSET:
        return BODY_OFFSET
    size: int
    (_, sec, nsec, sn, src, dst, kind, size, flag, proto, seq, pad, length, cmd, ext) = _unpack_head(data, start)
    if size > max_frame or flag != FRAME_FLAG:
        return f"head: size {size} is over {max_frame}" if size > max_frame else f"head: flag 0x{flag:02X}"
    if size != FRAME_OVERHEAD + length + pad or pad != -length & 3:
        return f"head: size {size} does not fit length {length} and pad {pad}"
    if proto != PROTO_HEXWIRE and proto != PROTO_CHAPTER:
        return f"head: unknown dialect {proto}"
    if available < size:
        return size
    body_end = start + BODY_OFFSET + length
    end = start + size
    if data[end - 2 : end] != TAIL:
        return f"tail is {data[end - 2 : end].hex(' ').upper()}, not 0D 0A"
    check = data[body_end] | data[body_end + 1] << 8
    if proto == PROTO_HEXWIRE:
        expected = crc_hqx(data[start:body_end], 0xFFFF)
        if (check != expected and (expected != UNCHECKED or check != 0)) or check == UNCHECKED:
            return f"check is {check:04X}, not {0 if expected == UNCHECKED else expected:04X}"
    return _new_frame(
        Frame,
        (
            sec,
            nsec,
            sn,
            src,
            dst,
            kind,
            proto,
            seq,
            cmd,
            data[start + BODY_OFFSET : body_end],
            ext,
        ),
    )


def parse_frame(data: bytes, max_frame: int = MAX_NETWORK_FRAME) -> Frame:
    """Parse exactly one frame.

    Raises:
        RemoteProtocolError: The bytes are not one valid frame; the text says why.
    """
    if data[:4] != SYNC_BYTES:
        raise RemoteProtocolError(f"no sync word: {data[:4].hex(' ').upper() or 'no bytes'}")
    result = examine(data, 0, max_frame)
    if isinstance(result, int):
        raise RemoteProtocolError(f"cut short: {len(data)} of {result} bytes")
    if isinstance(result, str):
        raise RemoteProtocolError(result.removeprefix("head: "))
    if len(data) != result.size:
        raise RemoteProtocolError(f"{len(data) - result.size} bytes after the frame")
    return result
