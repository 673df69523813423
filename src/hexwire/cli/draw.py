"""Live views on a terminal: tables of joints, the demo. The only user of rich.

Owns colours and columns. Must not know robots or commands.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.live import Live
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TimeElapsedColumn
from rich.progress_bar import ProgressBar
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from hexwire.units import plain

from .output import format_table, line_width, shown, split_columns

if TYPE_CHECKING:
    from rich.style import Style

    from hexwire.model.state import JointState

__all__ = ["CycleSample", "JointTable", "LiveView", "SafeConsole", "live", "live_table", "progress"]

_REDRAWS = 12
"""Redraws per second: enough for a smooth view."""
_GAP = 3
"""Columns between two cells of a table."""
_GOOD, _FAIR = 2.0, 5.0
"""Degrees off the trajectory shown as good, or fair: a servo lags by about a cycle."""


class SafeConsole(Console):
    """A console on which external text is harmless (see `output.shown`). Markup in names stays text.

    Args:
        width: Columns; those of the terminal if None.
    """

    def __init__(self, width: int | None = None) -> None:
        super().__init__(highlight=False, markup=False, emoji=False, width=width)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterator[Segment]:
        """Render like rich, with rich's own control codes and cleaned text."""
        for segment in super().render(renderable, options):
            text = segment.text
            if segment.control or text == "\n" or text.isprintable():
                yield segment
            else:
                yield Segment("\n".join(map(shown, text.split("\n"))), segment.style)


def live() -> Live:
    """A view that is redrawn in place at each update."""
    return Live(console=SafeConsole(), auto_refresh=False)


@contextmanager
def live_table(head: Sequence[str]) -> Iterator[Callable[[Sequence[Sequence[str]], str], None]]:
    """A table that is redrawn in place: gives what draws its rows, and a line below."""
    with live() as screen:

        def show(rows: Sequence[Sequence[str]], below: str) -> None:
            table = format_table(head, rows, width=line_width())
            screen.update(Text(f"{table}\n{below}"), refresh=True)

        yield show


def progress() -> Progress:
    """A progress bar with a description; it disappears at the end."""
    return Progress(BarColumn(), TimeElapsedColumn(), _Words(), console=SafeConsole(), transient=True)


class _Words(ProgressColumn):
    def render(self, task: Task) -> Text:
        return Text(shown(task.description))


class JointTable:
    """A table whose first column is the joint; the other columns are numbers, aligned to the right.

    On a narrower terminal it is drawn in parts below each other, so that no column is lost.

    Args:
        head: Titles.
        rows: Cells, one row per joint.
        faulty: Which rows to show as bad.
    """

    def __init__(self, head: Sequence[str], rows: Sequence[Sequence[str | Text]], faulty: Sequence[bool]) -> None:
        self._head = head
        self._rows: list[list[tuple[str, str | Style]]] = [[(shown(title), "bold") for title in head]]
        self._rows += [
            [_cell(cell, i, bad) for i, cell in enumerate(row)] for row, bad in zip(rows, faulty, strict=True)
        ]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        widths = [max(cell_len(text) for text, _ in column) for column in zip(*self._rows, strict=True)]
        left = [i == 0 or self._head[i] == "condition" for i in range(len(widths))]
        for part in split_columns(widths, 1, options.max_width - 1, _GAP):
            width = sum(widths[i] for i in part) + _GAP * (len(part) - 1)
            yield Segment.line()
            for number, row in enumerate(self._rows):
                line: list[tuple[str, str | Style]] = []
                plain_text = " "
                for i in part:
                    cell, style = row[i]
                    space = " " * (widths[i] - cell_len(cell))
                    plain_text += "" if left[i] else space
                    if style:
                        line += [(plain_text, ""), (cell, style)]
                        plain_text = ""
                    else:
                        plain_text += cell
                    plain_text += (space if left[i] else "") + " " * _GAP
                line.append((plain_text.rstrip(), ""))
                yield from _drawn(line, console, folded=width >= options.max_width)
                if number == 0:
                    yield from _drawn([(f" {'─' * width}", "")], console, folded=width >= options.max_width)
            yield Segment.line()


def _drawn(line: Sequence[tuple[str, str | Style]], console: Console, *, folded: bool) -> RenderResult:
    # Neither one of rich's tables nor its texts: those take many times as long, and a view is redrawn all the time.
    if folded:
        yield Text.assemble(*line, overflow="fold")
        return
    for text, style in line:
        yield Segment(text, console.get_style(style) if style else None)
    yield Segment.line()


def _cell(cell: str | Text, column: int, bad: bool) -> tuple[str, str | Style]:
    """The text of a cell, and its style."""
    if isinstance(cell, Text):
        return cell.plain, cell.style
    return shown(cell), "bold red" if bad else "bold cyan" if column == 0 else "dim" if cell == "-" else ""


class CycleSample(NamedTuple):
    """One cycle, for the view. Angles in radians, loads as fractions, times in seconds.

    Attributes:
        time: Time since the start of the motion.
        duration: Duration of the whole motion.
        state: State of the joints.
        target: Desired positions at that time.
        rate: Achieved cycles per second.
        round_trip: Round trip of the last request.
        retries: Retries since the start of the motion.
    """

    time: float
    duration: float
    state: JointState
    target: tuple[float, ...]
    rate: float
    round_trip: float
    retries: int


class LiveView:
    """The demo on a terminal: a live table and a progress bar.

    They are drawn in a separate thread, so that a slow terminal never delays the loop that moves the arm.
    """

    def __init__(self, console: Console | None = None) -> None:
        self._console = console or SafeConsole()
        self._sample: CycleSample | None = None

    def say(self, phase: str, text: str) -> None:
        """Print a phase above the table."""
        line = Text.assemble((f"{phase:>10}", "bold green"), "  ", shown(text))
        self._console.print(line, soft_wrap=True)

    def moving(self) -> Live:
        """Draw while the arm moves."""
        return Live(get_renderable=self.render, console=self._console, refresh_per_second=_REDRAWS)

    def show(self, sample: CycleSample) -> None:
        """Store a cycle for the next redraw."""
        self._sample = sample

    def render(self) -> RenderableType:
        """The present view."""
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

    def _bar(self, sample: CycleSample) -> RenderableType:
        line = Table.grid(padding=(0, 1))
        direction = "there" if sample.time < sample.duration / 2 else "back"
        line.add_row(
            Text(f"{direction:5}", style="bold"),
            ProgressBar(total=sample.duration, completed=sample.time, width=18),
            Text(f"{sample.time:4.1f}/{sample.duration:.1f} s"),
            Text(
                f"{sample.rate:.1f} Hz, round trip {1000 * sample.round_trip:.1f} ms, {sample.retries} retries",
                style="dim",
            ),
        )
        return line
