"""The same random fragments, tables and addresses for two boards, and what of the answers must be the same.

Owns the generator of sequences, sound and hostile, and the comparison. Both boards get each step at the same
simulated time. Everything that they send must be the same, but for clocks, the number of a frame, the count in the
id of a message from the board, and questions that are only repeated.

Run it by itself for as long as you like: ``python -m tests.conformance_board.message_pairs 500``.
"""

from __future__ import annotations

import random
import sys
from collections.abc import Sequence
from dataclasses import dataclass

from tests.conformance_board.adapter import BoardUnderTest
from tests.frames import frame_bytes

from hexwire.wire.addresses import Multicast
from hexwire.wire.board_trajectory import BeginRequest, PathFlag, PathPoint, PointsRequest
from hexwire.wire.command_frame import Command, Frame
from hexwire.wire.commands import FRAGMENT_HEAD_SIZE, FragmentHead, serialize_missing
from hexwire.wire.servo_table import ServoTable

__all__ = ["Step", "differences", "play", "run_seed", "sequence"]

GRID = 0.07
"""Seconds between two steps. No time-out of section 6.10 ends near a multiple of it after a step."""
BOARD = 8
NUMBER = 5
_START = (2053, 2043, 2035, 2039, 2083, 2046, 2047)
_LONG = {Command.STOP: 11, Command.MAINTENANCE: 2, Command.TORQUE: 2, Command.IDENTIFY: 1}
"""Steps that take several."""
_CLOCK = 4
_KEEPS = (6, 39)
"""Registers that stay as they are; from the id's neighbour to the last of the settings."""


@dataclass(frozen=True)
class Step:
    """One frame of a host, and how many steps it takes."""

    cmd: int = -1
    body: bytes = b""
    seq: int = 0
    src: int = 7
    dst: int = BOARD
    pause: int = 1


class _Host:
    """A host that sends messages, and spoils some of their chunks on purpose."""

    def __init__(self, draw: random.Random) -> None:
        self.draw = draw
        self.seq = 0
        self.messages = 0
        self.points = 0
        self.fine = False

    def step(self, cmd: int, body: bytes = b"", **more: int) -> Step:
        self.seq = (self.seq + 1) & 0xFF
        return Step(cmd, body, more.pop("seq", self.seq), pause=_LONG.get(cmd, 1), **more)

    def begin(self) -> Step:
        self.points = 0
        self.fine = self.draw.random() < 0.5
        flags = PathFlag.HERMITE | (PathFlag.FINE if self.fine else 0)
        return self.step(Command.TRAJECTORY_BEGIN, BeginRequest(NUMBER, flags, 0x7F, 200).serialize())

    def path(self, count: int) -> bytes:
        draw, unit = self.draw, 8 if self.fine else 1
        points = [
            PathPoint(
                500 if self.points + n else 0, tuple(p * unit + draw.randint(0, 2 * unit) for p in _START), (0,) * 7
            )
            for n in range(count)
        ]
        if draw.random() < 0.15:
            points[-1] = points[-1]._replace(ticks=0, positions=(-9, *points[-1].positions[1:]))
        first = self.points + (draw.choice((-1, 1, 7)) if draw.random() < 0.1 else 0)
        number = NUMBER + 1 if draw.random() < 0.05 else NUMBER
        return PointsRequest.of(number, first, points, last=draw.random() < 0.2).serialize()

    def table(self) -> bytes:
        draw = self.draw
        servo = draw.choice((4, 5, 6, 6, 1, 9))
        first = draw.randint(*_KEEPS)
        count = draw.choice((1, 2, 5, 20, 33))
        if draw.random() < 0.1:
            first, count = draw.choice(((0, 0), (255, 2), (1, 256), (0, 65535)))
        data = bytes(draw.choice((0, 1, 32, 90, 254)) for _ in range(min(count, 120)))
        return ServoTable(servo, first, count, data).serialize()

    def message(self) -> list[Step]:
        """All chunks of a message, some of them wrong."""
        draw = self.draw
        cmd = draw.choice(
            (Command.TRAJECTORY_POINTS, Command.TRAJECTORY_POINTS, Command.SERVO_TABLE, Command.SERVO_TABLE)
        )
        if draw.random() < 0.06:
            cmd = draw.choice((Command.LIMITS, Command.STATS, Command.FRAGMENT, Command.JOINT_MOVE))
        count = draw.randint(2, 25)
        body = self.path(count) if cmd == Command.TRAJECTORY_POINTS else self.table()
        size = draw.choice((200, 200, 90, 35, 16))
        chunks = [body[at : at + size] for at in range(0, len(body), size)][:12]
        self.messages = (self.messages + 1) & 0xFF
        self.seq = (self.seq + 1) & 0xFF
        number = self.messages << 8 | self.seq
        src = 6 if draw.random() < 0.1 else 7
        steps = []
        whole = -(-len(body) // size)
        for index, chunk in enumerate(chunks):
            bad = draw.random()
            head = FragmentHead(number, index, whole, cmd, 0)
            if bad < 0.04:
                continue
            if bad < 0.08:
                chunk = chunk[:-1] if draw.random() < 0.5 else chunk + b"\x55"
            elif bad < 0.1:
                head = head._replace(number=draw.choice((0, index + 1, 0xFFFF)))
            elif bad < 0.12:
                head = head._replace(chunks=draw.choice((0, 1, whole + 1, 0xFFFF)))
            elif bad < 0.13:
                head = head._replace(cmd_ext=0x80)
            elif bad < 0.15:
                head = head._replace(message_id=number ^ draw.choice((0x100, 1)))
            data = (head.serialize() + chunk)[: FRAGMENT_HEAD_SIZE + 200]
            steps.append(Step(Command.FRAGMENT, data, self.seq, src, pause=3 if cmd == Command.SERVO_TABLE else 1))
            if bad > 0.93:
                steps.append(steps[-1])
            elif bad > 0.86:
                steps.append(self.other())
        if draw.random() < 0.5:
            self.points += count
        return steps

    def other(self) -> Step:
        draw = self.draw
        several = draw.choice((-1, Multicast((8,)).dst, Multicast((7, 8)).dst, Multicast((9,)).dst, 9, -2))
        read = ServoTable(draw.choice((5, 5, 1)), 6, draw.choice((1, 30, 34))).serialize()
        far = ServoTable(5, draw.choice((87, 100)), draw.choice((128, 129, 150))).serialize()
        missing = serialize_missing(draw.randrange(0x600), tuple(draw.sample(range(4), draw.randint(0, 3))))
        return draw.choice(
            (
                self.begin(),
                self.begin(),
                self.step(Command.TRAJECTORY_STATUS),
                self.step(Command.TRAJECTORY_POINTS, self.path(2)),
                self.step(Command.TRAJECTORY_ABORT, bytes((NUMBER,))),
                self.step(Command.SERVO_TABLE, read),
                self.step(Command.SERVO_TABLE, far),
                self.step(Command.SERVO_TABLE, self.table()),
                self.step(Command.SERVO_TABLE, read[: draw.randint(0, 3)]),
                self.step(Command.FRAGMENT_MISSING, missing),
                self.step(Command.FRAGMENT_MISSING, missing[: draw.randint(0, len(missing))]),
                self.step(Command.FRAGMENT, bytes(draw.randint(0, 9))),
                self.step(Command.MAINTENANCE, bytes((draw.choice((0, 1, 1)),))),
                self.step(Command.STOP, b"\0"),
                self.step(Command.RESUME),
                self.step(Command.RESUME),
                self.step(Command.IDENTIFY),
                self.step(Command.IDENTIFY, src=6),
                self.step(Command.STATS, dst=several),
                self.step(Command.LIMITS, dst=several),
                self.step(Command.FRAGMENT, bytes(20), dst=several),
                Step(pause=draw.choice((1, 2, 5, 30))),
            )
        )


def sequence(seed: int, length: int = 60) -> list[Step]:
    """A sequence of steps."""
    draw = random.Random(seed)
    host = _Host(draw)
    steps = [host.begin()]
    if draw.random() < 0.6:
        steps.append(host.step(Command.MAINTENANCE, b"\1"))
        steps.append(host.begin())
    while len(steps) < length:
        steps += host.message() if draw.random() < 0.5 else [host.other()]
    return steps


def play(kind: str, steps: Sequence[Step]) -> list[tuple[Step, list[str]]]:
    """Let a board of some kind go through a sequence; what it sent after each step, in words."""
    board = BoardUnderTest(kind)
    machine, client = board.machine, board.client
    found = []
    asked: set[bytes] = set()
    try:
        moment = 1.0
        for step in steps:
            client.run(max(moment - machine.now, 0.0))
            if step.cmd >= 0:
                machine.send(
                    frame_bytes(step.cmd, step.body, proto=2, seq=step.seq, sn=1, src=step.src, dst=step.dst)
                )
            moment += GRID * step.pause
            heard = client.run(moment - machine.now)
            said = [_said(frame) for frame in heard if not _is_repeated(frame, asked)]
            found.append((step, sorted(said)))
    finally:
        board.close()
    return found


def _is_repeated(frame: Frame, asked: set[bytes]) -> bool:
    """Whether it is a question that was asked before: the boards count 0.1 s by clocks of their own."""
    if frame.cmd != Command.FRAGMENT_MISSING or frame.is_reply:
        return False
    known = frame.body in asked
    asked.add(frame.body)
    return known


def _said(frame: Frame) -> str:
    body = frame.body
    if frame.cmd in (Command.TRAJECTORY_STATUS, Command.TRAJECTORY_POINTS) and len(body) > _CLOCK:
        body = body[:-_CLOCK]
    if frame.cmd in (Command.IDENTIFY, Command.STATS):
        body = b""
    if frame.cmd in (Command.FRAGMENT, Command.FRAGMENT_MISSING) and not frame.is_reply:
        # The high byte of a message from the board counts its messages.
        body = body[:1] + b"." + body[2:] if frame.cmd == Command.FRAGMENT else body
        return f"{Command(frame.cmd).name} to {frame.dst} {frame.cmd_ext:02x} {body.hex(' ')}"
    return f"{frame.cmd:02x} to {frame.dst} seq {frame.seq} {frame.cmd_ext:02x} {body.hex(' ')}"


def differences(one: list[tuple[Step, list[str]]], two: list[tuple[Step, list[str]]]) -> list[str]:
    """Where two boards said different things; from the first such step on they may be in different states."""
    for number, ((step, a), (_, b)) in enumerate(zip(one, two, strict=True)):
        if sorted(set(a)) != sorted(set(b)):
            name = f"{step.cmd:02x}" if step.cmd >= 0 else "pause"
            return [f"step {number}, {name} {step.body[:24].hex(' ')} from {step.src} to {step.dst}: {a} and {b}"]
    return []


def run_seed(seed: int) -> list[str]:
    """Compare emulator and core in the sequence of a number."""
    steps = sequence(seed)
    return differences(play("emulator", steps), play("core", steps))


def main(count: int) -> None:
    """Compare so many sequences and print what differs."""
    for seed in range(count):
        for line in run_seed(seed):
            print(seed, line)
    print(f"{count} sequences")


if __name__ == "__main__":
    main(int(sys.argv[1]))
