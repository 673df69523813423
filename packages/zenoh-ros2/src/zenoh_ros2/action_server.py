"""An action server: three services and two topics around the goals of `goals.py`.

Owns names, quality of service and messages of an action, and the order of what clients see: the answer to a goal
before its state, a result before the state that ends the goal. Must not know what a goal means.

A goal belongs to nobody: any client may cancel it or ask for its result, and it goes on when the client that sent
it is gone. `rclcpp_action` and the joint trajectory controller do the same; who is to stop the arm at the loss of a
client has the client cancel, or uses the stop.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from .distributions import Distribution
from .errors import UsageError
from .goals import Goal, Goals, GoalStatus
from .node import Deferred
from .qos import ACTION_STATUS, DEFAULT
from .times import nanoseconds_of, time_fields

if TYPE_CHECKING:
    from .node import Node
    from .types import Types

__all__ = ["ActionServer", "GoalHandle", "default_result_timeout"]

_log = logging.getLogger(__name__)


def default_result_timeout(distribution: Distribution) -> float:
    """Seconds for which `rcl_action` of a distribution keeps results."""
    return 900.0 if distribution is Distribution.HUMBLE else 10.0


class GoalHandle:
    """A client's goal, for those who work on it. Any thread may call its methods.

    Call `accept` or `refuse` once; after `accept`, once one of `succeed`, `abort`, `canceled` and `preempt`.

    Attributes:
        id: UUID, 16 bytes.
        goal: The message that describes it.
    """

    def __init__(self, server: ActionServer, goal: Goal[Deferred], message: Any) -> None:
        self.id, self.goal = goal.id, message
        self._server, self._goal = server, goal
        self.answer = Deferred()

    @property
    def status(self) -> GoalStatus:
        """Its state."""
        return self._goal.status

    def accept(self) -> None:
        """Tell the client that the goal is accepted; it executes from now on, or is being cancelled already."""
        self._server.accept(self, self._goal)

    def refuse(self) -> None:
        """Tell the client that the goal is refused."""
        self._server.refuse(self, self._goal)

    def succeed(self, result: Any) -> None:
        """The goal is reached.

        Args:
            result: The action's result message.

        Raises:
            ValueError: The goal is not executing; likewise below.
        """
        self._server.end(self._goal, GoalStatus.SUCCEEDED, result)

    def abort(self, result: Any) -> None:
        """The goal is given up."""
        self._server.end(self._goal, GoalStatus.ABORTED, result)

    def canceled(self, result: Any) -> None:
        """The goal has been cancelled, as a client asked."""
        self._server.end(self._goal, GoalStatus.CANCELED, result)

    def preempt(self, result: Any) -> None:
        """Another goal has taken its place: it is CANCELED, though no client asked for that."""
        self._server.preempt(self._goal)
        self._server.end(self._goal, GoalStatus.CANCELED, result)

    def publish_feedback(self, feedback: Any) -> None:
        """Publish progress; nothing before the goal is accepted and after its end. It does not wait for a lock.

        Args:
            feedback: The action's feedback message.
        """
        if self._goal.known and self._goal.active:
            self._server.publish_feedback(self.id, feedback)


class ActionServer:
    """Serves one action. Its node must be open.

    Args:
        node: The node.
        types: Its types.
        name: Name of the action, as written in the program; remapped as that of a topic.
        type_name: As in ``control_msgs/action/FollowJointTrajectory``.
        on_goal: Gets each new goal, in the thread of callbacks; must not wait.
        on_cancel: Gets each goal that is to be cancelled; likewise. The goal then ends in any way.
        result_timeout: Seconds for which results are kept; None for what `rcl_action` keeps them.
        clock: Returns the seconds by which results are kept.
        ros_time: Returns the ROS time, nanoseconds.

    Attributes:
        type: Type of the action.
    """

    def __init__(
        self,
        node: Node,
        types: Types,
        name: str,
        type_name: str,
        *,
        on_goal: Callable[[GoalHandle], object],
        on_cancel: Callable[[GoalHandle], object],
        result_timeout: float | None = None,
        clock: Callable[[], float] = time.monotonic,
        ros_time: Callable[[], int] = time.time_ns,
    ) -> None:
        self.type = types.action(type_name)
        self._uuid = types.message("unique_identifier_msgs/msg/UUID")
        self._time = types.message("builtin_interfaces/msg/Time")
        self._goal_info = types.message("action_msgs/msg/GoalInfo")
        self._goal_status = types.message("action_msgs/msg/GoalStatus")
        self._on_goal, self._on_cancel = on_goal, on_cancel
        self._clock, self._ros_time = clock, ros_time
        keep = default_result_timeout(types.distribution) if result_timeout is None else result_timeout
        # Guards the goals, and the order of what is sent about them.
        self._lock = threading.RLock()
        self._goals: Goals[Deferred] = Goals(keep)
        self._handles: dict[bytes, GoalHandle] = {}
        # Its name is remapped first: a rule for the action moves all five.
        within = f"{node.resolve(name)}/_action"
        # Clients find the services once the topics are there.
        self._feedback = node.publisher(f"{within}/feedback", self.type.feedback.name, DEFAULT)
        self._status = node.publisher(f"{within}/status", self.type.status.name, ACTION_STATUS)
        self._services = (
            node.service(f"{within}/send_goal", self.type.send_goal.name, self._send_goal),
            node.service(f"{within}/cancel_goal", self.type.cancel_goal.name, self._cancel_goal),
            node.service(f"{within}/get_result", self.type.get_result.name, self._get_result),
        )

    @property
    def name(self) -> str:
        """Full name of the action."""
        return self._status.topic.removesuffix("/_action/status")

    def close(self) -> None:
        """End the services and topics. Goals go on."""
        for part in (*self._services, self._feedback, self._status):
            part.close()

    # -- for the handles ------------------------------------------------------------------------------------------

    def accept(self, handle: GoalHandle, goal: Goal[Deferred]) -> None:
        """See `GoalHandle.accept`."""
        with self._lock:
            self._goals.accept(goal)
            self._answer(handle.answer, self.type.send_goal.response(accepted=True, stamp=self._stamp(goal.stamp)))
            self._publish_status()

    def refuse(self, handle: GoalHandle, goal: Goal[Deferred]) -> None:
        """See `GoalHandle.refuse`."""
        with self._lock:
            waiting = self._goals.refuse(goal)
            self._handles.pop(goal.id, None)
            self._answer(handle.answer, self.type.send_goal.response(accepted=False))
            for waiter in waiting:
                self._answer(waiter, self._result(GoalStatus.UNKNOWN, None))

    def preempt(self, goal: Goal[Deferred]) -> None:
        """See `GoalHandle.preempt`."""
        with self._lock:
            self._goals.preempt(goal)
            self._publish_status()

    def end(self, goal: Goal[Deferred], status: GoalStatus, result: Any) -> None:
        """See `GoalHandle.succeed`."""
        with self._lock:
            waiting = self._goals.end(goal, status, result, self._clock())
            self._handles.pop(goal.id, None)
            for waiter in waiting:
                self._answer(waiter, self._result(status, result))
            self._publish_status()

    def publish_feedback(self, goal_id: bytes, feedback: Any) -> None:
        """See `GoalHandle.publish_feedback`."""
        self._feedback.publish(self.type.feedback(goal_id=self._uuid(uuid=goal_id), feedback=feedback))

    def _answer(self, waiter: Deferred, response: Any) -> None:
        try:
            waiter.answer(response)
        except Exception:  # noqa: BLE001
            # The others must get their answers, and all of them the state.
            _log.exception("%s: a client could not be answered", self.name)

    # -- requests, in the thread of callbacks --------------------------------------------------------------------

    def _send_goal(self, request: Any) -> Any:
        goal_id = bytes(request.goal_id.uuid)
        with self._lock:
            try:
                goal = self._goals.receive(goal_id, self._ros_time(), self._clock())
            except UsageError as error:
                _log.warning("%s: goal refused: %s", self.name, error)
                return self.type.send_goal.response(accepted=False)
            handle = GoalHandle(self, goal, request.goal)
            self._handles[goal_id] = handle
        self._on_goal(handle)
        return handle.answer

    def _cancel_goal(self, request: Any) -> Any:
        info = request.goal_info
        with self._lock:
            code, goals = self._goals.cancel(bytes(info.goal_id.uuid), nanoseconds_of(info.stamp), self._clock())
            handles = [self._handles[goal.id] for goal in goals]
            if any(goal.known for goal in goals):
                self._publish_status()
        # Not under the lock: it may end goals in other threads. All of them, whatever happens to one.
        for handle in handles:
            try:
                self._on_cancel(handle)
            except Exception:  # noqa: BLE001
                _log.exception("%s: a goal could not be cancelled", self.name)
        return self.type.cancel_goal.response(
            return_code=int(code), goals_canceling=[self._info(goal) for goal in goals]
        )

    def _get_result(self, request: Any) -> Any:
        answer = Deferred()
        with self._lock:
            found = self._goals.ask(bytes(request.goal_id.uuid), answer, self._clock())
        return answer if found is None else self._result(*found)

    # -- messages -------------------------------------------------------------------------------------------------

    def _result(self, status: GoalStatus, result: Any) -> Any:
        response = self.type.get_result.response(status=int(status))
        if result is not None:
            response.result = result
        return response

    def _publish_status(self) -> None:
        rows = [
            self._goal_status(goal_info=self._info(goal), status=int(goal.status))
            for goal in self._goals.known(self._clock())
        ]
        self._status.publish(self.type.status(status_list=rows))

    def _info(self, goal: Goal[Deferred]) -> Any:
        return self._goal_info(goal_id=self._uuid(uuid=goal.id), stamp=self._stamp(goal.stamp))

    def _stamp(self, nanoseconds: int) -> Any:
        return self._time(**time_fields(nanoseconds))
