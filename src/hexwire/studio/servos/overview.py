"""What a servo is, what is known against it, what it measures, its torque, and the way out of an overload.

Owns what this part shows. Must not know the other parts.
"""

from __future__ import annotations

from html import escape

from hexwire.bus import setup as servo_setup
from hexwire.errors import ServoError
from hexwire.studio.layout import mount

from .view import View, button, facts, html, question, section

__all__ = ["build"]

_LIVE = (
    ("deg", "Position", "deg"),
    ("counts", "Counts", ""),
    ("speed", "Speed", "deg/s"),
    ("load", "Load", "%"),
    ("volts", "Supply", "V"),
    ("celsius", "Temperature", "°C"),
    ("amps", "Current", "A"),
    ("state", "Faults", ""),
)


def build(view: View, servo_id: int) -> None:
    """Build the part."""
    from nicegui import ui

    row = view.bus.find(servo_id)
    if row is None or row.found.info is None:
        html("This servo is not known any more; search again.", "p", "sv-hint")
        return
    info = row.found.info
    limits = ""
    if "max_voltage" in row.settings:
        low, high = row.settings.get("min_voltage", 0.0), row.settings["max_voltage"]
        limits = f"{row.kind or 'unknown'} (its limits: {low:.1f} to {high:.1f} V)"
    facts(
        [
            ("Model", info.model_name or "not reported"),
            ("Series", info.series.title if info.series else "unknown"),
            ("Firmware", info.firmware or "not reported"),
            ("Voltage class", limits or "not reported"),
            ("Rate", f"{row.found.baud} baud"),
            ("Answers writes", "yes" if info.acknowledges else "no"),
        ]
    )
    with ui.element("ul").classes("sv-remarks"):
        for remark in row.remarks:
            level = "error" if remark.bad else "warn"
            ui.html(escape(remark.text), sanitize=False, tag="li").props(f'data-level="{level}"')
        if not row.remarks:
            ui.html("Nothing is known against this servo.", sanitize=False, tag="li").props('data-level="ok"')
    section("Now")
    cells = "".join(
        f'<div><dt>{name}</dt><dd><span data-live="{key}" data-id="{servo_id}">–</span> {unit}</dd></div>'
        for key, name, unit in _LIVE
    )
    mount("servos.js", ui.html(cells, sanitize=False, tag="dl").classes("sv-facts"), part="live")

    async def torque(on: bool) -> None:
        if await view.act(lambda: view.bus.switch_torque(on, (servo_id,))) is None:
            ui.notify(f"servo {servo_id} {'holds where it is' if on else 'has no torque'}")

    async def torque_off() -> None:
        if await question(
            "Torque off", f"Servo {servo_id} lets go: what it carries falls. Hold it.", "Switch torque off"
        ):
            await torque(False)

    async def recover() -> None:
        if not await question(
            "End the overload protection",
            f"Servo {servo_id} has no torque until its fault is gone. What it carries falls: hold it.",
            "Switch torque off and wait",
        ):
            return

        def call() -> tuple[str, ...]:
            with view.bus.bench.working(f"the recovery of servo {servo_id}"):
                left = servo_setup.recover(view.bus.bus, servo_id)
            if left:
                raise ServoError(f"servo {servo_id} still reports {', '.join(left)}: remove the cause, try again")
            return left

        if await view.act(call) == ():
            ui.notify(f"servo {servo_id} has no fault, and no torque", type="positive")

    section("Torque", "Switched on, a servo holds where it is; it never drives to an old goal.")
    with ui.element("div").classes("hw-row"):
        button("Torque on", lambda: torque(True), label=f"Torque of servo {servo_id} on")
        button("Torque off", torque_off, label=f"Torque of servo {servo_id} off", offline=True)
        button("Recover from overload", recover)
