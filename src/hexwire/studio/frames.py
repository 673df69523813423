"""A frame of state as bytes, for the browser: what is drawn at frame rate.

Owns the layout, which `static/live.js` reads. Pure. Must not know sockets, pages or robots.

Little-endian. Head: version (u8), number of joints (u8), bits of `FrameBit` (u16), number of the last stop (u32),
time of the sample in seconds of the server's clock (f64). Then eight columns, each with a value per joint:
position, velocity, load, current, voltage, temperature, goal (f32 each), flags (u16). Unknown values are NaN. That
the sample of a joint is too old is among its flags: it is silent.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from enum import IntFlag
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hexwire.model.state import JointState

__all__ = ["VERSION", "FrameBit", "serialize_frame"]

VERSION = 2
_HEAD = struct.Struct("<BBHId")


class FrameBit(IntFlag):
    """What is true of the whole arm."""

    STOPPED = 1
    WATCHDOG_TRIPPED = 2
    MAINTENANCE = 4
    KNOWN = 8
    """What it says is from now."""
    HELD = 16
    """Somebody holds a motion."""


def serialize_frame(state: JointState, goals: Mapping[str, float], bits: FrameBit, stops: int) -> bytes:
    """Make the bytes of a frame.

    Args:
        state: The state.
        goals: The last set-point of each joint, radians; those that are missing are unknown.
        bits: What is true of the whole arm.
        stops: Number of the last stop; a page sends it back with an order, so that one from before a stop is void.
    """
    n = len(state.names)
    head = _HEAD.pack(VERSION, n, int(bits), stops & 0xFFFFFFFF, state.stamp)
    aims = [goals.get(name, math.nan) for name in state.names]
    values = (
        *state.position,
        *state.velocity,
        *state.load,
        *state.current,
        *state.voltage,
        *state.temperature,
        *aims,
    )
    return head + struct.pack(f"<{7 * n}f{n}H", *values, *(int(flags) for flags in state.flags))
