"""Goals of FollowJointTrajectory clients: from an action server to the arm, and the results back.

Owns which end of a goal is which end in ROS 2. Must not know when a goal is valid.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from hexwire.control.loop.outcomes import Ended, Outcome, Reason
from hexwire.control.motion.goal_fields import CODES as USUAL_CODES
from hexwire.control.motion.goal_fields import ErrorCode
from hexwire.control.requests.client_goals import ClientGoals

from .values import request_of

if TYPE_CHECKING:
    from hexwire.control.requests.controlled_arm import ControlledArm
    from zenoh_ros2 import GoalHandle

__all__ = ["CODES", "FOLLOW_JOINT_TRAJECTORY", "ActionClient", "ActionGoals", "in_log"]

FOLLOW_JOINT_TRAJECTORY = "control_msgs/action/FollowJointTrajectory"
# The code that ros2_controllers gives to a goal that another one replaces.
CODES = {**USUAL_CODES, Reason.REPLACED: ErrorCode.INVALID_GOAL}
"""The error code of each reason."""


def in_log(reason: Reason, text: str) -> str:
    """A reason in the log, with its code: ROS 2 has no other place for why a goal is refused."""
    return f"{CODES[reason].name}: {text}"


class ActionClient:
    """Answers an action client.

    Args:
        handle: The client's goal.
        result: Makes a FollowJointTrajectory_Result.

    Attributes:
        handle: The client's goal.
    """

    def __init__(self, handle: GoalHandle, result: Callable[..., Any]) -> None:
        self.handle, self._result_type = handle, result

    def accepted(self) -> None:
        """See `Client.accepted`."""
        self.handle.accept()

    def refused(self, reason: Reason, text: str) -> None:
        """See `Client.refused`."""
        if reason is Reason.CANCELLED:
            # The client that cancelled it has been told that it is being cancelled, so it was a goal.
            self.handle.accept()
            self.handle.canceled(self._result(reason, text))
        else:
            # ROS 2 has no room for a reason here; the log has it.
            self.handle.refuse()

    def ended(self, ended: Ended) -> None:
        """See `Client.ended`."""
        result = self._result(ended.reason, ended.text)
        if ended.outcome is Outcome.SUCCEEDED:
            self.handle.succeed(result)
        elif ended.outcome is Outcome.PREEMPTED:
            # Whoever asked for that: a client, or a motion that takes its place. MoveIt calls an end by CANCELED
            # preempted, and one by ABORTED a failure.
            self.handle.preempt(result)
        else:
            self.handle.abort(result)

    def _result(self, reason: Reason, text: str) -> Any:
        return self._result_type(error_code=int(CODES[reason]), error_string=text)


class ActionGoals(ClientGoals[ActionClient]):
    """Goals of action clients, for all controllers of an arm.

    Args:
        arm: The arm that follows them.
        result: Makes a FollowJointTrajectory_Result.
        ros_time: Returns the ROS time, nanoseconds.
    """

    def __init__(
        self, arm: ControlledArm, result: Callable[..., Any], ros_time: Callable[[], int] = time.time_ns
    ) -> None:
        super().__init__(arm, answer_after=0.0, end_after=0.0, in_log=in_log)
        self._result, self._ros_time = result, ros_time

    def on_goal(self, controller: str, handle: GoalHandle) -> None:
        """Take a new goal for a controller."""
        client = ActionClient(handle, self._result)
        self.send(controller, handle.id.hex(), client, lambda: request_of(handle.goal, self._ros_time()))

    def on_cancel(self, controller: str, handle: GoalHandle) -> None:
        """Cancel a goal."""
        self.cancel(controller, handle.id.hex())
