"""Recordings as columns for plots, and two of them on one time axis.

Owns which recordings are in memory, in the process for the files of pages (`page_work`). Must not know pages or
requests.
"""

from __future__ import annotations

import math
from array import array
from collections import OrderedDict
from typing import TYPE_CHECKING, Any

from hexwire.errors import UsageError
from hexwire.motion.compare import best_lag, compare

from .columns import serialize_columns

if TYPE_CHECKING:
    from hexwire.trace.library import Library
    from hexwire.trace.series import PlotSeries

__all__ = ["Plotted"]

_MOST_KEPT = 3
"""Recordings in memory."""


class Plotted:
    """Recordings to plot. Not thread-safe.

    Args:
        library: The folder.
    """

    def __init__(self, library: Library) -> None:
        self._library = library
        self._kept: OrderedDict[tuple[object, ...], PlotSeries] = OrderedDict()

    def series(self, name: str, topic: str | None = None) -> PlotSeries:
        """The columns of a recording; raises as `Library.series`."""
        found = self._library.find(name)
        if topic is None and found.topics:
            topic = found.topics[0]
        key = (name, topic, found.size, found.changed)
        series = self._kept.pop(key, None) or self._library.series(name, topic)
        self._kept[key] = series
        while len(self._kept) > _MOST_KEPT:
            self._kept.popitem(last=False)
        return series

    def compared(self, a: tuple[str, str | None], b: tuple[str, str | None], align: str, lag: float = 0.0) -> bytes:
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


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
