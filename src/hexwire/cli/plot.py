"""Pictures of the commands: `--plot FILE`, `record plot`. One look for all of them, that of the studio's plots.

Owns the look (colours of joints, axes with units, a legend beside the data) and the picture of a motion. Needs
matplotlib, imported on first use. Must not know robots.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hexwire.errors import UsageError
from hexwire.model.palette import LIGHT_BACKGROUND, joint_colour
from hexwire.new_file import OutputFile

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["MotionPlot", "TimePlot", "drawing", "label_axes", "open_picture", "save_figure"]

FORMATS = (".png", ".svg", ".pdf")
_TEXT = "#1d232b"
_MUTED = "#565e68"
_GRID = "#e3e6ea"
_LOOK: Any = {
    "axes.edgecolor": "#b9bfc7",
    "axes.facecolor": LIGHT_BACKGROUND,
    "axes.grid": True,
    "axes.labelcolor": _MUTED,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlecolor": _MUTED,
    "axes.titlelocation": "left",
    "axes.titlesize": 10,
    "axes.unicode_minus": True,
    "axes.xmargin": 0.01,
    "figure.facecolor": LIGHT_BACKGROUND,
    "font.size": 9.5,
    "grid.color": _GRID,
    "grid.linewidth": 0.8,
    "legend.frameon": False,
    "legend.handlelength": 1.6,
    "lines.linewidth": 1.4,
    "lines.solid_capstyle": "round",
    "text.color": _TEXT,
    "xtick.color": "#b9bfc7",
    "xtick.labelcolor": _MUTED,
    "ytick.color": "#b9bfc7",
    "ytick.labelcolor": _MUTED,
}


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


@contextmanager
def drawing(picture: OutputFile, title: str, width: float = 10.0, height: float = 5.0) -> Iterator[Figure]:
    """A figure in the common look; it is saved at the end.

    Args:
        picture: File of `open_picture`.
        title: Title, above everything.
        width: Inches.
        height: Inches.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    with mpl.rc_context(_LOOK):
        figure = Figure(figsize=(width, height), layout=ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.1))
        if title:
            figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
        yield figure
        save_figure(figure, picture)


def label_axes(axes: Axes, x: str, y: str) -> None:
    """Name both axes, each with its unit, as ``time, s``."""
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.set_axisbelow(True)


@dataclass
class TimePlot:
    """Values over time: a row of axes for each unit, a line for each joint or servo.

    Attributes:
        title: Title of the picture.
        lines: Lines as added by `add`.
    """

    title: str = ""
    lines: list[tuple[str, str, int, bool, Sequence[float], Sequence[float]]] = field(default_factory=list)

    def add(
        self,
        quantity: str,
        name: str,
        index: int,
        times: Sequence[float],
        values: Sequence[float],
        *,
        dashed: bool = False,
    ) -> None:
        """Add a line.

        Args:
            quantity: What it shows, with its unit, as ``position, deg``; lines of one quantity share axes.
            name: Its name in the legend.
            index: Place of its joint, which gives the colour.
            times: Seconds.
            values: As many; NaN where unknown.
            dashed: For what was wanted, beside what was measured.
        """
        self.lines.append((quantity, name, index, dashed, times, values))

    def draw(self, picture: OutputFile) -> None:
        """Draw the plot into a file of `open_picture`, and keep the file."""
        rows = list(dict.fromkeys(line[0] for line in self.lines)) or [""]
        with drawing(picture, self.title, height=max(4.5, 1.2 + 2.4 * len(rows))) as figure:
            grid = figure.subplots(len(rows), 1, sharex=True, squeeze=False)
            named: set[str] = set()
            handles: list[Any] = []
            for axes, quantity in zip(grid[:, 0], rows, strict=True):
                for _, name, index, dashed, times, values in (line for line in self.lines if line[0] == quantity):
                    (drawn,) = axes.plot(
                        times, values, color=joint_colour(index), ls="--" if dashed else "-", label=name
                    )
                    # One entry for a joint, however many axes it has.
                    if name not in named:
                        named.add(name)
                        handles.append(drawn)
                label_axes(axes, "time, s" if quantity == rows[-1] else "", quantity)
            figure.align_ylabels()
            if handles:
                figure.legend(handles=handles, loc="outside right upper")


@dataclass
class MotionPlot:
    """Collects a motion and draws it.

    Attributes:
        names: Joint names.
        planned: Pairs of seconds and planned joint angles in radians.
        measured: The same, as measured; may be empty.
        path: Planned positions of the tip, metres; may be empty, and then only the joints are drawn.
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
        views = bool(self.path or self.measured_path)
        with drawing(picture, self.title, 12.0 if views else 10.0, 6.5 if views else 5.0) as figure:
            grid = figure.add_gridspec(2, 2, width_ratios=(3, 2)) if views else figure.add_gridspec(1, 1)
            joints = figure.add_subplot(grid[:, 0])
            self._draw_joints(joints)
            handles, labels = joints.get_legend_handles_labels()
            if handles:
                # Beside all axes, where it covers no data.
                figure.legend(handles, labels, loc="outside right upper")
            if views:
                self._draw_view(figure.add_subplot(grid[0, 1]), 0, 1, "tip from above", "x, mm", "y, mm")
                self._draw_view(figure.add_subplot(grid[1, 1]), 1, 2, "tip from the side", "y, mm", "z, mm")

    def _draw_joints(self, axes: Axes) -> None:
        for i, name in enumerate(self.names):
            colour = joint_colour(i)
            times, angles = [t for t, _ in self.planned], [math.degrees(q[i]) for _, q in self.planned]
            axes.plot(times, angles, color=colour, label=name)
            if self.measured:
                times, angles = [t for t, _ in self.measured], [math.degrees(q[i]) for _, q in self.measured]
                axes.plot(times, angles, color=colour, lw=0, marker=".", ms=4)
        if self.measured:
            axes.set_title("line: planned, dots: measured")
        label_axes(axes, "time, s", "joint angle, deg")

    def _draw_view(self, axes: Axes, a: int, b: int, title: str, x: str, y: str) -> None:
        dots: dict[str, Any] = {"color": _MUTED, "lw": 0, "marker": ".", "ms": 4}
        for points, look in ((self.path, {"color": _TEXT}), (self.measured_path, dots)):
            if points:
                axes.plot([1e3 * p[a] for p in points], [1e3 * p[b] for p in points], **look)
        start = (self.path or self.measured_path)[0]
        axes.plot([1e3 * start[a]], [1e3 * start[b]], marker="o", ms=7, mfc=LIGHT_BACKGROUND, mec=_TEXT)
        axes.set_title(f"{title} (circle: start)")
        label_axes(axes, x, y)
        axes.set_aspect("equal", adjustable="datalim")
