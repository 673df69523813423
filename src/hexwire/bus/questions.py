"""Requests to servos: repeats them, and uses another request where an answer would be ambiguous.

Owns repeats, and which answers are trusted. A register is read with its neighbours, in a length that no late reply
has. A request with only one possible length (a ping, an acknowledgement, a legacy servo's two bytes) waits until
another request to the same servo is answered: a link keeps the order of bytes, so late replies have arrived by
then.

Each function is a conversation of a `BusMachine`; see there. No I/O and no clock. Must not know registers by name.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from hexwire.session.servo_answers import AnswerCollector
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import StatusPacket, make_ping, make_read

from .machine import ADAPTER_TIME, BusMachine, Conversation
from .plan import LEGACY_READ, SyncReadPlan

__all__ = ["BlockAnswers", "ask_block", "ask_many", "ask_one", "ask_registers", "is_there", "places", "settle"]

_ANY_REGISTER = Series.STS_SMS.register("present_temperature").address
"""Register to read when only the answer matters: at the same address, one byte wide, in every series."""


def places(address: int, count: int, end: int, most: int) -> Iterator[tuple[int, int]]:
    """Yield blocks of registers that contain `count` bytes from `address`, shortest first, one of each length.

    Args:
        address: First register address.
        count: Bytes wanted.
        end: Address after the last register.
        most: Most bytes in the answer to one read.

    Yields:
        First address and length of each. The first block is the one wanted.
    """
    yield address, count
    end = max(end, address + count)
    for length in range(count + 1, min(most, end) + 1):
        yield min(address, end - length), length


class BlockAnswers:
    """Answers to the attempts of one call to read registers.

    An answer to any attempt counts: no other answer of that length was outstanding from that servo.

    Args:
        address: First register address.
        count: Bytes wanted.
    """

    def __init__(self, address: int, count: int) -> None:
        self._address = address
        self._count = count
        self._tried: dict[tuple[int, int], int] = {}
        self._heard: dict[int, bytes] = {}

    def take(self, collector: AnswerCollector, place: tuple[int, int]) -> dict[int, StatusPacket]:
        """Return the answers that are trusted after an attempt, cut to the bytes wanted."""
        found: dict[int, StatusPacket] = {}
        for (servo_id, length), status in collector.others.items():
            if (servo_id, length) in self._tried:
                found[servo_id] = self._cut(status, self._tried[servo_id, length])
        for servo_id, status in collector.murky.items():
            cut = self._cut(status, place[0])
            # The same answer twice, followed by invalid bytes: for example, an adapter that adds a byte.
            if self._heard.get(servo_id) == cut.params:
                found[servo_id] = cut
            self._heard[servo_id] = cut.params
        for servo_id, status in collector.answers.items():
            found[servo_id] = self._cut(status, place[0])
        for servo_id in collector.servo_ids:
            self._tried[servo_id, place[1]] = place[0]
        return found

    def _cut(self, status: StatusPacket, first: int) -> StatusPacket:
        skip = self._address - first
        return status._replace(params=status.params[skip : skip + self._count])


def ask_one(
    machine: BusMachine,
    servo_id: int,
    request: bytes,
    params: int,
    *,
    base: float,
    data: bytes | None = None,
    header: bytes | None,
    retries: int,
) -> Conversation[tuple[StatusPacket | None, AnswerCollector]]:
    """Send a request whose answer has only one possible length. Only for requests that may run `1 + retries` times.

    Args:
        machine: The bus.
        servo_id: The servo.
        request: The packet.
        params: Parameter bytes of the answer.
        base: Seconds that the answer takes without the adapter.
        data: Bytes received so far, if the request was sent; None sends it.
        header: First two bytes of the answer; None accepts either kind.
        retries: Number of repeats.

    Returns:
        The answer or None, and the collector of the last attempt.
    """
    late = data is None and (yield from machine.doubted(servo_id, params))
    if late and not (yield from settle(machine, servo_id, params)):
        machine.count.given_up += 1
        return None, AnswerCollector(request, (servo_id,), params)
    collector = yield from machine.collect(request, (servo_id,), params, base, data, header=header)
    for attempt in range(1 + retries):
        if attempt:
            machine.count.repeats += 1
            collector = yield from machine.collect(request, (servo_id,), params, base, header=header)
        found = collector.answers.get(servo_id)
        if found is not None:
            machine.silent.pop(servo_id, None)
            return found, collector
        if servo_id in collector.copies:
            # It may have answered; a repeat of the same request does not help.
            break
    else:
        machine.mark_silent(servo_id, machine.now)
    machine.count.given_up += 1
    return None, collector


def ask_block(
    machine: BusMachine, servo_id: int, address: int, count: int, *, base: float = 0.0, data: bytes | None = None
) -> Conversation[tuple[StatusPacket | None, AnswerCollector]]:
    """Read registers of one servo, with their neighbours where an answer of that length could be a late one.

    Args:
        machine: The bus.
        servo_id: The servo.
        address: First register address.
        count: Bytes wanted.
        base: Seconds that the answer takes, if the request was sent.
        data: Bytes received so far, if the request was sent; None sends it.

    Returns:
        The answer with the bytes wanted, or None; and the collector of the last attempt.
    """
    series = machine.servos.series_of(servo_id)
    collector = AnswerCollector(b"", (servo_id,), count)
    block = BlockAnswers(address, count)
    left, first = 1 + machine.retries, True
    while left > 0:
        left -= 1
        place: tuple[int, int] | None = (address, count)
        if data is None:
            place = yield from _free_place(machine, (servo_id,), address, count)
            if place is None and series is Series.SEVEN_BOT and (yield from settle(machine, servo_id, count)):
                place = yield from _free_place(machine, (servo_id,), address, count)
        if place is None:
            break
        request = make_read(servo_id, *place)
        machine.count.repeats += not first
        if data is None:
            base = machine.base(len(request) + 6 + place[1], (servo_id,))
        collector = yield from machine.collect(
            request, (servo_id,), place[1], base, data, header=series.reply_header
        )
        data = None
        found = block.take(collector, place).get(servo_id)
        if found is not None:
            machine.silent.pop(servo_id, None)
            machine.count.settled += place != (address, count)
            return found, collector
        if first and servo_id in collector.copies:
            # It may have answered with the same bytes as an echo: send another request.
            left = max(left, 1)
        first = False
    else:
        machine.mark_silent(servo_id, machine.now)
    machine.count.given_up += 1
    return None, collector


def ask_registers(machine: BusMachine, servo_id: int, address: int, count: int) -> Conversation[tuple[bytes, int]]:
    """Read registers of one servo; of a legacy servo, two bytes at a time.

    Returns:
        The bytes, empty if a request was not answered, and all error bits received.

    Raises:
        UsageError: There are no such registers.
    """
    legacy = machine.servos.series_of(servo_id) is Series.SEVEN_BOT
    step = LEGACY_READ if legacy else count
    if not legacy:
        make_read(servo_id, address, count)  # refuses an invalid block
    data, error = b"", 0
    for at in range(address, address + count, step):
        status, _ = yield from ask_block(machine, servo_id, at, step)
        if status is None:
            return b"", 0
        data += status.params
        error |= status.error
    return data[:count], error


def ask_many(machine: BusMachine, plan: SyncReadPlan, data: bytes | None) -> Conversation[dict[int, StatusPacket]]:
    """Collect the answers to a sync read; repeats go only to servos without an answer.

    Args:
        machine: The bus.
        plan: The sync read.
        data: Bytes received so far, if it was sent; None sends it.

    Returns:
        Answers with the bytes wanted, by servo id.
    """
    header = plan.series.reply_header
    block = BlockAnswers(plan.address, plan.count)
    found: dict[int, StatusPacket] = {}
    begin, silent = machine.now, machine.silent
    wanted: list[int] = list(plan.ids)
    if data is None and silent:
        # Servos that were silent go first: the answers of the others then end the wait.
        wanted.sort(key=lambda servo_id: servo_id not in silent)
    attempt, attempts = 0, 1 + machine.retries
    while attempt < attempts:
        if attempt:
            wanted = [i for i in plan.ids if i not in found and silent.get(i, 0.0) <= begin]
            if not wanted:
                break
            machine.count.repeats += 1
        place: tuple[int, int] | None = (plan.address, plan.count)
        if data is None:
            place, wanted = yield from _place_for_most(machine, wanted, plan.address, plan.count)
        if place is None:
            break
        if len(wanted) == 1 and attempt:
            request = make_read(wanted[0], *place)
            base = machine.base(len(request) + 6 + place[1], wanted)
        else:
            asked = plan if data is not None else machine.plans.part(plan, tuple(wanted), *place)
            request, base = asked.request, asked.base
        collector = yield from machine.collect(request, wanted, place[1], base, data, header=header)
        data = None
        for servo_id, status in block.take(collector, place).items():
            found[servo_id] = status
            machine.count.settled += place[1] != plan.count
            silent.pop(servo_id, None)
        if not attempt and collector.copies:
            attempts = max(attempts, 2)  # as in `ask_block`
        attempt += 1
    for servo_id in plan.ids:
        if servo_id not in found:
            machine.count.given_up += 1
            if silent.get(servo_id, 0.0) <= begin:
                machine.mark_silent(servo_id, begin)
    return found


def is_there(machine: BusMachine, servo_id: int) -> Conversation[tuple[StatusPacket | None, AnswerCollector]]:
    """Check whether a servo answers, by a read of any length; not for legacy servos."""
    found, collector = yield from ask_block(machine, servo_id, _ANY_REGISTER, 1)
    machine.count.settled += found is not None
    return found, collector


def settle(machine: BusMachine, servo_id: int, params: int) -> Conversation[bool]:
    """Make sure that no late answer of that length can arrive from a servo; False if it does not answer.

    An answer of another length proves it.
    """
    if machine.servos.series_of(servo_id) is Series.SEVEN_BOT:
        settled = yield from _settle_legacy(machine, servo_id)
    else:
        found, _ = yield from is_there(machine, servo_id)
        settled = found is not None
    if settled:
        machine.late_replies.settled(servo_id, params)
    else:
        machine.mark_silent(servo_id, machine.now)
    return settled


def _settle_legacy(machine: BusMachine, servo_id: int) -> Conversation[bool]:
    """Send a request in the other of a legacy servo's two lengths, and repeat it after a pause.

    Only their order distinguishes its answers. The pause is for a line that does not keep the order strictly.
    """
    header = Series.SEVEN_BOT.reply_header
    for _ in range(1 + machine.retries):
        if not (yield from machine.doubted(servo_id, 0)):
            params, request = 0, make_ping(servo_id)
        elif not (yield from machine.doubted(servo_id, LEGACY_READ)):
            params, request = LEGACY_READ, make_read(servo_id, _ANY_REGISTER, LEGACY_READ)
        else:
            break
        base = machine.base(len(request) + 6 + params, (servo_id,))
        collector = yield from machine.collect(request, (servo_id,), params, base, header=header)
        if servo_id not in collector.answers:
            continue
        yield from machine.drain(ADAPTER_TIME)
        collector = yield from machine.collect(request, (servo_id,), params, base, header=header)
        if servo_id in collector.answers:
            machine.count.settled += 1
            return True
    return False


# --- blocks of registers ------------------------------------------------------------------------------------------


def _places(machine: BusMachine, servo_id: int, address: int, count: int) -> Iterable[tuple[int, int]]:
    most = machine.servos.series_of(servo_id).max_read
    return places(address, count, machine.servos.end_of(servo_id), most)


def _free_place(
    machine: BusMachine, servo_ids: Sequence[int], address: int, count: int
) -> Conversation[tuple[int, int] | None]:
    """Find the shortest block around registers whose answers cannot be late ones; None without one."""
    for place in _places(machine, servo_ids[0], address, count):
        if not (yield from machine.any_doubted(servo_ids, place[1])):
            return place
    return None


def _place_for_most(
    machine: BusMachine, servo_ids: list[int], address: int, count: int
) -> Conversation[tuple[tuple[int, int] | None, list[int]]]:
    """Find a block for all of these servos, or for as many as possible; returns it and those servos."""
    place = yield from _free_place(machine, servo_ids, address, count)
    if place is not None:
        return place, servo_ids
    best: list[int] = []
    for candidate in _places(machine, servo_ids[0], address, count):
        suited = []
        for servo_id in servo_ids:
            if not (yield from machine.doubted(servo_id, candidate[1])):
                suited.append(servo_id)  # noqa: PERF401 (no comprehension may yield)
        if len(suited) > len(best):
            place, best = candidate, suited
    return place, best
