"""The controllers of one arm, as several threads use them.

Owns the lock around them, and that goals hear of their end outside of it. Must not know robots, clocks or threads.
"""

from __future__ import annotations

import threading
from collections.abc import Collection, Iterable, Sequence
from typing import TYPE_CHECKING, Protocol

from hexwire.model.state import JointTarget
from hexwire.motion.safety import StopReason

if TYPE_CHECKING:
    from hexwire.model.state import JointState
    from hexwire.motion.fence import Fence

    from .outcomes import Ended, GoalListener

__all__ = ["Controller", "ControllerGroup"]


class Controller(Protocol):
    """What decides where some joints of an arm go. Time comes in as an argument, seconds; angles are radians."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names."""

    @property
    def busy(self) -> bool:
        """It sends its joints somewhere, or will, or somebody still waits for the end of that."""

    @property
    def moving(self) -> bool:
        """It sends its joints somewhere."""

    @property
    def reason(self) -> StopReason | None:
        """Why it is stopped, or None."""

    def judge(self, state: JointState, velocity: Sequence[float], now: float) -> None:
        """Compare a state that was just read with what was meant; velocities are those of all the arm's joints."""

    def cycle(self, state: JointState, now: float, lead: float) -> JointTarget | StopReason | None:
        """What to send now, for so many seconds ahead; or why to stop the arm; or None to leave it alone."""

    def stop(self, reason: StopReason) -> None:
        """Latch a stop."""

    def reset(self) -> None:
        """End a stop. Nothing moves by it."""

    def release(self, why: str) -> None:
        """The joints are no longer held: what was commanded is forgotten."""

    def take_ended(self) -> list[tuple[GoalListener, Ended]]:
        """Goals that have ended since the last call."""


class ControllerGroup:
    """Does to all controllers, or some, what one of them can do.

    Attributes:
        members: The controllers; no joint is in two of them.
        lock: Guards them. Nobody waits or calls out while holding it.
        fence: Where the arm as a whole must not be sent, whoever's joints take it there; None for nowhere.
        stops: How often a stop was asked for or found necessary, whether one was latched already or not.
    """

    def __init__(self, members: Sequence[Controller] = ()) -> None:
        self.members = members
        self.lock = threading.RLock()
        self.fence: Fence | None = None
        self.stops = 0

    @property
    def busy(self) -> bool:
        """One of them is."""
        return any(controller.busy for controller in self.members)

    @property
    def moving(self) -> bool:
        """One of them sends its joints somewhere."""
        return any(controller.moving for controller in self.members)

    @property
    def reason(self) -> StopReason | None:
        """Why the arm is stopped, or None."""
        return next((c.reason for c in self.members if c.reason), None)

    @property
    def blamed(self) -> frozenset[str]:
        """Joints that stops are blamed on."""
        return frozenset(c.reason.joint for c in self.members if c.reason)

    def cycle(
        self, state: JointState, speeds: Sequence[float], now: float, lead: float, *, due: bool
    ) -> JointTarget | StopReason | None:
        """Judge all; if one is due, a cycle of all.

        Args:
            state: Just read.
            speeds: Of the arm's joints, radians per second; NaN where it is not known.
            now: Seconds.
            lead: Seconds ahead for which a target is sent.
            due: It is time for a target.

        Returns:
            What to write; or the first reason to stop the arm, and then all are stopped; None to leave it alone.
        """
        orders: list[JointTarget | StopReason | None] = []
        with self.lock:
            for controller in self.members:
                controller.judge(state, speeds, now)
                if due:
                    orders.append(controller.cycle(state, now, lead))
            targets = [order for order in orders if isinstance(order, JointTarget)]
            positions = tuple(pair for target in targets for pair in target.positions)
            reason = next((order for order in orders if isinstance(order, StopReason)), None)
            if reason is None and due:
                reason = self._outside(state, positions)
            if reason is not None:
                self._stop(reason)
        self.deliver()
        if reason is not None:
            return reason
        if len(targets) == 1:
            return targets[0]
        return JointTarget(positions, max(target.duration for target in targets)) if positions else None

    def _outside(self, state: JointState, target: Iterable[tuple[str, float]]) -> StopReason | None:
        """Each controller checks its own way, with the joints of the others where they were then."""
        found = self.fence.follow(state.positions, dict(target)) if self.fence is not None else ""
        return StopReason("fence", found) if found else None

    def stop(self, reason: StopReason) -> None:
        """Latch a stop of all."""
        with self.lock:
            self._stop(reason)
        self.deliver()

    def reset(self, stops: int) -> bool:
        """End a stop of all, unless there was another one.

        Args:
            stops: What `stops` was when the reset was asked for.

        Returns:
            False if there was another stop since: it stays.
        """
        with self.lock:
            if self.stops != stops:
                return False
            for controller in self.members:
                controller.reset()
            return True

    def release(self, why: str, joints: Collection[str] | None = None) -> None:
        """What was commanded means nothing now; goals under way are aborted.

        Args:
            why: For those who wait for the goals.
            joints: Only controllers of one of these; all if None.
        """
        with self.lock:
            for controller in self.members:
                if joints is None or not set(joints).isdisjoint(controller.joints):
                    controller.release(why)
            self._forget()
        self.deliver()

    def deliver(self) -> None:
        """Tell goals how they ended; never under the lock, since who is told may take locks of its own."""
        with self.lock:
            ended = [row for controller in self.members for row in controller.take_ended()]
        for listener, end in ended:
            listener.ended(end)

    def _forget(self) -> None:
        if self.fence is not None:
            self.fence.forget()

    def _stop(self, reason: StopReason) -> None:
        self.stops += 1
        self._forget()
        for controller in self.members:
            controller.stop(reason)
