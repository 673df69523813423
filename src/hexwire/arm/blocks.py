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

    from .claim import Claim

__all__ = ["Lesson", "Recording", "recording_writer"]

_MOST_STATES = 500_000
"""Most states that are kept in memory: several hours."""


class Lesson(Handle[None]):
    """A hand guides the arm, which has no torque, until `end` or the end of the ``with`` block.

    Args:
        robot: The arm.
        writer: Keeps its states; nothing does if None.
        limp: Leave torque off at the end.
        claim: That the arm is taught.

    Raises:
        HexwireError: The arm keeps its torque.
    """

    def __init__(self, robot: RobotDriver, writer: RecordingWriter | None, limp: bool, claim: Claim) -> None:
        self._states: list[JointState] = []
        self._begun = threading.Event()
        self._limp = limp
        self._writer = writer
        super().__init__(robot, "lesson", self._record, claim)
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

    def played(self) -> Taught:
        """What `Arm.play` plays of it; raises as `taught`."""
        return self.taught

    def _record(self, ending: threading.Event) -> None:
        writer = self._writer

        def keep(state: JointState) -> None:
            if len(self._states) < _MOST_STATES:
                self._states.append(state)
            if writer is not None:
                writer.joint_state(state, wall_time(state))

        limp, begun = self._limp, self._begun.set
        with told(), writer or nullcontext():
            record_by_hand(self._robot, keep, torque_off_at_end=limp, on_start=begun, ended=ending.is_set)


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

    def played(self) -> Path:
        """What `Arm.play` plays of it.

        Raises:
            UsageError: It is not over.
        """
        if not self.done:
            raise UsageError("the recording goes on: end() it before it is played")
        return self.file

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
    with told():
        return RecordingWriter(file, force=force)
