"""The pictures of README.md and the documentation: made by programs, whole, and readable without a script."""

from __future__ import annotations

import importlib.util
import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from types import ModuleType

import pytest
from PIL import Image

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def picture() -> ModuleType:
    file = ROOT / "docs" / "make_demo_picture.py"
    spec = importlib.util.spec_from_file_location("make_demo_picture", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_picture_of_the_readme_and_the_studio_is_made_by_make_pictures() -> None:
    pages = [ROOT / "README.md", *(ROOT / "docs" / f"{page}.md" for page in ("install", "studio"))]
    named = {name for page in pages for name in re.findall(r"pictures/([\w-]+\.\w+)", page.read_text("utf-8"))}
    assert {"studio-moving.webp", "demo.svg", "studio-move-light.png", "studio-move-dark.png"} <= named
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8").partition("\npictures:")[2].partition("\n\n")[0]
    makers = {file: (ROOT / file).read_text(encoding="utf-8") for file in re.findall(r"docs/\w+\.py", makefile)}
    assert "docs/make_demo_picture.py" in makers
    for name in named:
        stem = name.partition(".")[0].removesuffix("-light").removesuffix("-dark").removeprefix("studio-")
        assert any(stem in text for text in makers.values()), name
        assert (ROOT / "docs" / "pictures" / name).stat().st_size > 1000


def test_the_readme_is_short_and_its_picture_moves() -> None:
    """A person reads 700 words; a picture of a megabyte is seen at once."""
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= 700
    file = ROOT / "docs" / "pictures" / "studio-moving.webp"
    assert file.stat().st_size < 1_000_000
    with Image.open(file) as picture:
        assert getattr(picture, "n_frames", 1) > 20


def test_the_demo_shows_what_it_says_now() -> None:
    root = ET.fromstring((ROOT / "docs" / "pictures" / "demo.svg").read_text(encoding="utf-8"))
    shown = " ".join(element.text or "" for element in root.iter("{http://www.w3.org/2000/svg}text"))
    for words in ("make demo", "started", "identified", "7 of 7 servos answer", "J7", "torque off", "0 retries"):
        assert words in shown
    drawn = {element.tag.rpartition("}")[2] for element in root.iter()}
    assert drawn == {"svg", "style", "rect", "text"}


SAYS = """
import sys, time
from pathlib import Path

print("first", flush=True)
while not Path(sys.argv[1]).exists():
    time.sleep(0.02)
print("\\x1b[1;31msecond <&>\\x1b[0m", flush=True)
"""


def test_a_program_is_drawn_as_it_was_seen(picture: ModuleType, tmp_path: Path) -> None:
    frames, seen = [], tmp_path / "seen"
    for frame in picture.watch([sys.executable, "-c", SAYS, str(seen)]):
        frames.append(frame)
        if frame[1][0]:
            seen.touch()
    runs = {run[1]: (row, run, since, until) for row, run, since, until in picture.shown(frames)}
    end = frames[-1][0] + picture.REST
    first, second = runs["first"], runs["second <&>"]
    assert (first[0], second[0]) == (0, 1)
    assert second[1][2:4] == ("red", True)
    assert first[2] < second[2]
    assert first[3] == second[3] == end
    root = ET.fromstring(picture.draw(frames, "a title"))
    texts = list(root.iter("{http://www.w3.org/2000/svg}text"))
    assert [element.text for element in texts] == ["a title", "first", "second <&>"]
    assert texts[2].get("font-weight") == "bold"


def test_a_program_that_fails_gives_no_picture(picture: ModuleType) -> None:
    with pytest.raises(SystemExit, match="status 3"):
        list(picture.watch([sys.executable, "-c", "raise SystemExit(3)"]))
