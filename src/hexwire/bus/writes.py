"""Writes to registers, and the reliability of their acknowledgements.

Owns when an acknowledgement may belong to an earlier write, when the register is read back instead, and whether a
servo acknowledges at all. Must not know the meaning of registers, except for the one that selects acknowledgements.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hexwire.errors import UsageError
from hexwire.wire.servo_packet import BROADCAST_ID, make_sync_write

from . import questions
from .plan import WritePlan, writable
from .values import SILENT, Answer, why

if TYPE_CHECKING:
    from collections.abc import Mapping

    from hexwire.wire.registers import Register
    from hexwire.wire.servo_packet import StatusPacket

    from .line import BusLine
    from .machine import BusMachine, Conversation

__all__ = ["acknowledged", "in_range", "order", "sync_write_each", "write_register"]

_LEVEL = "status_return_level"
_new = tuple.__new__


def order(line: BusLine, servo_id: int, request: bytes, what: str, *, repeat: bool = True) -> Answer:
    """Send a packet that one servo acknowledges like a write; see `acknowledged`."""
    plan = WritePlan(servo_id, line.machine.servos.series_of(servo_id), 0, b"", request)
    return acknowledged(line, plan, what, repeat=repeat)


def acknowledged(line: BusLine, plan: WritePlan, what: str, *, repeat: bool = True) -> Answer:
    """Send a write and receive its acknowledgement, if the servo gives any.

    Args:
        line: The bus.
        plan: The write.
        what: Name of the write, for display.
        repeat: Whether it may be executed more than once.

    Raises:
        LinkError: The line has a fault.
        StoppedError: The arm was stopped after the call; nothing more was sent.
        PreemptedError: The arm was stopped while the write was sent.
    """
    servo_id = plan.servo_id
    if servo_id == BROADCAST_ID:
        line.send(plan.request)
        return Answer(servo_id, what, confirmed=False)
    machine, servos = line.machine, line.machine.servos
    with line.epochs.calling(what), line.lock:
        plan.base = machine.base(plan.total, (servo_id,))
        if not servos.acknowledges(servo_id):
            line.post(plan.request, line.epochs.of_this_call)
            # An unexpected acknowledgement must not count as the answer to the next ping or write.
            now = line.clock()
            machine.gave_up((servo_id,), 0, plan.request, now, now)
            return Answer(servo_id, what, confirmed=False)
        if line.doubted((servo_id,), 0):
            block = line.run(_write_and_look(machine, plan)) if repeat else None
            if block is not None:
                return Answer(servo_id, what, block.error)
            if not line.run(questions.settle(machine, servo_id, 0)):
                return Answer(servo_id, what, 0, SILENT, False)
        line.check_call()
        start = line.clock()
        try:
            data = _exchange(line, plan, start)
            if data is None:
                servos.confirmed_writes.add(servo_id)
                return _new(Answer, (servo_id, what, 0, "", True))
            status, instead = line.run(_finish(machine, plan, data, machine.retries if repeat else 0))
        except BaseException:
            # An error or Ctrl-C: the acknowledgement may still arrive.
            machine.gave_up((servo_id,), 0, plan.request, start, line.clock())
            raise
        if status is not None:
            servos.confirmed_writes.add(servo_id)
            return Answer(servo_id, what, status.error)
        if servo_id not in servos.confirmed_writes:
            level = line.run(_level(machine, servo_id))
            if level is not None and level.params == b"\0":
                servos.set_acknowledges(servo_id, False)
                return Answer(servo_id, what, level.error, confirmed=False)
        return Answer(servo_id, what, 0, why(instead), False)


def _exchange(line: BusLine, plan: WritePlan, start: float) -> bytes | None:
    """Send a write at `start`; returns None if the bytes received are its acknowledgement, else those bytes."""
    machine = line.machine
    machine.sent.add(plan.request, start)
    data = line.exchange(plan.request, plan.base + machine.timing.allowance)
    machine.turns += 1
    if data != plan.acknowledgement:
        return data
    machine.asked_at = start
    machine.learn_time(plan, line.clock())
    return None


def _finish(
    machine: BusMachine, plan: WritePlan, data: bytes, retries: int
) -> Conversation[tuple[StatusPacket | None, str]]:
    """Receive the acknowledgement of a sent write, or None; and in words what arrived instead."""
    servo_id, header = plan.servo_id, plan.series.reply_header
    status, collector = yield from questions.ask_one(
        machine,
        servo_id,
        plan.request,
        0,
        base=plan.base,
        data=data,
        header=header,
        retries=retries,
    )
    if status is None and plan.data and servo_id in collector.copies:
        # Its answer looks like the echo of a recent packet: read the register back.
        status = yield from _look(machine, plan)
    return status, collector.in_words()


def _write_and_look(machine: BusMachine, plan: WritePlan) -> Conversation[StatusPacket | None]:
    """Write while an acknowledgement could be an earlier one, and read back; None if that does not confirm it."""
    header = plan.series.reply_header
    for _ in range(1 + machine.retries if plan.data else 0):
        yield from machine.collect(plan.request, (plan.servo_id,), 0, plan.base, header=header)
        found = yield from _look(machine, plan)
        if found is not None:
            machine.count.settled += 1
            return found
    return None


def _look(machine: BusMachine, plan: WritePlan) -> Conversation[StatusPacket | None]:
    """Read a write back; None if the value differs, or the servo does not answer."""
    block, _ = yield from questions.ask_block(machine, plan.servo_id, plan.address, len(plan.data))
    return block if block is not None and block.params == plan.data else None


def _level(machine: BusMachine, servo_id: int) -> Conversation[StatusPacket | None]:
    """Read whether a servo acknowledges writes; None if it has no such register, or does not answer."""
    register = machine.servos.series_of(servo_id).registers.get(_LEVEL)
    if register is None:
        return None
    level, _ = yield from questions.ask_block(machine, servo_id, register.address, register.size)
    return level


# --- registers ----------------------------------------------------------------------------------------------------


def write_register(line: BusLine, servo_id: int, register: Register, raw: int) -> Answer:
    """Write the raw value of a register.

    Raises:
        UsageError: The register cannot hold it; nothing was sent.
        LinkError: As `acknowledged`, and so are StoppedError and PreemptedError.
    """
    data = register.encode(in_range(servo_id, register, raw))
    plan = WritePlan(servo_id, line.machine.servos.series_of(servo_id), register.address, data)
    return acknowledged(line, plan, f"a write of {register.name}")


def sync_write_each(line: BusLine, name: str, values: Mapping[int, int]) -> None:
    """Write a register that differs between the servos: one packet for each address and width.

    Raises:
        UsageError: A servo has no such register or it cannot hold its value; nothing was sent.
        StoppedError: The arm was stopped after the call; nothing more was sent.
        PreemptedError: The arm was stopped while a packet was sent.
    """
    # By address and width: the byte order of the data is that of each servo.
    rows: dict[tuple[int, int], dict[int, bytes]] = {}
    for servo_id, value in values.items():
        register = writable(line.machine.servos.series_of(servo_id), servo_id, name)
        data = register.encode(in_range(servo_id, register, value))
        rows.setdefault((register.address, register.size), {})[servo_id] = data
    with line.epochs.calling(name):
        for (address, _), data_of in rows.items():
            line.send(make_sync_write(address, data_of))


def in_range(servo_id: int, register: Register, raw: int) -> int:
    """Check a raw value against the register's range, and return it.

    Raises:
        UsageError: It is outside the range.
    """
    low, high = register.minimum, register.maximum
    if (low is not None and raw < low) or (high is not None and raw > high):
        raise UsageError(f"{register.name} of servo {servo_id} takes {low}..{high}, not {raw}; nothing was sent")
    return raw
