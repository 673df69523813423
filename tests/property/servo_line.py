"""A servo line in fake time on which everything goes wrong at once: echo, loss, damage, junk, lateness, stalls.

Owns servos that are nothing but memory, what becomes of each message on its way, and the judgement whether a value
that a reader gives back is one that the servo had. Shares no code with the emulator nor with the reader but the
building of status packets, so that a mistake cannot be on both sides.
"""

from __future__ import annotations

import random
from bisect import insort
from dataclasses import dataclass, fields

from hexwire.link.base import Link, LinkKind
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import make_legacy_ping_status, make_status

__all__ = ["Clock", "Faults", "FaultyLine", "MemoryServo", "all_faults"]

BAUD = 1_000_000
BYTE_TIME = 10 / BAUD
_TURNAROUND = 100e-6
_USB_TIMER = 0.016
_LATE = (0.002, 0.005, 0.012, 0.020, 0.040, 0.080)
_OLDEST_ECHO = 0.8
_MOST_READ = 244
_AWKWARD = b"\xff\xff\xff\xf5\x00\x01\x02\x04\x38"
_PING, _READ, _WRITE, _SYNC_READ = 1, 2, 3, 0x82


@dataclass(frozen=True)
class Faults:
    """What goes wrong. Each happens to one message in twenty, but echo and latency, which are the adapter's.

    Attributes:
        echo: The adapter hears itself; now and then twice, late, or an earlier request once more.
        loss: A message, or one or two of its bytes, is lost.
        flip: One bit is wrong.
        junk: Up to eight random bytes come before or behind a message.
        short: A message loses its end.
        late: An answer comes milliseconds later, during the next request or the one after it.
        latency: The adapter hands over what it has every 16 ms only.
        stall: The host stands still for up to 150 ms, and now and then for more than a second.
    """

    echo: bool = False
    loss: bool = False
    flip: bool = False
    junk: bool = False
    short: bool = False
    late: bool = False
    latency: bool = False
    stall: bool = False

    def __str__(self) -> str:
        return " ".join(f.name for f in fields(self) if getattr(self, f.name)) or "none"


def all_faults() -> list[Faults]:
    """Every combination."""
    names = [f.name for f in fields(Faults)]
    return [Faults(**{n: bool(k >> i & 1) for i, n in enumerate(names)}) for k in range(1 << len(names))]


class Clock:
    """Fake time."""

    def __init__(self) -> None:
        self.time = 1000.0

    def __call__(self) -> float:
        return self.time


class MemoryServo:
    """A servo that is 256 bytes of memory and an error byte."""

    def __init__(self, servo_id: int, series: Series, dice: random.Random) -> None:
        self.servo_id = servo_id
        self.series = series
        self.legacy = series is Series.SEVEN_BOT
        self.error = dice.choice((0, 0, 0, 0, 0, 1, 2, 2, 4, 8, 0x20))
        self.memory = bytearray(
            dice.choice(_AWKWARD) if dice.random() < 0.3 else dice.randrange(256) for _ in range(256)
        )
        self.written: list[bytes] = []
        self._dice = dice
        if self.error == 2 and dice.random() < 0.5:
            # Where the position's answer is the echo of its request.
            self.memory[56:58] = b"\x38\x02"
            self._still = True
        else:
            self._still = dice.random() < 0.2

    def live(self) -> None:
        """Time passes: all that can change has changed, so that a value of before is a wrong one."""
        if not self._still:
            dice = self._dice
            self.memory[56:64] = dice.randbytes(8)
            if dice.random() < 0.3:
                self.memory[56 + dice.randrange(8)] = dice.choice(_AWKWARD)

    def answer(self, instruction: int, params: bytes) -> bytes:
        """Its answer to a sound packet; empty if it gives none."""
        if instruction == _PING:
            if self.legacy:
                return make_legacy_ping_status(self.servo_id, self.error)
            return make_status(self.servo_id, self.error)
        if instruction in (_READ, _SYNC_READ) and len(params) >= 2:
            address, count = params[0], params[1]
            if (self.legacy and count != 2) or not 0 < count <= _MOST_READ or address + count > 256:
                return b""
            data = bytes(self.memory[address : address + count])
            return make_status(self.servo_id, self.error, data, legacy=self.legacy)
        if instruction == _WRITE and len(params) >= 2:
            self.memory[params[0] : params[0] + len(params) - 1] = params[1:]
            self.written.append(params)
            return b"" if self.legacy else make_status(self.servo_id, self.error)
        return b""


class FaultyLine(Link):
    """A link in fake time to some servos, with faults.

    Args:
        servos: Who is on the line.
        faults: What goes wrong.
        dice: For everything random.
    """

    kind = LinkKind.STREAM
    max_message = None
    baud = BAUD
    url = "serial:///faulty"

    def __init__(self, servos: list[MemoryServo], faults: Faults, dice: random.Random) -> None:
        self.clock = Clock()
        self.servos = {servo.servo_id: servo for servo in servos}
        self.heard = b""
        self.genuine: set[bytes] = set()
        self._faults = faults
        self._dice = dice
        self._rank = 0
        self._coming: list[tuple[float, int, bytes]] = []
        self._buffer = b""
        self._last = 0.0
        self._free_at = 0.0
        self._sent: list[tuple[float, bytes]] = []
        self._bodies: set[bytes] = set()
        # A line that keeps its order, as every real one does, or one on which what is late is overtaken. A legacy
        # servo's answers have nothing but their order to tell them apart.
        self._ordered = dice.random() < 0.5 or any(servo.legacy for servo in servos)
        self._chance = dice.choice((0.05, 0.05, 0.2))
        self._always_twice = faults.echo and dice.random() < 0.2

    # --- the contract of a link --------------------------------------------------------------------------------

    @property
    def is_open(self) -> bool:
        return True

    def open(self) -> None:
        """It is."""

    def close(self) -> None:
        """Never."""

    def wake(self) -> None:
        """Nobody sleeps."""

    def flush_input(self) -> int:
        self._arrive()
        size = len(self._buffer)
        self._buffer = b""
        return size

    def write(self, data: bytes, deadline: float | None = None) -> None:
        self._stall()
        self._sent = [*self._sent[-4:], (self.clock.time, data)]
        self._bodies.add(data[2:])
        now = self.clock.time
        start = max(now, self._free_at)
        end = start + len(data) * BYTE_TIME
        if self._faults.echo:
            self._echo(data, start, end)
        end = self._answer(self._spoil(data), end)
        self._free_at = end
        self._stall()

    def read(self, deadline: float | None) -> bytes:
        assert deadline is not None
        self._stall()
        self._arrive()
        if not self._buffer:
            clock = self.clock
            due = self._coming[0][0] if self._coming else deadline
            clock.time = max(clock.time, min(due, deadline))
            self._arrive()
        size = len(self._buffer)
        if size > 1 and self._dice.random() < 0.2:
            size = self._dice.randrange(1, size)
        data, self._buffer = self._buffer[:size], self._buffer[size:]
        self.heard += data
        return data

    # --- what happens on the way -------------------------------------------------------------------------------

    def _stall(self) -> None:
        if self._faults.stall and self._dice.random() < 0.005:
            self.clock.time += self._dice.choice((0.005, 0.030, 0.150, 0.150, 1.2))

    def _happens(self) -> bool:
        return self._dice.random() < self._chance

    def _echo(self, data: bytes, start: float, end: float) -> None:
        dice = self._dice
        self._put(self._spoil(data), end)
        if self._always_twice or self._happens():
            self._put(self._spoil(data), end + dice.choice((0.0, 0.0, 0.001, *_LATE)))
        when, earlier = dice.choice(self._sent)
        if end - when < _OLDEST_ECHO and self._happens():
            self._put(self._spoil(earlier), end + dice.choice((0.0, *_LATE)))

    def _answer(self, data: bytes, end: float) -> float:
        at = data.find(b"\xff\xff")
        while 0 <= at <= len(data) - 6:
            stop = at + 4 + data[at + 3]
            if data[at + 3] >= 2 and stop <= len(data) and sum(data[at + 2 : stop]) & 0xFF == 0xFF:
                end = self._obey(data[at + 2], data[at + 4], data[at + 5 : stop - 1], end)
                at = data.find(b"\xff\xff", stop)
            else:
                at = data.find(b"\xff\xff", at + 1)
        return end

    def _obey(self, servo_id: int, instruction: int, params: bytes, end: float) -> float:
        if instruction == _SYNC_READ:
            asked, params = params[2:], params[:2]
        elif instruction > 0x7F:
            return end
        else:
            asked = bytes((servo_id,))
        for one in asked:
            servo = self.servos.get(one)
            answer = servo.answer(instruction, params) if servo is not None else b""
            end += _TURNAROUND + len(answer) * BYTE_TIME
            if not answer:
                continue
            self.genuine.add(answer)
            late = self._dice.choice(_LATE) if self._faults.late and self._happens() else 0.0
            self._put(self._spoil(answer), end + late)
            if self._ordered:
                end += late
        return end

    def _spoil(self, data: bytes) -> bytes:
        faults, dice = self._faults, self._dice
        if faults.loss and self._happens():
            if dice.random() < 0.3:
                return b""
            for _ in range(dice.choice((1, 1, 1, 2))):
                at = dice.randrange(len(data))
                data = data[:at] + data[at + 1 :]
        if faults.flip and self._happens():
            at = dice.randrange(len(data))
            data = data[:at] + bytes((data[at] ^ 1 << dice.randrange(8),)) + data[at + 1 :]
        if faults.short and self._happens():
            data = data[: dice.randrange(len(data))]
        if faults.junk and self._happens():
            junk = bytes(
                dice.choice(_AWKWARD) if dice.random() < 0.3 else dice.randrange(256)
                for _ in range(dice.randint(1, 8))
            )
            data = junk + data if dice.random() < 0.7 else data + junk
        return data

    def _put(self, data: bytes, when: float) -> None:
        if not data:
            return
        if self._ordered:
            when = self._last = max(when, self._last)
        if self._faults.latency:
            when = (when // _USB_TIMER + 1) * _USB_TIMER
        self._rank += 1
        insort(self._coming, (when, self._rank, data))

    def _arrive(self) -> None:
        now, coming = self.clock.time, self._coming
        while coming and coming[0][0] <= now + 1e-9:
            self._buffer += coming.pop(0)[2]

    # --- judging ------------------------------------------------------------------------------------------------

    def listen(self) -> None:
        """A call begins: what is heard from now on is what it has to go by."""
        self.heard = b""

    def forged(self, servo_id: int, params: bytes) -> bool:
        """Whether damage alone made a whole and sound answer with these bytes in it, with nothing odd about it.

        Then nobody could tell: the bytes are those of an answer that was never sent, and what stands behind them,
        if anything, begins like a packet. No single wrong bit does that.
        """
        data = self.heard
        for at in range(len(data) - 5):
            if data[at] != 0xFF or data[at + 1] not in (0xFF, 0xF5) or data[at + 2] != servo_id:
                continue
            end = at + 4 + data[at + 3]
            packet = data[at:end]
            sound = len(packet) == end - at >= 6 and sum(packet[2:]) & 0xFF == 0xFF
            whole = end == len(data) or data[end : end + 2] in (b"\xff\xff", b"\xff\xf5", b"\xff")
            copied = packet[2:] in self._bodies
            if sound and whole and params in packet[5:-1] and not copied and packet not in self.genuine:
                return True
        return False
