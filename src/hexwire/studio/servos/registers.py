"""The register table of a servo: values, ranges, what differs; edits with check and undo.

Owns what a page is told of a register; `bus.registers` says what may be edited.
"""

from __future__ import annotations

from typing import Any

from hexwire.bus.registers import Edit, TableRow, in_people_unit, read_table, why_not
from hexwire.studio.calls import Arguments, Asked, OfServo, call
from hexwire.units import decimal

from .backup import newest

__all__ = ["applied", "prepared", "values"]

_KEPT = {"eeprom": "stored", "ram": "until power-off", "factory": "fixed"}


class _Edit(Arguments, frozen=True):
    servo: int
    register: str
    text: str
    raw: bool
    sure: bool = False


@call("registers.read", OfServo)
def _read(asked: Asked, args: OfServo) -> dict[str, Any]:
    """The table, and what the last edit was that can be undone."""
    asked.known(args.servo)
    saved = newest(asked, args.servo)
    rows = read_table(asked.bus.bus, args.servo, saved.registers if saved else None)
    last = asked.bus.edits.done[-1] if asked.bus.edits.done else None
    return {
        "rows": [values(row) for row in rows],
        "undo": "" if last is None else f"take back {last.for_people()}",
    }


@call("registers.edit", _Edit, control=True)
def _edit(asked: Asked, args: _Edit) -> dict[str, str]:
    """Write a value, unless there is something to be asked before: then say what."""
    asked.known(args.servo)
    edit = prepared(asked, args.servo, args.register, args.text[:40], raw=args.raw)
    if edit.before == edit.after:
        return {"told": f"{args.register} is {in_people_unit(edit.register, edit.after)} already"}
    if edit.warning and not args.sure:
        return {"question": f"{edit.for_people()}.\n{edit.warning}."}
    applied(asked, edit)
    return {"told": edit.for_people()}


@call("registers.undo", Arguments, control=True)
def _undo(asked: Asked, args: Arguments) -> str:
    with asked.bus.bench.working("an edit", acts=True):
        undone = asked.bus.edits.undo(asked.bus.bus)
    value = in_people_unit(undone.register, undone.before)
    return f"undone: {undone.register.name} of servo {undone.servo_id} is {value} again"


def prepared(asked: Asked, servo_id: int, name: str, text: str, *, raw: bool) -> Edit:
    """Check an edit; raises `StoppedError`, or `UsageError` as `RegisterEdits.prepare`."""
    asked.bus.bench.refuse_if_stopped(f"a write of {name}")
    return asked.bus.edits.prepare(asked.bus.bus, servo_id, name, text, raw=raw)


def applied(asked: Asked, edit: Edit) -> None:
    """Write an edit; raises as `RegisterEdits.apply`."""
    with asked.bus.bench.working("an edit", acts=True):
        asked.bus.edits.apply(asked.bus.bus, edit)


def values(row: TableRow) -> dict[str, Any]:
    """A row for a page: numbers as texts, empty where there is none."""
    register = row.register
    return {
        "name": register.name,
        "note": register.note,
        "words": ", ".join(row.words),
        "value": "–" if row.raw is None else decimal(row.value) if row.unit else str(row.raw),
        "exact": decimal(row.value, 6) if row.unit else str(row.raw),
        "unit": row.unit,
        "raw": "–" if row.raw is None else str(row.raw),
        "range": _range(row.low, row.high),
        "exact_range": _range(row.low, row.high, 6),
        "raw_range": _range(register.minimum, register.maximum),
        "factory": "" if register.default is None else in_people_unit(register, register.default),
        "backup": "" if row.saved is None else in_people_unit(register, row.saved),
        "kept": _KEPT.get(register.area, register.area),
        "stored": row.stored,
        "address": str(register.address),
        "why_not": why_not(register),
        "differs": [
            name
            for name, differs in (("factory", row.differs_from_factory), ("backup", row.differs_from_backup))
            if differs
        ],
    }


def _range(low: float | None, high: float | None, digits: int | None = None) -> str:
    if low is None or high is None:
        return ""
    return " … ".join(decimal(end) if digits is None else decimal(end, digits) for end in (low, high))
