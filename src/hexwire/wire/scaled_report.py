"""JOINT_STATE bodies to scaled columns in one pass, since this body is parsed a hundred or more times per second.

Owns the fast path that unpacks and scales a whole report. The result is that of `JointReport.parse` times the
factors; bodies of another shape need `JointReport.parse`. Knows no units: the factors are the caller's.
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
    """Parser of JOINT_STATE bodies that hold every field of a known number of joints.

    Positions and status are not scaled.

    Args:
        speed: Factors of the speeds, one per joint.
        load: Factors of the loads, one per joint.
        voltage: Factors of the supply voltages, one per joint.
        temperature: Factors of the temperatures, one per joint.
        current: Factors of the currents, one per joint.
        age: Factor of all ages.
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
        """Parse a body.

        Returns:
            time_us, board flags, and the columns position, status, speed, load, voltage, temperature, current and
            age; or None if the body has another shape, which `JointReport.parse` handles.
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
