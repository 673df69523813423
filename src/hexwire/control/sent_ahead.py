"""The trajectories of an arm's controllers, sent ahead to a robot that keeps the time itself.

Owns when a path of the robot begins, what of it is sent, replaced and given up, and what its ends mean for the
controllers. The followers decide where the joints are to be at each time, as for any robot; here the robot is told
earlier. One thread at a time makes all calls. Must not know connections, goals, nor how a robot follows a path.
"""

from __future__ import annotations

import logging
import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Collection, Iterator
from itertools import islice
from typing import TYPE_CHECKING

from hexwire.drivers.timed_path import REST_POINTS, PathReport, PathState, TimedPath, TimedPoint
from hexwire.errors import CommandRefusedError, DeviceError, LeaseError, PreemptedError, StoppedError, UsageError
from hexwire.motion.follower import Follower, Mode
from hexwire.motion.limits import rest_duration
from hexwire.motion.path_rest import nearest_time
from hexwire.motion.safety import STOP_COMMAND, StopReason, board_stop, silence
from hexwire.motion.together import Together

from .controller import TrajectoryController
from .path_brake import PathBrake, plan_points
from .path_pace import PathPace
from .path_start import StartOrder, first_start

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.state import JointState

    from .group import ControllerGroup

__all__ = ["SentAhead"]

_log = logging.getLogger(__name__)

_FIRST = 12
"""Points that are sent before the start, at least."""
_ENOUGH = 0.1
"""Seconds that a path which nothing ends must last for longer than the robot needs to brake: when it starts, and
when another request with points has come."""
_EXCHANGES = 4.0
"""Times that a request takes to the robot for which its points must last, if they are few and end with a brake."""
_TICK = 1e-4
"""Seconds: all times of points are multiples of it."""
_LOOK, _LONGER = 0.1, 0.5
"""Seconds between two questions where the path is; the second if there is a change to send."""
_WAIT, _REST = 0.01, 5.0
"""Seconds between two looks whether the joints are at rest, and the most until they are."""
_DONE_BY_OTHERS = {
    PathState.ABORTED: "another program has ended the path on the board",
    PathState.NONE: "the board was reset, or another program began another path",
}


class SentAhead:
    """Has a robot follow the trajectories of the controllers in its own time. See `turn`.

    Args:
        robot: Attached; need not have a time of its own, and is left alone unless it refills paths.
        group: The controllers.
        clock: Monotonic seconds.
        sleep: Waits for a number of seconds.
        arm_watchdog: Called before anything begins to move.

    Attributes:
        start: When the path starts or has started.
    """

    def __init__(
        self,
        robot: RobotDriver,
        group: ControllerGroup,
        *,
        clock: Callable[[], float],
        sleep: Callable[[float], object],
        arm_watchdog: Callable[[], object],
    ) -> None:
        self._robot, self._group, self._clock, self._sleep = robot, group, clock, sleep
        self._arm_watchdog = arm_watchdog
        self.start = StartOrder(clock)
        self._path: TimedPath | None = None
        self._members: dict[Follower, TrajectoryController] = {}
        # What of each follower was sent: `Follower.changes` then.
        self._marks: dict[Follower, int] = {}
        # Followers whose targets are sent one by one, until they are at the end of what they follow.
        self._one_by_one: set[Follower] = set()
        self._plan = self._on_robot = Together((), {})
        # When the time of the path was 0, host's clock.
        self._origin, self._pace = 0.0, PathPace()
        # Points on the robot, from index `_oldest` on.
        self._sent: list[TimedPoint] = []
        self._oldest = 0
        self._points: Iterator[TimedPoint] = iter(())
        self._waiting: list[TimedPoint] = []
        # Index from which on the next points replace others, or None.
        self._replaced: int | None = None
        self._complete = False
        self._looked = self._turned = -math.inf
        # Seconds that the robot's own brake takes.
        self._brakes_for = 0.0
        # It comes to rest although the plan goes on; at which time of the path, and where, if that is not on it.
        self._leaving, self._rest = False, 0.0
        self._stands: dict[str, float] | None = None
        # The robot refuses what comes next, and at rest the targets are sent one by one.
        self._unfit = self._refuses = False

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints that follow a path now; their targets must not be sent."""
        return () if self._path is None else self._path.joints

    @property
    def changed(self) -> bool:
        """Whether the controllers have other plans than the robot."""
        if self._leaving or not self._marks:
            return False
        with self._group.lock:
            return any(follower.changes != mark for follower, mark in self._marks.items())

    def time_left(self) -> float:
        """Seconds until the path is over; 0 if there is none."""
        return 0.0 if self._path is None else max(0.0, self._origin + self._plan.duration - self._clock())

    def drop(self) -> None:
        """Forget the path: a stop has ended it, or the robot is lost."""
        self._path = self.start.given = None
        with self._group.lock:
            for follower in self._members:
                follower.sent_ahead = False
            self._members, self._marks = {}, {}

    def turn(self, state: JointState, period: float) -> StopReason | None:
        """Send what has become due. Called after the cycles of the controllers: once a period, and if `changed`.

        Args:
            state: The newest state.
            period: Seconds between two turns.

        Returns:
            Why the motion is over, if the robot does not follow it any more. The robot must be stopped if a joint
            is named.

        Raises:
            StoppedError: The arm is stopped.
            LeaseError: Whoever moves the joints has lost the right to; `brake` brings them to rest.
            HexwireError: As `TimedPath`.
        """
        if not self._robot.refills_paths:
            return None
        if self._group.reason is not None:
            self.drop()
            return None
        self._set_pace(period)
        found = None
        if (path := self._path) is not None:
            try:
                found = self._follow(path, state)
            except (StoppedError, PreemptedError, LeaseError):
                raise
            except (CommandRefusedError, UsageError) as error:
                found = self._see_refusal(path, state, error)
        if self._path is None and found is None and not self._refuses:
            # At once, also after the end of another path: what has been decided for now is on the new one.
            self._begin()
        self._refuses = False
        with self._group.lock:
            moving = {one.follower for one in self._controllers() if one.follower.mode is Mode.TRAJECTORY}
            self._one_by_one = moving - self._members.keys()
        return found

    def brake(self, joints: Collection[str] | None = None) -> tuple[str, ...]:
        """Bring the joints to rest on their path, and wait for it; controllers that still want to move go on later.

        Args:
            joints: Only if one of them is on it; None for any.

        Returns:
            Joints that were on it; they hold.

        Raises:
            StoppedError: A stop has ended it, or another program.
            DeviceError: They do not come to rest.
            HexwireError: As `TimedPath`.
        """
        path = self._path
        if path is None or (joints is not None and set(joints).isdisjoint(path.joints)):
            return ()
        if not self._leaving:
            self._give_up(path)
        deadline = self._clock() + _REST
        while not ((found := path.report().state).over or found is PathState.NONE):
            if self._clock() > deadline:
                raise DeviceError("the board does not end its path")
            self._sleep(_WAIT)
        if (reason := self._see_end(found)) is not None:
            self._group.stop(reason)
            raise StoppedError.unsent("an order", 0, f"the arm is stopped ({reason}); resume first")
        if self._path is not None:
            self._settle()
        return path.joints

    def _follow(self, path: TimedPath, state: JointState) -> StopReason | None:
        changed = self.changed
        if self._clock() - self._turned < self._pace.pause and not changed:
            return None
        try:
            patience = _LONGER if changed else _LOOK  # a change is urgent
            if self._leaving or self._is_ending() or self._clock() - self._looked >= patience:
                found = self._look(path, state)
                if found is not None or self._leaving or self._path is None:
                    return found
            self._go_on(path)
            return None
        finally:
            self._turned = self._clock()

    # -- the beginning ------------------------------------------------------------------------------

    def _set_pace(self, period: float) -> None:
        self._pace.period = period
        with self._group.lock:
            for controller in self._controllers():
                controller.follower.settled = self._pace.ahead

    def _controllers(self) -> list[TrajectoryController]:
        return [member for member in self._group.members if isinstance(member, TrajectoryController)]

    def _begin(self) -> None:
        """Begin a path if a trajectory was begun."""
        with self._group.lock:
            members = {
                one.follower: one
                for one in self._controllers()
                # A robot begins at rest. What moves already, target by target, goes on like that.
                if one.follower.mode is Mode.TRAJECTORY and one.follower not in self._one_by_one
            }
            if not members:
                return
            self._members = members
            for follower in members:
                follower.sent_ahead = True
                follower.take_change()
            begins = min(first_start(follower.planned) for follower in members)
            plan = self._take_plans(begins)
        try:
            self._arm_watchdog()
            self._start(plan, begins)
        except (StoppedError, PreemptedError, LeaseError) as error:
            # One that the robot has must still be brought to rest.
            if self._path is None or not isinstance(error, LeaseError):
                self.drop()
            raise
        except (CommandRefusedError, UsageError) as error:
            _log.warning("the targets are sent one by one: %s", error)
            # Nothing was sent of it while another path was at its end.
            self._shift(max(0.0, self._clock() - begins))
            self.drop()

    def _take_plans(self, origin: float) -> Together:
        """What the members have planned, in the time of a path that began then."""
        names = tuple([name for member in self._members.values() for name in member.joints])
        self._marks = {follower: follower.changes for follower in self._members}
        parts = {
            member.joints: tuple([(path, began - origin) for path, began in follower.planned])
            for follower, member in self._members.items()
        }
        return Together(names, parts)

    def _start(self, plan: Together, begins: float) -> None:
        before = self._clock()
        self._brakes_for = rest_duration(self._robot.model, plan.names)
        path = self._robot.path(plan.names, brake=self._brakes_for)
        self._pace.measure(self._clock() - before)
        self._plan = self._on_robot = plan
        self._sent, self._oldest, self._replaced = [], 0, None
        self._make_points(path, 0.0)
        self._stands = None
        most, brake = max(_FIRST, self._pace.most(path.capacity)), PathBrake(self._robot.model, path.joints)
        self._send(path, min(most, path.capacity - REST_POINTS))
        # A path that has no brake at its end must last for longer than the robot's own, or it does not start.
        enough = 0.5 * self._brakes_for + _ENOUGH
        while not (self._complete or self._sent[-1].time > enough or brake.after(plan, self._sent[-1].time)):
            room, before = path.capacity - REST_POINTS - len(self._sent), len(self._sent)
            self._send(path, min(most, room))
            if len(self._sent) == before:
                break
        self._path, self._leaving, self._unfit, self._origin = path, False, False, begins
        self._looked = self._clock()
        self._shift(self.start.give(path, begins))

    # -- points -------------------------------------------------------------------------------------

    def _make_points(self, path: TimedPath, begin: float) -> None:
        """Points of the plan from a time of the path on come next."""
        points = plan_points(self._robot.model, path.joints, self._plan, begin, *self._pace.apart(path.capacity))
        self._points, self._waiting, self._complete = points, [], False

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
        plan, brake = self._plan, PathBrake(self._robot.model, path.joints)
        taken = path.send(
            some,
            last=last,
            first=self._replaced,
            rest=None if last else lambda point: brake.after(plan, point.time),
        )
        if taken:
            if self._replaced is not None:
                del self._sent[self._replaced - self._oldest :]
            self._replaced, self._on_robot = None, self._plan
        self._sent.extend(some[:taken])
        del waiting[:taken]
        self._complete = last and not waiting

    def _send_lasting(self, path: TimedPath, most: int) -> None:
        """Send so many points, or a few more, so that the robot never runs dry.

        Until the next request comes, it has only the points that are there with this one. So each request ends with
        a brake, or lasts for longer than the robot needs to brake by itself, if need be with points further apart.
        """
        while most > 0 and not self._complete:
            kept = self._sent if self._replaced is None else self._sent[: self._replaced - self._oldest]
            until = kept[-1].time if kept else 0.0
            now = self._clock() - self._origin
            lasts = now + path.lead + self._pace.transit + 0.5 * self._brakes_for + _ENOUGH
            count = most if until >= lasts else self._next_request(path, until, lasts)
            if not count:
                self._give_up(path)
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
        rests = bool(PathBrake(self._robot.model, path.joints).after(self._plan, end))
        # Over a slow line so few points would be over before the next ones come.
        if rests and end - until > _EXCHANGES * self._pace.transit:
            return few
        if len(coming) <= path.request or self._spread(path, lasts):
            return path.request
        return few if rests else 0

    def _spread(self, path: TimedPath, lasts: float) -> bool:
        """Have the points of the next request last until a time of the path; False if they were off the plan."""
        first, count = self._waiting[0].time, path.request
        if self._waiting[count - 1].time >= lasts:
            return True
        shortest, longest = self._pace.apart(path.capacity)
        longest = max(longest, (lasts - first) / max(1, count - 1) + _TICK)
        points = plan_points(self._robot.model, path.joints, self._plan, first, shortest, longest)
        some = list(islice(points, count))
        if len(some) == count and some[-1].time < lasts:
            return False
        self._make_points(path, some[-1].time)
        next(self._points)
        self._waiting = some
        return True

    def _go_on(self, path: TimedPath) -> None:
        """Send what has changed, and what comes next."""
        self._forget_past(path)
        if not self._take_changes(path):
            return
        room = path.capacity - REST_POINTS - len(self._sent) - 1
        if self._replaced is not None:
            room += self._oldest + len(self._sent) - self._replaced
        if not self._complete and room > 0:
            self._send_lasting(path, min(room, self._pace.most(path.capacity)))

    def _take_changes(self, path: TimedPath) -> bool:
        """Have points made of a new plan, if there is one; False if none can be sent now."""
        with self._group.lock:
            changed = [follower for follower, mark in self._marks.items() if follower.changes != mark]
            if not changed:
                return True
            if any(math.isinf(follower.changed_from) or not follower.planned for follower in changed):
                # It was released, or held before it began: then the robot must be at rest before what comes next.
                switches = None
            else:
                switches = {follower: follower.take_change() for follower in changed}
            marks, plan = self._marks, self._plan if switches is None else self._take_plans(self._origin)
        if switches is None:
            self._give_up(path)
            return False
        if self._replace(path, plan, min(switches.values()) - self._origin):
            return True
        with self._group.lock:
            self._marks = marks
            for follower, switch in switches.items():
                follower.changed_from = min(switch, follower.changed_from)
        return False

    def _replace(self, path: TimedPath, plan: Together, switch: float) -> bool:
        """Have a new plan count from a time of the path on; whether that is possible."""
        times = [point.time for point in self._sent]
        # Rounded up, since points are at ticks.
        switch = max(0.0, math.ceil(switch / _TICK - 1e-6) * _TICK)
        place = bisect_left(times, switch - _TICK / 2.0)
        begin, again = switch, True
        if place == len(times):
            # Points up to then have not been sent yet. The last one must be sent again.
            begin, again = times[-1], self._complete
            place -= self._complete
        settled = self._clock() - self._origin + path.lead + self._pace.transit
        if settled >= 0.0 and place <= bisect_right(times, settled):
            if not (self._complete and switch >= times[-1]):
                self._give_up(path)
            # Else the path is over before the new plan begins, with another path.
            return False
        self._plan = plan
        self._make_points(path, begin)
        if not again:
            next(self._points)
        self._replaced = self._oldest + place
        return True

    def _forget_past(self, path: TimedPath) -> None:
        """Forget points of which the robot is past; it keeps the one before that towards which it moves."""
        passed = self._clock() - self._origin + path.lead - self._pace.transit
        count = bisect_right([point.time for point in self._sent], passed) - 1
        if count > 0:
            del self._sent[:count]
            self._oldest += count

    # -- where it is --------------------------------------------------------------------------------

    def _is_ending(self) -> bool:
        return self._complete and self.time_left() <= 0.0

    def _shift(self, seconds: float) -> None:
        """Move what is planned in time."""
        self._origin += seconds
        with self._group.lock:
            for follower in self._members:
                follower.shift(seconds)

    def _look(self, path: TimedPath, state: JointState) -> StopReason | None:
        before = self._clock()
        report = path.report()
        self._looked = before
        self._pace.measure(self._clock() - before)
        return self._see(path, report, state, before)

    def _see(self, path: TimedPath, report: PathReport, state: JointState, before: float) -> StopReason | None:
        """Act on where the robot is; returns why the motion is over, or None."""
        found = report.state
        if found is PathState.RUNNING:
            self._keep_time(path, report, before)
        elif found is PathState.WAITING:
            self._shift(self.start.correct(path))
        elif found is PathState.BRAKING:
            self._leaving = True
        elif found is PathState.DONE:
            if self._leaving:
                self._settle()
            else:
                self.drop()
        elif found is PathState.FAULT:
            return self._see_fault(report, state)
        elif found is PathState.DRY:  # this program was suspended for longer than the points lasted
            self._note_rest(path, self._sent[-1].time, report.rest, self._brakes_for)
            self._settle()
        elif found is PathState.ABORTED and self._leaving:
            self._settle()
        return self._see_end(found)

    def _see_end(self, found: PathState) -> StopReason | None:
        """Forget a path that others have ended; returns why the motion is over, or None."""
        if found is PathState.STOPPED:
            self.drop()
            # Perhaps resumed since: then no state says so any more.
            return board_stop(self._robot.read()) or StopReason("board", STOP_COMMAND)
        if found is PathState.NONE and self._is_ending():
            self.drop()  # another program has begun another path since
        elif found in _DONE_BY_OTHERS and not (found is PathState.ABORTED and self._leaving):
            self.drop()
            return StopReason("board", _DONE_BY_OTHERS[found])
        return None

    def _see_fault(self, report: PathReport, state: JointState) -> StopReason | None:
        joints = self.joints
        if report.towards and all(name in state.torque_on and name not in state.silent for name in joints):
            # The robot has found out what this state does not show yet.
            state = self._robot.read()
        limp = [name for name in joints if name not in state.torque_on]
        if limp:
            self.drop()
            self._group.release(f"{', '.join(limp)} lost torque", joints)
            return None
        if not report.towards:  # a joint was not where the path begins; nothing has moved
            self._unfit, self._rest = True, 0.0
            self._settle()
            return None
        self.drop()
        return silence(state, joints)

    def _keep_time(self, path: TimedPath, report: PathReport, before: float) -> None:
        """Keep what is planned to the time of the robot, whose clock drifts."""
        place = report.towards - self._oldest
        if not 0 < place < len(self._sent):
            return
        # Where it was between request and reply; its targets are ahead by the lead.
        earliest = before - self._sent[place].time
        latest = self._clock() - self._sent[place - 1].time + path.lead
        self._shift(max(earliest, min(latest, self._origin)) - self._origin)

    def _see_refusal(self, path: TimedPath, state: JointState, error: Exception) -> StopReason | None:
        before = self._clock()
        report = path.report()
        if report.state in (PathState.RUNNING, PathState.WAITING):
            if self._replaced is None or self._replaced > report.towards:
                # The robot's own limits are tighter: targets one by one are clamped, and given more time.
                _log.warning("the targets are sent one by one from here: %s", error)
                self._unfit = True
            self._give_up(path)
            return None
        return self._see(path, report, state, before)

    # -- coming to rest -----------------------------------------------------------------------------

    def _give_up(self, path: TimedPath) -> None:
        """Have the robot come to rest: within all limits, or at least on its path."""
        before, epochs = self._clock(), self._robot.epochs
        # Also if whoever moves the joints has just lost the right to: this only brings them to rest.
        with epochs.using(epochs.mark()):
            if before - self._origin + path.lead > 0.0 and self._brake(path):
                self._leaving = True
                return
            path.abort()
        begins = (before + self._clock()) / 2.0 - self._origin + path.lead
        # Half of the braking time of the path is travelled; nothing, if it has not begun.
        self._rest = begins + self._brakes_for / 2.0 if begins > 0.0 else 0.0
        self._leaving = True

    def _brake(self, path: TimedPath) -> bool:
        """Send the planned brake in place of what is left of the path; whether that was possible."""
        brake, times = PathBrake(self._robot.model, path.joints), [point.time for point in self._sent]

        def settled() -> float:
            return self._clock() - self._origin + path.lead + self._pace.transit

        found = brake.end(path, self._on_robot, times, self._oldest, settled)
        if found is None:
            return False
        count, points = found
        del self._sent[count:]
        left, last = self._sent[-1].time, points[-1]
        self._note_rest(path, left, last.positions, last.time - left)
        return True

    def _note_rest(self, path: TimedPath, left: float, place: tuple[float, ...] | None, seconds: float) -> None:
        """The joints leave the path at a time of it, and come to rest at a place of or beside its next seconds."""
        self._rest, self._stands = left, None
        if place is not None:
            self._stands = dict(zip(path.joints, place, strict=True))
            place = tuple([self._stands[name] for name in self._on_robot.names])
            self._rest = nearest_time(self._on_robot, left, seconds, place)

    def _settle(self) -> None:
        """The robot is at rest: those that want to move go on from there."""
        rest = dict(zip(self._on_robot.names, self._on_robot.sample(self._rest).position, strict=True))
        if self._stands is not None:
            rest = self._stands
        members, left = self._members, self._origin + self._rest
        self._refuses = self._unfit
        self.drop()
        with self._group.lock:
            for follower, controller in members.items():
                if controller.reason is not None:
                    continue
                try:
                    follower.rejoin(rest, left, self._clock(), wanted=controller.busy)
                except UsageError as error:
                    controller.release(str(error))
        self._group.deliver()
