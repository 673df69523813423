"""The register table of a servo: values, ranges, what differs; edit with check and undo.

Owns the table's columns and filter, and the questions before an edit; `bus.registers` says what may be edited.
"""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Any

from hexwire.bus.registers import Edit, TableRow, read_table, why_not
from hexwire.studio.layout import mount
from hexwire.units import decimal

from .view import View, button, html, question, table

if TYPE_CHECKING:
    from hexwire.bus.backup import ServoBackup

__all__ = ["build"]

_FILTERS = {
    "all": "all registers",
    "stored": "stored settings",
    "factory": "different from the factory",
    "backup": "different from the backup",
    "live": "live values",
}
_HEAD = ("Register", "#Value", "Unit", "Change", "#Raw", "Range", "#Factory", "#Backup", "Kept", "#At")


def build(view: View, servo_id: int) -> None:
    """Build the part."""
    from nicegui import ui

    rows: list[TableRow] = []
    with ui.element("div").classes("sv-form"):
        shown = ui.select(_FILTERS, value="all", label="Show").props("dense outlined options-dense")
        find = ui.input("Find a register").props("dense outlined clearable maxlength=40")
        button("Read again", lambda: read())
        undo = button("Undo", lambda: take_back())
    place = ui.element("div")
    with place:
        body = ui.html("", sanitize=False)
    mount("servos.js", place, part="table")

    def draw() -> None:
        wanted = str(find.value or "").strip().lower()
        kept = [row for row in rows if _fits(row, str(shown.value)) and wanted in row.register.name]
        body.set_content(
            table(_HEAD, [_cells(row) for row in kept], caption=f"Registers of servo {servo_id}")
            if kept
            else '<p class="sv-hint">No such register.</p>'
        )
        last = view.bus.edits.done[-1] if view.bus.edits.done else None
        undo.set_visibility(last is not None)
        if last is not None:
            undo.props["title"] = f"back to {last.before}: {last}"
            undo.update()

    async def read() -> None:
        saved = _saved(view, servo_id)
        found = await view.read(lambda: read_table(view.bus.bus, servo_id, saved.registers if saved else None))
        if isinstance(found, list):
            rows[:] = found
            draw()

    async def edit(event: Any) -> None:
        data = event.args.get("detail") or {}
        row = next((one for one in rows if one.register.name == data.get("value")), None)
        if row is None or data.get("do") != "edit":
            return
        typed = await _ask(row)
        if typed is None:
            return
        text, raw = typed
        name = row.register.name
        made = await view.act(lambda: _prepared(view, servo_id, name, text, raw))
        if not isinstance(made, Edit):
            return
        if made.before == made.after:
            ui.notify(f"{name} is {made.after} already")
            return
        if made.warning and not await question(f"Write {name}", f"{made}.\n{made.warning}.", "Write it"):
            return
        if await view.act(lambda: _apply(view, made)) is None:
            ui.notify(str(made), type="positive")
            await read()

    async def take_back() -> None:
        def call() -> Edit:
            with view.bus.bench.working("an edit", acts=True):
                return view.bus.edits.undo(view.bus.bus)

        undone = await view.act(call)
        if isinstance(undone, Edit):
            ui.notify(f"undone: {undone.register.name} of servo {undone.servo_id} is {undone.before} again")
            await read()

    shown.on_value_change(draw)
    find.on_value_change(draw)
    place.on("act", edit, args=["detail"])
    ui.timer(0, read, once=True)


def _saved(view: View, servo_id: int) -> ServoBackup | None:
    """The newest backup of a servo."""
    return next((row for row in reversed(view.bus.backups) if row.servo_id == servo_id), None)


def _prepared(view: View, servo_id: int, name: str, text: str, raw: bool) -> Edit:
    view.bus.bench.refuse_if_stopped(f"a write of {name}")
    return view.bus.edits.prepare(view.bus.bus, servo_id, name, text, raw=raw)


def _apply(view: View, edit: Edit) -> None:
    with view.bus.bench.working("an edit", acts=True):
        view.bus.edits.apply(view.bus.bus, edit)


def _fits(row: TableRow, shown: str) -> bool:
    return {
        "stored": row.stored,
        "factory": row.differs_from_factory,
        "backup": row.differs_from_backup,
        "live": row.register.area == "ram",
    }.get(shown, True)


def _cells(row: TableRow) -> tuple[str, ...]:
    register = row.register
    value = "–" if row.raw is None else decimal(row.value) if row.unit else str(row.raw)
    low, high = row.low, row.high
    limits = "" if low is None or high is None else f"{decimal(low)} … {decimal(high)}"
    factory = "" if register.default is None else str(register.default)
    saved = "" if row.saved is None else str(row.saved)
    reason = why_not(register)
    words = escape("; ".join(part for part in (register.note, ", ".join(row.words)) if part))
    name = escape(register.name)
    told = escape(reason)
    change = (
        f'<button type="button" class="hw-button sv-small" data-do="edit" data-value="{name}" '
        f'aria-label="Edit {name}">Edit</button>'
        if not reason
        else f'<span class="sv-why" title="{told}" tabindex="0" role="note" aria-label="{told}">–</span>'
    )
    return (
        f'<span title="{words}">{name}</span>' + (f'<span class="sv-note">{words}</span>' if row.words else ""),
        value,
        escape(row.unit),
        change,
        "–" if row.raw is None else str(row.raw),
        limits,
        _marked(factory, row.differs_from_factory),
        _marked(saved, row.differs_from_backup),
        {"eeprom": "stored", "ram": "until power-off", "factory": "fixed"}.get(register.area, register.area),
        str(register.address),
    )


def _marked(text: str, differs: bool) -> str:
    return f'<mark title="different">{text} ≠</mark>' if differs else text


async def _ask(row: TableRow) -> tuple[str, bool] | None:
    """Ask for a value: what was typed, and whether it is raw; None if it was cancelled."""
    from nicegui import ui

    register = row.register
    with ui.dialog() as dialog, ui.element("div").classes("sv-dialog"):
        dialog.props(f'aria-label="Edit {escape(register.name)}"')
        html(f"Edit {register.name}", "h2", "sv-h2")
        if register.note:
            html(register.note, "p", "sv-hint")
        units = {"raw": "raw count"} if not row.unit else {"unit": row.unit, "raw": "raw count"}
        unit = ui.select(units, value=next(iter(units)), label="Unit").props("dense outlined options-dense")
        text = ui.input(f"New value of {register.name}").props("dense outlined autofocus maxlength=40")
        text.value = decimal(row.value, 6) if row.unit else str(row.raw)
        hint = html("", "p", "sv-hint")

        def told() -> None:
            raw = unit.value == "raw"
            low, high = (register.minimum, register.maximum) if raw else (row.low, row.high)
            now = row.raw if raw else decimal(row.value, 6)
            limits = "" if low is None or high is None else f"; {decimal(low, 6)} to {decimal(high, 6)}"
            kept = "stored in the servo" if row.stored else "forgotten at power-off"
            hint.set_content(escape(f"now {now}{limits}; {kept}"))
            text.value = str(now)

        unit.on_value_change(told)
        told()
        text.on("keydown.enter", lambda: dialog.submit((str(text.value or ""), unit.value == "raw")))
        with ui.element("div").classes("hw-row"):
            button(
                "Check and write", lambda: dialog.submit((str(text.value or ""), unit.value == "raw")), level="main"
            )
            button("Cancel", lambda: dialog.submit(None), offline=True)
    try:
        answer = await dialog
    finally:
        dialog.delete()
    return answer if isinstance(answer, tuple) else None
