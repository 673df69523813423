"""`--csv` and `--plot` of the commands that sample: the samples are saved however the sampling ends.

Owns the two files and their contents. Must not know where samples come from.
"""

from __future__ import annotations

import csv
import functools
import io
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

import click

from hexwire.new_file import OutputFile

from .common import force_option, refuse_idle_force
from .exits import note, shielded
from .plot import TimePlot, open_picture

__all__ = ["Row", "SampleFiles", "file_options", "saving"]

Row = tuple[float, ...]
"""One sample: one number per column."""


@dataclass(frozen=True, slots=True)
class SampleFiles:
    """Output files for samples, as typed."""

    csv: str | None
    plot: str | None
    force: bool


def file_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """``--csv``, ``--plot`` and ``--force``; the command gets ``files: SampleFiles``."""

    @functools.wraps(command)
    def given(*args: Any, csv_file: str | None, plot: str | None, force: bool, **rest: Any) -> Any:
        return command(*args, files=SampleFiles(csv_file, plot, force), **rest)

    packed: Callable[..., Any] = given
    for option in (
        force_option,
        click.option("--csv", "csv_file", metavar="FILE", help="Save the samples to this file."),
        click.option("--plot", metavar="FILE", help="Plot the samples to this file (.png, .svg or .pdf)."),
    ):
        packed = option(packed)
    return packed


@contextmanager
def saving(files: SampleFiles, head: Sequence[str], what: str) -> Iterator[list[Row]]:
    """Samples that are saved at the end, even after an error; their files are created before the first sample.

    Args:
        files: As typed.
        head: Names of the columns; the first two are time and id.
        what: The column to plot; a column named target is plotted with it.

    Raises:
        UsageError: A file cannot be created, or matplotlib is not installed.
    """
    if files.csv is None and files.plot is None:
        refuse_idle_force(files.force, "the files of --csv and --plot")
    with ExitStack() as stack:
        table = picture = None
        if files.csv is not None:
            table = stack.enter_context(OutputFile(files.csv, force=files.force))
        if files.plot is not None:
            picture = stack.enter_context(open_picture(files.plot, force=files.force))
        samples: list[Row] = []
        try:
            yield samples
        except BaseException:
            if samples:
                with shielded():
                    _save(samples, head, table, picture, what)
            raise
        _save(samples, head, table, picture, what)


def _save(
    samples: Sequence[Row], head: Sequence[str], table: OutputFile | None, picture: OutputFile | None, what: str
) -> None:
    if table is not None:
        text = io.TextIOWrapper(table.file, encoding="utf-8", newline="")
        writer = csv.writer(text)
        writer.writerow(head)
        writer.writerows(samples)
        text.detach()
        table.keep()
        note(f"{len(samples)} samples saved to {table.path}")
    if picture is not None:
        _plot(samples, head, picture, what)
        note(f"plotted to {picture.path}")


def _plot(samples: Sequence[Row], head: Sequence[str], picture: OutputFile, what: str) -> None:
    servos, words = sorted({row[1] for row in samples}), what.replace("_", " ")
    plot = TimePlot(
        f"{words} of servo{'' if len(servos) == 1 else 's'} {', '.join(f'{one:.0f}' for one in servos)}"
    )
    for i, servo_id in enumerate(servos):
        rows = [row for row in samples if row[1] == servo_id]
        times = [row[0] for row in rows]
        for column, name, dashed in ((what, "", False), ("target", ", target", True)):
            if column in head:
                place = head.index(column)
                values = [math.degrees(row[place]) for row in rows]
                plot.add(f"{words}, deg", f"servo {servo_id:.0f}{name}", i, times, values, dashed=dashed)
    plot.draw(picture)
