"""The same random trajectory commands for two boards, and what of it must be the same.

Owns the generator of sequences, sound and hostile, and the comparison. Both boards get each step at the same
simulated time. Their replies must be the same bytes, without clocks; while joints move, counts of points may be one
apart, and a state may change a moment earlier on one. Targets on the servo line must be the same motion.

Run it by itself for as long as you like: ``python -m tests.conformance_board.trajectory_pairs 500``.
"""

from __future__ import annotations

import random
import sys
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from tests.conformance_board.adapter import BoardUnderTest

from hexwire.wire.board_trajectory import (
    BeginRequest,
    PathFlag,
    PathPoint,
    PathState,
    PathStatus,
    PointsRequest,
    StartRequest,
)
from hexwire.wire.command_frame import Command, Frame, Status
from hexwire.wire.commands import LimitRow, LimitTable
from hexwire.wire.servo_packet import make_sync_write, make_write

__all__ = ["Comparison", "Outcome", "Step", "compare", "play", "run_seed", "sequence"]

START = (2053, 2043, 2035, 2039, 2083, 2046, 2047)
LOW, HIGH, SPEED = 1500, 2600, 1500
NUMBER = 5
GRID = 0.13
"""Seconds between two steps: the longest request and its answer take less."""
_SLACK = 0.04
"""Seconds within which two boards send the same target: a polling cycle, and what a request takes."""
_COUNTS = 2
_BRAKES = 0.75
"""Seconds of the longest braking, and a little."""
_LONG: dict[int, int] = {Command.LIMITS: 3, Command.TORQUE: 2, Command.STOP: 7, Command.MAINTENANCE: 2}
"""Steps that take several."""
_TARGETS = (0x29, 0x2A)


@dataclass(frozen=True)
class Step:
    """One thing that the host does.

    Attributes:
        ahead: Start so many seconds ahead of the board's clock, for TRAJECTORY_START.
        pause: Wait so many grid steps instead.
    """

    cmd: int = -1
    body: bytes = b""
    proto: int = 2
    ahead: float | None = None
    pause: int = 0


@dataclass(frozen=True)
class Answer:
    """The reply to a step, the state right afterwards, and a moment later."""

    step: Step
    time: float
    status: int | None
    body: bytes
    after: PathStatus
    later: PathStatus


@dataclass
class Outcome:
    """What a board did in a sequence: its answers, and its targets by joint as (time, counts)."""

    answers: list[Answer] = field(default_factory=list)
    targets: dict[int, list[tuple[float, int]]] = field(default_factory=dict)


@dataclass
class Comparison:
    """What came of a comparison.

    Attributes:
        differences: In words.
        compared: Answers that were compared.
        done: How many of them said that a trajectory was done.
        parted: From some answer on the boards were in different states by a matter of milliseconds.
    """

    differences: list[str] = field(default_factory=list)
    compared: int = 0
    done: int = 0
    parted: bool = False


# -- sequences --------------------------------------------------------------------------------------------------


class _Host:
    """A host that knows roughly where it is, and is wrong on purpose now and then."""

    def __init__(self, draw: random.Random) -> None:
        self.draw = draw
        self.joints: list[int] = [0]
        self.hermite = False
        self.unit = 1
        self.next = 0
        self.place = [0]
        self.tick = 0

    def begin(self) -> Step:
        draw = self.draw
        mask = draw.choice((0x7F, 0x7F, 0x01, 0x11, 0x0C, 0x70))
        self.joints = [i for i in range(7) if mask >> i & 1]
        self.hermite = draw.random() < 0.5
        self.unit = 8 if draw.random() < 0.4 else 1
        self.next, self.place = 0, [START[i] * self.unit for i in self.joints]
        flags = (PathFlag.HERMITE if self.hermite else 0) | (PathFlag.FINE if self.unit > 1 else 0)
        flags |= PathFlag.OUTLIVES_HOST if draw.random() < 0.3 else 0
        brake = draw.choice((20, 20, 100, 200, 700))
        bad = draw.random()
        if bad < 0.03:
            mask = draw.choice((0, 0x80, 0xFF, 0x8001))
        elif bad < 0.06:
            flags |= draw.choice((8, 0x80))
        elif bad < 0.09:
            brake = draw.choice((0, 19, 2001, 65535))
        return Step(Command.TRAJECTORY_BEGIN, self.length(BeginRequest(NUMBER, flags, mask, brake).serialize()))

    def points(self) -> Step:
        draw = self.draw
        count = draw.choice((1, 2, 3, 4, 5))
        first = self.next
        if draw.random() < 0.12:
            first += draw.choice((-3, -2, -1, -1, 1, 2, 32768))
        points = []
        for n in range(count):
            ticks = draw.choice((800, 1500, 2500, 4000)) if first + n else 0
            unit = self.unit
            step = [draw.randint(-150 * unit, 150 * unit) if first + n else 0 for _ in self.joints]
            near = [min(max(a + b, LOW * unit), HIGH * unit) for a, b in zip(self.place, step, strict=True)]
            speeds = tuple(draw.randint(-300, 300) for _ in self.joints) if self.hermite else ()
            points.append(PathPoint(ticks, tuple(near), speeds))
            self.place = near
        bad = draw.random()
        if bad < 0.08:
            points[-1] = self.worse(points[-1])
        number = NUMBER + 1 if draw.random() < 0.02 else NUMBER
        last = draw.random() < 0.5
        body = bytearray(PointsRequest.of(number, first, points, last=last).serialize())
        if draw.random() < 0.03:
            body[1] = 2
        if draw.random() < 0.04:
            body[4] = draw.choice((0, count + 1, 255))
        self.next = first + count
        return Step(Command.TRAJECTORY_POINTS, self.length(bytes(body)))

    def worse(self, point: PathPoint) -> PathPoint:
        """The same point with one thing wrong."""
        draw = self.draw
        bad = draw.randrange(5)
        if bad == 0:
            return point._replace(ticks=draw.choice((0, 1)))
        if bad == 1 and point.velocities:
            return point._replace(velocities=(draw.choice((SPEED + 1, -SPEED - 1, -32768)), *point.velocities[1:]))
        if bad == 2:
            return point._replace(ticks=draw.choice((1, 50, 65535)))
        return point._replace(
            positions=(
                draw.choice((LOW * self.unit - 1, HIGH * self.unit + 1, -32768, 32767)),
                *point.positions[1:],
            )
        )

    def start(self) -> Step:
        draw = self.draw
        number = NUMBER - 1 if draw.random() < 0.03 else NUMBER
        ahead = draw.choice((None, None, None, None, None, 0.25, 0.25, 0.4, 9.9, 10.1, -0.05))
        now = draw.choice((1, 1, 1, 1, 1, 1, 1, 2)) if ahead is None else 0
        body = StartRequest(number, now, draw.getrandbits(32) if now else 0).serialize()
        return Step(Command.TRAJECTORY_START, self.length(body), ahead=ahead)

    def other(self) -> Step:
        """A command that a trajectory meets."""
        draw = self.draw
        joint = draw.randrange(7)
        place = START[joint] + draw.randint(-40, 40)
        block = place.to_bytes(2, "big" if joint < 4 else "little") + (b"\0\x64" if joint < 4 else b"")
        write = make_write(joint, 0x2A, block)
        sync = make_sync_write(0x2A, {joint: place.to_bytes(2, "big") + b"\0\x64"})
        move = b"\x64\0\1" + bytes((joint,)) + place.to_bytes(2, "little")
        return draw.choice(
            (
                Step(Command.JOINT_MOVE, move),
                Step(Command.JOINT_MOVE, b"\x64\0\1" + bytes((0xFE,)) + place.to_bytes(2, "little")),
                Step(Command.SYNC_WRITE, sync),
                Step(Command.TRANSACT, b"\6\0" + write),
                Step(Command.READ, write, proto=1),
                Step(Command.READ, make_write(joint, 0x28, b"\1"), proto=1),
                Step(Command.TORQUE, b"\1" + bytes((1 << joint, 0))),
                Step(Command.TORQUE, b"\0" + bytes((1 << joint, 0))),
                Step(Command.TORQUE, b"\1\x7f\0"),
                Step(Command.MAINTENANCE, bytes((draw.randrange(2),))),
                Step(Command.STOP, bytes((draw.randrange(2),))),
                Step(Command.STOP, b"\0"),
                Step(Command.RESUME),
                Step(Command.RESUME),
            )
        )

    def length(self, body: bytes) -> bytes:
        """Now and then a body of another length."""
        if self.draw.random() < 0.02:
            return body[: self.draw.randrange(len(body) + 1)] if self.draw.random() < 0.6 else body + b"\1"
        return body


def sequence(seed: int, length: int = 40) -> list[Step]:
    """A sequence of steps."""
    draw = random.Random(seed)
    host = _Host(draw)
    limits = LimitTable(0, (LimitRow(LOW, HIGH, SPEED),) * 7).serialize()[1:]
    steps = [Step(Command.LIMITS, limits), Step(Command.TORQUE, b"\1\x7f\0"), Step(pause=2)]
    while len(steps) < length:
        choice = draw.random()
        if choice < 0.25:
            steps += [Step(Command.RESUME), Step(Command.TORQUE, b"\1\x7f\0")] if draw.random() < 0.4 else []
            steps += [host.begin(), host.points(), *([host.points()] if draw.random() < 0.5 else []), host.start()]
        elif choice < 0.45:
            steps.append(host.points())
        elif choice < 0.55:
            steps.append(host.start())
        elif choice < 0.6:
            bad = NUMBER if draw.random() < 0.8 else draw.randrange(256)
            steps.append(Step(Command.TRAJECTORY_ABORT, host.length(bytes((bad,)))))
        elif choice < 0.7:
            steps.append(Step(Command.TRAJECTORY_STATUS, host.length(b"")))
        elif choice < 0.8:
            steps.append(host.other())
        else:
            steps.append(Step(pause=draw.randint(1, 9)))
    return [*steps, Step(pause=12)]


# -- playing and comparing --------------------------------------------------------------------------------------


def play(kind: str, steps: Sequence[Step]) -> Outcome:
    """Let a board of some kind go through a sequence."""
    board = BoardUnderTest(kind)
    machine, client = board.machine, board.client
    outcome = Outcome()

    def until(moment: float) -> None:
        if moment > machine.now:
            client.run(moment - machine.now)

    def status() -> PathStatus:
        return PathStatus.parse(client.ask(Command.TRAJECTORY_STATUS, within=1.0).body)

    try:
        moment = 1.0
        for step in steps:
            if step.pause:
                moment += step.pause * GRID
                continue
            until(moment)
            body = step.body
            if step.ahead is not None and len(body) == 6:
                time_us = (status().time_us + round(step.ahead * 1e6)) & 0xFFFFFFFF
                body = body[:2] + time_us.to_bytes(4, "little")
            if step.proto == 1:
                reply: Frame | None = None
                heard = client.ask_chapter(step.cmd, body)
            else:
                reply = client.ask(step.cmd, body, within=2.0)
                heard = reply.body
            after = status()
            until(moment + 0.8 * GRID)
            code = None if reply is None else reply.status
            outcome.answers.append(Answer(step, machine.now, code, heard, after, status()))
            moment = max(moment + GRID * _LONG.get(step.cmd, 1), machine.now)
        until(moment)
        for time, packet in machine.line.sent:
            for joint, place in _targets(packet):
                outcome.targets.setdefault(joint, []).append((time, place))
    finally:
        board.close()
    return outcome


def _targets(packet: bytes) -> list[tuple[int, int]]:
    if len(packet) < 8 or packet[4] != 0x83 or packet[5] not in _TARGETS:
        return []
    old = packet[5] == 0x2A
    found = []
    for at in range(7, len(packet) - 1, packet[6] + 1):
        raw = packet[at + 1 : at + 3] if old else packet[at + 2 : at + 4]
        found.append((packet[at], int.from_bytes(raw, "big" if old else "little")))
    return found


def compare(one: Outcome, two: Outcome) -> Comparison:
    """Compare what two boards did."""
    result = Comparison()
    before = PathState.NONE
    for number, (a, b) in enumerate(zip(one.answers, two.answers, strict=True)):
        where = f"{number} {_name(a.step)}"
        if a.after.state != b.after.state and _in_passing(a, b):
            # A request may have come just before on one board and just after on the other: they part here.
            result.parted = True
            break
        if a.after.state != b.after.state or a.after.next != b.after.next:
            result.differences.append(f"{where}: {a.after} {b.after}")
        elif (a.status, _without_clocks(a)) != (b.status, _without_clocks(b)):
            if not _known(a, b, before):
                result.differences.append(f"{where}: {a.status} {a.body.hex()} {b.status} {b.body.hex()}")
        elif not _same_counts(a.after, b.after):
            result.differences.append(f"{where}: {a.after} {b.after}")
        before = a.after.state
        result.compared += 1
        result.done += a.after.state is PathState.DONE
    if not result.parted:
        result.differences += _different_targets(one, two)
    return result


def _name(step: Step) -> str:
    return f"{Command(step.cmd).name}/{step.proto} {step.body.hex(' ')} {'' if step.ahead is None else step.ahead}"


def _without_clocks(answer: Answer) -> bytes:
    """The body without clock; of the state while joints move only what `_same_counts` does not compare."""
    body, cmd = answer.body, answer.step.cmd
    if cmd in (Command.TRAJECTORY_STATUS, Command.TRAJECTORY_POINTS):
        return body[:4]
    return body[:-4] if cmd == Command.TRAJECTORY_START else body


def _in_passing(a: Answer, b: Answer) -> bool:
    """Whether a state is different only for a moment."""
    return a.later.state == b.after.state or b.later.state == a.after.state


def _known(a: Answer, b: Answer, before: PathState) -> bool:
    """What the text leaves open: a START that is refused for two reasons at once."""
    statuses = {a.status, b.status}
    return a.step.cmd == Command.TRAJECTORY_START and statuses == {Status.STOPPED, Status.BAD_RANGE} and before.over


def _same_counts(a: PathStatus, b: PathStatus) -> bool:
    if not a.towards:
        return a.free == b.free
    slack = 1 if a.state in (PathState.RUNNING, PathState.BRAKING) else 0
    same = abs(a.towards - b.towards) <= slack and abs(a.free - b.free) <= slack
    # Where it came to rest may lie on either side of a point.
    return same or (a.state.over and abs(a.towards - b.towards) <= 1)


def _different_targets(one: Outcome, two: Outcome) -> list[str]:
    """Targets of one board that the other did not send at about that time."""
    found = []
    for mine, other, name in ((one, two, "first"), (two, one, "second")):
        for joint, targets in mine.targets.items():
            line = other.targets.get(joint, [])
            wrong = [each for each in targets if not _is_near(each, line, alone=_is_alone(each, targets))]
            if wrong:
                found.append(
                    f"targets of joint {joint} that only the {name} board has: {wrong[:4]} of {len(wrong)}"
                )
    return found


def _is_alone(target: tuple[float, int], line: Sequence[tuple[float, int]]) -> bool:
    """Whether it is no part of a motion: a joint is held where it is."""
    return not any(0 < abs(time - target[0]) < _SLACK for time, _ in line)


def _is_near(target: tuple[float, int], line: Sequence[tuple[float, int]], *, alone: bool) -> bool:
    """Whether a target lies between those that another board sent around the same time.

    One that brakes a moment later comes to rest as much further on, and is held there whenever that is.
    """
    time, place = target
    first = max(bisect_left(line, (time - _SLACK, 0)) - 1, 0)
    last = bisect_left(line, (time + _SLACK, 0)) + 1
    around = [p for _, p in line[first:last]]
    before = line[0 if alone else bisect_left(line, (time - _BRAKES, 0)) : last]
    speeds = [abs(b[1] - a[1]) / (b[0] - a[0]) for a, b in pairwise(before) if 0.005 < b[0] - a[0] < _SLACK]
    slack = _COUNTS + _SLACK * max(speeds, default=0.0)
    return bool(around) and min(around) - slack <= place <= max(around) + slack


def run_seed(seed: int) -> Comparison:
    """Compare emulator and core in the sequence of a number."""
    steps = sequence(seed)
    return compare(play("emulator", steps), play("core", steps))


def main(count: int) -> None:
    """Compare so many sequences and print what differs."""
    parted = 0
    for seed in range(count):
        result = run_seed(seed)
        parted += result.parted
        for line in result.differences:
            print(seed, line)
    print(f"{count} sequences, {parted} that the boards left at the same point at different moments")


if __name__ == "__main__":
    main(int(sys.argv[1]))
