"""What the tests of shared arms have in common: a board that can hang, patience, commands at the arm's address."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from click.testing import CliRunner, Result
from tests.defaults import default
from tests.waits import PATIENCE

from hexwire.cli.main import cli
from hexwire.control.motion.motion_options import MotionOptions
from hexwire.control.sharing.lease import Lease
from hexwire.emulator.board import EmulatedBoard
from hexwire.emulator.serve_pty import PtyServer
from hexwire.motion.safety import SafetyLimits

ARM = "zenoh:lab/arm1"


class Plug:
    """An emulated Hex7Bot behind a terminal of this process, which can be made to hang. Use as context manager."""

    def __init__(self, board: EmulatedBoard) -> None:
        self.board = board
        self._runs, self._halted = threading.Event(), threading.Event()
        self._runs.set()
        self._ended = False
        self._server = PtyServer(board)
        self.path = self._server.open()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._ended:
            if self._runs.is_set():
                self._server.run_once(0.05)
            else:
                self._halted.set()
                self._runs.wait(0.05)

    def hang(self) -> None:
        """Answer nothing any more, when this returns."""
        self._halted.clear()
        self._runs.clear()
        assert self._halted.wait(PATIENCE)

    def go_on(self) -> None:
        self._runs.set()

    def rests(self, seconds: float) -> bool:
        """Whether no servo moves in so many seconds of the board's own time; from now on the board hangs."""
        return self.moves(seconds) < 6.0

    def moves(self, seconds: float) -> float:
        """As `rests`: how far a servo moves at most, counts."""
        self.hang()
        before, begin = self._counts(), self.board.time
        for i in range(round(100 * seconds)):
            self.board.step(begin + 0.01 * (i + 1))
        return max(abs(after - there) for after, there in zip(self._counts(), before, strict=True))

    def _counts(self) -> list[float]:
        return [servo.motion.position for servo in self.board.wire.servos]

    def __enter__(self) -> Plug:
        return self

    def __exit__(self, *_: object) -> None:
        self._ended = True
        self._thread.join()
        self._server.close()


def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Longer times for motions of this process: a busy machine lets it and its robots wait for long."""
    limits = SafetyLimits(following_time=5.0, lag=2.0, max_age=5.0)
    default(monkeypatch, MotionOptions, watchdog=5.0, limits=limits)
    # Of what is shared by this process.
    default(monkeypatch, Lease, max_age=2.0)


def run(*words: str, port: str = ARM) -> Result:
    return CliRunner().invoke(cli, [*words, "--port", port])


def ok(*words: str, port: str = ARM) -> str:
    result = run(*words, port=port)
    assert (result.exit_code, result.stderr) == (0, ""), result.output
    return result.stdout


@contextmanager
def process(*words: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-P", "-m", "hexwire.cli", *words]
    started = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield started
    finally:
        started.kill()
        started.communicate()


_NUMBER = re.compile(r"-?\b\d+(\.\d+)?(e-?\d+)?\b|\bnull\b|(?<= )-(?= )")
_OWN = ("link", "counters", "boot id", '"link"', "fastest", '"boot_id"')


def plain(text: str) -> list[str]:
    """The lines of an output without its numbers, and without what is each server's own."""
    lines = [line.strip() for line in text.split("\n")]
    # A busy machine may skip cycles of either.
    own = (*_OWN, "warning: the line or the machine is too slow")
    kept = [line for line in lines if not line.startswith(own) and "counters" not in line]
    kept = [re.sub(r"boot id \w+", "boot id", line) for line in kept]
    return [" ".join(_NUMBER.sub("#", line).split()) for line in kept if not re.fullmatch(r'"\w+": \d+,?', line)]
