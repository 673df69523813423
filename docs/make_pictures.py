"""Makes ``pictures/*.svg``: the console blocks of debugging.md as a terminal shows them, and the drawings.

    python docs/make_pictures.py           write
    python docs/make_pictures.py --check   exit 1 and name the pictures that are not up to date

The words of the blocks come from the page; the tests compare them with what the commands print. The drawings are in
``drawings/``.
"""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from rich.console import Console
from rich.text import Text

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from drawings import DRAWINGS  # noqa: E402  # found by the line above

PAGE = HERE / "debugging.md"
NAMES = ("wrong-id", "cooked-port", "cut-frame")
COLUMNS = 112
STYLES = (
    (re.compile(r"^\$ .*", re.M), "bold"),
    (re.compile(r"^-> .*", re.M), "cyan"),
    (re.compile(r"^<- .*", re.M), "green"),
    (re.compile(r"(! .*|[^,:\n]*header of another series.*|^\d+\s.*cuts.*|^.*board error.*)$", re.M), "bold red"),
)
_REMOTE_FONT = re.compile(r"\s*@font-face \{.*?\}", re.S)


def blocks(page: str) -> list[str]:
    """The console blocks of a page."""
    return re.findall(r"^```console\n(.*?)^```$", page, re.M | re.S)


def picture(block: str, name: str) -> str:
    """One block as SVG. No font is fetched: the viewer's own monospace face serves."""
    text = Text(block.rstrip("\n"))
    for pattern, style in STYLES:
        for found in pattern.finditer(text.plain):
            text.stylize(style, found.start(), found.end())
    console = Console(record=True, width=COLUMNS, file=io.StringIO(), force_terminal=True, color_system="truecolor")
    console.print(text)
    svg = console.export_svg(title="hexwire", unique_id=name)
    return _REMOTE_FONT.sub("", svg)


def pictures() -> Iterator[tuple[str, str]]:
    """Name and content of every picture."""
    for name, block in zip(NAMES, blocks(PAGE.read_text(encoding="utf-8")), strict=True):
        yield name, picture(block, name)
    for name, draw in DRAWINGS.items():
        yield name, draw().svg()


def main() -> int:
    """Write or check; returns the exit status."""
    check = "--check" in sys.argv[1:]
    stale = 0
    for name, wanted in pictures():
        path = HERE / "pictures" / f"{name}.svg"
        if path.is_file() and path.read_text(encoding="utf-8") == wanted:
            continue
        stale += 1
        if check:
            sys.stderr.write(f"{path.relative_to(HERE.parent)} is stale: run python docs/make_pictures.py\n")
        else:
            path.parent.mkdir(exist_ok=True)
            path.write_text(wanted, encoding="utf-8")
    return 1 if check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
