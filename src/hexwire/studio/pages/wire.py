"""The page Wire: the traffic of the line in the layers of the protocol, or that of a file.

Owns what the page shows; `static/wire.js` draws it, since it changes at the rate of the line. Must not know how
traffic is read.
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

    ui.html("Wire", sanitize=False, tag="h1")
    mount("wire.js", ui.element("div").classes("hw-wire"), tab=studio.tab().key)
