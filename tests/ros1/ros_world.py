"""A ROS master of one's own, and everything that runs under it: nodes, emulated arms, Debian's ROS programs.

Every process is ended with its world, whatever happens, and every wait has a deadline that only a fault meets.
"""

from __future__ import annotations

import contextlib
import gc
import json
import math
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from tests.defaults import default, patient_line
from tests.link.far_ends import free_port
from tests.patient_node import FRESH, REPLY_WINDOW
from tests.waits import PATIENCE, until

from hexwire.control.loop import owner
from hexwire.control.sharing.lease import Lease
from hexwire.emulator.board import EmulatedBoard, make_hex7bot_board
from hexwire.emulator.faults import FaultPlan
from hexwire.emulator.hand import FORCE, Hand
from hexwire.emulator.serve_pty import PtyServer
from hexwire.fleet.service import Service
from hexwire.fleet.service_file import read_arms
from hexwire.model.arms.hex7bot.joints import HEX7BOT

_STALE = re.compile("no state from the robot|no answer from")
"""Why a goal is refused for want of recent states."""
ROS_PYTHON = "/usr/bin/python3"
NODE = (sys.executable, "-m", "tests.patient_node", "ros1")
HEXWIRE = (sys.executable, "-m", "hexwire.cli")
CLIENT = Path(__file__).with_name("ros_client.py")
JOINTS = HEX7BOT.names


class Program:
    """A process whose output goes to files."""

    def __init__(self, command: Sequence[str], env: Mapping[str, str], folder: Path, name: str) -> None:
        self.name = name
        self._files = [folder / f"{name}.out", folder / f"{name}.err"]
        with self._files[0].open("wb") as out, self._files[1].open("wb") as err:
            self.process = subprocess.Popen(
                command, env=env, stdin=subprocess.DEVNULL, stdout=out, stderr=err, start_new_session=True
            )

    @property
    def out(self) -> str:
        return self._files[0].read_text(encoding="utf-8", errors="replace")

    @property
    def err(self) -> str:
        return self._files[1].read_text(encoding="utf-8", errors="replace")

    @property
    def running(self) -> bool:
        return self.process.poll() is None

    def said(self, text: str) -> None:
        """Wait until it has written something."""
        until(lambda: text in self.out + self.err or self._still_runs(text), f"it says {text!r}", self.report)

    def wait(self) -> int:
        """Wait for its end; returns the exit status."""
        try:
            return self.process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            # Python says by this where its threads hang.
            self.process.send_signal(signal.SIGABRT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(5.0)
            raise AssertionError(f"it does not end\n{self.report()}") from None

    def end(self, how: signal.Signals = signal.SIGTERM) -> int:
        """End it; returns the exit status."""
        if self.running:
            self.process.send_signal(how)
        return self.wait()

    def kill_all(self) -> None:
        """End it and what it started, one way or the other."""
        for how, patience in ((signal.SIGTERM, 15.0), (signal.SIGKILL, 15.0)):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.process.pid, how)
            try:
                self.process.wait(patience)
            except subprocess.TimeoutExpired:
                continue
            if how is signal.SIGTERM:
                # What it started may need a moment, or be beyond asking.
                with contextlib.suppress(AssertionError, ProcessLookupError):
                    self._wait_for_group(3.0)
                    return
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)

    def report(self) -> str:
        return f"--- {self.name} (status {self.process.poll()})\n{self.out[-3000:]}{self.err[-3000:]}"

    def _wait_for_group(self, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while True:
            os.killpg(self.process.pid, 0)
            assert time.monotonic() < deadline
            time.sleep(0.02)

    def _still_runs(self, text: str) -> None:
        assert self.running or text in self.out + self.err, f"ended without {text!r}\n{self.report()}"


class Client:
    """A rospy program in a process of its own; a call of any function of `ros_client.py` by its name."""

    def __init__(self, env: Mapping[str, str], folder: Path) -> None:
        self._errors = folder / "client.err"
        with self._errors.open("ab") as errors:
            self.process = subprocess.Popen(
                [ROS_PYTHON, str(CLIENT)],
                env=env,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                start_new_session=True,
            )
        assert self._answer() == "ready"

    def __getattr__(self, name: str) -> Callable[..., Any]:
        def call(**arguments: Any) -> Any:
            assert self.process.stdin is not None
            self.process.stdin.write(json.dumps([name, arguments]) + "\n")
            self.process.stdin.flush()
            return self._answer()

        return call

    def _answer(self) -> Any:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line, f"the client ended\n{self._errors.read_text()[-3000:]}"
        answer = json.loads(line)
        assert "ok" in answer, answer["error"]
        return answer["ok"]

    def close(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            self.process.kill()
        self.process.communicate()


class Programs:
    """Programs that end together.

    Args:
        folder: For their output.
        env: Their environment, besides what this process has.
        dropped: What this process has that they do not get: names begin so.
    """

    def __init__(self, folder: Path, env: Mapping[str, str], dropped: tuple[str, ...]) -> None:
        self.folder, self._programs = folder, list[Program]()
        self.env = {k: v for k, v in os.environ.items() if not k.startswith(dropped)} | dict(env)

    def start(self, *command: str, **env: str) -> Program:
        # Of a program in Python its module, its file, or the end of its text.
        what = command[:3][-1] if command[0] == sys.executable else Path(command[0]).name
        name = f"{len(self._programs):03}{re.sub(r'[^a-z0-9.]+', '-', what[-30:])}"
        program = Program(command, {**self.env, **env}, self.folder, name)
        self._programs.append(program)
        return program

    def report(self) -> str:
        return "\n".join(program.report() for program in self._programs[-6:])

    def end_later_than(self, count: int) -> None:
        """End all but the first so many, the last one first."""
        for program in reversed(self._programs[count:]):
            program.kill_all()

    def close(self) -> None:
        self.end_later_than(0)


class World(Programs):
    """A master on a free loopback port.

    Args:
        folder: For homes, logs and output; a new one.
    """

    def __init__(self, folder: Path) -> None:
        self._client: Client | None = None
        for name in ("home", "log", "tmp", "python"):
            (folder / name).mkdir()
        # Other tests need NumPy here; hexwire does not. With it, loading rospy takes every node twice as long.
        (folder / "python" / "numpy.py").write_text("raise ImportError('not on this robot')\n")
        env = {
            "ROS_IP": "127.0.0.1",
            "ROS_HOME": str(folder / "home"),
            "ROS_LOG_DIR": str(folder / "log"),
            "TMPDIR": str(folder / "tmp"),
            "PYTHONFAULTHANDLER": "1",
            "PYTHONPATH": str(folder / "python"),
            "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        }
        super().__init__(folder, env, ("ROS_", "HEXWIRE_", "PYTHON"))
        self.master = self._start_master()

    def _start_master(self) -> Program:
        for _ in range(5):
            port = free_port()
            self.port = port
            self.env["ROS_MASTER_URI"] = f"http://127.0.0.1:{port}"
            master = self.start_master()
            if master.running:
                return master
        raise AssertionError(f"no master would start\n{master.report()}")

    def start_master(self) -> Program:
        """Start a master at the world's port; one that has ended is not there if somebody else has the port."""
        master = self.start("rosmaster", "--core", "-p", str(self.port))

        def online() -> bool:
            with socket.socket() as probe:
                probe.settimeout(1.0)
                return not master.running or probe.connect_ex(("127.0.0.1", self.port)) == 0

        until(online, "the master answers", master.report)
        return master

    @property
    def client(self) -> Client:
        """The one for all; started when it is needed."""
        if self._client is None:
            self._client = Client(self.env, self.folder)
        return self._client

    def drop_client(self) -> None:
        """The next one is new."""
        if self._client is not None:
            self._client.close()
        self._client = None

    def run(self, *command: str, status: int | None = 0, **env: str) -> Program:
        """Run a program to its end, which must have this status if one is given."""
        program = self.start(*command, **env)
        ended = program.wait()
        assert status is None or ended == status, self.report()
        return program

    def node(self, *args: str, ready: bool = True, **env: str) -> Program:
        """The node under test; arguments are remappings."""
        program = self.start(*NODE, *args, **env)
        if ready:
            program.said("is ready at")
        return program

    def board(self, link: Path, *options: str) -> Program:
        """An emulated Hex7Bot in a process of its own."""
        return self.sim("board", "--baud", "0", "--link", str(link), *options)

    def sim(self, *options: str) -> Program:
        program = self.start(*HEXWIRE, "sim", *options)
        until(lambda: program.out.endswith("\n") or not program.running, "it is served", program.report)
        assert program.running, program.report()
        return program

    def close(self) -> None:
        self.drop_client()
        super().close()


@contextlib.contextmanager
def shared_board(world: Programs) -> Iterator[PtyBoard]:
    """A board that this process shares as `lab/arm1`, with the programs of a world and with nobody else.

    A program that a busy machine lets wait is not one that is late or gone.
    """
    folder = world.folder / "run"
    folder.mkdir(mode=0o700, exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        for name in ("XDG_RUNTIME_DIR", "XDG_STATE_HOME"):
            patch.setenv(name, str(folder))
            world.env[name] = str(folder)
        default(patch, Lease, max_age=5.0)
        patient_line(patch, REPLY_WINDOW)
        patch.setattr(owner, "_FRESH", FRESH)
        board = PtyBoard(world.folder / "shared-arm")
        try:
            with Service(read_arms({"lab/arm1": {"port": board.port, "watchdog": 5.0, "lease": 5.0}})):
                yield board
        finally:
            board.close()


class PtyBoard:
    """An emulated Hex7Bot on a pseudo-terminal of this process: its servos can be looked at, and given faults.

    Args:
        link: Name of the port, which stays.
        dialect: What it speaks.
    """

    def __init__(self, link: Path, dialect: int = 2) -> None:
        self.port = str(link)
        self.board: EmulatedBoard = make_hex7bot_board(dialect=dialect, baud=0, start=time.monotonic())
        # Collecting the garbage of thousands of tests stops every thread for longer than a board may be silent.
        gc.collect()
        gc.freeze()
        self.plug()

    def plug(self) -> None:
        """Plug it in; it goes on where it was."""
        self._server = PtyServer(self.board, link=self.port)
        self._server.open()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="board")
        self._thread.start()

    def unplug(self) -> None:
        """Take the port away; the board lives on its own supply."""
        self._ending.set()
        self._thread.join()
        self._server.close()

    def _serve(self) -> None:
        while not self._ending.is_set():
            self._server.run_once(0.05)

    def faults(self, *specs: str) -> None:
        """Faults from now on, in place of those before."""
        self.board.faults = self.board.wire.faults = FaultPlan(specs, start=time.monotonic())

    def lead(self, joint: str, angle: float, seconds: float, hold: float = 0.0) -> None:
        """Lead a joint without torque by hand, so many radians in so many seconds, and hold it there for some more.

        In the emulator's time: if that stalls, the states must not show a jump.
        """
        model = HEX7BOT.joint(joint)
        servo = next(servo for servo in self.board.wire.servos if servo.servo_id == model.servo_id)
        hand = Hand(servo.motion, model.sign * angle / model.scale, seconds, hold, FORCE)
        until(lambda: hand.has_let_go, "the hand lets go")

    @property
    def positions(self) -> dict[str, float]:
        """Where the servos really are, radians."""
        servos = {servo.servo_id: servo for servo in self.board.wire.servos}
        return {
            joint.name: joint.counts_to_angle(servos[joint.servo_id].present_position) for joint in HEX7BOT.joints
        }

    close = unplug


class Arm:
    """A node and what a client does with it.

    Args:
        world: Its master.
        node: Running.
        namespace: Where its names are, with a slash at the end.
        board: Behind it, if that is in this process.
        name: Of the node.
        patience: Seconds that the end of a goal is waited for.
    """

    def __init__(
        self,
        world: World,
        node: Program,
        namespace: str = "/",
        board: PtyBoard | None = None,
        name: str = "hardware_interface",
        patience: float = PATIENCE,
    ) -> None:
        self.world, self.node, self.namespace, self.name = world, node, namespace, name
        self.patience = patience
        self._board = board

    @property
    def board(self) -> PtyBoard:
        assert self._board is not None
        return self._board

    @property
    def client(self) -> Client:
        return self.world.client

    def service(self, name: str) -> str:
        return f"{self.namespace}{self.name}/{name}"

    def trigger(self, name: str) -> str:
        """Call a service that must succeed."""
        success, text = self.client.trigger(service=self.service(name))
        assert success, text
        return str(text)

    def refused(self, name: str) -> str:
        """Call a service that must not succeed."""
        success, text = self.client.trigger(service=self.service(name))
        assert not success, text
        return str(text)

    def enable(self, on: bool = True) -> None:
        success, text = self.client.switch(service=self.service("enable"), on=on)
        assert success, text

    def send(
        self, key: str, targets: Mapping[str, float], seconds: float, controller: str = "", **more: Any
    ) -> None:
        """Send a goal that takes the joints named to angles, and leaves the others."""
        names = more.pop("names", list(targets))
        points = more.pop("points", [{"t": seconds, "positions": list(targets.values())}])
        action = f"{self.namespace}{controller}follow_joint_trajectory"
        self.client.send(key=key, action=action, names=names, points=points, **more)

    def result(self, key: str) -> dict[str, Any]:
        result: dict[str, Any] = self.client.result(key=key, patience=self.patience)
        return result

    def succeeded(self, key: str) -> None:
        """Wait for the end of a goal, which must have reached its target."""
        result = self.result(key)
        assert result["state"] == "SUCCEEDED", f"{key}: {result['text']}\n{self.world.report()}"

    def moves(self, key: str, targets: Mapping[str, float], seconds: float, *args: Any, **more: Any) -> None:
        """Send a goal that must succeed.

        An arm whose states are a second old refuses goals, as it must, and a busy machine may let its program or
        its node wait for that long: then send the goal again.
        """

        def tried() -> bool:
            self.send(key, targets, seconds, *args, **more)
            result = self.result(key)
            return not (result["state"] == "REJECTED" and _STALE.search(result["text"]))

        until(tried, f"the arm takes the goal {key}", self.world.report)
        self.succeeded(key)

    def position(self) -> dict[str, float]:
        """As it is published."""
        position: dict[str, float] = self.client.position(topic=f"{self.namespace}joint_states")
        return position

    def diagnostics(self) -> dict[str, dict[str, Any]]:
        """Of this node, by the name without the node's."""
        own = f"{self.namespace}{self.name}: ".lstrip("/")

        def rows() -> dict[str, dict[str, Any]] | None:
            (message,) = self.client.collect(topic="/diagnostics", kind="diagnostic_msgs/DiagnosticArray")
            found = {row["name"].removeprefix(own): row for row in message["status"] if row["name"].startswith(own)}
            return found or None

        return until(rows, "diagnostics come", self.node.report)

    def diagnosed(self, part: str, level: int, text: str = "") -> dict[str, Any]:
        """Wait for a row of a level with a text in its message."""

        def row() -> dict[str, Any] | None:
            found = self.diagnostics().get(part)
            return found if found and found["level"] == level and text in found["message"] else None

        return until(row, f"{part} is at level {level} for {text!r}", self.node.report)

    def logged(self, text: str) -> None:
        self.node.said(text)


def still(read: Callable[[], Mapping[str, float]], tolerance: float = 0.003) -> dict[str, float]:
    """Wait until nothing moves any more; returns where it is."""
    last = dict(read())

    def settled() -> bool:
        nonlocal last
        time.sleep(0.3)
        now = dict(read())
        same = all(abs(now[name] - last[name]) <= tolerance for name in now)
        last = now
        return same

    until(settled, "the arm stands")
    return last


def near(a: Mapping[str, float], b: Mapping[str, float], tolerance: float = 0.03) -> bool:
    """Whether joints of both are at the same angles."""
    return all(math.isclose(a[name], b[name], abs_tol=tolerance) for name in a.keys() & b.keys())


@contextlib.contextmanager
def made(folder: Path) -> Iterator[World]:
    world = World(folder)
    try:
        yield world
    finally:
        world.close()
