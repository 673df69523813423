"""The jaws of a gripper on their way: alone, or while the arm moves.

Owns when they hold an object, and how near to their goal they have arrived.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from .arrival import Tolerance
from .goals import Point, TrajectoryGoal

if TYPE_CHECKING:
    from hexwire.drivers.tools import Gripper
    from hexwire.model.arm import JointModel
    from hexwire.model.state import JointState

    from ..loop.controller import TrajectoryController

__all__ = ["GRACE", "MOST_SECONDS", "Closing", "jaw_tolerance", "relieved"]

MOST_SECONDS = 0.8
"""Seconds from closed to open."""
GRACE = 0.5
"""Seconds after that in which they must arrive."""
_NEAR = 0.1
"""Position tolerance as a fraction of their range."""
_STANDS = math.radians(3.0)
"""Radians per second below which they count as stopped."""
_PRESSED = 3
_PRESSING = 0.1
"""Successive states and seconds in which the jaws press: the start of the motion takes effort too."""
_STILL = math.radians(0.3)
"""How far the jaws may move meanwhile: a board's states need not have a velocity that would show it."""

_UNHURRIED = 3.0
"""The time of a relief over the shortest at the greatest speed: it begins while the joint is planned to close."""


def jaw_tolerance(joint: JointModel) -> Tolerance:
    """How near to its goal, and how still, the joint of a gripper counts as arrived."""
    return Tolerance(_NEAR * (joint.maximum - joint.minimum), _STANDS)


class Closing:
    """Whether jaws on their way to an opening hold an object; jaws that open hold none.

    Args:
        gripper: The gripper.
        opening: Where they are sent: 0 is closed, 1 fully open.
        state: Where they are now.

    Attributes:
        gripper: The gripper.
        holds: They do.
    """

    def __init__(self, gripper: Gripper, opening: float, state: JointState) -> None:
        self.gripper, self._opening = gripper, opening
        self._closing = opening < gripper.share(state)
        # Successive states in which the jaws pressed, the time of the first, and where that was.
        self._pressed, self._since, self._at = 0, 0.0, math.nan
        self.holds = False

    def see(self, state: JointState) -> bool:
        """Take the next state; true for the one that shows that they hold an object."""
        if not self._closing or self.holds:
            return False
        if not self.gripper.holds(state, self._opening):
            self._pressed = 0
            return False
        at = state[self.gripper.joint.name].position
        if not self._pressed or abs(at - self._at) > _STILL:
            self._pressed, self._since, self._at = 0, state.stamp, at
        self._pressed += 1
        self.holds = self._pressed >= _PRESSED and state.stamp - self._since >= _PRESSING
        return self.holds


def relieved(gripper: Gripper, controller: TrajectoryController, state: JointState, now: float) -> TrajectoryGoal:
    """The goal with which jaws that have met an object hold it with little force.

    Args:
        gripper: The gripper.
        controller: Moves its joint, among others; the caller has the controllers' lock.
        state: Where the jaws are.
        now: Seconds.
    """
    target, joint = gripper.grasp(state), gripper.joint
    here = dict(zip(controller.joints, controller.start(0.0, state, now).position, strict=True))
    # The time of the point counts from now, and the robot may have what comes before that.
    wait = max(0.0, controller.generator.next_start(now) - now)
    goal = here | dict(target.positions)
    seconds = wait + max(target.duration, _UNHURRIED * abs(goal[joint.name] - here[joint.name]) / joint.max_speed)
    rest = (0.0,) * len(goal)
    point = Point(seconds, tuple(goal.values()), rest, rest)
    return TrajectoryGoal(controller.joints, (point,), gives_way=True)
