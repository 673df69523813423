"""The kinds of arms, as far as LeRobot asks before an arm is connected.

Owns joint names, servo ids and models. Must not know connections.
"""

from __future__ import annotations

from hexwire.drivers.bus_arm import BusArm
from hexwire.drivers.registry import load_driver
from hexwire.model.arm import ArmModel
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.gripper import jaws_of

__all__ = ["KINDS", "joints_of"]

KINDS = ("so101", "so100", "hex7bot")


def joints_of(kind: str) -> tuple[tuple[str, int, str, bool], ...]:
    """Name, servo id and servo model of each joint, and whether it is the gripper.

    Raises:
        ValueError: There is no such kind.
    """
    model = _model(kind)
    jaws = jaws_of(model)
    servo = "sts3215" if kind.startswith("so") else "seven_bot"
    return tuple(
        (one.name, one.servo_id, servo, jaws is not None and one.name == jaws.joint) for one in model.joints
    )


def _model(kind: str) -> ArmModel:
    if kind not in KINDS:
        raise ValueError(f"no arm {kind!r}; there are {', '.join(KINDS)}")
    if kind == "hex7bot":
        return HEX7BOT
    driver = load_driver(kind)
    assert issubclass(driver, BusArm)
    return driver.described().model
