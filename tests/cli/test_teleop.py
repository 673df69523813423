"""Sticks made of numbers move emulated arms, in simulated time; and the commands around that."""

from __future__ import annotations

import math
import os
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from click.testing import CliRunner, Result
from tests.link.far_ends import free_port

from hexwire.cli.main import cli
from hexwire.cli.teleop import drive
from hexwire.drivers.base import RobotDriver
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.drivers.puma260 import Puma260Driver
from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.puma import EmulatedPuma
from hexwire.emulator.serve import BoardLink, FakeClock
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session
from hexwire.joystick.channel import JoystickReceiver
from hexwire.model.hex7bot_kinematics import Hex7BotModel
from hexwire.model.puma260 import Puma260Model
from hexwire.model.state import JointTarget
from hexwire.motion.teleop import JogMode, Teleop
from hexwire.wire.modules import ModuleType
from hexwire.wire.robot_bodies import JoystickState

HELD = 1 << 4
PERIOD = 0.05
Script = Callable[[float], tuple[dict[int, float], int, float]]


class Rig(NamedTuple):
    """An arm, the rules, and a hand that does what a script says."""

    robot: RobotDriver
    rules: Teleop
    clock: FakeClock

    def run(self, script: Script, seconds: float) -> None:
        """`script` gives axes, buttons and age for each time."""
        began = self.clock()

        def stick() -> tuple[JoystickState | None, float]:
            axes, buttons, age = script(self.clock() - began)
            return JoystickState(tuple(axes.get(i, 0.0) for i in range(8)), buttons), age

        def ticks() -> Iterator[float]:
            for i in range(round(seconds / PERIOD)):
                self.clock.time = max(self.clock.time, began + i * PERIOD)
                yield i * PERIOD

        drive(self.robot, self.rules, stick, ticks(), PERIOD)

    def at(self, name: str) -> float:
        return self.robot.read()[name].position


def hex7bot(dialect: int = 2, mode: JogMode = JogMode.JOINT) -> Rig:
    clock = FakeClock(1000.0)
    board = make_hex7bot_board(dialect=dialect, baud=115200, faults=(), start=clock.time)
    robot: RobotDriver = Hex7BotDriver(Session(IpcHandle.from_link(BoardLink(board, clock, baud=115200))))
    robot.attach()
    return Rig(robot, Teleop(robot.model, Hex7BotModel(), mode=mode), clock)


def puma(mode: JogMode = JogMode.JOINT) -> Rig:
    clock = FakeClock(1000.0)
    link = BoardLink(EmulatedPuma(start=clock.time).connect(253), clock)
    handle = IpcHandle.from_link(link, ModuleType.PUMA260_HOST_IO_TRX, ModuleType.PUMA260_RBT_IO_SVR)
    robot: RobotDriver = Puma260Driver(Session(handle))
    robot.attach()
    return Rig(robot, Teleop(robot.model, Puma260Model(), mode=mode), clock)


@pytest.fixture(params=[hex7bot, puma])
def rig(request: pytest.FixtureRequest) -> Iterator[Rig]:
    made: Rig = request.param()
    made.robot.torque(True)
    yield made
    made.robot.detach()


def push(
    axis: int, *, begin: float = 0.1, rest: float = 0.1, until: float = math.inf, lost: float = math.inf
) -> Script:
    def script(t: float) -> tuple[dict[int, float], int, float]:
        held = begin <= t < until
        return ({axis: 1.0} if t > begin + rest else {}), HELD if held else 0, 0.0 if t < lost else t - lost + 0.3

    return script


def test_a_joint_follows_the_stick(rig: Rig) -> None:
    before = rig.at("J1")
    others = [rig.at(name) for name in rig.robot.model.names[1:]]
    rig.run(push(0), 1.6)
    speed = rig.robot.model.joints[0].max_speed
    assert rig.at("J1") - before == pytest.approx(0.3 * speed * 1.4, rel=0.2)
    assert [rig.at(name) for name in rig.robot.model.names[1:]] == pytest.approx(others, abs=0.01)


@pytest.mark.parametrize("how", ["released", "lost"])
def test_letting_go_and_losing_the_channel_hold_at_once(rig: Rig, how: str) -> None:
    end = 1.5
    script = push(0, until=end) if how == "released" else push(0, lost=end)
    rig.run(script, end)
    there = rig.at("J1")
    rig.run(lambda t: script(t + end), 0.1)
    rig.clock.advance(1.0)
    speed = 0.3 * rig.robot.model.joints[0].max_speed
    # No more than it moves in the cycle that it takes to hear of it, and what it needs to stand.
    assert abs(rig.at("J1") - there) < 3 * speed * PERIOD
    rig.run(lambda t: script(t + end + 1), 1.0)
    held = rig.at("J1")
    rig.clock.advance(1.0)
    assert rig.at("J1") == pytest.approx(held, abs=2e-3)
    assert not rig.robot.read().stopped


def test_a_stop_of_somebody_else_is_not_ended_by_the_stick(rig: Rig) -> None:
    rig.run(push(0), 0.5)
    rig.robot.stop()
    rig.clock.advance(0.5)
    there = rig.at("J1")
    rig.run(lambda t: ({0: 1.0}, HELD, 0.0), 0.5)
    assert rig.at("J1") == pytest.approx(there, abs=2e-3)
    rig.robot.resume()
    # The button is still down: it must be released first.
    rig.run(lambda t: ({0: 1.0}, HELD, 0.0), 0.5)
    assert rig.at("J1") == pytest.approx(there, abs=2e-3)


@pytest.mark.parametrize("make", [hex7bot, puma])
def test_cartesian_jog_moves_the_tool(make: Callable[..., Rig]) -> None:
    rig = make(mode=JogMode.CARTESIAN)
    robot, kinematics = rig.robot, rig.rules.kinematics
    assert kinematics is not None
    robot.torque(True)
    start = {"J1": 0.4, "J2": -0.6, "J3": -0.4, "J5": 0.4} if make is puma else {"J2": 0.7, "J5": 0.5}
    robot.write(JointTarget.of(start, 2.0))
    rig.clock.advance(4.0)

    def tool() -> tuple[float, ...]:
        return kinematics.forward(kinematics.from_joints(robot.read().positions)).position

    before = tool()
    rig.run(push(0), 1.2)
    after = tool()
    assert after[0] - before[0] == pytest.approx(0.05, abs=0.015)
    assert after[1:] == pytest.approx(before[1:], abs=0.008)
    robot.detach()


def test_the_chapters_board_can_be_driven_too() -> None:
    rig = hex7bot(dialect=1)
    rig.robot.torque(True)
    before = rig.at("J1")
    rig.run(push(0, begin=1.0, rest=1.0), 3.0)
    assert rig.at("J1") > before + 0.1
    rig.robot.detach()


# -- the commands -----------------------------------------------------------------------------------


def run(*words: str) -> Result:
    return CliRunner().invoke(cli, list(words))


@pytest.mark.parametrize(
    ("words", "status", "text"),
    [
        (("joystick", "send"), 2, "say where to: --to URL or --conf FILE"),
        (("joystick", "send", "--to", "udp://127.0.0.1:1", "--conf", "x"), 2, "say where to"),
        (("joystick", "send", "/none/js0", "--to", "udp://127.0.0.1:1"), 1, "there is no such device"),
        (("joystick", "show", "/none/event3"), 1, "there is no such device"),
        (("teleop", "--device", "a", "--from", "b"), 2, "one of --device, --from and --conf is enough"),
        (("teleop", "--speed", "2", "--port", "/dev/x"), 2, "--speed 2 is over the joints' own limits"),
        (("teleop", "--device", "/none/js0", "--port", "/dev/x"), 1, "there is no such device"),
        (("teleop", "--conf", "/none/x.conf", "--port", "/dev/x"), 2, "cannot be read"),
    ],
)
def test_mistakes(words: tuple[str, ...], status: int, text: str) -> None:
    result = run(*words)
    assert (result.exit_code, text in result.stderr) == (status, True), result.stderr
    assert result.stderr.count("\n") == 1


def test_no_joystick_is_no_error() -> None:
    result = run("joystick", "list")
    assert result.exit_code == 0


@pytest.mark.system
def test_a_joystick_is_sent_over_a_channel(tmp_path: Path) -> None:
    device, port = tmp_path / "js0", free_port()
    os.mkfifo(device)
    command = [
        sys.executable,
        "-m",
        "hexwire.cli",
        "joystick",
        "send",
        str(device),
        "--to",
        f"udp://127.0.0.1:{port}",
    ]
    with JoystickReceiver.from_url(f"udp-listen://127.0.0.1:{port}") as receiver:
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        try:
            with device.open("wb", buffering=0) as stick:
                stick.write(struct.pack("<IhBB", 0, 32767, 0x02, 1) + struct.pack("<IhBB", 0, 1, 0x01, 4))
                end = time.monotonic() + 20
                while receiver.received < 5 and time.monotonic() < end:
                    receiver.poll(time.monotonic() + 0.1)
            assert receiver.state == JoystickState((0.0, 1.0), 1 << 4)
            # Nobody holds the stick any more: that ends it, and the channel falls silent.
            assert process.wait(20) == 1
        finally:
            process.kill()
            process.wait()
            assert process.stderr is not None
            said = process.stderr.read()
            process.stderr.close()
    assert "js0 was unplugged" in said
