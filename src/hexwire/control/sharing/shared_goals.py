"""Trajectories of a shared arm: started at a time of the owner's clock, followed by the owner, checked to the end.

Owns the start time and its confirmation, the report on the motion, and the check of a path without moving. The
owner's controller follows, so that the connection to the client cannot disturb a motion.
"""

from __future__ import annotations

import itertools
import math
import secrets
import threading
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from hexwire.errors import GoalError
from hexwire.motion.trajectory import Spline, Waypoint

from ..loop.outcomes import Reason
from ..motion.goals import TrajectoryGoal, check_goal

if TYPE_CHECKING:
    from hexwire.model.state import JointState

    from ..loop.controller import TrajectoryController
    from ..loop.outcomes import Ended, Outcome
    from ..loop.owner import RobotOwner
    from .shared import Order, SharedArm

__all__ = ["BOARD", "CONFIRM", "HOST", "GoalReport", "SharedGoals"]

BOARD, HOST = "board", "host"
"""Who executes a trajectory: the robot's board, or its server."""
CONFIRM = 0.25
"""Seconds before the start until which a trajectory must be confirmed that begins only then: a board that waits for
the start must still be told that there is none."""

_MOVED = math.radians(0.3)
"""A joint that is farther from where it was at the start has moved: more than the noise of a servo."""
_SOONEST = 0.02
"""Seconds before the start time at which a goal must have been accepted, or the start would be late."""
_LATEST = 600.0
"""Seconds from now in which a start time must lie; a later one is an error of a clock."""
_AHEAD = 8.0
"""Seconds before the start at which a board that executes trajectories gets it; it takes less than 10 s."""
_BEFORE = 0.05
"""Seconds by which a path of the board may start before the time that was asked for; else it is another path."""


_UNCONFIRMED = f"it was not confirmed {CONFIRM:g} s before its start"
_NUMBER_BITS = 52
"""Of the first number: a message holds one of 53 bits."""


@dataclass(slots=True)
class GoalReport:
    """What became of a trajectory. Times are seconds of the owner's clock.

    Attributes:
        number: Its number.
        start: When it was to begin.
        outcome: How it ended; None while it is active.
        reason: Why it ended; None while it is active.
        text: Why it ended, in words; empty after a success.
        moved: When a joint had moved by 0.3 deg, interpolated between two samples; None before.
        slips: Stalls of the owner by which the trajectory was shifted.
        ready: Who will execute it, `BOARD` or `HOST`; empty until everything is prepared for the start.
        doubt: How far off the start may be: the uncertainty of the board's clock; without such a board, the period
            of targets, by which the first one may be late.
    """

    number: int
    start: float
    outcome: Outcome | None = None
    reason: Reason | None = None
    text: str = ""
    moved: float | None = None
    slips: int = 0
    ready: str = ""
    doubt: float = 0.0


class _Goal:
    """The listener of one trajectory.

    Attributes:
        confirmed: It may begin.
        off: Why it was called off; empty if it was not.
    """

    def __init__(
        self, report: GoalReport, controller: TrajectoryController, owner: RobotOwner, *, confirmed: bool
    ) -> None:
        self.report, self.confirmed, self.off = report, confirmed, ""
        self._controller, self._owner = controller, owner
        self._slips = controller.generator.counters.slips
        # Joint -> position at the start, time and distance of its last sample.
        self._from: dict[str, tuple[float, float, float]] = {}

    def ended(self, ended: Ended) -> None:
        self.report.reason, self.report.text = ended.reason, self.off or ended.text
        # Last: a reader that sees it reads the others.
        self.report.outcome = ended.outcome

    def prepare(self) -> None:
        """Note who executes it, and how well the start is known. Between two cycles of the controllers."""
        report, generator, given = self.report, self._controller.generator, self._owner.path_start
        if generator.onboard and given is not None and given.time > report.start - _BEFORE:
            report.doubt, report.ready = given.uncertainty, BOARD
        elif not generator.settled or not (self._controller.waiting or generator.onboard):
            report.doubt, report.ready = self._owner.command_period, HOST

    def see(self, state: JointState) -> None:
        """Detect the first movement in a state."""
        report = self.report
        report.slips = self._controller.generator.counters.slips - self._slips
        if report.moved is not None:
            return
        for name in self._controller.joints:
            joint = state[name]
            sampled = state.stamp - joint.age
            if not math.isfinite(joint.position + sampled):
                # The joint is silent.
                continue
            if sampled <= report.start or name not in self._from:
                self._from[name] = joint.position, sampled, 0.0
                continue
            origin, before, least = self._from[name]
            distance = abs(joint.position - origin)
            if distance > _MOVED:
                share = (_MOVED - least) / (distance - least)
                # The joint was at rest until the start, although the sample before may be long ago.
                before = max(before, report.start)
                report.moved = before + share * (sampled - before)
                return
            self._from[name] = origin, sampled, distance


class SharedGoals:
    """Any thread may call its methods.

    Args:
        shared: The arm.
    """

    def __init__(self, shared: SharedArm) -> None:
        self._shared, self._arm = shared, shared.arm
        self._newest: _Goal | None = None
        # Neither another program's goal nor one of a server before has the same number.
        self._numbers = itertools.count(secrets.randbits(_NUMBER_BITS))
        self._lock = threading.Lock()
        shared.arm.owner.observe(self._see)

    def close(self) -> None:
        """Stop observing the arm."""
        self._arm.owner.observe(self._see, on=False)

    def check(self, order: Order, goal: TrajectoryGoal) -> float:
        """Check the path of a trajectory from its own first point, as before its motion; nothing moves.

        Returns:
            Its duration, seconds.

        Raises:
            LeaseError: The sender does not hold the lease.
            GoalError: It is not allowed.
        """
        self._shared.admit(order)
        controller = self._arm.controllers[self._controller(goal)]
        check_goal(goal, controller.joints, allow_partial=True)
        if not goal.points or goal.points[0].time:
            raise GoalError("the first point must be the start, at 0 s", reason=Reason.MALFORMED)
        here = self._arm.owner.newest().positions
        points = [Waypoint(p.time, p.positions, p.velocities or None, p.accelerations or None) for p in goal.points]
        path = Spline(goal.names, points)
        with self._shared.explaining(order):
            self._shared.path_check.trajectory(
                path,
                {**here, **dict(zip(goal.names, path.start, strict=True))},
                wanted=lambda: self._shared.is_wanted(order),
            )
        return path.duration

    def follow(self, order: Order, goal: TrajectoryGoal, start: float, *, confirm: bool = False) -> int:
        """Follow a trajectory from a time on; it is not begun at another time.

        A board that executes trajectories gets it, and the order to start, as soon as possible; see
        `GoalReport.ready`.

        Args:
            order: Proof that it may be done.
            goal: The trajectory; its delay is not used.
            start: When it begins, seconds of the owner's clock.
            confirm: It begins only if `confirm` is called `CONFIRM` seconds before that.

        Returns:
            Its number, for `report`, `confirm` and `cancel`; no other goal has it.

        Raises:
            LeaseError: The sender does not hold the lease.
            StoppedError: The arm was stopped since.
            GoalError: It is refused, and nothing changes: TOO_LATE if the time has come, also during its check.
        """
        now = self._shared.now()
        if not now < start < now + _LATEST:
            why = f"is {now - start:.3f} s ago" if start <= now else f"is more than {_LATEST:g} s ahead"
            raise GoalError(f"the start time {why}; measure the clock again", reason=Reason.TOO_LATE)
        name = self._controller(goal)
        number = next(self._numbers)
        one = _Goal(GoalReport(number, start), self._arm.controllers[name], self._arm.owner, confirmed=not confirm)
        goal = replace(goal, delay=start - now, early=_AHEAD)
        latest = start - _SOONEST - (CONFIRM if confirm else 0.0)
        self._shared.follow(order, name, goal, one, received=now, latest=latest)
        with self._lock:
            self._newest = one
        return number

    def confirm(self, order: Order, number: int) -> None:
        """Let a trajectory begin that waits for this.

        Raises:
            LeaseError: The sender does not hold the lease.
            GoalError: It is not ready, has ended, or will not begin, since it is too late for that.
        """
        self._shared.admit(order)
        with self._lock:
            one = self._newest
            if one is None or one.report.number != number:
                raise GoalError(f"there is no goal {number}", reason=Reason.REPLACED)
            if one.report.outcome or one.off:
                raise GoalError(one.off or one.report.text or "it has ended", reason=Reason.CANCELLED)
            if not one.report.ready:
                raise GoalError("it is not ready to begin", reason=Reason.NOT_READY)
            if self._is_late(one):
                raise GoalError(_UNCONFIRMED, reason=Reason.TOO_LATE)
            one.confirmed = True

    def cancel(self, order: Order, number: int) -> None:
        """End a trajectory that is active or waits for its start: the joints hold. Without effect after its end."""
        self._shared.admit(order)
        one = self._newest
        if one is not None and one.report.number == number:
            self._arm.owner.group.cancel(one)

    def report(self, number: int) -> GoalReport | None:
        """What became of a trajectory; None unless it is the newest one."""
        one = self._newest
        return one.report if one is not None and one.report.number == number else None

    def _see(self, state: JointState) -> None:
        one = self._newest
        if one is None or one.report.outcome:
            return
        if self._shared.now() < one.report.start:
            one.prepare()
        one.see(state)
        with self._lock:
            late = self._is_late(one)
            if late:
                one.off = _UNCONFIRMED
        if late:
            self._arm.owner.group.cancel(one)

    def _is_late(self, one: _Goal) -> bool:
        """Whether it must not begin, since nobody has confirmed it in time. Under the lock."""
        return not one.confirmed and self._shared.now() >= one.report.start - CONFIRM

    def _controller(self, goal: TrajectoryGoal) -> str:
        for name, controller in self._arm.controllers.items():
            if set(goal.names) <= set(controller.joints):
                return name
        known = "; ".join(f"{name}: {', '.join(c.joints)}" for name, c in self._arm.controllers.items())
        raise GoalError(
            f"no controller moves all of {', '.join(goal.names)}; there are {known.removeprefix(': ')}",
            reason=Reason.WRONG_JOINTS,
        )
