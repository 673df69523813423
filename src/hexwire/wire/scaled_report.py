"""JOINT_STATE bodies straight to scaled columns: the one body that is read a hundred times a second and more.

Owns the shortcut that unpacks and scales a whole report in one pass. It gives what `JointReport.parse` gives, times
the factors; a body of any other shape is left to that. Knows no unit: factors are the caller's.
"""

from __future__ import annotations

import struct
from operator import mul

from .commands import ALL_FIELDS

__all__ = ["ReportScaler"]

_HEAD = "<IBBBB"
_ROW = "hBhhBbhH"
_HEAD_VALUES, _ROW_VALUES = 5, 8
_Column = tuple[float, ...]


class ReportScaler:
    """Reads JOINT_STATE bodies that hold every field of a known number of joints.

    Args:
        speed: Factor a joint; so for the others. Positions and status are not scaled.
        load: Of the load.
        voltage: Of the supply.
        temperature: Of the temperature.
        current: Of the current.
        age: One factor for all ages.
    """

    def __init__(
        self, *, speed: _Column, load: _Column, voltage: _Column, temperature: _Column, current: _Column, age: float
    ) -> None:
        self.joints = len(speed)
        self._struct = struct.Struct(_HEAD + _ROW * self.joints)
        self.size = self._struct.size
        rows = zip(speed, load, voltage, temperature, current, strict=True)
        self._factors: _Column = (1,) * _HEAD_VALUES + tuple(
            factor for s, lo, v, t, c in rows for factor in (1, 1, s, lo, v, t, c, age)
        )

    def parse(self, body: bytes) -> tuple[int, int, tuple[tuple[float, ...], ...]] | None:
        """Read a body.

        Returns:
            time_us, board flags, and the columns position, status, speed, load, voltage, temperature, current and
            age; or None if the body has another shape, for `JointReport.parse` to judge.
        """
        if len(body) != self.size:
            return None
        raw = self._struct.unpack(body)
        if raw[1] != ALL_FIELDS or raw[3] != self.joints:
            return None
        scaled = tuple(map(mul, raw, self._factors))
        return (
            raw[0],
            raw[2],
            (
                raw[5::8],
                raw[6::8],
                scaled[7::8],
                scaled[8::8],
                scaled[9::8],
                scaled[10::8],
                scaled[11::8],
                scaled[12::8],
            ),
        )
