"""The programs: `hexwire`, which is also `python -m hexwire.cli`, and `hexwire-ros1`.

Owns the moment before anything is loaded. Must not import anything slow itself.
"""

from __future__ import annotations

import importlib
import signal

__all__ = ["main", "ros1"]


def main() -> None:
    """Entry point of `hexwire`."""
    _start("main")


def ros1() -> None:
    """Entry point of `hexwire-ros1`."""
    _start("ros1")


def _start(name: str) -> None:
    # While nothing is open there is nothing to make safe: Ctrl-C ends the program without a traceback.
    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if ours:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    program = importlib.import_module(f"hexwire.cli.{name}")
    if ours:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    program.main()


if __name__ == "__main__":
    main()
