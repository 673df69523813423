"""An emulated board in a separate process, for commands that need one for a while.

Owns the lifetime of that process: it reads a pipe that only this program holds open, so it ends however this
program ends. Must not know what is done with the board.
"""

from __future__ import annotations

import contextlib
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import IO

from hexwire.errors import DeviceError, UsageError

from .exits import USAGE, shielded

__all__ = ["board_process"]

_START_TIMEOUT = 30.0
_END_TIMEOUT = 5.0


@contextmanager
def board_process(
    *, baud: int = 115200, dialect: int = 2, faults: Sequence[str] = (), physics: bool = False
) -> Iterator[str]:
    """Run `hexwire sim board` and yield the path of its terminal.

    Args:
        baud: Line rate; 0 is unpaced.
        dialect: Dialect of the board.
        faults: Fault specifications.
        physics: Simulate weight, sag and a table.

    Raises:
        UsageError: The emulator does not know a fault, or MuJoCo is not installed.
        DeviceError: The board did not start.
    """
    # -P: a file in the present folder must not stand in for a module.
    command = [sys.executable, "-P", "-m", "hexwire.cli", "sim", "board", "--until-eof"]
    command += ["--baud", str(baud), "--dialect", str(dialect), *(f"--fault={fault}" for fault in faults)]
    if sys.platform != "linux":
        command.append("--tcp=127.0.0.1:0")
    command += ["--physics"] if physics else []
    with tempfile.TemporaryFile() as errors:
        # A separate session: Ctrl-C must reach only this program, which needs the board to make the arm safe.
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, start_new_session=True
        )
        try:
            yield _read_path(process, errors)
        finally:
            with shielded():
                _end(process)


def _read_path(process: subprocess.Popen[bytes], errors: IO[bytes]) -> str:
    assert process.stdout is not None
    deadline = time.monotonic() + _START_TIMEOUT
    line = b""
    while not line.endswith(b"\n"):
        # Windows waits for sockets only; there the read waits until the board starts or ends.
        pipes = [] if sys.platform == "win32" else [process.stdout]
        if pipes and not select.select(pipes, [], [], max(deadline - time.monotonic(), 0))[0]:
            raise DeviceError(f"the emulated board did not start within {_START_TIMEOUT:g} s")
        byte = process.stdout.read1(256)  # type: ignore[attr-defined]  # a BufferedReader, says the documentation
        if not byte:
            status = process.wait()
            errors.seek(0)
            said = errors.read().decode(errors="replace").strip().splitlines() or [f"exit status {status}"]
            raise (UsageError if status == USAGE else DeviceError)(
                f"the emulated board did not start: {said[-1].removeprefix('error: ')}"
            )
        line += byte
    return line.decode().strip()


def _end(process: subprocess.Popen[bytes]) -> None:
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            # It may be gone already.
            with contextlib.suppress(BrokenPipeError):
                pipe.close()
    for last_resort in (process.terminate, process.kill, None):
        try:
            process.wait(_END_TIMEOUT)
            return
        except subprocess.TimeoutExpired:
            if last_resort is not None:
                last_resort()
