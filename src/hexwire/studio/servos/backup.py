"""Backups of stored settings: take, download, load, compare, restore.

Owns what is asked and shown; `bus.backup` owns the file and the order of a restore. An uploaded file is bounded.
"""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Any

from hexwire.bus.backup import (
    ServoBackup,
    compare,
    parse_backups,
    restore_backup,
    serialize_backups,
    take_backup,
)
from hexwire.errors import HexwireError, UsageError
from hexwire.studio.app import FAILED

from .view import View, button, download, html, question, section, table

if TYPE_CHECKING:
    from nicegui.events import UploadEventArguments

__all__ = ["build"]

_LARGEST = 1 << 20
_KEPT = 64


def build(view: View, servo_id: int) -> None:
    """Build the part."""
    from nicegui import ui

    bus = view.bus
    section(
        "Backup",
        "Stored settings of all servos here, except their ids and rates, can be compared and restored later.",
    )
    with ui.element("div").classes("hw-row"):
        button("Back up all servos", lambda: take(bus.bench.servo_ids), level="main")
        button(f"Back up servo {servo_id}", lambda: take((servo_id,)))
        upload = ui.upload(
            auto_upload=True,
            max_file_size=_LARGEST,
            on_upload=lambda event: load(event),
        )
        # Its own button cannot be named for a screen reader.
        upload.props('accept=".json,application/json"').classes("hidden")
        pick = button("Load a backup", lambda: None, offline=True)
        pick.on("click", js_handler=f"() => getElement({upload.id}).$refs.qRef.pickFiles()")
        upload.on("rejected", lambda: ui.notify("the file is larger than 1 MiB, or not JSON", type="negative"))
    place = ui.element("div")

    async def take(ids: Sequence[int]) -> None:
        made = await view.act(lambda: _take(view, ids))
        if made is not FAILED:
            keep(made)
            download("servos.json", serialize_backups(made))

    async def load(event: UploadEventArguments) -> None:
        data = await event.file.read()
        try:
            if len(data) > _LARGEST:
                raise UsageError("the file is larger than 1 MiB")
            keep(parse_backups(data, "the file"))
        except HexwireError as error:
            ui.notify(str(error), type="negative")
        upload.reset()

    def keep(rows: Sequence[ServoBackup]) -> None:
        bus.backups.extend(rows)
        del bus.backups[:-_KEPT]
        ui.notify(f"a backup of servo {', '.join(str(row.servo_id) for row in rows)}", type="positive")
        ui.timer(0, show, once=True)

    async def show() -> None:
        newest = {row.servo_id: row for row in bus.backups}
        place.clear()
        with place:
            if not newest:
                html("No backup was taken or loaded here.", "p", "sv-hint")
                return
            found = await view.read(lambda: [(row, _differences(view, row)) for row in newest.values()])
            if found is FAILED:
                return
            for row, differences in found:
                _show(view, row, differences, restored)

    async def restored() -> None:
        await show()

    ui.timer(0, show, once=True)


def _take(view: View, ids: Sequence[int]) -> list[ServoBackup]:
    if not ids:
        raise UsageError("no servo is known; search first")
    now = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
    with view.bus.bench.working("a backup"):
        return [take_backup(view.bus.bus, servo_id, taken=now) for servo_id in ids]


def _differences(view: View, row: ServoBackup) -> list[tuple[str, int | None, int | None]] | None:
    """What differs from a backup; None if the servo is not here."""
    if row.servo_id not in view.bus.bench.servo_ids:
        return None
    return compare(take_backup(view.bus.bus, row.servo_id), row)


def _show(view: View, row: ServoBackup, differences: Any, restored: Any) -> None:
    from nicegui import ui

    title = f"Servo {row.servo_id}, {row.model or row.series} {row.firmware}, {row.taken or 'no date'}"
    html(title, "h4", "sv-h4")
    if differences is None:
        html("This servo is not on the bus.", "p", "sv-hint")
        return
    if not differences:
        html("No differences.", "p", "sv-hint")
        return
    cells = [(escape(name), _cell(here), _cell(there)) for name, here, there in differences]
    ui.html(
        table(("Register", "#Servo", "#Backup"), cells, caption=f"Differences of servo {row.servo_id}"),
        sanitize=False,
    )

    async def restore() -> None:
        names = ", ".join(name for name, _, there in differences if there is not None)
        if not await question(
            f"Restore servo {row.servo_id}",
            f"These stored settings are overwritten: {names}.\nId and rate stay. Each is read back.",
            "Restore",
        ):
            return

        def call() -> list[str]:
            with view.bus.bench.working("a restore", acts=True):
                return restore_backup(view.bus.bus, row.servo_id, row)

        changed = await view.act(call)
        if changed is not FAILED:
            ui.notify(f"restored: {', '.join(changed) or 'nothing to change'}", type="positive")
            await restored()

    button(f"Restore servo {row.servo_id}", restore, level="danger")


def _cell(value: int | None) -> str:
    return "–" if value is None else str(value)
