"""The programs: `hexwire`, which is also `python -m hexwire.cli`, `hexwire-ros1` and `hexwire-ros2`.

Owns the moment before anything is loaded. Must not import anything slow itself.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import signal
import sys

__all__ = ["main", "ros1", "ros2"]


def main() -> None:
    """Entry point of `hexwire`."""
    _start("main")


def ros1() -> None:
    """Entry point of `hexwire-ros1`."""
    _start("ros1")


def ros2() -> None:
    """Entry point of `hexwire-ros2`."""
    _start("ros2")


def _start(name: str) -> None:
    # While nothing is open there is nothing to make safe: Ctrl-C ends the program without a traceback.
    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if ours:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    program = importlib.import_module(f"hexwire.cli.{name}")
    if ours:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        program.main()
    except SystemExit as end:
        if "zenoh" in sys.modules:
            _end_at_once(end.code)
        raise


def _end_at_once(code: object) -> None:
    """End without the interpreter's shutdown, which aborts if a thread is inside Zenoh. All is closed by now."""
    for stream in (sys.stdout, sys.stderr):
        # Closed, or nobody reads it any more.
        with contextlib.suppress(AttributeError, OSError, ValueError):
            stream.flush()
    os._exit(code if isinstance(code, int) else 0 if code is None else 1)


if __name__ == "__main__":
    main()
