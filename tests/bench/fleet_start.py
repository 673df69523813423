"""Several shared arms that begin at one time: how far apart, on their servo lines.

Every arm has a server and a board, each a process of its own: the firmware on simulated chips, whose time is exact
whatever their processes have to wait for, and emulated boards. The clocks of the servers are like those of other
machines: far from each other, and of different rates. The player is in this process.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from statistics import median

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import fleet_worker  # noqa: E402
from fleet_blocks import Process  # noqa: E402

from hexwire.fleet.player import FleetMotionError, PlayedArm, PlayReport, attached_to, play_together  # noqa: E402
from hexwire.motion.trajectory import Spline, Waypoint  # noqa: E402

_CLOCKS = ("0 0", "1000 40", "-300 -40", "5e6 20")
"""Seconds ahead and millionths fast, of each server."""
_STARTS = {"board": 10, "host": 5}
_CHIPS, _CHIP_STARTS = 2, 6
_SAME = 0.05
"""Seconds: start times that are closer are corrections of one."""
_PAUSE = 0.5
"""Seconds: between the approach and the motion nothing is written for longer."""
_WAY = Spline(("J1",), [Waypoint(t, (angle,), (0.0,)) for t, angle in ((0.0, 0.0), (0.3, 0.1), (0.6, 0.0))])


def run() -> Iterator[str]:
    """Measure; yields the lines to print."""
    with ExitStack() as stack:
        yield from _on_chips(stack)
    for way, starts in _STARTS.items():
        with ExitStack() as stack:
            yield from _together(stack, way, starts)


class _Chip:
    """The firmware on a simulated chip, in real time."""

    def __init__(self, stack: ExitStack) -> None:
        command = [sys.executable, "-m", "tests.bench.path_chip"]
        self._process = stack.enter_context(
            subprocess.Popen(command, cwd=HERE.parents[1], text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        )
        self.terminal = self._line()

    def _line(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline().strip()

    def starts(self) -> list[tuple[float, float]]:
        """End it; when each motion was to start, and its first packet on the servo line, in this machine's time."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        seen = json.loads(self._line())
        times, packets = sorted(seen["starts"]), [begin for begin, _ in seen["packets"]]
        # The last order counts. Every other one is that of an approach.
        starts = [a for a, b in pairwise([*times, float("inf")]) if b - a > _SAME][1::2]
        epoch = seen["epoch"]
        return [
            (start + epoch, min(begin for begin in packets if begin > start - _SAME) + epoch) for start in starts
        ]


def _on_chips(stack: ExitStack) -> Iterator[str]:
    chips = [_Chip(stack) for _ in range(_CHIPS)]
    names = [f"start/chip{number}" for number in range(_CHIPS)]
    stated = list[float]()
    with ExitStack() as servers:
        for name, chip, clock in zip(names, chips, _CLOCKS, strict=False):
            Process(servers, "owner", name, chip.terminal, **{fleet_worker.CLOCK: clock}).ready()
        with attached_to({name: f"zenoh:{name}" for name in names}) as robots:
            for _ in range(_CHIP_STARTS):
                report = play_together([PlayedArm(robot, _WAY) for robot in robots.values()])
                _check(report, "board")
                stated.append(report.apart)
    rows = list(zip(*(chip.starts() for chip in chips), strict=True))
    ordered = [_spread([start for start, _ in row]) for row in rows]
    written = [_spread([begin for _, begin in row]) for row in rows]
    wrong = sum(a > b for a, b in zip(ordered, stated, strict=True))
    yield (
        f"{_CHIPS} shared arms that begin together, {len(rows)} starts, the firmware on simulated chips at 115200 "
        "baud; median / worst ms:"
    )
    yield f"  between the starts on the boards' clocks: {_ms(ordered)} (aim: at most 2)"
    yield f"  what the player states as the most: {_ms(stated)}; exceeded in {wrong} starts"
    yield f"  between the first bytes on their servo lines: {_ms(written)}"


def _spread(times: list[float]) -> float:
    return max(times) - min(times)


def _together(stack: ExitStack, way: str, starts: int) -> Iterator[str]:
    folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="hw"))
    names = [f"start/{way}{number}" for number in range(len(_CLOCKS))]
    boards: dict[str, Process] = {}
    for name, clock in zip(names, _CLOCKS, strict=True):
        link = f"{folder}/{name.rpartition('/')[2]}"
        boards[name] = Process(stack, "board", link).ready()
        port = link if way == "board" else f"host:{link}"
        Process(stack, "owner", name, port, **{fleet_worker.CLOCK: clock}).ready()
    robots = stack.enter_context(attached_to({name: f"zenoh:{name}" for name in names}))
    ordered, written, late, stated = list[float](), list[float](), list[float](), list[float]()
    refused = wrong = 0
    for _ in range(starts):
        _asked(boards)
        try:
            report = play_together([PlayedArm(robot, _WAY) for robot in robots.values()])
        except FleetMotionError as error:
            refused += 1
            yield f"  not played: {error}"
            for robot in robots.values():
                robot.resume()
                robot.release()
            continue
        _check(report, way)
        rows = _asked(boards)
        first = [_begin(times) for times, _ in rows]
        written.append(_spread(first))
        stated.append(report.apart)
        if way == "board":
            begins = [start for _, start in rows]
            ordered.append(_spread(begins))
            wrong += ordered[-1] > report.apart
            late += [a - b for a, b in zip(first, begins, strict=True)]
    yield (
        f"{len(names)} shared arms that begin together, {len(written)} starts, time kept by "
        f"{'their boards' if way == 'board' else 'their servers'}; median / worst ms:"
    )
    if way == "board":
        yield f"  between the first and the last start on the boards' clocks: {_ms(ordered)} (aim: at most 2)"
        yield f"  what the player states as the most: {_ms(stated)}; exceeded in {wrong} starts"
        yield f"  between the first bytes on their servo lines: {_ms(written)}"
        yield f"  of that a stall of an emulated board's process, from its start to its first byte: {_ms(late)}"
    else:
        yield f"  between the first bytes on their servo lines: {_ms(written)} (stated: {_ms(stated)})"
    if refused:
        yield f"  of {starts} starts {refused} were refused"


def _asked(boards: dict[str, Process]) -> list[tuple[list[float], float]]:
    rows = [board.ask("times") for board in boards.values()]
    return [(row["times"], row["start"]) for row in rows]


def _check(report: PlayReport, way: str) -> None:
    if wrong := [name for name, row in report.arms.items() if row.kept_by != way]:
        raise RuntimeError(f"not timed by the {way}: {', '.join(wrong)}")


def _begin(times: list[float]) -> float:
    """When the motion begins: the first byte after the last pause."""
    return [b for a, b in pairwise(times) if b - a > _PAUSE][-1]


def _ms(seconds: list[float]) -> str:
    return f"{1000 * median(seconds):.2f} / {1000 * max(seconds):.2f}" if seconds else "-"


if __name__ == "__main__":
    for line in run():
        print(line, flush=True)
