"""The page Fleet: the shared arms that this program may see, and their stop.

Owns what the page shows; `static/fleet.js` draws it. Must not know how arms are found or stopped.
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

    tab = studio.tab()
    ui.html("Fleet", sanitize=False, tag="h1")
    mount("fleet.js", ui.element("div").classes("hw-fleet"), tab=tab.key, operate=tab.right >= Right.OPERATE)
