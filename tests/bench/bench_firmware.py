"""The firmware's figures, in simulated time on the simulated chip, beside the chapter's and the wire's own limit.

The chapter's figures were measured on its sketch in the same simulator. The limits are arithmetic: 10 bits a byte
at 115200, 250 us from the end of a request to the answer.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.avr.client import Client
from tests.avr.machines import ChipBoard

from hexwire.wire.command_frame import Command
from hexwire.wire.commands import JointReport
from hexwire.wire.servo_packet import Instruction, make_read

BYTE = 10 / 115200
DELAY = 250e-6
LEGACY_READ = 16 * BYTE + DELAY
SYNC_READ = (11 + 3 * 8) * BYTE + 3 * DELAY
CYCLE = 4 * LEGACY_READ + SYNC_READ
MOVE = (8 + 4 * 5) * BYTE + (8 + 3 * 8) * BYTE
IN_TURN = 0x0F  # speed, load, voltage, temperature
EVERYTHING = 0x3F
_POSITION = 0x38


@dataclass(frozen=True)
class LineUse:
    """Where the servo line's time goes while reports come as fast as they can.

    Attributes:
        rate: Reports a second.
        positions, slow, idle: Milliseconds a report: for positions, for the items that take turns, and between an
            answer and the next request.
    """

    rate: float
    positions: float
    slow: float
    idle: float


def line_use(host_baud: int = 500000, fields: int = EVERYTHING, reports: int = 192) -> LineUse:
    """Measure over so many cycles of the board's own polling; the slow items repeat after 16."""
    board = ChipBoard(host_baud=host_baud)
    try:
        client = Client(board)
        board.settle()
        client.ask(Command.REPORT, bytes((5, 0, fields)))
        client.run(0.2)
        answers: list[float] = []
        deliver = board.line._deliver

        def heard(data: bytes, begin: float) -> None:
            answers.append(begin + len(data) * BYTE)
            deliver(data, begin)

        board.line._deliver = heard
        board.line.sent.clear()
        # A sync read is the first of each cycle.
        while sum(p[4] == Instruction.SYNC_READ for _, p in board.line.sent) <= reports:
            client.run(0.005)
        assert board.overruns == 0
        first = [i for i, (_, p) in enumerate(board.line.sent) if p[4] == Instruction.SYNC_READ]
        parts = {"positions": 0.0, "slow": 0.0, "idle": 0.0}
        for i in range(first[0], first[reports]):
            begin, packet = board.line.sent[i]
            took = answers[i] - begin
            usual = SYNC_READ if packet[4] == Instruction.SYNC_READ else LEGACY_READ
            usual = usual if packet[5] == _POSITION else 0.0
            parts["positions"] += usual
            parts["slow"] += took - usual
            parts["idle"] += board.line.sent[i + 1][0] - answers[i]
        seconds = board.line.sent[first[reports]][0] - board.line.sent[first[0]][0]
        return LineUse(reports / seconds, **{name: 1e3 * part / reports for name, part in parts.items()})
    finally:
        board.close()


def report_rate(host_baud: int = 115200, fields: int = IN_TURN, seconds: float = 2.0) -> float:
    """Reports a second, all seven joints, positions fresh in each."""
    board = ChipBoard(host_baud=host_baud)
    try:
        client = Client(board)
        board.settle()
        client.ask(Command.REPORT, bytes((5, 0, fields)))
        client.run(0.2)
        begin = board.now
        reports = [frame for frame in client.run(seconds) if frame.is_unsolicited]
        clocks = [JointReport.parse(f.body).time_us for f in reports]
        assert all(b > a for a, b in pairwise(clocks)), "a report without new samples"
        assert board.overruns == 0
        return len(reports) / (board.now - begin)
    finally:
        board.close()


def move_rate(seconds: float = 2.0) -> tuple[float, float]:
    """Moves and reports a second, when the host sends a new JOINT_MOVE of all joints for every report."""
    board = ChipBoard()
    try:
        client = Client(board)
        board.settle()
        client.ask(Command.TORQUE, b"\1\x7f\0")
        client.ask(Command.REPORT, bytes((5, 0, 0)))
        client.run(0.1)
        start = [s.present_position for s in board.wire.servos]
        begin, reports = board.now, 0
        board.line.sent.clear()
        while board.now < begin + seconds:
            for frame in client.run(0.0005):
                if not frame.is_unsolicited:
                    continue
                reports += 1
                wave = reports % 40 - 20
                rows = b"".join(bytes((i,)) + (p + wave).to_bytes(2, "little") for i, p in enumerate(start))
                board.send(client.frame(Command.JOINT_MOVE, (20).to_bytes(2, "little") + b"\7" + rows))
        moves = sum(p[4] == 0x83 and p[5] == 0x29 for _, p in board.line.sent)
        assert board.overruns == 0
        return moves / (board.now - begin), reports / (board.now - begin)
    finally:
        board.close()


def read_time(busy: bool = False) -> float:
    """Slowest of 20 dialect-1 reads, from the first byte of the request to the last of the answer."""
    board = ChipBoard()
    try:
        client = Client(board)
        board.settle()
        if busy:
            client.ask(Command.JOINT_STATE, b"\0")
        slowest = 0.0
        for i in range(20):
            board.advance(0.0137 + 0.0011 * i)
            board.take()
            begin = board.now
            board.send(client.frame(Command.READ, make_read(i % 7, 0x38, 2), proto=1))
            while len(board.received) < 52:
                board.advance(0.0005)
                assert board.now < begin + 0.2
            slowest = max(slowest, board.stamps[51] - begin)
        return slowest
    finally:
        board.close()


def stop_time(load: bool = True) -> float:
    """Slowest of 20 STOPs, from the first byte of the frame to the end of the torque-off packet on the bus.

    Full load: reports as fast as they go, moves one after the other, a read of a servo that is not there.
    """
    slowest = 0.0
    board = ChipBoard()
    try:
        client = Client(board)
        board.settle()
        for i in range(20):
            client.ask(Command.RESUME)
            client.ask(Command.TORQUE, b"\1\x7f\0")
            if load:
                board.send(client.frame(Command.REPORT, bytes((5, 0, 0x3F))))
                board.advance(0.02)
                rows = b"".join(bytes((j,)) + (2040).to_bytes(2, "little") for j in range(7))
                for _ in range(2):
                    board.send(client.frame(Command.JOINT_MOVE, b"\x14\0\7" + rows))
                board.send(client.frame(Command.READ, make_read(9, 0x38, 2), proto=1))
                board.advance(0.018 + 0.0013 * i)
            board.line.sent.clear()
            board.line.ends.clear()
            # The line is serial: the frame begins when what was sent before is over.
            begin = max(board.now, board.host_free)
            board.send(client.frame(Command.STOP, b"\1"))
            board.advance(0.08)
            for (_, packet), end in zip(board.line.sent, board.line.ends, strict=True):
                if packet[4:7] == b"\x83\x28\x01" and packet[8] == 0:
                    slowest = max(slowest, end - begin)
                    break
            else:
                raise AssertionError("no torque-off on the bus")
            board.take()
        return slowest
    finally:
        board.close()


def run() -> list[str]:
    """Every figure of the firmware, one a line."""
    bus, moving = 1 / CYCLE, 1 / (CYCLE + MOVE)
    report = report_rate()
    moves, states = move_rate()
    read, stop = read_time(), stop_time()
    fast, wide = line_use(), report_rate(115200, EVERYTHING)
    host_limit = 1 / (144 * BYTE)
    limit_read = 120 * BYTE + DELAY
    moving_rate = min(moves, states)
    rows = (
        (
            "state of 7 joints, unsolicited",
            f"{report:.1f} Hz",
            f"{bus:.1f} Hz",
            report / bus,
            "3.99 Hz",
            report / 3.99,
        ),
        (
            "move and state in each cycle",
            f"{moving_rate:.1f} Hz",
            f"{moving:.1f} Hz",
            moving_rate / moving,
            "3.81 Hz",
            moving_rate / 3.81,
        ),
        (
            "one dialect-1 read",
            f"{read * 1e3:.2f} ms",
            f"{limit_read * 1e3:.2f} ms",
            limit_read / read,
            "35.85 ms",
            35.85e-3 / read,
        ),
    )
    lines = ["the firmware on a simulated ATmega2560, both lines at 115200, in simulated time"]
    lines.append(f"{'':32}{'measured':>10}{'limit':>11}{'of it':>7}{'chapter':>10}{'times':>7}")
    lines += [f"{n:32}{m:>10}{limit:>11}{part:7.2f}{old:>10}{gain:7.1f}" for n, m, limit, part, old, gain in rows]
    return [
        *lines,
        f"STOP to the last torque-off byte on the servo line, under full load: {stop * 1e3:.2f} ms",
        f"all fields in each report: {wide:.1f} Hz (limit of the host line {host_limit:.1f} Hz)",
        f"the same, host line at 500000: {fast.rate:.1f} Hz, {fast.rate / bus:.3f} of the servo line's limit",
        f"  each takes: positions {fast.positions:.2f} ms, slow items {fast.slow:.2f}, idle line {fast.idle:.2f}",
    ]


if __name__ == "__main__":
    print("\n".join(run()))
