"""hexwire: from a joint command in Python to a moving servo, and back.

Owns the public names, which load on first use: ``import hexwire`` costs next to nothing and imports neither a
third-party package nor a layer that the program does not touch. Knows where each name lives, and the environment
variable that switches verbose mode on for the whole program; nothing else.

Attributes:
    __version__: Version of the installed package, as in ``0.1.0``.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from hexwire.errors import (
    DeviceError,
    GoalError,
    HexwireError,
    LeaseError,
    LimitError,
    LinkError,
    ReplyTimeoutError,
    ServoError,
    StoppedError,
    UsageError,
)

if TYPE_CHECKING:
    # Re-exported for type checkers and editors; at run time `__getattr__` below does it. Keep both alike.
    from hexwire.arm.blocks import Lesson, Recording
    from hexwire.arm.handle import Handle, MotionHandle
    from hexwire.arm.poses import Poses
    from hexwire.arm.verbs import Arm, connect
    from hexwire.bus.servo_bus import ServoBus
    from hexwire.control.motion.motion_result import MotionResult
    from hexwire.control.motion.rest import Rest
    from hexwire.control.motion.via import Place
    from hexwire.drivers.base import RobotDriver, Signal, StopMode
    from hexwire.drivers.bus_arm import BusArm
    from hexwire.drivers.hex7bot import Hex7BotDriver
    from hexwire.drivers.plain import PlainDriver
    from hexwire.drivers.robot_state import RobotState
    from hexwire.ipc.handle import IpcHandle
    from hexwire.ipc.session import Session
    from hexwire.model.aim import Tip
    from hexwire.model.arm import ArmModel, JointModel
    from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
    from hexwire.model.arms.puma260.kinematics import Puma260Model
    from hexwire.model.picture import Picture
    from hexwire.model.state import JointFlag, JointState, JointTarget, NewestState, SentTarget
    from hexwire.motion.teach import Taught
    from hexwire.motion.trajectory import Trajectory
    from hexwire.ros2 import ros_node
    from hexwire.units import deg, mm
    from hexwire.wire.modules import ModuleType

    __version__: str

__all__ = [
    "Arm",
    "ArmModel",
    "BusArm",
    "DeviceError",
    "GoalError",
    "Handle",
    "Hex7BotDriver",
    "Hex7BotModel",
    "HexwireError",
    "IpcHandle",
    "JointFlag",
    "JointModel",
    "JointState",
    "JointTarget",
    "LeaseError",
    "Lesson",
    "LimitError",
    "LinkError",
    "ModuleType",
    "MotionHandle",
    "MotionResult",
    "NewestState",
    "Picture",
    "Place",
    "PlainDriver",
    "Poses",
    "Puma260Model",
    "Recording",
    "ReplyTimeoutError",
    "Rest",
    "RobotDriver",
    "RobotState",
    "SentTarget",
    "ServoBus",
    "ServoError",
    "Session",
    "Signal",
    "StopMode",
    "StoppedError",
    "Taught",
    "Tip",
    "Trajectory",
    "UsageError",
    "__version__",
    "connect",
    "deg",
    "mm",
    "ros_node",
]

_LAZY: dict[str, str] = {
    "MotionResult": "hexwire.control.motion.motion_result",
    "MotionHandle": "hexwire.arm.handle",
    "Handle": "hexwire.arm.handle",
    "Lesson": "hexwire.arm.blocks",
    "Recording": "hexwire.arm.blocks",
    "Poses": "hexwire.arm.poses",
    "Rest": "hexwire.control.motion.rest",
    "JointModel": "hexwire.model.arm",
    "JointFlag": "hexwire.model.state",
    "Place": "hexwire.control.motion.via",
    "Trajectory": "hexwire.motion.trajectory",
    "Picture": "hexwire.model.picture",
    "Arm": "hexwire.arm.verbs",
    "ArmModel": "hexwire.model.arm",
    "BusArm": "hexwire.drivers.bus_arm",
    "Hex7BotDriver": "hexwire.drivers.hex7bot",
    "Hex7BotModel": "hexwire.model.arms.hex7bot.kinematics",
    "IpcHandle": "hexwire.ipc.handle",
    "JointState": "hexwire.model.state",
    "JointTarget": "hexwire.model.state",
    "ModuleType": "hexwire.wire.modules",
    "PlainDriver": "hexwire.drivers.plain",
    "Puma260Model": "hexwire.model.arms.puma260.kinematics",
    "RobotDriver": "hexwire.drivers.base",
    "RobotState": "hexwire.drivers.robot_state",
    "NewestState": "hexwire.model.state",
    "SentTarget": "hexwire.model.state",
    "ServoBus": "hexwire.bus.servo_bus",
    "Session": "hexwire.ipc.session",
    "Signal": "hexwire.drivers.base",
    "StopMode": "hexwire.drivers.base",
    "Taught": "hexwire.motion.teach",
    "Tip": "hexwire.model.aim",
    "connect": "hexwire.arm.verbs",
    "deg": "hexwire.units",
    "mm": "hexwire.units",
    "ros_node": "hexwire.ros2",
}
"""Public name -> module that defines it."""


if not TYPE_CHECKING:  # a type checker would take any name for an object then, a misspelt one too

    def __getattr__(name: str) -> object:
        """Import a public name on its first use (PEP 562)."""
        if name == "__version__":
            from importlib.metadata import version

            value = version("hexwire")
        elif name in _LAZY:
            from importlib import import_module

            value = getattr(import_module(_LAZY[name]), name)
        else:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


if "HEXWIRE_TRACE" in os.environ:
    from hexwire.trace.live import trace_this_process

    trace_this_process()
