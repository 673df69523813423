"""The goals of a ROS 2 action server: their states, who waits for a result, and how long a result is kept.

Owns the rules of `rcl_action`: which state follows which, what a request to cancel means, when a goal is forgotten.
Pure: times come in as arguments. Must not know messages, services, threads, nor what a goal is for.

A goal lives on when its client is gone, as in ROS 2: no rule here asks whether a client is there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Generic, TypeVar

from .errors import UsageError

__all__ = ["MOST_GOALS", "CancelCode", "Goal", "GoalStatus", "Goals"]

MOST_GOALS = 1000
"""Most goals that are kept, those included that ended and whose results are kept."""
_MOST_ACTIVE = 100
"""Most goals that have not ended, since each may take memory for a long trajectory."""
_MOST_WAITING = 100
"""Most requests that wait for the result of one goal."""
_NO_ID = bytes(16)
_FOREVER = 2**63 - 1

_W = TypeVar("_W")


class GoalStatus(IntEnum):
    """States of a goal, with the numbers of action_msgs/msg/GoalStatus."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6


class CancelCode(IntEnum):
    """Answers to a request to cancel, with the numbers of action_msgs/srv/CancelGoal.

    An arm never refuses to hold, so nothing answers REJECTED.
    """

    NONE = 0
    REJECTED = 1
    UNKNOWN_GOAL_ID = 2
    GOAL_TERMINATED = 3


_NEXT: Mapping[GoalStatus, frozenset[GoalStatus]] = {
    GoalStatus.ACCEPTED: frozenset({GoalStatus.EXECUTING, GoalStatus.CANCELING}),
    GoalStatus.EXECUTING: frozenset({GoalStatus.CANCELING, GoalStatus.SUCCEEDED, GoalStatus.ABORTED}),
    GoalStatus.CANCELING: frozenset({GoalStatus.SUCCEEDED, GoalStatus.CANCELED, GoalStatus.ABORTED}),
}
"""Which state may follow; a state that is missing here is an end."""


@dataclass(eq=False, slots=True)
class Goal(Generic[_W]):
    """One goal.

    Attributes:
        id: UUID, 16 bytes.
        stamp: When it was received, nanoseconds of ROS time.
        status: Its state. ACCEPTED also means that it is still checked.
        known: Its client has been told that it is accepted; only then others see it.
        result: After its end.
        ended: When it ended, seconds; None before.
        waiting: Requests that wait for its end.
    """

    id: bytes
    stamp: int
    status: GoalStatus = GoalStatus.ACCEPTED
    known: bool = False
    result: object = None
    ended: float | None = None
    waiting: list[_W] = field(default_factory=list)

    @property
    def active(self) -> bool:
        """It has not ended."""
        return self.status in _NEXT

    @property
    def cancelable(self) -> bool:
        """It may be cancelled: it neither ended nor is it being cancelled."""
        return GoalStatus.CANCELING in _NEXT.get(self.status, ())


class Goals(Generic[_W]):
    """The goals of one action server; `_W` is what waits for a result.

    Args:
        result_timeout: Seconds for which a result is kept after the end; negative for as long as there is room.
    """

    def __init__(self, result_timeout: float) -> None:
        self._timeout = result_timeout
        self._goals: dict[bytes, Goal[_W]] = {}

    def __len__(self) -> int:
        return len(self._goals)

    def receive(self, goal_id: bytes, stamp: int, now: float) -> Goal[_W]:
        """Take a new goal; then `accept` or `refuse` it.

        Args:
            goal_id: UUID, 16 bytes.
            stamp: ROS time, nanoseconds.
            now: Seconds.

        Raises:
            UsageError: The id is in use, or there are too many goals.
        """
        self.expire(now)
        if goal_id in self._goals:
            raise UsageError(f"the goal id {goal_id.hex()} is in use; every goal needs an id of its own")
        if sum(goal.active for goal in self._goals.values()) >= _MOST_ACTIVE:
            raise UsageError(f"{_MOST_ACTIVE} goals are active or checked; wait for the end of one")
        if len(self._goals) >= MOST_GOALS:
            ended = (goal for goal in self._goals.values() if not goal.active)
            del self._goals[min(ended, key=lambda goal: goal.ended or 0.0).id]
        goal: Goal[_W] = Goal(goal_id, stamp)
        self._goals[goal_id] = goal
        return goal

    def accept(self, goal: Goal[_W]) -> None:
        """The goal is accepted and begins; one that is being cancelled stays so."""
        goal.known = True
        if goal.status is GoalStatus.ACCEPTED:
            goal.status = GoalStatus.EXECUTING

    def refuse(self, goal: Goal[_W]) -> list[_W]:
        """The goal is refused and unknown from now on. Returns who waited for its result."""
        if self._goals.get(goal.id) is goal:
            del self._goals[goal.id]
        waiting, goal.waiting = goal.waiting, []
        return waiting

    def end(self, goal: Goal[_W], status: GoalStatus, result: object, now: float) -> list[_W]:
        """The goal has ended.

        Args:
            goal: The goal.
            status: SUCCEEDED, CANCELED or ABORTED.
            result: Kept for those who ask for it.
            now: Seconds.

        Returns:
            Who waits for the result.

        Raises:
            ValueError: This end cannot follow the goal's state; nothing was changed.
        """
        if status in _NEXT or status not in _NEXT.get(goal.status, ()):
            raise ValueError(f"{status.name} cannot follow {goal.status.name}")
        goal.status, goal.result, goal.ended = status, result, now
        waiting, goal.waiting = goal.waiting, []
        return waiting

    def cancel(self, goal_id: bytes, stamp: int, now: float) -> tuple[CancelCode, list[Goal[_W]]]:
        """Cancel goals: their state is CANCELING from now on.

        Args:
            goal_id: Of the goal to cancel; zeros for no certain goal.
            stamp: Goals received until then are cancelled too, ROS time in nanoseconds; 0 for none, or for all of
                them if the id is zeros.
            now: Seconds.

        Returns:
            The answer, and the goals that are cancelled now.
        """
        self.expire(now)
        if goal_id != _NO_ID and stamp == 0:
            goal = self._goals.get(goal_id)
            if goal is None:
                return CancelCode.UNKNOWN_GOAL_ID, []
            # A goal that is being cancelled counts as ended here, in rcl_action too.
            if not goal.cancelable:
                return CancelCode.GOAL_TERMINATED, []
            chosen = [goal]
        else:
            until = _FOREVER if goal_id == _NO_ID and stamp == 0 else stamp
            chosen = [
                goal
                for goal in self._goals.values()
                if goal.cancelable and (goal.stamp <= until or goal.id == goal_id)
            ]
        for goal in chosen:
            goal.status = GoalStatus.CANCELING
        return CancelCode.NONE, chosen

    @staticmethod
    def preempt(goal: Goal[_W]) -> None:
        """Another goal takes its place: its state is CANCELING, as if a client had asked for that."""
        if goal.status is GoalStatus.EXECUTING:
            goal.status = GoalStatus.CANCELING

    def ask(self, goal_id: bytes, waiter: _W, now: float) -> tuple[GoalStatus, object] | None:
        """Ask for the result of a goal.

        Returns:
            State and result; UNKNOWN and None for a goal that is unknown, or for whose end too many wait already.
            None if the goal has not ended: `waiter` waits.
        """
        self.expire(now)
        goal = self._goals.get(goal_id)
        if goal is None or len(goal.waiting) >= _MOST_WAITING:
            return GoalStatus.UNKNOWN, None
        if not goal.active:
            return goal.status, goal.result
        goal.waiting.append(waiter)
        return None

    def expire(self, now: float) -> None:
        """Forget goals whose results have been kept long enough."""
        if self._timeout < 0.0:
            return
        old = [
            goal.id for goal in self._goals.values() if goal.ended is not None and now - goal.ended > self._timeout
        ]
        for goal_id in old:
            del self._goals[goal_id]

    def known(self, now: float) -> list[Goal[_W]]:
        """The goals that others may know of, in order of their arrival: accepted and not forgotten."""
        self.expire(now)
        return [goal for goal in self._goals.values() if goal.known]
