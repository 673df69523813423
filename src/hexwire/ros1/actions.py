"""The life of action goals: from a server's handle to the arm, and their ends back to the handle.

Owns the thread in which goals are checked and ended, in their order. Handles are those of actionlib, as they come;
must not know rospy, nor what a right goal is.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from hexwire.control.outcomes import Ended, Outcome, Reason
from hexwire.errors import GoalError

from .codes import CODES, ErrorCode
from .values import order_of, tolerances_of

if TYPE_CHECKING:
    from hexwire.control.arm import Arm

__all__ = ["ActionGoal", "ActionGoals"]

_log = logging.getLogger(__name__)

_CLIENT_READY = 0.02
"""Seconds from a goal to the first answer to it. actionlib's SimpleActionClient for Python publishes a goal before
it notes which one it waits for, and drops an answer that comes in between: it would wait for ever."""
_STEP = 0.002
"""Seconds that are waited at once. What passes beyond does not count: the machine stood still, its clients too."""


class ActionGoal:
    """A goal of an action client.

    Args:
        controller: Its name; ids are a client's own, and may be the same at two controllers.
        handle: Of actionlib.
        on_end: Called with this and how it ended.

    Attributes:
        accepted: Its client knows that it is.
        recalled: Its client wants it no more.
        answerable: When its client may be answered, by the worker's clock; None until there is an answer.
    """

    def __init__(self, controller: str, handle: Any, on_end: Callable[[ActionGoal, Ended], object]) -> None:
        self.controller, self.handle = controller, handle
        self.accepted = self.recalled = False
        self.answerable: float | None = None
        self._on_end = on_end

    @property
    def key(self) -> tuple[str, str]:
        """Controller and id."""
        return self.controller, self.handle.get_goal_id().id

    def ended(self, ended: Ended) -> None:
        """It is over."""
        self._on_end(self, ended)


class ActionGoals:
    """Goals of all controllers of an arm. `start` it, `close` it; any thread may call the others.

    Args:
        arm: What follows them.
        result: The message class FollowJointTrajectoryResult.
        now: ROS's time.
    """

    def __init__(self, arm: Arm, result: Callable[..., Any], now: Callable[[], Any]) -> None:
        self._arm, self._result_class, self._now = arm, result, now
        self._goals: dict[tuple[str, str], ActionGoal] = {}
        # Goals and results, in their order; checking a goal takes longer than a callback may.
        self._work: queue.SimpleQueue[Callable[[], object] | None] = queue.SimpleQueue()
        # Answers to clients in their order, each with the time before which it must not be given.
        self._answers: deque[tuple[float, Callable[[], object]]] = deque()
        # The worker's clock: seconds that it has run or waited, a step at a time.
        self._ran = self._seen = 0.0
        self._worker = threading.Thread(target=self._do_work, name="goals", daemon=True)

    def start(self) -> None:
        """Handle goals from now on."""
        self._worker.start()

    def close(self, patience: float = 1.0) -> None:
        """Handle what has come, and no more.

        Args:
            patience: Seconds to wait for that.
        """
        self._work.put(None)
        if self._worker.is_alive():
            self._worker.join(patience)

    @property
    def open(self) -> bool:
        """Somebody still waits for the end of a goal."""
        return bool(self._goals)

    def on_goal(self, controller: str, handle: Any) -> None:
        """A goal has come for a controller."""
        goal = ActionGoal(controller, handle, self._end)
        self._goals[goal.key] = goal
        self._work.put(partial(self._begin, goal))

    def on_cancel(self, controller: str, handle: Any) -> None:
        """Its client wants a goal no more."""
        goal = self._goals.get((controller, handle.get_goal_id().id))
        if goal is not None:
            # At once, and before the arm is asked: it, or another, may be on the way through its check.
            goal.recalled = True
            self._arm.cancel(controller, goal)

    def _begin(self, goal: ActionGoal) -> None:
        message = goal.handle.get_goal()
        try:
            tolerances = self._arm.controllers[goal.controller].settings.tolerances.overridden(
                tolerances_of(message.path_tolerance),
                tolerances_of(message.goal_tolerance),
                message.goal_time_tolerance.to_sec(),
            )
            self._arm.command(
                goal.controller,
                order_of(message.trajectory, self._now()),
                goal=goal,
                tolerances=tolerances,
                wanted=lambda: not goal.recalled,
            )
        except GoalError as error:
            if not goal.recalled:
                _log.warning("goal refused: %s", error)
            self._refuse(goal, CODES[Reason(error.reason)], str(error))
        except Exception as error:
            # Its client must not wait for an end that never comes.
            self._refuse(goal, ErrorCode.INVALID_GOAL, f"the node failed: {error!r}")
            raise
        else:
            self._answer(goal, partial(self._accept, goal))

    @staticmethod
    def _accept(goal: ActionGoal) -> None:
        goal.handle.set_accepted()
        goal.accepted = True

    def _refuse(self, goal: ActionGoal, code: ErrorCode, text: str) -> None:
        self._answer(goal, partial(self._reject, goal, code, text))

    def _reject(self, goal: ActionGoal, code: ErrorCode, text: str) -> None:
        self._forget(goal)
        if goal.recalled:
            goal.handle.set_canceled(self._result(ErrorCode.SUCCESSFUL, "cancelled"), "cancelled")
        else:
            goal.handle.set_rejected(self._result(code, text), text)

    def _end(self, goal: ActionGoal, ended: Ended) -> None:
        # After what accepted it, which may still be under way.
        self._work.put(partial(self._answer, goal, partial(self._finish, goal, ended)))

    def _finish(self, goal: ActionGoal, ended: Ended) -> None:
        self._forget(goal)
        result = self._result(CODES[ended.reason], ended.text)
        if ended.outcome is Outcome.SUCCEEDED:
            goal.handle.set_succeeded(result, ended.text)
        elif ended.outcome is Outcome.PREEMPTED:
            goal.handle.set_canceled(result, ended.text)
        else:
            _log.warning("goal aborted: %s", ended.text)
            goal.handle.set_aborted(result, ended.text)

    def _forget(self, goal: ActionGoal) -> None:
        # Its id may be another one's by now.
        if self._goals.get(goal.key) is goal:
            del self._goals[goal.key]

    def _result(self, code: ErrorCode, text: str) -> Any:
        return self._result_class(error_code=int(code), error_string=text)

    # -- the worker -----------------------------------------------------------------------------------

    def _answer(self, goal: ActionGoal, answer: Callable[[], object]) -> None:
        if goal.answerable is None:
            goal.answerable = self._ran + _CLIENT_READY
        self._answers.append((goal.answerable, answer))

    def _do_work(self) -> None:
        open_ = True
        while open_ or self._answers:
            if self._answers and self._time_left() <= 0.0:
                self._try(self._answers.popleft()[1])
                continue
            try:
                job = self._work.get(timeout=_STEP if self._answers else None)
            except queue.Empty:
                continue
            if job is None:
                open_ = False
            elif open_:
                self._try(job)

    def _time_left(self) -> float:
        """Seconds until the next answer may be given."""
        now = time.monotonic()
        self._ran += min(now - self._seen, _STEP)
        self._seen = now
        return self._answers[0][0] - self._ran

    @staticmethod
    def _try(job: Callable[[], object]) -> None:
        try:
            job()
        except Exception:  # noqa: BLE001  # a goal must not take the others with it
            _log.exception("a goal could not be handled")
