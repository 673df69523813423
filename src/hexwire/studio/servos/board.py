"""The servos of an arm that is open: what its protocol tells of them, and the way to the bare servos.

Owns what this part shows. Registers need an adapter on the bus: a board answers for its servos.
"""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Any

from hexwire.studio.app import FAILED
from hexwire.studio.layout import mount

from .view import button, html, question, section, table

if TYPE_CHECKING:
    from hexwire.drivers.base import ProbeReport
    from hexwire.studio.app import Studio
    from hexwire.studio.source import ArmSource

__all__ = ["build"]

_HEAD = ("Joint", "#Servo", "#deg", "#deg/s", "#Load %", "#V", "#°C", "#A", "Condition")


def build(studio: Studio, arm: ArmSource) -> None:
    """Build the part."""
    from nicegui import ui

    joints = arm.settings.model.joints
    bare = arm.driver.servo_link is not None
    if bare:
        html(
            "The arm is open as a whole. Registers, ids, rates, calibration and waves need "
            "its servos one by one: this closes the arm, and joints with torque hold where they are.",
            "p",
            "sv-hint",
        )

        async def switch() -> None:
            if not await question(
                "Work at the servos",
                "The arm is closed: motions end, joints with torque keep it and hold where they are.\n"
                "STOP then reaches the servos directly.",
                "Close the arm, open its servos",
                danger=False,
            ):
                return
            tab = studio.tab()

            def call() -> None:
                # Both at once: this part of the page is gone as soon as the bus is open.
                studio.source.open_bus()
                studio.take(tab)

            await studio.run(call, control=True)

        button("Work at the servos", switch, level="main")
    else:
        html(
            "A board is between this computer and the servos, and answers for them. It tells what is below. "
            "Registers, ids and rates need an adapter on the servo bus itself.",
            "p",
            "sv-hint",
        )
    section("Now")
    rows = [
        (
            escape(joint.name),
            str(joint.servo_id),
            *(f'<span data-frame="{name}" data-joint="{i}">–</span>' for name in _FRAME),
        )
        for i, joint in enumerate(joints)
    ]
    live = ui.element("div")
    with live:
        ui.html(table(_HEAD, rows, caption="Servos of the arm"), sanitize=False)
    mount("servos.js", live, part="frames")
    section("Board" if not bare else "Line")
    with ui.element("div").classes("hw-row"):
        button("Ask again", lambda: ask())
        button("Ping every servo", lambda: ping())
    place = ui.element("div")

    async def ask() -> None:
        report: Any = await studio.run(lambda: arm.ask("probe", arm.shared.probe))
        if report is not FAILED:
            counters = await studio.run(lambda: arm.ask("counters", arm.shared.board_counters))
            place.clear()
            with place:
                _show(report, arm.driver.host_counters(), counters if isinstance(counters, dict) else {})

    async def ping() -> None:
        def call() -> list[tuple[str, str, str]]:
            rows = []
            for joint in joints:
                status = arm.shared.ping(joint.servo_id)
                words = "no answer" if status is None else "ok" if not status else f"status {status:#04x}"
                rows.append((escape(joint.name), str(joint.servo_id), words))
            return rows

        found: Any = await studio.run(lambda: arm.ask("pings", call))
        if found is not FAILED:
            place.clear()
            with place:
                ui.html(table(("Joint", "#Servo", "Answer"), found, caption="Pings"), sanitize=False)

    ui.timer(0, ask, once=True)


_FRAME = ("position", "velocity", "load", "voltage", "temperature", "current", "flags")


def _show(report: ProbeReport, host: dict[str, int], board: dict[str, int]) -> None:
    from nicegui import ui

    rows: list[tuple[str, ...]] = []
    for joint in report.joints:
        limits = "" if joint.supply is None else f"{joint.supply[0]:.1f} to {joint.supply[1]:.1f} V"
        cells = (joint.name, str(joint.servo_id), joint.series, "yes" if joint.present else "no answer", limits)
        rows.append((*map(escape, cells), escape(joint.remarks)))
    head = ("Joint", "#Servo", "Series", "Present", "Supply limits", "Remarks")
    ui.html(table(head, rows, caption="What each servo is"), sanitize=False)
    counters: dict[str, Any] = {
        **{f"host: {name}": n for name, n in host.items()},
        **{f"board: {name}": n for name, n in board.items()},
    }
    counted = [(escape(name.replace("_", " ")), str(count)) for name, count in counters.items() if count]
    if report.firmware:
        html(f"Firmware {report.firmware}, dialect {report.dialect}.", "p", "sv-hint")
    ui.html(table(("Counter", "#Count"), counted, caption="Counters that are not 0"), sanitize=False)
