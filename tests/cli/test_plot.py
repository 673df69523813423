from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from hexwire.cli.plot import MotionPlot, TimePlot, drawing, open_picture
from hexwire.errors import UsageError
from hexwire.model.palette import LIGHT


def test_picture_of_a_motion_has_names_units_and_title(tmp_path: Path, figures: list[Any]) -> None:
    plot = MotionPlot(("J1", "J2"), "goto 0 220 200 mm")
    plot.planned = [(0.1 * i, (0.01 * i, -0.02 * i)) for i in range(10)]
    plot.measured = plot.planned[1:]
    plot.path = [(0.0, 0.2, 0.2 - 0.01 * i) for i in range(10)]
    plot.measured_path = plot.path[::2]
    # Text as text, so that it can be looked for.
    import matplotlib

    with matplotlib.rc_context({"svg.fonttype": "none"}):
        plot.draw(open_picture(str(tmp_path / "a.svg"), force=False))
    text = (tmp_path / "a.svg").read_text(encoding="utf-8")
    for words in ("goto 0 220 200 mm", "time, s", "joint angle, deg", "J1", "J2", "z, mm", "tip from above"):
        assert words in text
    joints = [(line.get_linewidth() > 0, line.get_marker()) for line in figures[0].axes[0].lines]
    assert joints == [(True, "None"), (False, ".")] * 2, "line: planned, dots: measured"


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The figures that were saved."""
    import hexwire.cli.plot

    saved: list[Any] = []
    save = hexwire.cli.plot.save_figure

    def spy(figure: Any, picture: Any) -> None:
        saved.append(figure)
        save(figure, picture)

    monkeypatch.setattr(hexwire.cli.plot, "save_figure", spy)
    return saved


def test_the_tip_is_seen_from_above_and_from_the_side(tmp_path: Path, figures: list[Any]) -> None:
    plot = MotionPlot(("J1",))
    plot.planned = [(0.0, (0.0,)), (1.0, (1.0,))]
    plot.path = [(0.1, 0.2, 0.3), (0.11, 0.22, 0.33)]
    plot.draw(open_picture(str(tmp_path / "a.png"), force=False))
    x, y, z = [100.0, 110.0], [200.0, 220.0], [300.0, 330.0]
    views = {(axes.get_xlabel(), axes.get_ylabel()): axes.lines[0].get_data() for axes in figures[0].axes[1:]}
    assert {names: [list(values) for values in data] for names, data in views.items()} == {
        ("x, mm", "y, mm"): [pytest.approx(x), pytest.approx(y)],
        ("y, mm", "z, mm"): [pytest.approx(y), pytest.approx(z)],
    }


@pytest.mark.parametrize("planned", [True, False])
def test_a_circle_is_where_the_tip_starts(tmp_path: Path, figures: list[Any], planned: bool) -> None:
    plot = MotionPlot(("J1",))
    plot.measured = [(0.0, (0.0,)), (1.0, (1.0,))]
    plot.measured_path = [(0.12, 0.2, 0.3), (0.2, 0.3, 0.4)]
    if planned:
        plot.path = [(0.1, 0.2, 0.3), (0.2, 0.3, 0.4)]
    plot.draw(open_picture(str(tmp_path / "a.png"), force=False))
    above, side = (next(line for line in axes.lines if line.get_marker() == "o") for axes in figures[0].axes[1:])
    assert list(above.get_xydata()[0]) == pytest.approx([100.0 if planned else 120.0, 200.0])
    assert list(side.get_xydata()[0]) == pytest.approx([200.0, 300.0])


def test_without_a_path_there_are_no_empty_axes(tmp_path: Path, figures: list[Any]) -> None:
    plot = MotionPlot(("J1",))
    plot.planned = [(0.0, (0.0,)), (1.0, (1.0,))]
    plot.draw(open_picture(str(tmp_path / "a.png"), force=False))
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    (axes,) = figures[0].axes
    assert axes.has_data()


def test_a_row_of_axes_for_each_unit_a_colour_for_each_joint(tmp_path: Path, figures: list[Any]) -> None:
    plot = TimePlot("two")
    for i, name in enumerate(("J1", "J2")):
        plot.add("position, deg", name, i, [0.0, 1.0], [0.0, i])
        plot.add("load, %", name, i, [0.0, 1.0], [5.0, i])
    plot.add("position, deg", "J1 target", 0, [0.0, 1.0], [0.0, 2.0], dashed=True)
    plot.draw(open_picture(str(tmp_path / "a.svg"), force=False))
    (figure,) = figures
    assert [axes.get_ylabel() for axes in figure.axes] == ["position, deg", "load, %"]
    assert figure.axes[-1].get_xlabel() == "time, s"
    above, below = ([line.get_color() for line in axes.lines] for axes in figure.axes)
    assert above == [*below, below[0]] == [LIGHT[0], LIGHT[1], LIGHT[0]]
    assert figure.axes[0].lines[2].get_linestyle() == "--"
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.texts] == ["J1", "J2", "J1 target"]


def test_a_legend_covers_no_data(tmp_path: Path, figures: list[Any]) -> None:
    plot = MotionPlot(tuple(f"J{i}" for i in range(1, 8)), "seven")
    plot.planned = [(0.1 * i, [0.3 * (i % 7 - k) for k in range(7)]) for i in range(50)]
    plot.draw(open_picture(str(tmp_path / "a.png"), force=False))
    (figure,) = figures
    (legend,) = figure.legends
    assert all(not legend.get_window_extent().overlaps(axes.get_window_extent()) for axes in figure.axes)


def test_the_look_ends_with_the_picture(tmp_path: Path) -> None:
    import matplotlib as mpl

    before = dict(mpl.rcParams)
    with drawing(open_picture(str(tmp_path / "a.svg"), force=False), "x"):
        assert mpl.rcParams["axes.grid"] is True
    assert dict(mpl.rcParams) == before


def test_unknown_picture_and_missing_package(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"a\.doc: the name of a plot must end in \.png"):
        open_picture(str(tmp_path / "a.doc"), force=False)
    open_picture(str(tmp_path / "a.PNG"), force=False).discard()
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(UsageError, match=r"pip install 'hexwire\[plots\]'"):
        open_picture(str(tmp_path / "a.png"), force=False)
    assert list(tmp_path.iterdir()) == []


def test_a_command_draws_what_it_did(bench: Any, tmp_path: Path) -> None:
    out = bench.ok("goto", "0", "220", "200", "--plot", str(tmp_path / "g.png"))
    assert "drawn: " in out
    assert (tmp_path / "g.png").stat().st_size > 10_000
