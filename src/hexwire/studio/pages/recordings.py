"""The page Recordings: list, plot, play on the twin or the arm, compare two.

Owns the frame of the page; `static/recordings.js` fills it from `hexwire.studio.recordings_api`. Must not know
other pages.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hexwire.studio.access import Right
from hexwire.studio.layout import mount

if TYPE_CHECKING:
    from hexwire.studio.app import Studio

__all__ = ["build"]


def build(studio: Studio) -> None:
    """Build the page."""
    from nicegui import ui

    ui.html("Recordings", sanitize=False, tag="h1")
    operates = studio.tab().right >= Right.OPERATE
    mount("recordings.js", ui.element("div").classes("pl-page"), operates=operates)
