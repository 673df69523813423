"""A program: an emulated Hex7Bot that writes down what its servos do, apart from everything that hexwire reports.

    python -m tests.system.watched_board LOG

Prints the path of its terminal, and ends with its standard input. LOG gets a row for every change of a servo's
target, position or drive, with the time of CLOCK_MONOTONIC, which all programs of a machine share; `fleet_watch`
reads it.
"""

from __future__ import annotations

import struct
import sys
import threading
import time
from pathlib import Path

from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.serve_pty import PtyServer
from hexwire.emulator.servo import EmulatedServo

ROW = struct.Struct("<dBBdd")
"""Time, id, whether it is driven, target and position in counts."""
_TURN = 0.01
"""Most seconds between two looks."""


class Notes:
    """Rows of one servo, of which those are left out that a straight line between their neighbours gives."""

    def __init__(self, servo: EmulatedServo) -> None:
        self._servo = servo
        self._written = self._last = b""
        self._seen: tuple[int, float, float] | None = None

    def look(self, now: float) -> bytes:
        servo = self._servo
        motion = servo.motion
        seen = (int(servo.torque_on), motion.target, motion.position)
        row = ROW.pack(now, servo.servo_id, *seen)
        before, self._last = self._last, row
        if seen == self._seen:
            return b""
        self._seen = seen
        # The end of a time in which it did not change belongs to the log, too.
        rows = row if before == self._written else before + row
        self._written = row
        return rows


def main() -> None:
    board = make_hex7bot_board(baud=0, start=time.monotonic())
    servos = board.wire.servos
    notes = [Notes(servo) for servo in servos]
    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
    with Path(sys.argv[1]).open("wb", buffering=0) as log, PtyServer(board) as server:
        print(server.path, flush=True)
        while not ended.is_set():
            server.run_once(_TURN)
            now = time.monotonic()
            for servo in servos:
                servo.step(now)
            if rows := b"".join(note.look(now) for note in notes):
                log.write(rows)


if __name__ == "__main__":
    main()
