"""A program that moves an arm is killed or stopped in the middle of it: the board stops the arm within a second."""

from __future__ import annotations

import itertools
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
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.beside import beside
from tests.cli.shared_arm import Plug, ok, patient
from tests.defaults import patient_line
from tests.link.far_ends import free_port
from tests.system.programs import PATIENCE, read_until
from tests.waits import eventually

from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.emulator.board import make_hex7bot_board
from hexwire.joystick.channel import JoystickSender
from hexwire.model.state import JointState
from hexwire.wire.robot_bodies import JoystickState

ROOT = Path(__file__).resolve().parent.parent.parent
# Ends the program that runs it, by a signal nobody can handle, at the n-th answer after its first move.
DIES = """
import os, signal
import hexwire.ipc.session as session
from hexwire.wire.command_frame import Command
plain, answers = session.Session.request, []
def request(self, cmd, *args, **kwargs):
    reply = plain(self, cmd, *args, **kwargs)
    if answers or cmd in (Command.JOINT_MOVE, Command.TRAJECTORY_START):
        answers.append(cmd)
        if len(answers) == {after}:
            os.kill(os.getpid(), {signal})
    return reply
session.Session.request = request
"""
# Patient: a busy machine must not end the program before it is killed.
CLI = """
import sys
import pytest
from hexwire.cli.main import main
from hexwire.control.motion.motion_options import MotionOptions
from hexwire.session.policy import RetryPolicy
from tests.defaults import default
patch = pytest.MonkeyPatch()
default(patch, MotionOptions, watchdog=3.0)
default(patch, RetryPolicy, window=1.0)
sys.argv = ['hexwire', *sys.argv[1:]]
main()
"""
WAY = {
    "joint_names": ["J4", "J5"],
    "points": [
        {"time_from_start": 0.0, "positions": [0.0, 0.0]},
        {"time_from_start": 8.0, "positions": [1.0, 1.0]},
    ],
}


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    patient(monkeypatch)
    patient_line(monkeypatch)


@pytest.fixture
def arm() -> Iterator[Plug]:
    with Plug(make_hex7bot_board(start=time.monotonic())) as arm:
        yield arm


def look(arm: Plug) -> JointState:
    with Hex7BotDriver.from_url(arm.path) as robot:
        return robot.read()


def start(port: str, program: str, *words: str) -> subprocess.Popen[str]:
    environment = {**os.environ, "HEXWIRE_PORT": port}
    return subprocess.Popen(
        [sys.executable, "-c", program, *words],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )


def killed(arm: Plug, program: str, *words: str) -> None:
    """Run a program that kills itself; returns when the board has noticed."""
    process = start(arm.path, program, *words)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == -signal.SIGKILL, errors
    eventually(lambda: arm.board.state.watchdog_tripped)


def check_held(arm: Plug) -> JointState:
    """Where the arm holds."""
    there = look(arm)
    assert there.watchdog_tripped
    assert there.stopped
    # The board may have stood still when the watchdog was due, so that the arm brakes only now.
    arm.moves(0.5)
    assert arm.rests(5.0)
    return there


MOVES = {
    "move": (("move", "J4=70", "--duration", "8", "--wait"), 2),
    "goto": (("goto", "100", "150", "200", "--speed", "10"), 2),
    "line": (("line", "0", "0", "-40", "--relative", "--speed", "4"), 2),
    "play": (("play", "{way}"), 2),
    "demo": (("demo", "--yes-move-the-arm", "--duration", "12", "--port", "{port}"), 40),
    "grip": (("grip", "close", "--duration", "6"), 2),
}


@pytest.mark.system
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name == "move" else pytest.mark.slow) for name in MOVES]
)
def test_a_command_that_is_killed_leaves_an_arm_that_is_stopped(arm: Plug, tmp_path: Path, name: str) -> None:
    words, after = MOVES[name]
    way = tmp_path / "way.json"
    way.write_text(json.dumps(WAY), encoding="utf-8")
    if name == "line":
        # Where it does not lead past a singularity.
        ok("goto", "60", "200", "150", "--down", port=arm.path)
    before = look(arm)
    killed(arm, DIES.format(after=after, signal=9) + CLI, *(w.format(way=way, port=arm.path) for w in words))
    there = check_held(arm)
    assert max(abs(a - b) for a, b in zip(there.position, before.position, strict=True)) > 0.002, "it moved"
    if name == "move":
        assert there["J4"].position < 0.6, "far from its target"


@pytest.mark.slow
@pytest.mark.system
def test_a_move_that_nobody_waits_for_is_finished_although_its_program_is_killed(arm: Plug) -> None:
    process = start(arm.path, DIES.format(after=1, signal=9) + CLI, "move", "J4=8", "--duration", "0.6")
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == -signal.SIGKILL, errors
    with Hex7BotDriver.from_url(arm.path) as robot:
        eventually(lambda: abs(robot.read()["J4"].position - math.radians(8.0)) < 0.01)
        assert not robot.read().stopped


@contextmanager
def pushed_stick(port: int) -> Iterator[list[float]]:
    """A stick at the other end of a channel; yields when it was pushed.

    Again and again it does what begins a motion: the button let go, then held with the stick at rest, then J1 on.
    """
    pushed: list[float] = []

    def push(ended: threading.Event) -> None:
        with JoystickSender.from_url(f"udp://127.0.0.1:{port}") as sender:
            for i in itertools.count():
                if ended.wait(0.02):
                    return
                at = i % 100
                sender.send(JoystickState((float(at > 30), *[0.0] * 7), (at > 20) << 4))
                if at == 99:
                    pushed.append(time.monotonic())

    with beside(push):
        yield pushed


@pytest.mark.slow
@pytest.mark.system
def test_teleop_that_is_killed_with_the_stick_pushed_leaves_an_arm_that_is_stopped(arm: Plug) -> None:
    before = look(arm)
    channel = free_port(socket.SOCK_DGRAM)
    with pushed_stick(channel):
        killed(arm, DIES.format(after=80, signal=9) + CLI, "teleop", "--from", f"udp-listen://127.0.0.1:{channel}")
        assert check_held(arm)["J1"].position > before["J1"].position + 0.01, "it moved"


@contextmanager
def suspended(arm: Plug, after: int, *words: str) -> Iterator[subprocess.Popen[str]]:
    """A command that is suspended in the middle and goes on when the board has noticed."""
    process = start(arm.path, DIES.format(after=after, signal=19) + CLI, *words)
    try:
        os.waitpid(process.pid, os.WUNTRACED)
        eventually(lambda: arm.board.state.watchdog_tripped)
        process.send_signal(signal.SIGCONT)
        yield process
    finally:
        process.kill()
        process.communicate()


@pytest.mark.slow
@pytest.mark.system
def test_teleop_that_stalls_stays_stopped_when_it_continues_with_the_stick_pushed(arm: Plug) -> None:
    channel = free_port(socket.SOCK_DGRAM)
    with (
        pushed_stick(channel) as pushed,
        suspended(arm, 80, "teleop", "--from", f"udp-listen://127.0.0.1:{channel}") as process,
    ):
        read_until(process, "the board has stopped the arm: its watchdog tripped", errors=True)
        known = time.monotonic()
        eventually(lambda: [when for when in pushed if when > known][1:])
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=PATIENCE)
        check_held(arm)


@pytest.mark.slow
@pytest.mark.system
def test_a_suspended_command_that_continues_says_why_the_arm_is_stopped(arm: Plug) -> None:
    with suspended(arm, 2, "move", "J4=70", "--duration", "8", "--wait") as process:
        _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert "the board has stopped the arm: its watchdog tripped" in errors
    assert check_held(arm)["J4"].position < 0.6


def program_of(page: str, marker: str) -> str:
    text = (ROOT / page).read_text(encoding="utf-8")
    blocks = re.findall(r"^```python[^\n]*\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    return "\n".join(blocks[: 1 + next(i for i, block in enumerate(blocks) if marker in block)])


@pytest.mark.system
def test_the_program_of_the_readme_stops_the_arm_when_it_is_killed(arm: Plug) -> None:
    program = program_of("README.md", "hexwire.connect()")
    assert "arm.stop()" in program
    # Slowly, and it is killed right after it has asked for its first motion.
    program = program.replace("hexwire.connect()", "hexwire.connect(speed=0.05)")
    killed(arm, DIES.format(after=1, signal=9) + program)
    there = check_held(arm)
    assert there["J1"].position < math.radians(18), "short of its target"


@pytest.mark.slow
@pytest.mark.system
def test_the_program_of_the_planning_page_stops_the_arm_when_it_is_killed(arm: Plug) -> None:
    program = program_of("docs/planning.md", "board_process")
    program = program.replace(
        "with board_process() as port, hexwire.connect(port)", f"with hexwire.connect({arm.path!r})"
    )
    before = look(arm)
    # The board follows the path until its watchdog trips, a second later.
    killed(arm, DIES.format(after=2, signal=9) + program)
    there = check_held(arm)
    way = there["J1"].position - before["J1"].position
    assert way < 0.38, "short of its target"
