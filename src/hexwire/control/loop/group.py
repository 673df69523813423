"""The controllers of one arm, protected for use by several threads.

Owns their lock, how a stop reaches them that waits for nobody, and notifying listeners outside of the lock. Must
not know robots, clocks or threads.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Collection, Iterable, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Protocol

from hexwire.epochs import Epochs
from hexwire.model.state import JointTarget
from hexwire.motion.safety import StopReason

if TYPE_CHECKING:
    from hexwire.epochs import Token
    from hexwire.model.state import JointState

    from ..motion.path_check import PathCheck
    from .outcomes import Ended, GoalListener

__all__ = ["Controller", "ControllerGroup", "ControllerLock", "Goalless"]

_log = logging.getLogger(__name__)

_PATIENCE = 0.5
"""Seconds for which a stop that was sent waits for the lock; later, whoever has it stops the controllers."""


class Controller(Protocol):
    """Decides the motion of some joints of an arm. Times are arguments in seconds; angles are in radians."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names."""

    @property
    def busy(self) -> bool:
        """A motion is active or planned, or its end is still to be confirmed."""

    @property
    def moving(self) -> bool:
        """A motion is active."""

    @property
    def reason(self) -> StopReason | None:
        """Why it is stopped, or None."""

    def judge(self, state: JointState, velocity: Sequence[float], now: float) -> None:
        """Compare a new state with the desired one; velocities are those of all joints of the arm."""

    def cycle(self, state: JointState, now: float, lead: float) -> JointTarget | StopReason | None:
        """The target to send now, with a duration of `lead`; or a reason to stop the arm; or None."""

    def stop(self, reason: StopReason) -> None:
        """Latch a stop."""

    def reset(self) -> None:
        """Clear a stop. Nothing moves."""

    def brake(self, why: str) -> bool:
        """Bring the joints to rest within their limits, if it can; returns whether they still move."""

    def release(self, why: str) -> None:
        """Forget the set-points, since the joints are no longer held."""

    def cancel(self, listener: GoalListener) -> None:
        """Hold, if the active goal is this listener's."""

    def take_ended(self) -> list[tuple[GoalListener, Ended]]:
        """Goals that have ended since the last call."""


class Goalless:
    """What controllers share that have no goals of clients: nobody hears of their end, and they latch no stop."""

    reason: StopReason | None = None

    def judge(self, state: JointState, velocity: Sequence[float], now: float) -> None:
        """Do nothing: a person, or who asked for the motion, watches it."""

    def reset(self) -> None:
        """Do nothing: an ended motion does not continue."""

    def cancel(self, listener: GoalListener) -> None:
        """There are no goals."""

    def take_ended(self) -> list[tuple[GoalListener, Ended]]:
        """There are no goals."""
        return []


class ControllerLock:
    """A re-entrant lock: who takes it finds no controller that a stop has not reached, and leaves none.

    Args:
        reach: Brings the controllers to a stop that was announced, if there is one. Called with the lock held.
    """

    def __init__(self, reach: Callable[[], object]) -> None:
        self._lock, self._depth, self._reach = threading.RLock(), 0, reach

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        """As `threading.RLock.acquire`."""
        if not self._lock.acquire(blocking, timeout):
            return False
        self._depth += 1
        try:
            self._reach()
        except BaseException:
            self._leave()
            raise
        return True

    __enter__ = acquire

    def release(self) -> None:
        """As `threading.RLock.release`."""
        try:
            # What was done after the stop was announced must not outlast it.
            if self._depth == 1:
                self._reach()
        finally:
            self._leave()

    def _leave(self) -> None:
        self._depth -= 1
        self._lock.release()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()


class ControllerGroup:
    """Applies operations to all controllers, or to some.

    Attributes:
        members: The controllers; no joint belongs to two of them.
        lock: Guards them. Do not block or call listeners while holding it.
        check: Checks the combined targets of all controllers; None for no check.
        epochs: The stops of the arm: one that the controllers learn of voids what was asked for before it.
    """

    def __init__(
        self, members: Sequence[Controller] = (), check: PathCheck | None = None, epochs: Epochs | None = None
    ) -> None:
        self.members = members
        self.lock = ControllerLock(self._reach)
        self.check = check
        self.epochs = epochs or Epochs()
        # Held for moments only, so a stop never waits for it; re-entrant, since a signal handler may stop the arm.
        self._announcing = threading.RLock()
        # The reason of a stop that was announced and has not reached the controllers yet.
        self._announced: StopReason | None = None

    @property
    def busy(self) -> bool:
        """A controller is busy."""
        return any(controller.busy for controller in self.members)

    @property
    def moving(self) -> bool:
        """A controller is moving its joints."""
        return any(controller.moving for controller in self.members)

    @property
    def reason(self) -> StopReason | None:
        """Why the arm is stopped, or is about to be, or None."""
        # In this order: one that reaches the controllers meanwhile is found there.
        if (announced := self._announced) is not None:
            return announced
        for controller in self.members:
            if (reason := controller.reason) is not None:
                return reason
        return None

    @property
    def blamed(self) -> frozenset[str]:
        """Joints that caused the stops."""
        announced = self._announced
        reasons = [announced, *(c.reason for c in self.members)]
        return frozenset(reason.joint for reason in reasons if reason)

    def cycle(
        self, state: JointState, speeds: Sequence[float] | None, now: float, lead: float, *, due: bool
    ) -> JointTarget | StopReason | None:
        """Pass a state to all controllers; if a target is due, run one cycle of each.

        Args:
            state: Just read.
            speeds: Velocities of the arm's joints, radians per second; NaN if unknown. None if the controllers have
                judged this state before.
            now: Seconds.
            lead: Duration of a target, seconds.
            due: A target is due.

        Returns:
            The target to write; or the first reason to stop the arm, after stopping all controllers; or None.
        """
        targets: list[JointTarget] = []
        reason: StopReason | None = None
        with self.lock:
            for controller in self.members:
                if speeds is not None:
                    controller.judge(state, speeds, now)
                if due and (order := controller.cycle(state, now, lead)) is not None:
                    if isinstance(order, JointTarget):
                        targets.append(order)
                    else:
                        reason = reason or order
            if reason is None and due:
                reason = self._outside(state, targets)
            if reason is not None:
                self._stop(reason)
            ended = self._take_ended()
        _tell(ended)
        if reason is not None:
            return reason
        if len(targets) < 2:
            return targets[0] if targets else None
        positions = tuple(pair for target in targets for pair in target.positions)
        laws = tuple(pair for target in targets for pair in target.laws)
        guided = all(target.guided for target in targets)
        return JointTarget(positions, max(target.duration for target in targets), laws, guided)

    def _outside(self, state: JointState, targets: Sequence[JointTarget]) -> StopReason | None:
        if self.check is None:
            return None
        where = {name: angle for target in targets for name, angle in target.positions}
        # An arm at rest is told so, wherever it is.
        found = self.check.running(state.positions if where else {}, where)
        return StopReason("fence", found) if found else None

    def announce(self, reason: StopReason) -> None:
        """Announce a stop: it voids what was asked for before. Waits for nobody; `settle` must follow."""
        with self._announcing:
            self.epochs.void()
            if self._announced is None:
                self._announced = reason

    def settle(self) -> None:
        """Latch an announced stop of all controllers; if their lock is not free, whoever has it does that."""
        if self.lock.acquire(timeout=_PATIENCE):
            try:
                ended = self._take_ended()
            finally:
                self.lock.release()
            _tell(ended)
        else:
            _log.error("the controllers are busy: they are stopped when that is over; the robot was told to stop")

    def stop(self, reason: StopReason) -> None:
        """Latch a stop of all controllers. A robot that must stop, too, is told between `announce` and `settle`."""
        self.announce(reason)
        self.settle()

    def see_stop(self, reason: StopReason) -> None:
        """Latch a stop that the robot tells of. If one is latched it is the same one: it does not count again."""
        with self.lock:
            if self.reason is None:
                self._stop(reason)
        self.deliver()

    def reset(self, asked: Token) -> bool:
        """Clear the stop of all controllers, unless there was another one.

        Args:
            asked: The time of the request, a mark of `epochs`.

        Returns:
            False if there was another stop since; it stays latched.
        """
        with self.lock:
            if self.epochs.stopped_since(asked):
                return False
            for controller in self.members:
                controller.reset()
            return True

    def release(self, why: str, joints: Collection[str] | None = None) -> None:
        """Forget set-points; active goals are aborted.

        Args:
            why: Reason for the listeners of the goals.
            joints: Only controllers with one of these joints; all if None.
        """
        with self.lock:
            for controller in self.members:
                if joints is None or not set(joints).isdisjoint(controller.joints):
                    controller.release(why)
            self._forget()
            ended = self._take_ended()
        _tell(ended)

    def brake(self, why: str) -> frozenset[str]:
        """End all motions within the limits of the joints, where a controller can; goals are aborted.

        Args:
            why: Reason for the listeners of the goals.

        Returns:
            Joints that brake; their controllers send targets until they rest.
        """
        with self.lock:
            braking = [controller.joints for controller in self.members if controller.brake(why)]
            if not braking:
                self._forget()
        self.deliver()
        return frozenset(name for joints in braking for name in joints)

    def cancel(self, listener: GoalListener) -> None:
        """Have each controller hold whose active goal is this listener's."""
        with self.lock:
            for controller in self.members:
                controller.cancel(listener)
        self.deliver()

    def deliver(self) -> None:
        """Notify the listeners of ended goals; without the lock, since a listener may take other locks."""
        with self.lock:
            ended = self._take_ended()
        _tell(ended)

    def _take_ended(self) -> list[tuple[GoalListener, Ended]]:
        ended: list[tuple[GoalListener, Ended]] = []
        for controller in self.members:
            ended += controller.take_ended()
        return ended

    def _forget(self) -> None:
        if self.check is not None:
            self.check.forget()

    def _stop(self, reason: StopReason) -> None:
        self.announce(reason)
        self._reach()

    def _reach(self) -> None:
        while (reason := self._announced) is not None:
            self._forget()
            for controller in self.members:
                controller.stop(reason)
            # Another one that came meanwhile has found all of them stopped.
            self._announced = None


def _tell(ended: Iterable[tuple[GoalListener, Ended]]) -> None:
    for listener, end in ended:
        try:
            listener.ended(end)
        except Exception:  # noqa: BLE001  # the others must be told as well
            _log.exception("a listener of a goal failed")
