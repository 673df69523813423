"""Draws `hexwire demo` as an animated picture of a terminal: ``pictures/demo.svg``.

    python docs/make_demo_picture.py

Runs the demo in a terminal of its own and records what it shows. The picture needs no script and no font: every run
of characters of a line is shown for as long as it stood there. Who prefers less motion sees the last moment.
"""

from __future__ import annotations

import fcntl
import os
import pty
import select
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from html import escape
from itertools import groupby
from pathlib import Path

import pyte

HERE = Path(__file__).resolve().parent
COLUMNS, ROWS = 104, 24
STEP = 0.2
"""Seconds between two frames."""
REST = 4.0
"""Seconds for which the end is shown."""
CELL, LINE, MARGIN, BAR = 8.4, 18.0, 14.0, 30.0
"""Width and height of a character, space around the text, and height of the title, in pixels."""
COLORS = {
    "default": "#d8dee9", "black": "#4c566a", "red": "#f0717a", "green": "#9fce7f", "brown": "#e9c46a",
    "blue": "#7aa6da", "magenta": "#c594c5", "cyan": "#6fc3df", "white": "#eceff4",
}  # fmt: skip

Run = tuple[int, str, str, bool, bool]
"""Characters of one style: column, text, colour, bold, dim."""
Line = tuple[Run, ...]


def watch(command: list[str]) -> Iterator[tuple[float, list[Line]]]:
    """What a program shows in a terminal: times from its start in seconds, and the lines."""
    screen = pyte.Screen(COLUMNS, ROWS)
    stream = pyte.ByteStream(screen)
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, COLUMNS, 0, 0))
    env = {**os.environ, "TERM": "xterm-256color", "COLORTERM": "", "HEXWIRE_PORT": ""}
    start = time.monotonic()
    with subprocess.Popen(
        command, stdin=theirs, stdout=theirs, stderr=theirs, env=env, start_new_session=True
    ) as program:
        os.close(theirs)
        due = 0.0
        while True:
            ready, _, _ = select.select([ours], [], [], STEP)
            data = b""
            if ready:
                try:
                    data = os.read(ours, 65536)
                except OSError:  # Linux says so when the program has ended
                    break
            stream.feed(data)
            now = time.monotonic() - start
            if now >= due:
                due = now + STEP
                yield now, lines(screen)
    os.close(ours)
    if program.returncode:
        sys.exit(f"{' '.join(command)} ended with status {program.returncode}")
    yield time.monotonic() - start, lines(screen)


def lines(screen: pyte.Screen) -> list[Line]:
    """The lines of a screen as runs of one style; blanks at the end are dropped."""
    found = []
    for row in range(screen.lines):
        cells = [screen.buffer[row][column] for column in range(screen.columns)]
        runs: list[Run] = []
        at = 0
        for (color, bold, dim), group in groupby(cells, lambda c: (c.fg, c.bold, getattr(c, "dim", False))):
            text = "".join(cell.data for cell in group)
            if text.strip():
                blank = len(text) - len(text.lstrip())
                runs.append((at + blank, text.strip(), color, bold, dim))
            at += len(text)
        found.append(tuple(runs))
    return found


def shown(frames: list[tuple[float, list[Line]]]) -> Iterator[tuple[int, Run, float, float]]:
    """Every run with its row, and from when to when it stood there without a break."""
    end = frames[-1][0] + REST
    since: dict[tuple[int, Run], float] = {}
    for now, screen in frames:
        present = {(row, run) for row, line in enumerate(screen) for run in line}
        for key in [key for key in since if key not in present]:
            yield *key, since.pop(key), now
        for key in present:
            since.setdefault(key, now)
    for key, begin in since.items():
        yield *key, begin, end


def draw(frames: list[tuple[float, list[Line]]], title: str) -> str:
    """The picture."""
    # The interpreter's start is of no interest.
    begin = next(now for now, screen in frames if any(screen)) - 0.5
    frames = [(max(0.0, now - begin), screen) for now, screen in frames if now >= begin]
    total = frames[-1][0] + REST
    used = max(row for _, screen in frames for row, line in enumerate(screen) if line) + 1
    width, height = 2 * MARGIN + COLUMNS * CELL, BAR + 2 * MARGIN + used * LINE
    rules, texts = {}, []
    for row, (column, text, color, bold, dim), first, last in sorted(shown(frames), key=lambda found: found[2:]):
        a, b = round(100 * first / total, 2), round(100 * last / total, 2)
        always, name = a <= 0 and b >= 100, f"t{a:g}-{b:g}".replace(".", "_")
        if not always:
            before = "" if a <= 0 else f"0%,{a - 0.01:.2f}%{{visibility:hidden}}"
            after = "" if b >= 100 else f"{b:.2f}%,100%{{visibility:hidden}}"
            rules[name] = (
                f"@keyframes {name}{{{before}{a:.2f}%,{min(b, 100) - 0.01:.2f}%{{visibility:visible}}{after}}}"
            )
        look = (' font-weight="bold"' if bold else "") + (' opacity=".6"' if dim else "")
        moving = "" if always else f' class="m{" e" if b >= 100 else ""}" style="animation-name:{name}"'
        fill = COLORS.get(color) or f"#{color}"
        place = f'x="{MARGIN + column * CELL:.1f}" y="{BAR + MARGIN + (row + 0.78) * LINE:.1f}"'
        long = f'textLength="{len(text) * CELL:.1f}"'
        texts.append(f'<text {place} {long} fill="{fill}"{look}{moving}>{escape(text)}</text>')
    style = (
        'text{font:14px ui-monospace,SFMono-Regular,Menlo,Consolas,"DejaVu Sans Mono",monospace;white-space:pre}'
        f".m{{visibility:hidden;animation-duration:{total:.2f}s;animation-iteration-count:infinite;"
        "animation-timing-function:step-end}"
        "@media(prefers-reduced-motion:reduce){.m{animation:none}.e{visibility:visible}}"
    )
    size = f'viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}" height="{height:.0f}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size} role="img" aria-label="{escape(title)}">'
    window = (
        f'<rect width="{width:.0f}" height="{height:.0f}" rx="8" fill="#1f2430"/>'
        f'<text x="{width / 2:.0f}" y="20" text-anchor="middle" fill="#8a93a6">{escape(title)}</text>'
    )
    return "\n".join([head, f"<style>{style}{''.join(rules.values())}</style>", window, *texts, "</svg>\n"])


def main() -> None:
    """Record and write."""
    frames = list(watch([str(Path(sys.executable).with_name("hexwire")), "demo"]))
    (HERE / "pictures" / "demo.svg").write_text(draw(frames, "make demo"), encoding="utf-8")


if __name__ == "__main__":
    main()
