"""Runs hexwire as a person does: real processes, real pseudo-terminals, generous time-outs."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

HEXWIRE = [sys.executable, "-m", "hexwire.cli"]
PATIENT_PLAYER = [sys.executable, "-m", "tests.system.patient_player"]
"""`hexwire` for motions on several arms, with a longer watchdog."""
PATIENCE = 60.0
# setsid alone gives no controlling terminal, and without one Ctrl-C is only a byte.
OWN_TERMINAL = """
import fcntl, os, sys, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
os.execv(sys.argv[1], sys.argv[1:])
"""
ANSI = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]")


def environment() -> dict[str, str]:
    """Ours, without what would steer the program or its output, and with a terminal that can be drawn on."""
    dropped = ("HEXWIRE_", "NO_COLOR", "FORCE_COLOR", "COLUMNS", "LINES", "PYTHONUNBUFFERED")
    env = {key: value for key, value in os.environ.items() if not key.startswith(dropped)}
    return env | {"TERM": "xterm-256color"}


def hexwire(*words: str, env: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command to its end, without a terminal."""
    return subprocess.run(
        [*HEXWIRE, *words],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
        env=environment() | (env or {}),
    )


@contextlib.contextmanager
def running(*command: str, **options: Any) -> Iterator[subprocess.Popen[str]]:
    """A program whose output is read through pipes. It ends with the block, also where a test fails."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options) as program:
        try:
            yield program
        finally:
            program.kill()


def start(*words: str) -> AbstractContextManager[subprocess.Popen[str]]:
    """`hexwire` with these words as a person starts it: without what steers it, in a session of its own."""
    return running(*HEXWIRE, *words, stdin=subprocess.DEVNULL, env=environment(), start_new_session=True)


def hexwire_program(
    *words: object, program: Sequence[str] = HEXWIRE
) -> AbstractContextManager[subprocess.Popen[str]]:
    """`hexwire` with these words and all of this environment."""
    return running(*program, *map(str, words), env=os.environ | {"PYTHONUNBUFFERED": "1"})


def read_until(program: subprocess.Popen[str], text: str | re.Pattern[str], *, errors: bool = False) -> str:
    """Read lines of a program's output until one contains `text`, or a pattern is found; returns all of them.

    Args:
        program: With pipes.
        text: What is waited for.
        errors: Read its standard error instead.
    """
    pipe, lines = program.stderr if errors else program.stdout, ""
    assert pipe is not None
    while not (text in lines if isinstance(text, str) else text.search(lines)):
        line = pipe.readline()
        assert line, f"ended before {text!r}: {lines!r}, and then {program.communicate(timeout=PATIENCE)}"
        lines += line
    return lines


@contextlib.contextmanager
def board(*options: str) -> Iterator[str]:
    """An emulated board on a pseudo-terminal; yields its path."""
    with start("sim", "board", *options) as process:
        try:
            yield read_until(process, "\n").strip()
        finally:
            process.send_signal(signal.SIGTERM)
            process.communicate(timeout=PATIENCE)


@contextlib.contextmanager
def mute_port(path: Path) -> Iterator[str]:
    """A pseudo-terminal behind which nobody answers; yields a symbolic link to it."""
    master, slave = pty.openpty()
    path.symlink_to(os.ttyname(slave))
    try:
        yield str(path)
    finally:
        os.close(master)
        os.close(slave)


class Terminal:
    """A program with a terminal of its own, 90 columns wide, as in a window.

    Attributes:
        process: The program; it leads the session of the terminal.
        text: Everything it wrote so far.
    """

    def __init__(self, *words: str) -> None:
        self._master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 90, 0, 0))
        self.process = subprocess.Popen(
            [sys.executable, "-c", OWN_TERMINAL, *HEXWIRE, *words],
            stdin=slave,
            stdout=slave,
            stderr=slave,
            env=environment(),
            start_new_session=True,
        )
        os.close(slave)
        self.text = ""

    def read_until(self, done: str | Callable[[str], bool]) -> None:
        """Read until a text is on the terminal, or a condition holds for all of it."""
        deadline = time.monotonic() + PATIENCE
        while not (done in self.plain if isinstance(done, str) else done(self.plain)):
            assert self._read(deadline), f"ended before {done!r}: {self.plain[-2000:]!r}"

    def type(self, keys: bytes) -> None:
        """Press keys."""
        os.write(self._master, keys)

    def wait(self) -> int:
        """Read to the end; returns the exit status."""
        deadline = time.monotonic() + PATIENCE
        while self._read(deadline):
            pass
        return self.process.wait(PATIENCE)

    @property
    def plain(self) -> str:
        """What was written, without colours and cursor movements."""
        return ANSI.sub("", self.text)

    def _read(self, deadline: float) -> bool:
        ready, _, _ = select.select([self._master], [], [], max(deadline - time.monotonic(), 0))
        assert ready, f"nothing more came: {self.plain[-2000:]!r}"
        try:
            data = os.read(self._master, 65536)
        except OSError:
            return False
        self.text += data.decode(errors="replace")
        return bool(data)

    def __enter__(self) -> Terminal:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._master)
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait(PATIENCE)


def children_of(pid: int) -> list[int]:
    """Process ids of a process's children."""
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def gone(pid: int) -> bool:
    """Wait for a process to end; whether it did."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except (FileNotFoundError, ProcessLookupError):
            return True
        if state == "Z":
            return True
        time.sleep(0.05)
    return False
