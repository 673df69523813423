"""`--plot FILE`: plots of a motion.

Owns the drawing. Needs matplotlib, imported on first use. Must not know robots.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from hexwire.errors import UsageError
from hexwire.new_file import OutputFile

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["MotionPlot", "open_picture", "save_figure"]

FORMATS = (".png", ".svg", ".pdf")
# Distinguishable with colour blindness (Okabe and Ito).
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")


def open_picture(file: str, *, force: bool) -> OutputFile:
    """Create the file of a plot, before the motion starts.

    Raises:
        UsageError: The format is unknown, the file cannot be created, or matplotlib is not installed.
    """
    if Path(file).suffix.lower() not in FORMATS:
        raise UsageError(f"{file}: the name of a plot must end in {', '.join(FORMATS)}")
    try:
        import matplotlib.figure  # noqa: F401  # only to check that it is installed
    except ImportError:
        raise UsageError("a plot needs matplotlib: pip install 'hexwire[plots]'") from None
    return OutputFile(file, force=force)


def save_figure(figure: Figure, picture: OutputFile) -> None:
    """Write a figure to its file, in the format given by the file name, and keep the file."""
    figure.savefig(picture.file, format=picture.path.suffix[1:].lower(), dpi=120)
    picture.keep()


@dataclass
class MotionPlot:
    """Collects a motion and draws it.

    Attributes:
        names: Joint names.
        planned: Pairs of seconds and planned joint angles in radians.
        measured: The same, as measured; may be empty.
        path: Planned positions of the tip, metres.
        measured_path: Measured positions of the tip, metres.
        title: Title of the plot.
    """

    names: tuple[str, ...]
    title: str = ""
    planned: list[tuple[float, Sequence[float]]] = field(default_factory=list)
    measured: list[tuple[float, Sequence[float]]] = field(default_factory=list)
    path: list[Sequence[float]] = field(default_factory=list)
    measured_path: list[Sequence[float]] = field(default_factory=list)

    def draw(self, picture: OutputFile) -> None:
        """Draw the plot into a file of `open_picture`, and keep the file."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(11, 7), layout="constrained")
        figure.suptitle(self.title)
        grid = figure.add_gridspec(2, 2, width_ratios=(3, 2))
        joints = figure.add_subplot(grid[:, 0])
        for i, name in enumerate(self.names):
            colour = _COLOURS[i % len(_COLOURS)]
            joints.plot(
                [t for t, _ in self.planned],
                [math.degrees(q[i]) for _, q in self.planned],
                color=colour,
                lw=1.5,
                label=name,
            )
            if self.measured:
                joints.plot(
                    [t for t, _ in self.measured],
                    [math.degrees(q[i]) for _, q in self.measured],
                    color=colour,
                    lw=0,
                    marker=".",
                    ms=4,
                )
        joints.set_xlabel("time, s")
        joints.set_ylabel("joint angle, deg" + (" (line: planned, dots: measured)" if self.measured else ""))
        joints.grid(alpha=0.3)
        joints.legend(ncols=4, loc="best", fontsize="small")
        views = ((0, 1, "from above", "x, mm", "y, mm"), (1, 2, "from the side", "y, mm", "z, mm"))
        for row, (a, b, name, x_label, y_label) in enumerate(views):
            view = figure.add_subplot(grid[row, 1])
            if self.path:
                view.plot(
                    [1e3 * p[a] for p in self.path], [1e3 * p[b] for p in self.path], lw=1.5, color=_COLOURS[0]
                )
            if self.measured_path:
                points = [1e3 * p[a] for p in self.measured_path], [1e3 * p[b] for p in self.measured_path]
                view.plot(*points, lw=0, marker=".", ms=4, color=_COLOURS[1])
            if self.path:
                view.plot([1e3 * self.path[0][a]], [1e3 * self.path[0][b]], marker="o", color="black", ms=6)
            view.set_title(f"tip {name} (o: start)", fontsize="medium")
            view.set_xlabel(x_label)
            view.set_ylabel(y_label)
            view.set_aspect("equal", adjustable="datalim")
            view.grid(alpha=0.3)
        save_figure(figure, picture)
