from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from hexwire.cli.plot import MotionPlot, open_picture
from hexwire.errors import UsageError


def test_picture_of_a_motion_has_names_units_and_title(tmp_path: Path) -> None:
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


def test_png_without_a_path(tmp_path: Path) -> None:
    plot = MotionPlot(("J1",))
    plot.planned = [(0.0, (0.0,)), (1.0, (1.0,))]
    plot.draw(open_picture(str(tmp_path / "a.png"), force=False))
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


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
