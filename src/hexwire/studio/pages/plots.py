"""The page Plots: any signal of any joint over the last ten minutes.

Owns the frame of the page; `static/plots.js` draws it from the live socket and `hexwire.studio.files`. Must not
know other pages.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hexwire.studio.layout import mount

if TYPE_CHECKING:
    from hexwire.studio.app import Studio

__all__ = ["build"]


def build(studio: Studio) -> None:
    """Build the page."""
    from nicegui import ui

    ui.html("Plots", sanitize=False, tag="h1")
    mount("plots.js", ui.element("div").classes("pl-page"))
