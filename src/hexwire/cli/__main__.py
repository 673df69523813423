"""The program: `hexwire`, which is also `python -m hexwire.cli`.

Owns the moment before anything is loaded. Must not import anything slow itself.
"""

from __future__ import annotations

import signal

__all__ = ["main"]


def main() -> None:
    """Entry point of the program."""
    # As long as nothing is open there is nothing to make safe: Ctrl-C ends the program without a traceback.
    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if ours:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from .main import main as run

    if ours:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    run()


if __name__ == "__main__":
    main()
