"""Everything a front can ask an arm for: motions, set-points, poses, teaching, power, stop; and what it reports.

Owns what is allowed when, across all controllers of an arm. Must not know who asks: requests come as plain values,
and answers are words.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from hexwire.errors import GoalError, HexwireError, UsageError
from hexwire.motion.fence import Fence
from hexwire.motion.teach import approach

from .controller import TrajectoryController
from .diagnostics import Facts
from .outcomes import Reason
from .owner import RobotOwner
from .path_check import PathCheck
from .power import switch_torque
from .teach_mode import TeachMode
from .waiting import TryLock, Waiter

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.state import JointState
    from hexwire.motion.teach import Taught
    from hexwire.motion.waypoints import Sample, Trajectory

    from .goals import Tolerances, TrajectoryGoal
    from .known_state import KnownState
    from .outcomes import GoalListener
    from .settings import Settings

__all__ = ["Arm"]

_log = logging.getLogger(__name__)

_NEVER = 1e9
_GRACE = 10.0
"""Seconds beyond a motion's own duration in which the arm must arrive, where its settings name no other time."""


class Arm:
    """A robot as fronts use it. `connect`, then `start`; `shutdown` at the end.

    Args:
        robot: Not attached.
        settings: What the front has set.
        on_state: As in `RobotOwner`.
        on_taught: Called with what was taught, in the thread that ended it.
        clock: As in `RobotOwner`.
        sleep: Likewise.

    Attributes:
        owner: Of the robot.
        controllers: By name; the only one has the empty name.
        teach_mode: Teaching by hand, and what was taught.
    """

    def __init__(
        self,
        robot: RobotDriver,
        settings: Settings,
        *,
        on_state: Callable[[JointState, KnownState], object] = lambda state, published: None,
        on_taught: Callable[[Taught], object] = lambda taught: None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], object] | None = None,
    ) -> None:
        self.settings = settings
        self.owner = RobotOwner(
            robot,
            publish_rate=settings.publish_rate,
            command_rate=settings.command_rate,
            watchdog=settings.watchdog,
            on_state=on_state,
            clock=clock,
            sleep=sleep,
        )
        self.controllers: dict[str, TrajectoryController] = {}
        self.teach_mode = TeachMode(self.owner, settings.teach_directory, on_taught)
        # One request at a time that takes the arm for longer: a pose, teaching, playing back.
        self._busy = threading.Lock()

    # -- coming and going ---------------------------------------------------------------------------

    def connect(self) -> None:
        """Find the robot and make its controllers; as `RobotOwner.connect`."""
        settings, owner = self.settings, self.owner
        owner.connect(settings.connect_timeout)
        if settings.kinematics is not None:
            owner.group.fence = Fence(settings.kinematics, settings.table, moving=True)
        limits = settings.safety_at(1.0 / owner.command_period)
        self.controllers = {
            row.name: TrajectoryController(
                row,
                settings.model,
                limits,
                kinematics=settings.kinematics,
                table=settings.table,
                command_timeout=settings.command_timeout or _NEVER,
            )
            for row in settings.controllers
        }

    def start(self) -> None:
        """Read and move from now on."""
        self.owner.start(tuple(self.controllers.values()))
        if self.settings.enable_on_start:
            try:
                _log.info("%s", self.enable(True))
            except HexwireError as error:
                # One servo that is silent must not keep the others from being seen.
                _log.error("not enabled: %s", error)

    def shutdown(self) -> None:
        """Stop what moves, and let go of the robot."""
        self.owner.shutdown(torque_off=self.settings.torque_off_at_exit)

    # -- trajectories and set-points ------------------------------------------------------------------

    def command(
        self,
        name: str,
        goal: TrajectoryGoal,
        *,
        listener: GoalListener | None = None,
        tolerances: Tolerances | None = None,
        wanted: Callable[[], bool] = lambda: True,
    ) -> None:
        """Have a controller follow a trajectory; one without points means hold.

        Args:
            name: Of the controller.
            goal: What was sent.
            listener: As in `TrajectoryController.accept`.
            tolerances: Likewise.
            wanted: Asked when it was checked, which takes time: whether it is still to be followed.

        Raises:
            GoalError: It cannot be followed; what was followed before goes on.
        """
        controller, owner = self.controllers[name], self.owner
        try:
            received = owner.now()
            self.teach_mode.hand.refuse()
            state = owner.newest()
            if not goal.points and listener is None:
                self.hold(name, "an empty trajectory came")
                return
            plan = controller.plan(goal, received)
            with owner.locked():
                start = controller.start(goal.delay, state, received)
                others = self._meanwhile([name], controller.follower.next_start(received + max(0.0, goal.delay)))
            # Takes long for a long one, so not under the lock.
            controller.check_path(plan.trajectory(start, received), state, others)
            with owner.locked():
                self.teach_mode.hand.refuse()
                if not wanted():
                    raise GoalError("cancelled before it began", reason=Reason.CANCELLED)
                now = owner.now()
                controller.accept(
                    plan,
                    owner.newest(),
                    now,
                    listener=listener,
                    tolerances=tolerances,
                    meanwhile=self._meanwhile([name], controller.follower.next_start(now)),
                )
        except GoalError:
            raise
        except HexwireError as error:
            raise GoalError(str(error), reason=Reason.NOT_READY) from None
        owner.hurry()
        owner.deliver()

    def query(self, name: str, delay: float) -> Sample:
        """Where a controller's joints are meant to be in `delay` seconds; as `TrajectoryController.query`."""
        owner = self.owner
        state = owner.newest()
        with owner.locked():
            now = owner.now()
            return self.controllers[name].query(now + delay, now, state)

    def hold(self, name: str, why: str) -> None:
        """Have a controller's joints stay where they were told to be last."""
        with self.owner.locked():
            self.controllers[name].hold(why)
        self.owner.deliver()

    def cancel(self, name: str, listener: GoalListener) -> None:
        """Hold, if what is followed is this one's goal."""
        with self.owner.locked():
            self.controllers[name].cancel(listener)
        self.owner.deliver()

    def set_points(self, positions: Mapping[str, float]) -> None:
        """Pursue set-points: all of them, or none.

        Args:
            positions: Radians by joint.

        Raises:
            UsageError: There is none, a joint is unknown, or a position is no number or outside limits.
            HexwireError: The arm is stopped or cannot be reached.
        """
        owner = self.owner
        self.teach_mode.hand.refuse()
        shares: dict[str, dict[str, float]] = {}
        for joint, angle in positions.items():
            which = next((key for key, c in self.controllers.items() if joint in c.joints), None)
            if which is None:
                raise UsageError(f"no joint {joint!r}; there are {', '.join(self._all_joints())}")
            self.settings.model.joint(joint).check(angle)
            shares.setdefault(which, {})[joint] = angle
        if not shares:
            raise UsageError("it holds no position, and these servos take nothing else")
        with owner.locked():
            self.teach_mode.hand.refuse()
            state, now = owner.newest(), owner.now()
            path = PathCheck(self.settings.model, self.settings.kinematics, self.settings.table)
            for key, share in shares.items():
                self.controllers[key].check_set_points(share, state)
            path.posture(state.positions, positions)
            for key, share in shares.items():
                self.controllers[key].set_points(share, state, now)
        owner.deliver()

    # -- power and stop -------------------------------------------------------------------------------

    def stop(self, why: str) -> str:
        """Latched stop; the joints hold where they are, and those without torque get none. Teaching ends.

        Returns:
            What was done, for people.

        Raises:
            HexwireError: Not every joint confirmed it; the controllers are stopped all the same.
        """
        try:
            confirmed = self.owner.stop(why)
        finally:
            self.teach_mode.abandon()
        missing = [name for name in self.settings.model.names if name not in confirmed]
        if missing:
            raise UsageError(f"stopped, but {', '.join(missing)} did not confirm it")
        return "stopped; all joints confirmed it"

    def reset(self) -> str:
        """End a stop. Nothing moves by it.

        Raises:
            HexwireError: Its cause is still there, or the robot refuses.
        """
        self.owner.reset()
        return "reset; nothing moves until it is told to"

    def enable(self, on: bool) -> str:
        """Torque of all controlled joints on, where they are, or off.

        Raises:
            HexwireError: Stopped, being taught, or not every joint confirmed it.
        """
        with self.teach_mode.hand.power:
            self.teach_mode.hand.refuse()
            switch_torque(self.owner, on, self._all_joints())
        return f"torque is {'on' if on else 'off'}"

    # -- poses and teaching -----------------------------------------------------------------------------

    def go_to(self, pose: str) -> str:
        """Go to a named pose, and wait until the arm is there. What was followed before ends.

        Raises:
            HexwireError: There is no such pose, it cannot be gone to, or the arm did not arrive.
        """
        goals = self.settings.poses.get(pose)
        if goals is None:
            raise UsageError(f"no pose {pose!r}; there are {', '.join(self.settings.poses) or 'none'}")
        with self._exclusive():
            self._travel(goals, f"the arm goes to {pose}")
        return f"at {pose}"

    def teach_start(self) -> str:
        """Take the torque away and take down where a hand leads the arm. Somebody must hold it.

        Raises:
            HexwireError: As `TeachMode.start`, or somebody else has the arm.
        """
        names = self._all_joints()
        with self._exclusive():
            self.teach_mode.start(names)
        return f"teaching {', '.join(names)}; they have no torque"

    def teach_stop(self) -> str:
        """End teaching; joints that had torque before hold where they are now.

        Raises:
            HexwireError: As `TeachMode.stop`, or somebody else has the arm.
        """
        with self._exclusive():
            return self.teach_mode.stop()

    def teach_play(self) -> str:
        """Go to where what was taught begins, follow it, and wait for its end.

        Raises:
            HexwireError: Nothing was taught, or it cannot be followed.
        """
        taught = self.teach_mode.taught
        if taught is None:
            raise UsageError("nothing was taught since the node started")
        with self._exclusive():
            self._travel(dict(zip(taught.names, taught.rows[0], strict=True)), "the arm plays what was taught")
            self._run({key: taught_part(taught, c.joints) for key, c in self.controllers.items()})
        return f"played {taught.duration:.1f} s"

    # -- what it reports ------------------------------------------------------------------------------

    def facts(self) -> Facts:
        """What diagnostics are made of."""
        owner = self.owner
        reason = owner.group.reason
        return Facts(
            robot=self.settings.model.name,
            url=owner.robot.url,
            connected=owner.connected,
            error=owner.error,
            reconnects=owner.reconnects,
            probe=owner.probe,
            state=owner.state,
            state_age=owner.state_age,
            rate=owner.rate,
            wanted_rate=self.settings.publish_rate,
            stopped=str(reason) if reason else "",
            stop_kind=reason.kind if reason else "",
            counters=self._counters(),
            controllers={key: controller.words for key, controller in self.controllers.items()},
            watchdog=owner.watchdog,
        )

    def _counters(self) -> Mapping[str, int]:
        own = {
            "stalls_of_the_loop": sum(c.follower.counters.slips for c in self.controllers.values()),
            "set_points_lost": sum(c.follower.counters.lost for c in self.controllers.values()),
        }
        return own | (self.owner.robot.host_counters() if self.owner.connected else {})

    # -- helpers --------------------------------------------------------------------------------------

    def _meanwhile(self, names: Collection[str], when: float) -> list[Trajectory]:
        """What the other controllers have left to follow at a time."""
        ways = [c.follower.ahead(when) for name, c in self.controllers.items() if name not in names]
        return [way for way in ways if way is not None]

    def _exclusive(self) -> TryLock:
        return TryLock(self._busy)

    def _all_joints(self) -> tuple[str, ...]:
        return tuple(name for controller in self.controllers.values() for name in controller.joints)

    def _travel(self, goals: Mapping[str, float], why: str) -> None:
        """Go somewhere the careful way, from rest, and wait."""
        lost = [name for name in goals if name not in self._all_joints()]
        if lost:
            raise UsageError(f"no controller moves {', '.join(lost)}; there are {', '.join(self._all_joints())}")
        ways: dict[str, Trajectory] = {}
        with self.owner.locked():
            self.teach_mode.hand.refuse()
            state, now = self.owner.newest(), self.owner.now()
            for key, controller in self.controllers.items():
                joints = controller.joints
                if not any(name in goals for name in joints):
                    continue
                controller.hold(why)
                here = controller.start(0.0, state, now).position
                there = [goals.get(name, angle) for name, angle in zip(joints, here, strict=True)]
                ways[key] = approach(self.settings.model, joints, here, there, speed=self.settings.pose_speed)
        self.owner.deliver()
        self._run(ways)

    def _run(self, ways: Mapping[str, Trajectory]) -> None:
        """Check trajectories, one a controller, follow them together, and wait for the end of all."""
        owner = self.owner
        state = owner.newest()
        with owner.locked():
            others = self._meanwhile(ways, owner.now())
        for key, way in ways.items():
            meanwhile = [*others, *(other for other in ways.values() if other is not way)]
            self.controllers[key].check_path(way, state, meanwhile)
        waiter = Waiter(len(ways))
        try:
            with owner.locked():
                for key, way in ways.items():
                    tolerances = self.controllers[key].settings.tolerances
                    tolerances = replace(tolerances, goal_time=tolerances.goal_time or _GRACE)
                    self.controllers[key].follow(way, state, owner.now(), listener=waiter, tolerances=tolerances)
            owner.hurry()
            owner.deliver()
            # The controllers judge the arrival; this is for an owner that judges nothing any more.
            waiter.wait(max(way.duration for way in ways.values()) + 2.0 * _GRACE)
        finally:
            # If one fails, or nobody waits any more, the others must not go on.
            with owner.locked():
                for key in ways:
                    self.controllers[key].cancel(waiter)
            owner.deliver()


def taught_part(taught: Taught, joints: Sequence[str]) -> Trajectory:
    """The part of what was taught that is a controller's."""
    places = [taught.names.index(name) for name in joints]
    rows = tuple(tuple(row[i] for i in places) for row in taught.rows)
    return type(taught)(tuple(joints), taught.times, rows).trajectory()
