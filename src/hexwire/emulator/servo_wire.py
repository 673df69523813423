"""An emulated half-duplex servo bus: one request at a time, and the answers to it.

Owns what the line itself does: line rate, answer delays, echo, collisions, the order of sync-read answers. Knows
servos only through `receive`, and no board.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

from hexwire.errors import UsageError
from hexwire.wire.servo_packet import BROADCAST_ID, Instruction, ServoPacket, iter_packets

from .faults import FaultPlan
from .servo import EmulatedServo
from .uart import listen, same_rate

__all__ = ["ServoWire"]

_BITS = 10  # start, eight data, stop
_SYNC_READ = Instruction.SYNC_READ


@lru_cache(maxsize=256)
def _requests(data: bytes) -> tuple[ServoPacket, ...]:
    """The packets in some bytes; a board that polls its servos sends the same ones again and again."""
    return tuple(iter_packets(data))


class ServoWire:
    """Servos on one wire.

    Args:
        servos: The servos on it. Two may have one id; their answers collide.
        baud: Line rate. A servo at another rate hears nothing. With 0, bytes take no time and all servos hear.
        echo: The sender hears itself, as with a plain one-wire adapter.
        faults: Scripted faults of the bus.

    Attributes:
        free_at: When the line is quiet again. A sender that does not wait for a late answer may set it earlier.
    """

    def __init__(
        self,
        servos: Iterable[EmulatedServo],
        *,
        baud: int = 0,
        echo: bool = False,
        faults: FaultPlan | None = None,
    ) -> None:
        if baud < 0:
            raise UsageError(f"the line rate is {baud}, but must be 0 (no pacing) or more")
        self.servos = list(servos)
        self.baud = baud
        self.faults = faults or FaultPlan()
        self.echo = echo or self.faults.bus_echo
        known = {servo.servo_id for servo in self.servos}
        for fault in self.faults.faults:
            if fault.servo_id >= 0 and fault.servo_id not in known:
                ids = ", ".join(map(str, sorted(known))) or "none"
                raise UsageError(
                    f"fault {fault.kind!r} is for servo {fault.servo_id}, which is not on the bus; servos: {ids}"
                )
        self.free_at = 0.0

    def __getitem__(self, servo_id: int) -> EmulatedServo:
        """The first servo that answers to an id now.

        Raises:
            KeyError: There is none.
        """
        for servo in self.servos:
            if servo.servo_id == servo_id:
                return servo
        raise KeyError(servo_id)

    def step(self, now: float) -> None:
        """Let time pass for all servos."""
        self._power(now)
        for servo in self.servos:
            servo.step(now)

    def transact(self, packet: bytes, now: float) -> tuple[bytes, float]:
        """Put bytes on the wire and listen until it is quiet again.

        Args:
            packet: Any bytes; servos pick valid packets out of them.
            now: When the first bit goes out; it goes later if the wire is still busy.

        Returns:
            What the sender hears (its echo too, if there is one), and when the last bit of it ends.
        """
        start = max(now, self.free_at) if self.baud else now
        end = start + self._time(len(packet))
        self._power(end)
        heard = bytearray(packet if self.echo else b"")
        if not self.faults.bus_dead(end):
            for request in _requests(self.faults.bus_request(bytes(packet))):
                answer, end = self._answer(request, end)
                heard += answer
        self.free_at = end
        return bytes(heard), end

    def _time(self, count: int) -> float:
        return count * _BITS / self.baud if self.baud else 0.0

    def _power(self, now: float) -> None:
        back = self.faults.power_returned(now)
        if back is None and not self.faults.faults:
            return
        for servo in self.servos:
            if back is not None:
                servo.power_cycle(back)
            self.faults.afflict(servo)

    def _answer(self, request: ServoPacket, now: float) -> tuple[bytes, float]:
        """All answers to one request that ended at `now`."""
        replies: list[tuple[int, bytes, float]] = []
        # A faulty servo may babble at a request that is for another one.
        told_apart = not self.faults.faults and request.servo_id != BROADCAST_ID
        baud = self.baud
        for servo in self.servos:
            if told_apart and not servo.is_addressed(request):
                continue
            if baud and (rate := servo.baud) != baud and not same_rate(rate, baud):
                continue
            # A servo answers with the id it had before the request: a write may change it.
            servo_id = servo.servo_id
            delay = servo.answer_delay if baud else 0.0
            reply, late = self.faults.bus_answer(servo_id, servo.receive(request, now))
            if reply:
                replies.append((servo_id, reply, delay + late))
        if request.instruction == _SYNC_READ:
            return self._in_order(request.params, replies, now)
        return self._at_once([(reply, delay) for _, reply, delay in replies], now)

    def _in_order(self, params: bytes, replies: list[tuple[int, bytes, float]], now: float) -> tuple[bytes, float]:
        """Sync read: each id in turn; a missing servo leaves a gap as long as its answer."""
        heard = bytearray()
        slot = 250e-6 + self._time(params[1] + 6) if self.baud else 0.0
        for servo_id in params[2:]:
            turn = [(reply, delay) for who, reply, delay in replies if who == servo_id]
            if turn:
                answer, now = self._at_once(turn, now)
                heard += answer
            else:
                now += slot
        # Babble of servos that were not asked comes last.
        for who, reply, _ in replies:
            if who not in params[2:]:
                heard += reply
                now += self._time(len(reply))
        return bytes(heard), now

    def _at_once(self, replies: list[tuple[bytes, float]], now: float) -> tuple[bytes, float]:
        """Answers that do not wait for each other: where they overlap, a 0 of any sender pulls the line down."""
        if not replies:
            return b"", now
        if len(replies) == 1:
            reply, delay = replies[0]
            return self.faults.bus_heard(reply), now + delay + self._time(len(reply))
        end = max(now + delay + self._time(len(reply)) for reply, delay in replies)
        if self.baud:
            return self.faults.bus_heard(listen(replies, self.baud)), end
        overlay = bytearray(b"\xff" * max(len(reply) for reply, _ in replies))
        for reply, _ in replies:
            for index, byte in enumerate(reply):
                overlay[index] &= byte
        return self.faults.bus_heard(bytes(overlay)), end
