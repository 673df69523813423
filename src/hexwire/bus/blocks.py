"""Registers read together with their neighbours, so that the length of an answer identifies its request.

Owns the blocks that contain a register, and the answers to attempts to read one of them. No I/O and no time;
`doubts` knows which lengths are free.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hexwire.session.servo_answers import AnswerCollector
    from hexwire.wire.servo_packet import StatusPacket

__all__ = ["BlockAnswers", "places"]


def places(address: int, count: int, end: int, most: int) -> Iterator[tuple[int, int]]:
    """Yield blocks of registers that contain `count` bytes from `address`, shortest first, one of each length.

    Args:
        address: First register address.
        count: Bytes wanted.
        end: Address after the last register.
        most: Most bytes in the answer to one read.

    Yields:
        First address and length of each. The first block is the one wanted.
    """
    yield address, count
    end = max(end, address + count)
    for length in range(count + 1, min(most, end) + 1):
        yield min(address, end - length), length


class BlockAnswers:
    """Answers to the attempts of one call to read registers.

    An answer to any attempt counts: no other answer of that length was outstanding from that servo.

    Args:
        address: First register address.
        count: Bytes wanted.
    """

    def __init__(self, address: int, count: int) -> None:
        self._address = address
        self._count = count
        self._tried: dict[tuple[int, int], int] = {}
        self._heard: dict[int, bytes] = {}

    def take(self, collector: AnswerCollector, place: tuple[int, int]) -> dict[int, StatusPacket]:
        """Return the answers that are trusted after an attempt, cut to the bytes wanted."""
        found: dict[int, StatusPacket] = {}
        for (servo_id, length), status in collector.others.items():
            if (servo_id, length) in self._tried:
                found[servo_id] = self._cut(status, self._tried[servo_id, length])
        for servo_id, status in collector.murky.items():
            cut = self._cut(status, place[0])
            # The same answer twice, followed by invalid bytes: for example, an adapter that adds a byte.
            if self._heard.get(servo_id) == cut.params:
                found[servo_id] = cut
            self._heard[servo_id] = cut.params
        for servo_id, status in collector.answers.items():
            found[servo_id] = self._cut(status, place[0])
        for servo_id in collector.servo_ids:
            self._tried[servo_id, place[1]] = place[0]
        return found

    def _cut(self, status: StatusPacket, first: int) -> StatusPacket:
        skip = self._address - first
        return status._replace(params=status.params[skip : skip + self._count])
