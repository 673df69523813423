"""A trajectory of which the robot keeps the time: sent ahead, and watched as if it were sent target by target.

Owns what is sent when, and what the reports of the robot mean for the motion. Must not know which program moves,
nor how a robot follows a path.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

from hexwire.drivers.timed_path import REST_POINTS, PathState, TimedPath, TimedPoint
from hexwire.errors import CommandRefusedError, DeviceError, HexwireError, PreemptedError, StoppedError, UsageError
from hexwire.motion.path_points import path_points
from hexwire.motion.safety import STOP_COMMAND, StopReason, board_stop

from .path_brake import PathBrake

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.drivers.timed_path import PathStart
    from hexwire.epochs import Token
    from hexwire.motion.waypoints import Trajectory

    from .owner import RobotOwner

__all__ = ["PathFeed", "begin_feed"]

_log = logging.getLogger(__name__)

_FIRST, _NEXT = 24, 12
"""Points that are sent before the start, and at most in one turn after it."""
_LONGEST, _SHORTEST = 0.05, 0.01
"""Seconds between two points; further apart where turns are rare."""
_AHEAD = 2.0
"""Turns for which the points on the robot must last."""
_LOOK = 0.1
"""Seconds between two questions where the path is, when all points are sent."""
_REST = 5.0
"""Most seconds that a path needs to come to rest."""
_TRANSIT = 0.04
"""Seconds until points that are sent now count: an exchange, and what the clocks may be apart."""
_WHY = {
    PathState.DRY: "the board came to rest on its path, because this program was too slow to send the next points",
    PathState.ABORTED: "another program has ended the path on the board",
    PathState.FAULT: "a joint lost its torque or does not answer; the others came to rest on the path",
    PathState.NONE: "the board was reset, or another program began another path",
}


class PathFeed:
    """Sends one trajectory ahead to a robot that keeps the time itself. One thread makes all calls.

    Args:
        robot: Attached; `times_motion`.
        trajectory: Checked.
        outlives: As in `RobotDriver.path`.
        period: Seconds between two turns: what is sent in one lasts for several.
        apart: Seconds between two points, and all of them are sent before the start; if None, they are as close
            as the trajectory needs, and are sent while it runs.

    Attributes:
        start: When it starts; set by `begin`.
        ordered: The start was sent, so that the robot may move, whether or not it has answered.
        stopped: A stop of the arm has ended it.
    """

    start: PathStart

    def __init__(
        self,
        robot: RobotDriver,
        trajectory: Trajectory,
        *,
        outlives: bool = False,
        period: float = 0.05,
        apart: float | None = None,
    ) -> None:
        self._robot, self._trajectory = robot, trajectory
        self._outlives, self._period = outlives, period
        self._next, self._apart = _NEXT, apart
        self._path: TimedPath | None = None
        self._places: list[int] = []
        self._brakes: PathBrake | None = None
        self._points: Iterator[TimedPoint] = iter(())
        self._waiting: list[TimedPoint] = []
        # Of all points, by index.
        self._times: list[float] = []
        self._complete = False
        self._looked = -math.inf
        self._over = False
        self.ordered = self.stopped = False

    def begin(self) -> None:
        """Send the first points, and start.

        Raises:
            CommandRefusedError: The robot refuses the points or the start; nothing moves.
            LimitError: The points are beyond limits; nothing moves.
            UsageError: Not all of them fit, although they must.
            HexwireError: As `TimedPath`.
        """
        robot, trajectory = self._robot, self._trajectory
        self._path = path = robot.path(trajectory.names, outlives=self._outlives)
        self._places = [trajectory.names.index(name) for name in path.joints]
        if robot.refills_paths:
            self._brakes = PathBrake(robot.model, path.joints)
        # Half a count, since the robot rounds to counts anyway.
        error = [robot.model.joint(name).scale / 2.0 for name in trajectory.names]
        if self._apart is None:
            shortest = min(_LONGEST, max(_SHORTEST, _AHEAD * self._period / path.capacity))
            self._next = max(_NEXT, math.ceil(_AHEAD * self._period / shortest))
            self._points = self._make_points(error, _LONGEST, shortest)
            most = min(max(_FIRST, self._next), path.capacity - REST_POINTS)
            self._send(most if robot.refills_paths else path.capacity)
        else:
            self._points = self._make_points(error, self._apart, self._apart)
            self._send(path.capacity)
            if not self._complete:
                raise UsageError("the motion takes too long for the points that the robot can hold")
        self.ordered = True
        try:
            self.start = path.start()
        except CommandRefusedError:
            self.ordered = False
            raise

    def until(
        self,
        owner: RobotOwner,
        keep: Callable[[float, float], object],
        ended: Callable[[StopReason], object],
        over: Callable[[], bool],
    ) -> Callable[[], bool]:
        """A function that feeds the robot, and says whether the motion is over.

        Args:
            owner: Of the robot.
            keep: Called with the earliest and the latest start of the path, under the lock of the controllers: the
                clock of the robot drifts.
            ended: Called with the reason if the robot does not follow the path any more.
            over: Whether the motion is over.
        """

        def is_over() -> bool:
            if not over() and (found := self._turn(owner, keep)) is not None:
                ended(found)
            return over()

        return is_over

    def _turn(self, owner: RobotOwner, keep: Callable[[float, float], object]) -> StopReason | None:
        """Send the next points if there is room, and see where the robot is; why it does not follow, or None."""
        path, now = self._path, owner.now()
        if path is None or self._over or (self._complete and now - self._looked < _LOOK):
            return None
        self._looked = now
        try:
            report = path.report()
            if report.state is PathState.RUNNING and report.towards > 0:
                # Where it was between request and reply; its targets are ahead by the lead.
                first, last = self._times[report.towards - 1], self._times[report.towards]
                with owner.locked():
                    keep(now - last, owner.now() - first + path.lead)
            self._over = report.state is PathState.DONE
            if report.state is PathState.STOPPED:
                self.stopped = True
                # Perhaps resumed since: then no state says so any more.
                return board_stop(self._robot.read()) or StopReason("board", STOP_COMMAND)
            if (why := _WHY.get(report.state)) is not None:
                return StopReason("board", report.why or why)
            if not self._complete and report.state is PathState.RUNNING:
                self._send(min(report.room - REST_POINTS, self._next))
        except (StoppedError, PreemptedError):
            self.stopped = True
            return StopReason("board", STOP_COMMAND)
        except CommandRefusedError as error:
            # It ended while the points were on their way; or the rest is beyond the robot's own limits.
            return StopReason("board", _WHY.get(path.report().state, str(error)))
        except UsageError as error:
            return StopReason("board", str(error))
        return None

    def end(self, wait: Callable[[], object], *, abort: bool) -> None:
        """Wait until the joints are at rest on the path.

        Args:
            wait: Waits for a moment.
            abort: Bring them to rest; otherwise the path is known to be at its end.

        Raises:
            DeviceError: They do not come to rest.
            HexwireError: As `TimedPath`.
        """
        path = self._path
        if path is None or self._over:
            return
        if self._is_at_rest(path):
            return
        if abort and not self._come_to_rest(path):
            try:
                path.abort()
            except CommandRefusedError:
                if not self._is_at_rest(path):
                    raise
        deadline = self._robot.now() + _REST
        while not self._is_at_rest(path):
            if self._robot.now() > deadline:
                raise DeviceError("the board does not end its path")
            wait()

    def _come_to_rest(self, path: TimedPath) -> bool:
        """Send the planned brake in place of what is left of the path; whether that was possible."""

        def settled() -> float:
            return self._robot.now() - self.start.time + path.lead + _TRANSIT

        if self._brakes is None or settled() < path.lead:
            return False
        times = self._times[: path.report().sent]
        try:
            return self._brakes.end(path, self._trajectory, times, 0, settled) is not None
        except StoppedError:
            # Of a stop meanwhile the caller knows, and says why the motion has ended.
            return False

    @staticmethod
    def _is_at_rest(path: TimedPath) -> bool:
        """Whether nothing of the path moves any more; so too after a reset, and if another one has replaced it."""
        state = path.report().state
        return state.over or state is PathState.NONE

    def _make_points(self, error: Sequence[float], longest: float, shortest: float) -> Iterator[TimedPoint]:
        places = self._places
        # An optimal motion runs at its limit, and may be above it by a rounding error.
        most = [self._robot.model.joint(name).max_speed for name in self._trajectory.names]
        for t, (position, velocity, _) in path_points(self._trajectory, error, longest=longest, shortest=shortest):
            self._times.append(t)
            yield TimedPoint(
                t,
                tuple([position[i] for i in places]),
                tuple([max(-most[i], min(most[i], velocity[i])) for i in places]),
            )

    def _send(self, most: int) -> None:
        assert self._path is not None
        waiting = self._waiting
        while len(waiting) <= most and (point := next(self._points, None)) is not None:
            waiting.append(point)
        some = waiting[:most]
        # One is always kept back, so that the last is known to be the last.
        last = len(waiting) <= most
        plan, brakes = self._trajectory, self._brakes
        # A path that outlives its program is whole when its last point is there, not before.
        needed = not (last or brakes is None or self._outlives)
        rest = (lambda point: brakes.after(plan, point.time)) if needed and brakes is not None else None
        del waiting[: self._path.send(some, last=last, rest=rest)]
        self._complete = last and not waiting


def begin_feed(
    robot: RobotDriver,
    trajectory: Trajectory,
    asked: Token,
    *,
    outlives: bool,
    stop_on_failure: bool = True,
    period: float = 0.05,
    apart: float | None = None,
    refused: Callable[[str], object] | None = None,
) -> PathFeed | None:
    """Have a robot follow a trajectory in its own time.

    Args:
        robot: Attached; `times_motion`.
        trajectory: Checked.
        asked: When it was asked for; a stop since then voids it.
        outlives: As in `RobotDriver.path`.
        stop_on_failure: Stop the arm if it may have started, although this fails.
        period: As in `PathFeed`.
        apart: Likewise.
        refused: Called with the reason if it refuses the trajectory; if None, that is logged.

    Returns:
        What feeds the robot from now on; None if it refuses the trajectory, and nothing moves.

    Raises:
        StoppedError: The arm is stopped.
        HexwireError: It does not answer.
    """
    feed = PathFeed(robot, trajectory, outlives=outlives, period=period, apart=apart)
    robot.epochs.check(asked, "the motion")
    try:
        with robot.epochs.using(asked):
            feed.begin()
    except (StoppedError, PreemptedError):
        raise
    except (CommandRefusedError, UsageError) as error:
        # Its limits may be tighter than the model's: targets one by one are clamped and given more time there.
        why = error.reason if isinstance(error, CommandRefusedError) else str(error)
        if refused is None:
            _log.warning("targets are sent one by one, since the board does not follow this path itself: %s", why)
        else:
            refused(why)
        return None
    except BaseException:
        # Without an answer it may have started, and no controller knows of it yet.
        if feed.ordered and stop_on_failure:
            with suppress(HexwireError):
                robot.stop()
        raise
    return feed
