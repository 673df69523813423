"""Backup of a servo's stored settings: read, compare and restore them.

Owns the format of the file (JSON, with series, model, firmware and date) and the order of a restore. Works on a
`ServoBus`; moves nothing.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from hexwire.errors import ConfigError, ServoError, UsageError
from hexwire.inputs import LARGEST_DATA, Item, parse_json, read_bytes
from hexwire.wire.registers import Series

from .servo_bus import ServoBus
from .setup import identify, unlocked

__all__ = [
    "ServoBackup",
    "compare",
    "load_backup",
    "parse_backups",
    "restorable",
    "restore_backup",
    "serialize_backups",
    "take_backup",
]

_FORMAT = "hexwire servo settings 1"
# Restoring these would lose the servo: it would answer to another id, or at another rate.
_NEVER_RESTORED = ("id", "baud_code")
_EEPROM_TIME = 0.02
_MOST_SERVOS = 253
_KEYS = ("id", "series", "firmware", "model", "taken", "registers")


@dataclass(frozen=True)
class ServoBackup:
    """Stored settings of one servo.

    Attributes:
        servo_id: Its id at the backup.
        series: Its series.
        firmware: As in ``3.10``.
        model: As in ``sts3215``.
        taken: Time of the backup, ISO 8601; empty if not given.
        registers: Raw values by register name.
    """

    servo_id: int
    series: str
    firmware: str
    model: str
    taken: str
    registers: Mapping[str, int] = field(default_factory=dict)


def take_backup(bus: ServoBus, servo_id: int, *, taken: str = "") -> ServoBackup:
    """Read all stored settings of a servo.

    Raises:
        ServoError: The servo does not answer.
    """
    info = identify(bus, servo_id)
    if info is None or info.series is None:
        raise ServoError(f"servo {servo_id} cannot be identified: check cable, power and id", servo_id=servo_id)
    rows = [row for row in info.series.registers.values() if row.area == "eeprom"]
    values: dict[str, int] = {}
    if info.series is Series.SEVEN_BOT:
        for row in rows:
            values[row.name] = _value(bus.read(servo_id, row.name).raw, servo_id, row.name)
    else:
        first, end = rows[0].address, max(row.address + row.size for row in rows)
        block = bus.read_block(servo_id, first, end - first)
        for row in rows:
            values[row.name] = _value(block.raw(row), servo_id, row.name)
    return ServoBackup(servo_id, info.series.value, info.firmware, info.model_name, taken, values)


def _value(raw: int | None, servo_id: int, name: str) -> int:
    if raw is None:
        raise ServoError(f"servo {servo_id} fell silent at {name}: nothing was changed", servo_id=servo_id)
    return raw


def compare(one: ServoBackup, other: ServoBackup) -> list[tuple[str, int | None, int | None]]:
    """Return the registers in which two backups differ: name, value in each."""
    names = list(dict.fromkeys([*one.registers, *other.registers]))
    rows = ((name, one.registers.get(name), other.registers.get(name)) for name in names)
    return [row for row in rows if row[1] != row[2]]


def restorable(now: ServoBackup, backup: ServoBackup) -> list[tuple[str, int]]:
    """What a restore writes: names and raw values of the settings that differ and can be written, but id and rate.

    Args:
        now: What is in the servo.
        backup: What is to be there.

    Raises:
        UsageError: The backup is of another series, or has a value out of range.
    """
    if now.series != backup.series:
        raise UsageError(f"this backup is of a {backup.series} servo, and servo {now.servo_id} is {now.series}")
    series, todo = Series(now.series), []
    for name, here, there in compare(now, backup):
        if there is None or here is None or name in _NEVER_RESTORED or series.register(name).access != "rw":
            continue
        register = series.register(name)
        low, high = register.minimum, register.maximum
        if (low is not None and there < low) or (high is not None and there > high):
            raise UsageError(f"this backup has {name} = {there}, which is out of range; nothing was changed")
        todo.append((name, there))
    return todo


def restore_backup(bus: ServoBus, servo_id: int, backup: ServoBackup) -> list[str]:
    """Restore settings except id and rate, and verify them.

    Returns:
        Names of the registers that were changed.

    Raises:
        UsageError: The backup is of another series; nothing was changed.
        ServoError: A register has another value afterwards; the text names it.
    """
    todo = restorable(take_backup(bus, servo_id), backup)
    if todo:
        with unlocked(bus, servo_id):
            for name, value in todo:
                answer = bus.write_raw(servo_id, name, value)
                if answer.error:
                    answer.check()
                bus.pause(_EEPROM_TIME)
    left = {name for name, here, there in compare(take_backup(bus, servo_id), backup)}
    failed = [name for name, _ in todo if name in left]
    if failed:
        raise ServoError(f"servo {servo_id} did not take {', '.join(failed)}", servo_id=servo_id)
    return [name for name, _ in todo]


def serialize_backups(backups: list[ServoBackup]) -> str:
    """Make the text of a file of backups."""
    rows = [
        {
            "id": backup.servo_id,
            "series": backup.series,
            "firmware": backup.firmware,
            "model": backup.model,
            "taken": backup.taken,
            "registers": dict(backup.registers),
        }
        for backup in backups
    ]
    return json.dumps({"format": _FORMAT, "servos": rows}, indent=2) + "\n"


def load_backup(path: str | Path) -> list[ServoBackup]:
    """Read a file of backups.

    Raises:
        ConfigError: The file is invalid; the text says where.
    """
    return parse_backups(read_bytes(path, largest=LARGEST_DATA), str(path))


def parse_backups(data: bytes, name: str) -> list[ServoBackup]:
    """Parse the contents of a file of backups.

    Args:
        data: The contents.
        name: What to call the file in an error.

    Raises:
        ConfigError: They are invalid; the text says where.
    """
    root = parse_json(data, name)
    if not isinstance(root.value, dict) or root.value.get("format") != _FORMAT:
        raise ConfigError(f"not a file of servo settings (its format is not {_FORMAT!r})", file=name)
    return root.table(("servos",))["servos"].each(_parse, _MOST_SERVOS)


def _parse(item: Item) -> ServoBackup:
    row = item.table(_KEYS, ())
    series = Series(row["series"].choice([known.value for known in Series]))
    registers = {}
    for key, value in row["registers"].table((), series.registers).items():
        # Refuse it here, before a restore writes the settings ahead of it.
        fits = series.register(key).fits
        registers[key] = value.integer(fits[0], fits[-1])
    texts = {key: row[key].text(100) for key in ("firmware", "model", "taken")}
    return ServoBackup(row["id"].integer(0, _MOST_SERVOS), series.value, registers=registers, **texts)
