"""What each servo on a bus is: identity, settings that matter, voltage class, and what is wrong with it.

Owns which settings are read for that, when servos are compared with each other, and what is known of a servo from
its model, firmware and settings, with the sources. Reads only. Must not know displays.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from hexwire.wire.registers import Series

from .servo_bus import ServoBus
from .setup import Found, ServoInfo, identify

__all__ = ["Remark", "Surveyed", "remarks", "survey", "voltage_class"]

_LOW_CLASS, _HIGH_CLASS = 9.0, 11.0
_FULL_PACK = 8.4
"""Volts of two full lithium cells: what a servo of 7.4 V meets at most."""
_UNSET = 0.5
"""Below this a servo does not measure its supply (legacy parts report 0)."""
_SETTINGS = ("max_voltage", "min_voltage", "mode")


class Remark(NamedTuple):
    """One thing to know.

    Attributes:
        bad: It needs something to be done; else it is only good to know.
        text: In words, with what to do.
    """

    bad: bool
    text: str


def voltage_class(max_voltage: float) -> str:
    """Return the class of a servo by its stored upper limit, as in ``7.4 V``; empty if that does not tell.

    An STS3215 is sold for 7.4 V and for 12 V under the same model number; only the stored limits tell them apart.
    The vendor delivers 8 V as the limit of the one and 14 V of the other (its tool's tables of STS and SMS).
    """
    if _UNSET < max_voltage <= _LOW_CLASS:
        return "7.4 V"
    return "12 V" if max_voltage >= _HIGH_CLASS else ""


def remarks(
    info: ServoInfo, settings: Mapping[str, float], supply: float = math.nan, others: Sequence[ServoInfo] = ()
) -> list[Remark]:
    """Collect what is known of a servo.

    Args:
        info: Its identity.
        settings: SI values of its stored registers, as far as they are known.
        supply: Its present supply, volts; NaN if unknown.
        others: Identities of the other servos on the bus.
    """
    found = _of_firmware(info, others)
    high, low = settings.get("max_voltage", math.nan), settings.get("min_voltage", math.nan)
    kind = voltage_class(high)
    if supply > _UNSET:
        if supply > high:
            found.append(
                Remark(
                    True,
                    f"supply {supply:.1f} V is above its limit of {high:.1f} V: switch it off, check its class",
                )
            )
        elif supply < low:
            found.append(Remark(True, f"supply {supply:.1f} V is below its limit of {low:.1f} V: check the supply"))
        elif kind == "12 V" and supply <= _FULL_PACK + 0.3:
            found.append(Remark(False, f"made for 12 V: with {supply:.1f} V it is slower and weaker"))
    mode = settings.get("mode", 0.0)
    if mode:
        found.append(Remark(True, f"in mode {mode:.0f}, not in position mode (0): goals do not stop it"))
    if not info.acknowledges and info.series is not Series.SEVEN_BOT:
        found.append(
            Remark(False, "does not acknowledge writes (status_return_level 0): each is read back instead")
        )
    return found


def _of_firmware(info: ServoInfo, others: Sequence[ServoInfo]) -> list[Remark]:
    if info.series is None:
        text = f"firmware {info.firmware} has no register table here: only ping and identity are reliable"
        return [Remark(True, text)] if info.firmware else []
    found = []
    version = tuple(int(part) for part in info.firmware.split(".")) if info.firmware else ()
    if info.series is Series.STS_SMS and (3, 0) <= version < (3, 10):
        # As owners of LeRobot arms report; the instruction to calibrate came with 3.10 (vendor's document).
        text = (
            f"firmware {info.firmware} is older than 3.10: LeRobot's calibration fails with it (hexwire sets the "
            "middle another way). Only the vendor's tool FD updates it: connect this servo alone for that"
        )
        found.append(Remark(True, text))
    if info.series is Series.HLS and (3, 40) <= version < (3, 43):
        found.append(
            Remark(
                False, f"firmware {info.firmware}: a middle can be set at the present position only (3.43: at any)"
            )
        )
    mixed = sorted({row.firmware for row in others if row.series is info.series and row.model == info.model} - {""})
    if any(firmware != info.firmware for firmware in mixed):
        versions = ", ".join(sorted({*mixed, info.firmware}))
        found.append(
            Remark(True, f"servos of this model have different firmware ({versions}): LeRobot refuses such an arm")
        )
    return found


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
        supply, unread = math.nan, list[str]()
        if row.info is not None and row.info.series is not None and row.baud == bus.timing.baud and not row.shared:
            # A search at other rates leaves what it knew of a servo behind.
            identify(bus, row.servo_id)
            known = bus.series_of(row.servo_id).registers
            for name in _SETTINGS:
                if name in known:
                    reading = bus.read(row.servo_id, name)
                    if reading.raw is None:
                        unread.append(name)
                    else:
                        settings[name] = reading.value
            if "max_voltage" in known:
                supply = bus.read(row.servo_id, "present_voltage").value
        told = [] if row.info is None else remarks(row.info, settings, supply, others)
        if unread:
            names = ", ".join(unread)
            told.append(Remark(True, f"did not answer when {names} was read: check its cable, try again"))
        if row.shared:
            told = [Remark(True, "several servos seem to have this id: connect one alone, and give it another")]
        elif row.info is None:
            told = [Remark(True, "it answers pings, but tells nothing of itself: check its cable")]
        rows.append(Surveyed(row, settings, supply, voltage_class(settings.get("max_voltage", math.nan)), told))
    return rows
