"""Opens and closes a gripper: closing ends when the jaws hold an object, and keeps a little pressure on it.

Owns when a gripper has arrived, and when it holds something. Must not know how a person asks for it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hexwire.drivers.tools import Gripper
from hexwire.model.state import JointTarget

from . import motions

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.epochs import Token
    from hexwire.model.state import JointState

    from .motion_options import MotionObserver
    from .motion_result import MotionResult

__all__ = ["GripResult", "run_grip"]

_GRACE = 0.5
"""Seconds after the duration in which the gripper must arrive."""
_NEAR = 0.1
"""Position tolerance as a fraction of its range."""
_STANDS = math.radians(3.0)
"""Radians per second below which it counts as stopped."""
_PRESSED = 3
"""Consecutive states with pressure but no motion that mean an object is held."""


@dataclass(frozen=True, slots=True)
class GripResult:
    """How a gripper's motion ended.

    Attributes:
        opening: How far it is open: 0 is closed, 1 fully open; NaN if its position is unknown.
        holds: There is an object between the jaws.
        motion: The motion.
    """

    opening: float
    holds: bool
    motion: MotionResult


def run_grip(
    robot: RobotDriver,
    opening: float,
    duration: float = 0.8,
    *,
    force: float = 0.25,
    observer: MotionObserver | None = None,
    cancelled: Callable[[], bool] = lambda: False,
    asked: Token | None = None,
) -> GripResult:
    """Move the gripper to an opening; see `run_motion` for what else is done.

    Args:
        robot: Attached.
        opening: 0 is closed, 1 fully open.
        duration: Seconds from closed to open.
        force: Effort from which a stationary jaw counts as holding something, fraction of full effort.
        observer: Is called at the events of the motion.
        cancelled: Whether it is to end now.
        asked: As in `run_motion`.

    Raises:
        UsageError: The robot has no gripper, or the opening is not within 0..1.
        HexwireError: As `run_motion`.
    """
    gripper = Gripper(robot, held=force)
    joint = gripper.joint
    target = JointTarget.of({joint.name: gripper.angle(opening)}, duration)
    pressed, holding = 0, False
    closing = opening < gripper.share(robot.read())

    def until(state: JointState) -> bool | JointTarget:
        nonlocal pressed, holding
        # A single state may be the start of the motion, which takes effort too.
        pressed = pressed + 1 if closing and gripper.holds(state, opening) else 0
        if pressed >= _PRESSED:
            holding = True
            return gripper.grasp(state)
        return cancelled()

    near = _NEAR * (joint.maximum - joint.minimum)
    how = motions.MotionOptions(tolerance=near, standing=_STANDS, grace=_GRACE, early=False)
    result = motions.run_motion(robot, target, how, until=until, observer=observer, asked=asked)
    found = math.nan if result.state is None else gripper.share(result.state)
    return GripResult(found, holding, result)
