"""Reads of neighbouring registers, of one servo or of several at once.

Owns the requests for a block where servos differ. Must not know registers by name.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from . import questions
from .values import SILENT, ServoBlock

if TYPE_CHECKING:
    from .line import BusLine
    from .plan import SyncReadPlan

__all__ = ["read_block", "sync_read_blocks"]


def read_block(line: BusLine, servo_id: int, address: int, count: int) -> ServoBlock:
    """See `ServoBus.read_block`."""
    with line.lock:
        data, error = line.run(questions.ask_registers(line.machine, servo_id, address, count))
    return ServoBlock(servo_id, address, data, error, "" if data else SILENT)


def sync_read_blocks(line: BusLine, address: int, count: int, ids: Sequence[int]) -> list[ServoBlock]:
    """See `ServoBus.sync_read_blocks`."""
    servos = line.machine.servos
    able = tuple(i for i in ids if servos.series_of(i).sync_read)
    found = _read_together(line, address, count, able) if able else {}
    for servo_id in ids:
        if servo_id not in found:
            found[servo_id] = read_block(line, servo_id, address, count)
    return [found[servo_id] for servo_id in ids]


def _read_together(line: BusLine, address: int, count: int, ids: tuple[int, ...]) -> dict[int, ServoBlock]:
    """Read one block per servo, by id. All of the servos support sync read."""
    machine = line.machine
    plan = machine.plans.block(address, count, ids)
    with line.lock:
        if machine.silent or line.doubted(ids, count):
            return _read_carefully(line, plan, None)
        try:
            data = line.transact(plan, timed=True)
            rows = plan.blocks(data)
            if rows is None:
                return _read_carefully(line, plan, data)
        except BaseException:
            line.gave_up(plan)
            raise
        machine.learn_time(plan, line.clock())
        machine.extra_answers += len(ids) - 1
        return {i: ServoBlock(i, address, row) for i, row in zip(ids, rows, strict=True)}


def _read_carefully(line: BusLine, plan: SyncReadPlan, data: bytes | None) -> dict[int, ServoBlock]:
    found = {i: ServoBlock(i, plan.address, b"", 0, SILENT) for i in plan.ids}
    for i, status in line.run(questions.ask_many(line.machine, plan, data)).items():
        found[i] = ServoBlock(i, plan.address, status.params, status.error)
    return found
