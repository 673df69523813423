"""An emulated device behind a TCP port, or behind a POSIX queue.

The port is for systems without pseudo-terminals, and for other machines in a test. Owns the port: one host at a
time, a new one replaces nobody.
"""

from __future__ import annotations

import contextlib
import time
from typing import TYPE_CHECKING

from hexwire.errors import LinkError, LinkTimeoutError
from hexwire.link.listener import Listener
from hexwire.system import READABLE, make_poll

from .serve import FRAME, Arrivals, DeviceServer, PacedLine, ServedDevice, deliver
from .serve_hand import port_name

if TYPE_CHECKING:
    from collections.abc import Callable

    from hexwire.link.base import Link
    from hexwire.link.tcp import PeerLink

    from .hand import Hands

__all__ = ["TcpServer", "serve_queue"]

_IDLE = 0.25
_KEPT = 4096
"""Bytes of a host that has hung up which its line still takes: those in the buffer of a real adapter."""


class TcpServer(DeviceServer):
    """A TCP port with a device behind it.

    Args:
        device: The board, or the servos of a bus.
        host: Address to bind.
        port: Port; 0 selects a free one.
        baud: Rate of the emulated line between host and device; 0 is unpaced.
        reset_on_open: Reset the device when a host connects, as DTR does on an Arduino.
        hands: The joints that programs of this user on this machine may move by hand; none if None.
    """

    def __init__(
        self,
        device: ServedDevice,
        host: str,
        port: int,
        *,
        baud: int = 0,
        reset_on_open: bool = False,
        hands: Hands | None = None,
    ) -> None:
        super().__init__(device, baud=baud, reset_on_open=reset_on_open, hands=hands)
        self._listener = Listener(host, port)
        self._guest: PeerLink | None = None

    def open(self) -> str:
        """Listen; returns the address to give to a host, such as ``tcp://127.0.0.1:40001``.

        Raises:
            LinkError: As `Listener.open`.
        """
        self._listener.open()
        self._open_door(port_name(self._listener.port))
        return self._listener.url.replace("tcp-listen:", "tcp:", 1)

    def close(self) -> None:
        """Hang up and stop listening."""
        if self._door is not None:
            self._door.close()
        self._hang_up()
        self._listener.close()

    def run_once(self, timeout: float = _IDLE) -> None:
        """Wait for bytes, a host or the next event, at most `timeout` seconds, and act on them."""
        wait = self._wait(timeout)
        poll, guest, door = make_poll(), self._guest, self._door
        poll.register(self._listener.fileno(), READABLE)
        by_hand = [] if door is None else door.descriptors()
        for fd in by_hand:
            poll.register(fd, READABLE)
        if guest is not None:
            poll.register(guest.fileno(), READABLE)
        begun = time.monotonic()
        ready = {fd for fd, _ in poll.poll(wait * 1000.0)}
        arrived = self._arrivals.since(begun, wait, time.monotonic())
        if door is not None and (door.is_busy or not ready.isdisjoint(by_hand)):
            door.step(time.monotonic())
        try:
            called = self._listener.fileno() in ready
            if guest is not None and guest.fileno() in ready:
                self._to_board.put(guest.read(0.0), arrived)
            # Silence is judged up to when a look began that found nothing: this process may stall anywhere.
            now = time.monotonic()
            if guest is not None:
                for _ in guest.leftovers():
                    self._to_board.put(guest.read(0.0), arrived)
                    arrived, now = now, time.monotonic()
            if called:
                self._let_in()
            self._step(now)
        except LinkError:
            self._hang_up()

    def _let_in(self) -> None:
        if self._guest is not None:
            # A line has one host. Whoever comes later learns it at once.
            self._listener.turn_away()
            return
        self._guest = self._listener.accept(0.0)
        if self._guest is not None and self._reset_on_open:
            self.device.reset(time.monotonic())

    def _step(self, now: float) -> None:
        deliver(self._to_board, self.device, now)
        self.device.step(now)
        # While the line is behind, the device keeps its bytes.
        if self._to_host.next_time() is None and (out := self.device.data_to_send()):
            self._to_host.put(out, now)
        out = self._to_host.take(now, whole=True)  # as `PtyServer`
        if out and self._guest is not None:
            self._guest.write(out, now + _IDLE)

    def _hang_up(self) -> None:
        if self._guest is not None:
            self._guest.close()
            self._guest = None
            # Else a burst keeps the next host waiting long after who sent it has left.
            self._to_board.cut(_KEPT)


def serve_queue(
    device: ServedDevice,
    link: Link,
    *,
    stop: Callable[[], bool],
    announce: Callable[[str], None],
    shows: bool = False,
) -> None:
    """Serve a device on a link that keeps messages until told to stop; what nobody takes is lost.

    Args:
        device: A board whose connection has conversations.
        link: The server's end of a queue; opened and closed here.
        stop: Called at least every quarter of a second; True ends it.
        announce: Called with the address for hosts once the link is open.
        shows: As of `DeviceServer.serve`.
    """
    idle = FRAME if shows else _IDLE
    with link:
        announce(link.url.partition("?")[0])
        arrivals, line = Arrivals(), PacedLine(0)
        while not stop():
            begun = time.monotonic()
            due = device.next_event_time()
            deadline = begun + idle if due is None else min(due, begun + idle)
            data = link.read(deadline)
            now = time.monotonic()
            arrived = arrivals.since(begun, max(0.0, deadline - begun), now)
            # Silence is judged up to when a look began that found nothing, as in `TcpServer`.
            line.put(data or link.read(now), arrived)
            deliver(line, device, now)
            device.step(now)
            if out := device.data_to_send():
                with contextlib.suppress(LinkTimeoutError):
                    link.write(out, now)
