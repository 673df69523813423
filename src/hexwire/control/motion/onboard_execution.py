"""Onboard execution: the trajectories of an arm's controllers, sent ahead to a robot that executes them itself.

Owns when a path of the robot begins, when a plan replaces it, and what its ends mean for the controllers. The
generators decide where the joints are to be at each time, as for any robot; here the robot is told earlier. One
thread at a time makes all calls. Must not know connections or goals.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Collection, Mapping
from typing import TYPE_CHECKING

from hexwire.drivers.timed_path import PathReport, PathState
from hexwire.errors import CommandRefusedError, LeaseError, PreemptedError, StoppedError, UsageError
from hexwire.motion.safety import StopReason
from hexwire.motion.set_point_generator import Mode, SetPointGenerator
from hexwire.motion.together import Together

from ..loop.controller import TrajectoryController
from .board_path_feeder import BoardPathFeeder, first_start, lost_torque

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.state import JointState

    from ..loop.group import ControllerGroup

__all__ = ["OnboardExecution"]

_log = logging.getLogger(__name__)

_WAIT = 0.01
"""Seconds between two looks whether the joints are at rest."""
_AWAY = math.radians(5.0)
"""A joint that is further from where a plan begins is elsewhere: a loaded servo rests within less of its target."""


class OnboardExecution:
    """Has a robot follow the trajectories of the controllers in its own time. See `turn`.

    Args:
        robot: Attached; need not have a time of its own, and is left alone unless it refills paths.
        group: The controllers.
        clock: Monotonic seconds.
        sleep: Waits for a number of seconds.
        arm_watchdog: Called before anything begins to move.

    Attributes:
        feeder: Of the path that the robot follows.
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
        self.feeder = BoardPathFeeder(robot, clock, self._shift)
        self._members: dict[SetPointGenerator, TrajectoryController] = {}
        # What of each generator was sent: `SetPointGenerator.changes` then.
        self._marks: dict[SetPointGenerator, int] = {}
        # Generators whose targets are sent one by one, until they are at the end of what they follow.
        self._one_by_one: set[SetPointGenerator] = set()
        # The robot refuses what comes next, and at rest the targets are sent one by one.
        self._unfit = self._refuses = False

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints that follow a path now; their targets must not be sent."""
        path = self.feeder.path
        return () if path is None else path.joints

    @property
    def changed(self) -> bool:
        """Whether the controllers have other plans than the robot."""
        if self.feeder.leaving or not self._marks:
            return False
        with self._group.lock:
            return any(generator.changes != mark for generator, mark in self._marks.items())

    def drop(self) -> None:
        """Forget the path: a stop has ended it, or the robot is lost."""
        self.feeder.drop()
        with self._group.lock:
            for generator in self._members:
                generator.onboard = False
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
        if self._group.reason is not None:
            self.drop()
            return None
        self._set_pace(period)
        found = None if self.feeder.path is None else self._follow(state)
        if self.feeder.path is None and found is None and not self._refuses:
            # At once, also after the end of another path: what has been decided for now is on the new one.
            self._begin(state)
        self._refuses = False
        with self._group.lock:
            moving = {one.generator for one in self._controllers() if one.generator.mode is Mode.TRAJECTORY}
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
        feeder, path = self.feeder, self.feeder.path
        if path is None or (joints is not None and set(joints).isdisjoint(path.joints)):
            return ()
        if not feeder.leaving:
            feeder.leave()
        report = feeder.wait_for_rest(lambda: self._sleep(_WAIT))
        if (reason := feeder.ended_by(report)) is not None:
            self.drop()
            self._group.stop(reason)
            raise StoppedError.unsent("an order", 0, f"the arm is stopped ({reason}); resume first")
        if report.state is PathState.NONE:
            self.drop()
        else:
            self._settle()
        return path.joints

    def _follow(self, state: JointState) -> StopReason | None:
        feeder = self.feeder
        report = feeder.turn(self._take_changes, urgent=self.changed)
        if feeder.refused and not self._unfit:
            # The robot's own limits are tighter: targets one by one are clamped, and given more time.
            _log.warning("the targets are sent one by one from here: %s", feeder.refused)
            self._unfit = True
        return None if report is None else self._see(report, state)

    # -- the beginning ------------------------------------------------------------------------------

    def _set_pace(self, period: float) -> None:
        pace = self.feeder.pace
        pace.period = period
        with self._group.lock:
            for controller in self._controllers():
                controller.generator.settled = pace.ahead

    def _controllers(self) -> list[TrajectoryController]:
        return [member for member in self._group.members if isinstance(member, TrajectoryController)]

    def _begin(self, state: JointState) -> None:
        """Begin a path if a trajectory was begun."""
        with self._group.lock:
            members = {
                one.generator: one
                for one in self._controllers()
                # A robot begins at rest. What moves already, target by target, goes on like that.
                if one.generator.mode is Mode.TRAJECTORY and one.generator not in self._one_by_one
            }
            if not members:
                return
            self._members = members
            for generator in members:
                generator.onboard = True
                generator.take_change()
            begins = min(first_start(generator.planned) for generator in members)
            plan = self._take_plans(begins)
        try:
            self._arm_watchdog()
            self._unfit = False
            self.feeder.begin(plan, begins)
        except (StoppedError, PreemptedError, LeaseError) as error:
            # One that the robot has must still be brought to rest.
            if self.feeder.path is None or not isinstance(error, LeaseError):
                self.drop()
            raise
        except (CommandRefusedError, UsageError) as error:
            _log.warning("the targets are sent one by one: %s", error)
            start, here = dict(zip(plan.names, plan.start, strict=True)), state.positions
            away = {name: here[name] for name, at in start.items() if abs(here[name] - at) > _AWAY}
            if away:
                # The first target would let them jump there.
                self._go_on(start | away, begins)
                return
            # Nothing was sent of it while another path was at its end.
            self._shift(max(0.0, self._clock() - begins))
            self.drop()

    def _take_plans(self, origin: float) -> Together:
        """What the members have planned, in the time of a path that began then."""
        names = tuple([name for member in self._members.values() for name in member.joints])
        self._marks = {generator: generator.changes for generator in self._members}
        parts = {
            member.joints: tuple([(path, began - origin) for path, began in generator.planned])
            for generator, member in self._members.items()
        }
        return Together(names, parts)

    def _take_changes(self) -> bool:
        """Have points made of a new plan, if there is one; False if none can be sent now."""
        feeder = self.feeder
        with self._group.lock:
            changed = [generator for generator, mark in self._marks.items() if generator.changes != mark]
            if not changed:
                return True
            if any(math.isinf(generator.changed_from) or not generator.planned for generator in changed):
                # It was released, or held before it began: then the robot must be at rest before what comes next.
                switches = None
            else:
                switches = {generator: generator.take_change() for generator in changed}
            marks, plan = self._marks, None if switches is None else self._take_plans(feeder.origin)
        if plan is None or switches is None:
            feeder.leave()
            return False
        if feeder.replace(plan, min(switches.values()) - feeder.origin):
            return True
        with self._group.lock:
            self._marks = marks
            for generator, switch in switches.items():
                generator.changed_from = min(switch, generator.changed_from)
        return False

    # -- where it is --------------------------------------------------------------------------------

    def _is_left_late(self) -> bool:
        """Whether a path that was run to its end should have been left before: the robot was not told in time."""
        ended = self.feeder.origin + self.feeder.on_robot.duration
        with self._group.lock:
            changed = [one.changed_from for one, mark in self._marks.items() if one.changes != mark]
        return any(-math.inf < when < ended for when in changed)

    def _shift(self, seconds: float) -> None:
        """Move what the generators have planned in time."""
        with self._group.lock:
            for generator in self._members:
                generator.shift(seconds)

    def _see(self, report: PathReport, state: JointState) -> StopReason | None:
        """Act on how the path has ended; returns why the motion is over, or None."""
        found, leaving = report.state, self.feeder.leaving
        if found is PathState.FAULT:
            return self._see_fault(report, state)
        if found is PathState.DRY or (leaving and found in (PathState.DONE, PathState.ABORTED)):
            self._settle()
            return None
        if found is PathState.DONE and self._is_left_late():
            self.feeder.rest, self.feeder.stands = self.feeder.on_robot.duration, None
            self._settle()
            return None
        reason = self.feeder.ended_by(report)
        self.drop()
        return reason

    def _see_fault(self, report: PathReport, state: JointState) -> StopReason | None:
        joints, (limp, reason) = self.joints, self.feeder.fault(report, state)
        if not (limp or report.towards):  # a joint was not where the path begins; nothing has moved
            self._unfit, self.feeder.rest = True, 0.0
            self._settle()
            return None
        self.drop()
        if not limp:
            return reason
        self._group.release(lost_torque(limp), joints)
        return None

    # -- coming to rest -----------------------------------------------------------------------------

    def _settle(self) -> None:
        """The robot is at rest: those that want to move go on from there."""
        feeder = self.feeder
        plan, rest = feeder.on_robot, feeder.stands
        if rest is None:
            rest = dict(zip(plan.names, plan.sample(feeder.rest).position, strict=True))
        self._refuses = self._unfit
        self._go_on(rest, feeder.origin + feeder.rest)

    def _go_on(self, rest: Mapping[str, float], left: float) -> None:
        """Let those that want to move go on from where the joints rest; see `SetPointGenerator.rejoin`."""
        members = self._members
        self.drop()
        with self._group.lock:
            for generator, controller in members.items():
                if controller.reason is not None:
                    continue
                try:
                    generator.rejoin(rest, left, self._clock(), wanted=controller.busy)
                except UsageError as error:
                    controller.release(str(error))
        self._group.deliver()
