"""Records what the open arm does, and what cameras see of it, into the folder of recordings.

Owns the thread that writes, so that the owner of the arm never waits for a disk, and the bounds of a recording.
Must not know pages.
"""

from __future__ import annotations

import logging
import queue
import shutil
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from hexwire.errors import HexwireError, UsageError
from hexwire.trace.recording import RecordingWriter

from .cameras import CameraPicture

if TYPE_CHECKING:
    from hexwire.model.state import JointState
    from hexwire.trace.library import Library

    from .cameras import Camera, OnPicture
    from .source import ArmSource

__all__ = ["LiveRecorder", "RecorderState"]

_log = logging.getLogger(__name__)

_WAITING = 2000
"""States that may wait for the disk: 20 s."""
_PICTURES = 32
"""Pictures that may wait for the disk: half a second of four cameras, at most 32 MiB."""
_LONGEST = 3600.0
"""Seconds of a recording: nobody fills a disk by forgetting a button."""
_LARGEST = 4 << 30
"""Bytes of a recording, for the same reason: an hour of one camera has about 2.5 GB."""
_FREE = 1 << 30
"""Bytes of the disk that a recording leaves free."""
_LOOK = 1.0
"""Seconds between two looks at that."""
_PATIENCE = 10.0


@dataclass(frozen=True, slots=True)
class RecorderState:
    """What is being recorded.

    Attributes:
        name: Name of the file; empty if nothing is being recorded.
        seconds: Since the start.
        states: Written so far.
        lost: States and pictures that the disk was too slow for.
        pictures: Written so far.
        size: Bytes of the file so far.
        problems: Why cameras give no picture now, by name.
        ended: How the last recording ended, in words; empty before the first.
    """

    name: str = ""
    seconds: float = 0.0
    states: int = 0
    lost: int = 0
    pictures: int = 0
    size: int = 0
    problems: dict[str, str] = field(default_factory=dict)
    ended: str = ""


class LiveRecorder:
    """Records one arm at a time. Any thread may call its methods.

    Args:
        library: The folder.
        largest: Bytes of a recording, after which it ends.
        free: Bytes of the disk that a recording leaves free.
    """

    def __init__(self, library: Library, *, largest: int = _LARGEST, free: int = _FREE) -> None:
        self._library, self._largest, self._free = library, largest, free
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
            present.name,
            time.monotonic() - present.began,
            present.count,
            present.lost,
            present.pictures,
            present.size,
            {camera.name: camera.problem for camera in present.cameras if camera.problem},
            self._ended,
        )

    def start(self, arm: ArmSource, cameras: Iterable[Camera] = ()) -> str:
        """Begin to record; returns the name of the file.

        Args:
            arm: The arm.
            cameras: Their pictures are recorded, too, with the time of the states.

        Raises:
            UsageError: Something is being recorded, the file cannot be created, or the package ``mcap`` is missing.
        """
        with self._lock:
            if self._present is not None and self._present.active:
                raise UsageError(f"{self._present.name} is being recorded; end it first")
            self._library.make_folder()
            robot = arm.settings.model.name
            name = self._library.new_name(robot)
            writer = RecordingWriter(self._library.path(name))
            self._present = _Present(arm, name, writer, robot, tuple(cameras), self._bound)
            return name

    def _bound(self, size: int) -> str:
        """Why a recording of so many bytes ends; empty if it goes on."""
        if size > self._largest:
            return f" (no recording is larger than {self._largest / 2**30:.0f} GiB)"
        if shutil.disk_usage(self._library.folder).free < self._free:
            return f" (the disk has less than {self._free / 2**30:.0f} GiB left)"
        return ""

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

    def __init__(
        self,
        arm: ArmSource,
        name: str,
        writer: RecordingWriter,
        robot: str,
        cameras: tuple[Camera, ...],
        bound: Callable[[int], str],
    ) -> None:
        self.name, self.ended = name, ""
        self.began = time.monotonic()
        self.count = self.lost = self.pictures = self.size = 0
        self.arm, self.cameras = arm, cameras
        self._writer, self._robot, self._bound = writer, robot, bound
        wall = time.time()
        self._offset, self._picture_offset = wall - arm.arm.owner.now(), wall - time.monotonic()
        self._queue: queue.SimpleQueue[tuple[JointState, dict[str, float]] | tuple[str, CameraPicture] | None]
        self._queue = queue.SimpleQueue()
        self._room = threading.Semaphore(_PICTURES)
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)
        self._thread.start()
        arm.listeners = (*arm.listeners, self._see)
        self._looks = [camera.look(self._looker(camera.name)) for camera in cameras]

    @property
    def active(self) -> bool:
        return self._thread.is_alive()

    def _see(self, state: JointState, goals: Mapping[str, float]) -> None:
        # In the owner's thread.
        if self._queue.qsize() >= _WAITING:
            self.lost += 1
        else:
            self._queue.put((state, dict(goals)))

    def _looker(self, camera: str) -> OnPicture:
        def see(picture: CameraPicture | None, why: str) -> None:
            # In the thread of the camera.
            if picture is None:
                return
            if self._room.acquire(blocking=False):
                self._queue.put((camera, picture))
            else:
                self.lost += 1

        return see

    def _run(self) -> None:
        why, looked = "", self.began
        try:
            while not why:
                item = self._queue.get()
                if item is None:
                    break
                self._write(*item)
                now = time.monotonic()
                if now - self.began >= _LONGEST:
                    why = f" (no recording is longer than {_LONGEST / 60:.0f} minutes)"
                elif now - looked >= _LOOK:
                    looked, self.size = now, self._writer.size
                    why = self._bound(self.size)
        except (OSError, HexwireError) as error:
            why = f": {error}"
            _log.error("%s cannot be written: %s", self.name, error)
        self._forget()
        try:
            if self._writer.count:
                self._writer.close()
                seen = f", {self.pictures} pictures" if self.cameras else ""
                lost = f", {self.lost} lost" if self.lost else ""
                self.ended = f"{self.name}: {self.count} states{seen}{lost}{why}"
            else:
                self._writer.discard()
                self.ended = f"nothing was recorded{why}"
        except (OSError, HexwireError) as error:
            self.ended = f"{self.name} is incomplete: {error}"

    def _write(self, what: JointState | str, rest: dict[str, float] | CameraPicture) -> None:
        if isinstance(what, str):
            assert isinstance(rest, CameraPicture)
            self._room.release()
            self._writer.picture(rest.jpeg, what, rest.stamp + self._picture_offset)
            self.pictures += 1
            return
        assert isinstance(rest, dict)
        extra = {"robot": self._robot} if not self.count else None
        self._writer.joint_state(what, what.stamp + self._offset, goals=rest, extra=extra)
        self.count += 1

    def _forget(self) -> None:
        self.arm.listeners = tuple(listener for listener in self.arm.listeners if listener != self._see)
        for end in self._looks:
            end()

    def stop(self) -> str:
        self._forget()
        self._queue.put(None)
        self._thread.join(_PATIENCE)
        return self.ended
