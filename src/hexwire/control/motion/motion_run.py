"""One motion of an arm's controllers: begun by all of them, watched while it runs, ended by all when one fails.

Owns its progress and its end, for whoever waits for it or is told of it; that it ends in the owner's own cycle when
signs of life stop; and that a closing gripper does not crush what it meets. Must not know leases, nor how its paths
were planned and checked.
"""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from hexwire.errors import HexwireError, UsageError

from ..loop.holding import SOON, hold_moving
from ..loop.outcomes import Outcome
from .hold_to_run import SILENCE

if TYPE_CHECKING:
    from hexwire.drivers.tools import Gripper
    from hexwire.model.state import JointState

    from ..loop.controller import TrajectoryController
    from ..loop.outcomes import Ended
    from ..loop.owner import RobotOwner
    from .jaws import Closing

__all__ = ["MotionRun", "RunProgress"]

_log = logging.getLogger(__name__)

_FAREWELL = 0.1
"""Seconds that whoever ends it has, before it ends by itself."""


@dataclass(frozen=True, slots=True)
class RunProgress:
    """How far a motion is.

    Attributes:
        title: What it is, for people.
        elapsed: Seconds of it that are over.
        duration: Seconds of all of it.
        lead_in: Seconds at its start in which the arm only moves to where it begins.
        outcome: How it ended; None while it runs.
        text: Why it ended, in words; empty after a success.
        holds: The gripper met an object, and holds it.
        off: After a success, how far off the goal joints have come to rest, in words; empty if they have not.
    """

    title: str = ""
    elapsed: float = 0.0
    duration: float = 0.0
    lead_in: float = 0.0
    outcome: Outcome | None = None
    text: str = ""
    holds: bool = False
    off: str = ""


class MotionRun:
    """One motion, and the listener of its goals. Call `begin` once; any thread may call the other methods.

    Args:
        owner: Of the arm.
        controllers: Of the arm.
        begins: What it is, and how long it takes.
        closing: Of a motion of the gripper, whether it holds an object.
        relieve: Called in a thread of its own when it does, to have it held with little force.
        age: Returns the seconds since the last sign of life of whoever began it, infinite when it is being ended;
            must not wait.
        silence: Seconds without one after which it ends.
        on_end: Called once when it has ended, in the thread that ended it; must not wait.

    Attributes:
        off: How far off their goals those have come to rest that succeeded, in words; empty for exactly there.
    """

    def __init__(
        self,
        owner: RobotOwner,
        controllers: Collection[TrajectoryController],
        begins: RunProgress = RunProgress(),
        *,
        closing: Closing | None = None,
        relieve: Callable[[Gripper, JointState], object] = lambda gripper, state: None,
        age: Callable[[], float] = lambda: 0.0,
        silence: float = SILENCE,
        on_end: Callable[[MotionRun], object] = lambda run: None,
    ) -> None:
        self._owner, self._controllers = owner, controllers
        self._progress = begins
        self._closing, self._relieve = closing, relieve
        self._age, self._silence, self._leaving = age, silence, math.inf
        self._on_end = on_end
        self.off: tuple[str, ...] = ()
        # Goals that have not succeeded yet.
        self._missing = 0
        # Re-entrant, since a signal handler may stop the arm.
        self._lock, self._over = threading.RLock(), threading.Event()

    @property
    def outcome(self) -> Outcome | None:
        """How it ended; None while it runs."""
        return self._progress.outcome

    @property
    def over(self) -> bool:
        """It has ended."""
        return self.outcome is not None

    def progress(self) -> RunProgress:
        """How far it is."""
        now = self._progress
        if now.outcome is None:
            now = replace(now, elapsed=self._elapsed())
        return replace(now, holds=self._closing is not None and self._closing.holds)

    def begin(self, goals: int, begin: Callable[[], object]) -> None:
        """Have controllers follow paths that were checked; if one of them refuses, none does.

        Args:
            goals: How many controllers; without any it has arrived.
            begin: Gives each of them a goal whose listener this is.

        Raises:
            HexwireError: As `begin`.
        """
        if not goals:
            self._end(Outcome.SUCCEEDED, "")
            return
        self._missing = goals
        self._owner.observe(self._see)
        try:
            begin()
        except BaseException as error:
            self._note(Outcome.ABORTED, str(error))
            self._owner.group.cancel(self)
            raise

    def ended(self, ended: Ended) -> None:
        """A controller reports the end of its goal, as `GoalListener`."""
        if ended.outcome is not Outcome.SUCCEEDED:
            # If one controller fails, the others must not go on.
            self._end(ended.outcome, ended.text)
            return
        with self._lock:
            self._missing -= 1
            if ended.text:
                self.off += (ended.text,)
        if not self._missing:
            self._end(Outcome.SUCCEEDED, "")

    def end(self, why: str) -> None:
        """End it; the joints that it moves hold. Without effect after its end.

        Args:
            why: In words.
        """
        if not self._note(Outcome.PREEMPTED, why):
            return
        owner = self._owner
        owner.group.cancel(self)
        if owner.lead > SOON and owner.connected:
            # A target that was sent lasts too long to wait for its end.
            with owner.deciding():
                if owner.group.reason is None and not owner.group.moving:
                    hold_moving(owner, why)
        self._on_end(self)

    def wait(self, timeout: float) -> None:
        """Wait for its end; where the wait ends first, so does the motion.

        Args:
            timeout: Seconds, for an owner that has failed: the controllers check the arrival.

        Raises:
            UsageError: It did not succeed in time; the text says why.
        """
        try:
            if not self._over.wait(timeout):
                raise UsageError(f"not arrived after {timeout:.0f} s; the arm holds")
        finally:
            self._owner.group.cancel(self)
        if self.outcome is not Outcome.SUCCEEDED:
            raise UsageError(self._progress.text or str(self.outcome))

    # -- helpers --------------------------------------------------------------------------------------

    def _elapsed(self) -> float:
        now = self._owner.now()
        left = max((c.generator.remaining(now) for c in self._controllers), default=0.0)
        return max(0.0, self._progress.duration - left)

    def _end(self, outcome: Outcome, text: str) -> None:
        """End it, unless it has ended: its controllers hold."""
        if self._note(outcome, text):
            self._owner.group.cancel(self)
            self._on_end(self)

    def _note(self, outcome: Outcome, text: str) -> bool:
        """Note the end; whether it had not ended before."""
        with self._lock:
            now = self._progress
            if now.outcome is not None:
                return False
            elapsed = now.duration if outcome is Outcome.SUCCEEDED else self._elapsed()
            self._progress = replace(now, elapsed=elapsed, outcome=outcome, text=text, off="; ".join(self.off))
            self._owner.observe(self._see, on=False)
        self._over.set()
        return True

    def _see(self, state: JointState) -> None:
        """Look for signs of life, and whether the jaws press; called in the owner's thread with every state."""
        if self._is_silent(state.stamp):
            # Here too, so that it ends although nothing else of the program may work.
            self.end("whoever held it is heard no more")
            return
        if self._closing is not None and self._closing.see(state):
            # In a thread of its own, since the owner's must not wait for the check of a path.
            args = self._closing.gripper, state
            threading.Thread(target=self._keep, args=args, name="grip", daemon=True).start()

    def _is_silent(self, now: float) -> bool:
        age = self._age()
        if not math.isinf(age):
            return age > self._silence
        # Somebody else ends it, and knows why; but does not have long.
        self._leaving = min(self._leaving, now)
        return now - self._leaving > _FAREWELL

    def _keep(self, gripper: Gripper, state: JointState) -> None:
        """Hold the object with little force instead of closing further."""
        # First, since the goal is about to be replaced.
        if not self._note(Outcome.SUCCEEDED, ""):
            return
        try:
            self._relieve(gripper, state)
        except HexwireError as error:
            _log.warning("the gripper does not hold what it met with little force: %s", error)
            self._owner.group.cancel(self)
        self._on_end(self)
