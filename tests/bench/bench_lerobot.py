"""The plug-in for LeRobot beside LeRobot's own arm, and `hexwire follow` beside `lerobot-teleoperate`.

Needs LeRobot's environment: that of `make test-lerobot`, or the Python that HEXWIRE_BENCH_LEROBOT names. Both sides
run on the same emulated pair of arms (`busemu pair`), whose lines are paced at 1 Mbaud, in turns and each in a
process of its own. `python tests/bench/bench_lerobot.py --write` also puts the figures into
docs/figures-lerobot.md.
"""

from __future__ import annotations

import datetime
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from statistics import median
from typing import Any

_HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(_HERE))

import lerobot_pair as pair  # noqa: E402

_ROOT = _HERE.parents[1]
_USUAL = _ROOT / "build" / "lerobot" / "bin" / "python"
_PAGE = _ROOT / "docs" / "figures-lerobot.md"
_BEGIN, _END = ("<!-- figures of the benchmark (lerobot): " + word + " -->\n" for word in ("begin", "end"))
_NAMES = ("hexwire", "lerobot")
_BARE = "bare"
_ROUNDS = 4
_CYCLES = 400
_PACED_CYCLES = 60
_RATE = 60.0
"""Cycles a second of LeRobot's programs."""
_LINE_RATE = 10_000.0
"""More than a line has room for: `hexwire follow` then takes as many cycles as there is room for."""
_FOLLOW_SECONDS = 5.0
"""One run of each program: LeRobot's takes a quarter of a minute to start."""
_CONNECTIONS = 20
_OBSERVATIONS = 500
_FREE_AIMS = {"observe": 0.25, "act": 1.0, "both": 0.25}
_PACED_AIMS = {"observe": 0.33, "act": 1.0, "both": 0.33}
"""Shares of LeRobot's processor time at most; that of an action also without the system calls."""
_P99_AIM = 0.75
_READ, _GOALS = 620.0, {"hexwire": 560.0, "lerobot": 260.0}
"""Microseconds on the line: six positions with their request, 62 bytes; six goals, of 7 and of 2 bytes."""


def run(*, write: bool = False) -> list[str]:
    """Measure.

    Args:
        write: Put the figures into docs/figures-lerobot.md.

    Returns:
        The lines to print.
    """
    python = os.environ.get("HEXWIRE_BENCH_LEROBOT", str(_USUAL))
    if not Path(python).exists():
        return ["LeRobot is not installed here: make test-lerobot, or set HEXWIRE_BENCH_LEROBOT=/path/python"]
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        return ["no C compiler here: sudo apt-get install gcc libc6-dev"]
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory(prefix="hexwire-bench-") as folder:
        home, busemu = Path(folder), str(Path(folder) / "busemu")
        command = [compiler, "-O2", "-o", busemu, str(_HERE / "busemu.c"), "-lutil", "-lpthread"]
        subprocess.run(command, check=True)
        pair.write_calibrations(home)
        with pair.emulated(busemu) as emulator:
            rows = [*_plug_in(python, emulator, home), *_teleoperation(python, emulator, home)]
    # The programs measured and the emulator inherit it.
    nice = f", all programs at nice {os.nice(0)}" if os.nice(0) else ""
    after = os.getloadavg()[0]
    where = f"{datetime.date.today().isoformat()}, {_machine()}, load {load:.1f} before, {after:.1f} after{nice}"
    lines = [
        where,
        "| what | hexwire | LeRobot | ratio | aim |",
        "|---|---|---|---|---|",
        *(f"| {' | '.join(row)} |" for row in rows),
    ]
    if write:
        _PAGE.write_text(_replaced(_PAGE.read_text(), f"Measured {lines[0]}:\n\n" + "\n".join(lines[1:]) + "\n"))
    return lines


def _replaced(page: str, block: str) -> str:
    """The page with another block between its markers."""
    before, begin, rest = page.partition(_BEGIN)
    _, end, after = rest.partition(_END)
    if not begin or not end:
        raise ValueError(f"{_PAGE} has no markers for the figures")
    return f"{before}{begin}{block}{end}{after}"


def _machine() -> str:
    name = platform.machine()
    with open("/proc/cpuinfo") as cpus:  # noqa: PTH123  # a file of the system
        name = next((line.partition(":")[2].strip() for line in cpus if line.startswith("model name")), name)
    return f"{os.cpu_count()} cores of {name}, Python {platform.python_version()}"


# --- the plug-in -------------------------------------------------------------------------------------------------


class _Worker:
    """A running `lerobot_worker.py`."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def ready(self) -> None:
        """Wait until it has imported LeRobot."""
        self._line()

    def ask(self, what: str, **options: object) -> dict[str, Any]:
        """Have it do something; returns the result."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps({"what": what, **options}) + "\n")
        self._process.stdin.flush()
        return self._line()

    def _line(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError("a worker has ended; see above")
        return json.loads(line)  # type: ignore[no-any-return]


@contextmanager
def _workers(python: str, port: str, home: Path) -> Iterator[dict[str, _Worker]]:
    # This tree's code, whatever tree the environment was made for.
    paths = os.pathsep.join(str(_ROOT / path) for path in ("src", "integrations/lerobot/src"))
    environ = {**pair.environment(home), "PYTHONPATH": paths}
    with ExitStack() as stack:
        found: dict[str, _Worker] = {}
        for name in (*_NAMES, _BARE):
            command = [python, str(_HERE / "lerobot_worker.py"), name, port]
            process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environ
            )
            stack.enter_context(process)
            assert process.stdin is not None
            stack.callback(process.stdin.close)
            found[name] = _Worker(process)
        for worker in found.values():
            worker.ready()
        yield found


Block = dict[str, list[float]]


def _plug_in(python: str, emulator: pair.Emulator, home: Path) -> Iterator[tuple[str, ...]]:
    with _workers(python, emulator.follower, home) as workers:
        free: dict[str, list[Block]] = {name: [] for name in workers}
        paced: dict[str, list[Block]] = {name: [] for name in workers}
        for turn in range(_ROUNDS):
            for name in workers if turn % 2 else reversed(workers):
                free[name].append(workers[name].ask("speed", cycles=_CYCLES, rate=0.0))
                paced[name].append(workers[name].ask("speed", cycles=_PACED_CYCLES, rate=_RATE))
        opened: dict[str, list[Block]] = {name: [] for name in _NAMES}
        for turn in range(_ROUNDS):
            for name in _NAMES if turn % 2 else _NAMES[::-1]:
                opened[name].append(workers[name].ask("connections", count=_CONNECTIONS))
        emulator.begin(faults=True)
        failed, observed = {}, {}
        for name in _NAMES:
            failed[name] = _CONNECTIONS - len(workers[name].ask("connections", count=_CONNECTIONS)["connect"])
            observed[name] = workers[name].ask("observe", count=_OBSERVATIONS)
        emulator.end()
    yield from _cpu_rows(free, "as fast as the line allows", _FREE_AIMS)
    yield from _cpu_rows(paced, f"{_RATE:g} a second", _PACED_AIMS)
    yield from _time_rows(free)
    for share, text in ((0.5, "p50"), (0.99, "p99")):
        ours, theirs = (_at(sorted(t for one in opened[name] for t in one["connect"]), share) for name in _NAMES)
        cells = f"{1e3 * ours:.0f} ms", f"{1e3 * theirs:.0f} ms", f"{ours / theirs:.2f}"
        yield f"`connect`, {text}", *cells, _aim(1.0, ours / theirs)
    loss = "with 1 % of the answers lost: "
    yield (
        f"{loss}observations that raise; wrong values",
        *(f"{observed[name]['raised'] / _OBSERVATIONS:.1%}; {observed[name]['wrong']}" for name in _NAMES),
        "",
        "none",
    )
    yield f"{loss}connections that fail", *(f"{failed[name]} of {_CONNECTIONS}" for name in _NAMES), "", "none"


def _aim(most: float, *ratios: float) -> str:
    """The aim of a ratio, and whether it is missed."""
    return f"{most:g}" + (", missed" if any(round(ratio, 2) > most for ratio in ratios) else "")


def _cpu_rows(blocks: dict[str, list[Block]], rate: str, aims: dict[str, float]) -> Iterator[tuple[str, ...]]:
    costs = {name: _costs(rows) for name, rows in blocks.items()}
    for key, what in (("observe", "`get_observation`"), ("act", "`send_action`"), ("both", "both: a cycle")):
        ours, theirs, bare = (1e6 * costs[name][key] for name in (*_NAMES, _BARE))
        ratios = [ours / theirs]
        if key == "act":
            ratios.append((ours - bare) / (theirs - bare))
        ratio = "; without the system calls ".join(f"{one:.2f}" for one in ratios)
        cells = f"{ours:.0f} us", f"{theirs:.0f} us", ratio, _aim(aims[key], *ratios)
        yield f"CPU of {what}, {rate}; the system calls alone {bare:.0f} us", *cells


def _time_rows(blocks: dict[str, list[Block]]) -> Iterator[tuple[str, ...]]:
    ours, theirs = (1e3 * _middle(blocks[name], "alone", 0.5) for name in _NAMES)
    cells = [f"{one:.2f} ms, {1e3 * one / _READ:.2f} times the line's" for one in (ours, theirs)]
    what = f"`get_observation`, p50; the line's own {_READ / 1000:.2f} ms"
    yield what, *cells, f"{ours / theirs:.2f}", "1.15 times the line's"
    ours, theirs = (1e3 * _middle(blocks[name], "alone", 0.99) for name in _NAMES)
    yield "... p99", f"{ours:.2f} ms", f"{theirs:.2f} ms", f"{ours / theirs:.2f}", _aim(_P99_AIM, ours / theirs)
    ours, theirs = (1e3 * _middle(blocks[name], "act", 0.5) for name in _NAMES)
    yield "`send_action` returns after, p50", f"{ours:.2f} ms", f"{theirs:.2f} ms", f"{ours / theirs:.2f}", ""
    cells = []
    for name in _NAMES:
        line = (_READ + _GOALS[name]) / 1000
        both = [{"both": [a + b for a, b in zip(one["observe"], one["act"], strict=True)]} for one in blocks[name]]
        p50 = 1e3 * _middle(both, "both", 0.5)
        cells.append(f"{p50:.2f} ms, {p50 / line:.2f} times the line's {line:.2f}")
    yield "both in turns, p50", *cells, "", "1.15 times the line's"


def _costs(blocks: list[Block]) -> dict[str, float]:
    """Median over the blocks of the mean CPU time of a call, seconds."""
    found = {
        key: median(sum(one[f"{key}_cpu"]) / len(one[f"{key}_cpu"]) for one in blocks) for key in ("observe", "act")
    }
    return {**found, "both": sum(found.values())}


def _middle(blocks: list[Block], key: str, share: float) -> float:
    """Median over the blocks of a quantile: a block in which the machine stalled tells of the machine."""
    return median(_at(sorted(one[key]), share) for one in blocks)


def _at(rows: list[float], share: float) -> float:
    return rows[min(len(rows) - 1, int(share * len(rows)))] if rows else float("nan")


# --- teleoperation -----------------------------------------------------------------------------------------------


def _teleoperation(python: str, emulator: pair.Emulator, home: Path) -> Iterator[tuple[str, ...]]:
    plain, faulty = (
        {name: _followed(name, python, emulator, home, faults) for name in _NAMES} for faults in (False, True)
    )
    rates = [f"{plain[name]['rate']:.0f}" for name in _NAMES]
    yield f"`hexwire follow --rate {_LINE_RATE:g}` and `lerobot-teleoperate`: cycles a second", *rates, "", ""
    for share, text in ((0.5, "p50"), (0.99, "p99")):
        ours, theirs = (1e3 * _at(sorted(plain[name]["delays"]), share) for name in _NAMES)
        what = f"leader's count to follower's goal, {text}"
        yield what, f"{ours:.1f} ms", f"{theirs:.1f} ms", f"{ours / theirs:.2f}", "0.25"
    ours, theirs = (1e6 * plain[name]["cpu"] for name in _NAMES)
    yield "CPU of a cycle", f"{ours:.0f} us", f"{theirs:.0f} us", f"{ours / theirs:.2f}", "0.25"
    cells = []
    for name in _NAMES:
        run = faulty[name]
        text = "goes on" if run["ended"] is None else f"ends after {run['ended']:.2f} s"
        cells.append(f"{text}; {run['wrong']} of {run['goals']} goals wrong")
    yield f"with 1 % of the answers lost, {_FOLLOW_SECONDS:g} s", *cells, "", "goes on, none wrong"


def _followed(name: str, python: str, emulator: pair.Emulator, home: Path, faults: bool) -> dict[str, Any]:
    for _ in range(5):
        command = pair.command_of(name, python, emulator, home, _LINE_RATE)
        found = pair.measure(command, emulator, home, _FOLLOW_SECONDS, faults=faults)
        # A stall of the machine ends LeRobot's loop without a lost answer, too.
        if found and (faults or found["ended"] is None):
            return found
    log = (home / "log").read_text().strip().splitlines()
    raise RuntimeError(f"{name} does not follow: {log[-1:]}")


if __name__ == "__main__":
    print("\n".join(run(write="--write" in sys.argv[1:])))
