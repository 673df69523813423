"""One board in real time, for the benchmark of motion: `python -m tests.bench.path_chip`.

Owns keeping the simulated chip at the pace of the wall clock, whatever the machine's load, and what was seen on its
servo line. Prints its terminal; ends when standard input ends, and prints what it saw as JSON.
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import time
import tty
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cache

from tests.avr.machines import CLOCK_HZ, ChipBoard, elf

from hexwire.session.decoder import FrameDecoder
from hexwire.wire.board_trajectory import StartReply
from hexwire.wire.command_frame import Command, Frame, Status

_SLICE = 0.0005
_PRIORITY = -15
_OVERFLOW = 1024e-6  # of timer 0, which the firmware's clock counts
_LOOK = 4e-6


@dataclass
class Seen:
    """What one board did.

    Attributes:
        packets: Begin in seconds of the chip's own time, and bytes in hex, of every packet with targets.
        starts: Times at which a path was to start, in the same time.
        epoch: Monotonic clock of the machine when that time was 0.
        behind: Most seconds by which the chip was behind the wall clock when it was its turn.
        niced: Whether it ran at a raised priority.
    """

    packets: list[tuple[float, str]]
    starts: list[float]
    epoch: float
    behind: float = 0.0
    niced: bool = False


def is_target(packet: bytes) -> bool:
    """Whether a packet of the servo line has targets for several servos."""
    return len(packet) > 8 and packet[4] == 0x83 and packet[5] in (0x29, 0x2A)


@cache
def _overflows() -> int:
    """Address of the count of timer 0's overflows in the chip's RAM."""
    listing = subprocess.run(["avr-nm", str(elf())], capture_output=True, text=True, check=True).stdout
    (line,) = [line for line in listing.splitlines() if line.endswith("timer0_overflow_count")]
    return int(line.split()[0], 16) & 0xFFFF


def clock_offset(board: ChipBoard) -> float:
    """Seconds of the chip's time at which the firmware's own clock was 0, to some microseconds.

    The clock counts overflows of a timer; an interrupt counts each of them, and is seldom held up.
    """
    found = []
    for _ in range(5):
        count = _count(board)
        while _count(board) == count:
            board.advance(_LOOK)
        found.append(board.now - _count(board) * _OVERFLOW)
    return min(found)


def _count(board: ChipBoard) -> int:
    return sum(board.peek(_overflows() + i) << 8 * i for i in range(4))


def path_starts(data: bytes, board: ChipBoard) -> list[float]:
    """When paths start, in the chip's time, from what came out of the board's host line."""
    decoder = FrameDecoder()
    decoder.receive(data, 0.0)
    offset, found = clock_offset(board), []
    while (event := decoder.next_event()) is not None:
        if isinstance(event, Frame) and event.cmd == Command.TRAJECTORY_START and event.status == Status.OK:
            found.append(StartReply.parse(event.body).time_us * 1e-6 + offset)
    return found


def main() -> None:
    """Run until standard input ends."""
    niced = False
    with suppress(PermissionError):
        niced = os.nice(_PRIORITY) < 0
    board = ChipBoard()
    board.settle()
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    print(os.ttyname(slave), flush=True)
    seen = Seen([], [], time.monotonic() - board.now, niced=niced)
    heard = bytearray()
    while True:
        ready, _, _ = select.select([master, 0], [], [], _SLICE)
        if 0 in ready:
            break
        late = time.monotonic() - seen.epoch - board.now
        seen.behind = max(seen.behind, late)
        # It makes up for all that it missed: its time stays that of the wall. What came comes after that.
        if late * CLOCK_HZ > 1:
            board.advance(late)
        if master in ready:
            board.send(os.read(master, 4096))
        if data := board.take():
            heard += data
            with suppress(BlockingIOError):  # nobody reads
                os.write(master, data)
    seen.packets = [(begin, packet.hex()) for begin, packet in board.line.sent if is_target(packet)]
    seen.starts = path_starts(bytes(heard), board)
    print(json.dumps(asdict(seen)), flush=True)
    board.close()


if __name__ == "__main__":
    main()
