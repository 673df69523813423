"""A bus of emulated servos behind an adapter: bytes in, bytes out, with the timing of a line.

Owns finding requests in the byte stream, what a receiver at another rate hears, and when each byte of an answer
arrives. Knows no terminal and no link, which belong to `serve`; order and collisions on the wire belong to
`servo_wire`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence

from hexwire.errors import UsageError
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import BROADCAST_ID

from .faults import FaultPlan
from .servo import EmulatedServo
from .servo_wire import ServoWire, heard_at, same_rate

__all__ = ["BusDevice", "make_servos"]

_BITS = 10
_MAX_PENDING = 4096
_MIN_PACKET = 6
_STEP = 0.02
_PAUSE = 0.001
"""Seconds of silence after which the sender may have given up an unfinished packet."""


def make_servos(
    series: Sequence[Series],
    ids: Sequence[int],
    *,
    baud: int | Sequence[int] = 0,
    seed: int = 1,
    start: float = 0.0,
) -> list[EmulatedServo]:
    """Servos for a bus, at their neutral positions.

    Args:
        series: One for each id, or a single one for all.
        ids: Servo ids; an id that occurs twice makes two servos that collide.
        baud: Rate they are set to, one for all or one for each id; 0 keeps the factory's rate.
        seed: Seed of the noise.
        start: The time of power-up; earlier time is not simulated.

    Raises:
        UsageError: The numbers of series, rates and ids differ, or a series has no such rate.
    """
    kinds = list(series) * len(ids) if len(series) == 1 else list(series)
    if len(kinds) != len(ids):
        raise UsageError(f"{len(ids)} ids but {len(kinds)} series: give one series, or one for each id")
    rates = [baud] if isinstance(baud, int) else list(baud)
    rates = rates * len(ids) if len(rates) == 1 else rates
    if len(rates) != len(ids):
        raise UsageError(f"{len(ids)} ids but {len(rates)} rates: give one rate, or one for each id")
    servos = []
    for place, (kind, servo_id, rate) in enumerate(zip(kinds, ids, rates, strict=True)):
        settings = {}
        codes = {bits: code for code, bits in kind.baud_codes.items()}
        if rate and codes:
            if rate not in codes:
                known = ", ".join(map(str, sorted(codes)))
                raise UsageError(f"{kind.value} servos support {known} baud, not {rate}")
            settings["baud_code"] = codes[rate]
        # Each a little off the centre, so that their answers differ.
        position = kind.neutral + 3 * place
        servos.append(
            EmulatedServo(kind, servo_id, position=position, seed=seed + place, settings=settings, start=start)
        )
    return servos


class BusDevice:
    """Emulated servos behind an adapter.

    Args:
        servos: The servos on the wire.
        paced: Bytes take as long as on a real line; otherwise they take no time and every servo hears any rate.
        faults: Scripted faults.
        echo: The adapter hears itself.
        host_baud: Returns the host's present rate. A servo at another rate hears what its receiver makes of the
            bytes, and so does the host with the answer. None stands for the first servo's rate at construction.
    """

    def __init__(
        self,
        servos: Sequence[EmulatedServo],
        *,
        paced: bool = False,
        faults: FaultPlan | None = None,
        echo: bool = False,
        host_baud: Callable[[], int] | None = None,
    ) -> None:
        self._paced = paced
        first = servos[0].baud if servos else Series.STS_SMS.baud
        self._host_baud = host_baud or (lambda: first)
        self.wire = ServoWire(servos, baud=self._host_baud() if paced else 0, faults=faults, echo=echo)
        # An adapter repeats every byte, not only those that are a packet.
        self._echo, self.wire.echo = self.wire.echo, False
        self._ears: dict[int, _Ear] = {}
        self._answers: deque[tuple[float, bytes, int]] = deque()
        self._now = 0.0
        self._busy_until = 0.0

    @property
    def pending(self) -> int:
        """Number of bytes held that are not yet a whole packet."""
        return sum(len(ear.data) for ear in self._ears.values())

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes from the host; whole packets go onto the wire."""
        rate = self._host_baud() if self._paced else 0
        if self._echo and data:
            due = max(now, self._busy_until) + len(data) * _BITS / rate if rate else now
            self._answers.append((due, data, rate))
        self._hear(data, rate, now)
        if rate:
            for other in {servo.baud for servo in self.wire.servos}:
                if not same_rate(other, rate):
                    self._hear(heard_at(data, rate, other, whole=True), other, now)
            self.wire.baud = rate

    def _hear(self, data: bytes, rate: int, now: float) -> None:
        """Pass bytes to the servos of one rate, and let them act on whole packets."""
        ear = self._ears.setdefault(rate, _Ear())
        ear.hear(data, now)
        while packet := ear.next_packet():
            self.wire.baud = rate
            start = max(now, self._busy_until)
            heard, end = self.wire.transact(packet, start)
            self._busy_until = end if self._paced else now
            self._queue(heard, start, end)

    def step(self, now: float) -> None:
        """Let time pass for the servos."""
        self._now = now
        self.wire.step(now)

    def data_to_send(self) -> bytes:
        """Bytes that have arrived by the time of the last `step`."""
        out = []
        while self._answers and self._answers[0][0] <= self._now + 1e-9:
            _, data, rate = self._answers.popleft()
            out.append(heard_at(data, rate, self._host_baud()) if rate else data)
        return b"".join(out)

    @property
    def answer_due(self) -> float | None:
        """When the next bytes for the host arrive; None if there are none."""
        return self._answers[0][0] if self._answers else None

    def next_event_time(self) -> float | None:
        """When the next bytes arrive, or the servos need their next step."""
        if self._answers:
            return self._answers[0][0]
        return self._now + _STEP

    def reset(self, now: float) -> None:
        """Forget what is on the line; the servos keep their power, as an adapter's reset does not reach them."""
        self._ears.clear()
        self._answers.clear()

    def _queue(self, heard: bytes, start: float, end: float) -> None:
        """Queue what was heard, each packet with the time at which its last bit arrives."""
        if not heard:
            return
        if not self._paced:
            self._answers.append((start, heard, 0))
            return
        rate = self.wire.baud
        at, left = 0, len(heard)
        while left > 0:
            size = min(left, heard[at + 3] + 4 if left > 3 else left)
            left -= size
            self._answers.append((end - left * _BITS / rate, heard[at : at + size], rate))
            at += size


class _Ear:
    """Packets in the stream of bytes that servos of one rate hear.

    Attributes:
        data: Bytes that are not yet a whole packet.
    """

    def __init__(self) -> None:
        self.data = b""
        self._before_pause = 0
        self._last = 0.0

    def hear(self, data: bytes, now: float) -> None:
        """Take bytes."""
        if now - self._last > _PAUSE:
            self._before_pause = len(self.data)
        self._last = now
        self.data += data

    def next_packet(self) -> bytes:
        """The next whole packet; empty if there is none yet. Bytes before it are noise and are dropped.

        An unfinished packet, left by noise or by another rate, does not swallow what comes after a pause: it is
        dropped once a whole packet follows it.
        """
        data = self.data
        at = data.find(b"\xff\xff")
        while at >= 0:
            here = len(data) - at
            size = data[at + 3] + 4 if here > 3 else _MIN_PACKET
            if size >= _MIN_PACKET and (here < 3 or data[at + 2] <= BROADCAST_ID):
                if here < size:
                    if at >= self._before_pause:
                        break
                elif sum(data[at + 2 : at + size]) & 0xFF == 0xFF:
                    self._drop(at + size)
                    return data[at : at + size]
            at = data.find(b"\xff\xff", at + 1)
        if len(data) > _MAX_PENDING:
            self._drop(len(data) - _MIN_PACKET)
        return b""

    def _drop(self, count: int) -> None:
        self.data = self.data[count:]
        self._before_pause = max(0, self._before_pause - count)
