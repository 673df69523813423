"""What a hand does with the arm, taken from its states and kept as a small trajectory.

Owns the recording and its file. Pure but for writing that file; time comes with the states. Must not know
messages, drivers or clocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from hexwire.model.state import JointState
from hexwire.motion.teach import Taught

__all__ = ["Teacher", "save", "simplified"]


class Teacher:
    """Records states.

    Args:
        limit: Seconds after which nothing more is taken.
        tolerance: Radians by which the result may differ from a sample.
    """

    def __init__(self, limit: float = 600.0, tolerance: float = 0.0035) -> None:
        self.limit = limit
        self.tolerance = tolerance
        self.active = False
        self.full = False

    def start(self, names: Sequence[str], now: float) -> None:
        """Begin anew."""
        raise NotImplementedError

    def take(self, state: JointState) -> None:
        """Take a state."""
        raise NotImplementedError

    def finish(self) -> Taught:
        """End the recording and give what was taught."""
        raise NotImplementedError


def simplified(taught: Taught, tolerance: float) -> Taught:
    """With fewer points, none of the others further off than `tolerance` radians."""
    raise NotImplementedError


def save(taught: Taught, folder: Path, when: datetime) -> Path:
    """Write a file that `hexwire play` takes."""
    raise NotImplementedError
