"""The servo bus beside its peers on one emulated bus written in C: time and CPU a call, faults, echo, a mute servo.

The peers take turns, forwards and backwards, so that no stall and no drift of the machine favours one. Without
a line rate a figure is the best of the rounds, and peer and emulator share one CPU while the other is kept busy: a
wake-up across CPUs would cost more than any peer does. At a line rate, where a peer mostly waits and its best round
is a matter of luck, a figure is the median of many short rounds, and a share that of the shares in each round. The
ratios to a bare loop are given by the median call, too: a rate is a mean, which a stall of the machine changes.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import bus_peers  # noqa: E402

FLOOR = "C write+read"
_ROUNDS = 3
_PACED_ROUNDS = 12
_PACED_TIME = 0.4
"""Seconds of calls in each of them."""
_OPS = ("read", "sync_read", "sync_write", "cycle")
_BARE = ("bare Python", "bare with time-out")
_FAULTS = ("drop", "flip", "junk", "short")


def run() -> list[str]:
    """Measure; returns the lines to print."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        return ["no C compiler here: sudo apt-get install gcc libc6-dev"]
    with tempfile.TemporaryDirectory() as folder:
        emulator = str(Path(folder) / "busemu")
        subprocess.run([compiler, "-O2", "-o", emulator, str(HERE / "busemu.c"), "-lutil", "-lpthread"], check=True)
        peers = bus_peers.installed()
        absent = [peer for peer in bus_peers.PEERS if peer not in peers]
        lines = [f"peers not installed here: {', '.join(absent)}"] if absent else []
        lines += _unpaced(emulator, peers)
        for baud in (1_000_000, 115_200):
            lines += _paced(emulator, peers, baud)
        # A lost answer ends the bare loop, which has no time-out, and puts the other one out of step.
        patient = [peer for peer in peers if peer not in _BARE]
        lines += _faulty(emulator, patient)
        lines += _mute(emulator, patient)
        lines += _echo(emulator, peers)
        return lines


# --- scenarios -------------------------------------------------------------------------------------------------


def _unpaced(emulator: str, peers: list[str]) -> list[str]:
    lines = ["no line rate, p50 us / CPU us a call (ratio of p50 to hexwire's)"]
    best: dict[str, dict[str, dict[str, float]]] = {}
    with _served(emulator, "--cpu", "0") as path, _spinner():
        for turn in range(_ROUNDS):
            for op in _OPS:
                for peer in _in_turn([FLOOR, *peers], turn):
                    result = _measure(emulator, peer, path, 0, op, 4000, "0")
                    _keep(best.setdefault(op, {}), peer, result, "p50")
    for op in _OPS:
        ours = best[op]["hexwire"]["p50"]
        cells = [f"{p} {r['p50']:.1f}/{r['cpu']:.1f} ({r['p50'] / ours:.2f})" for p, r in best[op].items()]
        lines.append(f"  {op}: {', '.join(cells)}")
    lines.append(_aims(best))
    return lines


def _aims(best: dict[str, dict[str, dict[str, float]]]) -> str:
    parts = []
    for op, peer in (
        ("sync_read", "rustypot"),
        ("sync_read", "lerobot"),
        ("read", "rustypot"),
        ("sync_read", "bare Python"),
        ("read", "bare Python"),
    ):
        if peer in best[op]:
            ratio = best[op]["hexwire"]["p50"] / best[op][peer]["p50"]
            parts.append(f"{op} hexwire/{peer} {ratio:.2f}")
    return f"  ratios: {', '.join(parts)}"


def _paced(emulator: str, peers: list[str], baud: int) -> list[str]:
    lines = [f"paced at {baud} baud, calls a second (share of the C floor) and CPU of one core, medians"]
    for op in ("sync_read", "cycle"):
        # A call is 71 bytes on the wire, and a cycle 100.
        count = round(_PACED_TIME * baud / (1000 if op == "cycle" else 710))
        rounds: list[dict[str, dict[str, float]]] = []
        with _served(emulator, "--baud", str(baud)) as path:
            for turn in range(_PACED_ROUNDS):
                found = {
                    p: _measure(emulator, p, path, baud, op, count, "-") for p in _in_turn([FLOOR, *peers], turn)
                }
                rounds.append({peer: result for peer, result in found.items() if result is not None})
        cells = [_paced_cell(rounds, peer) for peer in [FLOOR, *peers] if all(peer in row for row in rounds)]
        lines.append(f"  {op}: {'; '.join(cells)}")
        ratios = [
            f"hexwire/{bare} {_share(rounds, 'hexwire', bare):.3f}, {_share_by_call(rounds, 'hexwire', bare):.4f}"
            for bare in _BARE
        ]
        lines.append(f"    ratios by rate and by the median call: {'; '.join(ratios)}")
    return lines


def _paced_cell(rounds: list[dict[str, dict[str, float]]], peer: str) -> str:
    rate = median(row[peer]["rate"] for row in rounds)
    cpu = median(row[peer]["cpu"] / row[peer]["mean"] for row in rounds)
    return f"{peer} {rate:.0f} ({_share(rounds, peer, FLOOR):.3f}), {cpu:.1%}"


def _share(rounds: list[dict[str, dict[str, float]]], peer: str, other: str) -> float:
    """Median over the rounds of one peer's rate as a share of another's in the same round."""
    return median(row[peer]["rate"] / row[other]["rate"] for row in rounds)


def _share_by_call(rounds: list[dict[str, dict[str, float]]], peer: str, other: str) -> float:
    """The same of the rates at which the median call of each could be repeated."""
    return median(row[other]["p50"] / row[peer]["p50"] for row in rounds)


def _in_turn(peers: list[str], turn: int) -> list[str]:
    """Order of the peers in a round: each begins once, and every second round runs backwards."""
    first = turn // 2 % len(peers)
    order = peers[first:] + peers[:first]
    return order[::-1] if turn % 2 else order


def _faulty(emulator: str, peers: list[str]) -> list[str]:
    lines = []
    for baud in (0, 1_000_000):
        rate = f"at {baud} baud" if baud else "without a line rate"
        lines.append(f"1 % of the answers at fault, sync_read of seven {rate}")
        for kind in _FAULTS:
            cells = []
            for peer in peers:
                with _served(emulator, "--fault", f"{kind}:0.01", "--baud", str(baud)) as path:
                    cells.append(_outcome(peer, _measure(emulator, peer, path, baud, "sync_read", 3000, "-")))
            lines.append(f"  {kind}: {'; '.join(cells)}")
    return lines


def _mute(emulator: str, peers: list[str]) -> list[str]:
    lines = ["servo 4 of seven mute, sync_read"]
    for peer in peers:
        with _served(emulator, "--mute", "4", "--baud", "1000000") as path:
            lines.append(f"  {_outcome(peer, _measure(emulator, peer, path, 1_000_000, 'sync_read', 1000, '-'))}")
    return lines


def _echo(emulator: str, peers: list[str]) -> list[str]:
    lines = ["an adapter that echoes from the start, and from request 500 on"]
    for after in ("0", "500"):
        for op in ("read", "sync_read"):
            cells = []
            for peer in peers:
                with _served(emulator, "--echo", after) as path:
                    cells.append(_outcome(peer, _measure(emulator, peer, path, 0, op, 1500, "-")))
            lines.append(f"  after {after}, {op}: {'; '.join(cells)}")
    return lines


def _outcome(peer: str, result: dict[str, float] | None) -> str:
    if result is None:
        return f"{peer} cannot connect"
    n = result["calls"]
    return (
        f"{peer} whole {result['whole'] / n:.1%}, partial {result['partial'] / n:.1%}, "
        f"raised {result['raised'] / n:.1%}, wrong values {result['wrong']:.0f}, "
        f"p99 {result['p99'] / 1000:.2f} ms, {result['rate']:.0f}/s"
    )


# --- running one peer ------------------------------------------------------------------------------------------


def _measure(
    emulator: str, peer: str, path: str, baud: int, op: str, count: int, cpu: str
) -> dict[str, float] | None:
    if peer == FLOOR:
        command = [emulator, "client", path, op, str(count), *(("--cpu", cpu) if cpu != "-" else ())]
        text = subprocess.run(command, check=True, capture_output=True, text=True, timeout=60).stdout
        return dict(zip(("p50", "p99", "mean", "cpu", "rate"), map(float, text.split()), strict=True))
    worker = [sys.executable, str(HERE / "bus_peers.py"), peer, path, str(baud), op, str(count), cpu]
    result = subprocess.run(worker, capture_output=True, text=True, timeout=60)
    return None if result.returncode else json.loads(result.stdout)


def _keep(best: dict[str, dict[str, float]], peer: str, result: dict[str, float] | None, key: str) -> None:
    if result is not None and (peer not in best or result[key] < best[peer][key]):
        best[peer] = result


@contextmanager
def _served(emulator: str, *options: str) -> Iterator[str]:
    command = [emulator, "serve", *options]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            yield process.stdout.readline().strip()
        finally:
            process.stdin.close()
            process.wait(timeout=5)


@contextmanager
def _spinner() -> Iterator[None]:
    """Keep the second CPU awake, where there is one."""
    if (os.cpu_count() or 1) < 2:
        yield
        return
    program = "import os, sys\nos.sched_setaffinity(0, {1})\nwhile os.getppid() != 1: pass"
    with subprocess.Popen([sys.executable, "-c", program]) as process:
        try:
            yield
        finally:
            process.kill()


if __name__ == "__main__":
    print("\n".join(run()))
