"""The middle of a servo, and the calibration of an arm by hand with live minimum, position and maximum.

Owns what is asked and shown; `bus.setup` sets a middle, `control.calibrating` calibrates and stores.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hexwire.bus import setup as servo_setup
from hexwire.studio.app import FAILED
from hexwire.studio.layout import mount

from .calibration_run import ARMS, CalibrationRun
from .view import View, button, download, html, question, section

if TYPE_CHECKING:
    from hexwire.model.calibration import Calibration

__all__ = ["build"]


def build(view: View, servo_id: int) -> None:
    """Build the part."""
    from nicegui import ui

    bus = view.bus
    section(
        "Middle",
        "The present position of the servo becomes the middle of its turn. Nothing moves; its torque must be off.",
    )

    async def middle() -> None:
        now = bus.live.get(servo_id)
        here = f" It reports {now.counts} counts now." if now is not None and now.counts is not None else ""
        text = f"All positions of servo {servo_id} are counted anew from here; this is stored.{here}"
        if not await question("Set the middle", text, "This is the middle"):
            return

        def call() -> int:
            with bus.bench.working(f"the middle of servo {servo_id}", acts=True):
                return servo_setup.center(bus.bus, servo_id)

        counts = await view.act(call)
        if counts is not FAILED:
            ui.notify(f"servo {servo_id} reports {counts} here now", type="positive")

    button(f"Set the middle of servo {servo_id} here", middle)
    section(
        "Calibration by hand",
        "Without torque, move every joint to both of its ends; the table says what is missing. Offsets and limits "
        "can then be stored in the servos, and the calibration saved to a file.",
    )
    _calibration(view)


def _calibration(view: View) -> None:
    from nicegui import ui

    bus = view.bus
    run: list[CalibrationRun] = []
    with ui.element("div").classes("sv-form"):
        arm = ui.select(ARMS, value=_likely(view), label="Arm").props("dense outlined options-dense")
        begin = button("Begin: torque off", lambda: start(), level="main")
        mark = button("Joints without stops are in their middle", lambda: mark_middle())
        finish = button("Finish", lambda: end(), level="main")
        cancel = button("Cancel", lambda: bus.bench.cancel())
    place = ui.element("div")
    result = ui.element("div")
    mount("servos.js", place, part="range")

    def buttons(running: bool, needs_middle: bool = False) -> None:
        for made, shown in (
            (begin, not running),
            (mark, running and needs_middle),
            (finish, running),
            (cancel, running),
        ):
            made.set_visibility(shown)

    buttons(False)

    async def start() -> None:
        if not await question(
            "Torque off", "All joints lose their torque, and the arm sinks. Hold it.", "I hold it: torque off"
        ):
            return
        result.clear()
        made = await view.act(lambda: CalibrationRun(view.studio, bus, view.tab, str(arm.value)))
        if made is FAILED:
            return
        run[:] = [made]
        buttons(True, made.hand.needs_middle)
        await view.act(made.work)
        buttons(False)
        if made.found is not None:
            show(made, made.found)

    def mark_middle() -> None:
        if run and run[0].mark_middle():
            buttons(True)

    def end() -> None:
        if run:
            run[0].finish()

    def show(made: CalibrationRun, found: Calibration) -> None:
        with result:
            names = ", ".join(joint.name for joint in found.joints)
            html(f"Calibrated: {names}.", "p")

            async def store() -> None:
                text = (
                    "Offset and limits of every servo are overwritten, and read back.\n"
                    "If one fails, all get their old values."
                )
                if await question("Store in the servos", text, "Store them"):
                    changed = await view.act(lambda: made.store(found))
                    if changed is not FAILED:
                        ui.notify(f"stored: {', '.join(changed) or 'nothing to change'}", type="positive")

            with ui.element("div").classes("hw-row"):
                button("Store in the servos", store, level="danger")
                button("Save as file", lambda: download("calibration.toml", found.serialize()))


def _likely(view: View) -> str:
    return "so101" if view.bus.bench.servo_ids == (1, 2, 3, 4, 5, 6) else "servos"
