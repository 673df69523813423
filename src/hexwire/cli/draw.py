"""What is drawn on a terminal: tables of joints, the demo. The one place of these that knows rich.

Owns colours and columns. Must not know robots or commands.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich import box
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from .demo import Sample

__all__ = ["LiveView", "joint_table"]

_REDRAWS = 12
"""Drawings a second: enough to look alive."""
_GOOD, _FAIR = 2.0, 5.0
"""Degrees off the trajectory that still look good, or fair: a servo trails by about a cycle."""


def joint_table(head: Sequence[str], rows: Sequence[Sequence[str | Text]], faulty: Sequence[bool]) -> Table:
    """A table whose first column is the joint; the numbers behind it are aligned to the right.

    Args:
        head: Titles.
        rows: Cells, one row a joint.
        faulty: Which rows are to be shown as bad.
    """
    table = Table(box=box.SIMPLE_HEAD, header_style="bold", pad_edge=False)
    for i, title in enumerate(head):
        left = i == 0 or title == "condition"
        table.add_column(Text(title), justify="left" if left else "right", no_wrap=True)
    for row, bad in zip(rows, faulty, strict=True):
        name, *cells = row
        style = "bold red" if bad else ""
        table.add_row(Text(str(name), style=style or "bold cyan"), *(_cell(cell, style) for cell in cells))
    return table


def _cell(cell: str | Text, style: str) -> Text:
    return cell if isinstance(cell, Text) else Text(cell, style=style or ("dim" if cell == "-" else ""))


def _plain(value: float) -> float:
    # To one digit at most, and never "-0.0", which would have a reader look for a meaning.
    return round(value, 1) + 0.0


class LiveView:
    """The demo on a terminal: a live table and a progress bar.

    They are drawn in a thread of their own, so that a slow terminal never holds up the loop that moves the arm.
    """

    def __init__(self, console: Console | None = None) -> None:
        self._console = console or Console(highlight=False)
        self._sample: Sample | None = None

    def say(self, phase: str, text: str) -> None:
        """Print a phase above the table."""
        line = Text.assemble((f"{phase:>10}", "bold green"), "  ", text)
        self._console.print(line, soft_wrap=True)

    def moving(self) -> Live:
        """Draw while the arm moves."""
        return Live(get_renderable=self.render, console=self._console, refresh_per_second=_REDRAWS)

    def show(self, sample: Sample) -> None:
        """Take a cycle; it is drawn when it is time to."""
        self._sample = sample

    def render(self) -> RenderableType:
        """What is on the terminal now."""
        sample = self._sample
        if sample is None:
            return Text("")
        rows, faulty = [], []
        for joint, target in zip(sample.state, sample.target, strict=True):
            off = math.degrees(joint.position - target)
            style = "green" if abs(off) < _GOOD else "yellow" if abs(off) < _FAIR else "red"
            rows.append(
                (
                    joint.name,
                    f"{_plain(math.degrees(target)):.1f}",
                    f"{_plain(math.degrees(joint.position)):.1f}",
                    Text(f"{_plain(off):+.1f}", style=style),
                    f"{_plain(round(100 * joint.load)):+.0f}" if math.isfinite(joint.load) else "-",
                    f"{1000 * joint.age:.0f}" if math.isfinite(joint.age) else "-",
                )
            )
            faulty.append(bool(joint.flags.faults))
        head = ("joint", "target deg", "position deg", "error deg", "load %", "age ms")
        return Group(joint_table(head, rows, faulty), self._bar(sample))

    def _bar(self, sample: Sample) -> RenderableType:
        line = Table.grid(padding=(0, 1))
        way = "there" if sample.time < sample.duration / 2 else "back"
        line.add_row(
            Text(f"{way:5}", style="bold"),
            ProgressBar(total=sample.duration, completed=sample.time, width=18),
            Text(f"{sample.time:4.1f}/{sample.duration:.1f} s"),
            Text(
                f"{sample.rate:.1f} Hz, round trip {1000 * sample.round_trip:.1f} ms, {sample.retries} retries",
                style="dim",
            ),
        )
        return line
