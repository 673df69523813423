from __future__ import annotations

from itertools import combinations
from pathlib import Path

import pytest

import hexwire
from hexwire.model.palette import DARK, DARK_BACKGROUND, LIGHT, LIGHT_BACKGROUND, joint_colour, palette_css

# How colours look without one kind of cone, in linear RGB (Machado, Oliveira and Fernandes 2009, severity 1).
_SIGHT = {
    "all": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "protanopia": ((0.152, 1.053, -0.205), (0.115, 0.786, 0.099), (-0.004, -0.048, 1.052)),
    "deuteranopia": ((0.367, 0.861, -0.228), (0.280, 0.673, 0.047), (-0.012, 0.043, 0.969)),
    "tritanopia": ((1.256, -0.077, -0.179), (-0.078, 0.931, 0.148), (0.005, 0.691, 0.304)),
}


def _linear(colour: str) -> list[float]:
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    return [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]


def _luminance(colour: str) -> float:
    r, g, b = _linear(colour)
    return 0.2126 * r + 0.7152 * g + 0.0722 * b


def _lab(linear: list[float]) -> tuple[float, float, float]:
    r, g, b = (min(1.0, max(0.0, c)) for c in linear)
    x, y, z = (
        (0.4124 * r + 0.3576 * g + 0.1805 * b) / 0.9505,
        0.2126 * r + 0.7152 * g + 0.0722 * b,
        (0.0193 * r + 0.1192 * g + 0.9505 * b) / 1.0888,
    )
    a, b, c = (v ** (1 / 3) if v > 0.008856 else 7.787 * v + 16 / 116 for v in (x, y, z))
    return 116 * b - 16, 500 * (a - b), 200 * (b - c)


@pytest.mark.parametrize(("row", "background"), [(LIGHT, LIGHT_BACKGROUND), (DARK, DARK_BACKGROUND)])
def test_lines_can_be_seen_on_their_background(row: tuple[str, ...], background: str) -> None:
    for colour in row:
        low, high = sorted((_luminance(colour), _luminance(background)))
        assert (high + 0.05) / (low + 0.05) >= 3.0, colour


@pytest.mark.parametrize("sight", _SIGHT)
@pytest.mark.parametrize("row", [LIGHT, DARK])
def test_colours_differ_for_every_eye(row: tuple[str, ...], sight: str) -> None:
    matrix = _SIGHT[sight]
    seen = [
        _lab([sum(m * c for m, c in zip(line, _linear(colour), strict=True)) for line in matrix]) for colour in row
    ]
    near = {
        (a, b): sum((p - q) ** 2 for p, q in zip(seen[a], seen[b], strict=True)) ** 0.5
        for a, b in combinations(range(len(row)), 2)
    }
    # 2.3 is just noticeable; thin lines need about ten times that.
    assert min(near.values()) > 20, min(near, key=lambda pair: near[pair])


def test_an_arm_with_more_joints_begins_again() -> None:
    assert [joint_colour(i) for i in range(9)] == [*LIGHT, LIGHT[0]]
    assert joint_colour(1, dark=True) == DARK[1]


def test_pages_have_the_same_colours() -> None:
    sheet = Path(hexwire.__file__).parent / "studio" / "static" / "studio.css"
    assert palette_css() in sheet.read_text(encoding="utf-8")
    assert palette_css().count(f"--joint-8: {DARK[7]};") == 1
