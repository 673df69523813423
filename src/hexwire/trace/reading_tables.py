"""The tables that `reading` needs, as plain values: names of modules, commands, bodies, registers.

Owns their layout; `make analyzers` also writes them for sigrok, Logic 2 and Wireshark.
"""

from __future__ import annotations

from typing import Any

from hexwire.wire import tables as t

__all__ = ["TABLES"]


_BARE = ("PING", "ACTION", "RESTORE", "REBOOT", "BACKUP", "RESET_STATE")
"""Instructions without parameters."""


def _body(body: t.Body) -> dict[str, Any]:
    return {"fields": body.fields, "rows": body.rows, "count": body.count_field}


def _registers(rows: tuple[t.RegisterRow, ...]) -> dict[int, Any]:
    """Address -> name, size, sign bit (-1: unsigned), unit (count: degrees), scale."""
    return {
        row.address: (
            row.name,
            row.size,
            -1 if row.sign_bit is None else row.sign_bit,
            row.unit or "",
            float(row.scale or 0),
        )
        for row in rows
    }


def _named(numbers: dict[str, int]) -> dict[int, str]:
    return {value: name.lower().replace("_", " ") for name, value in numbers.items()}


TABLES: dict[str, Any] = {
    "modules": {value: name for name, value in t.MODULES.items()},
    "board_module": t.MODULES["ARM_7BOT_ARDUINO_TRX"],
    "max_frame": t.MAX_NETWORK_FRAME,
    "statuses": _named(t.STATUS),
    "state_fields": t.STATE_FIELDS,
    "commands": {
        row.code: {"name": name, "request": _body(row.request), "reply": _body(row.reply)}
        for name, row in t.COMMAND_ROWS.items()
    },
    "instructions": _named(t.INSTRUCTIONS),
    "bare": dict.fromkeys((t.INSTRUCTIONS[name] for name in _BARE), 1),
    "replies": {t.INSTRUCTIONS[name]: reply for name, reply in t.INSTRUCTION_REPLY.items()},
    "status_bits": {value: name for name, value in t.STATUS_BITS.items()},
    "board_errors": _named(t.BOARD_ERRORS),
    "joints": dict(zip(t.BOARD_JOINT_IDS, t.BOARD_JOINT_SERIES, strict=True)),
    "series": {
        name: {"byte_order": row.byte_order, "registers": _registers(t.REGISTERS[name])}
        for name, row in t.SERIES.items()
    },
}
