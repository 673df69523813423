"""Instructions to servos without registers: ping, reboot, factory reset, calibration, and raw packets.

Owns the instructions that name no register, as functions of a `BusLine`; `ServoBus` has them as methods and
documents them. Must not know registers by name, except for the position of a calibration, nor arms.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from hexwire.errors import NotSupportedError, RemoteProtocolError
from hexwire.session.servo_answers import AnswerCollector, expected_answer
from hexwire.wire import servo_packet as packets
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import BROADCAST_ID
from hexwire.wire.tables import LEGACY_HEADER, MAX_SERVO_ID

from . import questions
from .values import Answer, why
from .writes import order

if TYPE_CHECKING:
    from .line import BusLine
    from .machine import BusMachine, Conversation

__all__ = [
    "action",
    "ask",
    "backup",
    "broadcast_ping",
    "calibrate",
    "pause",
    "ping",
    "raw",
    "reboot",
    "reset_turns",
    "restore",
]

_PING_BYTES = 6


# --- ping ---------------------------------------------------------------------------------------------------------


def ping(line: BusLine, servo_id: int) -> Answer:
    """See `ServoBus.ping`."""
    with line.lock:
        status, collector = line.run(_ping(line.machine, servo_id))
    if status is None:
        return Answer(servo_id, "ping", 0, why(collector.in_words()), False)
    return Answer(servo_id, "ping", status.error)


def _ping(machine: BusMachine, servo_id: int) -> Conversation[tuple[packets.StatusPacket | None, AnswerCollector]]:
    legacy = machine.servos.series_of(servo_id) is Series.SEVEN_BOT
    if not legacy and (yield from machine.doubted(servo_id, 0)):
        return (yield from questions.is_there(machine, servo_id))
    status, collector = yield from questions.ask_one(
        machine,
        servo_id,
        packets.make_ping(servo_id),
        0,
        base=machine.base(2 * _PING_BYTES, (servo_id,)),
        # An unknown servo may be of either kind.
        header=LEGACY_HEADER if legacy else None,
        retries=machine.retries,
    )
    if status is None and not legacy and servo_id in collector.copies:
        # The answer of a servo with low supply voltage equals its ping.
        return (yield from questions.is_there(machine, servo_id))
    return status, collector


def broadcast_ping(line: BusLine, most: int) -> tuple[tuple[int, ...], int]:
    """See `ServoBus.broadcast_ping`."""
    machine = line.machine
    with line.lock:
        request = packets.make_ping(BROADCAST_ID)
        base = machine.base(_PING_BYTES * (1 + most), range(min(most, 8)))
        line.link.flush_input()
        data = line.exchange(request, base + machine.timing.allowance)
        now = line.clock()
        while more := line.link.read(now + base):
            data += more
        heard = AnswerCollector(request, range(MAX_SERVO_ID + 1), 0, sent=machine.sent.packets(now))
        heard.receive(data)
        found = set(heard.answers) | set(heard.murky)
        # An answer that may be the echo of an earlier ping: ping the servo alone.
        found |= {servo_id for servo_id in heard.copies - found if not ping(line, servo_id).error}
    data = packets.strip_echo(data, request)
    return tuple(sorted(found)), max(0, len(data) - _PING_BYTES * len(found))


# --- orders -------------------------------------------------------------------------------------------------------


def restore(line: BusLine, servo_id: int) -> Answer:
    """See `ServoBus.restore`."""
    _must_know(line, servo_id, "RESTORE")
    if line.machine.servos.series_of(servo_id) is Series.SEVEN_BOT:
        raise NotSupportedError(f"servo {servo_id} is a legacy servo: a factory reset would change its id to 1")
    return order(line, servo_id, packets.make_restore(servo_id), "factory reset", repeat=False)


def reboot(line: BusLine, servo_id: int) -> None:
    """See `ServoBus.reboot`."""
    _must_know(line, servo_id, "REBOOT")
    line.send(packets.make_reboot(servo_id))


def backup(line: BusLine, servo_id: int) -> Answer:
    """See `ServoBus.backup`."""
    _must_know(line, servo_id, "BACKUP")
    return order(line, servo_id, packets.make_backup(servo_id), "backup")


def reset_turns(line: BusLine, servo_id: int) -> Answer:
    """See `ServoBus.reset_turns`."""
    _must_know(line, servo_id, "RESET_STATE")
    return order(line, servo_id, packets.make_reset_state(servo_id), "reset of turns")


def calibrate(line: BusLine, servo_id: int, position: int | None) -> Answer:
    """See `ServoBus.calibrate`."""
    _must_know(line, servo_id, "CALIBRATE")
    register = line.machine.servos.series_of(servo_id).register("goal_position")
    data = None if position is None else register.encode(position)
    return order(line, servo_id, packets.make_calibrate(servo_id, data), "calibration", repeat=False)


def action(line: BusLine, servo_id: int) -> Answer | None:
    """See `ServoBus.action`."""
    if servo_id == BROADCAST_ID:
        line.send(packets.make_action())
        return None
    return order(line, servo_id, packets.make_action(servo_id), "action", repeat=False)


def _must_know(line: BusLine, servo_id: int, instruction: str) -> None:
    series = line.machine.servos.series_of(servo_id)
    if instruction not in series.instructions:
        raise NotSupportedError(f"servo {servo_id} is a {series.value} servo, which has no {instruction.lower()}")


# --- raw packets --------------------------------------------------------------------------------------------------


def ask(line: BusLine, request: bytes, servo_id: int, params: int) -> tuple[packets.StatusPacket | None, str]:
    """See `ServoBus.ask`."""
    machine = line.machine
    with line.calling(request), line.lock:
        if line.run(_in_doubt(machine, request, servo_id, params)):
            return None, ""
        base = machine.base(len(request) + 6 + params, (servo_id,))
        collector = line.run(machine.collect(request, (servo_id,), params, base, header=None))
    return collector.answers.get(servo_id), collector.in_words()


def raw(line: BusLine, request: bytes, servo_ids: Sequence[int], params: int) -> dict[int, bytes]:
    """See `ServoBus.raw`."""
    machine = line.machine
    with line.calling(request), line.lock:
        if not servo_ids:
            line.post(request, line.epochs.of_this_call)
            now = line.clock()
            for servo_id, length in _answers_of(request):
                machine.gave_up((servo_id,), length, request, now, now)
            return {}
        sure = [i for i in servo_ids if not line.run(_in_doubt(machine, request, i, params))]
        base = machine.base(len(request) + len(servo_ids) * (6 + params), servo_ids)
        collector = line.run(machine.collect(request, servo_ids, params, base, header=None))
    return {servo_id: status.params for servo_id, status in collector.answers.items() if servo_id in sure}


def _in_doubt(machine: BusMachine, request: bytes, servo_id: int, params: int) -> Conversation[bool]:
    """Whether the answer to a request could be a late one, and no further request can exclude that."""
    if not (yield from machine.doubted(servo_id, params, request)):
        return False
    return not (yield from questions.settle(machine, servo_id, params))


def _answers_of(request: bytes) -> list[tuple[int, int]]:
    """Return the servos that answer a packet, and their numbers of parameter bytes; empty for an invalid packet."""
    try:
        expected = expected_answer(packets.parse_packet(request))
    except RemoteProtocolError:
        return []
    return [(servo_id, expected.params) for servo_id in expected.servo_ids]


def pause(line: BusLine, seconds: float) -> None:
    """See `ServoBus.pause`."""
    with line.lock:
        end = line.clock() + seconds
        while line.clock() < end:
            line.link.read(end)
