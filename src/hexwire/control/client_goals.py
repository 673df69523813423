"""Goals of clients that do not wait for them: checked, followed and answered in the order in which they came.

Owns the thread in which that is done, and goals that are cancelled before they begin. Must not know how a client
sends a goal or is answered.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from hexwire.errors import GoalError

from .outcomes import Outcome, Reason

if TYPE_CHECKING:
    from .arm import Arm
    from .goals import TrajectoryGoal
    from .outcomes import Ended

__all__ = ["Client", "ClientGoal", "ClientGoals", "Request"]

_log = logging.getLogger(__name__)

_STEP = 0.002
"""Seconds that are waited at once. What passes beyond does not count: the machine stood still, its clients too."""


class Client(Protocol):
    """Who has sent a goal. It is called in the thread of `ClientGoals`: `accepted`, then `ended`; or `refused`."""

    def accepted(self) -> None:
        """The goal is followed from now on, or from its time on."""

    def refused(self, reason: Reason, text: str) -> None:
        """The goal is not followed."""

    def ended(self, ended: Ended) -> None:
        """The goal that was accepted is over."""


_C = TypeVar("_C", bound=Client)


@dataclass(frozen=True, slots=True)
class Request:
    """What a client asks for.

    Attributes:
        trajectory: What is to be followed.
        path: Tolerances on the path, as in `Tolerances.overridden`.
        goal: Tolerances at the goal; likewise.
        goal_time: Seconds; likewise.
    """

    trajectory: TrajectoryGoal
    path: Sequence[tuple[str, float, float, float]] = ()
    goal: Sequence[tuple[str, float, float, float]] = ()
    goal_time: float = 0.0


class ClientGoal(Generic[_C]):
    """A goal of a client.

    Args:
        controller: Name of the controller that is to follow it.
        key: What its client knows it by; clients may use the same at two controllers.
        client: Who has sent it.
        on_end: Called with this and how it ended.

    Attributes:
        accepted: Its client knows that it is.
        cancelled: Its client does not want it any more.
        answerable: When its client may be answered, by the worker's clock; None until there is an answer.
    """

    def __init__(
        self, controller: str, key: str, client: _C, on_end: Callable[[ClientGoal[_C], Ended], object]
    ) -> None:
        self.controller, self.key, self.client = controller, key, client
        self.accepted = self.cancelled = False
        self.answerable: float | None = None
        self._on_end = on_end

    def ended(self, ended: Ended) -> None:
        """It is over."""
        self._on_end(self, ended)


class ClientGoals(Generic[_C]):
    """Goals of all controllers of an arm. `start` it, `close` it; any thread may call the others.

    Args:
        arm: What follows them.
        answer_after: Seconds after which a client is answered at the earliest.
    """

    def __init__(self, arm: Arm, *, answer_after: float = 0.0) -> None:
        self._arm, self._answer_after = arm, answer_after
        self._goals: dict[tuple[str, str], ClientGoal[_C]] = {}
        # Goals and ends, in their order; checking a goal takes longer than its sender may be kept waiting.
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
        """A client still waits for the end of a goal."""
        return bool(self._goals)

    def send(self, controller: str, key: str, client: _C, read: Callable[[], Request]) -> None:
        """Take a goal.

        Args:
            controller: Name of the controller that is to follow it.
            key: What its client knows it by.
            client: Who is told of it.
            read: Says what is asked for; called in the worker's thread.
        """
        goal = ClientGoal(controller, key, client, self._end)
        self._goals[controller, key] = goal
        self._work.put(partial(self._begin, goal, read))

    def cancel(self, controller: str, key: str) -> None:
        """A client does not want its goal any more."""
        goal = self._goals.get((controller, key))
        if goal is not None:
            # At once, and before the arm is asked: it, or another, may be on the way through its check.
            goal.cancelled = True
            self._arm.cancel(controller, goal)

    def _begin(self, goal: ClientGoal[_C], read: Callable[[], Request]) -> None:
        try:
            request = read()
            tolerances = self._arm.controllers[goal.controller].settings.tolerances.overridden(
                request.path, request.goal, request.goal_time
            )
            self._arm.command(
                goal.controller,
                request.trajectory,
                listener=goal,
                tolerances=tolerances,
                wanted=lambda: not goal.cancelled,
            )
        except GoalError as error:
            if not goal.cancelled:
                _log.warning("goal refused: %s", error)
            self._answer(goal, partial(self._refuse, goal, Reason(error.reason), str(error)))
        except Exception as error:
            # Its client must not wait for an end that never comes.
            self._answer(goal, partial(self._refuse, goal, Reason.FAILED, f"the program failed: {error!r}"))
            raise
        else:
            self._answer(goal, partial(self._accept, goal))

    @staticmethod
    def _accept(goal: ClientGoal[_C]) -> None:
        goal.client.accepted()
        goal.accepted = True

    def _refuse(self, goal: ClientGoal[_C], reason: Reason, text: str) -> None:
        self._forget(goal)
        if goal.cancelled:
            reason, text = Reason.CANCELLED, "cancelled"
        goal.client.refused(reason, text)

    def _end(self, goal: ClientGoal[_C], ended: Ended) -> None:
        # After what accepted it, which may still be under way.
        self._work.put(partial(self._answer, goal, partial(self._finish, goal, ended)))

    def _finish(self, goal: ClientGoal[_C], ended: Ended) -> None:
        self._forget(goal)
        if ended.outcome is Outcome.ABORTED:
            _log.warning("goal aborted: %s", ended.text)
        goal.client.ended(ended)

    def _forget(self, goal: ClientGoal[_C]) -> None:
        # Its key may be another one's by now.
        if self._goals.get((goal.controller, goal.key)) is goal:
            del self._goals[goal.controller, goal.key]

    # -- the worker -----------------------------------------------------------------------------------

    def _answer(self, goal: ClientGoal[_C], answer: Callable[[], object]) -> None:
        if goal.answerable is None:
            goal.answerable = self._ran + self._answer_after
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
