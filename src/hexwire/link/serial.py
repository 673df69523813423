"""Serial ports by termios: raw, exclusive, any baud rate, no thread. For Linux; see `hexwire.link.serial_port`.

Owns the port's settings. Must not know the device on it.

The bytes must not be changed: with the terminal's usual line discipline (ICRNL) each 0D arrives as 0A, which
damaged the chapter's own log (PROTOCOL.md section 5). HUPCL is off, so that closing the port does not reset the
board at its next opening.
"""

from __future__ import annotations

import sys

if sys.platform != "linux":
    raise ImportError("hexwire.link.serial is for Linux; hexwire.link.open chooses a link for any system")

import array
import contextlib
import fcntl
import os
import stat
import struct
import termios
from functools import partial

from hexwire.errors import LinkError, LinkLostError, UsageError

from . import port_identity
from .serial_port import DEFAULT_BAUD, SerialPortLink, busy_port, explain_opening

__all__ = ["SerialLink", "terminal_rate"]

# Permitted deviation of the driver's rate from the requested rate: a receiver resynchronises at every start bit and
# tolerates about 2 % from each side (ATmega2560 data sheet, table of receiver tolerances).
_BAUD_TOLERANCE = 0.025

# linux/asm-generic/termbits.h and ioctls.h: constants that Python's termios lacks.
_BOTHER = 0o010000
_CBAUD = 0o010017
_TCGETS2 = 0x802C542A
_TCSETS2 = 0x402C542B
_TERMIOS2 = struct.Struct("=4I20B2I")  # iflag oflag cflag lflag, line and 19 control characters, ispeed ospeed
_ASYNC_LOW_LATENCY = 1 << 13
_SERIAL_STRUCT_INTS = 32  # more than the kernel's serial_struct; flags is its fifth int

# Most bytes that the terminal layer holds.
_MOST_HELD = 4096


def terminal_rate(fd: int) -> int | None:
    """Exact rate of a terminal in bits per second; None if the system does not report it.

    On the master side of a pseudo-terminal it is the rate that the program on the other side has set.
    """
    try:
        return int(_TERMIOS2.unpack(fcntl.ioctl(fd, _TCGETS2, bytes(_TERMIOS2.size)))[-1])
    except OSError:
        return None


class SerialLink(SerialPortLink):
    """A serial port, 8N1, raw, for one program at a time.

    Opening a port raises DTR, which resets an Arduino; the kernel does that, and it is not changed. Ask the board
    until it answers, then flush.

    Args:
        device: Path, such as ``/dev/ttyUSB0``. It may be a symbolic link that vanishes and comes back. A link
            object belongs to one device: a different device that comes back under that name is refused, and so is
            a terminal in which a program runs.
        baud: Bits per second; any rate that the port's driver supports.
        low_latency: Ask the driver to deliver bytes at once (FTDI: 1 ms instead of 16); ignored if the driver does
            not support it.
        reset_board: Pulse DTR after opening, to reset a board even if opening does not.
        raise_to: Rate to which a session shall raise the line once it knows the board; 0 leaves it.

    Attributes:
        baud: The present rate.
        raise_to: Rate to which a session shall raise the line; 0 leaves it.
    """

    def __init__(
        self,
        device: str,
        baud: int = DEFAULT_BAUD,
        *,
        low_latency: bool = True,
        reset_board: bool = False,
        raise_to: int = 0,
    ) -> None:
        if "\0" in device:
            raise UsageError(f"{device!r} is not a path: it contains a zero character")
        super().__init__(device, baud, low_latency=low_latency, reset_board=reset_board, raise_to=raise_to)
        self._port = -1

    def _set_dtr(self, on: bool) -> None:
        # Another thread may have closed it meanwhile.
        if (port := self._port) >= 0:
            fcntl.ioctl(port, termios.TIOCMBIS if on else termios.TIOCMBIC, struct.pack("I", termios.TIOCM_DTR))

    def set_rate(self, baud: int) -> None:
        self.baud = baud
        if self.is_open:
            self._apply_settings()

    def flush_input(self) -> int:
        count = super().flush_input()
        # Bytes that are still in the driver cannot be counted, but they can be discarded.
        with contextlib.suppress(termios.error, OSError):
            termios.tcflush(self._port, termios.TCIFLUSH)
        return count

    def _open(self) -> None:
        try:
            # Non-blocking also means not waiting for a modem's carrier.
            self._port = os.open(self.device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            raise explain_opening(error, self.device, self.url) from error
        if not stat.S_ISCHR(os.fstat(self._port).st_mode) or not os.isatty(self._port):
            raise self._no_port("is not a serial port")
        # Before anything is set or locked: it may be a terminal in which a program runs.
        identity = self._check_identity()
        self._claim(alone=not identity.terminal)
        self._apply_settings()
        if self._low_latency:
            self._ask_low_latency()
        self._identity = identity
        self._read_now = partial(os.read, self._port, _MOST_HELD)
        self._write_now = partial(os.write, self._port)

    def _check_identity(self) -> port_identity.PortIdentity:
        """Refuse a port that is not the intended one."""
        try:
            identity = port_identity.identify_port(self.device, os.fstat(self._port))
        except OSError as error:  # the symbolic link has just changed
            raise explain_opening(error, self.device, self.url) from error
        self._check_intended(identity)
        return identity

    def _close(self) -> None:
        if self._port >= 0:
            # In this order: after Ctrl-C between the two, another file may have the number.
            port, self._port = self._port, -1
            os.close(port)

    def _fileno(self) -> int:
        return self._port

    def _read_ready(self) -> bytes:
        data = os.read(self._port, _MOST_HELD)
        if not data:
            # Readable but empty: the other side of the port is gone.
            raise LinkLostError(f"{self.device} went away{self._lost_advice}", url=self.url)
        return data

    def _write_ready(self, data: memoryview | bytes) -> int:
        return os.write(self._port, data)

    # --- opening, step by step --------------------------------------------------------------------

    def _claim(self, *, alone: bool) -> None:
        """Keep other programs out: the lock for programs that check it, TIOCEXCL for all others except root.

        The second one would outlive this program at a pseudo-terminal, which its other end holds open: no program
        of an ordinary user could open it again.
        """
        try:
            fcntl.flock(self._port, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise busy_port(self.device, self.url) from error
        if alone:
            with contextlib.suppress(OSError):
                fcntl.ioctl(self._port, termios.TIOCEXCL)

    def _apply_settings(self) -> None:
        try:
            taken = self._configure()
        except (OSError, termios.error) as error:
            raise LinkLostError(
                f"{self.device} does not accept its settings ({error.args[-1]}){self._lost_advice}",
                url=self.url,
            ) from error
        if not taken:
            raise LinkError(f"{self.device} refuses raw mode with 8 data bits: use another port", url=self.url)

    def _configure(self) -> bool:
        """Set raw mode and the rate; False if the port did not accept everything."""
        control = list(termios.tcgetattr(self._port)[6])
        control[termios.VMIN] = 1
        control[termios.VTIME] = 0
        speed = getattr(termios, f"B{self.baud}", None)
        wanted = termios.CS8 | termios.CREAD | termios.CLOCAL
        base = termios.B38400 if speed is None else speed
        termios.tcsetattr(self._port, termios.TCSANOW, [0, 0, wanted | base, 0, base, base, control])
        if speed is None:
            self._set_any_baud()
        actual = self._actual_baud()
        if actual is not None and abs(actual - self.baud) > self.baud * _BAUD_TOLERANCE:
            raise self._bad_baud(f"it chose {actual}")
        iflag, oflag, cflag, lflag = termios.tcgetattr(self._port)[:4]
        return not (iflag or oflag or lflag) and bool(cflag & termios.CSIZE == termios.CS8)

    def _set_any_baud(self) -> None:
        try:
            fields = list(_TERMIOS2.unpack(self._ioctl_read(_TCGETS2, _TERMIOS2.size)))
            fields[2] = fields[2] & ~_CBAUD | _BOTHER
            fields[-2:] = self.baud, self.baud
            fcntl.ioctl(self._port, _TCSETS2, _TERMIOS2.pack(*fields))
        except OSError as error:
            raise self._bad_baud("only the usual rates work on this system") from error

    def _actual_baud(self) -> int | None:
        """The actual rate of the driver; None if the system does not report it."""
        return terminal_rate(self._port)

    def _ioctl_read(self, request: int, size: int) -> bytes:
        return fcntl.ioctl(self._port, request, bytes(size))

    def _ask_low_latency(self) -> None:
        # Pseudo-terminals and CDC-ACM boards have no such setting.
        with contextlib.suppress(OSError):
            settings = array.array("i", [0] * _SERIAL_STRUCT_INTS)
            fcntl.ioctl(self._port, termios.TIOCGSERIAL, settings)
            settings[4] |= _ASYNC_LOW_LATENCY
            fcntl.ioctl(self._port, termios.TIOCSSERIAL, settings)
