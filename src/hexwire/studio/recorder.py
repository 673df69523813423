"""Records what the open arm does into the folder of recordings.

Owns the thread that writes, so that the owner of the arm never waits for a disk, and the bounds of a recording.
Must not know pages.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hexwire.errors import HexwireError, UsageError
from hexwire.trace.recording import RecordingWriter

if TYPE_CHECKING:
    from hexwire.model.state import JointState
    from hexwire.trace.library import Library

    from .source import ArmSource

__all__ = ["LiveRecorder", "RecorderState"]

_log = logging.getLogger(__name__)

_WAITING = 2000
"""States that may wait for the disk: 20 s."""
_LONGEST = 3600.0
"""Seconds of a recording: nobody fills a disk by forgetting a button."""
_PATIENCE = 10.0


@dataclass(frozen=True, slots=True)
class RecorderState:
    """What is being recorded.

    Attributes:
        name: Name of the file; empty if nothing is being recorded.
        seconds: Since the start.
        states: Written so far.
        lost: States that the disk was too slow for.
        ended: How the last recording ended, in words; empty before the first.
    """

    name: str = ""
    seconds: float = 0.0
    states: int = 0
    lost: int = 0
    ended: str = ""


class LiveRecorder:
    """Records one arm at a time. Any thread may call its methods.

    Args:
        library: The folder.
    """

    def __init__(self, library: Library) -> None:
        self._library = library
        self._lock = threading.Lock()
        self._present: _Present | None = None
        self._ended = ""

    @property
    def state(self) -> RecorderState:
        """What is being recorded."""
        present = self._present
        if present is None or not present.active:
            return RecorderState(ended=present.ended if present is not None else self._ended)
        return RecorderState(
            present.name, time.monotonic() - present.began, present.count, present.lost, self._ended
        )

    def start(self, arm: ArmSource) -> str:
        """Begin to record; returns the name of the file.

        Raises:
            UsageError: Something is being recorded, the file cannot be created, or the package ``mcap`` is missing.
        """
        with self._lock:
            if self._present is not None and self._present.active:
                raise UsageError(f"{self._present.name} is being recorded; end it first")
            self._library.make_folder()
            robot = arm.settings.model.name
            name = self._library.new_name(robot)
            self._present = _Present(arm, name, RecordingWriter(self._library.path(name)), robot)
            return name

    def follow(self, arm: ArmSource | None) -> None:
        """End the recording if its arm is not open any more."""
        present = self._present
        if present is not None and present.arm is not arm:
            self.stop()

    def stop(self) -> str:
        """End the recording; returns how it ended, in words; empty if nothing was being recorded."""
        with self._lock:
            present, self._present = self._present, None
            if present is None:
                return ""
            self._ended = present.stop()
            return self._ended


class _Present:
    """One recording, and its thread."""

    def __init__(self, arm: ArmSource, name: str, writer: RecordingWriter, robot: str) -> None:
        self.name, self.ended = name, ""
        self.began = time.monotonic()
        self.count = self.lost = 0
        self.arm, self._writer, self._robot = arm, writer, robot
        self._offset = time.time() - arm.arm.owner.now()
        self._queue: queue.SimpleQueue[tuple[JointState, dict[str, float]] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)
        self._thread.start()
        arm.listeners = (*arm.listeners, self._see)

    @property
    def active(self) -> bool:
        return self._thread.is_alive()

    def _see(self, state: JointState, goals: Mapping[str, float]) -> None:
        # In the owner's thread.
        if self._queue.qsize() >= _WAITING:
            self.lost += 1
        else:
            self._queue.put((state, dict(goals)))

    def _run(self) -> None:
        why = ""
        try:
            while time.monotonic() - self.began < _LONGEST:
                item = self._queue.get()
                if item is None:
                    break
                state, goals = item
                extra = {"robot": self._robot} if not self.count else None
                self._writer.joint_state(state, state.stamp + self._offset, goals=goals, extra=extra)
                self.count += 1
            else:
                why = f" (no recording is longer than {_LONGEST / 60:.0f} minutes)"
        except (OSError, HexwireError) as error:
            why = f": {error}"
            _log.error("%s cannot be written: %s", self.name, error)
        self._forget()
        try:
            if self.count:
                self._writer.close()
                lost = f", {self.lost} lost" if self.lost else ""
                self.ended = f"{self.name}: {self.count} states{lost}{why}"
            else:
                self._writer.discard()
                self.ended = f"nothing was recorded{why}"
        except (OSError, HexwireError) as error:
            self.ended = f"{self.name} is incomplete: {error}"

    def _forget(self) -> None:
        self.arm.listeners = tuple(listener for listener in self.arm.listeners if listener != self._see)

    def stop(self) -> str:
        self._forget()
        self._queue.put(None)
        self._thread.join(_PATIENCE)
        return self.ended
