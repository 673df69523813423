"""Runs `hexwire-ros1` or `hexwire-ros2` for a test: python -m tests.patient_node ros1 ARGUMENTS...

Its board is in the process of the test, and a busy machine lets that or the node wait for longer than the three
times 0.2 s after which a board counts as lost, and than the second after which its state is old.
"""

from __future__ import annotations

import importlib
import sys

from hexwire.wire import tables

REPLY_WINDOW = 3.0
FRESH = 10.0


def main() -> None:
    # Before anything reads it.
    tables.DIALECT2_REPLY_WINDOW = REPLY_WINDOW
    from hexwire.control.loop import owner
    from hexwire.session.policy import RetryPolicy

    assert RetryPolicy().window == REPLY_WINDOW
    assert owner._FRESH < FRESH
    owner._FRESH = FRESH
    importlib.import_module(f"hexwire.cli.{sys.argv.pop(1)}").main()


if __name__ == "__main__":
    main()
