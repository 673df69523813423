"""The ROS 1 node beside a bare rospy publisher: rate, jitter, processor time, memory; a goal's way to the servos.

Everything is real: a master, the node, its clients and an emulated board behind a pseudo-terminal, each in a
process of its own. The monotonic clock is the same in all of them, also for the moment of a servo's first byte.
"""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from bisect import bisect_left
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import pairwise
from multiprocessing.connection import Connection
from pathlib import Path

from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.serve import PtyServer

_SYSTEM_PYTHON = "/usr/bin/python3"
_CLIENT = Path(__file__).with_name("ros1_client.py")
_LISTEN = 6.0
_GOALS = 20
_ONE_WAYS = 60
_PATIENCE = 30.0
_WRITES = (0x03, 0x83)
"""Instructions of a servo packet that move a servo: write and sync write."""
_TICKS = os.sysconf("SC_CLK_TCK")


def run() -> list[str]:
    """Figures of the node, each beside that of a bare publisher in the same run."""
    if not Path("/usr/bin/rosmaster").exists():
        return ["left out: ROS 1 is not installed (`make test` installs it)"]
    with _world() as world:
        ours, our_cpu, our_memory = world.watch("joint_states", world.node)
        sent, moved = world.goals()
        one_way = world.one_way()
        with world.client("publish", "bare", "100") as bare:
            theirs, bare_cpu, bare_memory = world.watch("bare", bare)
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


class _World:
    """A master, a board and a node."""

    def __init__(self, environment: dict[str, str], node: subprocess.Popen[str], moves: Connection) -> None:
        self.node = node
        self._environment = environment
        self._moves = moves

    @contextmanager
    def client(self, *args: str) -> Iterator[subprocess.Popen[str]]:
        """The far side with these arguments."""
        command = [_SYSTEM_PYTHON, str(_CLIENT), *args]
        process = subprocess.Popen(command, env=self._environment, stdout=subprocess.PIPE, text=True)
        try:
            yield process
        finally:
            _end(process)

    def ask(self, *args: str) -> list:
        """What the far side says at its end."""
        with self.client(*args) as process:
            said, _ = process.communicate(timeout=_PATIENCE + _LISTEN)
        if process.returncode:
            raise RuntimeError(f"{args[0]} ended with {process.returncode}")
        return json.loads(said)

    def watch(self, topic: str, process: subprocess.Popen[str]) -> tuple[list[list[float]], float, float]:
        """Messages of a topic, and what the process that publishes them takes meanwhile: share of a core, MB."""
        before, begin = _cpu(process.pid), time.monotonic()
        rows = self.ask("listen", topic, str(_LISTEN))
        share = (_cpu(process.pid) - before) / (time.monotonic() - begin)
        # The connection takes its time.
        return rows[20:], share, _memory(process.pid)

    def goals(self) -> tuple[list[float], list[float]]:
        """When goals were sent, and when bytes went to servos that move them."""
        call = ["rosservice", "call", "/hardware_interface/enable", "true"]
        subprocess.run(call, env=self._environment, check=True, capture_output=True, timeout=_PATIENCE)
        sent = self.ask("goals", str(_GOALS))
        self._moves.send(None)
        return sent, self._moves.recv()

    def one_way(self) -> list[float]:
        """Seconds from publishing to the callback in another process."""
        with self.client("echo", "there") as far:
            assert far.stdout is not None
            far.stdout.readline()
            with self.client("send", "there", str(_ONE_WAYS)) as near:
                near.wait(_PATIENCE)
            rows = [json.loads(far.stdout.readline()) for _ in range(_ONE_WAYS // 2)]
        return [came - went for went, came in rows]


@contextmanager
def _world() -> Iterator[_World]:
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        port = _free_port()
        environment = {
            **{key: value for key, value in os.environ.items() if key != "ROS_HOSTNAME"},
            "ROS_MASTER_URI": f"http://127.0.0.1:{port}",
            "ROS_IP": "127.0.0.1",
            "ROS_HOME": str(folder),
            "TMPDIR": str(folder),
        }
        stack.enter_context(_process(["rosmaster", "--core", "-p", str(port)], environment))
        path, moves = stack.enter_context(_board())
        node = stack.enter_context(
            _process([sys.executable, "-P", "-m", "hexwire.cli.ros1", f"_port:={path}"], environment)
        )
        world = _World(environment, node, moves)
        deadline = time.monotonic() + _PATIENCE
        while "/hardware_interface/stop" not in _services(environment):
            if node.poll() is not None or time.monotonic() > deadline:
                raise RuntimeError("the node did not start")
            time.sleep(0.2)
        yield world


@contextmanager
def _board() -> Iterator[tuple[str, Connection]]:
    """An emulated board on an unpaced line, in a process of its own so that nothing here holds it up.

    Yields its terminal, and whom to ask when bytes went out that move a servo.
    """
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs,), daemon=True)
    process.start()
    try:
        yield ours.recv(), ours
    finally:
        process.terminate()
        process.join()


def _serve(parent: Connection) -> None:
    board = make_hex7bot_board(baud=0, start=time.monotonic())
    plain = board.wire.transact
    moved: list[float] = []

    def transact(packet: bytes, now: float) -> tuple[bytes, float]:
        if len(packet) > 4 and packet[4] in _WRITES:
            moved.append(time.monotonic())
        return plain(packet, now)

    board.wire.transact = transact  # type: ignore[method-assign]
    with PtyServer(board, baud=0) as server:
        parent.send(server.path)
        while True:
            server.run_once()
            # Not as they come: a pipe that is full would hold the board up.
            if parent.poll():
                parent.recv()
                parent.send(moved)


@contextmanager
def _process(command: list[str], environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, text=True)
    try:
        yield process
    finally:
        _end(process)


def _end(process: subprocess.Popen[str]) -> None:
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(5.0)
            return
        process.kill()
        process.wait()


def _services(environment: dict[str, str]) -> str:
    return subprocess.run(["rosservice", "list"], env=environment, capture_output=True, text=True).stdout


def _free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


def _cpu(pid: int) -> float:
    """Seconds of processor time that a process has had."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


def _memory(pid: int) -> float:
    """Resident memory, MB."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) / 1000
    return 0.0
