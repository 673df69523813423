"""The ELF on the simulated chip behind a pseudo-terminal, asked by the real driver and by the commands."""

from __future__ import annotations

import json
import math
import os
import select
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from tests.avr.machines import BUILD, ChipBoard, built
from tests.avr.pty import PtyBoard, on_pty
from tests.beside import beside
from tests.cli.shared_arm import ok, run
from tests.waits import eventually

from hexwire.control import MotionOptions, run_motion
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.emulator.bus_arms import make_hex7bot_servos
from hexwire.emulator.servo_wire import ServoWire
from hexwire.ipc import raised_line
from hexwire.model.state import JointTarget
from hexwire.wire import tables

VERSION = f"{tables.VERSION_MAJOR}.{tables.VERSION_MINOR}.{tables.VERSION_PATCH}"

pytestmark = pytest.mark.system


@pytest.fixture(autouse=True)
def patient_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    """A simulated chip that is slower than the clock is back at its own rate later than a real one."""
    monkeypatch.setattr(raised_line, "_BACK", 30.0)


def test_the_driver_moves_a_joint() -> None:
    with on_pty(PtyBoard(ChipBoard())) as board, Hex7BotDriver.from_url(board.path) as robot:
        report = robot.probe()
        assert (report.dialect, report.firmware, report.missing) == (2, VERSION, ())
        state = robot.read()
        angles = dict(zip(state.names, map(math.degrees, state.position), strict=True))
        assert angles["J1"] == pytest.approx(-4.47257, abs=1e-4)
        assert angles["J5"] == pytest.approx(3.1641, abs=1e-4)
        assert robot.torque(True) == tuple(angles)
        sent = robot.write(JointTarget((("J1", 0.0), ("J5", 0.1)), duration=0.2))
        assert (sent.clamped, sent.silent) == ((), ())


def test_a_target_is_a_path_that_a_later_program_may_replace() -> None:
    with on_pty(PtyBoard(ChipBoard())) as board:
        with Hex7BotDriver.from_url(board.path) as robot:
            assert run_motion(robot, JointTarget.of({"J4": 0.6}, 20.0), wait=False).timed
        with Hex7BotDriver.from_url(board.path) as robot:
            assert robot.left_path() == ("J4",)
            # The simulated chip is slower than the clock on a busy machine.
            patient = MotionOptions(grace=60.0)
            result = run_motion(robot, JointTarget.of({"J4": 0.05}, 0.3), patient)
            assert (result.arrived, result.timed, result.why) == (True, True, "")
            assert robot.left_path() == ()


def test_the_command_line() -> None:
    with on_pty(PtyBoard(ChipBoard())) as board:
        assert json.loads(ok("probe", "--json", port=board.path))["firmware"] == VERSION
        ok("torque", "on", port=board.path)
        # Short: the simulated chip is slow on a busy machine, and the command waits two seconds more than this.
        ok("move", "J4=10", "--wait", "--duration", "0.3", "--tolerance", "0.3", port=board.path)
        joints = {joint["name"]: joint for joint in json.loads(ok("state", "--json", port=board.path))["joints"]}
        assert joints["J4"]["position_deg"] == pytest.approx(10, abs=0.3)
        ok("stop", port=board.path)
        refused = run("move", "J4=0", port=board.path)
        assert refused.exit_code == 1
        assert "stopped" in refused.stderr
        ok("resume", port=board.path)
        info = ok("firmware", "info", port=board.path)
        assert f"version {VERSION}" in info
        assert "(the same)" in info


class ShakyBoard(ChipBoard):
    """Its line does not hold a raised rate: every so-manieth byte is damaged there."""

    def set_rate(self, baud: int) -> None:
        super().set_rate(baud)
        self.spoil(200 if baud > 115200 else 0)


@pytest.mark.parametrize("rate", [500_000, pytest.param(1_000_000, marks=pytest.mark.slow)])
def test_the_rate_of_the_line_is_raised_and_put_back(rate: int, monkeypatch: pytest.MonkeyPatch) -> None:
    # A machine that stalls for longer than an answer may take is no line that does not hold the rate.
    for name in ("_ANSWER", "_CHECK"):
        monkeypatch.setattr(raised_line, name, 20.0)
    with on_pty(PtyBoard(ChipBoard())) as board:
        chip = board.machine
        assert isinstance(chip, ChipBoard)
        with Hex7BotDriver.from_url(f"{board.path}?raise={rate}") as robot:
            assert chip.chip_rate == rate
            assert len(robot.read().position) == 7
        with Hex7BotDriver.from_url(board.path) as robot:
            assert chip.chip_rate == 117_647
            assert len(robot.read().position) == 7
        assert chip.overruns == 0


@pytest.mark.slow
def test_a_line_that_does_not_hold_the_rate() -> None:
    with on_pty(PtyBoard(ShakyBoard())) as board:
        probe = run("probe", "--raise-baud", "1000000", "--json", port=board.path)
        assert probe.exit_code == 0, probe.stderr
        assert json.loads(probe.stdout)["firmware"] == VERSION
        lines = probe.stderr.splitlines()
        assert len(lines) == 1, lines
        assert "the rate stays at 115200 baud instead of 1000000" in lines[0]
        assert "exchanges failed" in lines[0]


@pytest.mark.slow
def test_the_chapters_dialect_alone() -> None:
    with on_pty(PtyBoard(ChipBoard())) as board:
        assert json.loads(ok("probe", "--dialect", "1", "--json", port=board.path))["dialect"] == 1
        ok("ping", "--dialect", "1", port=board.path)


@contextmanager
def servos_on(path: str) -> Iterator[None]:
    """Emulated servos at the end of a terminal; they take no time."""
    line = os.open(path, os.O_RDWR | os.O_NOCTTY)
    wire = ServoWire(make_hex7bot_servos())

    def serve(ended: threading.Event) -> None:
        held, now = b"", 0.0
        while not ended.is_set():
            ready, _, _ = select.select([line], [], [], 0.05)
            held += os.read(line, 4096) if ready else b""
            while len(held) >= 4 and len(held) >= held[3] + 4:
                packet, held = held[: held[3] + 4], held[held[3] + 4 :]
                now += 0.001
                os.write(line, wire.transact(packet, now)[0])

    try:
        with beside(serve):
            yield
    finally:
        os.close(line)


def test_the_core_as_a_program() -> None:
    built("host")
    with subprocess.Popen([str(BUILD / "host/pty_board")], stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout
        lines = dict(program.stdout.readline().split() for _ in range(2))
        try:
            with servos_on(lines["bus"]), Hex7BotDriver.from_url(lines["host"]) as robot:
                assert robot.probe().firmware == VERSION
                # On a loaded machine the servos may be late; the board asks those again every half second.
                eventually(lambda: robot.probe().missing == ())
        finally:
            program.terminate()
    assert program.returncode == 0


def test_the_program_refuses_what_it_does_not_know() -> None:
    built("host")
    done = subprocess.run(
        [str(BUILD / "host/pty_board"), "--nonsense"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "usage" in done.stderr
