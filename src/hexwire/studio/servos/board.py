"""The servos of an arm that is open, as its protocol tells of them, and their registers behind a board.

Owns what a page is told of them, and how an edit is made by the board's own requests: reads always, writes in
maintenance, which the board refuses while a joint has torque. A table takes the line for as long as several states,
so who only watches does not read them. `bus.registers` says what may be edited.
"""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from hexwire.bus.backup import ServoBackup, compare, restorable, serialize_backups
from hexwire.bus.registers import Edit, in_people_unit, make_table, prepare_edit
from hexwire.drivers.abilities import BareServos, Counters
from hexwire.errors import HexwireError, ServoError, UsageError
from hexwire.studio.access import Right
from hexwire.studio.calls import Arguments, Asked, OfServo, call
from hexwire.wire.registers import Register, Series

from .backup import Differences, compared, keep, newest
from .registers import values

if TYPE_CHECKING:
    from hexwire.model.arm import JointModel
    from hexwire.studio.source import ArmSource

__all__ = ["raw_registers"]

_SERIES = {"seven_bot": "7Bot", "scs": "SCS", "sts_sms": "STS", "hls": "HLS"}
"""Series of servos as their makers write them."""
_UNDONE = 100
"""Edits that can be undone."""


class _Joint(Arguments, frozen=True):
    joint: str


class _Edit(Arguments, frozen=True):
    joint: str
    register: str
    text: str
    raw: bool
    sure: bool = False


@call("board.registers", _Joint, right=Right.OPERATE)
def _registers(asked: Asked, args: _Joint) -> dict[str, Any]:
    """The registers of a joint's servo, and what the last edit was that can be undone."""
    arm = asked.arm
    joint = arm.settings.model.joint(args.joint)
    saved = newest(asked, joint.servo_id)
    rows = make_table(Series(joint.series), raw_registers(arm, joint), saved.registers if saved else None)
    last = arm.edits[-1] if arm.edits else None
    return {
        "rows": [values(row) for row in rows],
        "undo": "" if last is None else f"take back {_words(last[1])}",
    }


@call("board.edit", _Edit, control=True)
def _edit(asked: Asked, args: _Edit) -> dict[str, str]:
    """Write a value, unless there is something to be asked before: then say what."""
    arm = asked.arm
    joint = arm.settings.model.joint(args.joint)
    series, raws = Series(joint.series), raw_registers(arm, joint)

    def read(name: str) -> int:
        if name not in raws:
            raise ServoError(f"servo {joint.servo_id} did not tell {name}", servo_id=joint.servo_id)
        return raws[name]

    edit = prepare_edit(series, joint.servo_id, args.register, args.text[:40], raw=args.raw, read=read)
    if edit.before == edit.after:
        return {"told": f"{args.register} is {in_people_unit(edit.register, edit.after)} already"}
    if edit.warning and not args.sure:
        return {"question": f"{edit.for_people()}.\n{edit.warning}."}
    _write(asked, joint, [(edit.register, edit.after)])
    _note(arm, joint, (edit,))
    return {"told": edit.for_people()}


@call("board.undo", Arguments, control=True)
def _undo(asked: Asked, args: Arguments) -> str:
    arm = asked.arm
    if not arm.edits:
        raise UsageError("there is nothing to undo")
    name, edits = arm.edits[-1]
    joint = arm.settings.model.joint(name)
    raws = raw_registers(arm, joint)
    if changed := [edit.register.name for edit in edits if raws.get(edit.register.name) != edit.after]:
        raise ServoError(
            f"{', '.join(changed)} was changed by something else since that edit", servo_id=joint.servo_id
        )
    _write(asked, joint, [(edit.register, edit.before) for edit in edits])
    arm.edits.pop()
    if len(edits) > 1:
        return f"undone: {_words(edits)}"
    value = in_people_unit(edits[0].register, edits[0].before)
    return f"undone: {edits[0].register.name} of servo {joint.servo_id} is {value} again"


def _words(edits: Sequence[Edit]) -> str:
    if len(edits) == 1:
        return edits[0].for_people()
    return f"the restore of {len(edits)} settings of servo {edits[0].servo_id}"


def _note(arm: ArmSource, joint: JointModel, edits: tuple[Edit, ...]) -> None:
    """Keep what was written together, so that it can be taken back together."""
    arm.edits.append((joint.name, edits))
    del arm.edits[:-_UNDONE]


@call("board.backup", Arguments, right=Right.OPERATE)
def _backup(asked: Asked, args: Arguments) -> dict[str, object]:
    """The stored settings of all servos, kept for comparison; the file for the page to save."""
    arm = asked.arm
    made = [_taken(arm, joint) for joint in arm.settings.model.joints]
    keep(asked, made)
    return {"servos": [row.servo_id for row in made], "file": serialize_backups(made)}


@call("board.differences", Arguments, right=Right.OPERATE)
def _differences(asked: Asked, args: Arguments) -> list[dict[str, object]]:
    """The newest backup of each servo, and what differs from it now."""

    def differ(row: ServoBackup) -> Differences:
        joint = _joint_of(asked.arm, row.servo_id)
        return None if joint is None else compare(_taken(asked.arm, joint), row)

    return compared(asked, differ)


@call("board.restore", OfServo, control=True)
def _restore(asked: Asked, args: OfServo) -> list[str]:
    """Write the newest backup of a servo back; the names of what has changed."""
    arm, joint, row = asked.arm, _joint_of(asked.arm, args.servo), newest(asked, args.servo)
    if joint is None or row is None:
        raise UsageError(f"there is no backup of servo {args.servo}")
    todo, series = restorable(_taken(arm, joint), row), Series(joint.series)
    raws = raw_registers(arm, joint)
    edits = [Edit(joint.servo_id, series.register(name), raws[name], value) for name, value in todo]
    if not edits:
        return []
    done: tuple[Edit, ...] = ()
    try:
        _write(asked, joint, [(edit.register, edit.after) for edit in edits])
    finally:
        # What has been written can be taken back, also if the rest was refused.
        with suppress(HexwireError):
            now = raw_registers(arm, joint)
            if done := tuple(edit for edit in edits if now.get(edit.register.name) == edit.after):
                _note(arm, joint, done)
    if failed := [edit.register.name for edit in edits if edit not in done]:
        raise ServoError(f"servo {joint.servo_id} did not take {', '.join(failed)}", servo_id=joint.servo_id)
    return [edit.register.name for edit in edits]


def _joint_of(arm: ArmSource, servo_id: int) -> JointModel | None:
    return next((joint for joint in arm.settings.model.joints if joint.servo_id == servo_id), None)


def _taken(arm: ArmSource, joint: JointModel) -> ServoBackup:
    """The stored settings of a joint's servo now."""
    series, raws = Series(joint.series), raw_registers(arm, joint)
    now = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
    stored = {
        row.name: raws[row.name] for row in series.registers.values() if row.area == "eeprom" and row.name in raws
    }
    return ServoBackup(joint.servo_id, series.value, "", "", now, stored)


def raw_registers(arm: ArmSource, joint: JointModel) -> dict[str, int]:
    """Raw values of a servo's registers by name, read by one request of the board."""
    # What was written is no answer of before.
    table = arm.ask(f"registers of {joint.name} after {arm.written}", lambda: arm.shared.read_registers(joint.name))
    rows = Series(joint.series).registers.values()
    return {
        row.name: row.decode(table[row.address : row.address + row.size])
        for row in rows
        if row.address + row.size <= len(table)
    }


def _write(asked: Asked, joint: JointModel, values: Sequence[tuple[Register, int]]) -> None:
    """Write registers in maintenance; stored ones are kept through power-off. The board reads each of them back."""
    arm = asked.arm
    parts = [(register.address, register.encode(value)) for register, value in values]
    lock = Series(joint.series).registers.get("lock")
    if lock is not None and any(register.area == "eeprom" for register, _ in values):
        parts = [(lock.address, lock.encode(0)), *parts, (lock.address, lock.encode(1))]
    try:
        arm.shared.write_registers(arm.order(asked.tab, asked.arrived), joint.name, parts)
    finally:
        arm.written += 1


@call("board.servos", Arguments)
def _servos(asked: Asked, args: Arguments) -> dict[str, Any]:
    """The joints with their servos, and whether these can be reached without the arm."""
    joints = asked.arm.settings.model.joints
    return {
        "bare": asked.arm.driver.can(BareServos),
        "joints": [{"name": joint.name, "servo": joint.servo_id} for joint in joints],
    }


@call("board.ask", Arguments)
def _ask(asked: Asked, args: Arguments) -> dict[str, Any]:
    """What each servo is, and the counters that are not 0."""
    arm = asked.arm
    report = arm.ask("probe", arm.shared.probe)
    host = Counters.find(arm.driver)
    counters = {f"this computer: {name}": n for name, n in ({} if host is None else host.host_counters()).items()}
    counters |= {f"board: {name}": n for name, n in (arm.ask("counters", arm.shared.board_counters) or {}).items()}
    rows = [
        (
            joint.name,
            str(joint.servo_id),
            _SERIES.get(joint.series, joint.series),
            "yes" if joint.present else "no answer",
            "" if joint.supply is None else f"{joint.supply[0]:.1f} to {joint.supply[1]:.1f} V",
            joint.remarks,
        )
        for joint in report.joints
    ]
    return {
        "servos": rows,
        "firmware": f"Firmware {report.firmware}, dialect {report.dialect}." if report.firmware else "",
        "counters": [(name.replace("_", " "), str(count)) for name, count in counters.items() if count],
    }


@call("board.ping", Arguments)
def _ping(asked: Asked, args: Arguments) -> list[tuple[str, str, str]]:
    arm = asked.arm

    def ping() -> list[tuple[str, str, str]]:
        rows = []
        for joint in arm.settings.model.joints:
            status = arm.shared.ping(joint.servo_id)
            words = "no answer" if status is None else "ok" if not status else f"status {status:#04x}"
            rows.append((joint.name, str(joint.servo_id), words))
        return rows

    return arm.ask("pings", ping)
