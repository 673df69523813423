"""What goes on during a ``with`` block: a hand that teaches the arm, and a recording.

Owns when they begin and end, and what is kept of them. Must not know the format of a file.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING

from hexwire.control.requests.teach_mode import record_by_hand
from hexwire.errors import UsageError
from hexwire.motion.teach import Taught
from hexwire.trace.recording import RecordingWriter, check_recording_name, wall_time

from .handle import Handle

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
        writer: Around what is done: gives what keeps its states, or None.
        limp: Leave torque off at the end.
        rate: States per second.
        seconds: When to end.
        claim: That the arm is taught.
        telling: Around what is done: for whom errors are worded.

    Raises:
        HexwireError: The arm keeps its torque.
    """

    def __init__(
        self,
        robot: RobotDriver,
        writer: AbstractContextManager[RecordingWriter | None],
        limp: bool,
        rate: float,
        seconds: float,
        claim: Claim,
        telling: Callable[[], AbstractContextManager[None]],
    ) -> None:
        self._states: list[JointState] = []
        self._begun = threading.Event()
        self._limp, self._rate, self._seconds = limp, rate, seconds
        self._writer, self._telling = writer, telling
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
        def keep(state: JointState) -> None:
            if len(self._states) < _MOST_STATES:
                self._states.append(state)
            if writer is not None:
                writer.joint_state(state, wall_time(state))

        with self._telling(), self._writer as writer:
            record_by_hand(
                self._robot,
                keep,
                rate=self._rate,
                duration=self._seconds,
                torque_off_at_end=self._limp,
                on_start=self._begun.set,
                ended=ending.is_set,
            )


class Recording(Handle[int]):
    """Records states until `end`, which returns their number, or the end of the ``with`` block.

    Args:
        robot: The arm.
        file: Where they are kept.
        writer: Keeps them there.
        states: Returns the states to record.

    Attributes:
        file: Where they are kept.
        states: Those of so far; of a long recording the first 500,000.
    """

    def __init__(
        self,
        robot: RobotDriver,
        file: str | Path,
        writer: RecordingWriter,
        states: Callable[[], Iterator[JointState]],
    ) -> None:
        self.file = Path(file)
        self.states: list[JointState] = []
        self._writer, self._next = writer, states
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


def recording_writer(
    file: str | Path, force: bool, telling: Callable[[], AbstractContextManager[None]]
) -> RecordingWriter:
    """A new recording; `force` replaces a file of that name. Raises `UsageError` if it cannot be written."""
    check_recording_name(file)
    with telling():
        return RecordingWriter(file, force=force)
