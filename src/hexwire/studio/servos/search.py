"""The left side: search servos at all ids and rates, and the list of those that were found.

Owns the form of a search and the list. Must not know what is done with a servo.
"""

from __future__ import annotations

import math
from html import escape
from typing import TYPE_CHECKING, Any

from hexwire.bus.ids import parse_ids
from hexwire.drivers.bus_checkup import SERVO_RATES
from hexwire.studio.layout import mount

from .view import View, button, html, rate_words, table

if TYPE_CHECKING:
    from hexwire.bus.survey import Surveyed

__all__ = ["build_search"]


def build_search(view: View) -> None:
    """Build the form and the list."""
    from nicegui import ui

    bus = view.bus
    html("Search", "h2", "sv-h2")
    with ui.element("div").classes("sv-form"):
        here = bus.bus.timing.baud
        rates = {0: f"{rate_words(here)} (now)", -1: "all rates", **{rate: f"{rate} baud" for rate in SERVO_RATES}}
        rate = ui.select(rates, value=0, label="Rates").props("dense outlined options-dense")
        ids = ui.input("Ids", value="0-253").props("dense outlined maxlength=60")
        search = button("Search", lambda: start(), level="main")
        cancel = button("Cancel", lambda: bus.bench.cancel(), late=True)
        cancel.set_visibility(False)
    with ui.element("div").classes("sv-progress-place"):
        bar = ui.element("progress").classes("sv-progress").props('max="1" aria-label="Progress of the search"')
    told = html("", "p", "sv-hint sv-status")
    told.props('role="status"')
    bar.set_visibility(False)
    doing = html("", "p", "sv-doing")
    place = ui.element("div").classes("sv-list")

    def progress() -> None:
        job = bus.bench.job
        if job is not None and job.what == "a search":
            told.set_content(escape(job.told))
            bar.props["value"] = 0 if math.isnan(job.share) else round(job.share, 3)
            bar.update()

    watch = ui.timer(0.2, progress, active=False)

    async def start() -> None:
        async def find() -> Any:
            def call() -> list[Surveyed]:
                value = int(rate.value or 0)
                wanted = [] if not value else list(SERVO_RATES) if value == -1 else [value]
                return bus.search(wanted, list(dict.fromkeys(parse_ids(str(ids.value or "")))))

            return await view.act(call)

        search.set_visibility(False)
        cancel.set_visibility(True)
        bar.set_visibility(True)
        watch.activate()
        try:
            found = await find()
        finally:
            watch.deactivate()
            bar.set_visibility(False)
            cancel.set_visibility(False)
            search.set_visibility(True)
        if isinstance(found, list):
            words = f"{len(found)} servo{'s' if len(found) != 1 else ''} found"
            told.set_content(escape(words if found else "no servo answers: check power, cable and rate"))
            if view.selected is None or view.bus.find(view.selected) is None:
                view.selected = bus.bench.servo_ids[0] if bus.bench.servo_ids else None
            view.relist()
            view.redraw()
        else:
            told.set_content("")

    def pick(event: Any) -> None:
        data = event.args.get("detail") or {}
        name, value = str(data.get("do", "")), str(data.get("value", ""))
        if name == "select" and value.isdigit() and int(value) in bus.bench.servo_ids:
            view.selected = int(value)
            show()
            view.redraw()
        elif name == "rate" and value.isdigit():
            ui.timer(0, lambda: at_rate(int(value)), once=True)

    async def at_rate(baud: int) -> None:
        if baud in SERVO_RATES:
            await view.act(lambda: bus.use_rate(baud))
            view.selected = bus.bench.servo_ids[0] if bus.bench.servo_ids else None
            view.relist()
            view.redraw()

    place.on("act", pick, args=["detail"])

    def show() -> None:
        place.clear()
        with place:
            ui.html(_list(view), sanitize=False)

    view.relist = show
    show()
    mount("servos.js", place, part="list", doing=f"c{doing.id}")


def _list(view: View) -> str:
    bus = view.bus
    here = bus.bus.timing.baud
    rows, elsewhere = [], dict[int, list[int]]()
    for row in bus.servos:
        found, info = row.found, row.found.info
        if found.baud != here:
            elsewhere.setdefault(found.baud, []).append(found.servo_id)
            continue
        chosen = found.servo_id == view.selected
        usable = found.servo_id in bus.bench.servo_ids
        name = f"{found.servo_id}"
        if usable:
            name = (
                f'<button type="button" class="sv-pick" data-do="select" data-value="{found.servo_id}" '
                f'aria-pressed="{"true" if chosen else "false"}" aria-label="Servo {found.servo_id}">'
                f"{found.servo_id}</button>"
            )
        model = escape(info.model_name or (info.series.value if info.series else "?")) if info is not None else "?"
        version = info.firmware if info is not None else ""
        more = escape(", ".join(part for part in (f"fw {version}" if version else "", row.kind) if part))
        level = "error" if row.bad else "warn" if row.remarks else "ok"
        words = "; ".join(remark.text for remark in row.remarks) or "nothing known against it"
        mark = {"error": "!", "warn": "i", "ok": "✓"}[level]
        # It cannot be chosen, so the reason must be in sight here.
        why = "" if usable else f'<span class="sv-note" data-level="{level}">{escape(words)}</span>'
        live = [
            f'<span data-live="{name}" data-id="{found.servo_id}">–</span>' for name in ("deg", "volts", "celsius")
        ]
        state = (
            f'<span class="sv-mark" data-level="{level}" title="{escape(words)}" role="img" '
            f'aria-label="{escape(words)}">{mark}</span>'
            f'<span class="sv-state" data-live="state" data-id="{found.servo_id}"></span>'
        )
        rows.append((name, f'{model}<span class="sv-chip">{more}</span>{why}', *live, state))
    text = ""
    if rows:
        head = ("Id", "Model", "#deg", "#V", "#°C", "State")
        text = table(head, rows, caption=f"Servos at {rate_words(here)}")
    elif not elsewhere:
        text = '<p class="sv-hint">No servo is known yet. Take control, then search.</p>'
    for baud, ids in sorted(elsewhere.items()):
        names = ", ".join(map(str, ids))
        text += (
            f'<p class="sv-hint">At {baud} baud: {names} <button type="button" class="hw-button" data-do="rate" '
            f'data-value="{baud}">Work at {baud} baud</button></p>'
        )
    return text
