"""Goals of action clients: from an action server's handle to the arm, and the results back to the handle.

Owns the calls of actionlib's handles. Must not import rospy, nor know when a goal is valid.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from hexwire.control.loop.outcomes import Ended, Outcome, Reason
from hexwire.control.motion.goal_fields import CODES, tolerance_rows
from hexwire.control.requests.client_goals import ClientGoals, ClientRequest

from .values import trajectory_of

if TYPE_CHECKING:
    from hexwire.control.requests.controlled_arm import ControlledArm

__all__ = ["ActionClient", "ActionGoals"]

_CLIENT_READY = 0.02
"""Seconds from a goal to the first answer to it. actionlib's SimpleActionClient for Python publishes a goal before
it stores which one it waits for, and drops an answer that arrives in between."""
_CLIENT_READY_FOR_END = 0.1
"""Seconds from a goal to its end, also as a refusal. If that is dropped, the client waits forever. The time above
is too short for a client that a busy machine keeps from its processor."""


class ActionClient:
    """Answers an action client.

    Args:
        handle: The action server's handle of the client's goal.
        result: The message class FollowJointTrajectoryResult.
    """

    def __init__(self, handle: Any, result: Callable[..., Any]) -> None:
        self.handle, self._result_class = handle, result

    def accepted(self) -> None:
        """See `Client.accepted`."""
        self.handle.set_accepted()

    def refused(self, reason: Reason, text: str) -> None:
        """See `Client.refused`."""
        end = self.handle.set_canceled if reason is Reason.CANCELLED else self.handle.set_rejected
        end(self._result(reason, text), text)

    def ended(self, ended: Ended) -> None:
        """See `Client.ended`."""
        ends = {
            Outcome.SUCCEEDED: self.handle.set_succeeded,
            Outcome.PREEMPTED: self.handle.set_canceled,
            Outcome.ABORTED: self.handle.set_aborted,
        }
        ends[ended.outcome](self._result(ended.reason, ended.text), ended.text)

    def _result(self, reason: Reason, text: str) -> Any:
        return self._result_class(error_code=int(CODES[reason]), error_string=text)


class ActionGoals(ClientGoals[ActionClient]):
    """Goals of action clients, for all controllers of an arm.

    Args:
        arm: The arm that follows them.
        result: The message class FollowJointTrajectoryResult.
        now: Returns the current ROS time.
    """

    def __init__(self, arm: ControlledArm, result: Callable[..., Any], now: Callable[[], Any]) -> None:
        super().__init__(arm, answer_after=_CLIENT_READY, end_after=_CLIENT_READY_FOR_END)
        self._result, self._now = result, now

    def on_goal(self, controller: str, handle: Any) -> None:
        """Take a new goal for a controller."""
        # actionlib holds a lock during this call, so the message is read later.
        self.send(
            controller,
            handle.get_goal_id().id,
            ActionClient(handle, self._result),
            lambda: self._request(handle.get_goal()),
        )

    def on_cancel(self, controller: str, handle: Any) -> None:
        """Cancel a goal for its client."""
        self.cancel(controller, handle.get_goal_id().id)

    def _request(self, message: Any) -> ClientRequest:
        return ClientRequest(
            trajectory_of(message.trajectory, self._now()),
            tolerance_rows(message.path_tolerance),
            tolerance_rows(message.goal_tolerance),
            message.goal_time_tolerance.to_sec(),
        )
