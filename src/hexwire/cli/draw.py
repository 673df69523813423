"""What is drawn on a terminal: tables of joints, the demo. The one place of these that knows rich.

Owns colours and columns. Must not know robots or commands.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from rich import box
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.live import Live
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TimeElapsedColumn
from rich.progress_bar import ProgressBar
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from .output import plain, shown, split_columns

if TYPE_CHECKING:
    from .demo_view import Sample

__all__ = ["JointTable", "LiveView", "SafeConsole", "live", "progress"]

_REDRAWS = 12
"""Drawings a second: enough to look alive."""
_GAP = 3
"""Columns between two cells of a table."""
_GOOD, _FAIR = 2.0, 5.0
"""Degrees off the trajectory that still look good, or fair: a servo trails by about a cycle."""


class SafeConsole(Console):
    """A console that no text from outside can command: see `output.shown`. Markup in names stays what it is.

    Args:
        width: Columns, if not the terminal's.
    """

    def __init__(self, width: int | None = None) -> None:
        super().__init__(highlight=False, markup=False, emoji=False, width=width)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterator[Segment]:
        """As rich does, with its own control codes and clean text."""
        for segment in super().render(renderable, options):
            text = segment.text
            if segment.control or text == "\n" or text.isprintable():
                yield segment
            else:
                yield Segment("\n".join(map(shown, text.split("\n"))), segment.style)


def live() -> Live:
    """Something that is drawn again in place whenever it is updated."""
    return Live(console=SafeConsole(), auto_refresh=False)


def progress() -> Progress:
    """A bar that is gone at the end, with what is going on behind it."""
    return Progress(BarColumn(), TimeElapsedColumn(), _Words(), console=SafeConsole(), transient=True)


class _Words(ProgressColumn):
    def render(self, task: Task) -> Text:
        return Text(shown(task.description))


class JointTable:
    """A table whose first column is the joint; the numbers behind it are aligned to the right.

    Where the terminal is narrower, it is drawn in parts below each other: no column is lost.

    Args:
        head: Titles.
        rows: Cells, one row a joint.
        faulty: Which rows are to be shown as bad.
    """

    def __init__(self, head: Sequence[str], rows: Sequence[Sequence[str | Text]], faulty: Sequence[bool]) -> None:
        self._head = head
        self._rows = [
            [_cell(cell, i, bad) for i, cell in enumerate(row)] for row, bad in zip(rows, faulty, strict=True)
        ]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        titles = [Text(shown(title)) for title in self._head]
        widths = [max(cell.cell_len for cell in column) for column in zip(titles, *self._rows, strict=True)]
        for part in split_columns(widths, 1, options.max_width, _GAP):
            table = Table(box=box.SIMPLE_HEAD, header_style="bold", pad_edge=False)
            for i in part:
                left = i == 0 or self._head[i] == "condition"
                table.add_column(titles[i], justify="left" if left else "right", no_wrap=not left, overflow="fold")
            for row in self._rows:
                table.add_row(*(row[i] for i in part))
            yield table


def _cell(cell: str | Text, column: int, bad: bool) -> Text:
    if isinstance(cell, Text):
        return cell
    style = "bold red" if bad else "bold cyan" if column == 0 else "dim" if cell == "-" else ""
    return Text(shown(cell), style=style)


class LiveView:
    """The demo on a terminal: a live table and a progress bar.

    They are drawn in a thread of their own, so that a slow terminal never holds up the loop that moves the arm.
    """

    def __init__(self, console: Console | None = None) -> None:
        self._console = console or SafeConsole()
        self._sample: Sample | None = None

    def say(self, phase: str, text: str) -> None:
        """Print a phase above the table."""
        line = Text.assemble((f"{phase:>10}", "bold green"), "  ", shown(text))
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
                    plain(math.degrees(target), 1),
                    plain(math.degrees(joint.position), 1),
                    Text(plain(off, 1, sign=True), style=style),
                    plain(100 * joint.load, 0, sign=True),
                    plain(1000 * joint.age, 0),
                )
            )
            faulty.append(bool(joint.flags.faults))
        head = ("joint", "target deg", "position deg", "error deg", "load %", "age ms")
        return Group(JointTable(head, rows, faulty), self._bar(sample))

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
