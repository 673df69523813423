"""One motion that a person began: followed by the controllers, watched while it runs, ended when nobody wants it.

Owns its beginning, its progress and its end, for all controllers together; that it ends in the owner's own cycle
when signs of life stop; and that a closing gripper does not crush what it meets.
"""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hexwire.drivers.tools import Gripper
from hexwire.errors import GoalError, HexwireError

from ..loop.holding import SOON, hold_moving
from ..loop.outcomes import Outcome, Reason
from ..loop.waiting import Waiter
from ..motion.goals import Point, TrajectoryGoal
from ..motion.hold_to_run import SILENCE
from ..motion.jaws import Closing
from .preview import goal_of

if TYPE_CHECKING:
    from hexwire.model.state import JointState
    from hexwire.motion.trajectory import Trajectory

    from ..loop.outcomes import Ended
    from ..sharing.shared import Order, SharedArm
    from .preview import Preview

__all__ = ["MotionRun", "RunProgress", "begin_motion"]

_log = logging.getLogger(__name__)

_FAREWELL = 0.1
"""Seconds that whoever ends it has, before it ends by itself."""
_UNHURRIED = 3.0
"""The time of a relief over the shortest at the greatest speed: it begins while the joint is planned to close."""


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

    title: str
    elapsed: float
    duration: float
    lead_in: float
    outcome: Outcome | None = None
    text: str = ""
    holds: bool = False
    off: str = ""


class MotionRun:
    """One motion. Made by `begin_motion`; any thread may call its methods.

    Args:
        shared: The arm.
        orders: Makes an order of whoever began it; called for each controller.
        title: What it is, for people.
        plan: What it does.
        grip: The opening at its end, of a motion of the gripper: 0 is closed, 1 fully open.
        age: Returns the seconds since the last sign of life of whoever began it, infinite when it is being ended;
            must not wait.
        silence: Seconds without one after which it ends.
        on_end: Called once when it has ended, in the thread that ended it; must not wait.
    """

    def __init__(
        self,
        shared: SharedArm,
        orders: Callable[[], Order],
        title: str,
        plan: Preview,
        *,
        grip: float | None = None,
        age: Callable[[], float] = lambda: 0.0,
        silence: float = SILENCE,
        on_end: Callable[[MotionRun], object] = lambda run: None,
    ) -> None:
        self._age, self._silence, self._leaving = age, silence, math.inf
        self._shared, self._arm, self._orders = shared, shared.arm, orders
        self._title, self._plan, self._path = title, plan, plan.require()
        self._opening, self._on_end = grip, on_end
        self._lock = threading.Lock()
        self._outcome: Outcome | None = None
        self._text, self._done = "", 0.0
        # Of the goals of all controllers that move.
        self._goals = Waiter(0)
        self._closing: Closing | None = None

    @property
    def over(self) -> bool:
        """It has ended."""
        return self._outcome is not None

    def progress(self) -> RunProgress:
        """How far it is."""
        duration, lead = self._plan.duration, self._plan.lead_in
        if self._outcome is None:
            self._done = self._elapsed()
            return RunProgress(self._title, self._done, duration, lead, holds=self._holds())
        done = duration if self._outcome is Outcome.SUCCEEDED else self._done
        off = "; ".join(self._goals.off)
        return RunProgress(self._title, done, duration, lead, self._outcome, self._text, self._holds(), off)

    def end(self, why: str) -> None:
        """End it; the joints that it moves hold. Without effect after its end.

        Args:
            why: In words.
        """
        with self._lock:
            if self._outcome is not None:
                return
            self._done = self._elapsed()
            self._finish(Outcome.PREEMPTED, why)
        self._arm.cancel(None, self)
        owner = self._arm.owner
        if owner.lead > SOON and owner.connected:
            # A target that was sent lasts too long to wait for its end.
            with owner.deciding():
                if owner.group.reason is None and not owner.group.moving:
                    hold_moving(owner, why)
        self._on_end(self)

    def ended(self, ended: Ended) -> None:
        """A controller reports the end of its goal, as `GoalListener`."""
        with self._lock:
            if self._outcome is not None:
                return
            self._goals.ended(ended)
            if not self._goals.is_over():
                return
            self._done = self._elapsed()
            self._finish(ended.outcome, "" if ended.outcome is Outcome.SUCCEEDED else ended.text)
        # If one controller fails, the others must not go on.
        self._arm.cancel(None, self)
        self._on_end(self)

    # -- for `begin_motion` ---------------------------------------------------------------------------

    def begin(self) -> None:
        """Let the controllers follow the path; raises as `begin_motion`."""
        arm = self._arm
        goals = {name: goal_of(self._path, controller.joints) for name, controller in arm.controllers.items()}
        moving = {name: goal for name, goal in goals.items() if _moves(goal, self._path)}
        if not moving:
            with self._lock:
                self._finish(Outcome.SUCCEEDED, "")
            self._on_end(self)
            return
        self._goals = Waiter(len(moving))
        if self._opening is not None:
            self._closing = Closing(Gripper(arm.owner.robot), self._opening, arm.owner.newest())
        # A new list, since the owner's thread may be going through the old one.
        arm.owner.observers = [*arm.owner.observers, self._see]
        try:
            for name, goal in moving.items():
                self._shared.follow(self._orders(), name, goal, self)
        except BaseException as error:
            with self._lock:
                self._finish(Outcome.ABORTED, str(error))
            self._arm.cancel(None, self)
            raise

    # -- helpers --------------------------------------------------------------------------------------

    def _elapsed(self) -> float:
        owner = self._arm.owner
        now = owner.now()
        left = max((c.generator.remaining(now) for c in self._arm.controllers.values()), default=0.0)
        return max(0.0, self._plan.duration - left)

    def _finish(self, outcome: Outcome, text: str) -> None:
        """Note the end; the caller has the lock."""
        self._outcome, self._text = outcome, text
        owner = self._arm.owner
        owner.observers = [observer for observer in owner.observers if observer != self._see]

    def _see(self, state: JointState) -> None:
        """Look for signs of life, and whether the jaws press; called in the owner's thread with every state."""
        if self._is_silent(state.stamp):
            # Here too, so that it ends although nothing else of the program may work.
            self.end("whoever held it is heard no more")
            return
        if self._closing is not None and self._closing.see(state):
            # In a thread of its own, since the owner's must not wait for the check of a path.
            threading.Thread(target=self._keep, args=(state,), name="grip", daemon=True).start()

    def _holds(self) -> bool:
        return self._closing is not None and self._closing.holds

    def _is_silent(self, now: float) -> bool:
        age = self._age()
        if not math.isinf(age):
            return age > self._silence
        # Somebody else ends it, and knows why; but does not have long.
        self._leaving = min(self._leaving, now)
        return now - self._leaving > _FAREWELL

    def _keep(self, state: JointState) -> None:
        """Hold the object with little force instead of closing further."""
        closing = self._closing
        with self._lock:
            if closing is None or self._outcome is not None:
                return
            self._done = self._elapsed()
            # First, since the goal is about to be replaced.
            self._finish(Outcome.SUCCEEDED, "")
        gripper, arm = closing.gripper, self._arm
        target = gripper.grasp(state)
        try:
            for name, controller in arm.controllers.items():
                if gripper.joint.name not in controller.joints:
                    continue
                with arm.owner.locked():
                    now = arm.owner.now()
                    here = dict(zip(controller.joints, controller.start(0.0, state, now).position, strict=True))
                    # The time of the point counts from now, and the robot may have what comes before that.
                    wait = max(0.0, controller.generator.next_start(now) - now)
                goal = here | dict(target.positions)
                back = abs(goal[gripper.joint.name] - here[gripper.joint.name])
                seconds = wait + max(target.duration, _UNHURRIED * back / gripper.joint.max_speed)
                rest = (0.0,) * len(goal)
                point = Point(seconds, tuple(goal.values()), rest, rest)
                relief = TrajectoryGoal(controller.joints, (point,), gives_way=True)
                self._shared.follow(self._orders(), name, relief, None)
        except HexwireError as error:
            _log.warning("the gripper does not hold what it met with little force: %s", error)
            self._arm.cancel(None, self)
        self._on_end(self)


def begin_motion(
    shared: SharedArm,
    orders: Callable[[], Order],
    title: str,
    make: Callable[[], Preview],
    *,
    grip: float | None = None,
    wanted: Callable[[], bool] = lambda: True,
    age: Callable[[], float] = lambda: 0.0,
    silence: float = SILENCE,
    on_end: Callable[[MotionRun], object] = lambda run: None,
) -> MotionRun:
    """Plan a motion from where the arm is now, and begin it; a running motion is replaced.

    Args:
        shared: The arm.
        orders: As for `MotionRun`; one more order is made for the beginning itself.
        title: What it is, for people.
        make: Plans it; called when the arm holds.
        grip: The opening at its end, of a motion of the gripper: 0 is closed, 1 fully open.
        wanted: Asked right before it begins, since planning takes time.
        age: As for `MotionRun`.
        silence: As for `MotionRun`.
        on_end: As for `MotionRun`.

    Raises:
        LeaseError: Whoever asks does not hold the lease.
        GoalError: It may not begin; the text says why.
        HexwireError: As `make`.
    """
    shared.admit(orders())
    for name in shared.arm.controllers:
        shared.arm.hold(name, f"replaced by {title}")
    run = MotionRun(shared, orders, title, make(), grip=grip, age=age, silence=silence, on_end=on_end)
    if not wanted():
        raise GoalError("released before it began", reason=Reason.CANCELLED)
    run.begin()
    return run


def _moves(goal: TrajectoryGoal, path: Trajectory) -> bool:
    """Whether a goal leads anywhere but to where its joints are at the start of the path."""
    start = dict(zip(path.names, path.start, strict=True))
    return any(
        value != start[name]
        for point in goal.points
        for name, value in zip(goal.names, point.positions, strict=True)
    )
