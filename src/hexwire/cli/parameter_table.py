"""The table of parameters in the help of a ROS node.

Owns its columns.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hexwire.control.requests.setting import Setting

__all__ = ["table"]

_WIDTH = 112
_LONGEST = 40
"""Longest first column; a longer one has a line of its own."""


def table(rows: Iterable[tuple[str, Setting]]) -> str:
    """The lines of the table.

    Args:
        rows: How users write each parameter with its default, and the parameter.
    """
    rows = list(rows)
    width = max(len(name) for name, _ in rows if len(name) <= _LONGEST) + 4
    lines = []
    for name, row in rows:
        first = f"  {name}".ljust(width)
        if len(first) > width:
            lines.append(first)
            first = " " * width
        lines += textwrap.wrap(row.description, _WIDTH, initial_indent=first, subsequent_indent=" " * width)
    return "\n".join(lines)
