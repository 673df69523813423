"""What each servo on a bus is: identity, settings that matter, voltage class, and what is wrong with it.

Owns which settings are read for that, and when servos are compared with each other. Reads only. Must not know
displays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from .servo_bus import ServoBus
from .servo_facts import Remark, remarks, voltage_class
from .setup import Found, identify

__all__ = ["Surveyed", "survey"]

_SETTINGS = ("max_voltage", "min_voltage", "mode")


class Surveyed(NamedTuple):
    """One servo.

    Attributes:
        found: Its identity, id and rate.
        settings: SI values of stored settings, by name.
        supply: Its supply, volts; NaN if it does not measure it, or is at another rate.
        kind: Its voltage class, as in ``7.4 V``; empty if unknown.
        remarks: What is known of it.
    """

    found: Found
    settings: dict[str, float]
    supply: float
    kind: str
    remarks: list[Remark]

    @property
    def bad(self) -> bool:
        """Whether something needs to be done."""
        return self.found.shared or any(remark.bad for remark in self.remarks)


def survey(bus: ServoBus, found: Sequence[Found]) -> list[Surveyed]:
    """Read what matters of the servos that a search found; those at another rate than the bus's are only listed."""
    others = [row.info for row in found if row.info is not None]
    rows = []
    for row in found:
        settings: dict[str, float] = {}
        supply = math.nan
        if row.info is not None and row.info.series is not None and row.baud == bus.timing.baud and not row.shared:
            # A search at other rates leaves what it knew of a servo behind.
            identify(bus, row.servo_id)
            known = bus.series_of(row.servo_id).registers
            for name in _SETTINGS:
                if name in known and (reading := bus.read(row.servo_id, name)).raw is not None:
                    settings[name] = reading.value
            if "max_voltage" in known:
                supply = bus.read(row.servo_id, "present_voltage").value
        told = [] if row.info is None else remarks(row.info, settings, supply, others)
        if row.shared:
            told = [Remark(True, "several servos seem to have this id: connect one alone, and give it another")]
        elif row.info is None:
            told = [Remark(True, "it answers pings, but tells nothing of itself: check its cable")]
        rows.append(Surveyed(row, settings, supply, voltage_class(settings.get("max_voltage", math.nan)), told))
    return rows
