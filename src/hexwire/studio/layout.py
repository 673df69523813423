"""What every page has: the facts that are always in sight, STOP, control, navigation.

Owns the frame around a page. Facts are filled in by `static/live.js` from the live socket, without NiceGUI's. Must
not know what a page shows.
"""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable
from html import escape
from typing import TYPE_CHECKING

from .access import Right

if TYPE_CHECKING:
    from nicegui import Client
    from nicegui.element import Element

    from .access import Session
    from .app import Studio
    from .tabs import Tab

__all__ = ["build_page", "every", "mount", "on_press"]

_WITH_A_CONNECTION = (
    "() => (window.hexwire?.late"
    " ? window.hexwire.say('No connection to the studio: the button did nothing') : emit())"
)
_FACTS = (
    ("connection", "Connection"),
    ("dialect", "Dialect"),
    ("rate", "Rate"),
    ("trip", "Round trip"),
    ("faults", "Faults"),
    ("holder", "Control"),
    ("torque", "Torque"),
)


async def build_page(studio: Studio, session: Session) -> None:
    """Build the frame and, in it, the page of the address."""
    from nicegui import context, ui

    from .page_sockets import OWNER
    from .pages import PAGES

    tab = studio.tabs.open(session.key, session.right)
    client = context.client
    client.storage["tab"] = tab
    client.storage[OWNER] = session.key
    client.on_delete(lambda: _forget(studio, tab, client))
    ui.add_head_html(
        '<link rel="stylesheet" href="/static/studio.css">'
        f'<meta name="hexwire-tab" content="{escape(tab.key)}">'
        '<script type="module" src="/static/live.js"></script>'
    )
    client.content.classes("hw-content")
    with ui.element("header").classes("hw-header"):
        ui.link("Skip to the page", "#hw-main").classes("hw-skip")
        with ui.element("nav").classes("hw-nav").props('aria-label="Pages"'):
            for page in PAGES:
                ui.link(page.title, page.path).classes("hw-nav-link").props(f'data-path="{page.path}"')
        with ui.element("dl").classes("hw-facts").props('aria-label="Facts"'):
            for name, words in _FACTS:
                with ui.element("div").classes("hw-fact"):
                    with ui.element("dt"):
                        ui.html(words, sanitize=False, tag="span")
                    ui.element("dd").props(f'id="hw-fact-{name}"')
        with ui.element("div").classes("hw-actions"):
            _build_control(studio)
            with ui.element("button").classes("hw-button").props('id="hw-theme" type="button"'):
                ui.html("Theme", sanitize=False, tag="span")
            # Its handler is in live.js, which needs nothing of NiceGUI: it works while all else hangs.
            with ui.element("button").classes("hw-stop").props('id="hw-stop" type="button" title="Stop (Escape)"'):
                ui.html("STOP", sanitize=False, tag="span")
    ui.element("div").classes("hw-banner").props('id="hw-banner" role="status" aria-live="polite"')
    with ui.element("main").classes("hw-main").props('id="hw-main" tabindex="-1"'):
        ui.sub_pages({page.path: _builder(studio, page.path) for page in PAGES})


def _forget(studio: Studio, tab: Tab, client: Client) -> None:
    """A page is gone."""
    studio.tabs.close(tab)
    # NiceGUI's collections hold themselves, by what they call when they change: 1,000 objects of a page that only
    # the garbage collector would find.
    for element in client.elements.values():
        for name in ("_classes", "_style", "_props"):
            handlers = getattr(getattr(element, name, None), "_change_handlers", None)
            if isinstance(handlers, list):
                handlers.clear()


def _build_control(studio: Studio) -> None:
    """Take control, give it back, resume, torque: their state comes over the live socket."""
    from nicegui import ui

    tab = studio.tab()

    async def take() -> None:
        await studio.run(lambda: studio.take(tab, force=True))

    async def leave() -> None:
        await studio.run(lambda: studio.source.leave(tab))

    async def resume() -> None:
        arm, bus = studio.source.arm, studio.source.bus
        # Marked now: it waits for a thread, and a stop that comes meanwhile must stay.
        if bus is not None:
            since = bus.mark()
            await studio.run(lambda: bus.resume(since), control=True)
        if arm is not None:
            token = arm.mark()
            await studio.run(lambda: arm.shared.resume(arm.order(tab, token)), control=True)

    async def torque(on: bool) -> None:
        arm, bus = studio.source.arm, studio.source.bus
        if bus is not None:
            await studio.run(lambda: bus.switch_torque(on), control=True)
        if arm is not None:
            token = arm.mark()
            await studio.run(lambda: arm.shared.torque(arm.order(tab, token), on, None), control=True)

    def button(words: str, name: str, handler: Callable[[], object]) -> None:
        with ui.element("button").classes("hw-button").props(f'id="hw-{name}" type="button" hidden') as made:
            ui.html(words, sanitize=False, tag="span")
        on_press(made, handler)

    if tab.right >= Right.OPERATE:
        button("Take control", "take", take)
        button("Give back", "leave", leave)
        button("Resume", "resume", resume)
        button("Torque on", "torque-on", lambda: torque(True))
        button("Torque off", "torque-off", lambda: torque(False))


def _builder(studio: Studio, path: str) -> Callable[[], None]:
    def build() -> None:
        from .pages import load

        load(path)(studio)

    return build


def every(seconds: float, call: Callable[[], Awaitable[object] | None]) -> None:
    """Call something now and then, while the page has its socket; it is kept for a while without."""
    from nicegui import context, ui

    client = context.client
    ui.timer(seconds, lambda: call() if client.has_socket_connection else None)


def on_press(element: Element, call: Callable[..., object], *, late: bool = False) -> None:
    """Call something when a button is pressed.

    Args:
        element: The button.
        call: What it does; may be a coroutine function.
        late: Also if it is pressed without a connection. NiceGUI keeps such a press, and `call` is made when the
            connection is back, a minute later at worst: only for what ends something.
    """
    element.on("click", call, js_handler="() => emit()" if late else _WITH_A_CONNECTION)


def mount(module: str, element: Element, **args: object) -> None:
    """Let a module of ``static/`` take over an element of the page: calls its export ``mount(element, args)``.

    Args:
        module: Its file, such as ``arm.js``.
        element: The element.
        **args: What JSON can hold.
    """
    from nicegui import ui

    # While the module was loaded the page may have been drawn again, or left: then there is nothing to take over.
    place = f"const place = document.getElementById('c{element.id}')"
    call = f"import('/static/{module}').then((m) => {{ {place}; if (place) m.mount(place, {json.dumps(args)}); }})"
    ui.run_javascript(call)
