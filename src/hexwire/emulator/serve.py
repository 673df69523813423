"""An emulated device behind a link in simulated time, and the line between the two.

Owns `BoardLink`, for tests and examples that must not sleep, how long bytes take on a line, and what all servers of
a device do between two looks at their hosts. Only the `serve_` modules of the package do I/O.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from hexwire.errors import LinkBusyError, LinkClosedError, LinkLostError, UsageError
from hexwire.link.base import Link, LinkKind

if TYPE_CHECKING:
    from .hand import Hands
    from .serve_hand import HandServer

__all__ = ["FRAME", "Arrivals", "BoardLink", "DeviceServer", "FakeClock", "PacedLine", "ServedDevice", "deliver"]

_BITS = 10
_STALL = 0.02
"""Seconds by which a server may be late before that is a stall."""
FRAME = 1 / 30
"""Seconds between two pictures of a twin."""
_IDLE = 0.25
_SLICE = 0.001
"""Seconds between two looks at a paced line in use."""
_HAND_PERIOD = 0.02
"""Most seconds between two steps of a joint that is moved by hand."""


class ServedDevice(Protocol):
    """A device that can be put behind a line: a board, or a bus of servos."""

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes from the line. They end a silence: that before them is judged by `step`, see `deliver`."""

    def step(self, now: float) -> None:
        """Do everything that is due."""

    def data_to_send(self) -> bytes:
        """Bytes for the line since the last call."""

    def next_event_time(self) -> float | None:
        """When `step` has something to do without input."""

    def reset(self, now: float) -> None:
        """Restart."""


class FakeClock:
    """A clock that advances only on request: `clock()` is its time in seconds."""

    def __init__(self, start: float = 1000.0) -> None:
        self.time = start

    def __call__(self) -> float:
        return self.time

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        self.time += seconds

    def sleep(self, seconds: float) -> None:
        """Let a `Session` wait in simulated time between two attempts to open a lost port."""
        self.advance(seconds)


class BoardLink(Link):
    """A link to a device in this process, in simulated time: a read advances the clock, nothing sleeps.

    Args:
        device: The emulated board.
        clock: Shared with the session; `Session` finds it as `link.clock`.
        baud: Line rate between host and board; with 0, bytes take no time.
    """

    kind = LinkKind.STREAM
    max_message = None

    def __init__(
        self,
        device: ServedDevice,
        clock: FakeClock | None = None,
        *,
        baud: int = 0,
    ) -> None:
        self.device = device
        self.clock = clock or FakeClock()
        self.url = "serial:///emulated"
        self.lost = False
        self.written: list[bytes] = []
        self._to_board = PacedLine(baud)
        self._to_host = PacedLine(baud)
        self._open = False
        self._woken = False

    @property
    def is_open(self) -> bool:
        return self._open

    def open(self) -> None:
        if self._open:
            raise LinkBusyError(f"{self.url} is already open", url=self.url)
        if self.lost:
            raise LinkLostError(f"{self.url} is unplugged", url=self.url)
        self._open = True

    def close(self) -> None:
        self._open = False

    def wake(self) -> None:
        self._woken = True

    def flush_input(self) -> int:
        return len(self._to_host.take(self.clock.time, everything=True))

    def write(self, data: bytes, deadline: float | None = None) -> None:
        self._check()
        self.written.append(data)
        self._to_board.put(data, self.clock.time)
        self._run()

    def read(self, deadline: float | None) -> bytes:
        while True:
            self._check()
            self._run()
            data = self._to_host.take(self.clock.time)
            if data:
                return data
            if self._woken:
                self._woken = False
                return b""
            times = [self._to_host.next_time(), self._to_board.next_time(), self.device.next_event_time()]
            known = [t for t in times if t is not None]
            if deadline is not None:
                known.append(deadline)
            if not known:
                raise UsageError("a read without a deadline would never return: the board has nothing to send")
            target = min(known)
            if deadline is not None and target >= deadline:
                self.clock.time = max(self.clock.time, deadline)
                self._run()
                return self._to_host.take(self.clock.time)
            # Time must advance even if the device has an event that is due now.
            self.clock.time = target if target > self.clock.time else self.clock.time + 1e-6

    def _run(self) -> None:
        now = self.clock.time
        deliver(self._to_board, self.device, now)
        self.device.step(now)
        # While the line is busy the device keeps its bytes, so that it notices when it sends too much.
        if self._to_host.next_time() is None:
            out = self.device.data_to_send()
            if out:
                self._to_host.put(out, now)

    def _check(self) -> None:
        if not self._open:
            raise LinkClosedError(f"{self.url} is closed", url=self.url)
        if self.lost:
            self._open = False
            raise LinkLostError(f"{self.url} was unplugged", url=self.url)


class Arrivals:
    """When bytes arrived that a server finds waiting: after a stall of the server they have not come just now."""

    def __init__(self) -> None:
        self._looked = math.inf

    def since(self, begun: float, wait: float, now: float) -> float:
        """The earliest time at which bytes that are found now may have come.

        Args:
            begun: When the server began to wait for them.
            wait: How long it meant to wait at most, seconds.
            now: When it found them.
        """
        # Also while it dealt with what it found before.
        stall = max(0.0, begun - self._looked) + max(0.0, now - begun - wait)
        self._looked = now
        return now - stall if stall > _STALL else now


class PacedLine:
    """One direction of a serial line: bytes put in come out at the line rate, 10 bits each.

    Args:
        baud: Bits per second; with 0, bytes take no time.

    Attributes:
        came: When the first of the bytes that were taken last had arrived.
    """

    def __init__(self, baud: int) -> None:
        self.came = -math.inf
        self._per_byte = _BITS / baud if baud else 0.0
        self._queue: deque[tuple[float, bytes]] = deque()
        self._free_at = 0.0

    def put(self, data: bytes, now: float) -> None:
        """Bytes enter the line at `now`, or when it is free."""
        if not data:
            return
        start = max(now, self._free_at)
        self._free_at = start + len(data) * self._per_byte
        self._queue.append((start, data))

    def take(self, now: float, *, everything: bool = False, whole: bool = False) -> bytes:
        """The bytes that have arrived by `now`; with `whole`, only all that were put in together."""
        arrived: list[bytes] = []
        while self._queue:
            start, data = self._queue[0]
            if everything or not self._per_byte:
                count = len(data)
            else:
                count = min(len(data), int((now - start) / self._per_byte + 1e-6))
            if count <= 0 or (whole and count < len(data)):
                break
            if not arrived:
                self.came = start + self._per_byte
            arrived.append(data[:count])
            if count < len(data):
                self._queue[0] = (start + count * self._per_byte, data[count:])
                break
            self._queue.popleft()
        return b"".join(arrived)

    def cut(self, most: int) -> None:
        """Lose what waits beyond so many bytes."""
        kept = deque[tuple[float, bytes]]()
        for start, data in self._queue:
            if data := data[:most]:
                kept.append((start, data))
                most -= len(data)
                self._free_at = start + len(data) * self._per_byte
        self._queue = kept

    def next_time(self) -> float | None:
        """When all of the piece that is on the line now arrives; None if the line is empty."""
        if not self._queue:
            return None
        start, data = self._queue[0]
        return start + len(data) * self._per_byte


def deliver(line: PacedLine, device: ServedDevice, now: float) -> None:
    """Give a device what has arrived on its line.

    It judges silence up to when the first of it came, as if it had run then, and none after that: whoever serves it
    may be late, and what has arrived ends a silence.
    """
    if data := line.take(now):
        device.step(min(line.came, now))
        device.receive(data, now)


class DeviceServer(ABC):
    """A device behind a line of its own, for other programs.

    Args:
        device: The board, or the servos of a bus.
        baud: Rate of the line between host and device; 0 is unpaced.
        reset_on_open: Reset the device when a host opens its end, as DTR does on an Arduino.
        hands: The joints that programs of this user on this machine may move by hand; none if None.
    """

    def __init__(self, device: ServedDevice, *, baud: int, reset_on_open: bool, hands: Hands | None) -> None:
        self.device = device
        self._baud = baud
        self._reset_on_open = reset_on_open
        self._hands = hands
        self._door: HandServer | None = None
        self._to_board, self._to_host = PacedLine(baud), PacedLine(baud)
        self._arrivals = Arrivals()

    @abstractmethod
    def open(self) -> str:
        """Make the line; returns its address for hosts."""

    @abstractmethod
    def close(self) -> None:
        """Take the line away."""

    @abstractmethod
    def run_once(self, timeout: float = _IDLE) -> None:
        """Wait for bytes, a host or the next event, at most `timeout` seconds, and act on them."""

    def serve(self, stop: Callable[[], bool], announce: Callable[[str], None], *, shows: bool = False) -> None:
        """Serve until told to stop.

        Args:
            stop: Called at least every quarter of a second; True ends it.
            announce: Called with the address for hosts once the line is open.
            shows: `stop` shows pictures of a twin, and is called for each of them.
        """
        try:
            announce(self.open())
            while not stop():
                self.run_once(FRAME if shows else _IDLE)
        finally:
            self.close()

    def _open_door(self, name: str) -> None:
        """Let hands find the arm by a name, see `serve_hand`."""
        if self._hands is not None:
            from .serve_hand import HandServer

            self._door = HandServer(name, self._hands)
            self._door.open()

    def _wait(self, timeout: float) -> float:
        """Seconds until there is something to do without input, `timeout` at most."""
        now, lines = time.monotonic(), (self._to_host.next_time(), self._to_board.next_time())
        due = [max(t - now, 0.0) for t in (self.device.next_event_time(), *lines) if t is not None]
        if self._baud and lines != (None, None):
            due.append(_SLICE)
        if self._door is not None and self._door.is_busy:
            due.append(_HAND_PERIOD)
        return min([timeout, *due])
