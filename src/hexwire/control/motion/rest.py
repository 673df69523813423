"""Whether an arm is at rest, and where it came to rest after a motion, beside where it should be.

Owns how long to wait until it is at rest, and the distance of joints and tip.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hexwire.model.state import JointFlag

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.state import JointState

__all__ = ["Rest", "come_to_rest", "rest_in_words"]

_SETTLES, _LOOK, _STILL = 0.6, 0.05, math.radians(0.05)
"""Most seconds until the arm is at rest, seconds between two looks, and radians that it may move between them."""
_SILENT = int(JointFlag.SILENT)


@dataclass(frozen=True, slots=True)
class Rest:
    """How far off its goal an arm came to rest.

    Attributes:
        joint: The worst joint.
        off: Its distance, radians; NaN if its position is unknown.
        tip: Distance of the tip from where the goal would have it, metres; None if it is unknown.
        joints: Distance of each joint, radians, worst first; NaN if its position is unknown.
    """

    joint: str
    off: float
    tip: float | None
    joints: tuple[tuple[str, float], ...] = ()


def come_to_rest(
    robot: RobotDriver,
    goal: Mapping[str, float],
    *,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], object] = time.sleep,
) -> Rest:
    """Wait until the joints do not move any more, at most 0.6 s: they arrive within a tolerance, and settle then.

    Args:
        robot: Attached.
        goal: Radians by joint, at least one.
        clock: Monotonic seconds.
        sleep: Waits for a number of seconds.

    Raises:
        HexwireError: The robot does not answer.
    """
    state, _ = _settle(robot.read, _SETTLES, clock, sleep)
    here = state.positions
    # An unknown position is the worst.
    rows = [(name, abs(here.get(name, math.nan) - angle)) for name, angle in goal.items()]
    rows.sort(key=lambda row: math.inf if math.isnan(row[1]) else row[1], reverse=True)
    joint, off = rows[0]
    tip, kinematics = None, robot.kinematics
    if kinematics is not None and all(math.isfinite(here.get(name, math.nan)) for name in kinematics.joint_names):
        places = [
            kinematics.forward(kinematics.from_joints(angles)).position for angles in (here, {**here, **goal})
        ]
        tip = math.dist(*places)
    return Rest(joint, off, tip, tuple(rows))


def rest_in_words(
    newest: Callable[[], JointState],
    seconds: float,
    *,
    clock: Callable[[], float],
    sleep: Callable[[float], object],
) -> str:
    """Whether the joints are at rest, after a stop: waits until they are.

    Args:
        newest: Returns the newest state.
        seconds: The most to wait.
        clock: Monotonic seconds.
        sleep: Waits for a number of seconds.
    """
    _, moving = _settle(newest, seconds, clock, sleep)
    if moving is None:
        return f"no news of where they are for {seconds:g} s"
    if not moving:
        return "at rest"
    return f"{', '.join(moving)} still {'moves' if len(moving) == 1 else 'move'} after {seconds:g} s"


def _settle(
    look: Callable[[], JointState], seconds: float, clock: Callable[[], float], sleep: Callable[[float], object]
) -> tuple[JointState, tuple[str, ...] | None]:
    """Wait until no joint moves; the last state, and which joints still moved then; None if nothing new came."""
    state = before = look()
    moving: tuple[str, ...] | None = None
    deadline = clock() + seconds
    while clock() < deadline:
        sleep(_LOOK)
        state = look()
        between = _between(before, state)
        # States that were sampled at nearly the same time say nothing: a server that stalled sends several at once.
        if between < 0.5 * _LOOK:
            continue
        most = _STILL * min(1.0, between / _LOOK)
        places = [(i, abs(state.position[i] - before.position[i])) for i in _heard(before, state)]
        moving = tuple([state.names[i] for i, moved in places if not moved < most])
        if not moving:
            break
        before = state
    return state, moving


def _heard(before: JointState, state: JointState) -> list[int]:
    """Indices of the joints to wait for: one that is silent in both states does not say where it is."""
    flags = zip(before.flags, state.flags, strict=True)
    return [i for i, (old, new) in enumerate(flags) if not old & new & _SILENT]


def _between(before: JointState, state: JointState) -> float:
    """Least seconds between two samples of a joint; 0 if one of them has no new sample."""
    ages = [(before.age[i], state.age[i]) for i in _heard(before, state)]
    # Not every robot knows its ages. A joint that was never sampled has an infinite one, which gives NaN.
    least = [(state.stamp - new) - (before.stamp - old) for old, new in ages if not math.isnan(new + old)]
    if not least:
        return state.stamp - before.stamp
    return 0.0 if any(map(math.isnan, least)) else min(least)
