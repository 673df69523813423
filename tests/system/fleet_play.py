"""A program: `hexwire fleet play FILE --on PATTERN` whose own threads hang as soon as a file exists.

    python -m tests.system.fleet_play HANGS FILE PATTERN

Its heartbeats go on, as those of a program do that waits for a lock, a full disk or a terminal.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

from hexwire.cli.__main__ import main
from hexwire.fleet.remote import RemoteRobot


def hang_with(file: Path) -> None:
    """Make the questions how a motion goes on wait for ever while the file exists."""
    goal = RemoteRobot.goal

    def hanging(self: RemoteRobot, number: int) -> Any:
        while file.exists():
            time.sleep(0.05)
        return goal(self, number)

    RemoteRobot.goal = hanging  # type: ignore[method-assign]  # a mistake in the program


if __name__ == "__main__":
    hangs, motion, pattern = sys.argv[1:]
    hang_with(Path(hangs))
    sys.argv = ["hexwire", "fleet", "play", motion, "--on", pattern, "--max-doubt", "250"]
    main()
