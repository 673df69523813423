"""Ready-made sets of emulated servos.

Owns which servos an arm has and their positions at power-up. Knows no board.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.wire.registers import Series

from .servo import EmulatedServo

__all__ = ["HEX7BOT_START", "make_hex7bot_servos"]

HEX7BOT_START = (2053, 2043, 2035, 2039, 2083, 2046, 2047)
"""Counts of servos 0..6 that give the joint angles printed in the chapter's log (J7 is not printed)."""

_BEYOND = (5.0,) * 6 + (30.0,)
"""Degrees from a joint's limits to its mechanical stops: assumed. The travel of the gripper is not known either."""
_BAUD_115200 = 4  # the chapter's bus; an HLS servo leaves the factory at 1 Mbaud
_IDLE_LOAD_6 = 52  # in the same log: load of id 6 with nothing moving


def _arm(weight: float, horizontal: float) -> Callable[[float], float]:
    """Gravity on a link, with its maximum where the servo is at `horizontal` counts."""
    return lambda shaft: -weight * math.cos((shaft - horizontal) * math.tau / 4096)


# Fractions of the stall torque: a small arm, light enough that its gears hold it without power.
_GRAVITY: dict[int, Callable[[float], float]] = {
    1: _arm(0.12, 1024),
    2: _arm(0.10, 2047),
    4: _arm(0.05, 2047),
}


def make_hex7bot_servos(*, seed: int = 0, start: float = 0.0) -> list[EmulatedServo]:
    """The seven servos of a Hex7Bot: ids 0..3 legacy, 4..6 HLS at 115200 baud, torque off, with the arm's stops.

    Args:
        seed: Seed of the servos' noise.
        start: The time of power-up.
    """
    servos = []
    for servo_id, position in enumerate(HEX7BOT_START):
        legacy, joint = servo_id < 4, HEX7BOT.joints[servo_id]
        beyond = math.radians(_BEYOND[servo_id])
        low, high = (joint.angle_to_counts(end) for end in (joint.minimum - beyond, joint.maximum + beyond))
        servos.append(
            EmulatedServo(
                Series.SEVEN_BOT if legacy else Series.HLS,
                servo_id,
                position=position,
                seed=seed * 256 + servo_id,
                settings=None if legacy else {"baud_code": _BAUD_115200},
                gravity=_GRAVITY.get(servo_id),
                idle_load=_IDLE_LOAD_6 if servo_id == 6 else 0,
                stops=(low, high),
                start=start,
            )
        )
    return servos
