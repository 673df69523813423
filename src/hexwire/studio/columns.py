"""Columns of numbers as bytes, for the browser: what a plot shows at once.

Owns the layout, which `static/columns.js` reads. Pure. Must not know sockets or pages.

Little-endian: ``HWC1``, length of the head (u32), the head (JSON, UTF-8, padded with blanks so that what follows
begins at a multiple of 8), the times (f64), then each column (f32). The head has ``count``, the number of times,
and ``columns``, one name for each column. They are made and sent in parts, so that nothing holds the interpreter
for long: a whole history has 12 MB.
"""

from __future__ import annotations

import json
import sys
from array import array
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hexwire.control.history import History, Rows
    from hexwire.trace.series import Series

__all__ = ["history_columns", "serialize_columns", "series_columns", "transposed"]

_MAGIC = b"HWC1"
_PART = 32_768
"""Numbers in a part at most."""


def serialize_columns(
    head: dict[str, Any], times: array[float], columns: Sequence[tuple[str, array[float]]]
) -> list[bytes]:
    """Make the bytes, in parts.

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
        parts += [row[at : at + _PART].tobytes() for at in range(0, len(row), _PART)]
    return parts


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


def history_columns(history: History, after: float, offset: float) -> list[bytes]:
    """What is known of an arm, later than a time.

    Args:
        history: The last ten minutes.
        after: Seconds of the host's clock.
        offset: Seconds to add to the times for seconds since 1970; noted in the head.
    """
    rows = history.rows(after)
    names = [f"{joint}.{signal.name}" if joint else signal.name for joint, signal in history.columns]
    return serialize_columns({"offset": offset}, rows.times, list(zip(names, transposed(rows), strict=True)))


def series_columns(series: Series) -> list[bytes]:
    """A recording."""
    head = {"names": list(series.names), "begin": series.begin, "problem": series.problem}
    columns = [(f"{joint}.{quantity}", values) for (joint, quantity), values in series.columns.items()]
    return serialize_columns(head, series.times, columns)
