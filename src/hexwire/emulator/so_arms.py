"""The servos of an SO-100 or SO-101 arm as its makers assemble it, not calibrated.

Owns which servos it has, how their horns are mounted, the mechanical stops and the weight on each joint. Joint
angle 0 is the middle of the range, as in the public URDF of the SO-101; angles grow with the counts. Knows no bus.

Sources: ids, servo models and gear ratios (1:345 in a follower; 1:191, 1:345, 1:191 and 1:147 three times in a
leader) from the makers' bill of materials; ranges from the URDF `so101_new_calib` of TheRobotStudio/SO-ARM100; that
the stops lie 5 degrees further out is assumed. The wrist turns without end: only its cable limits it. An SO-100 has
the same servos and a range of the elbow that is a little smaller.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass

from hexwire.model.arm import ArmModel, JointModel
from hexwire.wire.registers import Series

from .servo import EmulatedServo
from .servo_control import MECHANICS
from .servo_motion import Mechanics

__all__ = ["SO_ARMS", "SoArm", "make_so_arm"]

SO_ARMS = ("so100", "so101")
"""Names of the arms."""

_DEGREE = 4096 / 360
_MIDDLE = 2048
_BEYOND = 5.0
"""Degrees from the end of a joint's range to its mechanical stop."""
_TOOTH = 360 / 25
"""Degrees between two teeth of a horn: it is mounted at the nearest one."""
_GEARS = 345


@dataclass(frozen=True, slots=True)
class _Joint:
    name: str
    low: float
    high: float
    start: float
    leader_gears: int
    weight: float = 0.0
    """Greatest torque of gravity on a follower's joint, as a share of its stall torque."""
    upright: bool = False
    """Angle 0 points upward, not forward."""


# At the start the arm is folded, as it is put down before it is switched on.
_JOINTS = (
    _Joint("shoulder_pan", -110.0, 110.0, 0.0, 191),
    _Joint("shoulder_lift", -100.0, 100.0, -95.0, 345, 0.12, upright=True),
    _Joint("elbow_flex", -96.8, 96.8, 90.0, 191, 0.1),
    _Joint("wrist_flex", -95.0, 95.0, 50.0, 147, 0.04),
    _Joint("wrist_roll", -157.2, 162.8, 0.0, 147),
    _Joint("gripper", -10.0, 100.0, 0.0, 147),
)
_SO100_ELBOW = 90.0


@dataclass(frozen=True, slots=True)
class SoArm:
    """An emulated arm.

    Attributes:
        model: Its joints: where each servo's horn is, and the angles of the mechanical stops as limits; a joint
            without stops has limits of a whole turn to either side.
        servos: Its servos, torque off.
    """

    model: ArmModel
    servos: list[EmulatedServo]


def make_so_arm(
    name: str, *, leader: bool = False, any_horns: bool = False, seed: int = 0, start: float = 0.0
) -> SoArm:
    """Make an arm, folded and without torque.

    Args:
        name: One of `SO_ARMS`.
        leader: With the gears of a leader arm, which a hand moves easily.
        any_horns: Every horn is mounted anywhere in the turn, as by somebody who did not centre the servos first.
        seed: Seed of the horns' positions and of the servos' noise.
        start: The time of power-up.
    """
    draw = random.Random(f"{name} {seed}")
    joints, servos = [], []
    for servo_id, joint in enumerate(_JOINTS, 1):
        elbow = joint.name == "elbow_flex" and name == "so100"
        low, high = (-_SO100_ELBOW, _SO100_ELBOW) if elbow else (joint.low, joint.high)
        start_at = min(joint.start, high - 1.0)
        endless = joint.name == "wrist_roll"
        horn = draw.uniform(0, 4095) if any_horns else _MIDDLE + draw.uniform(-0.5, 0.5) * _TOOTH * _DEGREE
        middle = round(horn)
        # The encoder counts within one turn at power-up.
        turn = (middle + start_at * _DEGREE) // 4096 * 4096
        middle -= round(turn)
        stops = None if endless else (middle + (low - _BEYOND) * _DEGREE, middle + (high + _BEYOND) * _DEGREE)
        ratio = joint.leader_gears / _GEARS if leader else 1.0
        servos.append(
            EmulatedServo(
                Series.STS_SMS,
                servo_id,
                position=middle + start_at * _DEGREE,
                seed=seed * 256 + servo_id,
                gravity=_gravity(joint, middle, ratio) if joint.weight else None,
                mechanics=_geared(MECHANICS[Series.STS_SMS], ratio),
                stops=stops,
                start=start,
            )
        )
        ends = (-360.0, 360.0) if endless else (low - _BEYOND, high + _BEYOND)
        joints.append(
            JointModel(
                name=joint.name,
                servo_id=servo_id,
                series=Series.STS_SMS.value,
                neutral=middle,
                sign=1,
                offset=0.0,
                scale=math.tau / 4096,
                minimum=math.radians(ends[0]),
                maximum=math.radians(ends[1]),
                max_speed=math.radians(180.0),
            )
        )
    return SoArm(ArmModel(name, tuple(joints)), servos)


def _geared(of_all: Mechanics, ratio: float) -> Mechanics:
    """A motor behind other gears; its torques are shares of its own, smaller stall torque."""
    return Mechanics(
        of_all.max_speed / ratio,
        of_all.max_acceleration,
        of_all.full_acceleration / ratio,
        friction=of_all.friction,
        # Gears of a smaller ratio are easier to turn from outside.
        holding_friction=of_all.holding_friction * ratio,
        stall_current=of_all.stall_current,
        nominal_voltage=of_all.nominal_voltage,
    )


def _gravity(joint: _Joint, middle: int, ratio: float) -> Callable[[float], float]:
    """Gravity on a joint, which leans forward and down at positive angles; the gears hold it without power."""
    weight = joint.weight * ratio
    turn = math.sin if joint.upright else math.cos
    return lambda shaft: weight * turn((shaft - middle) / _DEGREE * math.pi / 180)
