"""A single target as a path, for a robot that follows one in its own time.

Owns when a target becomes a path, its shape, and what counts as sent. Must not know who moves, nor how a path is
sent.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from hexwire.model.state import JointTarget, SentTarget
from hexwire.motion.limits import resting_inside, smooth_duration
from hexwire.motion.waypoints import Spline, Waypoint

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.state import JointState

__all__ = ["apart", "path_to", "sent_as"]

_BRIEF = 0.05
"""Seconds; a shorter motion is one target."""
_MOVING = math.radians(20.0)
"""Radians per second; a faster joint is turning, and a path begins at rest. Flicker by a count is slower."""
_POINTS = 12
"""Parts of a path: enough for a twentieth of a count over half a turn, and few enough to fit on any board."""
_LONGEST = 6.0
"""Most seconds between two points; a board takes 6.5."""
_TICK = 1e-4
"""Seconds, of which the times of points are multiples."""


def path_to(robot: RobotDriver, target: JointTarget, state: JointState) -> Spline | None:
    """The way from rest to rest, all joints together, with limited jerk.

    Args:
        robot: Attached; it keeps the time of a path.
        target: Checked, with the arm's own names.
        state: Just read.

    Returns:
        The path; None if the target itself must be sent: a joint is turning, or its position is unknown.
    """
    names, goal = tuple([name for name, _ in target.positions]), tuple([angle for _, angle in target.positions])
    here = resting_inside(robot.model, {name: state[name].position for name in names})
    duration = max(target.duration, smooth_duration(robot.model, here, dict(target.positions)))
    unknown = not all(map(math.isfinite, here.values()))
    if unknown or duration < _BRIEF or any(abs(state[name].velocity) > _MOVING for name in names):
        return None
    rest = (0.0,) * len(names)
    start = tuple([here[name] for name in names])
    return Spline(names, [Waypoint(0.0, start, rest, rest), Waypoint(duration, goal, rest, rest)])


def apart(path: Spline) -> float:
    """Seconds between two points of such a path."""
    parts = max(_POINTS, math.ceil(path.duration / _LONGEST))
    # In whole ticks, and not more: the last part may be longer, but would be twice as long if it were shorter.
    return math.floor(path.duration / parts / _TICK) * _TICK


def sent_as(robot: RobotDriver, path: Spline) -> SentTarget:
    """What the servos are sent at its end: whole counts."""
    joints = [robot.model.joint(name) for name in path.names]
    rows = zip(joints, path.goal, strict=True)
    goal = tuple([(joint.name, joint.counts_to_angle(joint.angle_to_counts(angle))) for joint, angle in rows])
    return SentTarget(goal, path.duration)
