"""Shared arms: what sharing costs beside bare Zenoh, one process and PhysicalAI; then many arms; then their start.

Owners run all the time; their readers take turns in blocks, forwards and backwards. A figure is the median of the
blocks, and a ratio the median of the ratios within each round, so that no stall and no drift of the machine favours
one. PhysicalAI's SharedRobot is measured if this Python finds it, or the one in HEXWIRE_BENCH_PHYSICALAI.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from statistics import median

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import fleet_process  # noqa: E402
import fleet_router  # noqa: E402
import fleet_start  # noqa: E402
import fleet_worker  # noqa: E402
from fleet_blocks import Block, Process, free_port, in_rounds, middle, quantiles, ratio  # noqa: E402

PYTHON = "HEXWIRE_BENCH_PHYSICALAI"
"""Environment variable: an interpreter that imports physicalai."""
_ROUNDS = 5
_SECONDS = 1.2
_CPU_ROUNDS = 3
_CPU_SECONDS = 1.5
_READERS = (1, 4, 16)
_PROCESSES = 4
"""Processes of the readers, each with a share of them."""
_OPENS = 4
_LOOP = "PhysicalAI by its own call in a loop at 100 Hz"


def run() -> Iterator[str]:
    """Measure; yields the lines to print."""
    with tempfile.TemporaryDirectory(prefix="hw") as folder:
        os.environ |= {"XDG_RUNTIME_DIR": folder, "XDG_STATE_HOME": folder}
        os.environ.pop("HEXWIRE_PORT", None)
        for part in (_states_and_peer, _set_points, _opening):
            with ExitStack() as stack:
                yield from part(stack, Path(folder))
        yield from fleet_router.run()
        yield from fleet_start.run()
    yield from fleet_process.run()


# -- one arm: states, readers, the peer ---------------------------------------------------------------------------


def _states_and_peer(stack: ExitStack, folder: Path) -> Iterator[str]:
    port, bare_port = free_port(), free_port()
    python = _physical_python()
    # The clients of the TCP endpoint do not see the socket.
    away = {"XDG_RUNTIME_DIR": str(folder / "away"), "XDG_STATE_HOME": str(folder / "away")}
    unix = f"unixsock-stream/{folder}/bare.sock"
    owners = {"hexwire": Process(stack, "owner", "lab/arm1", "", f"tcp/127.0.0.1:{port}")}
    if python:
        owners["PhysicalAI"] = Process(stack, "physical-owner", "arm1", python=python)
    for process in owners.values():
        process.ready()
    clients = {
        "hexwire": [Process(stack, "client", "zenoh:lab/arm1") for _ in range(_PROCESSES)],
        "hexwire tcp": [Process(stack, "client", f"zenoh:lab/arm1?router=tcp/127.0.0.1:{port}", **away)],
        "bare Zenoh": [Process(stack, "bare-reader", unix)],
        "bare Zenoh tcp": [Process(stack, "bare-reader", f"tcp/127.0.0.1:{bare_port}")],
    }
    if python:
        clients["PhysicalAI"] = [
            Process(stack, "physical-client", "arm1", python=python) for _ in range(_PROCESSES)
        ]
        clients[_LOOP] = [Process(stack, "physical-client", "arm1", "loop", python=python)]
    for process in clients["hexwire"]:
        process.ready()
    size = clients["hexwire"][0].ask("size")["size"]
    for process in [Process(stack, "bare-owner", at, size) for at in (unix, f"tcp/127.0.0.1:{bare_port}")]:
        process.ready()
    for name, processes in clients.items():
        for process in processes if name != "hexwire" else ():
            process.ready()

    rounds = in_rounds(clients, _ROUNDS, lambda name: _ages(clients[name][0]))
    yield f"states of {size} bytes at 100 Hz from the robot to a reader in another process, p50 / p99 ms:"
    for name in clients:
        yield f"  {name}: {middle(rounds, name, 'p50'):.3f} / {middle(rounds, name, 'p99'):.3f}"
    pairs = [("hexwire", "bare Zenoh"), ("hexwire tcp", "bare Zenoh tcp")]
    pairs += [("hexwire", other) for other in ("PhysicalAI", _LOOP)] if python else []
    for ours, other in pairs:
        aim = "at most 1.5" if other.startswith("bare") else "at most 1"
        yield (
            f"  ratio {ours} / {other}: p50 {ratio(rounds, ours, other, 'p50'):.2f}, "
            f"p99 {ratio(rounds, ours, other, 'p99'):.2f} (aim: {aim})"
        )
    if not python:
        yield f"  PhysicalAI is not installed here; {PYTHON} may name a Python that has physicalai"
    rounds = in_rounds(owners, _ROUNDS, lambda name: _commands(clients[name][0], owners[name]))
    yield "a target from the client's call to the robot's, p50 / p99 ms:"
    for name in owners:
        yield f"  {name}: {middle(rounds, name, 'p50'):.3f} / {middle(rounds, name, 'p99'):.3f}"
    yield f"  hexwire until its answer: {middle(rounds, 'hexwire', 'answered'):.3f} (PhysicalAI does not answer)"
    if python:
        share = ratio(rounds, "hexwire", "PhysicalAI", "p50")
        yield f"  ratio hexwire / PhysicalAI: p50 {share:.3f} (aim: at most 0.2)"
    yield from _cpu(owners, clients)


def _cpu(owners: dict[str, Process], clients: dict[str, list[Process]]) -> Iterator[str]:
    cases = [(name, count) for name in owners for count in _READERS]
    counts = {f"{name} {count}": (name, count) for name, count in cases}

    def measure(case: str) -> Block:
        name, count = counts[case]
        return _owner_cpu(owners[name], clients[name], count)

    rounds = in_rounds(counts, _CPU_ROUNDS, measure)
    yield f"CPU of the owner at 100 Hz with {', '.join(map(str, _READERS))} readers, ms a second of one core:"
    for name in owners:
        figures = [middle(rounds, f"{name} {count}", "cpu") for count in _READERS]
        more = (figures[-1] - figures[0]) / (_READERS[-1] - _READERS[0])
        share = min(middle(rounds, f"{name} {count}", "share") for count in _READERS)
        yield (
            f"  {name}: {', '.join(f'{figure:.0f}' for figure in figures)}; a reader more costs {more / 10:.2f} % "
            f"of a core{' (aim: at most 1)' if name == 'hexwire' else ''}; of the states {share:.1%} arrived"
        )
    if len(owners) > 1:
        share = ratio(rounds, f"hexwire {_READERS[-1]}", f"PhysicalAI {_READERS[-1]}", "cpu")
        yield f"  ratio hexwire / PhysicalAI at {_READERS[-1]} readers: {share:.2f} (aim: at most 1)"


def _ages(process: Process) -> Block:
    process.ask("open", count=1)
    try:
        ages = process.ask("read", seconds=_SECONDS)["ages"][0]
    finally:
        process.ask("close")
    return quantiles(ages)


def _commands(process: Process, owner: Process) -> Block:
    owner.ask("targets")
    answer = process.ask("write", seconds=_SECONDS)
    start = answer.get("start", 0.0)
    arrived = {round((value - start) / fleet_worker.STEP): when for when, value in owner.ask("targets")["targets"]}
    delays, answered = [], []
    for sent, value, done in answer["sent"]:
        answered.append(done - sent)
        when = arrived.get(round((value - start) / fleet_worker.STEP))
        if when is not None:
            delays.append(when - sent)
    return {**quantiles(delays), "answered": 1000 * median(answered)}


def _owner_cpu(owner: Process, processes: list[Process], count: int) -> Block:
    used = processes[: min(count, len(processes))]
    for process in used:
        process.ask("open", count=count // len(used))
    time.sleep(0.2)
    before = owner.ask("cpu")
    for process in used:
        process.begin("read", seconds=_CPU_SECONDS)
    ages = [rows for process in used for rows in process.end()["ages"]]
    after = owner.ask("cpu")
    for process in used:
        process.ask("close")
    expected = fleet_worker.RATE * _CPU_SECONDS * count
    return {
        "cpu": 1000 * (after["cpu"] - before["cpu"]) / (after["now"] - before["now"]),
        "share": sum(map(len, ages)) / expected,
    }


# -- from the client's call to the servo line ---------------------------------------------------------------------


def _set_points(stack: ExitStack, folder: Path) -> Iterator[str]:
    boards = {name: str(folder / f"board{i}") for i, name in enumerate(("driver", "local", "client"))}
    lines = {name: Process(stack, "board", link).ready() for name, link in boards.items()}
    owner = Process(stack, "owner", "lab/arm2", boards["client"]).ready()
    senders = {name: Process(stack, name, boards[name]) for name in ("driver", "local")}
    senders["client"] = Process(stack, "client", "zenoh:lab/arm2")
    for process in senders.values():
        process.ready()
    rounds = in_rounds(senders, _ROUNDS, lambda name: _first_byte(senders[name], lines[name]))
    del owner
    words = {
        "driver": "a driver in one process, which reads nothing meanwhile",
        "local": "owner, lease and checks in one process, states at 100 Hz",
        "client": "shared by hexwire serve, states at 100 Hz",
    }
    yield "a target from the client's call to its first byte on the servo line of an emulated board, p50 / p99 ms:"
    for name, text in words.items():
        yield f"  {text}: {middle(rounds, name, 'p50'):.3f} / {middle(rounds, name, 'p99'):.3f}"
    for other in ("driver", "local"):
        yield f"  ratio shared / {words[other].partition(',')[0]}: p50 {ratio(rounds, 'client', other, 'p50'):.2f}"


def _first_byte(sender: Process, board: Process) -> Block:
    board.ask("times")
    sent = sender.ask("write", seconds=_SECONDS)["sent"]
    times = board.ask("times")["times"]
    delays = []
    for (began, _, _), (until, _, _) in pairwise(sent):
        found = [when for when in times if began <= when <= until]
        if found:
            delays.append(found[0] - began)
    return quantiles(delays)


def _opening(stack: ExitStack, folder: Path) -> Iterator[str]:
    links = [str(folder / f"open{i}") for i in range(2)]
    for link in links:
        Process(stack, "board", link).ready()
    Process(stack, "owner", "lab/arm3", links[1]).ready()
    ports = {"direct": links[0], "shared": "zenoh:lab/arm3"}
    rounds = in_rounds(ports, _OPENS, lambda name: _open(ports[name]))
    yield (
        f"'hexwire state' from start to end: {middle(rounds, 'direct', 's'):.3f} s at a port, "
        f"{middle(rounds, 'shared', 's'):.3f} s at zenoh: (ratio {ratio(rounds, 'shared', 'direct', 's'):.2f})"
    )


def _open(port: str) -> Block:
    began = time.monotonic()
    command = [sys.executable, "-m", "hexwire.cli", "state", "--port", port]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, timeout=30)
    return {"s": time.monotonic() - began}


def _physical_python() -> str:
    """An interpreter that has PhysicalAI's shared robot; empty if there is none."""
    python = os.environ.get(PYTHON) or sys.executable
    check = subprocess.run(
        [python, "-c", "import physicalai.robot.transport, zenoh, numpy"], capture_output=True, check=False
    )
    return python if check.returncode == 0 else ""


if __name__ == "__main__":
    for line in run():
        print(line, flush=True)
