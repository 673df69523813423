"""An emulated half-duplex servo bus: one request at a time, the answers to it, and what a receiver hears of both.

Owns what the line itself does: line rate, answer delays, echo, collisions, the order of sync-read answers, and the
arithmetic of start bit, eight data bits and stop bit. Knows servos only through `receive`, and no board. Times are
seconds.

A line is described by the times at which it is low: it rests high, and a 0 of any sender pulls it down. A receiver
waits for a falling edge and samples the middle of each bit at its own rate, as the hardware does. So a rate that is
a few per cent off is understood, and any other gives the same wrong bytes as on a real line.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable
from functools import lru_cache

from hexwire.errors import UsageError
from hexwire.wire.servo_packet import BROADCAST_ID, Instruction, ServoPacket, iter_packets

from .faults import FaultPlan
from .servo import EmulatedServo

__all__ = ["ServoWire", "heard_at", "listen", "same_rate"]

_BITS = 10
_TOLERANCE = 0.03
"""Largest relative difference at which two rates understand each other. The stop bit is sampled after 9.5 bits, by
when sender and receiver may be half a bit apart (5 %); the rest is a margin for slow edges."""
_SAME = 1e-9
"""Edges that are no further apart than this, in seconds, are one."""


def same_rate(one: int, other: int) -> bool:
    """Whether a sender at one rate is understood at the other, both in bits a second."""
    return one == other or abs(one - other) <= _TOLERANCE * max(one, other)


def heard_at(data: bytes, sent: int, heard: int, *, whole: bool = False) -> bytes:
    """What a receiver hears of bytes that follow each other without a pause.

    Args:
        data: The bytes.
        sent: Rate they are sent at, bits a second.
        heard: Rate of the receiver.
        whole: See `listen`.
    """
    if same_rate(sent, heard):
        return data
    return listen([(data, 0.0)], sent, heard, whole=whole)


def listen(
    sent: Iterable[tuple[bytes, float]], baud: int, heard: int | None = None, *, whole: bool = False
) -> bytes:
    """What a receiver hears of several senders on one line.

    Args:
        sent: Bytes of each sender, and the time of its first start bit.
        baud: Rate of the senders.
        heard: Rate of the receiver; the senders' if None.
        whole: Leave out bytes without a stop bit, as a servo does; a serial driver passes them on as sampled.
    """
    lows = _merged(low for data, start in sent for low in _lows(data, start, baud))
    starts = [begin for begin, _ in lows]
    bit = 1.0 / (heard or baud)
    out = bytearray()
    at = 0
    while at < len(lows):
        edge = lows[at][0]
        if lows[at][1] - edge <= bit / 2:
            at += 1  # too short for a start bit
            continue
        byte = 0
        for place in range(8):
            if not _is_low(lows, starts, edge + (place + 1.5) * bit):
                byte |= 1 << place
        stop = edge + 9.5 * bit
        if not (whole and _is_low(lows, starts, stop)):
            out.append(byte)
        # The next start bit is a falling edge after the stop bit was sampled.
        at = bisect_right(starts, stop)
    return bytes(out)


def _lows(data: bytes, start: float, baud: int) -> Iterable[tuple[float, float]]:
    """Start and end of each time in which a sender pulls the line down."""
    for place, byte in enumerate(data):
        frame = byte << 1 | 1 << _BITS - 1
        first = place * _BITS
        bit = 0
        while bit < _BITS:
            if frame >> bit & 1:
                bit += 1
                continue
            end = bit
            while not frame >> end & 1:
                end += 1
            yield start + (first + bit) / baud, start + (first + end) / baud
            bit = end


def _merged(lows: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    merged: list[tuple[float, float]] = []
    for begin, end in sorted(lows):
        if merged and begin <= merged[-1][1] + _SAME:
            if end > merged[-1][1]:
                merged[-1] = (merged[-1][0], end)
        else:
            merged.append((begin, end))
    return merged


def _is_low(lows: list[tuple[float, float]], starts: list[float], time: float) -> bool:
    at = bisect_right(starts, time) - 1
    return at >= 0 and time < lows[at][1]


# start, eight data, stop
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
