"""Columns of numbers as bytes, for the browser: what a plot shows at once.

Owns the layout, which `static/columns.js` reads. Pure. Must not know sockets or pages.

Little-endian: ``HWC1``, length of the head (u32), the head (JSON, UTF-8, padded with blanks so that what follows
begins at a multiple of 8), the times (f64), then each column (f32). The head has ``count``, the number of times,
and ``columns``, one name for each column. A whole history has 12 MB: those are made in a process of their own
(`page_work`).
"""

from __future__ import annotations

import json
import sys
from array import array
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from hexwire.trace.series import column_name

if TYPE_CHECKING:
    from hexwire.control.requests.history import Rows
    from hexwire.trace.series import PlotSeries

__all__ = ["history_columns", "serialize_columns", "series_columns", "transposed"]

_MAGIC = b"HWC1"


def serialize_columns(
    head: dict[str, Any], times: array[float], columns: Sequence[tuple[str, array[float]]]
) -> bytes:
    """Make the bytes.

    Args:
        head: Further entries of the head.
        times: Doubles.
        columns: Pairs of name and single floats, as many as there are times.
    """
    text = json.dumps({**head, "count": len(times), "columns": [name for name, _ in columns]}, allow_nan=False)
    data = text.encode()
    data += b" " * (-(len(_MAGIC) + 4 + len(data)) % 8)
    parts = [_MAGIC, len(data).to_bytes(4, "little"), data]
    for row in (times, *(values for _, values in columns)):
        if sys.byteorder == "big":
            row = array(row.typecode, row)
            row.byteswap()
        parts.append(row.tobytes())
    return b"".join(parts)


def transposed(rows: Rows) -> list[array[float]]:
    """The columns of rows."""
    columns = [array("f") for _ in range(rows.width)]
    for block in rows.blocks:
        values = memoryview(block).cast("f")
        for i, column in enumerate(columns):
            column.frombytes(values[i :: rows.width].tobytes())
    if sys.byteorder == "big":
        for column in columns:
            column.byteswap()
    return columns


def history_columns(
    head: dict[str, Any], signals: Sequence[tuple[str, str]], rows: Rows, endings: tuple[str, ...] = ("",)
) -> bytes:
    """Rows of a history.

    Args:
        head: Further entries of the head.
        signals: Joint (empty for the whole arm) and signal of each value of a row.
        rows: The rows.
        endings: Only columns whose names end so.
    """
    pairs = zip((column_name(*signal) for signal in signals), transposed(rows), strict=True)
    return serialize_columns(head, rows.times, [pair for pair in pairs if pair[0].endswith(endings)])


def series_columns(series: PlotSeries) -> bytes:
    """A recording."""
    head = {"names": list(series.names), "begin": series.begin, "problem": series.problem}
    columns = [(f"{joint}.{quantity}", values) for (joint, quantity), values in series.columns.items()]
    return serialize_columns(head, series.times, columns)
