"""The controllers of one arm, protected for use by several threads.

Owns their lock, and notifying listeners outside of it. Must not know robots, clocks or threads.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Collection, Iterable, Sequence
from typing import TYPE_CHECKING, Protocol

from hexwire.model.state import JointTarget
from hexwire.motion.safety import StopReason

if TYPE_CHECKING:
    from hexwire.model.state import JointState

    from .outcomes import Ended, GoalListener
    from .path_check import PathCheck

__all__ = ["Controller", "ControllerGroup"]

_log = logging.getLogger(__name__)


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

    def release(self, why: str) -> None:
        """Forget the set-points, since the joints are no longer held."""

    def take_ended(self) -> list[tuple[GoalListener, Ended]]:
        """Goals that have ended since the last call."""


class ControllerGroup:
    """Applies operations to all controllers, or to some.

    Attributes:
        members: The controllers; no joint belongs to two of them.
        lock: Guards them. Do not block or call listeners while holding it.
        check: Checks the combined targets of all controllers; None for no check.
        stops: Number of stops, including those while one was latched.
    """

    def __init__(self, members: Sequence[Controller] = (), check: PathCheck | None = None) -> None:
        self.members = members
        self.lock = threading.RLock()
        self.check = check
        self.stops = 0

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
        """Why the arm is stopped, or None."""
        return next((c.reason for c in self.members if c.reason), None)

    @property
    def blamed(self) -> frozenset[str]:
        """Joints that caused the stops."""
        return frozenset(c.reason.joint for c in self.members if c.reason)

    def cycle(
        self, state: JointState, speeds: Sequence[float], now: float, lead: float, *, due: bool
    ) -> JointTarget | StopReason | None:
        """Pass a state to all controllers; if a target is due, run one cycle of each.

        Args:
            state: Just read.
            speeds: Velocities of the arm's joints, radians per second; NaN if unknown.
            now: Seconds.
            lead: Duration of a target, seconds.
            due: A target is due.

        Returns:
            The target to write; or the first reason to stop the arm, after stopping all controllers; or None.
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
        found = self.check.running(state.positions, dict(target)) if self.check is not None else ""
        return StopReason("fence", found) if found else None

    def stop(self, reason: StopReason) -> None:
        """Latch a stop of all controllers."""
        with self.lock:
            self._stop(reason)
        self.deliver()

    def see_stop(self, reason: StopReason) -> None:
        """Latch a stop that the robot tells of. If one is latched it is the same one: it does not count again."""
        with self.lock:
            if self.reason is None:
                self._stop(reason)
        self.deliver()

    def reset(self, stops: int) -> bool:
        """Clear the stop of all controllers, unless there was another one.

        Args:
            stops: `stops` at the time of the request.

        Returns:
            False if there was another stop since; it stays latched.
        """
        with self.lock:
            if self.stops != stops:
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
        self.deliver()

    def void(self) -> None:
        """Count a stop that has been carried out already, so that it voids what was asked for since."""
        with self.lock:
            self.stops += 1

    def deliver(self) -> None:
        """Notify the listeners of ended goals; without the lock, since a listener may take other locks."""
        with self.lock:
            ended = [row for controller in self.members for row in controller.take_ended()]
        for listener, end in ended:
            try:
                listener.ended(end)
            except Exception:  # noqa: BLE001  # a stop of the robot comes after this, and must come
                _log.exception("a listener of a goal failed")

    def _forget(self) -> None:
        if self.check is not None:
            self.check.forget()

    def _stop(self, reason: StopReason) -> None:
        self.stops += 1
        self._forget()
        for controller in self.members:
            controller.stop(reason)
