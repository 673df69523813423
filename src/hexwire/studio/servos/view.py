"""What one tab shows of the servos: which servo, which part, and small things that all parts use.

Owns the tab's selection, questions before a change, and tables as HTML. Must not know what a part shows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING, Any, TypeVar

from hexwire.errors import LinkLostError
from hexwire.studio.layout import on_press

if TYPE_CHECKING:
    from nicegui.element import Element

    from hexwire.studio.app import Studio
    from hexwire.studio.bus_source import BusSource
    from hexwire.studio.tabs import Tab

__all__ = ["View", "button", "download", "facts", "html", "question", "rate_words", "section", "table"]

_T = TypeVar("_T")


@dataclass(eq=False)
class View:
    """One tab at one servo bus.

    Attributes:
        studio: The studio.
        bus: The servo bus that was open when the page was built.
        tab: The tab.
        selected: The servo that is shown; None for all.
        part: The part that is shown.
        redraw: Shows the selected part again.
        relist: Shows the list of servos again.
    """

    studio: Studio
    bus: BusSource
    tab: Tab
    selected: int | None = None
    part: str = "overview"
    redraw: Callable[[], object] = field(default=lambda: None)
    relist: Callable[[], object] = field(default=lambda: None)

    async def read(self, call: Callable[[], _T]) -> _T | Any:
        """Ask the bus something; `FAILED` after the error was shown."""
        return await self.studio.run(lambda: self._checked(call))

    async def act(self, call: Callable[[], _T]) -> _T | Any:
        """Change something; needs control."""
        return await self.studio.run(lambda: self._checked(call), control=True)

    def _checked(self, call: Callable[[], _T]) -> _T:
        if self.studio.source.bus is not self.bus:
            raise LinkLostError("this servo bus was closed; load the page again")
        return call()


def html(text: str, tag: str = "span", classes: str = "") -> Any:
    """A piece of text; it is escaped."""
    from nicegui import ui

    return ui.html(escape(text), sanitize=False, tag=tag).classes(classes)


def button(
    words: str, call: Any, *, level: str = "", label: str = "", late: bool = False, offline: bool = False
) -> Element:
    """A button.

    Args:
        words: Its text.
        call: What it does; may be a coroutine function.
        level: "main" or "danger", or empty.
        label: Its name for screen readers, where the text alone says too little.
        late: As for `on_press`.
        offline: It can be pressed while nobody knows how the servos are, as one that is late can.
    """
    from nicegui import ui

    more = f"{f'sv-{level}' if level else ''} {'sv-offline' if offline or late else ''}"
    made = ui.element("button").classes(f"hw-button {more}").props('type="button"')
    if label:
        made.props["aria-label"] = label
    with made:
        html(words)
    on_press(made, call, late=late)
    return made


def rate_words(baud: int) -> str:
    """A rate in words; 0 is that of a line which has none of its own, such as a TCP adapter."""
    return f"{baud} baud" if baud else "the rate of the line"


def section(words: str, hint: str = "") -> None:
    """A heading of a part, and a sentence about it."""
    html(words, "h3", "sv-h3")
    if hint:
        html(hint, "p", "sv-hint")


def facts(rows: Iterable[tuple[str, str]]) -> None:
    """Names and values in two columns."""
    from nicegui import ui

    body = "".join(f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in rows)
    ui.html(body, sanitize=False, tag="dl").classes("sv-facts")


def table(head: Sequence[str], rows: Iterable[Sequence[str]], *, caption: str) -> str:
    """A table as HTML.

    Args:
        head: Heads of the columns; a leading ``#`` makes a column of numbers.
        rows: Cells, escaped already; the first one of a row is its head.
        caption: What the table shows, for screen readers.
    """
    number = [name.startswith("#") for name in head]
    mark = [' class="sv-num"' if is_number else "" for is_number in number]
    heads = "".join(
        f'<th scope="col"{m}>{escape(name.lstrip("#"))}</th>' for name, m in zip(head, mark, strict=True)
    )
    body = []
    for row in rows:
        first, *rest = row
        cells = "".join(f"<td{m}>{cell}</td>" for cell, m in zip(rest, mark[1:], strict=True))
        body.append(f'<tr><th scope="row"{mark[0]}>{first}</th>{cells}</tr>')
    return (
        f'<div class="sv-scroll" tabindex="0" role="region" aria-label="{escape(caption)}"><table class="sv-table">'
        f"<caption>{escape(caption)}</caption><thead><tr>{heads}</tr></thead><tbody>{''.join(body)}</tbody></table></div>"
    )


async def question(title: str, text: str, yes: str, *, danger: bool = True) -> bool:
    """Ask before a change; True if the person agrees."""
    from nicegui import ui

    with ui.dialog() as dialog, ui.element("div").classes("sv-dialog"):
        dialog.props(f'aria-label="{escape(title)}"')
        html(title, "h2", "sv-h2")
        for line in text.split("\n"):
            html(line, "p")
        with ui.element("div").classes("hw-row"):
            button(yes, lambda: dialog.submit(True), level="danger" if danger else "main", offline=True)
            button("Cancel", lambda: dialog.submit(False), offline=True)
    try:
        return bool(await dialog)
    finally:
        dialog.delete()


def download(name: str, text: str) -> None:
    """Offer a file."""
    from nicegui import ui

    ui.download.content(text, name, "application/octet-stream")
