"""What goes on during a ``with`` block: a hand that teaches the arm, and a recording.

Owns when they begin and end, and what is kept of them. Must not know how an arm is guided, nor the format of
a file.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from hexwire.control.teach_mode import record_by_hand
from hexwire.errors import UsageError
from hexwire.motion.teach import Taught
from hexwire.trace.recording import RecordingWriter, check_recording_name, wall_time

from .handle import Handle, told

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.state import JointState

__all__ = ["Lesson", "Recording", "recording_writer"]

_MOST_STATES = 500_000
"""Most states that are kept in memory: several hours."""


class Lesson(Handle[None]):
    """A hand guides the arm, which has no torque, until `end` or the end of the ``with`` block.

    Args:
        robot: The arm.
        writer: Keeps its states; nothing does if None.
        limp: Leave torque off at the end.
        on_end: Is called at the end.

    Raises:
        HexwireError: The arm keeps its torque.
    """

    def __init__(
        self, robot: RobotDriver, writer: RecordingWriter | None, limp: bool, on_end: Callable[[], object]
    ) -> None:
        self._states: list[JointState] = []
        self._begun = threading.Event()
        self._how = (robot, limp, on_end)
        self._writer = writer
        super().__init__(robot, "lesson", self._record)
        while not self._begun.wait(0.01):
            if self.done:
                self.wait()

    @property
    def taught(self) -> Taught:
        """What was recorded so far.

        Raises:
            UsageError: Nothing was.
        """
        names = max((state.names for state in self._states), key=len, default=())
        rows = [(state.stamp, state.position) for state in self._states if state.names == names]
        return Taught.of(names, rows)

    def _record(self, ending: threading.Event) -> None:
        robot, limp, on_end = self._how
        writer = self._writer

        def keep(state: JointState) -> None:
            if len(self._states) < _MOST_STATES:
                self._states.append(state)
            if writer is not None:
                writer.joint_state(state, wall_time(state))

        try:
            with told(), writer or nullcontext():
                record_by_hand(robot, keep, torque_off_at_end=limp, on_start=self._begun.set, ended=ending.is_set)
        finally:
            on_end()


class Recording(Handle[int]):
    """Records states until `end`, which returns their number, or the end of the ``with`` block.

    Args:
        robot: The arm.
        file: Where they are kept.
        force: Replace such a file.
        states: Returns the states to record.

    Attributes:
        file: Where they are kept.
        states: Those of so far; of a long recording the first 500,000.

    Raises:
        UsageError: The file exists, or cannot be written.
    """

    def __init__(
        self, robot: RobotDriver, file: str | Path, force: bool, states: Callable[[], Iterator[JointState]]
    ) -> None:
        self.file = Path(file)
        self.states: list[JointState] = []
        self._writer, self._next = recording_writer(file, force), states
        super().__init__(robot, "recording", self._record)

    def _record(self, ending: threading.Event) -> int:
        with self._writer as writer:
            for state in self._next():
                writer.joint_state(state, wall_time(state))
                if len(self.states) < _MOST_STATES:
                    self.states.append(state)
                if ending.is_set():
                    break
            return writer.count


def recording_writer(file: str | Path, force: bool) -> RecordingWriter:
    """A new recording; `force` replaces a file of that name. Raises `UsageError` if it cannot be written."""
    check_recording_name(file)
    try:
        return RecordingWriter(file, force=force)
    except UsageError as error:
        raise UsageError(str(error).replace("--force", "force=True")) from None
