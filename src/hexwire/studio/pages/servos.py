"""The page Servos: search, registers, ids, calibration, waves and health of the servos on a bus.

Owns the order of the parts: a list at the left, one servo at the right; on a phone one below the other. What each
part shows belongs to `hexwire.studio.servos`. Must not know other pages.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from hexwire.studio.layout import every

if TYPE_CHECKING:
    from hexwire.studio.app import Studio
    from hexwire.studio.servos.view import View

__all__ = ["build"]

_PARTS = (
    ("overview", "Overview"),
    ("registers", "Registers"),
    ("identity", "Id and rate"),
    ("middle", "Calibration"),
    ("wave", "Wave"),
    ("health", "Health"),
    ("stress", "Stress test"),
    ("backup", "Backup"),
    ("whole_arm", "Set up an arm"),
)


def build(studio: Studio) -> None:
    """Build the page, and again whenever something else is open."""
    from nicegui import ui

    ui.add_css("@import url('/static/servos.css');")
    ui.html("Servos", sanitize=False, tag="h1")
    place = ui.element("div").classes("sv-page")
    shown: list[object] = []

    def draw() -> None:
        source = studio.source
        now = source.present if source.mode in ("arm", "bus") else source.mode
        if shown and shown[0] is now:
            return
        shown[:] = [now]
        place.clear()
        with place:
            if source.bus is not None:
                _workbench(studio)
            elif source.arm is not None:
                from hexwire.studio.servos import board

                with ui.element("section").classes("sv-board").props('aria-label="Servos of the arm"'):
                    board.build(studio, source.arm)
            else:
                _closed(studio)

    draw()
    every(0.3, draw)


def _closed(studio: Studio) -> None:
    """Nothing is open: offer to open a bus."""
    from nicegui import ui

    from hexwire.drivers.board_reset import RESET_WARNING
    from hexwire.studio.servos.view import button, html

    html("Nothing is open. Open the adapter of a servo bus here, or an arm on the page Connect.", "p", "sv-hint")
    html(f"If a controller board is there instead: {RESET_WARNING}.", "p", "sv-hint")
    with ui.element("div").classes("sv-form"):
        # What could not be opened as an arm may be a bus of servos that are none yet.
        port = ui.input("Port or address of the adapter", value=studio.source.refused)
        port.classes("sv-address").props("dense outlined maxlength=200")

        async def start() -> None:
            url = str(port.value or "").strip()
            tab = studio.tab()

            def call() -> None:
                # Both at once: this part of the page is gone as soon as the bus is open.
                studio.source.open_bus(url)
                studio.take(tab)

            if url:
                await studio.run(call)

        button("Open the servo bus", start, level="main")


def _workbench(studio: Studio) -> None:
    from nicegui import ui

    from hexwire.studio.servos import search
    from hexwire.studio.servos.view import View, button, question

    bus = studio.source.need_bus()
    view = View(studio, bus, studio.tab())
    ids = bus.bench.servo_ids
    view.selected = ids[0] if ids else None

    async def close() -> None:
        text = "Servos with torque keep it and hold where they are."
        if await question("Close the servo bus", text, "Close it", danger=False):
            await view.act(studio.source.close)

    with ui.element("div").classes("sv-columns"):
        with ui.element("section").classes("sv-left").props('aria-label="Servos found"'):
            search.build_search(view)
            button("Close the servo bus", close)
        with ui.element("section").classes("sv-right").props('aria-label="One servo"'):
            _detail(view)


def _detail(view: View) -> None:
    from nicegui import ui

    tabs = ui.element("div").classes("sv-tabs").props('role="tablist" aria-label="Parts"')
    body = ui.element("div").classes("sv-part").props('role="tabpanel" tabindex="0"')
    made: dict[str, Any] = {}

    def choose(part: str) -> None:
        view.part = part
        draw()

    with tabs:
        for name, words in _PARTS:
            made[name] = _tab(name, words, choose)

    def draw() -> None:
        for name, element in made.items():
            element.props["aria-selected"] = "true" if name == view.part else "false"
            element.props["tabindex"] = "0" if name == view.part else "-1"
            element.update()
        body.clear()
        with body:
            _part(view)

    view.redraw = draw
    draw()


def _tab(name: str, words: str, choose: Callable[[str], None]) -> Any:
    from nicegui import ui

    from hexwire.studio.servos.view import html

    made = ui.element("button").classes("sv-tab").props('type="button" role="tab"')
    with made:
        html(words)
    made.on("click", lambda: choose(name))
    # Arrow keys go from tab to tab, as everywhere.
    made.on(
        "keydown",
        js_handler="""(event) => {
          const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
          if (!step) return;
          const all = [...event.currentTarget.parentElement.children];
          const next = all[(all.indexOf(event.currentTarget) + step + all.length) % all.length];
          next.focus();
          next.click();
        }""",
    )
    return made


def _part(view: View) -> None:
    from importlib import import_module

    from hexwire.studio.servos.view import html

    if view.part == "whole_arm":
        import_module("hexwire.studio.servos.whole_arm").build(view)
        return
    if view.selected is None:
        html("Search servos first, then choose one.", "p", "sv-hint")
        return
    html(f"Servo {view.selected}", "h2", "sv-h2")
    import_module(f"hexwire.studio.servos.{view.part}").build(view, view.selected)
