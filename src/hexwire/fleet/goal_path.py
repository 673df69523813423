"""A path that the server of a shared arm follows: sent as one trajectory when it starts.

Owns how a trajectory of the server is a `TimedPath`. Must not know how messages travel.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Protocol

from hexwire.control.goals import MAX_POINTS
from hexwire.control.outcomes import Outcome, Reason
from hexwire.drivers.timed_path import PathReport, PathStart, PathState, TimedPath, TimedPoint
from hexwire.errors import GoalError, UsageError
from hexwire.motion.trajectory import Spline, Waypoint

from . import messages as m

__all__ = ["GoalPath"]

_SOON, _PER_SECOND = 0.4, 0.02
"""Seconds from the order to the start, and more for each second of the path: the server checks all of it before."""
_ATTEMPTS = 3
"""Orders of which each has twice as much time to reach the server."""
_SETTLED = 0.3
"""Seconds after the end of a path until which its server may still wait for the joints to stand still."""


class _Server(Protocol):
    """What a path needs of `RemoteRobot`."""

    def follow(self, path: Spline, start: float, *, anywhere: bool = False) -> int: ...

    def goal(self, number: int) -> m.Goal: ...

    def cancel(self, number: int) -> None: ...

    @property
    def clock_offset(self) -> tuple[float, float]: ...


class GoalPath(TimedPath):
    """A path of one shared arm; made by `RemoteRobot.path`.

    It ends, and the joints come to rest on it, when this program loses the lease.

    Args:
        server: The arm.
        joints: Names.
        now: This program's clock, seconds.
    """

    def __init__(
        self, server: _Server, joints: Sequence[str], *, now: Callable[[], float] = time.monotonic
    ) -> None:
        self.joints, self.lead = tuple(joints), 0.0
        self.capacity = self.request = MAX_POINTS
        self._server, self._now = server, now
        self._points: list[TimedPoint] = []
        self._whole = False
        self._number: int | None = None
        self._began = self._ends = 0.0

    def send(
        self,
        points: Sequence[TimedPoint],
        *,
        last: bool = False,
        first: int | None = None,
        rest: Callable[[TimedPoint], Sequence[TimedPoint]] | None = None,
    ) -> int:
        if self._number is not None:
            raise UsageError("the server of a shared arm takes no points after the start")
        begin = len(self._points) if first is None else first
        if not 0 <= begin <= len(self._points):
            raise UsageError(f"there are {len(self._points)} points; none can be sent as number {begin}")
        del self._points[begin:]
        taken = points[: self.capacity - begin]
        self._points.extend(taken)
        self._whole = last and len(taken) == len(points)
        return len(taken)

    def start(self, at: float | None = None) -> PathStart:
        if not self._whole or len(self._points) < 2:
            raise UsageError(f"the server of a shared arm takes a path of 2 to {self.capacity} points at once")
        path = Spline(self.joints, [Waypoint(p.time, p.positions, p.velocities) for p in self._points])
        soon, attempt = _SOON + _PER_SECOND * path.duration, 1
        while self._number is None:
            begins = self._now() + soon if at is None else at
            try:
                # From where the joints are: under load they rest beside what they were told.
                self._number = self._server.follow(path, begins, anywhere=True)
            except GoalError as error:
                if error.reason != Reason.TOO_LATE.value or at is not None or attempt == _ATTEMPTS:
                    raise
                soon, attempt = 2.0 * soon, attempt + 1
            else:
                self._began, self._ends = begins, begins + path.duration
        _, doubt = self._server.clock_offset
        return PathStart(self._began, doubt)

    def report(self) -> PathReport:
        sent = len(self._points)
        if self._number is None:
            return PathReport(PathState.LOADING, sent, 0, self.capacity - sent, 0)
        state, why = self._state(self._number)
        return PathReport(state, sent, 0, 0, 0, why)

    def _state(self, number: int) -> tuple[PathState, str]:
        try:
            row = self._server.goal(number)
        except GoalError as error:
            return PathState.NONE, str(error)
        now = self._now()
        if row.outcome == Outcome.SUCCEEDED.value:
            return PathState.DONE, ""
        if not row.outcome:
            if now > self._ends + _SETTLED:
                # Where exactly the joints are to be, this program judges itself.
                return PathState.DONE, ""
            return (PathState.RUNNING if now >= self._began else PathState.WAITING), ""
        return (PathState.STOPPED if row.reason == Reason.STOPPED.value else PathState.ABORTED), row.text

    def abort(self) -> PathState:
        if self._number is not None:
            self._server.cancel(self._number)
        return PathState.ABORTED
