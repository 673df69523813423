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
from tests.link.far_ends import free_port

from hexwire.cli.board_process import board_process
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.joystick.channel import JoystickSender
from hexwire.model.state import JointState
from hexwire.wire.robot_bodies import JoystickState

ROOT = Path(__file__).resolve().parent.parent.parent
PATIENCE = 60.0
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
CLI = "from hexwire.cli.main import main\nimport sys\nsys.argv = ['hexwire', *sys.argv[1:]]\nmain()\n"
WAY = {
    "joint_names": ["J4", "J5"],
    "points": [
        {"time_from_start": 0.0, "positions": [0.0, 0.0]},
        {"time_from_start": 5.0, "positions": [1.0, 1.0]},
    ],
}


@pytest.fixture
def port() -> Iterator[str]:
    with board_process() as path:
        yield path


def look(port: str) -> tuple[JointState, JointState]:
    """Two states half a second apart."""
    with Hex7BotDriver.from_url(port) as robot:
        first = robot.read()
        time.sleep(0.5)
        return first, robot.read()


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


def killed(port: str, program: str, *words: str) -> None:
    process = start(port, program, *words)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == -signal.SIGKILL, errors
    time.sleep(1.5)


def check_held(port: str) -> JointState:
    first, second = look(port)
    assert first.watchdog_tripped
    assert first.stopped
    if second.position != pytest.approx(first.position, abs=0.01):
        # The board's process stood still when the watchdog was due, so that the arm brakes only now.
        first, second = look(port)
    assert second.position == pytest.approx(first.position, abs=0.01)
    return first


MOVES = {
    "move": (("move", "J4=70", "--duration", "8", "--wait"), 10),
    "goto": (("goto", "100", "150", "200", "--speed", "10"), 20),
    "line": (("line", "0", "0", "-40", "--relative", "--speed", "10"), 20),
    "play": (("play", "{way}"), 30),
    "demo": (("demo", "--yes-move-the-arm", "--duration", "12", "--port", "{port}"), 40),
    "grip": (("grip", "close", "--duration", "3"), 5),
}


@pytest.mark.system
@pytest.mark.parametrize("name", list(MOVES))
def test_a_command_that_is_killed_leaves_an_arm_that_is_stopped(port: str, tmp_path: Path, name: str) -> None:
    words, after = MOVES[name]
    way = tmp_path / "way.json"
    way.write_text(json.dumps(WAY), encoding="utf-8")
    if name == "line":
        # Where it does not lead past a singularity.
        there = start(port, CLI, "goto", "60", "200", "150", "--down")
        _, errors = there.communicate(timeout=PATIENCE)
        assert there.returncode == 0, errors
    before, _ = look(port)
    killed(port, DIES.format(after=after, signal=9) + CLI, *(w.format(way=way, port=port) for w in words))
    there = check_held(port)
    assert max(abs(a - b) for a, b in zip(there.position, before.position, strict=True)) > 0.005, "it moved"
    if name == "move":
        assert there["J4"].position < 0.6, "far from its target"


@pytest.mark.system
def test_a_move_that_nobody_waits_for_is_finished_although_its_program_is_killed(port: str) -> None:
    process = start(port, DIES.format(after=1, signal=9) + CLI, "move", "J4=8", "--duration", "0.6")
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == -signal.SIGKILL, errors
    with Hex7BotDriver.from_url(port) as robot:
        deadline = time.monotonic() + PATIENCE
        while abs(robot.read()["J4"].position - math.radians(8.0)) > 0.01:
            assert time.monotonic() < deadline
            time.sleep(0.05)
        assert not robot.read().stopped


@contextmanager
def pushed_stick(port: int) -> Iterator[None]:
    """A stick at the other end of a channel.

    Again and again it does what begins a motion: the button let go, then held with the stick at rest, then J1 on.
    """

    def push(ended: threading.Event) -> None:
        with JoystickSender.from_url(f"udp://127.0.0.1:{port}") as sender:
            for i in itertools.count():
                if ended.wait(0.02):
                    return
                at = i % 250
                sender.send(JoystickState((float(at > 30), *[0.0] * 7), (at > 20) << 4))

    with beside(push):
        yield


@pytest.mark.system
def test_teleop_that_is_killed_with_the_stick_pushed_leaves_an_arm_that_is_stopped(port: str) -> None:
    before, _ = look(port)
    channel = free_port(socket.SOCK_DGRAM)
    with pushed_stick(channel):
        killed(port, DIES.format(after=80, signal=9) + CLI, "teleop", "--from", f"udp-listen://127.0.0.1:{channel}")
        assert check_held(port)["J1"].position > before["J1"].position + 0.01, "it moved"


@pytest.mark.system
def test_teleop_that_stalls_stays_stopped_when_it_continues_with_the_stick_pushed(port: str) -> None:
    channel = free_port(socket.SOCK_DGRAM)
    program = DIES.format(after=80, signal=19) + CLI
    with pushed_stick(channel):
        process = start(port, program, "teleop", "--from", f"udp-listen://127.0.0.1:{channel}")
        try:
            os.waitpid(process.pid, os.WUNTRACED)
            time.sleep(2.0)
            process.send_signal(signal.SIGCONT)
            time.sleep(2.0)
            process.send_signal(signal.SIGINT)
        finally:
            try:
                _, errors = process.communicate(timeout=PATIENCE)
            finally:
                process.kill()
        assert "the board has stopped the arm: its watchdog tripped" in errors
        check_held(port)


@pytest.mark.system
def test_a_suspended_command_that_continues_says_why_the_arm_is_stopped(port: str) -> None:
    process = start(port, DIES.format(after=10, signal=19) + CLI, "move", "J4=70", "--duration", "8", "--wait")
    try:
        os.waitpid(process.pid, os.WUNTRACED)
        time.sleep(2.0)
        process.send_signal(signal.SIGCONT)
        _, errors = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
    assert process.returncode == 1
    assert "the board has stopped the arm: its watchdog tripped" in errors
    assert check_held(port)["J4"].position < 0.6


def program_of(page: str, marker: str) -> str:
    text = (ROOT / page).read_text(encoding="utf-8")
    blocks = re.findall(r"^```python[^\n]*\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    return "\n".join(blocks[: 1 + next(i for i, block in enumerate(blocks) if marker in block)])


@pytest.mark.system
def test_the_program_of_the_readme_stops_the_arm_when_it_is_killed(port: str) -> None:
    program = program_of("README.md", "hexwire.connect()")
    assert "arm.stop()" in program
    # It is killed right after it has asked for a motion of a second.
    killed(port, DIES.format(after=1, signal=9) + program)
    there = check_held(port)
    assert there["J1"].position < 0.08, "short of its target"


@pytest.mark.system
def test_the_program_of_the_motion_page_stops_the_arm_when_it_is_killed(port: str) -> None:
    program = program_of("docs/motion.md", "board_process")
    program = program.replace(
        "with board_process() as port, hexwire.connect(port)", f"with hexwire.connect({port!r})"
    )
    before, _ = look(port)
    # The board follows the path until its watchdog trips, a second later.
    killed(port, DIES.format(after=4, signal=9) + program)
    there = check_held(port)
    way = there["J1"].position - before["J1"].position
    assert way < 0.38, "short of its target"
