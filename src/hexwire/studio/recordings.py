"""The recordings of a studio: the folder, what is recorded now, the twin, motions made of recordings.

Owns joining them. Its calls may wait; any thread may make them. Must not know pages or requests, nor how a
recording is read: another process does that.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hexwire.errors import UsageError
from hexwire.inputs import Item
from hexwire.motion.teach import Taught
from hexwire.trace.library import Library, recordings_folder

from .page_process import PageProcess
from .recorder import LiveRecorder
from .twin import Twin

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

__all__ = ["Recordings"]

UPLOAD = 64 * 1024 * 1024
"""Bytes of a file that a page sends."""
_KEPT = 500_000
"""Angles of a recording that is kept for the next question: 20 minutes of seven joints; 20 MB."""


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
        self._last: tuple[object, Taught] | None = None

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
        found = self._read(name, topic)
        unknown = [joint for joint in found.names if joint not in joints]
        if unknown:
            raise UsageError(f"{name} moves {', '.join(unknown)}; this arm has {', '.join(joints)}")
        return found

    def asked(self, motion: Mapping[str, object], joints: Sequence[str]) -> tuple[dict[str, object], Taught | None]:
        """The motion that a page asks for, and the recording that it names; None if it names none.

        Args:
            motion: As `read_motion` takes it, and maybe ``recording`` and ``topic``.
            joints: As for `taught`.

        Raises:
            UsageError: One of these is no text.
            HexwireError: As `taught`.
        """
        args = dict(motion)
        name, topic = (_text_or_none(key, args.pop(key, None)) for key in ("recording", "topic"))
        return args, None if name is None else self.taught(name, topic, joints)

    def _read(self, name: str, topic: str | None) -> Taught:
        """Read a recording, unless it is the one of before: while it is edited, each change asks for it."""
        there = self.library.path(name).stat() if self.library.path(name).is_file() else None
        key = name, topic, there and (there.st_ino, there.st_size, there.st_mtime_ns)
        last = self._last
        if last is not None and last[0] == key:
            return last[1]
        names, times, columns = self._reader.ask("positions", name, topic)
        found = Taught.of(names, zip(times, zip(*columns, strict=True), strict=True))
        if len(found.times) * len(found.names) <= _KEPT:
            self._last = key, found
        return found

    def twin_of(self, name: str) -> str:
        """The emulated arm that can play a recording, empty if none can; raises if it cannot be read."""
        return str(self._reader.ask("find", name))

    def close(self) -> None:
        """End what is being recorded or played."""
        self.recorder.stop()
        self.twin.stop("the studio ends")
        self._reader.close()


def _text_or_none(key: str, value: object) -> str | None:
    """What a page names: None if it names nothing. Anything else is refused: else the taught motion is played."""
    if value is None or isinstance(value, str):
        return value or None
    raise Item(value, where=key).wrong_kind("text")
