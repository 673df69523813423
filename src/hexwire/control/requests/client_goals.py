"""Goals of asynchronous clients: checked, started and answered in the order of their arrival.

Owns the worker thread, and goals that are cancelled before they begin.
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
from hexwire.system import next_within

from ..loop.outcomes import Outcome, Reason

if TYPE_CHECKING:
    from hexwire.epochs import Token

    from ..loop.outcomes import Ended
    from ..motion.goals import ComponentTolerance, TrajectoryGoal
    from .controlled_arm import ControlledArm

__all__ = ["Client", "ClientGoal", "ClientGoals", "ClientRequest"]

_log = logging.getLogger(__name__)

_STEP = 0.002
"""Longest single wait, seconds. Time beyond it does not count: the machine was stalled, and its clients too."""


class Client(Protocol):
    """The sender of a goal. Called in the worker thread: `accepted`, then `ended`; or only `refused`."""

    def accepted(self) -> None:
        """The goal begins now, or at its time."""

    def refused(self, reason: Reason, text: str) -> None:
        """The goal is refused."""

    def ended(self, ended: Ended) -> None:
        """The accepted goal has ended."""


_C = TypeVar("_C", bound=Client)


@dataclass(frozen=True, slots=True)
class ClientRequest:
    """The contents of a client's goal.

    Attributes:
        trajectory: The trajectory to follow.
        path: Tolerances on the path, as in `Tolerances.overridden`.
        goal: Tolerances at the goal, as in `Tolerances.overridden`.
        goal_time: Seconds, as in `Tolerances.overridden`.
        path_components: Tolerances of components on the path, as in `Tolerances.overridden`.
        goal_components: Tolerances of components at the goal, as in `Tolerances.overridden`.
        only_minus_one: Which negative tolerances disable a check, as in `Tolerances.overridden`.
    """

    trajectory: TrajectoryGoal
    path: Sequence[tuple[str, float, float, float]] = ()
    goal: Sequence[tuple[str, float, float, float]] = ()
    goal_time: float = 0.0
    path_components: Sequence[ComponentTolerance] = ()
    goal_components: Sequence[ComponentTolerance] = ()
    only_minus_one: bool = False


class ClientGoal(Generic[_C]):
    """A goal of a client.

    Args:
        controller: Name of its controller.
        key: The client's id of the goal; the same id may be in use at two controllers.
        client: Its sender.
        asked: The arm's mark of when it arrived; a later stop voids it.
        on_end: Called with this goal and how it ended.

    Attributes:
        accepted: The client knows that it is accepted.
        cancelled: The client has cancelled it.
        judged: When the first answer was there, by the worker's clock; None until then.
    """

    def __init__(
        self, controller: str, key: str, client: _C, asked: Token, on_end: Callable[[ClientGoal[_C], Ended], object]
    ) -> None:
        self.controller, self.key, self.client, self.asked = controller, key, client, asked
        self.accepted = self.cancelled = False
        self.judged: float | None = None
        self._on_end = on_end

    def ended(self, ended: Ended) -> None:
        """Take the end of the goal."""
        self._on_end(self, ended)


class ClientGoals(Generic[_C]):
    """Goals for all controllers of an arm. Call `start`, finally `close`; any thread may call the other methods.

    Args:
        arm: The arm that follows them.
        answer_after: Least seconds until a client hears that its goal is accepted.
        end_after: Least seconds until it hears the end, also as a refusal.
        in_log: How the log words why a goal was refused or aborted.
    """

    def __init__(
        self,
        arm: ControlledArm,
        *,
        answer_after: float,
        end_after: float,
        in_log: Callable[[Reason, str], str] = lambda reason, text: text,
    ) -> None:
        self._arm, self._answer_after, self._end_after, self._in_log = arm, answer_after, end_after, in_log
        self._goals: dict[tuple[str, str], ClientGoal[_C]] = {}
        # Goals and ends, in order; checking a goal takes longer than its sender may be blocked.
        self._work: queue.SimpleQueue[Callable[[], object] | None] = queue.SimpleQueue()
        # Answers to clients in order, each with its earliest time.
        self._answers: deque[tuple[float, Callable[[], object]]] = deque()
        # The worker's clock: seconds that it has run or waited, in steps of `_STEP` at most.
        self._ran = self._seen = 0.0
        self._worker = threading.Thread(target=self._do_work, name="goals", daemon=True)

    def start(self) -> None:
        """Start handling goals."""
        self._worker.start()

    def close(self, patience: float = 1.0) -> None:
        """Handle the goals received so far, and no more.

        Args:
            patience: Seconds to wait for this.
        """
        self._work.put(None)
        if self._worker.is_alive():
            self._worker.join(patience)

    @property
    def open(self) -> bool:
        """A client still waits for the end of a goal."""
        return bool(self._goals)

    def send(self, controller: str, key: str, client: _C, read: Callable[[], ClientRequest]) -> None:
        """Take a goal.

        Args:
            controller: Name of its controller.
            key: The client's id of the goal.
            client: Gets the answers.
            read: Returns the contents; called in the worker thread.
        """
        goal = ClientGoal(controller, key, client, self._arm.mark(), self._end)
        self._goals[controller, key] = goal
        self._work.put(partial(self._begin, goal, read))

    def cancel(self, controller: str, key: str) -> None:
        """Cancel a client's goal."""
        goal = self._goals.get((controller, key))
        if goal is not None:
            # Before the call of the arm, since the goal may still be in its path check.
            goal.cancelled = True
            self._arm.owner.group.cancel(goal)

    def _begin(self, goal: ClientGoal[_C], read: Callable[[], ClientRequest]) -> None:
        try:
            request = read()
            tolerances = self._arm.controllers[goal.controller].settings.tolerances.overridden(
                request.path,
                request.goal,
                request.goal_time,
                request.path_components,
                request.goal_components,
                only_minus_one=request.only_minus_one,
            )
            self._arm.command(
                goal.controller,
                request.trajectory,
                listener=goal,
                tolerances=tolerances,
                wanted=lambda: not goal.cancelled,
                asked=goal.asked,
            )
            self._arm.owner.begin_at_once()
        except GoalError as error:
            if not goal.cancelled:
                _log.warning("goal refused: %s", self._in_log(Reason(error.reason), str(error)))
            self._answer(goal, partial(self._refuse, goal, Reason(error.reason), str(error)), self._end_after)
        except Exception as error:
            # The client must get an answer.
            refuse = partial(self._refuse, goal, Reason.FAILED, f"the program failed: {error!r}")
            self._answer(goal, refuse, self._end_after)
            raise
        else:
            self._answer(goal, partial(self._accept, goal), self._answer_after)

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
        # Queued, to come after the acceptance, which may still be in progress.
        self._work.put(partial(self._answer, goal, partial(self._finish, goal, ended), self._end_after))

    def _finish(self, goal: ClientGoal[_C], ended: Ended) -> None:
        self._forget(goal)
        if ended.outcome is Outcome.ABORTED:
            _log.warning("goal aborted: %s", self._in_log(ended.reason, ended.text))
        goal.client.ended(ended)

    def _forget(self, goal: ClientGoal[_C]) -> None:
        # The key may belong to a newer goal by now.
        if self._goals.get((goal.controller, goal.key)) is goal:
            del self._goals[goal.controller, goal.key]

    # -- the worker -----------------------------------------------------------------------------------

    def _answer(self, goal: ClientGoal[_C], answer: Callable[[], object], after: float) -> None:
        if goal.judged is None:
            goal.judged = self._ran
        self._answers.append((goal.judged + after, answer))

    def _do_work(self) -> None:
        open_ = True
        while open_ or self._answers:
            if self._answers and self._time_left() <= 0.0:
                self._try(self._answers.popleft()[1])
                continue
            try:
                job = next_within(self._work, _STEP if self._answers else None)
            except queue.Empty:
                continue
            if job is None:
                open_ = False
            elif open_:
                self._try(job)

    def _time_left(self) -> float:
        """Seconds until the next answer may be sent."""
        now = time.monotonic()
        self._ran += min(now - self._seen, _STEP)
        self._seen = now
        return self._answers[0][0] - self._ran

    @staticmethod
    def _try(job: Callable[[], object]) -> None:
        try:
            job()
        except Exception:  # noqa: BLE001  # a failure of one goal must not affect others
            _log.exception("a goal could not be handled")
