"""The ROS 2 node beside the ROS 1 node: jitter, a goal's way to the servos, processor time; and services.

Both nodes run at the same time, each with an emulated board of its own, and are measured by turns. Everything is
real: master, router, nodes, clients and boards are processes. Beside it stands what rospy and Zenoh do alone.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from bisect import bisect_left
from collections.abc import Callable
from contextlib import ExitStack
from itertools import pairwise
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench.board import board, cpu_ns, memory
from tests.bench.goal_start import goal_starts
from tests.link.far_ends import free_port
from tests.ros1.ros_world import ROS_PYTHON, Program, World, made

_ROS1 = Path(__file__).with_name("ros1_client.py")
_ROS2 = Path(__file__).with_name("ros2_client.py")
_NODE = (sys.executable, "-m", "hexwire.cli.ros2", "--ros-args")
_STATES = "0/joint_states/**"
_ROUNDS = 4
_LISTEN = 4.0
_SPARE = 0.5
"""Seconds for which the ROS 1 listener goes on: it must still read while the processor time is taken."""
_SKIPPED = 20
"""First messages, while the connection is new."""
_GOALS = 15
_STARTS = 40
_CALLS = 100
_WAIT = 0.005
_PERIOD = 0.01
Rows = list[list[float]]


class Worker:
    """A process of `ros2_client.py`."""

    def __init__(self, stack: ExitStack, role: str, endpoint: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, str(_ROS2), role, endpoint], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        stack.callback(self._end)
        self._line()

    def ask(self, what: str, **options: object) -> Any:
        """Have it do something; returns what it says."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps({"what": what, **options}) + "\n")
        self._process.stdin.flush()
        return json.loads(self._line())

    def _line(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"the worker ended with status {self._process.wait(10.0)}")
        return line

    def _end(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def run() -> list[str]:
    """Figures of both nodes from the same run."""
    if not Path("/usr/bin/rosmaster").exists():
        return ["left out: ROS 1 is not installed (`make test` installs it)"]
    load = os.getloadavg()[0]
    starts = [_start_line(what, timed) for what, timed in (("path on the board", False), ("targets", True))]
    with ExitStack() as stack:
        world = stack.enter_context(made(Path(stack.enter_context(tempfile.TemporaryDirectory()))))
        (path1, moves1), (path2, moves2) = (stack.enter_context(board()) for _ in range(2))
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        Worker(stack, "router", endpoint)
        node1 = world.node(f"_port:={path1}")
        node2 = world.start(
            *_NODE, "-p", f"port:='{path2}'", ZENOH_CONFIG_OVERRIDE=f'connect/endpoints=["{endpoint}"]'
        )
        node2.said("is ready at")
        client = Worker(stack, "client", endpoint)
        states = [_both(world, client, node1, node2) for _ in range(_ROUNDS)]
        sizes = memory(node1.process.pid), memory(node2.process.pid)
        world.run("rosservice", "call", "/hardware_interface/enable", "true")
        client.ask("enable")
        turns = [_goals(world, client, moves1, moves2) for _ in range(_ROUNDS)]
        late = [late for one, _ in turns for late in one], [late for _, two in turns for late in two]
        bare = world.start(ROS_PYTHON, str(_ROS1), "publish", "bare", "100")
        Worker(stack, "bare", endpoint)
        bare1, bare2 = (
            _ask(world, "listen", "bare", str(_LISTEN)),
            client.ask("listen", key="bench/states", seconds=_LISTEN),
        )
        bare.end()
        calls1 = _ask(world, "services", str(_ROUNDS * _CALLS))
        node1.end()
        calls2 = [client.ask("services", count=_CALLS, wait=_WAIT) for _ in range(_ROUNDS)]
    lines = _lines(states, sizes, late, (bare1, bare2), calls1, calls2)
    return [f"load of the machine before: {load:.2f}", *starts, *lines]


def _start_line(what: str, host_timed: bool) -> str:
    ours, waiting = (goal_starts(_STARTS, at_once=how, host_timed=host_timed) for how in (True, False))
    rows = [", ".join(f"{1e3 * _quantile(times, share):.2f}" for share in (0.5, 0.9)) for times in (ours, waiting)]
    return f"goal accepted to its first byte ({what}), ms p50, p90: {rows[0]}; if it waits for a state {rows[1]}"


def _lines(
    states: list[list[tuple[Rows, float]]],
    sizes: tuple[float, float],
    late: tuple[list[float], list[float]],
    bare: tuple[Rows, Rows],
    calls1: list[float],
    calls2: list[dict[str, list[float]]],
) -> list[str]:
    one, two = ([gap for turn in states for gap in _off(turn[i][0])] for i in range(2))
    bares = [_off(rows) for rows in bare]
    lines = []
    for what, share in (("p50", 0.5), ("p99", 0.99)):
        ours, theirs = _quantile(two, share), _quantile(one, share)
        lines.append(
            f"joint_states at 100 Hz, {what} off the period: {1e3 * ours:.3f} ms, ROS 1 {1e3 * theirs:.3f} ms, "
            f"ratio {ours / theirs:.2f}; bare Zenoh {1e3 * _quantile(bares[1], share):.3f} ms, "
            f"bare rospy {1e3 * _quantile(bares[0], share):.3f} ms"
        )
    rates = [
        statistics.median((len(rows) - 1) / (rows[-1][0] - rows[0][0]) for rows, _ in (turn[i] for turn in states))
        for i in range(2)
    ]
    lines.append(f"rate: {rates[1]:.2f} Hz, ROS 1 {rates[0]:.2f} Hz")
    middle = [statistics.median(times) for times in late]
    lines.append(
        f"goal to first servo byte: median {1e3 * middle[1]:.1f} ms, worst {1e3 * max(late[1]):.1f} ms, ROS 1 "
        f"{1e3 * middle[0]:.1f} and {1e3 * max(late[0]):.1f} ms; ratio {middle[1] / middle[0]:.2f} of medians"
    )
    shares = [[turn[i][1] for turn in states] for i in range(2)]
    ratio = statistics.median(b / a for a, b in zip(*shares, strict=True))
    lines.append(
        f"processor: {statistics.median(shares[1]):.1%} of a core, ROS 1 {statistics.median(shares[0]):.1%}; "
        f"ratio {ratio:.2f}, aim at most 1"
    )
    lines.append(f"memory: {sizes[1]:.0f} MB, ROS 1 {sizes[0]:.0f} MB; ratio {sizes[1] / sizes[0]:.2f}")
    for what, share in (("p50", 0.5), ("p99", 0.99)):
        blocks = [[_quantile(row[name], share) for name in ("service", "bare")] for row in calls2]
        ours, theirs = (statistics.median(block[i] for block in blocks) for i in range(2))
        ratio = statistics.median(one / other for one, other in blocks)
        lines.append(
            f"service query_state, {what}: {1e3 * ours:.3f} ms, bare Zenoh query {1e3 * theirs:.3f} ms, ratio "
            f"{ratio:.2f}{', aim at most 1.5' if what == 'p50' else ''}; "
            f"ROS 1 {1e3 * _quantile(calls1, share):.3f} ms"
        )
    return lines


def _both(world: World, client: Worker, node1: Program, node2: Program) -> list[tuple[Rows, float]]:
    """Messages of both nodes, and which share of a core each takes while one program reads them."""
    listener = world.start(ROS_PYTHON, str(_ROS1), "listen", "joint_states", str(_LISTEN + _SPARE))
    listener.said("messages come")
    one = _share(node1, lambda: time.sleep(_LISTEN))
    assert listener.wait() == 0, listener.report()
    rows1: Rows = json.loads(listener.out)
    rows2: Rows = []
    two = _share(node2, lambda: rows2.extend(client.ask("listen", key=_STATES, seconds=_LISTEN)))
    return [(rows1[_SKIPPED:], one), (rows2[_SKIPPED:], two)]


def _share(node: Program, wait: Callable[[], object]) -> float:
    before, begin = cpu_ns(node.process.pid), time.monotonic()
    wait()
    return 1e-9 * (cpu_ns(node.process.pid) - before) / (time.monotonic() - begin)


def _goals(world: World, client: Worker, moves1: Connection, moves2: Connection) -> tuple[list[float], list[float]]:
    """Seconds from each goal to the first byte that moves a servo."""
    sent1 = _ask(world, "goals", str(_GOALS))
    try:
        sent2 = client.ask("goals", count=_GOALS)
    except RuntimeError as error:
        # The node says why it refused a goal.
        raise RuntimeError(f"{error}\n{world.report()[-2000:]}") from error
    late = []
    for sent, moves in ((sent1, moves1), (sent2, moves2)):
        moves.send(None)
        moved = moves.recv()
        late.append([moved[i] - goal for goal in sent if (i := bisect_left(moved, goal)) < len(moved)])
    return late[0], late[1]


def _ask(world: World, *args: str) -> list:
    """What the far side of ROS 1 says at its end."""
    return json.loads(world.run(ROS_PYTHON, str(_ROS1), *args).out)


def _off(rows: Rows) -> list[float]:
    """How far each gap between arrivals is from the period, seconds."""
    return [abs(b[0] - a[0] - _PERIOD) for a, b in pairwise(rows)]


def _quantile(values: list[float], share: float) -> float:
    rows = sorted(values)
    return rows[min(len(rows) - 1, int(share * len(rows)))]
