"""Memory and time of commands, as far as a small computer at an arm feels them, beside a bare start of Python.

A watched state is drawn on a pseudo-terminal, as a person sees it.
"""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from statistics import median

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from fleet_blocks import Process  # noqa: E402

_ROUNDS = 7
_BEGUN, _WATCHED = 10, 5.0
"""Pictures after which a watched state is no longer beginning, and seconds for which it is watched then."""
_AIMS = {"state at a port": 45, "state of a shared arm": 45}


def run() -> list[str]:
    """Measure; returns the lines to print."""
    with tempfile.TemporaryDirectory(prefix="hw") as folder, ExitStack() as stack:
        os.environ |= {"XDG_RUNTIME_DIR": folder, "XDG_STATE_HOME": folder}
        os.environ.pop("HEXWIRE_PORT", None)
        port = f"{folder}/board"
        Process(stack, "board", port).ready()
        server = Process(stack, "owner", "lab/arm1", "").ready()
        state = [sys.executable, "-m", "hexwire.cli", "state", "--port"]
        commands = {
            "bare Python": [sys.executable, "-c", "print()"],
            "import hexwire": [sys.executable, "-c", "import hexwire; print()"],
            "state at a port": [*state, port],
            "state of a shared arm": [*state, "zenoh:lab/arm1"],
        }
        rows: dict[str, list[tuple[float, float, float]]] = {name: [] for name in commands}
        for _ in range(_ROUNDS):
            for name, command in commands.items():
                rows[name].append(_first_line(command))
        bare = median(row[1] for row in rows["bare Python"])
        lines = ["medians: ms to the first line, ms of processor, MB at most"]
        for name, found in rows.items():
            first, cpu, memory = (median(column) for column in zip(*found, strict=True))
            aim = f" (aim: at most {_AIMS[name]} MB)" if name in _AIMS else ""
            times = f"{cpu:.0f} ms, {cpu / bare:.1f} times bare Python"
            lines.append(f"  {name}: {1000 * first:.0f} ms; {times}; {memory:.1f} MB{aim}")
        lines.append(f"  the server of the shared arm: {server.memory:.1f} MB (aim: at most 60 MB)")
        for name in _AIMS:
            share = median(_watched([*commands[name], "--watch"]) for _ in range(3))
            lines.append(f"  {name}, watched on a terminal: {share:.1%} of a core (aim: at most 2 %)")
        return lines


def _first_line(command: list[str]) -> tuple[float, float, float]:
    """Seconds to the first line, milliseconds of processor, and most memory in MB."""
    began = time.monotonic()
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdout is not None
        if not process.stdout.readline():
            raise RuntimeError(f"{command} printed nothing")
        first = time.monotonic() - began
        process.stdout.read()
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    return first, 1000 * (used.ru_utime + used.ru_stime), used.ru_maxrss / 1024


def _watched(command: list[str]) -> float:
    """Part of a core that a command takes which draws on a terminal until Ctrl-C."""
    ours, its = pty.openpty()
    drawn = threading.Semaphore(0)

    def read() -> None:
        # A terminal without a reader stops who writes; its end is an error.
        with suppress(OSError):
            while os.read(ours, 1 << 16):
                drawn.release()

    reader = threading.Thread(target=read)
    reader.start()
    environ = {**os.environ, "TERM": "xterm-256color"}
    with subprocess.Popen(command, stdin=its, stdout=its, stderr=subprocess.DEVNULL, env=environ) as process:
        os.close(its)
        for _ in range(_BEGUN):
            drawn.acquire()
        before, began = _used(process.pid), time.monotonic()
        time.sleep(_WATCHED)
        share = (_used(process.pid) - before) / (time.monotonic() - began)
        process.send_signal(signal.SIGINT)
    reader.join()
    os.close(ours)
    return share


def _used(pid: int) -> float:
    """Seconds of processor that all threads of a process have used; Linux only."""
    return sum(int(file.read_text().split()[0]) for file in Path(f"/proc/{pid}/task").glob("*/schedstat")) / 1e9


if __name__ == "__main__":
    for line in run():
        print(line, flush=True)
