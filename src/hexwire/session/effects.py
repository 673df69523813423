"""Effect of a request on an arm: whether a stop must cancel it, and whether it is a stop itself.

Owns the classification by command and body. No I/O and no time.
"""

from __future__ import annotations

from enum import Enum

from hexwire.wire.command_frame import Command
from hexwire.wire.servo_packet import Instruction
from hexwire.wire.servo_table import TABLE_HEAD_SIZE
from hexwire.wire.tables import PROTO_CHAPTER

__all__ = ["Effect", "effect_of", "packet_only_reads"]

_NEUTRAL = frozenset(
    (
        Command.IDENTIFY,
        Command.JOINT_STATE,
        Command.REPORT,
        Command.WATCHDOG,
        Command.STATS,
        Command.HOST_BAUD,
        Command.TRAJECTORY_STATUS,
        Command.ROBOT_PROBE,
        Command.JOINT_STATES,
        Command.JOYSTICK,
    )
)
_READS = frozenset((Instruction.PING, Instruction.READ, Instruction.SYNC_READ))
_INSTRUCTION = 4
_TRANSACT_HEAD = 2


class Effect(Enum):
    """Effect of a request."""

    NONE = "reads, feeds the watchdog, or keeps the line"
    ACT = "moves, switches or sets something"
    FREE = "switches torque off"
    STOP = "stops"
    RESUME = "ends a stop"


_SIGNALS = {1: Effect.STOP, 2: Effect.STOP, 3: Effect.RESUME, 5: Effect.FREE}


def effect_of(dialect: int, cmd: int, body: bytes) -> Effect:
    """Return the effect of a request; an unknown request acts."""
    if cmd in (Command.PING, Command.READ):
        return Effect.NONE if packet_only_reads(body) else Effect.ACT
    if dialect == PROTO_CHAPTER:
        # IDENTIFY checks whether the board speaks dialect 2.
        return Effect.NONE if cmd == Command.IDENTIFY else Effect.ACT
    if cmd in _NEUTRAL or (cmd in (Command.LIMITS, Command.OFFSETS) and not body):
        return Effect.NONE
    if cmd == Command.STOP:
        return Effect.STOP
    if cmd == Command.RESUME:
        return Effect.RESUME
    if cmd == Command.ROBOT_SIGNAL:
        return _SIGNALS.get(body[0], Effect.ACT) if body else Effect.ACT
    if cmd == Command.TORQUE and body[:1] == b"\0":
        return Effect.FREE
    if cmd == Command.IO and body[:1] == b"\0":
        return Effect.NONE
    if cmd == Command.SERVO_TABLE and len(body) == TABLE_HEAD_SIZE:
        return Effect.NONE
    if cmd == Command.TRANSACT and packet_only_reads(body[_TRANSACT_HEAD:]):
        return Effect.NONE
    return Effect.ACT


def packet_only_reads(packet: bytes) -> bool:
    """Whether a servo packet only reads."""
    return len(packet) > _INSTRUCTION and packet[_INSTRUCTION] in _READS
