"""`hexwire fleet play` is killed, halted, or hangs, while two arms move: each of them is left at rest.

Real processes of one machine. What the arms do is read from their servos.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.system.fleet_programs import Program
from tests.system.fleet_watch import HOLD, TIMEOUT, BoardLog, moved
from tests.system.programs import HEXWIRE, PATIENCE, PATIENT_PLAYER

from hexwire.cli.main import cli

pytestmark = pytest.mark.system

NAMES = ("lab/arm1", "lab/arm2")
WATCHDOG = 1.0
"""Seconds after which a server stops its arm when the program makes no call: what `fleet play` asks for."""
POINTS = [(0.0, 0.0), (4.0, 0.8), (8.0, 0.0)]
"""Times and angles of J1, the same on both arms."""


class Stage:
    """Two arms with a server each, on boards that write down what their servos do. Use as context manager."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.env = {name: str(folder / "run") for name in ("XDG_RUNTIME_DIR", "XDG_STATE_HOME")}
        self.motion, self.hangs, self.errors = folder / "way.json", folder / "hangs", folder / "errors.log"
        rows = [{"time_from_start": t, "positions": [angle], "velocities": [0.0]} for t, angle in POINTS]
        self.motion.write_text(json.dumps({"joint_names": ["J1"], "points": rows}))
        self._served = folder / "arms.toml"
        self._stack = ExitStack()
        self._boards: list[BoardLog] = []
        self._told = 0

    def __enter__(self) -> Stage:
        with ExitStack() as self._stack:
            for number, name in enumerate(NAMES):
                # Not that a board stops its arm whose server stands still for a second, as on a busy machine.
                log = self.folder / f"board{number}.log"
                self._boards.append(BoardLog(log))
                port = self.program(sys.executable, "-m", "tests.system.watched_board", log).line()
                self._served.write_text(f'lease = {TIMEOUT}\n[arms."{name}"]\nport = "{port}"\nwatchdog = 5.0\n')
                self.program(*HEXWIRE, "serve", "--config", self._served).line()
            self._stack = self._stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def program(self, *words: object) -> Program:
        """Start a program."""
        program = Program([*map(str, words)], self.errors, extra=self.env)
        self._stack.callback(program.end)
        return program

    def run(self, *words: str) -> str:
        """Run a command in this process; returns its output."""
        done = CliRunner(env=self.env).invoke(cli, words)
        assert done.exit_code == 0, done.output
        return done.stdout

    def play(self, *words: object) -> Program:
        """Start to play; returns when both arms are far on their way."""
        for name in NAMES:
            self.run("resume", "--port", f"zenoh:{name}")
        self._told += len(self.said())
        program = self.program(
            # With a short watchdog, a server that stands still finds the lease and the watchdog over at once.
            *(words or (*PATIENT_PLAYER, "fleet", "play", self.motion, "--on", "lab/*", "--max-doubt", 250))
        )
        while not program.line().startswith("motion:"):
            pass
        deadline = time.monotonic() + PATIENCE
        before = self.positions()
        while any(abs(now - then) < 40 for now, then in zip(self.positions(), before, strict=True)):
            assert time.monotonic() < deadline, "the arms do not move"
            assert program.process.poll() is None, self.said()
            time.sleep(0.02)
        return program

    def said(self) -> str:
        """What was written to standard errors since the last `play` began."""
        return self.errors.read_text()[self._told :] if self.errors.exists() else ""

    def positions(self) -> list[float]:
        """Where J1 of each arm is, in counts."""
        return [board.read()[0].positions[-1] for board in self._boards]

    def rest(self, since: float, within: float) -> list[float]:
        """Check that no servo moves any more some time after; returns when each arm came to rest, in seconds."""
        time.sleep(max(0.0, since + within + 1.0 - time.monotonic()))
        now, times = time.monotonic(), []
        for board in self._boards:
            servos = board.read()
            assert moved(servos, since + within, now) == ""
            j1 = servos[0]
            there = j1.positions[-1]
            last = [t for t, position in zip(j1.times, j1.positions, strict=True) if abs(position - there) > 1.0]
            times.append(last[-1] - since)
        return times

    def arms(self) -> list[dict[str, object]]:
        """What the arms say of themselves."""
        rows: list[dict[str, object]] = json.loads(self.run("fleet", "list", "--json"))
        return rows


@pytest.fixture(scope="module")
def stage() -> Iterator[Stage]:
    with tempfile.TemporaryDirectory(prefix="hw-", dir="/tmp") as folder, Stage(Path(folder)) as stage:
        yield stage


def show(capsys: pytest.CaptureFixture[str], what: str, times: list[float]) -> None:
    with capsys.disabled():
        print(f"\n{what}: at rest after {' and '.join(f'{t:.2f} s' for t in times)}", end=" ")


def test_a_player_that_is_killed_leaves_arms_that_hold(stage: Stage, capsys: pytest.CaptureFixture[str]) -> None:
    player = stage.play()
    killed = player.kill()
    show(capsys, "killed", stage.rest(killed, TIMEOUT + HOLD))
    for row in stage.arms():
        assert (row["stopped"], row["holder"]) == (False, None), f"{row} {stage.said()}"
        assert f"lost the lease after {TIMEOUT:g} s of silence" in str(row["condition"])


@pytest.mark.slow
def test_a_player_that_is_halted_leaves_arms_that_hold_and_ends_when_it_goes_on(
    stage: Stage, capsys: pytest.CaptureFixture[str]
) -> None:
    player = stage.play()
    with player.stopped() as begin:
        show(capsys, "halted", stage.rest(begin, TIMEOUT + HOLD))
        assert all("lost the lease" in str(row["condition"]) for row in stage.arms())
        end = time.monotonic()
    assert player.process.wait(PATIENCE) == 1
    assert "all arms are stopped" in stage.said()
    stage.rest(end, 0.0)


@pytest.mark.slow
def test_a_player_that_hangs_with_a_heartbeat_has_its_arms_stopped(
    stage: Stage, capsys: pytest.CaptureFixture[str]
) -> None:
    player = stage.play(sys.executable, "-m", "tests.system.fleet_play", stage.hangs, stage.motion, "lab/*")
    begin = time.monotonic()
    stage.hangs.touch()
    show(capsys, "hangs", stage.rest(begin, WATCHDOG + HOLD))
    assert player.process.poll() is None
    for row in stage.arms():
        assert row["stopped"], row
        assert f"process {player.process.pid}" in str(row["holder"])
    stage.hangs.unlink()
    assert player.process.wait(PATIENCE) == 1
    assert "all arms are stopped" in stage.said()
