"""Matching on a half-duplex servo bus: what answer a packet calls for, and which bytes are that answer.

Owns who answers what, and in which length. Sans I/O and sans state: the caller keeps the request. Used by the
dialect-1 side of a connection, by boards, and by whoever drives a bus directly.
"""

from __future__ import annotations

from typing import NamedTuple

from hexwire.wire.servo_packet import (
    BROADCAST_ID,
    Instruction,
    ServoPacket,
    StatusPacket,
)

from .servo_answers import AnswerCollector

__all__ = ["Expected", "expected_answer", "match_answer"]

_NO_ANSWER = frozenset({Instruction.SYNC_WRITE, Instruction.REBOOT})


class Expected(NamedTuple):
    """What answers a packet.

    Attributes:
        servo_ids: Who answers, in order; empty if nobody does.
        params: Parameter bytes of each answer.
    """

    servo_ids: tuple[int, ...]
    params: int

    @property
    def length(self) -> int:
        """Bytes of all answers together."""
        return len(self.servo_ids) * (6 + self.params)


def expected_answer(packet: ServoPacket, *, acknowledges_writes: bool = True) -> Expected:
    """What answer a packet calls for.

    Args:
        packet: The request.
        acknowledges_writes: Whether the servo answers writes too (status level 1); legacy servos do not.
    """
    instruction = packet.instruction
    if instruction == Instruction.SYNC_READ:
        return Expected(tuple(packet.params[2:]), packet.params[1] if len(packet.params) > 1 else 0)
    if instruction == Instruction.PING:
        return Expected((packet.servo_id,), 0)
    if packet.servo_id == BROADCAST_ID or instruction in _NO_ANSWER:
        return Expected((), 0)
    if instruction == Instruction.READ:
        return Expected((packet.servo_id,), packet.params[1] if len(packet.params) > 1 else 0)
    return Expected((packet.servo_id,) if acknowledges_writes else (), 0)


def match_answer(data: bytes, request: bytes, expected: Expected) -> StatusPacket | None:
    """Find the one status packet that answers `request` in what was received.

    What is an answer and what is an echo, `servo_answers` decides. A board does not ask in another way where
    noise follows, so that counts.

    Returns:
        The packet, or None if it is not (yet) there. Never raises.
    """
    if not expected.servo_ids:
        return None
    servo_id = expected.servo_ids[0]
    collector = AnswerCollector(request, (servo_id,), expected.params)
    collector.receive(data)
    return collector.answers.get(servo_id) or collector.murky.get(servo_id)
