"""The processes of the fleet's benchmark as the benchmark sees them, and the figures of their blocks.

Owns how a worker is started, asked and ended, and how blocks become a figure. Must not know what is measured.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from statistics import median
from typing import Any

HERE = Path(__file__).resolve().parent

Block = dict[str, float]

_FILES = {
    "fleet_own.py": ("owner", "several", "client", "driver", "local", "board"),
    "fleet_many.py": ("router", "arms", "replay", "watcher"),
    "fleet_worker.py": ("bare-owner", "bare-reader", "bare-client", "physical-owner", "physical-client"),
}


class Process:
    """A worker process."""

    def __init__(self, stack: ExitStack, role: str, *args: object, python: str = "", **environ: str) -> None:
        file = next(file for file, roles in _FILES.items() if role in roles)
        self._process = subprocess.Popen(
            [python or sys.executable, str(HERE / file), role, *map(str, args)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, **environ},
        )
        stack.callback(self._end)
        self._role = role

    def ready(self) -> Process:
        """Wait until it has started."""
        self._line()
        return self

    @property
    def memory(self) -> float:
        """MB that it takes now; Linux only."""
        rows = Path(f"/proc/{self._process.pid}/status").read_text().splitlines()
        return next(int(row.split()[1]) for row in rows if row.startswith("VmRSS")) / 1024

    def begin(self, what: str, **options: object) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps({"what": what, **options}) + "\n")
        self._process.stdin.flush()

    def end(self) -> dict[str, Any]:
        return json.loads(self._line())

    def ask(self, what: str, **options: object) -> dict[str, Any]:
        self.begin(what, **options)
        return self.end()

    def _line(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"the worker {self._role} has ended with status {self._process.wait()}")
        return line

    def _end(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def in_rounds(names: dict[str, Any], count: int, measure: Callable[[str], Block]) -> list[dict[str, Block]]:
    """Measure every name once a round, in alternating order."""
    rounds = []
    for turn in range(count):
        order = list(names)
        rounds.append({name: measure(name) for name in (reversed(order) if turn % 2 else order)})
    return rounds


def quantiles(times: list[float]) -> Block:
    rows = sorted(times)
    if not rows:
        raise RuntimeError("nothing arrived")
    return {"p50": 1000 * rows[len(rows) // 2], "p99": 1000 * rows[min(len(rows) - 1, int(0.99 * len(rows)))]}


def middle(rounds: list[dict[str, Block]], name: str, key: str) -> float:
    return median(row[name][key] for row in rounds)


def ratio(rounds: list[dict[str, Block]], name: str, other: str, key: str) -> float:
    return median(row[name][key] / row[other][key] for row in rounds)


def free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])
