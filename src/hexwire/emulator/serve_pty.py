"""An emulated device behind a pseudo-terminal, for other programs. For Linux; elsewhere, see `serve_tcp`.

Owns the terminal, its rate, and its name. Must not know what the device is.
"""

from __future__ import annotations

import sys

if sys.platform != "linux":
    raise ImportError("pseudo-terminals for emulated arms are for Linux; give the emulator --tcp HOST:PORT")

import errno
import os
import select
import stat
import termios
import time
import tty
from pathlib import Path
from typing import TYPE_CHECKING

from hexwire.link.serial import terminal_rate

from .serve import Arrivals, PacedLine, ServedDevice, deliver
from .serve_hand import HAND_PERIOD, HandServer, terminal_name
from .serve_link import TerminalName
from .uart import heard_at

if TYPE_CHECKING:
    from collections.abc import Callable

    from .hand import Hands

__all__ = ["PtyServer", "serve_board"]

_IDLE = 0.25
_SLICE = 0.001
_READ = 4096
_MOST_LOOKS = 4
"""Looks for more bytes in a turn; a terminal keeps few, so whoever fills it so often is not silent."""
_BAUD_RATES = {
    getattr(termios, name): int(name[1:]) for name in dir(termios) if name[:1] == "B" and name[1:].isdigit()
}


class PtyServer:
    """A pseudo-terminal with a device behind it.

    Args:
        device: The board.
        link: Path of a symbolic link to make to the terminal; none if None.
        baud: Line rate; 0 is unpaced. If paced, a host that opens the port at another rate gets garbage.
        reset_on_open: Reset the device when the port is opened, as DTR does on an Arduino. The sticky bit of the
            terminal says so to those who open it.
        hands: The joints that programs of this user may move by hand; none if None.
        rate: Present rate of a paced line whose device changes it; it starts with `baud`.
    """

    def __init__(
        self,
        device: ServedDevice,
        *,
        link: str | Path | None = None,
        baud: int = 0,
        reset_on_open: bool = False,
        hands: Hands | None = None,
        rate: Callable[[], int] | None = None,
    ) -> None:
        self.device = device
        self._rate = rate
        self.path = ""
        self._hands = hands
        self._door: HandServer | None = None
        self._link = Path(link) if link else None
        self._baud = baud
        self._reset_on_open = reset_on_open
        self._name: TerminalName | None = None
        self._master = -1
        self._slave = -1
        self._to_board = PacedLine(baud)
        self._to_host = PacedLine(baud)
        self._arrivals = Arrivals()
        self._unsent = b""
        self._hung_up = True

    def open(self) -> str:
        """Make the terminal; returns the path to give to a host.

        Raises:
            UsageError: `link` cannot be made, or something that must stay has its name.
        """
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self._set_rate(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        if self._hands is not None:
            self._door = HandServer(terminal_name(self.path), self._hands)
            self._door.open()
        if self._reset_on_open:
            # The master shows when a host opens and closes the terminal only if we do not hold it open.
            os.fchmod(self._slave, stat.S_IMODE(os.fstat(self._slave).st_mode) | stat.S_ISVTX)
            os.close(self._slave)
            self._slave = -1
        if self._link is not None:
            try:
                self._name = TerminalName(self._link, self.path)
            except BaseException:
                self.close()
                raise
            return str(self._link)
        return self.path

    def _set_rate(self, slave: int) -> None:
        # A terminal starts at 38400: a program that sets no rate would receive only garbage.
        code = next((code for code, rate in _BAUD_RATES.items() if rate == self._baud), None)
        if self._baud and code is not None:
            settings = termios.tcgetattr(slave)
            settings[4] = settings[5] = code
            termios.tcsetattr(slave, termios.TCSANOW, settings)

    def close(self) -> None:
        """Remove the symbolic link and close the terminal."""
        if self._door is not None:
            self._door.close()
        # In this order: the number of a closed terminal goes to the next one that is opened.
        if self._name is not None:
            self._name.remove()
            self._name = None
        for fd in (self._master, self._slave):
            if fd >= 0:
                os.close(fd)
        self._master = self._slave = -1

    def fileno(self) -> int:
        """Descriptor that turns readable when a host writes."""
        return self._master

    def run_once(self, timeout: float = _IDLE) -> None:
        """Wait for bytes or the next event, at most `timeout` seconds, and act on them."""
        self._follow_rate()
        now = time.monotonic()
        due = [t for t in (self.device.next_event_time(), self._to_host.next_time()) if t is not None]
        arriving = self._to_board.next_time()
        if arriving is not None:
            due.append(arriving)
        wait = min([timeout, *(max(t - now, 0.0) for t in due)])
        if self._baud and (self._to_host.next_time() is not None or arriving is not None):
            wait = min(wait, _SLICE)
        mask = select.POLLIN | (select.POLLOUT if self._unsent else 0)
        poll = select.poll()
        poll.register(self._master, mask)
        door = self._door
        if door is not None:
            for fd in door.descriptors():
                poll.register(fd, select.POLLIN)
            wait = min(wait, HAND_PERIOD) if door.is_busy else wait
        begun = time.monotonic()
        found = poll.poll(wait * 1000)
        events = [row for row in found if row[0] == self._master]
        now = time.monotonic()
        arrived = self._arrivals.since(begun, wait, now)
        if door is not None and (door.is_busy or len(found) > len(events)):
            door.step(now)
        for _, flags in events:
            if flags & select.POLLIN:
                self._read(now, arrived)
            if flags & select.POLLHUP and not flags & select.POLLIN:
                # Nobody has the port open: the condition persists, so do not spin on it.
                self._hung_up = True
                time.sleep(min(0.02, max(timeout, 0.0)))
        if not events or not any(flags & select.POLLHUP for _, flags in events):
            self._seen_open(now)
        # The device must not answer at a time before the request was sent, although this process stalls. And
        # silence is judged up to when a look began that found nothing.
        now = time.monotonic()
        for _ in range(_MOST_LOOKS):
            if not self._is_waiting():
                break
            self._read(now, arrived)
            arrived, now = now, time.monotonic()
        deliver(self._to_board, self.device, now)
        self.device.step(now)
        self._follow_rate()
        # While the line or the host is behind, the device keeps its bytes.
        if self._to_host.next_time() is None and not self._unsent:
            out = self.device.data_to_send()
            if out:
                self._to_host.put(out, now)
        self._write(now)

    def _is_waiting(self) -> bool:
        """Whether bytes of the host wait to be read."""
        poll = select.poll()
        poll.register(self._master, select.POLLIN)
        return any(flags & select.POLLIN for _, flags in poll.poll(0))

    def _follow_rate(self) -> None:
        """Take over the rate of the device. What is on the line then is lost, as on a real one."""
        if self._baud and self._rate is not None and (rate := self._rate()) != self._baud:
            self._baud = rate
            self._to_board, self._to_host = PacedLine(rate), PacedLine(rate)

    def _seen_open(self, now: float) -> None:
        if self._hung_up:
            self._hung_up = False
            if self._reset_on_open:
                self.device.reset(now)

    def _read(self, now: float, arrived: float) -> None:
        try:
            data = os.read(self._master, _READ)
        except OSError as error:
            if error.errno not in (errno.EIO, errno.EAGAIN):
                raise
            return
        self._seen_open(now)
        self._to_board.put(self._garbled(data, inward=True), arrived)

    def _write(self, now: float) -> None:
        self._unsent += self._garbled(self._to_host.take(now), inward=False)
        if not self._unsent:
            return
        try:
            written = os.write(self._master, self._unsent)
        except BlockingIOError:
            return
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            written = len(self._unsent)
        self._unsent = self._unsent[written:]

    def _garbled(self, data: bytes, *, inward: bool) -> bytes:
        """The bytes that the other side hears if the host uses another rate."""
        if not self._baud or not data:
            return data
        rate = terminal_rate(self._master) or self._baud
        return heard_at(data, *((rate, self._baud) if inward else (self._baud, rate)))

    def __enter__(self) -> PtyServer:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def serve_board(
    device: ServedDevice,
    *,
    link: str | Path | None = None,
    baud: int = 0,
    reset_on_open: bool = False,
    hands: Hands | None = None,
    rate: Callable[[], int] | None = None,
    stop: Callable[[], bool],
    announce: Callable[[str], None],
) -> None:
    """Serve a device on a pseudo-terminal until told to stop.

    Args:
        device: The board.
        link: Path of a symbolic link to make to the terminal.
        baud: Line rate; 0 is unpaced.
        reset_on_open: Reset the board when the port is opened.
        hands: The joints that can be moved by hand.
        rate: As of `PtyServer`.
        stop: Called at least every quarter of a second; True ends it.
        announce: Called with the path once the terminal is open.
    """
    server = PtyServer(device, link=link, baud=baud, reset_on_open=reset_on_open, hands=hands, rate=rate)
    path = server.open()
    try:
        announce(path)
        while not stop():
            server.run_once()
    finally:
        server.close()
