"""An emulated device behind a pseudo-terminal, for other programs: a board, or servos on a bus adapter.

For Linux; elsewhere, see `serve_tcp`. Owns the terminal, its rate, the loops, and the name: a symbolic link, which
never replaces one that another program still serves, that belongs to another user, or that leads to anything but a
pseudo-terminal. A bus keeps the line's timing more finely than a board needs it, and follows the rate that the host
has set: servos set to another rate do not understand it.
"""

from __future__ import annotations

import sys

if sys.platform != "linux":
    raise ImportError("pseudo-terminals for emulated arms are for Linux; give the emulator --tcp HOST:PORT")

import contextlib
import errno
import hashlib
import os
import re
import select
import socket
import stat
import termios
import time
import tty
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hexwire.errors import UsageError
from hexwire.folders import open_folder
from hexwire.link.serial import terminal_rate
from hexwire.system import user_id, user_name

from .bus_device import BusDevice
from .faults import FaultPlan
from .hand import Hands
from .serve import DeviceServer, PacedLine, ServedDevice, deliver
from .serve_hand import terminal_name
from .servo_wire import heard_at

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel

    from .servo import EmulatedServo

__all__ = ["PtyServer", "TerminalName", "serve_bus"]

_TERMINAL = re.compile(r"/dev/pts/[0-9]+")
_IDLE = 0.25
_BUS_IDLE = 0.02
_READ = 4096
_MOST_LOOKS = 4
"""Looks for more bytes in a turn; a terminal keeps few, so whoever fills it so often is not silent."""
_BAUD_RATES = {
    getattr(termios, name): int(name[1:]) for name in dir(termios) if name[:1] == "B" and name[1:].isdigit()
}


class TerminalName:
    """A symbolic link to a terminal while it is served.

    While the link exists, an abstract socket is bound that stands for it, so that another emulator can tell a name
    in use from one left behind. The system releases the socket however this program ends.

    Args:
        link: Path of the link.
        terminal: The terminal's own path.

    Raises:
        UsageError: The link cannot be made, or something that must stay has its name.
    """

    def __init__(self, link: Path, terminal: str) -> None:
        self._link = link
        self._terminal = terminal
        try:
            self._folder = open_folder(link.parent).descriptor
        except UsageError as error:
            raise UsageError(f"cannot make the link {link} (--link): {error}") from None
        self._claim: socket.socket | None = None
        try:
            self._claim = self._claimed()
            self._look()
            self._make()
        except OSError as error:
            self._release()
            raise UsageError(f"cannot make the link {link}: {error.strerror}; choose another --link") from error
        except BaseException:
            self._release()
            raise

    def remove(self) -> None:
        """Remove the link if it still leads to our terminal, which must still be open."""
        if self._folder < 0:
            return
        with contextlib.suppress(OSError):
            found = os.stat(self._link.name, dir_fd=self._folder, follow_symlinks=False)
            ours = stat.S_ISLNK(found.st_mode) and found.st_uid == user_id()
            if ours and os.readlink(self._link.name, dir_fd=self._folder) == self._terminal:
                os.unlink(self._link.name, dir_fd=self._folder)
        self._release()

    def _release(self) -> None:
        os.close(self._folder)
        self._folder = -1
        if self._claim is not None:
            self._claim.close()

    def _claimed(self) -> socket.socket | None:
        """The socket that stands for this name, by whatever path it is reached."""
        folder = os.fstat(self._folder)
        name = f"{folder.st_dev}:{folder.st_ino}:{self._link.name}"
        claim = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            claim.bind(b"\0hexwire-link:" + hashlib.sha256(os.fsencode(name)).hexdigest().encode())
        except OSError as error:
            claim.close()
            if error.errno == errno.EADDRINUSE:
                raise UsageError(
                    f"{self._link} is in use by another emulator; stop that one, or choose another --link"
                ) from None
            return None
        return claim

    def _look(self) -> None:
        """Refuse to replace what is not a link that an emulator of this user has left behind."""
        try:
            found = os.stat(self._link.name, dir_fd=self._folder, follow_symlinks=False)
        except FileNotFoundError:
            return
        if not stat.S_ISLNK(found.st_mode):
            raise UsageError(f"{self._link} exists and is not a symbolic link; choose another --link")
        if found.st_uid != user_id():
            owner = user_name(found.st_uid)
            raise UsageError(f"{self._link} is a link that belongs to {owner}; choose another --link")
        target = os.readlink(self._link.name, dir_fd=self._folder)
        if not _TERMINAL.fullmatch(target):
            raise UsageError(f"{self._link} links to {target}, not to a pseudo-terminal; choose another --link")
        if target == self._terminal:
            return
        with contextlib.suppress(FileNotFoundError):
            terminal = Path(target).stat()
            # A terminal younger than the link only reuses the number.
            if terminal.st_uid == user_id() and terminal.st_ctime_ns <= found.st_mtime_ns:
                raise UsageError(
                    f"{self._link} leads to {target}, which another program of yours has open; stop that program, "
                    "or choose another --link"
                )

    def _make(self) -> None:
        """Make the link, in place of one that `_look` has allowed to replace."""
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self._link.name, dir_fd=self._folder)
        # Fails if another process made it first.
        os.symlink(self._terminal, self._link.name, dir_fd=self._folder)


class PtyServer(DeviceServer):
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
        super().__init__(device, baud=baud, reset_on_open=reset_on_open, hands=hands)
        self._rate = rate
        self.path = ""
        self._link = Path(link) if link else None
        self._name: TerminalName | None = None
        self._master = -1
        self._slave = -1
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
        self._open_door(terminal_name(self.path))
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
        wait = self._wait(timeout)
        mask = select.POLLIN | (select.POLLOUT if self._unsent else 0)
        poll = select.poll()
        poll.register(self._master, mask)
        door = self._door
        if door is not None:
            for fd in door.descriptors():
                poll.register(fd, select.POLLIN)
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
        # No board pauses within a frame, so a process that stalls must not: a host gives a frame up after 50 ms.
        self._unsent += self._garbled(self._to_host.take(now, whole=True), inward=False)
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


def serve_bus(
    servos: Sequence[EmulatedServo],
    *,
    baud: int,
    stop: Callable[[], bool],
    announce: Callable[[str], None],
    link: str | Path | None = None,
    faults: FaultPlan | None = None,
    echo: bool = False,
    arm: ArmModel | None = None,
) -> None:
    """Serve a bus until told to stop.

    Args:
        servos: The servos on it.
        baud: Rate of the servos, of the first if they differ; with 0, bytes take no time and every servo hears any
            rate.
        stop: Called at least every 20 ms; True ends it.
        announce: Called with the path once the terminal is open.
        link: Path of a symbolic link to make to the terminal.
        faults: Scripted faults.
        echo: The adapter hears itself.
        arm: Names of the joints, for hands; None if it is no arm.
    """
    server: PtyServer | None = None

    def host_baud() -> int:
        return (None if server is None else terminal_rate(server.fileno())) or baud

    device = BusDevice(servos, paced=bool(baud), faults=faults, echo=echo, host_baud=host_baud)
    server = PtyServer(device, link=link, hands=Hands(servos, arm))
    path = server.open()
    try:
        announce(path)
        while not stop():
            due = device.answer_due
            if due is None:
                server.run_once(_BUS_IDLE)
            else:
                time.sleep(max(0.0, due - time.monotonic()))
                server.run_once(0.0)
    finally:
        server.close()
