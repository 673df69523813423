"""Collecting the answers to one request on a servo bus, whatever comes between them.

Owns what counts as an answer (id, length and checksum fit, and it is not the request's own echo) and when
nothing more can come. Sans I/O; the caller feeds bytes and keeps time. This is the careful path: what a healthy
bus sends is recognised by `servo_plan` at a glance.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum

from hexwire.wire.servo_packet import StatusPacket, find_status, iter_status
from hexwire.wire.tables import MAX_SERVO_PACKET

__all__ = ["AnswerCollector", "Outlook"]

# What one request can cause at most, echo and a generous amount of noise included; older bytes are dropped.
_MAX_BUFFER = 16 * 1024


class Outlook(Enum):
    """What is still to be expected."""

    WAIT = "wait"
    """An answer may still come."""
    LINGER = "linger"
    """As many bytes as the answers have are here, but not all answers: only what noise pushed back can come."""
    DONE = "done"
    """Nothing more will come."""


class AnswerCollector:
    """The answers to one request.

    Args:
        request: The bytes that were sent.
        servo_ids: Who answers, in this order.
        params: Parameter bytes of each answer.

    Attributes:
        answers: Status packets by servo id, as far as they came.
        echoed: The request itself came back.
        size: Bytes received.
    """

    def __init__(self, request: bytes, servo_ids: Sequence[int], params: int) -> None:
        self.request = request
        self.servo_ids = servo_ids
        self.params = params
        self.answers: dict[int, StatusPacket] = {}
        self.echoed = False
        self.size = 0
        self._data = b""

    def receive(self, data: bytes) -> Outlook:
        """Take bytes in, in any pieces. Never raises."""
        self.size += len(data)
        data = (self._data + data)[-_MAX_BUFFER:]
        if not self.echoed:
            # Compared as a whole: the echo of a READ is a valid status packet of the same servo, and of the same
            # length if two bytes are read.
            at = data.find(self.request)
            if at >= 0:
                self.echoed = True
                self.answers.clear()
                data = data[at + len(self.request) :]
        self._data = data
        return self._look(data)

    @property
    def missing(self) -> tuple[int, ...]:
        """Ids that did not answer."""
        return tuple(servo_id for servo_id in self.servo_ids if servo_id not in self.answers)

    @property
    def due(self) -> int:
        """How many answers may still come: those of the servos after the last that answered."""
        for waiting, servo_id in enumerate(reversed(self.servo_ids)):
            if servo_id in self.answers:
                return waiting
        return len(self.servo_ids)

    @property
    def only_echo(self) -> bool:
        """Nothing but the request's own bytes came: its echo, or an answer that looks exactly like it."""
        return self.echoed and not self._data and not self.answers

    def in_words(self) -> str:
        """What came instead of an answer, for an error text; empty if nothing did."""
        if not self.size:
            return ""
        if self.only_echo:
            return "only the echo of the request"
        others = [p.servo_id for p in iter_status(self._data) if p.servo_id not in self.servo_ids]
        if others:
            return f"an answer of servo {', '.join(str(i) for i in dict.fromkeys(others))}"
        return f"{self.size} bytes that are no answer: {self._data[:16].hex(' ')}"

    def _look(self, data: bytes) -> Outlook:
        wanted = self.servo_ids
        for packet in iter_status(data):
            servo_id = packet.servo_id
            if servo_id in wanted and servo_id not in self.answers and len(packet.params) == self.params:
                self.answers[servo_id] = packet
        if len(self.answers) < len(wanted) and len(data) <= 4 * MAX_SERVO_PACKET:
            # Noise that happens to look like a packet may have swallowed one.
            for servo_id in self.missing:
                found = find_status(data, servo_id, self.params)
                if found is not None:
                    self.answers[servo_id] = found[0]
        if not wanted or wanted[-1] in self.answers:
            # Servos answer in the order of the request: whoever has not by now will not.
            return Outlook.DONE
        return Outlook.LINGER if len(data) >= len(wanted) * (6 + self.params) else Outlook.WAIT
