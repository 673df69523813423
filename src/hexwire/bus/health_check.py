"""Reads what the health of the servos on a bus is judged from. Nothing is written and nothing moves.

Owns which registers are read, how often, and how lost answers are counted. Must not know what is healthy: `health`
judges.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hexwire.wire.registers import Series

from .health import ServoSamples
from .live_values import LiveValues, read_live
from .servo_bus import ServoBus
from .setup import Found, identify, shares_id
from .survey import survey

__all__ = ["check_health"]

_READS = 200
"""Reads of each servo for its lost answers."""
_SAMPLES, _PERIOD = 20, 0.05
_PATIENCE = 0.03
"""Seconds allowed for the adapter and this computer."""


def check_health(
    bus: ServoBus,
    servo_ids: Sequence[int],
    *,
    reads: int = _READS,
    go_on: Callable[[], bool] = lambda: True,
) -> list[ServoSamples]:
    """Read all servos for about a second, then each of them again and again.

    Args:
        bus: The open bus.
        servo_ids: In the order of the chain, from the adapter on.
        reads: Reads of each servo, without repeats, that count lost answers.
        go_on: Asked between two reads; what is there is returned as soon as it returns False.

    Raises:
        LinkError: The line has a fault.
    """
    infos = {servo_id: identify(bus, servo_id) for servo_id in servo_ids}
    here = [servo_id for servo_id, info in infos.items() if info is not None]
    found = [Found(infos[servo_id], servo_id, bus.timing.baud, shares_id(bus, servo_id)) for servo_id in here]
    known = {row.found.servo_id: row for row in survey(bus, found)}
    settings = {servo_id: dict(known[servo_id].settings) for servo_id in here}
    torque: dict[int, bool | None] = {}
    for servo_id in here:
        registers = bus.series_of(servo_id).registers
        if "max_temperature" in registers:
            settings[servo_id]["max_temperature"] = bus.read(servo_id, "max_temperature").value
        on = bus.read(servo_id, "torque_enable").raw if "torque_enable" in registers else None
        torque[servo_id] = None if on is None else bool(on)
    live: dict[int, list[LiveValues]] = {servo_id: [] for servo_id in here}
    for _ in range(_SAMPLES if here else 0):
        if not go_on():
            break
        for row in read_live(bus, here):
            if not row.error:
                live[row.servo_id].append(row)
        bus.pause(_PERIOD)
    counts = _count_losses(bus, here, reads, go_on)
    return [
        ServoSamples(
            servo_id,
            servo_id in here,
            tuple(known[servo_id].remarks) if servo_id in known else (),
            settings.get(servo_id),
            torque.get(servo_id),
            tuple(live.get(servo_id, ())),
            *counts.get(servo_id, (0, 0)),
        )
        for servo_id in servo_ids
    ]


def _count_losses(
    bus: ServoBus, servo_ids: Sequence[int], reads: int, go_on: Callable[[], bool]
) -> dict[int, tuple[int, int]]:
    """Number of reads and of lost answers of each servo; in turns, so that a disturbance meets all of them."""
    asked, lost = dict.fromkeys(servo_ids, 0), dict.fromkeys(servo_ids, 0)
    retries = bus.retries
    try:
        bus.retries = 0
        for _ in range(reads):
            if not go_on():
                break
            for servo_id in servo_ids:
                asked[servo_id] += 1
                # A legacy servo answers short reads only.
                count = 2 if bus.series_of(servo_id) is Series.SEVEN_BOT else 15
                # An answer that is late because this computer stalls says nothing about cables.
                bus.timing.allowance = max(bus.timing.allowance, _PATIENCE)
                lost[servo_id] += bool(bus.read_block(servo_id, 56, count).error)
    finally:
        bus.retries = retries
    return {servo_id: (asked[servo_id], lost[servo_id]) for servo_id in servo_ids}
