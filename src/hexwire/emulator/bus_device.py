"""A bus of emulated servos as something that can be put behind a line: bytes in, bytes out, in time.

Owns cutting requests out of the byte stream and when each answer's bytes are there. Knows no terminal and no link;
`serve` has those. The wire itself (order, echo, collisions) is `servo_wire`'s.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence

from hexwire.errors import UsageError
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import BROADCAST_ID

from .faults import FaultPlan
from .servo import EmulatedServo
from .servo_wire import ServoWire

__all__ = ["BusDevice", "make_servos"]

_BITS = 10
_MAX_PENDING = 4096
_MIN_PACKET = 6
_STEP = 0.02


def make_servos(
    series: Sequence[Series], ids: Sequence[int], *, baud: int = 0, seed: int = 1, start: float = 0.0
) -> list[EmulatedServo]:
    """Servos for a bus, at their neutral positions.

    Args:
        series: One for each id, or a single one for all.
        ids: Servo ids; an id that occurs twice makes two servos that collide.
        baud: Rate they are set to; 0 leaves them as they come from the factory.
        seed: For noise.
        start: The time at which they get power; what passed before need not be caught up with.

    Raises:
        UsageError: The numbers of series and ids differ, or a series has no such rate.
    """
    kinds = list(series) * len(ids) if len(series) == 1 else list(series)
    if len(kinds) != len(ids):
        raise UsageError(f"{len(ids)} ids but {len(kinds)} series: give one series, or one for each id")
    servos = []
    for place, (kind, servo_id) in enumerate(zip(kinds, ids, strict=True)):
        settings = {}
        codes = {rate: code for code, rate in kind.baud_codes.items()}
        if baud and codes:
            if baud not in codes:
                raise UsageError(f"{kind.value} servos do {', '.join(map(str, sorted(codes)))} baud, not {baud}")
            settings["baud_code"] = codes[baud]
        # Each a little off the middle, so that their answers differ.
        position = kind.neutral + 3 * place
        servos.append(
            EmulatedServo(kind, servo_id, position=position, seed=seed + place, settings=settings, start=start)
        )
    return servos


class BusDevice:
    """Emulated servos behind an adapter.

    Args:
        servos: Who is on the wire.
        paced: Take the time that a line takes; otherwise every servo hears at any rate, at no cost.
        faults: Scripted faults.
        echo: The adapter hears itself.
        host_baud: Tells the rate at which the host talks; servos set to another do not hear. None is the rate
            that the first servo has now.
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
        self._input = b""
        self._answers: deque[tuple[float, bytes]] = deque()
        self._now = 0.0
        self._busy_until = 0.0

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes from the host; whole packets go onto the wire."""
        if self._paced:
            self.wire.baud = self._host_baud()
        self._input += data
        while packet := self._next_packet():
            start = max(now, self._busy_until)
            heard, end = self.wire.transact(packet, start)
            self._busy_until = end if self._paced else now
            self._queue(heard, packet, start, end)

    def step(self, now: float) -> None:
        """Let time pass for the servos."""
        self._now = now
        self.wire.step(now)

    def data_to_send(self) -> bytes:
        """What has come over the wire by the time of the last `step`."""
        out = []
        while self._answers and self._answers[0][0] <= self._now + 1e-9:
            out.append(self._answers.popleft()[1])
        return b"".join(out)

    @property
    def answer_due(self) -> float | None:
        """When the next bytes for the host are there; None if there are none to come."""
        return self._answers[0][0] if self._answers else None

    def next_event_time(self) -> float | None:
        """When the next bytes are there, or the servos want to move on."""
        if self._answers:
            return self._answers[0][0]
        return self._now + _STEP

    def reset(self, now: float) -> None:
        """Forget what is on the line; the servos keep their power, as an adapter's reset does not reach them."""
        self._input = b""
        self._answers.clear()

    def _next_packet(self) -> bytes:
        """The next whole packet of the host, with what stands before it; empty if there is none yet."""
        data = self._input
        at = data.find(b"\xff\xff")
        while at >= 0:
            if len(data) - at < _MIN_PACKET:
                break
            size = data[at + 3] + 4
            if data[at + 2] <= BROADCAST_ID and size >= _MIN_PACKET:
                if len(data) - at < size:
                    break
                if sum(data[at + 2 : at + size]) & 0xFF == 0xFF:
                    self._input = data[at + size :]
                    return data[: at + size]
            at = data.find(b"\xff\xff", at + 1)
        if len(data) > _MAX_PENDING:
            self._input = data[-_MIN_PACKET:]
        return b""

    def _queue(self, heard: bytes, packet: bytes, start: float, end: float) -> None:
        """Give each piece of what was heard the time at which its last bit was there."""
        if not heard:
            return
        if not self._paced:
            self._answers.append((start, heard))
            return
        byte_time = _BITS / self.wire.baud
        if self.wire.echo:
            self._answers.append((start + len(packet) * byte_time, heard[: len(packet)]))
            heard = heard[len(packet) :]
        at, left = 0, len(heard)
        while left > 0:
            size = min(left, heard[at + 3] + 4 if left > 3 else left)
            left -= size
            self._answers.append((end - left * byte_time, heard[at : at + size]))
            at += size
