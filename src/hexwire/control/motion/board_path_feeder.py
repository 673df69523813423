"""Feeds a path that a board keeps: when it starts, which of its points are sent when, replaced, and ended at rest.

Owns what the robot has of a path, how early and how densely it is sent, the points with which it comes to rest
(sent with each part of a path, and to end one), and that no request lets it run dry on a fast curve. Must not know
goals.
"""

from __future__ import annotations

import logging
import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from typing import TYPE_CHECKING

from hexwire.drivers.abilities import OnboardPaths, RefilledPaths
from hexwire.drivers.timed_path import REST_POINTS, PathReport, PathState, TimedPath, TimedPoint
from hexwire.errors import CommandRefusedError, DeviceError, LeaseError, StoppedError, UsageError
from hexwire.motion.eased import LONGEST, ease_out
from hexwire.motion.limits import rest_duration
from hexwire.motion.moving import joint_limits
from hexwire.motion.path_points import nearest_time, path_points, path_rest
from hexwire.motion.safety import STOP_COMMAND, StopReason, board_stop, silence
from hexwire.motion.together import Together
from hexwire.motion.trajectory import Tail

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.drivers.timed_path import PathStart
    from hexwire.model.arm import ArmModel
    from hexwire.model.state import JointState
    from hexwire.motion.trajectory import Trajectory

__all__ = [
    "BoardPathFeeder",
    "PathBrake",
    "PathPace",
    "StartOrder",
    "first_start",
    "lost_torque",
    "plan_points",
]

_PLACES = 12
"""Points of a path from which a brake is tried."""
_CLOSE, _FAR = 0.02, 0.1
"""Seconds between two points of a path that slows down. Those of one request must last for longer than the robot
needs to brake by itself: otherwise it does, before the next request has come."""
_SPARE = 16
"""Points of a path that may still be on the robot before those that slow it down."""
_SEARCH, _TRIES = 0.02, 3
"""Seconds that the search for a way to rest may take, at first; if it took longer, twice that in the next try."""
_TICK = 1e-4


def plan_points(
    model: ArmModel, joints: Sequence[str], plan: Trajectory, begin: float, shortest: float, longest: float
) -> Iterator[TimedPoint]:
    """The points of a plan from a time on.

    Args:
        model: The arm.
        joints: Of the path on the robot, in its order.
        plan: Of the same joints, in any order.
        begin: Seconds of the plan.
        shortest: Seconds between two points, at least.
        longest: And at most.
    """
    rows = [(plan.names.index(name), model.joint(name)) for name in joints]
    # Half a count, since the robot rounds to counts anyway.
    error = [model.joint(name).scale / 2.0 for name in plan.names]
    for t, (position, velocity, _) in path_points(Tail(plan, begin), error, longest=longest, shortest=shortest):
        # A plan runs at the limits, and may be above them by a rounding error.
        yield TimedPoint(
            begin + t,
            tuple([min(max(position[i], joint.minimum), joint.maximum) for i, joint in rows]),
            tuple([max(-joint.max_speed, min(joint.max_speed, velocity[i])) for i, joint in rows]),
        )


class PathBrake:
    """Makes a robot come to rest within the limits of its joints.

    Args:
        model: The arm.
        joints: Of the path on the robot, in its order.
    """

    def __init__(self, model: ArmModel, joints: Sequence[str]) -> None:
        self._model, self._joints = model, tuple(joints)
        # Who sends a request asks once whether there is a brake at its end, and once for the brake.
        self._last: tuple[Trajectory, float, list[TimedPoint]] | None = None

    def after(self, plan: Trajectory, time: float) -> list[TimedPoint]:
        """Points that bring the joints to rest after a time of a plan; empty if a brake would leave its path.

        Args:
            plan: Of the same joints, in any order.
            time: Seconds of it; a multiple of 0.1 ms.
        """
        last = self._last
        if last is not None and last[0] is plan and last[1] == time:
            return last[2]
        model, names = self._model, plan.names
        ranges = [(model.joint(name).minimum, model.joint(name).maximum) for name in names]
        found = path_rest(plan, time, joint_limits(model, names), ranges)
        rows = [(names.index(name), model.joint(name)) for name in self._joints]
        points = [
            TimedPoint(
                round(point.time / _TICK) * _TICK,
                tuple([point.position[i] for i, _ in rows]),
                tuple([max(-joint.max_speed, min(joint.max_speed, point.velocity[i])) for i, joint in rows]),
            )
            for point in found or ()
        ]
        self._last = plan, time, points
        return points

    def end(
        self,
        path: TimedPath,
        plan: Trajectory,
        times: Sequence[float],
        oldest: int,
        settled: Callable[[], float],
    ) -> tuple[int, list[TimedPoint]] | None:
        """Replace what is left of a path by a brake, or by the path as it slows down, whichever is over sooner.

        Args:
            path: On the robot, which follows it.
            plan: What it follows.
            times: Of the points that the robot has, from index `oldest` on.
            oldest: Index of the first of them.
            settled: Returns the time of the plan up to which nothing can be changed any more.

        Returns:
            How many points of `times` still count, and those that were sent; None if the robot has taken none.

        Raises:
            StoppedError: A stop ended the path.
        """
        search = _SEARCH
        for _ in range(_TRIES):
            begin = settled()
            found = self._soonest(path, plan, times, bisect_right(times, begin + search))
            if found is None:
                return None
            (n, points), end = found, settled()
            if times[n] <= end:
                search = 2.0 * (end - begin)
                continue
            try:
                if path.send(points, last=True, first=oldest + n + 1) < len(points):
                    return None
            except StoppedError:
                raise
            except (CommandRefusedError, UsageError):
                # Perhaps it came too late.
                continue
            return n + 1, points
        return None

    def _soonest(
        self, path: TimedPath, plan: Trajectory, times: Sequence[float], begin: int
    ) -> tuple[int, list[TimedPoint]] | None:
        """After which point of the plan the joints can come to rest soonest, and how."""
        found = None
        for n in range(begin, min(begin + _PLACES, len(times))):
            if points := self.after(plan, times[n]):
                found = n, points
                break
        if begin == len(times) or (found is not None and found[0] == begin):
            return found
        longest = LONGEST if found is None else min(LONGEST, found[1][-1].time - times[begin])
        slowed = ease_out(Tail(plan, times[begin]), joint_limits(self._model, plan.names), longest)
        if slowed is None:
            return found
        points = [
            point._replace(time=round((times[begin] + point.time) / _TICK) * _TICK)
            for point in plan_points(self._model, self._joints, slowed, 0.0, _CLOSE, _FAR)
        ]
        return (begin, points[1:]) if len(points) <= path.capacity - _SPARE else found


_log = logging.getLogger(__name__)

_ENDED_BY_OTHERS = {
    PathState.ABORTED: "another program has ended the path on the board",
    PathState.NONE: "the board was reset, or another program began another path",
}
"""Ends of a path that whoever feeds it has not asked for, in words."""
_ENOUGH = 0.1
"""Seconds that a path which nothing ends must last for longer than the robot needs to brake: when it starts, and
when another request with points has come."""
_EXCHANGES = 4.0
"""Times that a request takes to the robot for which its points must last, if they are few and end with a brake."""
_LOOK, _LONGER = 0.1, 0.5
"""Seconds between two questions where the path is; the second if there is a change to send."""
_REST = 5.0
"""Most seconds that a path needs to come to rest."""
_AHEAD = 0.12
"""Seconds by which the robot must know of a change: the point towards which its joints move cannot be replaced, and
requests take time, perhaps one more that is under way."""
_APART, _FIXED_APART = (0.02, 0.03), (0.01, 0.05)
"""Least and most seconds between two points; further apart where turns are rare. Those of a plan that may be
replaced are close together, since it is replaced from a point on."""
_TURNS = 2.0
"""Turns for which the points on the robot must last at least."""
_FIRST, _NEXT = 12, 6
"""Points that are sent before the start, and in one turn after it, or more; twice as many of a fixed plan."""
_TRANSIT, _USUAL = 0.015, 0.025
"""Seconds that a request with points takes to the robot, and an exchange at most, on a serial line."""
_FADES = 0.9
"""Part of what was measured of a slower line that counts after another exchange."""
_SOON = 0.005
"""Seconds: a start that is nearer than this is ordered as one at once."""
_AIM = 0.05
"""Seconds before a start until which its time may still be corrected."""
_LATER = (0.1, 0.2, 0.4)
"""Seconds from now to a start that is tried after one whose time has passed."""
_UNSURE = 0.02
"""Seconds before a start in which it may have passed on the robot's clock, which is known to some milliseconds."""


class PathPace:
    """The pace of a path.

    Args:
        fixed: Its plan is never replaced: the robot may have much of it early.

    Attributes:
        period: Seconds between two turns in which something is sent.
    """

    def __init__(self, *, fixed: bool = False) -> None:
        self._fixed, self.period = fixed, 0.0
        # Seconds that an exchange takes longer than usual, as over a network.
        self._slow = 0.0

    def measure(self, seconds: float) -> None:
        """Take in how long an exchange took."""
        self._slow = max(seconds - _USUAL, _FADES * self._slow, 0.0)

    @property
    def ahead(self) -> float:
        """Seconds by which the robot must know of a change."""
        return _AHEAD + 2.0 * self._slow

    @property
    def transit(self) -> float:
        """Seconds until the robot has received points that are sent now."""
        return _TRANSIT + self._slow

    def apart(self, capacity: int) -> tuple[float, float]:
        """Least and most seconds between two points, so that those on the robot last for some turns.

        Args:
            capacity: Points that the robot can hold.
        """
        closest, furthest = _FIXED_APART if self._fixed else _APART
        least = max(closest, _TURNS * self._turn / capacity)
        return least, max(least, furthest)

    def first(self, capacity: int) -> int:
        """Points that are sent before the start, at least."""
        return max(_FIRST * (1 + self._fixed), self.most(capacity))

    def most(self, capacity: int) -> int:
        """Most points that are sent in one turn."""
        return max(_NEXT * (1 + self._fixed), math.ceil(_TURNS * self._turn / self.apart(capacity)[0]))

    @property
    def pause(self) -> float:
        """Least seconds from one turn to the next: states must not wait behind them."""
        return 2.0 * self._slow

    @property
    def _turn(self) -> float:
        """Seconds from one turn to the next; each may ask and send."""
        return self.period + 2.0 * self._slow + self.pause


class StartOrder:
    """The start of one path after the other.

    Args:
        clock: Host's clock, seconds.

    Attributes:
        given: When the robot starts or has started; None if it has no path.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock, self._wanted = clock, 0.0
        self.given: PathStart | None = None

    def give(self, path: TimedPath, begins: float) -> float:
        """Order a start, as `TimedPath.start`; returns by how many seconds the robot is later than meant.

        If its time has passed when the robot gets the order, a later one is tried, a few times.
        """
        self._wanted = begins
        for later in _LATER:
            at_once = self._wanted - self._clock() <= _SOON
            try:
                return self._order(path, at_once=at_once) - begins
            except StoppedError:
                raise
            except CommandRefusedError as error:
                now = self._clock()
                if at_once or self._wanted - now > _UNSURE:
                    raise
                _log.warning("an order to start came too late (%s); the robot starts in %g s", error, later)
                self._wanted = now + later
        return self._order(path, at_once=False) - begins

    def _order(self, path: TimedPath, *, at_once: bool) -> float:
        self.given = path.start(None if at_once else self._wanted)
        return self.given.time

    def correct(self, path: TimedPath) -> float:
        """Order the start again: the longer the clocks have been compared, the better its time is known.

        Returns:
            By how much the robot is later than after the order before, seconds.

        Raises:
            StoppedError: A stop ended the path.
        """
        before = self.given
        if before is None or self._wanted - self._clock() < _AIM:
            return 0.0
        try:
            self.given = path.start(self._wanted)
        except StoppedError:
            raise
        except CommandRefusedError as error:
            # Such as after a stall: the order before holds.
            _log.debug("the start is not corrected: %s", error)
            return 0.0
        return self.given.time - before.time


class BoardPathFeeder:
    """Has a robot follow one path after the other in its own time. One thread at a time makes all calls.

    Args:
        robot: Attached.
        clock: Monotonic seconds.
        shifted: Called with the seconds by which what is planned is later than before: the robot's clock drifts, or
            it starts later than was meant.
        fixed: As in `PathPace`.

    Attributes:
        path: On the robot; None if there is none.
        start: When it starts or has started.
        pace: How early and how densely its points are sent.
        on_robot: What the robot has been told to follow.
        origin: When the time of the path was 0, host's clock.
        complete: All points have been sent.
        leaving: It comes to rest although the plan goes on.
        refused: Why it does so, if the robot does not take the rest of the plan, in words; else empty.
        starved: It does so since the next points came too late.
        rest: At which time of the path it comes to rest then.
        stands: And where, radians by joint, if that is not on the path.
    """

    def __init__(
        self,
        robot: RobotDriver,
        clock: Callable[[], float],
        shifted: Callable[[float], object] = lambda seconds: None,
        *,
        fixed: bool = False,
    ) -> None:
        self._robot, self._clock, self._shifted = robot, clock, shifted
        self.path: TimedPath | None = None
        self.start, self.pace = StartOrder(clock), PathPace(fixed=fixed)
        self._plan: Trajectory = Together((), {})
        self.on_robot: Trajectory = self._plan
        self.origin = 0.0
        # Points on the robot, from index `_oldest` on.
        self._sent: list[TimedPoint] = []
        self._oldest = 0
        self._points: Iterator[TimedPoint] = iter(())
        self._waiting: list[TimedPoint] = []
        # Index from which on the next points replace others, or None.
        self._replaced: int | None = None
        self.complete = False
        self._turned = self._looked = -math.inf
        # Seconds that the robot's own brake takes; and the brake that is planned for it.
        self._brakes_for, self._rests = 0.0, PathBrake(robot.model, ())
        # A path that outlives its program is whole when its last point is there: no brake comes before.
        self._outlives = False
        self.leaving, self.rest = False, 0.0
        self.refused, self.starved = "", False
        self.stands: dict[str, float] | None = None

    @property
    def ending(self) -> bool:
        """All of the path was sent, and its time is over."""
        return self.complete and self.time_left() <= 0.0

    def time_left(self) -> float:
        """Seconds until the path is over; 0 if there is none."""
        return 0.0 if self.path is None else max(0.0, self.origin + self._plan.duration - self._clock())

    def drop(self) -> None:
        """Forget the path: it is over, a stop has ended it, or the robot is lost."""
        self.path = self.start.given = None

    def shift(self, seconds: float) -> None:
        """Move what is planned in time."""
        self.origin += seconds
        self._shifted(seconds)

    # -- the beginning ------------------------------------------------------------------------------

    def begin(self, plan: Trajectory, begins: float, *, apart: float | None = None, outlives: bool = False) -> None:
        """Begin a path.

        Args:
            plan: What it follows.
            begins: When it starts, host's clock.
            apart: Seconds between two points, and all of them are sent before the start; if None, they are as close
                as the plan needs, and are sent while it runs if the robot takes them then.
            outlives: As in `OnboardPaths.path`.

        Raises:
            CommandRefusedError: The robot refuses the points or the start; nothing moves.
            LimitError: The points are beyond limits; nothing moves.
            UsageError: Not all of them fit, although they must.
            HexwireError: As `TimedPath`; if there is a `path`, the robot may have started.
        """
        robot, before = self._robot, self._clock()
        self._brakes_for, self._outlives = rest_duration(robot.model, plan.names), outlives
        path = OnboardPaths.of(robot).path(plan.names, brake=self._brakes_for, outlives=outlives)
        self.pace.measure(self._clock() - before)
        self._plan = self.on_robot = plan
        self._sent, self._oldest, self._replaced = [], 0, None
        self.stands = None
        self._rests = PathBrake(robot.model, path.joints)
        self._make_points(path, 0.0, self.pace.apart(path.capacity) if apart is None else (apart, apart))
        if apart is None and robot.can(RefilledPaths):
            self._send_first(path)
        else:
            self._send(path, path.capacity)
            if apart is not None and not self.complete:
                raise UsageError("the motion takes too long for the points that the robot can hold")
        self.path, self.leaving, self.origin = path, False, begins
        self.refused, self.starved = "", False
        self._looked = self._clock()
        self.shift(self.start.give(path, begins))

    def _send_first(self, path: TimedPath) -> None:
        most = self.pace.first(path.capacity)
        self._send(path, min(most, path.capacity - REST_POINTS))
        # A path that has no brake at its end must last for longer than the robot's own, or it does not start.
        enough = 0.5 * self._brakes_for + _ENOUGH
        while not (self.complete or self._sent[-1].time > enough or self._rest_after(self._sent[-1].time)):
            room, before = path.capacity - REST_POINTS - len(self._sent), len(self._sent)
            self._send(path, min(most, room))
            if len(self._sent) == before:
                break

    # -- a turn -------------------------------------------------------------------------------------

    def turn(self, change: Callable[[], bool] = lambda: True, *, urgent: bool = False) -> PathReport | None:
        """Ask where the path is, if it is time, and send what comes next.

        Args:
            change: Replaces the plan if there is a new one; returns whether points can be sent now.
            urgent: There is a new plan.

        Returns:
            How the path has ended; None as long as it goes on. What it means, `ended_by` and `fault` say.

        Raises:
            StoppedError: The arm is stopped.
            LeaseError: Whoever moves the joints has lost the right to.
            HexwireError: As `TimedPath`.
        """
        if self._clock() - self._turned < self.pace.pause and not urgent:
            return None
        try:
            if self._must_look(urgent=urgent) and _at_rest((report := self._look()).state):
                return report
            if not self.leaving:
                self._forget_past()
                if change():
                    self._refill()
            return None
        except (StoppedError, LeaseError):
            raise
        except (CommandRefusedError, UsageError) as error:
            # It ended while the points were on their way; or the rest is beyond the robot's own limits.
            report = self._look()
            if _at_rest(report.state):
                return report
            if report.state in (PathState.RUNNING, PathState.WAITING):
                if self._replaced is None or self._replaced > report.towards:
                    self.refused = str(error)
                self.leave()
            return None
        finally:
            self._turned = self._clock()

    def ended_by(self, report: PathReport) -> StopReason | None:
        """Why a path has ended, if a stop or another program has ended it; else None."""
        found = report.state
        if found is PathState.STOPPED:
            # Perhaps resumed since: then no state says so any more.
            return board_stop(self._robot.read()) or StopReason("board", STOP_COMMAND)
        # After its end, another program may have begun another one.
        known = self.ending if found is PathState.NONE else self.leaving
        if known or found not in _ENDED_BY_OTHERS:
            return None
        return StopReason.of_outcome("board", report.why or _ENDED_BY_OTHERS[found])

    def fault(self, report: PathReport, state: JointState) -> tuple[tuple[str, ...], StopReason]:
        """Why the path has ended with a fault: the joints without torque, and the reason in words.

        Args:
            report: Of its end.
            state: The newest one.
        """
        path = self.path
        assert path is not None
        if report.towards and all(name in state.torque_on and name not in state.silent for name in path.joints):
            # The robot has found out what this state does not show yet.
            state = self._robot.read()
        limp = tuple([name for name in path.joints if name not in state.torque_on])
        return limp, StopReason("board", lost_torque(limp)) if limp else silence(state, path.joints)

    # -- points -------------------------------------------------------------------------------------

    def _make_points(self, path: TimedPath, begin: float, spacing: tuple[float, float]) -> None:
        """Points of the plan from a time of the path on come next."""
        self._points = plan_points(self._robot.model, path.joints, self._plan, begin, *spacing)
        self._waiting, self.complete = [], False

    def _rest_after(self, time: float) -> Sequence[TimedPoint]:
        """Points that bring the joints to rest after a time of the plan, if nothing else is sent."""
        return () if self._outlives else self._rests.after(self._plan, time)

    def _come_next(self, count: int) -> list[TimedPoint]:
        """The points that are sent next: so many, if so many are left."""
        self._waiting.extend(islice(self._points, max(0, count - len(self._waiting))))
        return self._waiting

    def _send(self, path: TimedPath, most: int) -> None:
        waiting = self._come_next(most + 1)
        some = waiting[:most]
        if not some:
            return
        # One is always kept back, so that the last is known to be the last.
        last = len(waiting) <= most
        needed = not (last or self._outlives) and self._robot.can(RefilledPaths)
        taken = path.send(
            some,
            last=last,
            first=self._replaced,
            rest=(lambda point: self._rest_after(point.time)) if needed else None,
        )
        if taken:
            if self._replaced is not None:
                del self._sent[self._replaced - self._oldest :]
            self._replaced, self.on_robot = None, self._plan
        self._sent.extend(some[:taken])
        del waiting[:taken]
        self.complete = last and not waiting

    def _refill(self) -> None:
        """Send what comes next, as far as there is room; if the robot would run dry, it comes to rest."""
        path = self.path
        assert path is not None
        room = path.capacity - REST_POINTS - len(self._sent) - 1
        if self._replaced is not None:
            room += self._oldest + len(self._sent) - self._replaced
        if not self.complete and room > 0:
            self._send_lasting(path, min(room, self.pace.most(path.capacity)))

    def _send_lasting(self, path: TimedPath, most: int) -> None:
        """Send so many points, or a few more, so that the robot never runs dry.

        Until the next request comes, it has only the points that are there with this one. So each request ends with
        a brake, or lasts for longer than the robot needs to brake by itself, if need be with points further apart.
        """
        while most > 0 and not self.complete:
            kept = self._sent if self._replaced is None else self._sent[: self._replaced - self._oldest]
            until = kept[-1].time if kept else 0.0
            now = self._clock() - self.origin
            lasts = now + path.lead + self.pace.transit + 0.5 * self._brakes_for + _ENOUGH
            count = most if until >= lasts else self._next_request(path, until, lasts)
            if not count:
                self.starved = True
                self.leave()
                return
            self._send(path, count)
            if len(self._sent) <= len(kept):
                return
            most -= count

    def _next_request(self, path: TimedPath, until: float, lasts: float) -> int:
        """How many points come in the next request; 0 if the robot would run dry with any.

        Args:
            path: On the robot.
            until: Seconds of it that the points last that the robot keeps.
            lasts: Those that they must last with the ones of the request, if no brake is possible at their end.
        """
        few = max(1, path.request - REST_POINTS)
        coming = self._come_next(path.request + 1)
        if len(coming) <= few:
            return few
        end = coming[few - 1].time
        rests = bool(self._rest_after(end))
        # Over a slow line so few points would be over before the next ones come.
        if rests and end - until > _EXCHANGES * self.pace.transit:
            return few
        if len(coming) <= path.request or self._spread(path, lasts):
            return path.request
        return few if rests else 0

    def _spread(self, path: TimedPath, lasts: float) -> bool:
        """Have the points of the next request last until a time of the path; False if they were off the plan."""
        first, count = self._waiting[0].time, path.request
        if self._waiting[count - 1].time >= lasts:
            return True
        shortest, longest = self.pace.apart(path.capacity)
        longest = max(longest, (lasts - first) / max(1, count - 1) + _TICK)
        points = plan_points(self._robot.model, path.joints, self._plan, first, shortest, longest)
        some = list(islice(points, count))
        if len(some) == count and some[-1].time < lasts:
            return False
        self._make_points(path, some[-1].time, self.pace.apart(path.capacity))
        next(self._points)
        self._waiting = some
        return True

    def replace(self, plan: Trajectory, switch: float) -> bool:
        """Have a new plan count from a time of the path on; whether that is possible.

        If it is too late for that, the robot comes to rest; unless the path is over before the new plan begins.
        """
        path = self.path
        assert path is not None
        times = [point.time for point in self._sent]
        # Rounded up, since points are at ticks.
        switch = max(0.0, math.ceil(switch / _TICK - 1e-6) * _TICK)
        place = bisect_left(times, switch - _TICK / 2.0)
        begin, again = switch, True
        if place == len(times):
            # Points up to then have not been sent yet. The last one must be sent again.
            begin, again = times[-1], self.complete
            place -= self.complete
        settled = self._settled(path)
        if settled >= 0.0 and place <= bisect_right(times, settled):
            if not (self.complete and switch >= times[-1]):
                self.leave()
            return False
        self._plan = plan
        self._make_points(path, begin, self.pace.apart(path.capacity))
        if not again:
            next(self._points)
        self._replaced = self._oldest + place
        return True

    def _forget_past(self) -> None:
        """Forget points of which the robot is past; it keeps the one before that towards which it moves."""
        assert self.path is not None
        passed = self._clock() - self.origin + self.path.lead - self.pace.transit
        count = bisect_right([point.time for point in self._sent], passed) - 1
        if count > 0:
            del self._sent[:count]
            self._oldest += count

    # -- where it is --------------------------------------------------------------------------------

    def _must_look(self, *, urgent: bool) -> bool:
        """Whether it is time to ask where the path is; a change that is urgent may be sent before that."""
        patience = _LONGER if urgent else _LOOK
        return self.leaving or self.ending or self._clock() - self._looked >= patience

    def _look(self) -> PathReport:
        """Ask where the path is, and keep what is planned to the time of the robot."""
        path, before = self.path, self._clock()
        assert path is not None
        report = path.report()
        self._looked = before
        self.pace.measure(self._clock() - before)
        if report.state is PathState.RUNNING:
            self._keep_time(path, report, before)
        elif report.state is PathState.WAITING:
            self.shift(self.start.correct(path))
        elif report.state is PathState.BRAKING:
            self.leaving = True
        elif report.state is PathState.DRY:  # this program was suspended for longer than the points lasted
            self._note_rest(path, self._sent[-1].time, report.rest, self._brakes_for)
        return report

    def _keep_time(self, path: TimedPath, report: PathReport, before: float) -> None:
        """Keep what is planned to the time of the robot, whose clock drifts."""
        place = report.towards - self._oldest
        if report.towards <= 0 or place >= len(self._sent):
            return
        # Where it was between request and reply; its targets are ahead by the lead.
        # If its clock is slow, points may have been forgotten too early.
        earliest = before - self._sent[max(0, place)].time
        latest = self._clock() - self._sent[place - 1].time + path.lead if place > 0 else math.inf
        self.shift(max(earliest, min(latest, self.origin)) - self.origin)

    # -- coming to rest -----------------------------------------------------------------------------

    def leave(self) -> None:
        """Have the robot come to rest: within all limits, or at least on its path."""
        path, before, epochs = self.path, self._clock(), self._robot.epochs
        assert path is not None
        # Also if whoever moves the joints has just lost the right to: this only brings them to rest.
        with epochs.using(epochs.mark()):
            if before - self.origin + path.lead > 0.0 and self._brake(path):
                self.leaving = True
                return
            path.abort()
        begins = (before + self._clock()) / 2.0 - self.origin + path.lead
        # Half of the braking time of the path is travelled; nothing, if it has not begun.
        self.rest = begins + self._brakes_for / 2.0 if begins > 0.0 else 0.0
        self.leaving = True

    def wait_for_rest(self, wait: Callable[[], object]) -> PathReport:
        """Wait until the joints are at rest.

        Args:
            wait: Waits for a moment.

        Returns:
            How the path has ended.

        Raises:
            DeviceError: They do not come to rest.
            HexwireError: As `TimedPath`.
        """
        assert self.path is not None
        deadline = self._clock() + _REST
        while not _at_rest((report := self.path.report()).state):
            if self._clock() > deadline:
                raise DeviceError("the board does not end its path")
            wait()
        return report

    def at_rest(self) -> bool:
        """Whether nothing of the path moves any more; asks the robot."""
        assert self.path is not None
        return _at_rest(self.path.report().state)

    def _settled(self, path: TimedPath) -> float:
        """The time of the path up to which nothing can be changed any more."""
        return self._clock() - self.origin + path.lead + self.pace.transit

    def _brake(self, path: TimedPath) -> bool:
        """Send the planned brake in place of what is left of the path; whether that was possible."""
        if not self._robot.can(RefilledPaths):
            return False
        times = [point.time for point in self._sent]
        found = self._rests.end(path, self.on_robot, times, self._oldest, lambda: self._settled(path))
        if found is None:
            return False
        count, points = found
        del self._sent[count:]
        left, last = self._sent[-1].time, points[-1]
        self._note_rest(path, left, last.positions, last.time - left)
        return True

    def _note_rest(self, path: TimedPath, left: float, place: tuple[float, ...] | None, seconds: float) -> None:
        """The joints leave the path at a time of it, and come to rest at a place of or beside its next seconds."""
        self.rest, self.stands = left, None
        if place is not None:
            self.stands = dict(zip(path.joints, place, strict=True))
            place = tuple([self.stands[name] for name in self.on_robot.names])
            self.rest = nearest_time(self.on_robot, left, seconds, place)


def lost_torque(limp: Sequence[str]) -> str:
    """That joints have lost torque, in words."""
    return f"{', '.join(limp)} lost torque"


def _at_rest(state: PathState) -> bool:
    """Whether a path has ended; so too after a reset, and if another one has replaced it."""
    return state.over or state is PathState.NONE


def first_start(planned: Sequence[tuple[Trajectory, float]]) -> float:
    """When the motion begins that a plan ends with: its last part, and those that went over into it.

    Args:
        planned: At least one part, and when it begins, seconds; each counts until the next one begins.
    """
    *before, (_, begins) = planned
    for path, began in reversed(before):
        if began + path.duration <= begins + _SOON:
            break
        begins = min(began, begins)
    return begins
