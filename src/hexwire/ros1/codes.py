"""The reasons why goals end, as error codes of control_msgs/FollowJointTrajectoryResult.

Owns this one table. Must not know why a goal was refused or how it ended.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

from hexwire.control.outcomes import Reason

__all__ = ["CODES", "ErrorCode"]


class ErrorCode(IntEnum):
    """Error codes of FollowJointTrajectoryResult, with the names that the message gives them."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


CODES: Mapping[Reason, ErrorCode] = {
    Reason.REACHED: ErrorCode.SUCCESSFUL,
    Reason.REPLACED: ErrorCode.SUCCESSFUL,
    Reason.CANCELLED: ErrorCode.SUCCESSFUL,
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
