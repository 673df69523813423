"""The recordings of a studio: the folder, what is recorded now, the twin, motions made of recordings.

Owns joining them. Its calls may wait; any thread may make them. Must not know pages or requests, nor how a
recording is read: another process does that.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hexwire.errors import UsageError
from hexwire.motion.teach import Taught
from hexwire.trace.library import Library, recordings_folder

from .page_process import PageProcess
from .recorder import LiveRecorder
from .twin import Twin

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["Recordings"]

UPLOAD = 64 * 1024 * 1024
"""Bytes of a file that a page sends."""


class Recordings:
    """Recordings.

    Args:
        folder: Their folder; this user's if None.

    Attributes:
        library: The folder.
        recorder: Records the open arm.
        twin: Plays recordings on an emulated arm.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.library = Library(folder or recordings_folder(), largest=UPLOAD)
        self.recorder = LiveRecorder(self.library)
        self.twin = Twin()
        # Its own: what is to move waits for no export of a page.
        self._reader = self.process()

    def process(self) -> PageProcess:
        """A process that works in this folder; it begins when it is needed."""
        return PageProcess(lambda: (str(self.library.folder), str(self.library.largest)))

    def taught(self, name: str, topic: str | None, joints: Sequence[str]) -> Taught:
        """A recording as a motion of an arm's joints.

        Args:
            name: The recording.
            topic: Channel of its joint states.
            joints: The arm's joints; the recording may lack some.

        Raises:
            UsageError: It moves joints that the arm does not have.
            HexwireError: It cannot be read.
        """
        names, times, columns = self._reader.ask("positions", name, topic)
        unknown = [joint for joint in names if joint not in joints]
        if unknown:
            raise UsageError(f"{name} moves {', '.join(unknown)}; this arm has {', '.join(joints)}")
        return Taught.of(names, zip(times, zip(*columns, strict=True), strict=True))

    def twin_of(self, name: str) -> str:
        """The emulated arm that can play a recording, empty if none can; raises if it cannot be read."""
        return str(self._reader.ask("find", name))

    def close(self) -> None:
        """End what is being recorded or played."""
        self.recorder.stop()
        self.twin.stop("the studio ends")
        self._reader.close()
