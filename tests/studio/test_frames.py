"""Frames of state: every value at its place, unknown ones as NaN."""

from __future__ import annotations

import math
import struct

from hexwire.model.state import JointFlag, JointState
from hexwire.studio.frames import VERSION, FrameBit, serialize_frame


def test_every_value_stands_at_its_place() -> None:
    rows = [(10.0 * column + 1.0, 10.0 * column + 2.0) for column in range(6)]
    flags = (int(JointFlag.TORQUE_ON), int(JointFlag.SILENT))
    position, velocity, load, current, voltage, temperature = rows
    state = JointState(
        names=("a", "b"),
        position=position,
        velocity=velocity,
        load=load,
        current=current,
        voltage=voltage,
        temperature=temperature,
        flags=flags,
        age=(0.5, math.inf),
        stamp=7.25,
    )
    data = serialize_frame(state, {"b": -1.5}, FrameBit.KNOWN | FrameBit.STOPPED, 3)
    assert struct.unpack_from("<BBHId", data) == (VERSION, 2, 9, 3, 7.25)
    values = struct.unpack_from("<14f2H", data, 16)
    assert values[:12] == tuple(value for row in rows for value in row)
    assert math.isnan(values[12])
    assert values[13] == -1.5
    assert values[14:] == flags
    assert len(data) == 16 + 2 * 30
