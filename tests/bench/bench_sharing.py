"""What one client costs that reads each state of a shared arm and answers it by a target, beside bare Zenoh.

The arm is a fake one, so that what is measured is the sharing. Owners and clients run all the time and take turns
in blocks; a figure is the median of the blocks, and a ratio the median of the ratios within each round.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from statistics import median

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import fleet_worker  # noqa: E402
from fleet_blocks import Block, Process, in_rounds, middle, quantiles, ratio  # noqa: E402

_ROUNDS = 5
_SECONDS = 3.0
_SETTLED = 12.0
"""Seconds after a client has come until all threads have ended that were needed for that; Zenoh's take 10."""
_UNUSED = 3.0
"""Seconds until an arm that nobody uses is read rarely."""
_AIMS = ("at most 60", "at most 50")


def run() -> Iterator[str]:
    """Measure; yields the lines to print."""
    with tempfile.TemporaryDirectory(prefix="hw") as folder, ExitStack() as stack:
        os.environ |= {"XDG_RUNTIME_DIR": folder, "XDG_STATE_HOME": folder}
        os.environ.pop("HEXWIRE_PORT", None)
        yield from _one_client(stack, Path(folder))
    with tempfile.TemporaryDirectory(prefix="hw") as folder, ExitStack() as stack:
        os.environ |= {"XDG_RUNTIME_DIR": folder, "XDG_STATE_HOME": folder}
        yield from _on_boards(stack, Path(folder))


def _on_boards(stack: ExitStack, folder: Path) -> Iterator[str]:
    ports = [f"{folder}/board{i}" for i in range(5)]
    for port in ports:
        Process(stack, "board", port).ready()
    owner = Process(stack, "owner", "lab/board", ports[0]).ready()
    client = Process(stack, "client", "zenoh:lab/board").ready()
    rounds: list[Block] = []
    for _ in range(_ROUNDS):
        # Until nobody uses it any more.
        client.ask("wait", seconds=_UNUSED)
        rounds.append({"idle": _idle(owner, client)["owner"]})
        before = owner.ask("cpu")
        work = client.ask("work", seconds=_SECONDS, torque=True)
        after = owner.ask("cpu")
        rounds[-1]["owner"] = 1000 * (after["cpu"] - before["cpu"]) / (after["now"] - before["now"])
        rounds[-1]["client"] = 1000 * work["cpu"] / work["seconds"]
        rounds[-1]["states"] = len(work["ages"]) / work["seconds"]
    idle, used, by, states = (median(row[key] for row in rounds) for key in ("idle", "owner", "client", "states"))
    yield "the same on an emulated board in another process; CPU in ms/s of one core:"
    yield f"  owner {used:.0f}, client {by:.0f}, {states:.0f} states a second"
    yield f"  owner whose arm has no torque and no reader: {idle:.1f} (aim: at most 10)"
    four = Process(stack, "several", "50", *ports[1:]).ready()
    readers = [Process(stack, "client", f"zenoh:lab/arm{i}").ready() for i in range(4)]
    for reader in readers:
        reader.ask("open", count=1)
    shares = []
    for _ in range(_ROUNDS):
        before = four.ask("cpu")
        for reader in readers:
            reader.begin("read", seconds=_SECONDS)
        read = sum(len(rows) for reader in readers for rows in reader.end()["ages"])
        after = four.ask("cpu")
        shares.append((1000 * (after["cpu"] - before["cpu"]) / (after["now"] - before["now"]), read / _SECONDS))
    cost, rate = (median(column) for column in zip(*shares, strict=True))
    yield f"  four arms in one process at 50 Hz, {rate:.0f} states read a second: {cost:.0f} (aim: at most 80)"


def _one_client(stack: ExitStack, folder: Path) -> Iterator[str]:
    ours, bare = "hexwire", "bare Zenoh"
    unix = f"unixsock-stream/{folder}/bare.sock"
    owners = {ours: Process(stack, "owner", "lab/arm1", "").ready()}
    clients = {ours: Process(stack, "client", "zenoh:lab/arm1").ready()}
    size = clients[ours].ask("size")["size"]
    owners[bare] = Process(stack, "bare-owner", unix, size).ready()
    clients[bare] = Process(stack, "bare-client", unix).ready()
    idle = in_rounds(owners, _ROUNDS, lambda name: _idle(owners[name], clients[name]))
    rounds = in_rounds(owners, _ROUNDS, lambda name: _work(owners[name], clients[name]))
    yield f"states of {size} bytes at {fleet_worker.RATE:g} Hz, each answered by a target; CPU in ms/s of one core:"
    for name in owners:
        rows = [f"{key} {middle(rounds, name, key):.0f}" for key in ("owner", "client")]
        if name == ours:
            rows = [f"{row} (aim: {aim})" for row, aim in zip(rows, _AIMS, strict=True)]
        rates = [middle(rounds, name, key) for key in ("states", "targets")]
        yield f"  {name}: {', '.join(rows)}; {rates[0]:.0f} states and {rates[1]:.0f} targets a second"
        yield f"  {name}: owner without a client {middle(idle, name, 'owner'):.0f}"
        aim = " (aim: at most 8)" if name == ours else ""
        most = max(row[name]["threads"] for row in rounds)
        threads = _threads(owners[name], clients[name])
        yield f"  {name}: threads of the owner {threads}{aim}; {most:.0f} while clients come and go"
    shares = ", ".join(f"{key} {ratio(rounds, ours, bare, key):.2f}" for key in ("owner", "client"))
    # A machine that is shared with others is twice as slow in one hour as in the next.
    yield f"  CPU, ratio {ours} / {bare}: {shares}"
    for what, aim in (("state", "at most 1.5"), ("command", "p50 at most 0.6 ms")):
        for name in owners:
            p50, p99 = (middle(rounds, name, f"{what} {key}") for key in ("p50", "p99"))
            yield f"  {what}, p50 / p99 ms: {name} {p50:.3f} / {p99:.3f}"
        p50, p99 = (ratio(rounds, ours, bare, f"{what} {key}") for key in ("p50", "p99"))
        yield f"  {what}, ratio {ours} / {bare}: p50 {p50:.2f}, p99 {p99:.2f} (aim: {aim})"


def _idle(owner: Process, client: Process) -> Block:
    before = owner.ask("cpu")
    client.ask("wait", seconds=_SECONDS)
    after = owner.ask("cpu")
    return {"owner": 1000 * (after["cpu"] - before["cpu"]) / (after["now"] - before["now"])}


def _work(owner: Process, client: Process) -> Block:
    owner.ask("targets")
    before = owner.ask("cpu")
    client.begin("work", seconds=_SECONDS)
    time.sleep(0.8 * _SECONDS)
    # Not at the end, when the client gives the lease back.
    threads = owner.ask("cpu")["threads"]
    work = client.end()
    after = owner.ask("cpu")
    arrived = {_number(value): when for when, value in owner.ask("targets")["targets"]}
    delays = [arrived[_number(value)] - sent for sent, value in work["sent"] if _number(value) in arrived]
    rows = {f"state {key}": value for key, value in quantiles(work["ages"]).items()}
    rows |= {f"command {key}": value for key, value in quantiles(delays).items()}
    return {
        **rows,
        "owner": 1000 * (after["cpu"] - before["cpu"]) / (after["now"] - before["now"]),
        "client": 1000 * work["cpu"] / work["seconds"],
        "threads": threads,
        "states": len(work["ages"]) / work["seconds"],
        "targets": len(arrived) / work["seconds"],
    }


def _threads(owner: Process, client: Process) -> int:
    """Threads of an owner whose client has answered its states for a while."""
    client.begin("work", seconds=_SETTLED + 1.0)
    time.sleep(_SETTLED)
    threads = owner.ask("cpu")["threads"]
    client.end()
    return int(threads)


def _number(target: float) -> int:
    return round(target / fleet_worker.STEP)


if __name__ == "__main__":
    for line in run():
        print(line, flush=True)
