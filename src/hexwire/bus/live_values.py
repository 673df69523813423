"""What a servo measures now: position, speed, load, voltage, temperature, current and faults, read at once.

Owns the block of registers that holds them in every series, and their SI values. Must not know joints or displays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from hexwire.wire.registers import Series

from .servo_bus import ServoBus
from .values import fault_words

__all__ = ["LiveValues", "read_live"]

_FIRST, _COUNT = 56, 15
_NAMES = ("present_position", "present_speed", "present_load", "present_voltage", "present_temperature")


class LiveValues(NamedTuple):
    """What one servo measures. NaN where it does not report a value; a legacy servo reports only its position.

    Attributes:
        servo_id: The servo.
        counts: Its position, raw; None if it did not answer.
        position: Radians from count 0.
        speed: Radians per second.
        load: Fraction of full load.
        voltage: Supply, volts.
        temperature: Degrees Celsius.
        current: Amperes.
        status: Its error byte.
        error: Why there are no values; empty if there are.
    """

    servo_id: int
    counts: int | None
    position: float
    speed: float
    load: float
    voltage: float
    temperature: float
    current: float
    status: int = 0
    error: str = ""

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of its faults."""
        return fault_words(self.status)


def read_live(bus: ServoBus, servo_ids: Sequence[int]) -> list[LiveValues]:
    """Read what servos measure, in one request where they support it.

    Raises:
        LinkError: The line has a fault.
    """
    able = tuple(i for i in servo_ids if bus.series_of(i) is not Series.SEVEN_BOT)
    blocks = {block.servo_id: block for block in bus.sync_read_blocks(_FIRST, _COUNT, able)} if able else {}
    rows = []
    for servo_id in servo_ids:
        registers = bus.series_of(servo_id).registers
        block = blocks.get(servo_id)
        if block is None:
            reading = bus.read(servo_id, "present_position")
            nan = math.nan
            rows.append(
                LiveValues(
                    servo_id, reading.raw, reading.value, nan, nan, nan, nan, nan, reading.status, reading.error
                )
            )
            continue
        position, speed, load, voltage, temperature = (block.value(registers[name]) for name in _NAMES)
        row = registers.get("present_current")
        current = block.value(row) if row is not None and row.si_unit == "A" else math.nan
        counts = block.raw(registers["present_position"])
        rows.append(
            LiveValues(
                servo_id,
                counts,
                position,
                speed,
                load,
                voltage,
                temperature,
                current,
                block.status,
                block.error,
            )
        )
    return rows
