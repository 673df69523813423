"""Backups of stored settings: take, keep, compare, restore.

Owns which backups there are, and what of them a page is told; `bus.backup` owns the file and the order of a
restore.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable, Sequence

from hexwire.bus.backup import (
    ServoBackup,
    compare,
    parse_backups,
    restore_backup,
    serialize_backups,
    take_backup,
)
from hexwire.errors import UsageError
from hexwire.studio.calls import Arguments, Asked, OfServo, call

__all__ = ["LARGEST", "Differences", "compared", "differences", "keep", "newest", "taken"]

LARGEST = 1 << 20
"""Bytes of a file."""
_KEPT = 64


Differences = list[tuple[str, int | None, int | None]] | None
"""Register, value here, value there; None if the servo is not here."""


class _Servos(Arguments, frozen=True):
    servos: list[int] | None = None


@call("backup.take", _Servos, control=True)
def _take(asked: Asked, args: _Servos) -> dict[str, object]:
    """Back up these servos, or all; the file for the page to save."""
    made = taken(asked, asked.bus.bench.servo_ids if args.servos is None else asked.known(*args.servos))
    keep(asked, made)
    return {"servos": [row.servo_id for row in made], "file": serialize_backups(made)}


@call("backup.differences", Arguments)
def _compared(asked: Asked, args: Arguments) -> list[dict[str, object]]:
    """The newest backup of each servo, and what differs from it now."""
    return compared(asked, lambda row: differences(asked, row))


@call("backup.restore", OfServo, control=True)
def _restore(asked: Asked, args: OfServo) -> tuple[str, ...]:
    """Write the newest backup of a servo back; the names of what has changed."""
    asked.known(args.servo)
    row = newest(asked, args.servo)
    if row is None:
        raise UsageError(f"there is no backup of servo {args.servo}")
    with asked.bus.bench.working("a restore", acts=True):
        return tuple(restore_backup(asked.bus.bus, args.servo, row))


def compared(asked: Asked, differ: Callable[[ServoBackup], Differences]) -> list[dict[str, object]]:
    """The newest backup of each servo for a page, with what differs from it now."""
    return [
        {
            "servo": row.servo_id,
            "title": f"Servo {row.servo_id}, {_kind(row)}, {row.taken or 'no date'}",
            "differences": differ(row),
        }
        for row in {row.servo_id: row for row in asked.backups}.values()
    ]


def _kind(row: ServoBackup) -> str:
    return f"{row.model or row.series} {row.firmware}".strip()


def taken(asked: Asked, ids: Sequence[int]) -> list[ServoBackup]:
    """Read the stored settings of servos.

    Raises:
        UsageError: There are none.
        HexwireError: One does not answer.
    """
    if not ids:
        raise UsageError("no servo is known; search first")
    now = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
    with asked.bus.bench.working("a backup"):
        return [take_backup(asked.bus.bus, servo_id, taken=now) for servo_id in ids]


def keep(asked: Asked, rows: Sequence[ServoBackup] | bytes) -> list[int]:
    """Keep backups, or those of a file, beside the others of what is open; the ids of their servos.

    Raises:
        ConfigError: The file is none of backups.
    """
    found = parse_backups(rows, "the file") if isinstance(rows, bytes) else rows
    backups = asked.backups
    backups.extend(found)
    del backups[:-_KEPT]
    return [row.servo_id for row in found]


def newest(asked: Asked, servo_id: int) -> ServoBackup | None:
    """The newest backup of a servo."""
    return next((row for row in reversed(asked.backups) if row.servo_id == servo_id), None)


def differences(asked: Asked, row: ServoBackup) -> Differences:
    """What differs from a backup: register, value here, value there; None if the servo is not here."""
    if row.servo_id not in asked.bus.bench.servo_ids:
        return None
    return compare(take_backup(asked.bus.bus, row.servo_id), row)
