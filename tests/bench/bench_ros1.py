"""The ROS 1 node beside a bare rospy publisher: rate, jitter, processor time, memory; a goal's way to the servos.

Everything is real: a master, the node, its clients and an emulated board behind a pseudo-terminal, each in a
process of its own. The monotonic clock is the same in all of them, also for the moment of a servo's first byte.
"""

from __future__ import annotations

import json
import statistics
import sys
import tempfile
import time
from bisect import bisect_left
from itertools import pairwise
from multiprocessing.connection import Connection
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench.board import board, cpu, memory
from tests.ros1.ros_world import ROS_PYTHON, Program, World, made

_CLIENT = Path(__file__).with_name("ros1_client.py")
_LISTEN = 6.0
_GOALS = 20
_ONE_WAYS = 60


def run() -> list[str]:
    """Figures of the node, each beside that of a bare publisher in the same run."""
    if not Path("/usr/bin/rosmaster").exists():
        return ["left out: ROS 1 is not installed (`make test` installs it)"]
    with tempfile.TemporaryDirectory() as folder, made(Path(folder)) as world, board() as (path, moves):
        node = world.node(f"_port:={path}")
        ours, our_cpu, our_memory = _watch(world, "joint_states", node)
        sent, moved = _goals(world, moves)
        one_way = _one_way(world)
        bare = world.start(ROS_PYTHON, str(_CLIENT), "publish", "bare", "100")
        theirs, bare_cpu, bare_memory = _watch(world, "bare", bare)
    late = []
    for goal in sent:
        i = bisect_left(moved, goal)
        if i < len(moved):
            late.append(moved[i] - goal)
    way, usual = statistics.median(one_way), statistics.median(late)
    return [
        _rate("joint_states, 100 Hz wanted", ours),
        _rate("bare rospy publisher", theirs),
        f"jitter / bare: {_jitter(ours) / _jitter(theirs):.2f}",
        f"goal to first servo byte: median {1e3 * usual:.1f} ms, worst {1e3 * max(late):.1f} ms of {len(late)}",
        f"one way of a bare topic: median {1e3 * way:.2f} ms, ratio {usual / way:.0f}",
        f"processor: {our_cpu:.1%} of a core, bare {bare_cpu:.1%}, ratio {our_cpu / bare_cpu:.1f}",
        f"memory: {our_memory:.0f} MB, bare {bare_memory:.0f} MB, ratio {our_memory / bare_memory:.2f}",
    ]


def _rate(what: str, rows: list[list[float]]) -> str:
    arrivals = [row[0] for row in rows]
    stamps = [row[1] for row in rows]
    gaps = [b - a for a, b in pairwise(stamps)]
    rate = (len(arrivals) - 1) / (arrivals[-1] - arrivals[0])
    return (
        f"{what}: {rate:.2f} Hz, {1e3 * _jitter(rows):.2f} ms standard deviation between arrivals, "
        f"{1e3 * statistics.pstdev(gaps):.2f} ms between stamps"
    )


def _jitter(rows: list[list[float]]) -> float:
    arrivals = [row[0] for row in rows]
    return statistics.pstdev([b - a for a, b in pairwise(arrivals)])


def _ask(world: World, *args: str) -> list:
    """What the far side says at its end."""
    return json.loads(world.run(ROS_PYTHON, str(_CLIENT), *args).out)


def _watch(world: World, topic: str, program: Program) -> tuple[list[list[float]], float, float]:
    """Messages of a topic, and what the process that publishes them takes meanwhile: share of a core, MB."""
    pid = program.process.pid
    before, begin = cpu(pid), time.monotonic()
    rows = _ask(world, "listen", topic, str(_LISTEN))
    share = (cpu(pid) - before) / (time.monotonic() - begin)
    # The connection takes its time.
    return rows[20:], share, memory(pid)


def _goals(world: World, moves: Connection) -> tuple[list[float], list[float]]:
    """When goals were sent, and when bytes went to servos that move them."""
    world.run("rosservice", "call", "/hardware_interface/enable", "true")
    sent = _ask(world, "goals", str(_GOALS))
    moves.send(None)
    return sent, moves.recv()


def _one_way(world: World) -> list[float]:
    """Seconds from publishing to the callback in another process."""
    far = world.start(ROS_PYTHON, str(_CLIENT), "echo", "there")
    far.said("ready")
    world.run(ROS_PYTHON, str(_CLIENT), "send", "there", str(_ONE_WAYS))
    far.end()
    rows = [json.loads(line) for line in far.out.splitlines()[1:]]
    return [came - went for went, came in rows]
