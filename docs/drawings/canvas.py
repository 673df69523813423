"""A canvas for drawings as SVG: a few shapes in named colours, readable on light and dark pages.

Owns shapes, colours and fonts. Must not know what is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

__all__ = ["Canvas", "Point"]

Point = tuple[float, float]

_LIGHT = {
    "paper": "#ffffff",
    "ink": "#1f2933",
    "soft": "#5b6773",
    "box": "#eef2f6",
    "blue": "#0b5f9c",
    "red": "#b3261e",
    "green": "#1c7332",
    "orange": "#9a4a00",
}
_DARK = {
    "paper": "#14191f",
    "ink": "#e6ebf0",
    "soft": "#a7b2bd",
    "box": "#242c35",
    "blue": "#7cc0f5",
    "red": "#ff9a8f",
    "green": "#7fd694",
    "orange": "#ffb870",
}
_FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "DejaVu Sans", sans-serif'
_MONO = 'ui-monospace, "Cascadia Mono", "DejaVu Sans Mono", Menlo, monospace'
_SIZE = 15
_LEADING = 1.3


def _n(value: float) -> str:
    return f"{round(value, 1) + 0.0:g}"


class Canvas:
    """A drawing of 640 units in width, so that its text is legible on a phone too.

    Args:
        height: Its height.
        title: What it shows, for people who do not see it.
        width: Its width.
    """

    def __init__(self, height: float, title: str, width: float = 640) -> None:
        self.width, self.height, self.title = width, height, title
        self._parts: list[str] = []

    # -- shapes -----------------------------------------------------------------------------------------

    def line(
        self,
        *points: Point,
        color: str = "ink",
        width: float = 1.8,
        dash: str = "",
        end: bool = False,
        both: bool = False,
    ) -> None:
        """A line through points; with an arrow at its end, or at both."""
        path = "M" + " L".join(f"{_n(x)} {_n(y)}" for x, y in points)
        dashes = f' stroke-dasharray="{dash}"' if dash else ""
        self._parts.append(f'<path class="s-{color}" stroke-width="{_n(width)}"{dashes} d="{path}"/>')
        if end or both:
            self._arrow(points[-2], points[-1], color)
        if both:
            self._arrow(points[1], points[0], color)

    def _arrow(self, before: Point, tip: Point, color: str) -> None:
        dx, dy = tip[0] - before[0], tip[1] - before[1]
        length = (dx * dx + dy * dy) ** 0.5 or 1.0
        dx, dy = dx / length, dy / length
        sides = [(tip[0] - 9 * dx + s * 4.5 * dy, tip[1] - 9 * dy - s * 4.5 * dx) for s in (1, -1)]
        self.polygon(tip, *sides, fill=color)

    def polygon(self, *points: Point, fill: str = "box", stroke: str = "") -> None:
        """A filled polygon."""
        corners = " ".join(f"{_n(x)},{_n(y)}" for x, y in points)
        outline = f" s-{stroke}" if stroke else ""
        self._parts.append(f'<polygon class="f-{fill}{outline}" points="{corners}"/>')

    def box(
        self,
        x: float,
        y: float,
        w: float,
        h: float,
        *,
        fill: str = "box",
        stroke: str = "ink",
        r: float = 6,
        dash: str = "",
    ) -> None:
        """A rectangle with round corners."""
        outline = f" s-{stroke}" if stroke else ""
        dashes = f' stroke-dasharray="{dash}"' if dash else ""
        self._parts.append(
            f'<rect class="f-{fill}{outline}" stroke-width="1.6"{dashes} x="{_n(x)}" y="{_n(y)}" width="{_n(w)}" '
            f'height="{_n(h)}" rx="{_n(r)}"/>'
        )

    def circle(self, x: float, y: float, r: float, *, fill: str = "paper", stroke: str = "ink") -> None:
        """A circle."""
        outline = f" s-{stroke}" if stroke else ""
        self._parts.append(
            f'<circle class="f-{fill}{outline}" stroke-width="1.8" cx="{_n(x)}" cy="{_n(y)}" r="{_n(r)}"/>'
        )

    def dot(self, x: float, y: float, color: str = "ink") -> None:
        """A joint of wires."""
        self.circle(x, y, 3.4, fill=color, stroke="")

    def text(
        self,
        x: float,
        y: float,
        text: str,
        *,
        color: str = "ink",
        size: float = _SIZE,
        anchor: str = "start",
        bold: bool = False,
        mono: bool = False,
    ) -> None:
        """Text, its first base line at `y`; a line break begins the next line.

        Args:
            x: Left end, middle or right end, as `anchor` says: ``start``, ``middle``, ``end``.
            y: Its base line.
            text: One or several lines.
            color: A colour's name.
            size: Height of the letters.
            anchor: See `x`.
            bold: In bold.
            mono: Letters of equal width.
        """
        kinds = " ".join(filter(None, (f"f-{color}", "b" if bold else "", "m" if mono else "")))
        lines = text.split("\n")
        for i, row in enumerate(lines):
            at = y + i * size * _LEADING
            self._parts.append(
                f'<text class="{kinds}" font-size="{_n(size)}" text-anchor="{anchor}" x="{_n(x)}" y="{_n(at)}">'
                f"{escape(row, quote=False)}</text>"
            )

    def labelled(self, x: float, y: float, w: float, h: float, text: str, *, sub: str = "") -> None:
        """A box with a bold text in its middle, and smaller lines below that."""
        self.box(x, y, w, h)
        small = sub.split("\n") if sub else []
        heads = text.split("\n")
        total = len(heads) * _SIZE * _LEADING + len(small) * 13 * _LEADING
        top = y + (h - total) / 2 + _SIZE
        self.text(x + w / 2, top, text, anchor="middle", bold=True)
        if small:
            self.text(
                x + w / 2, top + len(heads) * _SIZE * _LEADING - 1, sub, anchor="middle", size=13, color="soft"
            )

    def wave(
        self, x: float, y: float, levels: Sequence[tuple[float, int]], *, h: float = 26, color: str = "blue"
    ) -> None:
        """A digital signal: (length, level) one after the other; `y` is the low level."""
        points: list[Point] = []
        at = x
        for length, level in levels:
            points += [(at, y - level * h), (at + length, y - level * h)]
            at += length
        self.line(*points, color=color, width=2.2)

    # -- the file ---------------------------------------------------------------------------------------

    def svg(self) -> str:
        """The drawing as a file."""
        width, height = _n(self.width), _n(self.height)
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" '
            f'height="{height}" role="img">\n'
            f"<title>{escape(self.title, quote=False)}</title>\n<style>\n{_style()}</style>\n"
            f'<rect class="f-paper" width="{width}" height="{height}" rx="8"/>\n'
            + "\n".join(self._parts)
            + "\n</svg>\n"
        )


def _style() -> str:
    def variables(colors: dict[str, str]) -> str:
        return "".join(f"--{name}:{value};" for name, value in colors.items())

    rules = [f"svg{{{variables(_LIGHT)}font-family:{_FONT}}}"]
    rules.append(f"@media (prefers-color-scheme:dark){{svg{{{variables(_DARK)}}}}}")
    rules.append("path{fill:none;stroke-linejoin:round;stroke-linecap:round}")
    rules += [f".f-{name}{{fill:var(--{name})}} .s-{name}{{stroke:var(--{name})}}" for name in _LIGHT]
    rules.append(f".b{{font-weight:600}} .m{{font-family:{_MONO}}}")
    return "\n".join(rules) + "\n"
