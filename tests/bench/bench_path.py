"""Motion in the board's own time beside motion that the host times, on the servo line of the simulated chip.

Chip and host program are processes of their own; the chip has a raised priority, so that it keeps real time while
the host program is disturbed. Both ways are measured in one run, in turns.
"""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.avr.client import Client
from tests.avr.machines import ChipBoard, make
from tests.bench import path_figures as figures
from tests.bench import path_host as motions
from tests.bench.path_chip import Seen, clock_offset, is_target

from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.motion.trajectory import Trajectory
from hexwire.wire.board_trajectory import (
    BeginReply,
    BeginRequest,
    PathFlag,
    PathPoint,
    PathStatus,
    PointsRequest,
    StartReply,
    StartRequest,
)
from hexwire.wire.command_frame import Command, Frame, Status

_ROOT = Path(__file__).resolve().parents[2]
_BUSY = 8
_LEAD = 0.024
"""The board's, seconds."""
_LIMIT = 25.0
"""Most seconds that a busy process lives."""
_STOPPED = 0.9
_UNTIL_STOP = 1.5
WAYS = ("board", "host")


# -- in real time -----------------------------------------------------------------------------------


class _Process:
    """A Python program that talks in lines."""

    def __init__(self, module: str, *words: str) -> None:
        command = [sys.executable, "-m", f"tests.bench.{module}", *words]
        self.process = subprocess.Popen(
            command, cwd=_ROOT, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )

    def line(self) -> str:
        assert self.process.stdout
        if not (line := self.process.stdout.readline()):
            raise RuntimeError(f"{self.process.args} ended")
        return line.strip()

    def go(self) -> None:
        assert self.process.stdin
        self.process.stdin.write("\n")
        self.process.stdin.flush()

    def finish(self) -> str:
        assert self.process.stdin
        self.process.stdin.close()
        return self.line()

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        for end in (self.process.stdin, self.process.stdout):
            if end and not end.closed:
                end.close()


@contextmanager
def _processes() -> Iterator[list[_Process]]:
    found: list[_Process] = []
    try:
        yield found
    finally:
        for each in reversed(found):
            each.close()


@contextmanager
def _busy(count: int) -> Iterator[None]:
    code = f"import time\nend = time.monotonic() + {_LIMIT}\nwhile time.monotonic() < end: pass"
    found = [subprocess.Popen([sys.executable, "-c", code]) for _ in range(count)]
    try:
        yield
    finally:
        for each in found:
            each.kill()
        for each in found:
            each.wait()


@dataclass
class Run:
    """One motion, and what the board did."""

    seen: Seen
    start: list[float]
    result: dict[str, Any]

    def sets(self) -> list[figures.Set]:
        """The packets with targets, of the motion that is measured and of those before it."""
        return figures.read_sets(((t, bytes.fromhex(p)) for t, p in self.seen.packets), 0.0)


def _run(motion: str, way: str, *, busy: int = 0, stop: bool = False, chips: int = 1) -> list[Run]:
    with _processes() as processes:
        boards = [_Process("path_chip") for _ in range(chips)]
        processes += boards
        host = _Process("path_host", motion, way, *(board.line() for board in boards))
        processes.append(host)
        host.line()
        with _busy(busy):
            host.go()
            start: list[float] = json.loads(host.line())["start"] if motion != "together" else []
            if stop:
                time.sleep(_UNTIL_STOP)
                os.kill(host.process.pid, signal.SIGSTOP)
                time.sleep(_STOPPED)
                os.kill(host.process.pid, signal.SIGCONT)
            result = json.loads(host.line())
        return [Run(Seen(**json.loads(board.finish())), start, result) for board in boards]


def _start(run: Run, path: Trajectory) -> tuple[list[figures.Set], float]:
    """The packets of a motion, and when one should have the path's first position.

    The board says when it starts. When the host does, is found from the packets: a constant offset is taken away.
    """
    sets = run.sets()
    if run.seen.starts and run.result["timed"]:
        start = run.seen.starts[-1] - _LEAD
    else:
        pauses = [(b.time - a.time, b.time) for a, b in pairwise(sets)]
        first = max(pauses)[1] if len(path.names) < len(HEX7BOT.names) else sets[0].time
        start = figures.best_start(path, [s for s in sets if s.time >= first], first)
    return [s for s in sets if s.time >= start - 0.1], start


def _swings() -> Iterator[str]:
    for title, words in (
        ("idle", {}),
        (f"{_BUSY} busy processes", {"busy": _BUSY}),
        (f"host stopped for {_STOPPED} s", {"stop": True}),
    ):
        for way in WAYS:
            run = _tried("swing", way, **words)
            if isinstance(run, str):
                yield f"{title}, {way}-timed: the host program failed: {run}"
                continue
            path = motions.swing(run.start)
            sets, start = _start(run, path)
            errors = figures.spread(figures.time_errors(path, sets, start))
            sent = figures.SentPath(path) if way == "board" else path
            left = figures.spread(figures.unexplained(path, sent, sets, start))
            floor = figures.spread(figures.time_errors(path, figures.rounded(path, sets, start), start))
            off = math.degrees(figures.path_error(path, sets, start))
            pause = figures.longest_pause(sets, start, start + path.duration)
            yield (
                f"{title}, {way}-timed: time error {_ms(errors)} of {errors.count}, rounding alone {_ms(floor)}; "
                f"without rounding {_ms(left)}; off the path {off:.2f} deg; longest pause {1e3 * pause:.0f} ms; "
                f"{run.result['why'] or 'arrived'}; chip behind by {1e3 * run.seen.behind:.0f} ms at most"
            )


def _ms(row: figures.Spread) -> str:
    return f"p50 {1e3 * row.p50:.2f} p99 {1e3 * row.p99:.2f} worst {1e3 * row.worst:.2f} ms"


def _tried(motion: str, way: str, **words: Any) -> Run | str:
    try:
        return _run(motion, way, **words)[0]
    except RuntimeError as error:
        return str(error)


def _lines() -> Iterator[str]:
    model, path = motions.kinematics(), motions.straight()

    def tip(joints: dict[str, float]) -> Sequence[float]:
        return model.forward(model.from_joints(joints)).position

    for title, busy in (("idle", 0), (f"{_BUSY} busy processes", _BUSY)):
        for way in WAYS:
            run = _tried("line", way, busy=busy)
            if isinstance(run, str):
                yield f"line of 200 mm, {title}, {way}-timed: the host program failed: {run}"
                continue
            sets, start = _start(run, path)
            off = figures.distance_from_line(tip, sets, path.names, motions.LINE)
            floor = figures.distance_from_line(tip, figures.rounded(path, sets, start), path.names, motions.LINE)
            yield (
                f"line of 200 mm, {title}, {way}-timed: tip off by {1e3 * off:.2f} mm at most "
                f"({1e3 * floor:.2f} mm from rounding to counts alone), {len(sets)} packets"
            )


def _skew() -> str:
    runs = _run("together", "board", chips=2)
    starts = [[t + run.seen.epoch for t in run.seen.starts] for run in runs]
    skews = [abs(a - b) * 1e3 for a, b in zip(*starts, strict=True)]
    return (
        f"start skew of two boards, {len(skews)} starts: median {sorted(skews)[len(skews) // 2]:.2f} ms, worst "
        f"{max(skews):.2f} ms; the driver states an uncertainty of {1e3 * runs[0].result['doubt']:.2f} ms at most"
    )


# -- in simulated time ------------------------------------------------------------------------------


class _Chip:
    """A chip in simulated time whose joints have torque, and a host that sends it paths."""

    def __init__(self) -> None:
        self.board = ChipBoard()
        self.client = Client(self.board)
        self.board.settle()
        self.ask(Command.TORQUE, b"\1\x7f\0")
        self.here = [round(servo.present_position) for servo in self.board.wire.servos]
        self._sent = 0
        self._last: list[PathPoint] = []

    def ask(self, command: int, body: bytes = b"") -> Frame:
        reply = self.client.ask(command, body)
        assert reply.status == Status.OK, reply
        return reply

    def begin(self) -> int:
        """Begin a path of all joints with velocities; the number of points that fit."""
        self._sent = 0
        body = BeginRequest(1, PathFlag.HERMITE, 0x7F, 200).serialize()
        return BeginReply.parse(self.ask(Command.TRAJECTORY_BEGIN, body).body).capacity

    def add(self, points: list[PathPoint]) -> None:
        """Send the first of the points, and take them off the list."""
        self._last = points[:6]
        del points[:6]
        request = PointsRequest.of(1, self._sent, self._last, last=not points)
        self.ask(Command.TRAJECTORY_POINTS, request.serialize())
        self._sent += len(self._last)

    def repeat(self) -> None:
        """Send the newest points again, in place of themselves."""
        request = PointsRequest.of(1, self._sent - len(self._last), self._last, last=False)
        self.ask(Command.TRAJECTORY_POINTS, request.serialize())

    def free(self) -> int:
        """Points that fit now."""
        return PathStatus.parse(self.ask(Command.TRAJECTORY_STATUS).body).free

    def start(self) -> float:
        """Start; the time."""
        reply = self.ask(Command.TRAJECTORY_START, StartRequest(1, 1, 0).serialize())
        return StartReply.parse(reply.body).time_us * 1e-6


def path_rate() -> tuple[float, float]:
    """States and targets of each joint a second, while a trajectory of all joints runs."""
    chip = _Chip()
    board = chip.board
    try:
        chip.ask(Command.REPORT, bytes((5, 0, 0)))
        chip.begin()
        points = [PathPoint(400 if i else 0, tuple(p + 20 * i for p in chip.here), (500,) * 7) for i in range(50)]
        while points:
            chip.add(points)
        chip.start()
        chip.client.run(0.1)
        board.line.sent.clear()
        begin = board.now
        reports = [f for f in chip.client.run(1.5) if f.is_unsolicited and f.cmd == Command.JOINT_STATE]
        seconds = board.now - begin
        assert board.overruns == 0
        sent = [packet[5] for _, packet in board.line.sent if is_target(packet)]
        return len(reports) / seconds, min(sent.count(0x29), sent.count(0x2A)) / seconds
    finally:
        board.close()


def time_error(*, fed: bool = False) -> tuple[figures.Spread, figures.Spread]:
    """Time errors of targets that the board sends, without rounding: of the legacy servos and of the others.

    The same on every machine.

    Args:
        fed: Points come all the time, as many as a request takes, and states are reported as fast as possible.
    """
    chip = _Chip()
    try:
        if fed:
            chip.ask(Command.REPORT, bytes((5, 0, 0)))
        chip.begin()
        joints = HEX7BOT.joints
        legs = 16 if fed else 3
        path = motions.swing([j.counts_to_angle(count) for j, count in zip(joints, chip.here, strict=True)], legs)
        sent = figures.SentPath(path)
        points = sent.points()
        while points and len(points) > sent.count - 54:
            chip.add(points)
        offset = clock_offset(chip.board)
        start = chip.start() + offset - _LEAD
        while points:
            # At all phases of the board's cycle.
            chip.client.run(0.0371 if fed else 0.3)
            if fed and chip.free() < 12:
                chip.repeat()
            else:
                chip.add(points)
        chip.client.run(start + path.duration + 0.1 - chip.board.now)
        packets = [(begin, packet) for begin, packet in chip.board.line.sent if is_target(packet)]
        legacy, others = (
            figures.read_sets([each for each in packets if (each[1][5] == 0x2A) == old], start)
            for old in (True, False)
        )
        return (
            figures.spread(figures.unexplained(path, sent, legacy, start)),
            figures.spread(figures.unexplained(path, sent, others, start)),
        )
    finally:
        chip.board.close()


def _capacity() -> int:
    chip = _Chip()
    try:
        return chip.begin()
    finally:
        chip.board.close()


def run() -> Iterator[str]:
    """Every figure, one a line, as it is measured."""
    yield f"load of the machine {' '.join(f'{x:.1f}' for x in os.getloadavg())}, {os.cpu_count()} cores"
    states, writes = path_rate()
    yield f"while a trajectory of seven joints runs: states {states:.1f} Hz, targets {writes:.1f} Hz"
    yield f"{_capacity()} points of seven joints with velocities; {make('size').strip().splitlines()[-2]}"
    for fed, title in ((False, "no other request"), (True, "points and states all the time")):
        for exact, servos in zip(time_error(fed=fed), ("legacy servos", "others"), strict=True):
            yield f"in simulated time, without rounding, {title}, {servos}: {_ms(exact)} of {exact.count}"
    yield from _swings()
    yield from _lines()
    yield _skew()
    yield f"load at the end {' '.join(f'{x:.1f}' for x in os.getloadavg())}"


if __name__ == "__main__":
    for row in run():
        print(row, flush=True)
