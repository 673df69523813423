"""The reasons why goals end, as error codes of control_msgs/action/FollowJointTrajectory.

Owns this one table. Must not know why a goal was refused or how it ended.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

from hexwire.control.outcomes import Reason

__all__ = ["CODES", "ErrorCode", "in_log"]


class ErrorCode(IntEnum):
    """Error codes in the result of FollowJointTrajectory, with the names that the action gives them."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


CODES: Mapping[Reason, ErrorCode] = {
    Reason.REACHED: ErrorCode.SUCCESSFUL,
    Reason.CANCELLED: ErrorCode.SUCCESSFUL,
    # A replaced goal is aborted, with the code that ROS 2's controller gives it.
    Reason.REPLACED: ErrorCode.INVALID_GOAL,
    Reason.MALFORMED: ErrorCode.INVALID_GOAL,
    Reason.WRONG_JOINTS: ErrorCode.INVALID_JOINTS,
    Reason.TOO_LATE: ErrorCode.OLD_HEADER_TIMESTAMP,
    Reason.NOT_READY: ErrorCode.INVALID_GOAL,
    Reason.PATH_NOT_ALLOWED: ErrorCode.INVALID_GOAL,
    Reason.PATH_TOLERANCE: ErrorCode.PATH_TOLERANCE_VIOLATED,
    Reason.GOAL_TOLERANCE: ErrorCode.GOAL_TOLERANCE_VIOLATED,
    Reason.STOPPED: ErrorCode.INVALID_GOAL,
    Reason.FAILED: ErrorCode.INVALID_GOAL,
}
"""The error code of each reason."""


def in_log(reason: Reason, text: str) -> str:
    """A reason in the log, with its code: ROS 2 has no other place for why a goal is refused."""
    return f"{CODES[reason].name}: {text}"
