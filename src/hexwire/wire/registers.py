"""Servo registers as typed rows: address, width, coding, unit, range; one set per series.

Owns the coding of a register (byte order, sign-magnitude) and its SI value. The rows are generated into `tables`
from the schema. Knows nothing of packets or joints: angles are measured from count 0 of the servo.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cache
from types import MappingProxyType

from hexwire.errors import RemoteProtocolError, UsageError

from .tables import FIRMWARE, REGISTER_BITS, REGISTER_NOTES, REGISTERS, SERIES, SERIES_CODES, RegisterRow

__all__ = ["Register", "Series"]


_ALIASES_OF = {
    "seven_bot": ("sevenbot", "7bot"),
    "scs": ("scscl",),
    "sts_sms": ("sts", "sms", "sms_sts"),
    "hls": ("hlscl",),
}
"""Aliases of the series: on the vendor's boxes, in its libraries, and common names of the 7Bot's servos."""


@dataclass(frozen=True, slots=True)
class Register:
    """One register of one series.

    Attributes:
        name: Name in the vendor's memory table, or the public library's.
        address: First address.
        size: Bytes, 1 or 2.
        byte_order: "big" or "little".
        sign_bit: Sign-magnitude coding: this bit set means negative. None is unsigned.
        unit: Unit of ``raw * scale``; "count" has its scale in degrees. None for a bare number.
        scale: See unit.
        access: "r" or "rw".
        area: "eeprom", "ram" or "factory".
        minimum: Lowest raw value that the servo accepts; None if unknown.
        maximum: Highest raw value that the servo accepts; None if unknown.
        default: Factory setting, raw; None if unknown or different by model. Public sources disagree: read it.
        bits: Names of single bits.
        note: Further facts.
        si_unit: rad, rad/s, rad/s^2, A, V, degC, s, fraction (1.0 = 100 %), or "" for a bare number.
        si_factor: SI value of one raw step.
    """

    name: str
    address: int
    size: int
    byte_order: str
    sign_bit: int | None
    unit: str | None
    scale: float | None
    access: str
    area: str
    minimum: int | None
    maximum: int | None
    default: int | None
    bits: Mapping[int, str]
    note: str
    si_unit: str
    si_factor: float

    @property
    def fits(self) -> range:
        """Raw values that the coding can express."""
        if self.sign_bit is None:
            return range(1 << (8 * self.size))
        return range(1 - (1 << self.sign_bit), 1 << self.sign_bit)

    def decode(self, data: bytes) -> int:
        """Decode the register's bytes to a signed raw value.

        Raises:
            RemoteProtocolError: The number of bytes is not that of the register.
        """
        if len(data) != self.size:
            raise RemoteProtocolError(f"{self.name} has {self.size} bytes, but {len(data)} arrived")
        if self.size == 1:
            value = data[0]
        else:
            value = data[0] << 8 | data[1] if self.byte_order == "big" else data[1] << 8 | data[0]
        if self.sign_bit is None:
            return value
        magnitude = value & ((1 << self.sign_bit) - 1)
        return -magnitude if value >> self.sign_bit & 1 else magnitude

    def encode(self, value: int) -> bytes:
        """Encode a raw value as bytes.

        Raises:
            UsageError: The value does not fit the coding. The servo's own range is not checked.
        """
        if value not in self.fits:
            low, high = self.fits[0], self.fits[-1]
            raise UsageError(f"{self.name} cannot hold {value}; {low}..{high} fit")
        if value < 0 and self.sign_bit is not None:
            value = -value | 1 << self.sign_bit
        if self.size == 1:
            return bytes((value,))
        return bytes((value >> 8, value & 0xFF) if self.byte_order == "big" else (value & 0xFF, value >> 8))

    def to_si(self, raw: int) -> float:
        """Convert a raw value to the SI value, in `si_unit`."""
        return raw * self.si_factor

    def from_si(self, value: float) -> int:
        """Convert an SI value to the nearest raw value.

        Raises:
            UsageError: The value is not finite or does not fit the coding.
        """
        steps = value / self.si_factor
        if not math.isfinite(steps) or round(steps) not in self.fits:
            low, high = self.to_si(self.fits[0]), self.to_si(self.fits[-1])
            raise UsageError(f"{self.name} cannot hold {value} {self.si_unit}; {low:.6g}..{high:.6g} fit")
        return round(steps)


class Series(Enum):
    """The servo series; the value is the name used in schema, model files and documents."""

    SEVEN_BOT = "seven_bot"
    SCS = "scs"
    STS_SMS = "sts_sms"
    HLS = "hls"

    @classmethod
    def _missing_(cls, value: object) -> Series | None:
        """Accept names from boxes, other libraries and vendors' programs, in upper or lower case."""
        name = str(value).strip().lower().replace("-", "_")
        return next((series for series in cls if name in (series.value, *_ALIASES_OF[series.value])), None)

    @classmethod
    def from_firmware(cls, major: int, minor: int, byte_order: str = "little") -> Series | None:
        """Return the series for registers 0, 1 and 2; None for a series without a table here (SMCL, SCS2).

        Args:
            major: Register 0.
            minor: Register 1.
            byte_order: Selects between two series that share versions (3.20 to 3.39).
        """
        rows = [row for row in FIRMWARE if row.major == major and row.minor_first <= minor <= row.minor_last]
        for row in rows:
            if row.byte_order == byte_order or len(rows) == 1:
                return next((series for series in cls if series.value == row.series), None)
        return None

    @property
    def code(self) -> int:
        """Code in an IDENTIFY reply (u8)."""
        return SERIES_CODES[self.value]

    @property
    def title(self) -> str:
        """Title for display, one line."""
        return SERIES[self.value].title

    @property
    def byte_order(self) -> str:
        """Order of two-byte registers, "big" or "little"."""
        return SERIES[self.value].byte_order

    @property
    def reply_header(self) -> bytes:
        """First two bytes of a status packet."""
        return SERIES[self.value].reply_header

    @property
    def counts_per_rev(self) -> int:
        """Encoder counts over `range_deg`: 4096 per turn, or 1024 over the range of an SCS."""
        return SERIES[self.value].counts

    @property
    def range_deg(self) -> float:
        """Degrees that `counts_per_rev` cover; nominal for SCS."""
        return SERIES[self.value].range_deg

    @property
    def neutral(self) -> int:
        """Count of the middle position."""
        return SERIES[self.value].neutral

    @property
    def baud(self) -> int:
        """Factory setting of the line rate."""
        return SERIES[self.value].baud

    @property
    def baud_codes(self) -> Mapping[int, int]:
        """Line rate by value of register baud_code; empty if the series has no such register."""
        return SERIES[self.value].baud_codes

    @property
    def max_read(self) -> int:
        """Most bytes in the answer to one READ."""
        return SERIES[self._value_].max_read

    @property
    def sync_read(self) -> bool:
        """Whether the series answers SYNC_READ."""
        return SERIES[self.value].sync_read

    @property
    def instructions(self) -> tuple[str, ...]:
        """Names of the instructions that the series supports."""
        return SERIES[self._value_].instructions

    @property
    def registers(self) -> Mapping[str, Register]:
        """All registers by name, in order of address."""
        # `value` is a descriptor written in Python, and every servo packet uses this property.
        return _registers(self._value_)

    def register(self, name: str) -> Register:
        """Return the register with a name.

        Raises:
            UsageError: The series has no such register; the text suggests similar names.
        """
        found = self.registers.get(name)
        if found is None:
            from difflib import get_close_matches

            near = get_close_matches(name, self.registers)
            hint = f"; did you mean {' or '.join(near)}?" if near else ""
            raise UsageError(f"{self.value} servos have no register {name!r}{hint}")
        return found

    def at(self, address: int) -> Register | None:
        """Return the register that starts at an address, or None."""
        return _by_address(self.value).get(address)


@cache
def _registers(series: str) -> Mapping[str, Register]:
    return MappingProxyType({row.name: _make(series, row) for row in REGISTERS[series]})


@cache
def _by_address(series: str) -> Mapping[int, Register]:
    return {register.address: register for register in _registers(series).values()}


def _make(series: str, row: RegisterRow) -> Register:
    common = SERIES[series]
    si_unit, si_factor = _si(row.unit, row.scale, math.radians(common.range_deg / common.counts))
    return Register(
        name=row.name,
        address=row.address,
        size=row.size,
        byte_order=common.byte_order,
        sign_bit=row.sign_bit,
        unit=row.unit,
        scale=row.scale,
        access=row.access,
        area=row.area,
        minimum=row.minimum,
        maximum=row.maximum,
        default=row.default,
        bits=MappingProxyType(REGISTER_BITS[series].get(row.name, {})),
        note=REGISTER_NOTES[series].get(row.name, ""),
        si_unit=si_unit,
        si_factor=si_factor,
    )


def _si(unit: str | None, scale: float | None, radians_per_count: float) -> tuple[str, float]:
    if unit is None or scale is None:
        return "", 1.0
    if unit.startswith("percent"):
        return "fraction", scale / 100
    return {
        "count": ("rad", math.radians(scale)),
        "count/s": ("rad/s", scale * radians_per_count),
        "count/s^2": ("rad/s^2", scale * radians_per_count),
        "ms": ("s", scale / 1000),
        "us": ("s", scale / 1_000_000),
        "mA": ("A", scale / 1000),
        "V": ("V", scale),
        "degC": ("degC", scale),
    }[unit]
