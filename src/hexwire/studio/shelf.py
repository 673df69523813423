"""The recordings of a studio: the folder, what is recorded now, columns for plots, comparisons, the twin.

Owns which of them are in memory. Its calls may wait; any thread may make them. Must not know pages or requests.
"""

from __future__ import annotations

import math
import threading
from array import array
from collections import OrderedDict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hexwire.errors import UsageError
from hexwire.motion.compare import best_lag, compare
from hexwire.motion.teach import Taught
from hexwire.trace.library import Library, recordings_folder

from .columns import serialize_columns
from .recorder import LiveRecorder
from .twin import Twin

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hexwire.trace.series import Series

__all__ = ["Shelf"]

_MOST_KEPT = 3
"""Recordings in memory."""
UPLOAD = 64 * 1024 * 1024
"""Bytes of a file that a page sends."""


class Shelf:
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
        self._kept: OrderedDict[tuple[object, ...], Series] = OrderedDict()
        self._lock = threading.Lock()

    def series(self, name: str, topic: str | None = None) -> Series:
        """The columns of a recording; raises as `Library.series`."""
        found = self.library.find(name)
        if topic is None and found.topics:
            topic = found.topics[0]
        key = (name, topic, found.size, found.changed)
        # One at a time: a page asks again while the first answer is being made.
        with self._lock:
            series = self._kept.pop(key, None) or self.library.series(name, topic)
            self._kept[key] = series
            while len(self._kept) > _MOST_KEPT:
                self._kept.popitem(last=False)
        return series

    def taught(self, name: str, topic: str | None, joints: Sequence[str]) -> Taught:
        """A recording as a motion of an arm's joints.

        Args:
            name: The recording.
            topic: Channel of its joint states.
            joints: The arm's joints; the recording may lack some.

        Raises:
            UsageError: It moves joints that the arm does not have.
        """
        series = self.series(name, topic)
        unknown = [joint for joint in series.names if joint not in joints]
        if unknown:
            raise UsageError(f"{name} moves {', '.join(unknown)}; this arm has {', '.join(joints)}")
        return Taught.of(series.names, series.positions())

    def compared(
        self, a: tuple[str, str | None], b: tuple[str, str | None], align: str, lag: float = 0.0
    ) -> list[bytes]:
        """Two recordings on one time axis, as columns: for each joint both angles and the difference, in radians.

        Args:
            a: Name and channel of the first.
            b: Of the second.
            align: ``start``, ``best`` (the lag at which they agree best), or ``lag`` (as given).
            lag: Seconds that the second one is later.

        Raises:
            UsageError: They have no joint in common, do not overlap, or `align` is none of these.
        """
        first, second = self.series(*a), self.series(*b)
        names = [name for name in first.names if name in second.names]
        if not names:
            raise UsageError("the two recordings have no joint in common")
        rows = first.positions(names), second.positions(names)
        if align == "best":
            lag = best_lag(*rows)
        elif align == "start":
            lag = 0.0
        elif align != "lag" or not math.isfinite(lag):
            raise UsageError("align by start, best, or a lag in seconds")
        found = compare(names, *rows, lag)
        columns = []
        for i, name in enumerate(names):
            one = array("f", [row[i] for row in found.first])
            other = array("f", [row[i] + d[i] for row, d in zip(found.first, found.differences, strict=True)])
            columns += [
                (f"{name}.first", one),
                (f"{name}.second", other),
                (f"{name}.difference", array("f", [row[i] for row in found.differences])),
            ]
        head: dict[str, Any] = {
            "names": names,
            "lag": found.lag,
            "joints": [
                {
                    "name": joint.name,
                    "rms": _known(joint.rms),
                    "largest": _known(joint.largest),
                    "at": _known(joint.at),
                }
                for joint in found.joints
            ],
            "left_out": [name for name in (*first.names, *second.names) if name not in names],
        }
        return serialize_columns(head, array("d", found.times), columns)

    def close(self) -> None:
        """End what is being recorded or played."""
        self.recorder.stop()
        self.twin.stop("the studio ends")


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
