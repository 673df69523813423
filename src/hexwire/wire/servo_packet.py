"""Servo packets: FF FF id len inst params chk, and the status packets that answer them.

Owns building, exact parsing and finding them in a byte stream. Knows no registers, no time and no series. The
quirks of answers are:

- A status packet starts FF FF (Feetech) or FF F5 (legacy servo, and every error the board makes itself).
- A legacy ping status has 6 bytes, with 6 in its length byte; a JOHO part has 2 there, which is correct. Both are
  accepted.
- Board errors are FF F5 FF 06 04 and FF F5 FF 06 07, FF F5 id 06 05, and FF F5 id 04 01 00 00: see
  `board_error_name`. From a legacy id the last two may also be the servo's own error bits.
  - The chapter's board exchanges value and checksum of a one-byte legacy read. The checksum still fits, so this
  module cannot detect it; see `undo_one_byte_swap`.
- The echo of a request is a valid status packet to the same id: remove it first (`strip_echo`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from enum import IntEnum
from functools import lru_cache
from struct import Struct, calcsize
from typing import Any, NamedTuple

from hexwire.errors import RemoteProtocolError, UsageError

from .tables import (
    BOARD_ERRORS,
    BROADCAST_ID,
    INSTRUCTIONS,
    LEGACY_HEADER,
    MAX_SERVO_ID,
    MAX_SERVO_PACKET,
    SERVO_HEADER,
)

__all__ = [
    "BOARD_ID",
    "BROADCAST_ID",
    "Instruction",
    "ServoPacket",
    "StatusPacket",
    "board_error_name",
    "find_status",
    "iter_packets",
    "iter_status",
    "make_action",
    "make_backup",
    "make_board_error",
    "make_calibrate",
    "make_legacy_ping_status",
    "make_packet",
    "make_ping",
    "make_read",
    "make_reboot",
    "make_reg_write",
    "make_reset_state",
    "make_restore",
    "make_status",
    "make_sync_read",
    "make_sync_write",
    "make_write",
    "parse_packet",
    "parse_status",
    "parse_sync_write",
    "status_end",
    "strip_echo",
    "sync_write_packer",
    "undo_one_byte_swap",
]

BOARD_ID = 0xFF
"""Id in errors of the board itself. No servo has it."""

_CHECKSUMS = tuple(bytes((~(total + 2) & 0xFF,)) for total in range(256))
"""Checksum by the low byte of the sum of the packet before it, with its header FF FF."""
_QUIRK_LENGTH = 6
_MAX_ERROR = 0x7F  # the vendor's SDK treats a higher error byte as noise
_MIN_PACKET = 6
_SYNC_WRITE = INSTRUCTIONS["SYNC_WRITE"]
_UNEQUAL = "a sync write needs the same number of bytes, at least one, for every servo"
_KNOWN = frozenset(INSTRUCTIONS.values())
_new = tuple.__new__


class Instruction(IntEnum):
    """Instruction codes of a request."""

    PING = INSTRUCTIONS["PING"]
    READ = INSTRUCTIONS["READ"]
    WRITE = INSTRUCTIONS["WRITE"]
    REG_WRITE = INSTRUCTIONS["REG_WRITE"]
    ACTION = INSTRUCTIONS["ACTION"]
    RESTORE = INSTRUCTIONS["RESTORE"]
    REBOOT = INSTRUCTIONS["REBOOT"]
    BACKUP = INSTRUCTIONS["BACKUP"]
    RESET_STATE = INSTRUCTIONS["RESET_STATE"]
    CALIBRATE = INSTRUCTIONS["CALIBRATE"]
    SYNC_READ = INSTRUCTIONS["SYNC_READ"]
    SYNC_WRITE = INSTRUCTIONS["SYNC_WRITE"]


class ServoPacket(NamedTuple):
    """A request to one servo or to all (id 0xFE)."""

    servo_id: int
    instruction: int
    params: bytes

    def serialize(self) -> bytes:
        """Serialize the packet."""
        return make_packet(self.servo_id, self.instruction, self.params)


class StatusPacket(NamedTuple):
    """An answer. `legacy`: its header is FF F5; `error`: the servo's status bits."""

    servo_id: int
    error: int
    params: bytes
    legacy: bool


# --- building ----------------------------------------------------------------------------------------------


def make_packet(servo_id: int, instruction: int, params: bytes = b"") -> bytes:
    """Build any request packet.

    Raises:
        UsageError: The id is outside 0..254, the instruction is not a byte, or the packet has more than 250 bytes.
    """
    if not 0 <= servo_id <= BROADCAST_ID:
        raise UsageError(f"servo id {servo_id} is outside 0..254 (254 = all)")
    if not 0 <= instruction <= 0xFF:
        raise UsageError(f"instruction {instruction} is not a byte")
    length = len(params) + 2
    if length + 4 > MAX_SERVO_PACKET:
        raise UsageError(f"a packet of {length + 4} bytes is too long; at most {MAX_SERVO_PACKET}")
    packet = SERVO_HEADER + bytes((servo_id, length, instruction)) + params
    return packet + _CHECKSUMS[sum(packet) & 0xFF]


def _address(address: int) -> int:
    if not 0 <= address <= 0xFF:
        raise UsageError(f"register address {address} is outside 0..255")
    return address


def _count(count: int) -> int:
    if not 1 <= count <= MAX_SERVO_PACKET - _MIN_PACKET:
        raise UsageError(f"cannot read {count} bytes; 1..{MAX_SERVO_PACKET - _MIN_PACKET} fit a packet")
    return count


def make_ping(servo_id: int) -> bytes:
    """Build PING, which a servo answers with an empty status packet."""
    return make_packet(servo_id, Instruction.PING)


def make_read(servo_id: int, address: int, count: int) -> bytes:
    """Build READ of `count` bytes from a register address. Legacy servos answer 2-byte reads only."""
    return make_packet(servo_id, Instruction.READ, bytes((_address(address), _count(count))))


def make_write(servo_id: int, address: int, data: bytes) -> bytes:
    """Build WRITE: `data` takes effect immediately."""
    return make_packet(servo_id, Instruction.WRITE, bytes((_address(address),)) + data)


def make_reg_write(servo_id: int, address: int, data: bytes) -> bytes:
    """Build REG_WRITE: `data` takes effect at ACTION."""
    return make_packet(servo_id, Instruction.REG_WRITE, bytes((_address(address),)) + data)


def make_action(servo_id: int = BROADCAST_ID) -> bytes:
    """Build ACTION: execute the pending REG_WRITE."""
    return make_packet(servo_id, Instruction.ACTION)


def make_restore(servo_id: int) -> bytes:
    """Build RESTORE: factory settings. A legacy servo also loses its id."""
    return make_packet(servo_id, Instruction.RESTORE)


def make_reboot(servo_id: int) -> bytes:
    """Build REBOOT: no answer, and silence for about 800 ms (STS/SMS and HLS)."""
    return make_packet(servo_id, Instruction.REBOOT)


def make_backup(servo_id: int) -> bytes:
    """Build BACKUP: store the present settings (STS/SMS and HLS)."""
    return make_packet(servo_id, Instruction.BACKUP)


def make_reset_state(servo_id: int) -> bytes:
    """Build RESET_STATE: clear the turn counter (STS/SMS and HLS)."""
    return make_packet(servo_id, Instruction.RESET_STATE)


def make_calibrate(servo_id: int, position: bytes | None = None) -> bytes:
    """Build CALIBRATE: the present position becomes 2048, or the given one.

    Args:
        servo_id: Bus id.
        position: Two bytes in the servo's order; only for firmware that accepts one (STS 3.10, HLS 3.43 and later).
    """
    if position is not None and len(position) != 2:
        raise UsageError(f"a calibration position has 2 bytes, not {len(position)}")
    return make_packet(servo_id, Instruction.CALIBRATE, position or b"")


@lru_cache(maxsize=256)
def _checked_ids(listed: tuple[int, ...]) -> bytes:
    if not listed:
        raise UsageError("a sync packet needs at least one servo id")
    if len(set(listed)) != len(listed):
        raise UsageError("a servo id occurs twice in one sync packet")
    for servo_id in listed:
        if not 0 <= servo_id <= MAX_SERVO_ID:
            raise UsageError(f"servo id {servo_id} is outside 0..{MAX_SERVO_ID}")
    return bytes(listed)


def make_sync_read(address: int, count: int, ids: Iterable[int]) -> bytes:
    """Build SYNC_READ: the servos answer in the order of `ids` (STS/SMS and HLS only)."""
    head = bytes((_address(address), _count(count)))
    return make_packet(BROADCAST_ID, Instruction.SYNC_READ, head + _checked_ids(tuple(ids)))


def make_sync_write(address: int, data: Mapping[int, bytes] | Iterable[tuple[int, bytes]]) -> bytes:
    """Build SYNC_WRITE: data of the same length for several servos. Never answered.

    Args:
        address: First register address, the same for all.
        data: Bytes by id, in the byte order of each servo.
    """
    if not isinstance(data, dict):
        data = list(data.items()) if isinstance(data, Mapping) else list(data)
        ids, rows = tuple([servo_id for servo_id, _ in data]), [values for _, values in data]
    else:
        ids, rows = tuple(data), list(data.values())
    fields, pack = _sync_write(address, ids, len(rows[0]) if rows else 0)
    if set(map(len, rows)) != {len(rows[0])}:
        raise UsageError(_UNEQUAL)
    fields = fields.copy()
    fields[1::2] = rows
    return pack(*fields)


@lru_cache(maxsize=256)
def _sync_write(address: int, ids: tuple[int, ...], size: int) -> tuple[list[Any], Callable[..., bytes]]:
    """What is the same in each SYNC_WRITE of some registers of some servos: the fields, and what packs them."""
    _checked_ids(ids)
    if not size:
        raise UsageError(_UNEQUAL)
    fields: list[Any] = []
    for servo_id in ids:
        fields += servo_id, b""
    return fields, sync_write_packer(address, f"<B{size}s", len(ids))


def sync_write_packer(address: int, row: str, count: int) -> Callable[..., bytes]:
    """What packs a SYNC_WRITE of the same registers of several servos, for loops that send it again and again.

    Args:
        address: First register address.
        row: Byte order and fields of one servo, as in `struct`: its id of one byte, then its registers.
        count: Number of servos.

    Returns:
        A function of the fields of one servo after the other.
    """
    size = calcsize(row) - 1
    length = count * (size + 1) + 4
    if length + 4 > MAX_SERVO_PACKET:
        raise UsageError(f"a packet of {length + 4} bytes is too long; at most {MAX_SERVO_PACKET}")
    head = SERVO_HEADER + bytes((BROADCAST_ID, length, _SYNC_WRITE, _address(address), size))
    pack = Struct(f"{row[0]}{len(head)}s" + row[1:] * count).pack

    def packed(*fields: Any) -> bytes:
        packet = pack(head, *fields)
        return packet + _CHECKSUMS[sum(packet) & 0xFF]

    return packed


def make_status(servo_id: int, error: int = 0, params: bytes = b"", *, legacy: bool = False) -> bytes:
    """Build a status packet.

    Args:
        servo_id: Id of the answering servo.
        error: Status bits.
        params: Parameter bytes, in the servo's byte order.
        legacy: Start with FF F5 instead of FF FF.
    """
    if not 0 <= servo_id <= 0xFF or not 0 <= error <= 0xFF:
        raise UsageError(f"id {servo_id} or error {error} is not a byte")
    if len(params) > MAX_SERVO_PACKET - _MIN_PACKET:
        raise UsageError(f"{len(params)} parameters do not fit a status packet")
    body = bytes((servo_id, len(params) + 2, error)) + params
    return (LEGACY_HEADER if legacy else SERVO_HEADER) + body + bytes((~sum(body) & 0xFF,))


def make_legacy_ping_status(servo_id: int, error: int = 0) -> bytes:
    """Build the ping answer of a legacy servo: 6 bytes, with 6 in the length byte."""
    body = bytes((servo_id, _QUIRK_LENGTH, error))
    return LEGACY_HEADER + body + bytes((~sum(body) & 0xFF,))


def make_board_error(code: int, servo_id: int = BOARD_ID) -> bytes:
    """Build an error packet as that board does.

    Args:
        code: A value of `tables.BOARD_ERRORS`. "read_silent" is 8 bytes long, the others 6.
        servo_id: The servo that the error concerns, or 0xFF.

    Raises:
        UsageError: The board has no such code.
    """
    if code == BOARD_ERRORS["read_silent"]:
        return make_status(servo_id, code, b"\x00\x00", legacy=True)
    if code not in BOARD_ERRORS.values():
        raise UsageError(f"the board has no error code {code}")
    return make_legacy_ping_status(servo_id, code)


# --- exact parsing -----------------------------------------------------------------------------------------


def parse_packet(data: bytes) -> ServoPacket:
    """Parse the bytes of exactly one request.

    Raises:
        RemoteProtocolError: Header, length, checksum or id is wrong; the text says which.
    """
    if len(data) < _MIN_PACKET:
        raise RemoteProtocolError(f"servo packet of {len(data)} bytes; the shortest has {_MIN_PACKET}")
    if data[:2] != SERVO_HEADER:
        raise RemoteProtocolError(f"servo packet starts with {bytes(data[:2]).hex(' ')}, not ff ff")
    if data[3] != len(data) - 4:
        raise RemoteProtocolError(f"length byte of a servo packet says {data[3]}, but {len(data) - 4} follow it")
    _verify(data)
    if data[2] > BROADCAST_ID:
        raise RemoteProtocolError("servo packet to id 255, which no servo has")
    return ServoPacket(data[2], data[4], bytes(data[5:-1]))


def parse_status(data: bytes, *, as_it_is: bool = False) -> StatusPacket:
    """Parse the bytes of exactly one status packet, quirks included.

    Args:
        data: Its bytes.
        as_it_is: Accept an invalid id and reserved error bits, to display what was on the line.

    Raises:
        RemoteProtocolError: Header, length, checksum, id or error byte is wrong; the text says which.
    """
    if len(data) < _MIN_PACKET:
        raise RemoteProtocolError(f"status packet of {len(data)} bytes; the shortest has {_MIN_PACKET}")
    legacy = data[:2] == LEGACY_HEADER
    if not legacy and data[:2] != SERVO_HEADER:
        raise RemoteProtocolError(f"status packet starts with {bytes(data[:2]).hex(' ')}, not ff ff or ff f5")
    quirk = legacy and len(data) == _QUIRK_LENGTH == data[3]
    if data[3] != len(data) - 4 and not quirk:
        raise RemoteProtocolError(f"length byte of a status packet says {data[3]}, but {len(data) - 4} follow it")
    _verify(data)
    if as_it_is:
        return StatusPacket(data[2], data[4], bytes(data[5:-1]), legacy)
    if data[2] > MAX_SERVO_ID and not (legacy and data[2] == BOARD_ID):
        raise RemoteProtocolError(f"status packet from id {data[2]}, which no servo has")
    if data[4] > _MAX_ERROR:
        raise RemoteProtocolError(f"status packet with reserved error bits set: {data[4]:#04x}")
    return StatusPacket(data[2], data[4], bytes(data[5:-1]), legacy)


def _verify(data: bytes) -> None:
    want = ~sum(data[2:-1]) & 0xFF
    if data[-1] != want:
        raise RemoteProtocolError(f"checksum is {data[-1]:02x}, should be {want:02x}")


def parse_sync_write(packet: ServoPacket) -> tuple[int, tuple[tuple[int, bytes], ...]]:
    """Parse a SYNC_WRITE: the address, and (id, data) of each servo.

    Raises:
        RemoteProtocolError: It is another instruction, or its rows are incomplete.
    """
    if packet.instruction != Instruction.SYNC_WRITE:
        raise RemoteProtocolError(f"instruction {packet.instruction:#04x} is not a sync write")
    params = packet.params
    if len(params) < 2 or not params[1] or (len(params) - 2) % (params[1] + 1):
        raise RemoteProtocolError("a sync write ends within a row")
    step = params[1] + 1
    rows = tuple((params[i], params[i + 1 : i + step]) for i in range(2, len(params), step))
    return params[0], rows


# --- finding in a stream -----------------------------------------------------------------------------------


def find_status(
    data: bytes, servo_id: int, n_params: int | None, start: int = 0
) -> tuple[StatusPacket, int] | None:
    """Find the first status packet of one servo among other bytes. Never raises.

    Args:
        data: The received bytes.
        servo_id: Id of the answering servo; `BOARD_ID` for errors of the board itself.
        n_params: Number of parameters it must have; None accepts any number.
        start: Offset at which to begin.

    Returns:
        The packet and the offset after it, or None.
    """
    # Only candidates with this id count, so that noise that looks like another servo's packet cannot hide the
    # answer.
    data = bytes(data)
    at = data.find(b"\xff", start)
    while 0 <= at <= len(data) - _MIN_PACKET:
        if data[at + 2] == servo_id:
            end = status_end(data, at, n_params)
            if end and n_params in (None, end - at - _MIN_PACKET):
                return _status(data, at, end), end
        at = data.find(b"\xff", at + 1)
    return None


def iter_status(data: bytes) -> Iterator[StatusPacket]:
    """Yield all status packets of a byte stream in order, and skip other bytes. Never raises."""
    # One `find` for the next FF and constant work per candidate: linear in the length of any noise.
    data = bytes(data)
    find, last = data.find, len(data) - _MIN_PACKET
    at = find(b"\xff")
    while 0 <= at <= last:
        end = status_end(data, at)
        if end:
            yield _status(data, at, end)
            at = find(b"\xff", end)
        else:
            at = find(b"\xff", at + 1)


def status_end(data: bytes, at: int, n_params: int | None = None) -> int:
    """Return the offset after the valid status packet that starts at `at`; 0 without one.

    Args:
        data: The received bytes; at least 6 from `at` on.
        at: Offset of the packet.
        n_params: Number of parameters requested: a legacy answer with four may begin like that to a ping.
    """
    second = data[at + 1]
    if second != 0xFF and second != 0xF5:
        return 0
    servo_id, length, error = data[at + 2 : at + 5]
    if error > _MAX_ERROR or (servo_id > MAX_SERVO_ID and (second == 0xFF or servo_id != BOARD_ID)):
        return 0
    end = at + 4 + length
    whole = length > 1 and end <= len(data) and sum(data[at + 2 : end]) & 0xFF == 0xFF
    if second == 0xF5 and length == _QUIRK_LENGTH and not (whole and n_params == _QUIRK_LENGTH - 2):
        ping = sum(data[at + 2 : at + _QUIRK_LENGTH]) & 0xFF == 0xFF
        return at + _QUIRK_LENGTH if ping else end if whole else 0
    return end if whole else 0


def _status(data: bytes, at: int, end: int) -> StatusPacket:
    # tuple.__new__ skips the Python-level constructor, which doubles the cost of a packet.
    return _new(StatusPacket, (data[at + 2], data[at + 4], data[at + 5 : end - 1], data[at + 1] == 0xF5))


def iter_packets(data: bytes) -> Iterator[ServoPacket]:
    """Yield all requests with a known instruction in a byte stream, and skip other bytes. Never raises."""
    data = bytes(data)
    last = len(data) - _MIN_PACKET
    at = data.find(SERVO_HEADER)
    while 0 <= at <= last:
        servo_id, length, instruction = data[at + 2 : at + 5]
        end = at + 4 + length
        if (
            servo_id <= BROADCAST_ID
            and instruction in _KNOWN
            and length > 1
            and end <= last + _MIN_PACKET
            and sum(data[at + 2 : end]) & 0xFF == 0xFF
        ):
            yield ServoPacket(servo_id, instruction, data[at + 5 : end - 1])
            at = data.find(SERVO_HEADER, end)
        else:
            at = data.find(SERVO_HEADER, at + 1)


def strip_echo(data: bytes, request: bytes) -> bytes:
    """Remove the echo of a request that a one-wire adapter makes.

    Bytes before the echo are older than the request, so they are removed too. Without an echo the bytes are
    returned unchanged. An answer identical to its request (such as a ping answered with error 1) cannot be
    distinguished from an echo and is removed.
    """
    at = data.find(request) if request else -1
    return data if at < 0 else data[at + len(request) :]


def undo_one_byte_swap(data: bytes) -> bytes:
    """Correct a one-byte legacy read whose value and checksum were exchanged (see above).

    A sum does not depend on the order of its terms, so the exchanged bytes have a valid checksum and do not
    show the exchange. Use this only for answers of a legacy servo through a dialect-1 board; better, read two
    registers. Anything but 7 bytes FF F5 id 03 error x y is returned unchanged.
    """
    if len(data) == 7 and data[:2] == LEGACY_HEADER and data[3] == 3:
        return data[:5] + bytes((data[6], data[5]))
    return data


# --- errors of the board -----------------------------------------------------------------------------------


def board_error_name(status: StatusPacket) -> str | None:
    """Return the board error that a status packet may be, a key of `tables.BOARD_ERRORS`, or None.

    From the id of a legacy servo, "read_silent" and "ping_silent" may also be the servo's own status bits: the
    bytes are the same. Treat them as "no answer" unless the value excludes it.
    """
    if not status.legacy or not status.error:
        return None
    if status.error == BOARD_ERRORS["read_silent"]:
        return "read_silent" if status.params == b"\x00\x00" else None
    if status.params:
        return None
    if status.error == BOARD_ERRORS["ping_silent"]:
        return "ping_silent"
    if status.servo_id == BOARD_ID:
        return next((name for name, code in BOARD_ERRORS.items() if code == status.error), None)
    return None
