"""`RobotState`: the state of a whole robot in one word, the chapter's ``m_rbtState``.

Owns the states and how they follow from a joint state.
"""

from __future__ import annotations

from enum import IntEnum

from hexwire.model.state import JointFlag, JointState

__all__ = ["RobotState"]

_AT_REST = 0.05
"""Speed up to which a joint counts as standing, rad/s: the noise of one count over a tenth of a second."""
_TORQUE = JointFlag.TORQUE_ON | JointFlag.TORQUE_UNKNOWN


class RobotState(IntEnum):
    """The state of a robot. Where several fit, the first of STOPPED, FAULT, MAINTENANCE, MOVING counts."""

    DETACHED = 0
    """This program has no connection."""
    LOST = 1
    """The connection is open, but the robot does not answer."""
    LIMP = 2
    """No joint has torque."""
    HOLDING = 3
    """A joint has torque, or may have it, and none is known to turn."""
    MOVING = 4
    """A joint turns."""
    STOPPED = 5
    """A stop is latched: nothing moves until `RobotDriver.resume`."""
    FAULT = 6
    """A servo reports a fault or does not answer."""
    MAINTENANCE = 7
    """Settings of servos may be written, and nothing moves."""

    @classmethod
    def of(cls, state: JointState) -> RobotState:
        """The state of a robot whose joints are in this state."""
        if state.stopped:
            return cls.STOPPED
        if any(JointFlag(flags).faults for flags in state.flags):
            return cls.FAULT
        if state.maintenance:
            return cls.MAINTENANCE
        if any(abs(speed) > _AT_REST for speed in state.velocity):
            return cls.MOVING
        return cls.HOLDING if any(flags & _TORQUE for flags in state.flags) else cls.LIMP
