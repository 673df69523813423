"""A simulated board behind a pseudo-terminal, in real time; and the boot loader that a Mega 2560 starts with.

For the few tests that go end to end. Everything else runs in simulated time.
"""

from __future__ import annotations

import os
import select
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from tests.avr.machines import Machine
from tests.defaults import patient_line
from tests.patient_node import REPLY_WINDOW

from hexwire.link.serial import terminal_rate

_SLICE = 0.002
_UNSET = 38400  # of a terminal that no program has opened
_MOST = 0.05  # after a stall the board does not make up for more


class PtyBoard:
    """Runs a machine at the speed of the wall clock.

    Attributes:
        path: The terminal to open.
    """

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def close(self) -> None:
        self._ended.set()
        self._thread.join(timeout=30)
        os.close(self._master)
        os.close(self._slave)

    def _run(self) -> None:
        last = time.monotonic()
        while not self._ended.is_set():
            ready, _, _ = select.select([self._master], [], [], _SLICE)
            if ready:
                self._take(os.read(self._master, 4096))
            now = time.monotonic()
            rate = terminal_rate(self._master)
            if rate != _UNSET:
                self.machine.set_rate(rate or 115200)
            self.machine.advance(min(now - last, _MOST))
            last = now
            data = self.machine.take()
            if data:
                os.write(self._master, data)

    def _take(self, data: bytes) -> None:
        self.machine.send(data)


_START, _TOKEN = 0x1B, 0x0E
_SIGN_ON, _GET_PARAMETER, _LOAD_ADDRESS = 0x01, 0x03, 0x06
_LEAVE, _PROGRAM_FLASH, _READ_FLASH = 0x11, 0x13, 0x14
_READ_FUSE, _READ_LOCK, _READ_SIGNATURE, _SPI_MULTI = 0x18, 0x1A, 0x1B, 0x1D
_OK = b"\0"


class FlashableBoard(PtyBoard):
    """A board whose boot loader (STK500v2) waits for a flasher, and starts the machine when that is done.

    Attributes:
        flash: What was written.
        writes: Pages written.
    """

    def __init__(self, machine: Machine, signature: str = "1E9801") -> None:
        self.flash = bytearray(b"\xff" * 0x40000)
        self.writes = 0
        self._signature = bytes.fromhex(signature)
        self._address = 0
        self._buffer = b""
        self._loading = True
        super().__init__(machine)

    def _take(self, data: bytes) -> None:
        if not self._loading:
            super()._take(data)
            return
        self._buffer += data
        while len(self._buffer) >= 6:
            if self._buffer[0] != _START:
                self._buffer = self._buffer[1:]
                continue
            size = int.from_bytes(self._buffer[2:4], "big")
            if len(self._buffer) < size + 6:
                return
            answer = self._answer(self._buffer[5 : 5 + size])
            message = bytes((_START, self._buffer[1])) + len(answer).to_bytes(2, "big") + bytes((_TOKEN,)) + answer
            check = 0
            for byte in message:
                check ^= byte
            os.write(self._master, message + bytes((check,)))
            self._buffer = self._buffer[size + 6 :]

    def _answer(self, body: bytes) -> bytes:
        command = body[0]
        ok = bytes((command,)) + _OK
        count = int.from_bytes(body[1:3], "big")
        if command == _SIGN_ON:
            return ok + b"\x08AVRISP_2"
        if command == _GET_PARAMETER:
            return ok + b"\x02"
        if command == _LOAD_ADDRESS:
            self._address = (int.from_bytes(body[1:5], "big") & 0x7FFFFFFF) * 2
        elif command == _PROGRAM_FLASH:
            self.flash[self._address : self._address + count] = body[10 : 10 + count]
            self._address += count
            self.writes += 1
        elif command == _READ_FLASH:
            data = bytes(self.flash[self._address : self._address + count])
            self._address += count
            return ok + data + _OK
        elif command == _READ_SIGNATURE:
            return ok + self._signature[body[4] : body[4] + 1] + _OK
        elif command == _SPI_MULTI:
            # 30 00 n 00 reads byte n of the signature.
            value = self._signature[body[6]] if body[4] == 0x30 else 0xFF
            return ok + bytes((0, body[4], 0, value)) + _OK
        elif command in (_READ_FUSE, _READ_LOCK):
            return ok + b"\xff" + _OK
        elif command == _LEAVE:
            self._loading = False
        return ok


@contextmanager
def on_pty(board: PtyBoard) -> Iterator[PtyBoard]:
    """Close a board and its machine in the end.

    Until then, hosts in this process wait longer for answers: a busy machine simulates a chip that is slow.
    """
    try:
        with pytest.MonkeyPatch.context() as patch:
            patient_line(patch, REPLY_WINDOW)
            yield board
    finally:
        board.close()
        board.machine.close()
