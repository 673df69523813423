"""The life cycle of an arm, with the states that ros2_control gives hardware.

Owns which state of an arm is which state of a managed node, and which requests to change it are carried out. Must
not know messages.

Requests come from launch files and life cycle managers as well as from people, so none of them moves the arm, lets
it fall or clears a stop of others.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hexwire.control.requests.readiness import Readiness, activate, deactivate, readiness
from hexwire.errors import UsageError
from zenoh_ros2 import Change, State

if TYPE_CHECKING:
    from hexwire.control.requests.controlled_arm import ControlledArm

__all__ = ["carry_out", "state_of"]

_STATES = {
    Readiness.UNREACHABLE: State.UNCONFIGURED,
    Readiness.NOT_READY: State.INACTIVE,
    Readiness.READY: State.ACTIVE,
}
_REFUSED = {
    "configure": "the node connects by itself as soon as the arm answers",
    "cleanup": "the node keeps its connection to the arm; end the node to release it",
    "shutdown": "end the node instead; its parameter torque_off_at_exit says what becomes of the torque",
}


def state_of(arm: ControlledArm) -> State:
    """The state of a managed node that says whether an arm can move now."""
    return _STATES[readiness(arm)]


def carry_out(arm: ControlledArm, change: Change) -> None:
    """Carry out a client's request, for `Lifecycle`.

    Raises:
        HexwireError: It is refused, or failed; the text says why.
    """
    if change is Change.ACTIVATE:
        activate(arm, asked=arm.mark())
    elif change is Change.DEACTIVATE:
        deactivate(arm)
    else:
        raise UsageError(_REFUSED[change.label])
