"""Replies of a board or robot controller: a refusing status becomes an error that says what to do.

Owns the advice for each status. Must not know sessions, joints or callers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hexwire.errors import CommandRefusedError, StoppedError
from hexwire.model.state import JointFlag
from hexwire.wire.command_frame import Command, Status, command_name, status_name

if TYPE_CHECKING:
    from hexwire.session.events import Reply

__all__ = ["check_reply", "torque_flag"]

_ADVICE: dict[int, str] = {
    Status.STOPPED: "the arm is stopped; `hexwire resume` ends that",
    Status.TORQUE_OFF: "a joint has no torque; `hexwire torque on` first",
    Status.BUSY: "the board is busy; try again",
    Status.SERVO_SILENT: "a servo does not answer; `hexwire ping` shows which",
    Status.SERVO_FAULT: "a servo is not in position mode; set its register `mode` to 0 in maintenance",
    Status.FORBIDDEN: (
        "the board forwards no such packet to a servo: move joints with `write`, switch torque with `torque`; "
        "servo settings need `maintenance(True)`, and nothing moves until `maintenance(False)`"
    ),
}
_TORQUE_FLAGS = {None: int(JointFlag.TORQUE_UNKNOWN), True: int(JointFlag.TORQUE_ON), False: 0}
_FORBIDDEN_MAINTENANCE = "a joint has torque; `hexwire torque off` first"
_FORBIDDEN_MOTION = "the board is in maintenance; `maintenance(False)` ends that"


def torque_flag(torque: bool | None) -> int:
    """Return the flag of a joint whose torque is on, off, or unknown."""
    return _TORQUE_FLAGS[torque]


def check_reply(reply: Reply, *accepted: Status) -> Reply:
    """Turn a status other than ok into an error.

    Args:
        reply: The reply.
        *accepted: Further status codes, which the caller handles.

    Raises:
        StoppedError: The arm is stopped.
        CommandRefusedError: Any other status.
    """
    status = reply.status
    if status == Status.OK or status in accepted:
        return reply
    reason = _ADVICE.get(status) or status_name(status)
    if status == Status.FORBIDDEN and reply.cmd == Command.MAINTENANCE:
        reason = _FORBIDDEN_MAINTENANCE
    elif status == Status.FORBIDDEN and reply.cmd in (Command.JOINT_MOVE, Command.TORQUE, Command.SYNC_WRITE):
        reason = _FORBIDDEN_MOTION
    kind = StoppedError if status == Status.STOPPED else CommandRefusedError
    raise kind(command_name(reply.cmd), status, reason)
