"""Serial ports by pyserial, for systems on which hexwire has no own link to them, and with ``backend=pyserial``.

Owns two threads that carry bytes between the port and a pair of sockets; everything else, such as deadlines and
closing in another thread, is that of every link. pyserial alone cannot wait for bytes, a deadline and a wake-up at
once on every system. The price is two thread changes for a request and two for its answer. Must not know the device
on the port.
"""

from __future__ import annotations

import contextlib
import errno
import socket
import stat
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hexwire.errors import LinkError, LinkLostError
from hexwire.system import device_number, device_parts

from . import port_identity
from .serial_port import DEFAULT_BAUD, SerialPortLink, busy_port, explain_opening

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["PySerialLink"]

_SLICE = 0.1
"""Seconds after which the reading thread checks whether the link is closed: Windows may lose an early cancel."""
_LAST = 1.0
"""Seconds, besides their time on the line, for which closing waits for bytes that the port has not accepted yet."""
_AHEAD = 4096
"""Bytes that may wait for the port, about as many as a terminal of the system holds."""
_PIECE = 4096


class PySerialLink(SerialPortLink):
    """A serial port, 8N1, raw, for one program at a time; opening it raises DTR, which resets an Arduino.

    Args:
        device: Name of the port: ``COM3``, ``/dev/cu.usbserial-1``, ``/dev/ttyUSB0``.
        baud: Bits per second; any rate that the port's driver supports.
        low_latency: Ask the driver to deliver bytes at once, where the system has such a setting.
        reset_board: Pulse DTR after opening, to reset a board even if opening does not.
        raise_to: As of `SerialLink`.
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
        super().__init__(device, baud, low_latency=low_latency, reset_board=reset_board, raise_to=raise_to)
        self._port: Any = None
        self._near: socket.socket | None = None
        self._pumps: list[threading.Thread] = []
        self._fault = ""
        self._idle = threading.Condition()
        # Bytes that the link has accepted and the port has not.
        self._ahead = 0

    def _set_dtr(self, on: bool) -> None:
        if (port := self._port) is not None:
            port.dtr = on

    def set_rate(self, baud: int) -> None:
        # Bytes that were written before leave at the old rate.
        patience = self._patience()
        self.baud = baud
        if self.is_open:
            with self._idle:
                self._idle.wait_for(lambda: not self._ahead, patience)
            try:
                self._port.baudrate = baud
            except ValueError as error:
                raise self._bad_baud("its driver refuses it") from error
            except OSError as error:
                raise self._lose(error) from error

    def flush_input(self) -> int:
        count = super().flush_input()
        # Bytes that are still in the driver cannot be counted, but they can be discarded.
        with contextlib.suppress(OSError):
            self._port.reset_input_buffer()
        return count + super().flush_input()

    # --- opening and closing ----------------------------------------------------------------------------------

    def _open(self) -> None:
        import serial

        identity = self._check_identity()
        try:
            self._port = serial.Serial(self.device, self.baud, timeout=_SLICE, exclusive=True)
        except ValueError as error:
            raise self._bad_baud("its driver refuses it") from error
        except OSError as error:
            raise self._explain(error) from error
        self._identity = identity
        if self._low_latency and hasattr(self._port, "set_low_latency_mode"):
            # Pseudo-terminals and CDC-ACM boards have no such setting; pyserial calls that a ValueError.
            with contextlib.suppress(OSError, ValueError, NotImplementedError):
                self._port.set_low_latency_mode(True)
        self._near, far = socket.socketpair()
        self._near.setblocking(False)
        self._near.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _AHEAD)
        self._fault, self._ahead = "", 0
        for pump, name in ((self._carry_in, "serial port in"), (self._carry_out, "serial port out")):
            thread = threading.Thread(target=self._run, args=(pump, self._port, far), name=name, daemon=True)
            self._pumps.append(thread)
            thread.start()
        self._far = far

    def _check_identity(self) -> port_identity.PortIdentity | None:
        """Refuse a port that is not the intended one, on a system that numbers its devices."""
        if not self.device.startswith("/"):
            return None
        try:
            status = Path(self.device).stat()
            if not stat.S_ISCHR(status.st_mode):
                raise self._no_port("is not a serial port")
            if device_parts(device_number(status)) == (0, 0):
                return None
            identity = port_identity.identify_port(self.device, status)
        except LinkError:
            raise
        except OSError as error:
            raise self._explain(error) from error
        self._check_intended(identity)
        return identity

    def _close(self) -> None:
        if self._near is not None:
            # What was written goes out first; then neither thread may wait any more.
            with contextlib.suppress(OSError):
                self._near.shutdown(socket.SHUT_WR)
            for pump in self._pumps[1:]:
                pump.join(self._patience())
            with contextlib.suppress(OSError):
                self._near.shutdown(socket.SHUT_RDWR)
            for cancel in ("cancel_write", "cancel_read"):
                with contextlib.suppress(OSError):
                    getattr(self._port, cancel)()
            for pump in self._pumps:
                pump.join()
            self._pumps.clear()
            self._far.close()
            self._near.close()
            self._near = None
        if self._port is not None:
            port, self._port = self._port, None
            with contextlib.suppress(OSError):
                port.close()

    def _patience(self) -> float:
        """Seconds for which bytes on their way are waited for; 10 bits to a byte."""
        return _LAST + 10.0 * self._ahead / self.baud

    # --- the two threads --------------------------------------------------------------------------------------

    def _run(self, pump: Callable[[Any, socket.socket], None], port: Any, far: socket.socket) -> None:
        try:
            pump(port, far)
        # pyserial lets TypeError pass when a port is closed under it.
        except (OSError, TypeError) as error:
            self._fault = self._fault or str(error)
        with contextlib.suppress(OSError):
            far.shutdown(socket.SHUT_RDWR)
        with self._idle:
            self._ahead = 0
            self._idle.notify_all()

    def _carry_in(self, port: Any, far: socket.socket) -> None:
        while not self._closing:
            data = port.read(1)
            if data:
                far.sendall(data + port.read(min(port.in_waiting, _PIECE)))

    def _carry_out(self, port: Any, far: socket.socket) -> None:
        while data := far.recv(_PIECE):
            left = memoryview(data)
            while len(left):
                # Less than all of it only when the write was cancelled.
                sent = port.write(left)
                if self._closing and not sent:
                    return
                left = left[sent or 0 :]
            with self._idle:
                self._ahead -= len(data)
                self._idle.notify_all()

    # --- the link's side --------------------------------------------------------------------------------------

    def _fileno(self) -> int:
        return -1 if self._near is None else self._near.fileno()

    def _read_ready(self) -> bytes:
        assert self._near is not None
        data = self._near.recv(65536)
        if not data:
            raise LinkLostError(f"{self.device} went away{self._lost_advice}", url=self.url)
        return data

    def _write_ready(self, data: memoryview | bytes) -> int:
        assert self._near is not None
        with self._idle:
            sent = self._near.send(data)
            self._ahead += sent
        return sent

    # --- errors -----------------------------------------------------------------------------------------------

    def _explain(self, error: OSError) -> LinkError:
        # On Windows pyserial keeps the cause in the text alone, and a port in use shows as a refused access.
        text = str(error)
        if error.errno == errno.EAGAIN or "Could not exclusively lock" in text or "PermissionError(13" in text:
            return busy_port(self.device, self.url)
        if "FileNotFoundError(2" in text:
            return self._no_port("does not exist")
        if f"Could not configure port: ({errno.ENOTTY}," in text:
            return self._no_port("is not a serial port")
        return explain_opening(error, self.device, self.url)
