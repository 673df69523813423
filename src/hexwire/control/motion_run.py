"""One motion that a person began: followed by the controllers, watched while it runs, ended when nobody wants it.

Owns its beginning, its progress and its end, for all controllers together; that it ends in the owner's own cycle
when signs of life stop; and that a closing gripper does not crush what it meets. Must not know who began it, nor
how a person keeps it alive.
"""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hexwire.errors import GoalError, HexwireError

from .attended import SILENCE
from .goals import Point, TrajectoryGoal
from .holding import SOON, hold_moving
from .outcomes import Outcome, Reason
from .preview import goal_of

if TYPE_CHECKING:
    from hexwire.drivers.tools import Gripper
    from hexwire.model.state import JointState
    from hexwire.motion.waypoints import Trajectory

    from .outcomes import Ended
    from .preview import Preview
    from .shared import Order, SharedArm

__all__ = ["Grip", "MotionRun", "Progress", "begin_motion"]

_log = logging.getLogger(__name__)

_FAREWELL = 0.1
"""Seconds that whoever ends it has, before it ends by itself."""
_PRESSED = 3
_PRESSING = 0.1
"""Successive states and seconds in which the jaws press: the start of the motion takes effort too."""
_STILL = math.radians(0.3)
"""How far the jaws may move meanwhile: a board's states need not have a velocity that would show it."""
_UNHURRIED = 3.0
"""The time of a relief over the shortest at the greatest speed: it begins while the joint is planned to close."""


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a motion is.

    Attributes:
        title: What it is, for people.
        elapsed: Seconds of it that are over.
        duration: Seconds of all of it.
        lead_in: Seconds at its start in which the arm only moves to where it begins.
        outcome: As `Outcome`; empty while it runs.
        text: Why it ended, in words; empty after a success.
        holds: The gripper met an object, and holds it.
        off: After a success, how far off the goal joints have come to rest, in words; empty if they have not.
    """

    title: str
    elapsed: float
    duration: float
    lead_in: float
    outcome: str = ""
    text: str = ""
    holds: bool = False
    off: str = ""


@dataclass(frozen=True, slots=True)
class Grip:
    """A motion of the gripper.

    Attributes:
        gripper: The gripper.
        share: Opening at its end: 0 is closed, 1 fully open.
    """

    gripper: Gripper
    share: float


class MotionRun:
    """One motion. Made by `begin_motion`; any thread may call its methods.

    Args:
        shared: The arm.
        orders: Makes an order of whoever began it; called for each controller.
        title: What it is, for people.
        plan: What it does.
        grip: It is a motion of the gripper.
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
        grip: Grip | None = None,
        age: Callable[[], float] = lambda: 0.0,
        silence: float = SILENCE,
        on_end: Callable[[MotionRun], object] = lambda run: None,
    ) -> None:
        self._age, self._silence, self._leaving = age, silence, math.inf
        self._shared, self._arm, self._orders = shared, shared.arm, orders
        self._title, self._plan, self._path = title, plan, plan.require()
        self._grip, self._on_end = grip, on_end
        self._lock = threading.Lock()
        self._outcome: Outcome | None = None
        self._text, self._off, self._done = "", "", 0.0
        # Controllers that have not reached their goals.
        self._waiting = 0
        # Successive states in which the jaws pressed, while they close, and the time of the first.
        self._pressed, self._pressing, self._closing, self._holds = 0, 0.0, False, False
        self._pressed_at = math.nan

    @property
    def over(self) -> bool:
        """It has ended."""
        return self._outcome is not None

    def progress(self) -> Progress:
        """How far it is."""
        duration, lead = self._plan.duration, self._plan.lead_in
        if self._outcome is None:
            self._done = self._elapsed()
            return Progress(self._title, self._done, duration, lead, holds=self._holds)
        done = duration if self._outcome is Outcome.SUCCEEDED else self._done
        return Progress(self._title, done, duration, lead, self._outcome.value, self._text, self._holds, self._off)

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
        self._cancel()
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
            text = ended.text
            if ended.outcome is Outcome.SUCCEEDED:
                if text:
                    self._off = f"{self._off}; {text}" if self._off else text
                    text = ""
                self._waiting -= 1
                if self._waiting > 0:
                    return
            self._done = self._elapsed()
            self._finish(ended.outcome, text)
        # If one controller fails, the others must not go on.
        self._cancel()
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
        self._waiting = len(moving)
        if self._grip is not None:
            state = arm.owner.newest()
            self._closing = self._grip.share < self._grip.gripper.share(state)
        # A new list, since the owner's thread may be going through the old one.
        arm.owner.observers = [*arm.owner.observers, self._see]
        try:
            for name, goal in moving.items():
                self._shared.follow(self._orders(), name, goal, self)
        except BaseException as error:
            with self._lock:
                self._finish(Outcome.ABORTED, str(error))
            self._cancel()
            raise

    # -- helpers --------------------------------------------------------------------------------------

    def _elapsed(self) -> float:
        owner = self._arm.owner
        now = owner.now()
        left = max((c.follower.remaining(now) for c in self._arm.controllers.values()), default=0.0)
        return max(0.0, self._plan.duration - left)

    def _finish(self, outcome: Outcome, text: str) -> None:
        """Note the end; the caller has the lock."""
        self._outcome, self._text = outcome, text
        owner = self._arm.owner
        owner.observers = [observer for observer in owner.observers if observer != self._see]

    def _cancel(self) -> None:
        for name in self._arm.controllers:
            self._arm.cancel(name, self)

    def _see(self, state: JointState) -> None:
        """Look for signs of life, and whether the jaws press; called in the owner's thread with every state."""
        if self._is_silent(state.stamp):
            # Here too, so that it ends although nothing else of the program may work.
            self.end("no sign of life")
            return
        grip = self._grip
        if grip is None or not self._closing or self._holds:
            return
        if not grip.gripper.holds(state, grip.share):
            self._pressed = 0
            return
        at = state[grip.gripper.joint.name].position
        if not self._pressed or abs(at - self._pressed_at) > _STILL:
            self._pressed, self._pressing, self._pressed_at = 0, state.stamp, at
        self._pressed += 1
        if self._pressed >= _PRESSED and state.stamp - self._pressing >= _PRESSING:
            self._holds = True
            # In a thread of its own, since the owner's must not wait for the check of a path.
            threading.Thread(target=self._keep, args=(state,), name="grip", daemon=True).start()

    def _is_silent(self, now: float) -> bool:
        age = self._age()
        if not math.isinf(age):
            return age > self._silence
        # Somebody else ends it, and knows why; but does not have long.
        self._leaving = min(self._leaving, now)
        return now - self._leaving > _FAREWELL

    def _keep(self, state: JointState) -> None:
        """Hold the object with little force instead of closing further."""
        grip = self._grip
        with self._lock:
            if grip is None or self._outcome is not None:
                return
            self._done = self._elapsed()
            # First, since the goal is about to be replaced.
            self._finish(Outcome.SUCCEEDED, "")
        target, arm = grip.gripper.grasp(state), self._arm
        try:
            for name, controller in arm.controllers.items():
                if grip.gripper.joint.name not in controller.joints:
                    continue
                with arm.owner.locked():
                    now = arm.owner.now()
                    here = dict(zip(controller.joints, controller.start(0.0, state, now).position, strict=True))
                    # The time of the point counts from now, and the robot may have what comes before that.
                    wait = max(0.0, controller.follower.next_start(now) - now)
                goal = here | dict(target.positions)
                back = abs(goal[grip.gripper.joint.name] - here[grip.gripper.joint.name])
                seconds = wait + max(target.duration, _UNHURRIED * back / grip.gripper.joint.max_speed)
                rest = (0.0,) * len(goal)
                point = Point(seconds, tuple(goal.values()), rest, rest)
                relief = TrajectoryGoal(controller.joints, (point,), gives_way=True)
                self._shared.follow(self._orders(), name, relief, None)
        except HexwireError as error:
            _log.warning("the gripper does not hold what it met with little force: %s", error)
            self._cancel()
        self._on_end(self)


def begin_motion(
    shared: SharedArm,
    orders: Callable[[], Order],
    title: str,
    make: Callable[[], Preview],
    *,
    grip: Grip | None = None,
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
        grip: It is a motion of the gripper.
        wanted: Asked right before it begins, since planning takes time.
        age: As for `MotionRun`.
        silence: Likewise.
        on_end: Likewise.

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
