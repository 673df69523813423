"""Ends a motion that nobody answers for: the joints that move hold where they are, else the arm is stopped.

Owns which joints hold, and when that is not enough. Must not know why: leases, clients.
"""

from __future__ import annotations

import logging
import math
from typing import TYPE_CHECKING

from hexwire.drivers.values import StopMode
from hexwire.errors import DeviceError, HexwireError, PreemptedError, StoppedError
from hexwire.model.state import JointFlag

from .target import holding

if TYPE_CHECKING:
    from hexwire.model.state import JointReading

    from .controller import TrajectoryController
    from .owner import RobotOwner
    from .target import TargetController

__all__ = ["SOON", "brake_at_end", "hold_moving", "stop_or_log"]

_log = logging.getLogger(__name__)

SOON = 0.15
"""Seconds that a joint may still move before it brakes; where a target lasts longer, joints are told to hold where
they are at once."""

_TORQUE = JointFlag.TORQUE_ON | JointFlag.TORQUE_UNKNOWN


def hold_moving(owner: RobotOwner, why: str) -> None:
    """End all motions: joints that controllers move brake, others hold where they are.

    The caller has `RobotOwner.deciding`. What the robot does on its own, such as a far target, has no plan from
    which a brake could begin; and where targets last long, a brake would come too late.

    Joints that hold already keep their target: under load a servo rests a little off it, and a new one at each of
    many holds would let the arm sink.

    Args:
        owner: Of the arm.
        why: In words.
    """
    moved = owner.running()
    if owner.lead <= SOON:
        braking = owner.group.brake(why)
    else:
        braking = frozenset()
        owner.group.release(why)
    if not moved:
        return
    robot = owner.robot
    asked = robot.epochs.mark()
    try:
        # The call that this thread executes may be what just lost its right; this is not part of it.
        with robot.epochs.using(asked):
            braking = braking.union(owner.brake())
            state = robot.read()
        if state.stopped:
            return
        moving = [j for j in state if j.name in moved and j.flags & _TORQUE]
        moving = [j for j in moving if j.name not in braking]
        if unknown := [joint.name for joint in moving if not _is_known(joint)]:
            raise DeviceError(f"nobody knows where {', '.join(unknown)} is")
        target = holding(robot.model, state, [joint.name for joint in moving])
        if moving and target is not None and (silent := owner.send(target, asked, holds=True).silent):
            raise DeviceError(f"{', '.join(silent)} does not answer")
    except (StoppedError, PreemptedError):
        # Another program stops it.
        return
    except HexwireError as error:
        _log.error("the arm cannot hold: %s; it is stopped", error)
        stop_or_log(owner, why)


def brake_at_end(owner: RobotOwner, *controllers: TrajectoryController | TargetController) -> bool:
    """Brake joints before their program ends, and wait until they rest.

    Args:
        owner: Of the arm; this thread makes its turns.
        *controllers: Move them, target by target.

    Returns:
        False if that is not possible: they must be told where to hold.
    """
    if owner.lead > SOON:
        return False
    with owner.locked():
        braked = [controller for controller in controllers if controller.brake("it is over")]
    while any(controller.brakes(owner.now()) for controller in braked):
        owner.turn()
    return len(braked) == len(controllers)


def stop_or_log(owner: RobotOwner, why: str, mode: StopMode = StopMode.HOLD) -> None:
    """Stop the arm; log a stop that is not confirmed, since nobody waits for the answer."""
    try:
        confirmed = owner.stop(why, mode)
    except HexwireError as error:
        _log.error("the stop was not confirmed: %s", error)
        return
    if missing := [name for name in owner.model.names if name not in confirmed]:
        _log.error("%s did not confirm the stop", ", ".join(missing))


def _is_known(joint: JointReading) -> bool:
    """Whether its torque is on and its position known."""
    doubtful = joint.flags & (JointFlag.TORQUE_UNKNOWN | JointFlag.SILENT)
    return not doubtful and math.isfinite(joint.position)
