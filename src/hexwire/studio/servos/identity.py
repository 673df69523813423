"""A guided change of id and rate, and the search for a servo whose change was cut off.

Owns what is asked and told. The steps belong to `bus.identity`, which cannot lose a servo.
"""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from hexwire.bus.identity import change_identity, find_again
from hexwire.errors import ServoError, UsageError
from hexwire.studio.app import FAILED

from .view import View, button, html, question, rate_words, section

if TYPE_CHECKING:
    from collections.abc import Iterable

    from hexwire.bus.setup import Found, ServoInfo

__all__ = ["build"]


def build(view: View, servo_id: int) -> None:
    """Build the part."""
    from nicegui import ui

    bus = view.bus
    here = bus.bus.timing.baud
    section(
        "Id and rate",
        "The id is changed first, then the rate. Each is read back, and goes back if the servo does not answer. "
        "If this is interrupted, the servo has its old or its new address, and is found there again.",
    )
    with ui.element("div").classes("sv-form"):
        new = ui.number("New id", value=servo_id, min=0, max=253, step=1, format="%d").props("dense outlined")
        options = _rates(here, bus.bus.series_of(servo_id).baud_codes.values())
        rate = ui.select(options, value=here if here in options else next(iter(options)), label="New rate")
        rate.props("dense outlined options-dense")
        go = button("Change", lambda: change(), level="main")
    steps = ui.element("ol").classes("sv-steps").props('aria-live="polite"')
    again = button("Look for it again", lambda: look())
    again.set_visibility(False)
    wanted: dict[str, int] = {}
    told: list[str] = []

    def show() -> None:
        steps.clear()
        with steps:
            for words in tuple(told):
                ui.html(escape(words), sanitize=False, tag="li")

    watch = ui.timer(0.1, show, active=False)

    async def change() -> None:
        number = new.value
        if number is None or number != int(number):
            ui.notify("an id is a whole number from 0 to 253", type="negative")
            return
        wanted.update(id=int(number), baud=int(rate.value or here))
        what = []
        if wanted["id"] != servo_id:
            what.append(
                f"Servo {servo_id} becomes servo {wanted['id']}. An arm that expects servo {servo_id} misses it."
            )
        if wanted["baud"] != here:
            what.append(f"It answers at {wanted['baud']} baud only; the other servos stay at {here}.")
        if not what:
            ui.notify("nothing to change")
            return
        if not await question("Change the servo's address", "\n".join([*what, "Both are stored."]), "Change it"):
            return
        told.clear()
        again.set_visibility(False)
        go.set_visibility(False)
        watch.activate()
        try:
            info = await view.act(lambda: _change(view, servo_id, wanted["id"], wanted["baud"], told))
        finally:
            watch.deactivate()
            go.set_visibility(True)
            show()
        if info is FAILED:
            again.set_visibility(True)
            return
        view.selected = wanted["id"]
        ui.notify(f"servo {wanted['id']} answers at {rate_words(bus.bus.timing.baud)}", type="positive")
        view.relist()
        view.redraw()

    async def look() -> None:
        found = await view.act(lambda: _look(view, (servo_id, wanted["id"]), (here, wanted["baud"])))
        if found is FAILED:
            html("Switch its supply off and on, then look again.", "p", "sv-hint")
            return
        view.selected = found.servo_id
        ui.notify(f"servo {found.servo_id} answers at {rate_words(found.baud)}", type="positive")
        view.relist()
        view.redraw()


def _rates(here: int, known: Iterable[int]) -> dict[int, str]:
    """The rates to choose from, in words. A line without a rate could not follow a change of it."""
    if not here:
        return {here: rate_words(here)}
    rates = {baud: rate_words(baud) for baud in sorted(known, reverse=True)}
    return rates or {here: "the rate of this series is fixed"}


def _change(view: View, servo_id: int, new_id: int, new_baud: int, told: list[str]) -> ServoInfo:
    bus = view.bus
    if not 0 <= new_id <= 253:
        raise UsageError(f"id {new_id} is outside 0..253")
    with bus.bench.working("a change of id and rate", acts=True, changes_rate=True):
        info = change_identity(bus.bus, servo_id, new_id=new_id, new_baud=new_baud, step=told.append)
        bus.edits.moved(servo_id, new_id)
        bus.look_again(new_id, former=servo_id)
    return info


def _look(view: View, ids: tuple[int, int], bauds: tuple[int, int]) -> Found:
    with view.bus.bench.working("the search for a servo", changes_rate=True):
        found = find_again(view.bus.bus, ids, bauds)
        if found is None:
            raise ServoError(f"it answers neither as {ids[0]} nor as {ids[1]}: switch its supply off and on")
        view.bus.look_again(found.servo_id, former=next((i for i in ids if i != found.servo_id), None))
    return found
