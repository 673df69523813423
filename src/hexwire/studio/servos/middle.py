"""The middle of a servo, and the calibration of an arm by hand with live minimum, position and maximum.

Owns what is asked and shown; `bus.setup` sets a middle, `control.calibrating` calibrates and stores.
"""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from hexwire.bus import setup as servo_setup
from hexwire.errors import HexwireError, UsageError
from hexwire.studio.app import FAILED
from hexwire.studio.layout import mount

from .calibration_run import ARMS, CalibrationRun, parse_file, store_in
from .view import View, button, download, html, question, section, table

if TYPE_CHECKING:
    from nicegui.events import UploadEventArguments

    from hexwire.model.calibration import Calibration

__all__ = ["build"]

_LARGEST = 1 << 18


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
        "can then be stored in the servos, and the calibration saved to a file, also for LeRobot. In place of "
        "measuring, a file of either kind can be loaded.",
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
        cancel = button("Cancel", lambda: bus.bench.cancel(), late=True)
        upload = ui.upload(auto_upload=True, max_file_size=_LARGEST, on_upload=lambda event: load(event))
        # Its own button cannot be named for a screen reader.
        upload.props('accept=".toml,.json"').classes("hidden")
        pick = button("Load a calibration", lambda: None, offline=True)
        pick.on("click", js_handler=f"() => getElement({upload.id}).$refs.qRef.pickFiles()")
        upload.on(
            "rejected",
            lambda: ui.notify("the file is larger than 256 KiB, or neither .toml nor .json", type="negative"),
        )
    place = ui.element("div")
    result = ui.element("div")
    mount("servos.js", place, part="range")

    def buttons(running: bool, needs_middle: bool = False) -> None:
        for made, shown in (
            (begin, not running),
            (pick, not running),
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
            show(made.found, "Calibrated")

    async def load(event: UploadEventArguments) -> None:
        data = await event.file.read()
        upload.reset()
        try:
            if len(data) > _LARGEST:
                raise UsageError("the file is larger than 256 KiB")
            found = parse_file(bus, event.file.name, data, str(arm.value))
        except HexwireError as error:
            ui.notify(str(error), type="negative")
            return
        result.clear()
        show(found, f"Loaded from {event.file.name}")

    def mark_middle() -> None:
        if run and run[0].mark_middle():
            buttons(True)

    def end() -> None:
        if run:
            run[0].finish()

    def show(found: Calibration, how: str) -> None:
        with result:
            html(f"{how}.", "p").props('role="status"')
            rows = [
                (escape(row.name), str(row.servo_id), _offset(row.servo_offset), str(row.low), str(row.high))
                for row in found.joints
            ]
            head = ("Joint", "#Servo", "#Offset", "#Lowest count", "#Highest count")
            ui.html(table(head, rows, caption="Calibration"), sanitize=False)

            async def store() -> None:
                text = (
                    "Offset and limits of every servo are overwritten, and read back.\n"
                    "If one fails, all get their old values."
                )
                if await question("Store in the servos", text, "Store them"):
                    changed = await view.act(lambda: store_in(bus, found))
                    if changed is not FAILED:
                        ui.notify(f"stored: {', '.join(changed) or 'nothing to change'}", type="positive")

            with ui.element("div").classes("hw-row"):
                button("Store in the servos", store, level="danger")
                button("Save as file", lambda: download("calibration.toml", found.serialize()), offline=True)
                button("Save for LeRobot", lambda: save_lerobot(found), offline=True)

    def save_lerobot(found: Calibration) -> None:
        try:
            download("calibration.json", found.to_lerobot())
        except UsageError as error:
            ui.notify(str(error), type="negative")


def _offset(value: int | None) -> str:
    return "–" if value is None else str(value)


def _likely(view: View) -> str:
    return "so101" if view.bus.bench.servo_ids == (1, 2, 3, 4, 5, 6) else "servos"
