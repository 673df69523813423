"""The page Recordings.

Owns what the page shows. Must not know other pages.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hexwire.studio.app import Studio

__all__ = ["build"]


def build(studio: Studio) -> None:
    """Build the page."""
    from nicegui import ui

    ui.html("Recordings", sanitize=False, tag="h1")
