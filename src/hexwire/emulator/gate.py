"""The gate of a board: what a packet from the host may do to a servo now, and the packet that then goes to it.

Owns PROTOCOL.md section 6.4 as a pure function of the packet and of what the board knows: torque, limits, speed,
mode, stop, maintenance. Must not know the bus, frames or time; the board keeps the facts up to date and sends the
result.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, auto

from hexwire.errors import RemoteProtocolError
from hexwire.wire import tables
from hexwire.wire.command_frame import Status
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import (
    BROADCAST_ID,
    Instruction,
    ServoPacket,
    make_sync_write,
    make_write,
    parse_packet,
    parse_sync_write,
)

__all__ = [
    "MAX_REPLY",
    "READ_ONLY",
    "SPEED_UNIT",
    "Admitted",
    "Gate",
    "JointFacts",
    "RefusedError",
    "check_packet",
    "clamp",
    "speed_cap",
    "time_needed",
    "written_ids",
]

READ_ONLY = frozenset({Instruction.PING, Instruction.READ, Instruction.SYNC_READ})
"""Instructions that change nothing."""
MAX_REPLY = 120
"""Most bytes of answers that a board passes on."""
SPEED_UNIT = 50
"""Counts/s of one unit of an HLS servo's goal speed."""
MAX_RUN_TIME = 0xFFFF

_HLS = Series.HLS
_TORQUE = _HLS.register("torque_enable").address
_ACCELERATION = _HLS.register("acceleration").address
_TARGET = _HLS.register("goal_position").address
_CEILING = _HLS.register("goal_torque").address
_SPEED = _HLS.register("goal_speed").address
_BLOCK_END = _SPEED + 2
_RUN_TIME = Series.SEVEN_BOT.register("run_time").address
_LEGACY_END = _RUN_TIME + 2
_OTHER_RAM = (*range(_CEILING, _CEILING + 2), *range(0x30, 0x36))
_PAIRS = (_TARGET, _CEILING, _SPEED)
"""Two-byte values, which must be written as a whole."""
_REGISTERS = 0x100


class RefusedError(Exception):
    """A request is refused; the status says why."""

    def __init__(self, status: Status) -> None:
        super().__init__(status.name)
        self.status = status


@dataclass(frozen=True, slots=True)
class JointFacts:
    """What the board knows of a joint when it checks a packet.

    Attributes:
        legacy: A legacy servo: big-endian, with a run time instead of a speed.
        torque_on: It has torque.
        positioning: Its servo is in position mode.
        position: Counts; None if it is silent or was never sampled.
        late_ms: Age of the position of a moving joint, milliseconds; 0 for one at rest.
        ceiling: Current ceiling of an HLS servo; 0 is unknown.
        minimum: Lowest allowed position, counts.
        maximum: Highest allowed position, counts.
        speed: Highest allowed speed, counts/s.
        following: It follows a trajectory, which alone may give it targets.
    """

    legacy: bool
    torque_on: bool
    positioning: bool
    position: int | None
    late_ms: int
    ceiling: int
    minimum: int
    maximum: int
    speed: int
    following: bool = False


@dataclass(frozen=True, slots=True)
class Admitted:
    """What may go to the bus.

    Attributes:
        packets: One packet, or two for a sync write to servos of both kinds; the answer is that of the last.
        hold: Joints whose present position has to be written as their target first.
        torque: Torque switches that the packets set, by servo id.
        targets: Target positions that they write, by servo id.
    """

    packets: tuple[bytes, ...]
    hold: tuple[int, ...] = ()
    torque: Mapping[int, bool] = field(default_factory=dict)
    targets: Mapping[int, int] = field(default_factory=dict)


class _Kind(Enum):
    TORQUE = auto()
    TARGET = auto()
    MOTION = auto()
    RAM = auto()
    SETTING = auto()


def check_packet(data: bytes) -> ServoPacket:
    """Parse a packet of the host and check that it is well formed.

    Raises:
        RefusedError: It is not well formed: `bad_range`, whatever the board's state.
    """
    try:
        packet = parse_packet(data)
    except RemoteProtocolError:
        raise RefusedError(Status.BAD_RANGE) from None
    try:
        params = packet.params
        match packet.instruction:
            case Instruction.READ:
                sound = len(params) == 2 and 0 < params[1] <= MAX_REPLY - 6
            case Instruction.SYNC_READ:
                sound = len(params) > 2 and params[1] > 0 and (params[1] + 6) * (len(params) - 2) <= MAX_REPLY
            case Instruction.WRITE:
                sound = len(params) > 1 and params[0] + len(params) - 1 <= _REGISTERS
            case Instruction.SYNC_WRITE:
                address, rows = parse_sync_write(packet)
                ids = {servo_id for servo_id, _ in rows}
                sound = 0 < len(ids) == len(rows) and address + len(rows[0][1]) <= _REGISTERS
            case _:
                sound = True
    except RemoteProtocolError:
        sound = False
    if not sound:
        raise RefusedError(Status.BAD_RANGE)
    return packet


def written_ids(packet: ServoPacket) -> tuple[int, ...]:
    """Ids of the servos that a well-formed packet changes; `BROADCAST_ID` stands for all."""
    if packet.instruction in READ_ONLY:
        return ()
    if packet.instruction == Instruction.SYNC_WRITE:
        return tuple(servo_id for servo_id, _ in parse_sync_write(packet)[1])
    return (packet.servo_id,)


def clamp(joint: JointFacts, position: int) -> int:
    """Clamp a position to the joint's limits."""
    return min(max(position, joint.minimum), joint.maximum)


def time_needed(joint: JointFacts, position: int) -> int:
    """Milliseconds that a joint needs to reach a position at its speed limit."""
    if joint.position is None:
        return 0
    distance = abs(position - joint.position)
    # A moving joint may have gone further away since it was sampled, at its speed limit at most.
    return min(-(-distance * 1000 // max(joint.speed, 1)) + joint.late_ms, MAX_RUN_TIME)


def speed_cap(limit: int) -> int:
    """The highest goal speed of an HLS servo for a limit in counts/s; never 0, with which it would not move."""
    return max(limit // SPEED_UNIT, 1)


@dataclass(frozen=True, slots=True)
class Gate:
    """The gate in the board's present state.

    Attributes:
        joints: What is known of the joints, by servo id.
        chapter: The packet came in dialect 1.
        stopped: A stop is latched.
        maintenance: Settings may be written.
    """

    joints: Mapping[int, JointFacts]
    chapter: bool = False
    stopped: bool = False
    maintenance: bool = False

    def judge(self, packet: ServoPacket) -> Admitted:
        """Decide what of a well-formed packet may go to the bus.

        Raises:
            RefusedError: No part of it may.
        """
        if packet.instruction in READ_ONLY:
            return Admitted((packet.serialize(),))
        if self.stopped:
            raise RefusedError(Status.STOPPED)
        rows: tuple[tuple[int, bytes], ...]
        if packet.instruction == Instruction.WRITE:
            address, rows = packet.params[0], ((packet.servo_id, packet.params[1:]),)
        elif packet.instruction == Instruction.SYNC_WRITE:
            address, rows = parse_sync_write(packet)
        else:
            # A stop could not void a write that waits in a servo for ACTION. The other instructions reset or
            # recalibrate a servo, or are unknown.
            waits = packet.instruction in (Instruction.REG_WRITE, Instruction.ACTION)
            if waits or not self.maintenance:
                raise RefusedError(Status.FORBIDDEN)
            return Admitted((packet.serialize(),))
        torque: dict[int, bool] = {}
        targets: dict[int, int] = {}
        hold = []
        for servo_id, data in rows:
            self._check(servo_id, address, data)
            on = self._switches(address, data)
            if on is not None and servo_id in self.joints:
                torque[servo_id] = on
            elif on is not None and servo_id == BROADCAST_ID:
                torque.update(dict.fromkeys(self.joints, on))
            if _byte(address, data, _TORQUE) == 1:
                hold.append(servo_id)
            if _covers_target(address, data):
                at = _TARGET - address
                targets[servo_id] = _decode(self.joints[servo_id], data[at : at + 2])
        return Admitted(self._packets(packet, address, rows), tuple(hold), torque, targets)

    def _check(self, servo_id: int, address: int, data: bytes) -> None:
        """Refuse a write to one servo if it is not allowed."""
        joint = self.joints.get(servo_id)
        covered = range(address, address + len(data))
        if any((at in covered) != (at + 1 in covered) for at in _PAIRS):
            raise RefusedError(Status.BAD_RANGE)
        for at in covered:
            kind = _kind(at, legacy=joint is not None and joint.legacy)
            if kind is _Kind.TORQUE:
                self._check_torque(joint, data[at - address])
            elif kind is _Kind.TARGET:
                if at == _TARGET:
                    self._check_target(joint, data[at - address : at - address + 2])
            elif kind is _Kind.MOTION:
                if _TARGET not in covered:
                    raise RefusedError(Status.FORBIDDEN)
            elif kind is _Kind.RAM:
                if joint is None and not (servo_id == BROADCAST_ID and self.maintenance):
                    raise RefusedError(Status.FORBIDDEN)
            elif not self.maintenance:
                raise RefusedError(Status.FORBIDDEN)

    def _check_torque(self, joint: JointFacts | None, value: int) -> None:
        if value == 0:
            return
        if value > 1:
            if not self.maintenance:
                raise RefusedError(Status.FORBIDDEN)
            return
        if joint is None or self.maintenance or not self.chapter:
            raise RefusedError(Status.FORBIDDEN)
        if joint.following:
            raise RefusedError(Status.BUSY)
        if not joint.positioning:
            raise RefusedError(Status.SERVO_FAULT)
        if joint.position is None:
            raise RefusedError(Status.SERVO_SILENT)

    def _check_target(self, joint: JointFacts | None, data: bytes) -> None:
        if joint is None or self.maintenance:
            raise RefusedError(Status.FORBIDDEN)
        position = _decode(joint, data)
        if not joint.minimum <= position <= joint.maximum:
            raise RefusedError(Status.BAD_RANGE)
        if joint.following:
            raise RefusedError(Status.BUSY)
        if not joint.positioning:
            raise RefusedError(Status.SERVO_FAULT)
        if not (joint.torque_on or self.chapter):
            raise RefusedError(Status.TORQUE_OFF)
        if joint.position is None:
            raise RefusedError(Status.SERVO_SILENT)

    @staticmethod
    def _switches(address: int, data: bytes) -> bool | None:
        """The torque switch after a write; None if the write does not change it."""
        if _covers_target(address, data):
            # A target makes the servo switch its torque on.
            return True
        value = _byte(address, data, _TORQUE)
        return None if value is None else value == 1

    def _packets(self, packet: ServoPacket, address: int, rows: tuple[tuple[int, bytes], ...]) -> tuple[bytes, ...]:
        if not _covers_target(address, rows[0][1]):
            return (packet.serialize(),)
        blocks = [(servo_id, *self._block(self.joints[servo_id], address, data)) for servo_id, data in rows]
        if packet.instruction == Instruction.WRITE:
            return (make_write(*blocks[0]),)
        by_start: dict[int, dict[int, bytes]] = {}
        for servo_id, start, block in blocks:
            by_start.setdefault(start, {})[servo_id] = block
        return tuple(make_sync_write(start, group) for start, group in by_start.items())

    @staticmethod
    def _block(joint: JointFacts, address: int, data: bytes) -> tuple[int, bytes]:
        """Extend a row with a target to the whole block of its series, within the joint's speed limit."""
        at = _TARGET - address
        position = data[at : at + 2]
        needed = time_needed(joint, _decode(joint, position))
        if joint.legacy:
            run_time = Series.SEVEN_BOT.register("run_time")
            given = data[at + 2 : at + 4]
            asked = run_time.decode(given) if given else 0
            return _TARGET, position + run_time.encode(max(asked, needed))
        head = data[:at] if at else b"\0"
        if joint.late_ms:
            # A gentle ramp also brakes gently: a moving joint would overshoot its limit.
            head = head[:-1] + b"\0"
        ceiling, speed = _HLS.register("goal_torque"), _HLS.register("goal_speed")
        own_ceiling = data[at + 2 : at + 4] or ceiling.encode(joint.ceiling or tables.DEFAULT_CEILING)
        asked_speed = abs(speed.decode(data[at + 4 : at + 6])) if len(data) > at + 4 else 0
        most = speed_cap(joint.speed)
        own_speed = speed.encode(min(asked_speed or most, most))
        return min(address, _ACCELERATION), head + position + own_ceiling + own_speed + data[at + 6 :]


def _byte(address: int, data: bytes, at: int) -> int | None:
    """The byte that a write puts at an address; None if the write does not cover it."""
    return data[at - address] if address <= at < address + len(data) else None


def _covers_target(address: int, data: bytes) -> bool:
    return address <= _TARGET < address + len(data)


def _decode(joint: JointFacts, data: bytes) -> int:
    series = Series.SEVEN_BOT if joint.legacy else _HLS
    return series.register("target_position" if joint.legacy else "goal_position").decode(data)


def _kind(at: int, *, legacy: bool) -> _Kind:
    if at == _TORQUE:
        return _Kind.TORQUE
    if at in (_TARGET, _TARGET + 1):
        return _Kind.TARGET
    if legacy:
        return _Kind.MOTION if _RUN_TIME <= at < _LEGACY_END else _Kind.SETTING
    if at == _ACCELERATION or _SPEED <= at < _BLOCK_END:
        return _Kind.MOTION
    return _Kind.RAM if at in _OTHER_RAM else _Kind.SETTING
