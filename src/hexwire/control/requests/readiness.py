"""Whether an arm can move, and requests to make it so or not, for fronts whose users think in such states.

Owns the three states, and what may change them.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from enum import Enum
from typing import TYPE_CHECKING

from hexwire.errors import UsageError

if TYPE_CHECKING:
    from hexwire.epochs import Token

    from .controlled_arm import ControlledArm

__all__ = ["Readiness", "activate", "deactivate", "readiness"]

_CONFIRMED_IN = 2.0
"""Longest wait for a state that shows the torque, seconds."""
_STEP = 0.02
_DEACTIVATED = "deactivated"


class Readiness(Enum):
    """Whether an arm can move."""

    UNREACHABLE = "unreachable"
    """There is no connection, or no state yet."""
    NOT_READY = "not ready"
    """A stop is latched, or a controlled joint has no torque."""
    READY = "ready"


def readiness(arm: ControlledArm) -> Readiness:
    """Whether an arm can move now."""
    owner, state = arm.owner, arm.owner.state
    if not owner.connected or state is None:
        return Readiness.UNREACHABLE
    joints = {name for controller in arm.controllers.values() for name in controller.joints}
    if owner.group.reason is not None or not joints <= set(state.torque_on):
        return Readiness.NOT_READY
    return Readiness.READY


def activate(
    arm: ControlledArm,
    *,
    asked: Token,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], object] = time.sleep,
) -> None:
    """Switch torque on, and wait until a state shows it. Nothing moves.

    The stop of `deactivate` ends. Any other is not cleared: whoever asks for this may be a program, which does not
    know why there is one.

    Args:
        arm: The arm.
        asked: As in `ControlledArm.command`.
        clock: Returns seconds.
        sleep: Waits.

    Raises:
        HexwireError: The arm is stopped or in teach mode, or not every joint confirmed it.
    """
    reason = arm.owner.group.reason
    if reason is not None:
        state = arm.owner.state
        tripped = state is not None and state.watchdog_tripped
        # Its own stop was the last, and is the first that is not cleared yet.
        if tripped or reason.text != _DEACTIVATED or asked != arm.deactivated or asked != arm.mark():
            raise UsageError(f"the arm is stopped: {reason}; reset it first")
        arm.reset(asked)
    arm.enable(True, asked)
    deadline = clock() + _CONFIRMED_IN
    while readiness(arm) is not Readiness.READY:
        if clock() >= deadline:
            raise UsageError("torque is on, but no state of the arm shows it")
        sleep(_STEP)


def deactivate(arm: ControlledArm) -> None:
    """Stop the arm, and latch that until `activate` or a reset. Joints keep their torque and hold: nothing falls.

    Raises:
        HexwireError: Not every joint confirmed it; the controllers are stopped nevertheless.
    """
    try:
        arm.stop(_DEACTIVATED)
    finally:
        arm.deactivated = arm.mark()
