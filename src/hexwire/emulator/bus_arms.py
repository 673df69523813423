"""The servos of arms: of the Hex7Bot, and of an arm that a person assembles, such as an SO-101, not calibrated yet.

Owns which servos an arm has and their positions at power-up, how horns are mounted, the mechanical stops and the
weight on each joint; the arm's record says of which joints. Joint angle 0 of an assembled arm is the middle of the
range; angles grow with the counts. Knows no bus and no board.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass

from hexwire.errors import UsageError
from hexwire.model.arm import ArmModel, JointModel
from hexwire.model.arms import AssemblyJoint, arm_record
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.wire.registers import Series

from .servo import EmulatedServo
from .servo_control import MECHANICS
from .servo_motion import Mechanics

__all__ = ["HEX7BOT_START", "EmulatedArm", "make_bus_arm", "make_hex7bot_servos"]

HEX7BOT_START = (2053, 2043, 2035, 2039, 2083, 2046, 2047)
"""Counts of servos 0..6 that give the joint angles printed in the chapter's log (J7 is not printed)."""

_HEX7BOT_BEYOND = (5.0,) * 6 + (30.0,)
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
        beyond = math.radians(_HEX7BOT_BEYOND[servo_id])
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


_DEGREE = 4096 / 360
_MIDDLE = 2048
_BEYOND = 5.0
"""Degrees from the end of a joint's range to its mechanical stop."""
_TOOTH = 360 / 25
"""Degrees between two teeth of a horn: it is mounted at the nearest one."""


@dataclass(frozen=True, slots=True)
class EmulatedArm:
    """An emulated arm.

    Attributes:
        model: Its joints: where each servo's horn is, and the angles of the mechanical stops as limits; a joint
            without stops has limits of a whole turn to either side.
        servos: Its servos, torque off.
    """

    model: ArmModel
    servos: list[EmulatedServo]


def make_bus_arm(
    name: str, *, leader: bool = False, any_horns: bool = False, seed: int = 0, start: float = 0.0
) -> EmulatedArm:
    """Make an arm, as it is put down and without torque.

    Args:
        name: Name of an arm whose record has an assembly.
        leader: With the gears of a leader arm, which a hand moves easily.
        any_horns: Every horn is mounted anywhere in the turn, as by somebody who did not centre the servos first.
        seed: Seed of the horns' positions and of the servos' noise.
        start: The time of power-up.

    Raises:
        UsageError: There is no such arm.
    """
    assembly = arm_record(name).assembly
    if assembly is None:
        raise UsageError(f"nobody has said how an arm {name!r} is assembled: it cannot be emulated")
    draw = random.Random(f"{name} {seed}")
    joints, servos = [], []
    for servo_id, joint in enumerate(assembly.joints, 1):
        low, high, endless = joint.low, joint.high, joint.endless
        start_at = min(joint.start, high - 1.0)
        horn = draw.uniform(0, 4095) if any_horns else _MIDDLE + draw.uniform(-0.5, 0.5) * _TOOTH * _DEGREE
        middle = round(horn)
        # The encoder counts within one turn at power-up.
        turn = (middle + start_at * _DEGREE) // 4096 * 4096
        middle -= round(turn)
        stops = None if endless else (middle + (low - _BEYOND) * _DEGREE, middle + (high + _BEYOND) * _DEGREE)
        ratio = joint.leader_gears / assembly.gears if leader and joint.leader_gears else 1.0
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
    return EmulatedArm(ArmModel(name, tuple(joints)), servos)


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


def _gravity(joint: AssemblyJoint, middle: int, ratio: float) -> Callable[[float], float]:
    """Gravity on a joint, which leans forward and down at positive angles; the gears hold it without power."""
    weight = joint.weight * ratio
    turn = math.sin if joint.upright else math.cos
    return lambda shaft: weight * turn((shaft - middle) / _DEGREE * math.pi / 180)
