"""Bags of ROS 2, in files that are made as safely as a recording.

Owns the folder and its files; `zenoh_ros2` has what is in them. Needs the package ``mcap``, imported on first use.
"""

from __future__ import annotations

import stat
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hexwire.errors import UsageError
from hexwire.new_file import OutputFile
from hexwire.trace.mcap_file import NewMcapFile, load_mcap
from zenoh_ros2 import DEFAULT, Qos
from zenoh_ros2.bag import METADATA, PROFILE, BagMessages, mcap_name

from .wire import own_errors

if TYPE_CHECKING:
    from zenoh_ros2 import Types

__all__ = ["BagWriter"]


class BagWriter(NewMcapFile):
    """Writes a bag; use it as a context manager, or `close` it.

    Args:
        folder: The bag. Only its owner can read the files in it.
        types: The distribution's; its name is stored.
        force: Overwrite an existing bag of this name.

    Attributes:
        folder: The bag.
        count: Messages written.

    Raises:
        UsageError: The folder exists already or cannot be created, or the package ``mcap`` is not installed.
    """

    def __init__(self, folder: str | Path, types: Types, *, force: bool = False) -> None:
        load_mcap("mcap.writer")
        self.folder = Path(folder)
        self._force = force
        file = mcap_name(self.folder)
        self._made = _make_folder(self.folder, {file, METADATA}, force)
        try:
            super().__init__(self.folder / file, PROFILE, force=force)
        except UsageError:
            self._remove_folder()
            raise
        self._messages = BagMessages(self._writer, file, types)

    def write(self, topic: str, message_type: str, message: Any, stamp: int, qos: Qos = DEFAULT) -> None:
        """Write a message; see `zenoh_ros2.bag.BagMessages.write`.

        Raises:
            LocalProtocolError: The message has an unsuitable value.
            OSError: It cannot be written; nor can anything after it.
        """
        with self._writing(), own_errors():
            self._messages.write(topic, message_type, message, stamp, qos)
        self.count += 1

    def close(self) -> None:
        """Finish the bag. Does nothing if it is finished; after a write error, its MCAP file stays truncated.

        Raises:
            OSError: The end cannot be written.
            UsageError: Another program has put a file there meanwhile.
        """
        if self._closed:
            return
        super().close()
        if self._failed is None:
            with OutputFile(self.folder / METADATA, force=self._force) as out:
                out.file.write(self._messages.metadata().encode())

    def discard(self) -> None:
        """Delete the bag. Does nothing if it is finished."""
        if not self._closed:
            super().discard()
            self._remove_folder()

    def _remove_folder(self) -> None:
        if self._made:
            with suppress(OSError):
                self.folder.rmdir()


def _make_folder(folder: Path, files: set[str], force: bool) -> bool:
    """Make the folder of a bag; return whether it is new."""
    if folder.name in ("", ".."):
        raise UsageError(f"{folder} has no name; name a new folder")
    try:
        folder.mkdir()
    except FileExistsError:
        if not stat.S_ISDIR(folder.lstat().st_mode):
            raise UsageError(f"{folder} is not a folder; choose another name") from None
        if not force:
            raise UsageError(f"{folder} already exists; --force overwrites it") from None
        if others := sorted({path.name for path in folder.iterdir()} - files):
            raise UsageError(f"{folder} is not overwritten: it also has {others[0]}") from None
        return False
    except OSError as error:
        raise UsageError(f"{folder} cannot be created: {error.strerror}; choose another place") from None
    return True
