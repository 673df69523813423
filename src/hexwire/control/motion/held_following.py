"""Following while a person attends to it: it ends for good as soon as nobody does, or anything is wrong.

Owns what ends it, and that the follower holds then. How a follower follows is `hexwire.control.motion.following`.
Must not know devices, pages or threads: the age of the person's last sign of life comes in by a call.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from hexwire.errors import GoalError
from hexwire.motion.safety import StopReason

from ..loop.target import holding
from .following import LEADER_STOPPED, FollowController
from .hold_to_run import SILENCE

if TYPE_CHECKING:
    from hexwire.model.state import JointState, JointTarget
    from hexwire.motion.following import Following

    from .path_check import PathCheck

__all__ = ["HeldFollowing"]

_GONE = 2.0
"""Seconds of silence of the leader after which it ends: the follower has held since a quarter of a second."""
_MAX_AGE = 1.0
"""Seconds of silence of a servo after which its joint is lost."""


class HeldFollowing(FollowController):
    """One following of an arm that has other controllers, too. Once it has ended, it sends nothing any more.

    Args:
        rules: How the follower follows.
        leader: The newest state of the leader, however old; must not wait.
        now: Clock of the leader's states, seconds.
        period: Least seconds between two cycles.
        age: Returns the seconds since the last sign of life of whoever attends to it; infinite when it is to end.
            Must not wait.
        silence: Seconds without one after which it ends.
        check: The checks of the follower.
        lost: Returns why the leader cannot be read; empty if it can.
        on_end: Called once with the reason, in the thread that found it, perhaps with the controllers' lock; must
            not wait.

    Attributes:
        ended: Why it has ended; empty while it lasts.
        note: The last note for the operator.
    """

    def __init__(
        self,
        rules: Following,
        leader: Callable[[], JointState],
        now: Callable[[], float],
        period: float,
        *,
        age: Callable[[], float],
        silence: float = SILENCE,
        check: PathCheck,
        lost: Callable[[], str] = lambda: "",
        on_end: Callable[[str], object] = lambda why: None,
    ) -> None:
        super().__init__(rules, leader, now, period, self._noted)
        self._age, self._silence, self._check = age, silence, check
        self._lost, self._on_end = lost, on_end
        self.ended, self.note = "", "the arm meets its leader slowly"
        # From the beginning: a stop that is found elsewhere ends it although the leader is silent.
        self.moving = True

    def cycle(self, state: JointState, now: float, lead: float) -> JointTarget | None:
        """The target for the leader's present position; when it ends, the joints hold."""
        if self.ended:
            return None
        target, why = None, self._fault(state)
        if not why:
            target = super().cycle(state, now, lead)
            self.moving = True
            if self.stopped is not None or state.stopped:
                why = str(self.stopped or "the arm was stopped")
            elif self.leader_stopped:
                why = LEADER_STOPPED
        if not why:
            return target
        self._end(why)
        return None if state.stopped else holding(self._arm, state, state.torque_on)

    def stop(self, reason: StopReason) -> None:
        """End it: it does not continue after a reset."""
        self._end(str(reason))

    def release(self, why: str) -> None:
        """End it; whoever asks for that says where the joints hold."""
        self._end(why)

    def _fault(self, state: JointState) -> str:
        if self._age() >= self._silence:
            return "whoever held it is heard no more"
        if lost := self._lost():
            return lost
        leader = self._leader()
        if self._now() - leader.stamp + max(leader.age, default=0.0) >= _GONE:
            return f"the leader has been silent for {_GONE:g} s"
        try:
            self._check.ready(self.joints, state, _MAX_AGE)
        except GoalError as error:
            return str(error)
        return ""

    def _end(self, why: str) -> None:
        if self.ended:
            return
        self.ended, self.moving = why, False
        self._on_end(why)

    def _noted(self, said: str | StopReason) -> None:
        self.note = str(said)
