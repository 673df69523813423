"""Tools at the end of the arm: a gripper, and a suction cup with its pump.

Owns the meaning of the outputs and of the gripper's joint.
"""

from __future__ import annotations

import math

from hexwire.errors import UsageError
from hexwire.model.arm import JointModel
from hexwire.model.gripper import jaws_of
from hexwire.model.state import JointState, JointTarget, SentTarget
from hexwire.wire.command_frame import Command

from .base import RobotDriver

__all__ = ["Gripper", "Suction"]

_PUMP = 0x01
_VALVE = 0x02


class Suction:
    """The pump (pin 40) and valve (pin 36) of the 7Bot's board, through the firmware's IO command.

    Args:
        robot: An attached robot whose board has outputs.
    """

    def __init__(self, robot: RobotDriver) -> None:
        self._robot = robot

    def suck(self) -> None:
        """Switch the pump on and close the valve: the cup holds.

        Raises:
            NotSupportedError: The board speaks dialect 1 and has no such command.
            StoppedError: A stop is latched.
        """
        self._set(_PUMP)

    def release(self) -> None:
        """Switch the pump off and open the valve: air enters and the cup releases. Call `off` afterwards."""
        self._set(_VALVE)

    def off(self) -> None:
        """Switch both off, so that neither heats up."""
        self._set(0)

    def read(self) -> tuple[bool, bool]:
        """Read whether the pump is on, and whether the valve is open."""
        _, value = self._robot.ioctl(Command.IO, bytes((0, 0)))
        return bool(value & _PUMP), bool(value & _VALVE)

    def _set(self, value: int) -> None:
        self._robot.ioctl(Command.IO, bytes((_PUMP | _VALVE, value)))


class Gripper:
    """The gripper of an arm, which one of its joints opens and closes.

    Args:
        robot: An attached robot.
        held: Effort from which a stationary jaw counts as holding something, fraction of full effort.

    Attributes:
        joint: The joint.

    Raises:
        UsageError: The robot has no gripper, or nobody knows which way it opens.
    """

    def __init__(self, robot: RobotDriver, *, held: float = 0.25) -> None:
        jaws = jaws_of(robot.model)
        if jaws is None:
            raise UsageError(
                f"no gripper of {robot.model.name} is known; if it has one, move it by name, as in "
                "`hexwire move NAME=DEGREES`"
            )
        self._robot, self._jaws, self._held = robot, jaws, held
        self.joint: JointModel = robot.model.joint(jaws.joint)

    def move(self, share: float, duration: float = 0.8) -> SentTarget:
        """Move to an opening: 0 is closed, 1 fully open.

        Raises:
            UsageError: The opening is not within 0..1.
            HexwireError: As `RobotDriver.write`.
        """
        return self._robot.write(JointTarget.of({self.joint.name: self.angle(share)}, duration))

    def angle(self, share: float) -> float:
        """Return the angle of the joint for an opening, radians; raises `UsageError` if it is not within 0..1."""
        return self._jaws.angle(share)

    def share(self, state: JointState) -> float:
        """Return the opening: 0 is closed, 1 fully open."""
        return self._jaws.share(state[self.joint.name].position)

    def holds(self, state: JointState, goal: float) -> bool:
        """Whether an object is between the jaws: they press, stand still, and are not at their goal.

        Args:
            state: The state.
            goal: The opening that it was sent to.
        """
        joint = state[self.joint.name]
        short = abs(joint.position - self.angle(goal)) > math.radians(2.0)
        if abs(joint.velocity) > math.radians(3.0):
            return False
        return short and math.isfinite(joint.load) and abs(joint.load) >= self._held

    def grasp(self, state: JointState, squeeze: float = math.radians(3.0)) -> JointTarget:
        """Return the target that holds the object between the jaws with little force."""
        goal = self._jaws.pressed(state[self.joint.name].position, squeeze)
        return JointTarget.of({self.joint.name: goal}, 0.2)

    def keep(self, state: JointState, squeeze: float = math.radians(3.0)) -> SentTarget:
        """Hold the object between the jaws with little force instead of the servo's full force."""
        return self._robot.write(self.grasp(state, squeeze))
