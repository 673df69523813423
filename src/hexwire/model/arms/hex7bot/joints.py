"""The Hex7Bot: six joints and a gripper on seven bus servos.

Owns the constants of this arm and the source of each. Must not know its kinematics.
"""

from __future__ import annotations

import math

from hexwire.model.arm import ArmModel, JointModel
from hexwire.units import CHAPTER_RADIANS_PER_COUNT

__all__ = ["HEX7BOT"]

NEUTRAL = 2047
"""Count of the neutral pose; no other value fits the chapter's J1 (2053 read, -4.47257 deg printed)."""


def _joint(
    name: str, servo_id: int, offset: float, low_deg: float, high_deg: float, max_speed: float
) -> JointModel:
    series = "seven_bot" if servo_id < 4 else "hls"
    return JointModel(
        name=name,
        servo_id=servo_id,
        series=series,
        neutral=NEUTRAL,
        sign=1,
        offset=offset,
        scale=CHAPTER_RADIANS_PER_COUNT,
        minimum=offset + math.radians(low_deg),
        maximum=offset + math.radians(high_deg),
        max_speed=max_speed,
    )


HEX7BOT = ArmModel(
    "hex7bot",
    (
        # Offsets: from the angles printed in the chapter's log, which differ from these by whole counts. Signs:
        # only J1's can be recovered from the log; the others are assumed to be the same.
        # Ranges about neutral: the bus-servo version of the 7Bot library, 10..170, 10..180, 10..170, 0..180,
        # 0..180 and 0..360 deg with neutral at 90; J6 ends at the end of an encoder turn. The gripper's travel is
        # the first 7Bot's 90 deg, centred on neutral because this arm's travel is not published.
        _joint("J1", 0, -0.087265, -80.0, 80.0, 2.6),
        _joint("J2", 1, 0.95993, -80.0, 90.0, 2.6),
        _joint("J3", 2, -0.04363, -80.0, 80.0, 2.6),
        _joint("J4", 3, 0.0, -90.0, 90.0, 2.6),
        _joint("J5", 4, 0.0, -90.0, 90.0, 3.5),
        _joint("J6", 5, 0.0, -90.0, 179.0, 3.5),
        _joint("J7", 6, 0.0, -45.0, 45.0, 3.5),
    ),
)
"""The arm with seven servos."""
