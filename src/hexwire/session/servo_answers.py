"""The answers to one request on a half-duplex servo bus, with any bytes between them.

Owns which servos answer a packet, what counts as an answer, and when no more answers can arrive. No I/O; the caller
passes bytes and keeps time. This is the careful path: the plans of `hexwire.bus` check the bytes of a healthy bus
faster.

An answer is a status packet whose header, id, length and checksum fit, and

- that is no copy of a recently sent packet, including the request, and cannot be the echo of a 2-byte read, which
has the form of a status packet with error 2;
- that is not followed by invalid bytes: when bytes are lost, a packet takes in the first bytes of the next one, and
one time in 256 its checksum still fits. The bytes after it then start in the middle of a packet;
- that no other answer of the same servo contradicts.

A packet that fails only the second condition is `murky`: it is trusted if it arrives twice.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from enum import Enum
from typing import NamedTuple

from hexwire.wire.servo_packet import BROADCAST_ID, Instruction, ServoPacket, StatusPacket, status_end
from hexwire.wire.tables import LEGACY_HEADER, MAX_SERVO_ID, SERVO_HEADER

__all__ = ["AnswerCollector", "Expected", "Outlook", "expected_answer", "is_read_echo", "match_answer"]

# More than one request can cause, with echo and a generous amount of noise; older bytes are dropped.
_MAX_BUFFER = 16 * 1024
_READ_PARAMS = 2
_HEAD = 4
_NO_ANSWER = frozenset({Instruction.SYNC_WRITE, Instruction.REBOOT})


class Outlook(Enum):
    """Whether more answers may arrive."""

    WAIT = "wait"
    """An answer may still arrive."""
    LINGER = "linger"
    """As many bytes as all answers have arrived, but not all answers: only answers delayed by noise can follow."""
    DONE = "done"
    """No more answers will arrive."""


class _Token(NamedTuple):
    """A valid packet in the received bytes; `status` is None for an echo."""

    start: int
    end: int
    status: StatusPacket | None


def is_read_echo(packet: bytes) -> bool:
    """Whether a valid packet may be the echo of a READ: read as a status, it has error 2, address and count."""
    return packet[4] == Instruction.READ and len(packet) == 6 + _READ_PARAMS and packet[6] > 0


class AnswerCollector:
    """Collector of the answers to one request.

    Args:
        request: The bytes that were sent.
        servo_ids: Ids of the servos that answer, in this order.
        params: Parameter bytes of each answer.
        header: First two bytes of an answer; None accepts either kind.
        sent: Recently sent packets, whose echo may still arrive.
        all_sent: `sent` has every read too, so that other packets cannot be the echo of one.
        echo: Whether to expect the echo of the request.

    Attributes:
        answers: Status packets received so far, by servo id.
        murky: Status packets that would be answers but are followed by invalid bytes.
        others: Status packets that would be answers but have another length, perhaps of an earlier attempt; by
            servo id and number of parameter bytes.
        strays: Valid status packets that answer another request, or none.
        copies: Ids with a packet that is either an answer or a copy of a sent packet.
        echoed: The echo of the request arrived.
        size: Bytes received.
    """

    def __init__(
        self,
        request: bytes,
        servo_ids: Sequence[int],
        params: int,
        *,
        header: bytes | None = None,
        sent: Collection[bytes] = (),
        all_sent: bool = False,
        echo: bool = False,
    ) -> None:
        self.request = request
        self.servo_ids = servo_ids
        self.params = params
        self.answers: dict[int, StatusPacket] = {}
        self.murky: dict[int, StatusPacket] = {}
        self.others: dict[tuple[int, int], StatusPacket] = {}
        self.strays: list[StatusPacket] = []
        self.copies: set[int] = set()
        self.echoed = False
        self.size = 0
        self._header = header
        self._sent = sent
        self._all_sent = all_sent
        self._enough = len(servo_ids) * (6 + params)
        self._and_echo = len(request) if echo else 0
        self._data = b""
        self._rest = 0

    def receive(self, data: bytes) -> Outlook:
        """Process bytes, split at any place. Never raises."""
        self.size += len(data)
        self._data = data = (self._data + data)[-_MAX_BUFFER:]
        self._look(data)
        wanted = self.servo_ids
        if not wanted or wanted[-1] in self.answers:
            # Servos answer in the order of the request: earlier ones that have not answered will not.
            return Outlook.DONE
        # Bytes of an echo do not count. An expected echo that did not arrive may be damaged.
        left = self._rest - (0 if self.echoed else self._and_echo)
        return Outlook.LINGER if left >= self._enough else Outlook.WAIT

    @property
    def missing(self) -> tuple[int, ...]:
        """Ids that did not answer."""
        return tuple(servo_id for servo_id in self.servo_ids if servo_id not in self.answers)

    @property
    def due(self) -> int:
        """Number of answers that may still arrive: those of the servos after the last that answered."""
        for waiting, servo_id in enumerate(reversed(self.servo_ids)):
            if servo_id in self.answers:
                return waiting
        return len(self.servo_ids)

    @property
    def only_echo(self) -> bool:
        """Whether only copies of sent packets arrived, or answers identical to them."""
        return self.size > 0 and not self._rest

    def in_words(self) -> str:
        """What arrived instead of an answer, for an error text; empty if nothing arrived."""
        if not self.size:
            return ""
        if self.only_echo:
            return "only the echo of the request"
        others = [p.servo_id for p in self.strays if p.servo_id not in self.servo_ids]
        if others:
            return f"an answer of servo {', '.join(str(i) for i in dict.fromkeys(others))}"
        return f"{self.size} bytes that are not an answer: {self._data[:16].hex(' ')}"

    def _look(self, data: bytes) -> None:
        tokens = list(self._tokens(data))
        starts = {token.start for token in tokens}
        heard: dict[tuple[int, int], StatusPacket] = {}
        murky: dict[tuple[int, int], StatusPacket] = {}
        disputed: set[tuple[int, int]] = set()
        self.strays = []
        self._rest = len(data)
        for start, end, status in tokens:
            if status is None:
                self._rest -= end - start
                continue
            servo_id, params = status.servo_id, len(status.params)
            fits = servo_id in self.servo_ids and self._header in (None, data[start : start + 2])
            if not fits or params != self.params:
                self.strays.append(status)
            if not fits:
                continue
            key = servo_id, params
            if heard.setdefault(key, status) != status:
                disputed.add(key)
            elif end != len(data) and end not in starts and not self._goes_on(data, end, servo_id):
                murky[key] = status
        good = {key: status for key, status in heard.items() if key not in disputed and key not in murky}
        own = self.params
        self.answers = {i: status for (i, n), status in good.items() if n == own}
        self.murky = {i: status for (i, n), status in murky.items() if n == own and (i, n) not in disputed}
        self.others = {key: status for key, status in good.items() if key[1] != own}

    def _goes_on(self, data: bytes, at: int, servo_id: int) -> bool:
        """Whether the answer of a later servo begins here; the rest of it may be damaged."""
        head = data[at : at + _HEAD]
        if len(head) < _HEAD or head[:2] not in (SERVO_HEADER, LEGACY_HEADER) or head[3] != self.params + 2:
            return False
        later = self.servo_ids[self.servo_ids.index(servo_id) + 1 :]
        return head[2] in later

    def _tokens(self, data: bytes) -> Iterator[_Token]:
        """Yield all valid packets in order, including echoes, and skip other bytes."""
        at = data.find(b"\xff")
        while 0 <= at <= len(data) - 6:
            end = self._echo_end(data, at)
            if end:
                yield _Token(at, end, None)
            elif end := status_end(data, at, self.params):
                status = StatusPacket(data[at + 2], data[at + 4], data[at + 5 : end - 1], data[at + 1] == 0xF5)
                yield _Token(at, end, status)
            at = data.find(b"\xff", end or at + 1)

    def _echo_end(self, data: bytes, at: int) -> int:
        """Return the offset after the echo that starts at `at`; 0 without one."""
        if data[at + 1] != 0xFF and data[at + 1] != 0xF5:
            return 0
        servo_id, length = data[at + 2], data[at + 3]
        end = at + 4 + length
        if length < 2 or end > len(data) or sum(data[at + 2 : end]) & 0xFF != 0xFF:
            return 0
        packet = SERVO_HEADER + data[at + 2 : end]
        copy = packet == self.request or packet in self._sent
        if packet == self.request and data[at + 1] == 0xFF:
            self.echoed = True
        if not copy and data[at + 1] == 0xFF:
            # No servo has the broadcast id, and any recent 2-byte read may be echoed.
            like_a_read = not self._all_sent and servo_id <= MAX_SERVO_ID and is_read_echo(packet)
            copy = servo_id == BROADCAST_ID or like_a_read
        if not copy:
            return 0
        as_answer = self._header in (None, data[at : at + 2])
        if as_answer and servo_id in self.servo_ids and length - 2 == self.params:
            self.copies.add(servo_id)
        return end


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

    An answer followed by noise counts too, since a board does not repeat
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
