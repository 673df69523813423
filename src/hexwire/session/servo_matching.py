"""Matching on a half-duplex servo bus: the answer expected for a packet, and the bytes that are this answer.

Owns which servos answer a packet, and the length of the answers. No I/O and no state: the caller keeps the request.
Used by the dialect-1 half of a connection, by boards, and by the servo bus.
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
    """The answer expected for a packet.

    Attributes:
        servo_ids: Ids of the servos that answer, in order; empty if none does.
        params: Parameter bytes of each answer.
    """

    servo_ids: tuple[int, ...]
    params: int

    @property
    def length(self) -> int:
        """Bytes of all answers together."""
        return len(self.servo_ids) * (6 + self.params)


def expected_answer(packet: ServoPacket, *, acknowledges_writes: bool = True) -> Expected:
    """Return the answer expected for a packet.

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
    """Find the status packet that answers `request` in received bytes. Never raises.

    `servo_answers` tells answers from echoes. An answer followed by noise counts too, since a board does not repeat
    the request in another form.

    Returns:
        The packet, or None if it has not arrived.
    """
    if not expected.servo_ids:
        return None
    servo_id = expected.servo_ids[0]
    collector = AnswerCollector(request, (servo_id,), expected.params)
    collector.receive(data)
    return collector.answers.get(servo_id) or collector.murky.get(servo_id)
