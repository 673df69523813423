"""The page Connect: what is plugged in, what it probably is, and opening it.

Owns what the page shows. Must not know how ports are found or opened.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from hexwire.drivers.board_reset import RESET_WARNING
from hexwire.drivers.registry import DEFAULT_ROBOT
from hexwire.studio.access import Right
from hexwire.studio.layout import every, on_press
from hexwire.studio.plugged import Plugged, emulated, find_plugged, robots

if TYPE_CHECKING:
    from hexwire.studio.app import Studio

__all__ = ["build"]

_LOOK = 2.0
"""Seconds between two looks at the ports."""


def build(studio: Studio) -> None:
    """Build the page."""
    from nicegui import ui

    tab = studio.tab()
    # What was there a moment ago is shown at once: a table that comes later would push its neighbours away.
    seen = studio.plugged

    async def connect(url: str, robot: str | None) -> None:
        from hexwire.studio.app import FAILED

        if await studio.run(lambda: studio.open(tab, url, robot)) is not FAILED:
            ui.navigate.to("/arm")

    async def close() -> None:
        await studio.run(lambda: studio.close_source(tab))
        show_present()

    def text(words: str, tag: str = "span", classes: str = "") -> None:
        with ui.element(tag).classes(classes):
            ui.label(words).classes("hw-plain")

    def button(words: str, name: str, handler: Callable[[], object]) -> None:
        with ui.element("button").classes("hw-button").props(f'type="button" aria-label="{name}"') as made:
            ui.label(words).classes("hw-plain")
        on_press(made, handler)

    def table(rows: list[Plugged], caption: str) -> None:
        with ui.element("table").classes("hw-table"):
            text(caption, "caption", "hw-caption")
            with ui.element("thead"), ui.element("tr"):
                for head in ("Port", "Probably", "State", "Robot", ""):
                    text(head, "th")
            with ui.element("tbody"):
                for row in rows:
                    with ui.element("tr"):
                        text(row.device, "th", "hw-code")
                        text(row.guess, "td")
                        with ui.element("td"):
                            text(row.obstacle or "can be opened", "div", "" if not row.obstacle else "hw-bad")
                            if row.advice:
                                text(row.advice, "div", "hw-dim")
                        _choice(row)

    def _choice(row: Plugged) -> None:
        names = list(dict.fromkeys([*row.robots, DEFAULT_ROBOT, *robots()]))
        with ui.element("td"):
            if row.device.startswith("sim://"):
                ui.label(row.robots[0])
                chosen = None
            else:
                chosen = ui.select(names, value=names[0]).props(
                    f'dense outlined options-dense aria-label="Robot on {row.device}"'
                )
        with ui.element("td"):
            if tab.right >= Right.OPERATE:
                robot = None if chosen is None else chosen

                async def go(url: str = row.device) -> None:
                    await connect(url, None if robot is None else str(robot.value))

                button("Open", f"Open {row.device}", go)

    @ui.refreshable
    def present() -> None:
        source = studio.source
        if source.error:
            text(f"Not opened: {source.error}", "p", "hw-bad")
        if source.present is None:
            text("Nothing is open. Choose a port, or enter an address.", "p")
            return
        with ui.element("div").classes("hw-row"):
            where = source.arm.driver.url if source.arm is not None else "the servo bus"
            text(f"Open: {where}")
            if tab.right >= Right.OPERATE:
                button("Close", "Close what is open", close)

    @ui.refreshable
    def ports() -> None:
        if seen is None:
            text("Looking for ports …", "p", "hw-dim")
        elif not seen:
            text(
                "No serial port on this machine. Plug in the board or the adapter, or try another cable.",
                "p",
            )
        else:
            table(seen, "Plugged in")

    async def look() -> None:
        nonlocal seen
        found = await studio.run(find_plugged)
        if isinstance(found, list) and found != seen:
            seen = studio.plugged = found
            ports.refresh()
        show_present()

    def what_is_open() -> tuple[object, ...]:
        return studio.source.error, studio.source.present

    shown = what_is_open()

    def show_present() -> None:
        # Only after a change: a button that is made again loses the focus, and a press that has begun on it.
        nonlocal shown
        if shown != (now := what_is_open()):
            shown = now
            present.refresh()

    text("Connect", "h1")
    with ui.element("div").classes("hw-present"):
        present()
    ports()
    table(list(emulated()), "Without hardware")
    with ui.element("div").classes("hw-row"):
        port = ui.input("Port or address", placeholder="zenoh:lab/arm1").props("dense outlined")
        port.classes("hw-choice")
        robot = (
            ui.select(["", *robots()], value="", label="Robot")
            .classes("hw-choice")
            .props("dense outlined options-dense")
        )

        async def typed() -> None:
            await connect(str(port.value or "").strip(), str(robot.value) or None)

        if tab.right >= Right.OPERATE:
            button("Open", "Open this address", typed)
    if tab.right >= Right.OPERATE:
        text(f"A serial port, or a bridge to one: {RESET_WARNING}.", "p", "hw-dim")
    every(_LOOK, look)
    ui.timer(0.0, partial(look), once=True)
