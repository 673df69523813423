"""The start page: what is plugged in, what it probably is, and opening it.

Owns what the page shows. Must not know how ports are found or opened.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hexwire.studio.app import Studio

__all__ = ["build"]


def build(studio: Studio) -> None:
    """Build the page."""
    from nicegui import ui

    ui.html("Connect", sanitize=False, tag="h1")
    with ui.row().classes("hw-row"):
        port = ui.input("Port or address", value="sim://hex7bot").props("dense outlined")
        robot = ui.input("Robot (optional)").props("dense outlined")

        async def connect() -> None:
            url, name = port.value or "", robot.value or None
            if await studio.run(lambda: studio.source.open(url, name)):
                ui.navigate.to("/arm")

        ui.button("Open", on_click=connect, color=None).classes("hw-button")
