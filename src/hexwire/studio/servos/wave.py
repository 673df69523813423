"""The wave of a servo: its form, the button that is held, and the plot of goal and position.

Owns what this part shows. `wave_run` runs the wave.
"""

from __future__ import annotations

import json
import math
from html import escape

from hexwire.errors import UsageError
from hexwire.motion.waves import SHAPES
from hexwire.studio.layout import mount

from .view import View, html, section
from .wave_run import add_wave, read_wave

__all__ = ["build"]


def build(view: View, servo_id: int) -> None:
    """Build the part."""
    from nicegui import ui

    add_wave(view.studio)
    section(
        "Wave",
        "The servo moves to both sides of where it stands while you hold the button, and returns at the end. "
        "If you release it earlier, the servo holds where it is.",
    )
    with ui.element("div").classes("sv-form"):
        shape = ui.select(list(SHAPES), value="sine", label="Shape").props("dense outlined options-dense")
        amplitude = ui.number("To either side, deg", value=10, min=0.1, max=45, step=1).props("dense outlined")
        period = ui.number("Period, s", value=2, min=0.2, max=600, step=0.1).props("dense outlined")
        last = ui.number("Last period, s", value=0.25, min=0.2, max=600, step=0.05).props("dense outlined")
        seconds = ui.number("Duration, s", value=6, min=0.5, max=600, step=1).props("dense outlined")
    told = html("", "p", "sv-hint")
    told.props('role="status"')
    with ui.element("div").classes("hw-row"):
        hold = ui.element("button").classes("hw-button sv-main sv-hold").props('type="button" data-wave')
        with hold:
            html(f"Hold to move servo {servo_id}")
    place = ui.element("div").classes("sv-wave")

    def check() -> None:
        last.set_visibility(shape.value == "sweep")
        args = {
            "servo": servo_id,
            "shape": shape.value,
            "amplitude": amplitude.value,
            "period": period.value,
            "seconds": seconds.value,
            "last_period": last.value,
        }
        try:
            _, wave = read_wave(args)
        except UsageError as error:
            told.set_content(escape(str(error)))
            hold.props("disabled")
        else:
            words = "steps, as fast as it can"
            if math.isfinite(wave.fastest):
                words = f"fastest on the way: {math.degrees(wave.fastest):.0f} deg/s"
            told.set_content(escape(words))
            hold.props(remove="disabled")
            hold.props["data-args"] = json.dumps(args)
        hold.update()

    for made in (shape, amplitude, period, last, seconds):
        made.on_value_change(check)
    check()
    mount("servos.js", place, part="wave", button=f"c{hold.id}")
