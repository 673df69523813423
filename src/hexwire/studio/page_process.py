"""A process of its own for what pages want of files: it takes no interpreter lock from the arm.

Owns that process: it begins when it is first needed, has one order at a time, is ended when it falls silent, and
ends with this program however that ends. Must not know what it does (`page_work`).
"""

from __future__ import annotations

import contextlib
import logging
import pickle
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from hexwire.errors import HexwireError

__all__ = ["BEAT", "PageProcess"]

_log = logging.getLogger(__name__)

BEAT = b"."
"""What the process sends now and then while it works; anything else is the pickled outcome."""
_SILENCE, _LONGEST = 15.0, 900.0
"""Seconds without a sign of life, and seconds of one order, after which the process is ended. Whatever it reads is
bounded by itself; a folder of recordings that nobody has listed yet may take minutes."""
_START = 45.0
"""Seconds more for its first sign of life: behind the arm, on a slow machine, it imports for long."""
_LOOK = 0.5


class PageProcess:
    """One such process. Any thread may call its methods; orders wait their turn.

    Args:
        arguments: Of `page_work`, asked when the process begins.
        silence: Seconds without a sign of life after which it is ended.
        longest: Seconds of one order.
    """

    def __init__(
        self,
        arguments: Callable[[], Sequence[str]],
        *,
        silence: float = _SILENCE,
        longest: float = _LONGEST,
    ) -> None:
        self._arguments, self._silence, self._longest = arguments, silence, longest
        self._turn = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._closed = threading.Event()
        self._heard = 0.0
        self._why = ""

    @property
    def pid(self) -> int | None:
        """Number of the process; None if there is none now."""
        process = self._process
        return None if process is None else process.pid

    def ask(self, what: str, *args: object) -> Any:
        """Have something done, and wait for it.

        Args:
            what: Name of a public method of `hexwire.studio.page_work.PageWork`.
            *args: Its arguments. Large ones are `bytes` of at most some 100 kB each: nobody waits for their copies.

        Raises:
            HexwireError: It was refused, or the process has ended meanwhile; the next call begins another one.
            OSError: A file failed.
        """
        with self._turn:
            if self._closed.is_set():
                raise HexwireError("the studio ends")
            process, self._heard = self._living(), time.monotonic()
            if process is None:
                process = self._begin()
                self._heard += _START
            self._process = process
            if self._closed.is_set():
                _end(process)
            assert process.stdin is not None
            assert process.stdout is not None
            try:
                with self._watched(process):
                    # Straight into the pipe: what waits for it does so without the interpreter's lock.
                    pickle.dump((what, args), process.stdin, pickle.HIGHEST_PROTOCOL)
                    process.stdin.flush()
                    while (sign := process.stdout.read(1)) == BEAT:
                        self._heard = time.monotonic()
                    if not sign:
                        raise EOFError
                    kind, value = pickle.load(process.stdout)  # from a program of our own
                if kind == "full":
                    # It ends; the next order must not meet it on its way out.
                    self._drop(process)
            except (OSError, EOFError, ValueError, pickle.UnpicklingError):
                status = self._drop(process)
                why = self._why or f"has ended with status {status}"
                _log.error("the process that reads and writes files for pages %s", why)
                raise HexwireError(f"the process that reads and writes files for pages {why}; try again") from None
            except BaseException:
                # It may wait for the rest of an order.
                self._drop(process)
                raise
        if kind == "done":
            return value
        if kind == "os":
            raise OSError(*value)
        text = str(value)
        raise HexwireError(text)

    def _drop(self, process: subprocess.Popen[bytes]) -> int:
        """End the process, so that the next order begins another one; its status."""
        self._process = None
        return _end(process)

    def _living(self) -> subprocess.Popen[bytes] | None:
        """The process, unless there is none or it has ended while it had nothing to do."""
        process = self._process
        if process is None or process.poll() is None:
            return process
        _log.warning("the process that reads and writes files for pages has ended with status %s", _end(process))
        return None

    def _begin(self) -> subprocess.Popen[bytes]:
        # -P: a file in the present folder must not stand in for a module. A session of its own: Ctrl-C is for this
        # program only. It inherits no file but these two pipes and stderr.
        command = [sys.executable, "-P", "-m", "hexwire.studio.page_work", *self._arguments()]
        priority = 0
        if sys.platform == "win32":
            priority = subprocess.BELOW_NORMAL_PRIORITY_CLASS
        try:
            return subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                start_new_session=True,
                creationflags=priority,
            )
        except OSError as error:
            raise HexwireError(f"no process for the files of pages can begin: {error.strerror or error}") from None

    @contextmanager
    def _watched(self, process: subprocess.Popen[bytes]) -> Iterator[None]:
        """End the process if it falls silent, or works too long, meanwhile."""
        over = threading.Event()
        began = time.monotonic()
        self._why = ""

        def watch() -> None:
            while not over.wait(_LOOK):
                now = time.monotonic()
                if now - self._heard > self._silence:
                    self._why = f"was silent for {self._silence:g} s and was ended"
                elif now - began > self._longest:
                    self._why = f"worked for {self._longest:g} s and was ended"
                else:
                    continue
                process.kill()
                return

        watcher = threading.Thread(target=watch, name="page process", daemon=True)
        watcher.start()
        try:
            yield
        finally:
            over.set()
            watcher.join()

    def close(self) -> None:
        """End the process for good. What it works at is given up, and whoever waits is told."""
        self._closed.set()
        process = self._process
        if process is not None:
            _end(process)


def _end(process: subprocess.Popen[bytes]) -> int:
    """End it; its status. It keeps nothing that its end would harm."""
    process.kill()
    status = process.wait()
    for pipe in (process.stdin, process.stdout):
        # What could not be written is of no use to anybody.
        with contextlib.suppress(OSError, ValueError):
            assert pipe is not None
            pipe.close()
    return status
