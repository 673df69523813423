"""The colours of joints, the same in every picture: plots, 3D views, tables, on paper and on dark screens.

Owns the two rows of colours and how they become CSS custom properties.

Neighbours in a row differ for people with any of the three kinds of colour blindness, and every colour has a
contrast of 3:1 or more on its background, so that a thin line can be seen.
"""

from __future__ import annotations

__all__ = ["DARK", "DARK_BACKGROUND", "LIGHT", "LIGHT_BACKGROUND", "joint_colour", "palette_css"]

LIGHT = ("#0a58b0", "#b02800", "#00a05c", "#e8459e", "#c47b00", "#8f52f5", "#443852", "#6d2720")
"""For light backgrounds, as ``#rrggbb``: the first joint has the first colour."""
DARK = ("#689bdc", "#e8622a", "#42e498", "#cc629a", "#efbb11", "#9a76ff", "#dbccd8", "#968259")
"""For dark backgrounds, in the same order and of the same hues."""
LIGHT_BACKGROUND = "#ffffff"
"""The lightest background that `LIGHT` is meant for."""
DARK_BACKGROUND = "#14181d"
"""The darkest background that `DARK` is meant for."""


def joint_colour(index: int, *, dark: bool = False) -> str:
    """The colour of a joint as ``#rrggbb``; beyond the last one they repeat.

    Args:
        index: Place of the joint in its arm, from 0.
        dark: For a dark background.
    """
    row = DARK if dark else LIGHT
    return row[index % len(row)]


def palette_css() -> str:
    """The colours as CSS custom properties ``--joint-1`` to ``--joint-8``.

    Dark ones apply in a page whose body has the class ``body--dark``, or whose root has ``data-theme="dark"``.
    """
    light, dark = (
        "".join(f"  --joint-{i}: {colour};\n" for i, colour in enumerate(row, 1)) for row in (LIGHT, DARK)
    )
    return (
        "/* Written from hexwire/model/palette.py; a test compares them. */\n"
        f":root {{\n{light}}}\n"
        f'.body--dark,\n:root[data-theme="dark"] {{\n{dark}}}\n'
    )
