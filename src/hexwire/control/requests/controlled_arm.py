"""The requests of fronts to an arm: motions, set-points, poses, teach mode, power, stop; and its diagnostics.

Owns which request is allowed when, across all controllers of an arm, and that a goal's way out of the running
motion is planned and checked while nobody is kept waiting. Must not know the front: requests come in as plain
values, and answers are texts.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

from hexwire.drivers.abilities import Counters, StoredCalibration
from hexwire.drivers.values import StopMode
from hexwire.errors import DeviceError, GoalError, HexwireError, UsageError
from hexwire.motion.set_point_generator import Mode
from hexwire.trace.chapter_log import format_positions

from ..loop.controller import TrajectoryController
from ..loop.outcomes import Reason
from ..loop.owner import RobotOwner
from ..loop.power import Torques, switch_torque
from ..loop.rate import Periodic
from ..motion.motion_run import MotionRun
from ..motion.path_check import PathCheck
from .diagnostics import RobotFacts
from .pose_file import find_pose
from .preview import Planner
from .teach_mode import TeachMode

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.epochs import Token
    from hexwire.model.control_law import Laws
    from hexwire.model.state import JointState, SentTarget
    from hexwire.motion.teach import Taught
    from hexwire.motion.trajectory import Sample, Trajectory

    from ..loop.known_state import KnownState
    from ..loop.outcomes import GoalListener
    from ..loop.plan import Plan
    from ..motion.goals import Tolerances, TrajectoryGoal
    from .preview import Preview
    from .settings import Settings

__all__ = ["ControlledArm", "logging_states"]

_TRIES = 3
"""How often a way is planned without the lock while the motion that it leads out of goes on; then with it."""
_LONGEST = 0.2
"""Seconds by which a goal may begin later, so that it is planned before that."""

_log = logging.getLogger(__name__)

_PERIOD = 1.0


def logging_states(
    on_state: Callable[[JointState, KnownState], object], name: str
) -> Callable[[JointState, KnownState], object]:
    """The receiver of states of a `RobotOwner`, which logs them too.

    Args:
        on_state: Receives every state, before it is logged.
        name: The robot's, for the log.
    """
    due = Periodic()

    def both(state: JointState, published: KnownState) -> None:
        on_state(state, published)
        if due.due(state.stamp, _PERIOD):
            degrees = [math.degrees(angle) for angle in state.position]
            _log.info("%s", "\n".join(format_positions(state.names, degrees, name=name)))

    return both


_NEVER = 1e9
_GRACE = 10.0
"""Default seconds after a motion's duration in which the arm must arrive."""
_QUERY_WAIT = 0.5
"""Most seconds for which a question waits: whoever asks it may be in a loop."""


class ControlledArm:
    """A robot as fronts use it. Call `connect`, then `start`; finally `shutdown`.

    Args:
        robot: Not attached.
        settings: The arm's settings.
        on_state: As in `RobotOwner`.
        on_taught: Called with a taught motion, in the thread that ended teach mode.
        on_sent: As in `RobotOwner`.
        monitored: As in `TrajectoryController`.
        clock: As in `RobotOwner`.
        sleep: As in `RobotOwner`.

    Attributes:
        owner: The owner of the robot.
        controllers: By name; a single one has the empty name.
        teach_mode: Teach mode, and the last taught motion.
        planner: Plans motions; made by `connect`.
    """

    planner: Planner

    def __init__(
        self,
        robot: RobotDriver,
        settings: Settings,
        *,
        on_state: Callable[[JointState, KnownState], object] = lambda state, published: None,
        on_taught: Callable[[Taught], object] = lambda taught: None,
        on_sent: Callable[[SentTarget], object] = lambda sent: None,
        monitored: bool = True,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], object] | None = None,
    ) -> None:
        self.settings, self._monitored = settings, monitored
        # The mark right after `readiness.deactivate`; None before.
        self.deactivated: Token | None = None
        self._check = PathCheck(settings.model, settings.kinematics, settings.table)
        self.owner = RobotOwner(
            robot,
            check=self._check,
            publish_rate=settings.publish_rate,
            command_rate=settings.command_rate,
            watchdog=settings.watchdog,
            timed=not settings.host_timed,
            on_state=logging_states(on_state, settings.model.name) if settings.log_positions else on_state,
            on_sent=on_sent,
            clock=clock,
            sleep=sleep,
        )
        self.controllers: dict[str, TrajectoryController] = {}
        self.teach_mode = TeachMode(self.owner, settings.teach_directory, on_taught)
        # Held by one long request at a time: moving to a pose, starting or ending teach mode, playing back.
        self._busy = threading.Lock()

    # -- start and shutdown -------------------------------------------------------------------------

    def connect(self) -> None:
        """Connect to the robot and create its controllers.

        Raises:
            HexwireError: As from `RobotOwner.connect`.
            DeviceError: Its servos have stored a calibration, but did not answer when the settings were read.
        """
        owner = self.owner
        owner.connect(self.settings.connect_timeout)
        if owner.model != self.settings.model:
            raise DeviceError(
                "the servos have stored a calibration that was not known when this program started; start it again"
            )
        arm = StoredCalibration.find(owner.robot)
        if arm is not None and arm.doubt:
            _log.warning("%s: `%s`", arm.doubt, arm.cure)
        # They may have changed meanwhile.
        settings = self.settings
        limits = settings.safety_at(1.0 / owner.command_period)
        self.controllers = {
            row.name: TrajectoryController(
                row,
                settings.model,
                limits,
                check=self._check,
                command_timeout=settings.command_timeout or _NEVER,
                monitored=self._monitored,
            )
            for row in settings.controllers
        }
        self.planner = Planner(owner, settings, self.controllers, self.teach_mode.hand.refuse)

    def start(self) -> None:
        """Start reading states and accepting motions."""
        self.owner.start(tuple(self.controllers.values()))
        if self.settings.enable_on_start:
            try:
                _log.info("%s", self.enable(True))
            except HexwireError as error:
                # One silent servo must not prevent reading the others.
                _log.error("not enabled: %s", error)

    def shutdown(self) -> None:
        """Stop all motion, and detach from the robot. Teach mode ends, and the arm holds."""
        self.teach_mode.shutdown(hold=not self.settings.torque_off_at_exit)
        self.owner.shutdown(torque_off=self.settings.torque_off_at_exit)

    def mark(self) -> Token:
        """A mark of now, for requests that are carried out later: a stop voids those with an earlier mark."""
        return self.owner.robot.epochs.mark()

    def void(self) -> None:
        """Void what has been asked for: a stop went ahead of requests that had not got their `mark` yet."""
        self.owner.robot.epochs.void()

    def adopt(self, settings: Settings) -> None:
        """Use changed settings, as `settings_reader.reread` makes them; a goal that is followed keeps its own."""
        with self.owner.locked():
            self.settings = settings
            for row in settings.controllers if self.controllers else ():
                self.controllers[row.name].settings = row

    # -- trajectories and set-points ------------------------------------------------------------------

    def command(
        self,
        name: str,
        goal: TrajectoryGoal,
        *,
        listener: GoalListener | None = None,
        tolerances: Tolerances | None = None,
        wanted: Callable[[], bool] = lambda: True,
        accepting: Callable[[], object] = lambda: None,
        received: float | None = None,
        asked: Token | None = None,
    ) -> None:
        """Let a controller follow a trajectory; a trajectory without points means hold.

        Args:
            name: Name of the controller.
            goal: The trajectory.
            listener: As in `TrajectoryController.accept`.
            tolerances: As in `TrajectoryController.accept`.
            wanted: Called during the path check, which takes time, and after it: whether the goal is still wanted.
            accepting: Called right before it is accepted, under the lock of the controllers.
            received: Time to which the goal's delay refers, seconds of the owner's clock; now if None.
            asked: The `mark` of when it was asked for; now if None.

        Raises:
            GoalError: The goal is refused; the previous motion continues.
        """
        controller, owner = self.controllers[name], self.owner
        asked = self.mark() if asked is None else asked
        try:
            self._refuse_void(asked)
            received = owner.now() if received is None else received
            self.teach_mode.hand.refuse()
            state = owner.newest()
            if not goal.points and listener is None:
                self.hold(name, "replaced by an empty trajectory")
                return
            plan = controller.plan(goal, received, streamed=listener is None)
            with owner.locked():
                start = controller.start(goal.delay, state, received)
                begins = max(received + goal.delay, controller.generator.next_start(received))
                others = self._meanwhile([name], begins)
            # Not under the lock, since the check of a long trajectory takes long.
            streamed = start if listener is None else None
            controller.check_path(plan.trajectory(start, received), state, others, wanted=wanted, streamed=streamed)

            def refuse() -> None:
                self.teach_mode.hand.refuse()
                self._refuse_void(asked)
                if not wanted():
                    raise GoalError("cancelled before it began", reason=Reason.CANCELLED)

            self._begin(name, plan, listener, tolerances, refuse, accepting)
        except GoalError:
            raise
        except HexwireError as error:
            raise GoalError(str(error), reason=Reason.NOT_READY) from None
        owner.hurry()
        owner.group.deliver()

    def _begin(
        self,
        name: str,
        plan: Plan,
        listener: GoalListener | None,
        tolerances: Tolerances | None,
        refuse: Callable[[], object],
        accepting: Callable[[], object],
    ) -> None:
        """Have a controller accept a goal whose path was checked; what was begun before goes on if it is refused.

        Args:
            name: Name of the controller.
            plan: Of the goal.
            listener: As in `command`.
            tolerances: As in `command`.
            refuse: Raises the error with which the goal is refused by now; called with the lock held.
            accepting: As in `command`.
        """
        owner, controller, streamed = self.owner, self.controllers[name], listener is None
        generator = controller.generator
        for i in range(_TRIES + 1):
            with owner.locked():
                refuse()
                state, now = owner.newest(), owner.now()
                soonest = generator.next_start(now)
                waits = plan.goal.delay > 0.0 and plan.due > soonest
                # What gives way needs no way, and must begin at once.
                if i == _TRIES or waits or plan.goal.gives_way:
                    accepting()
                    others = self._meanwhile([name], soonest)
                    controller.accept(plan, state, now, listener=listener, tolerances=tolerances, meanwhile=others)
                    return
                # What follows set-points is where they will be, which nobody knows.
                later = min(_LONGEST, 2.0 * controller.planning) if generator.mode is not Mode.STREAM else 0.0
                begins = soonest + (later if not generator.done or streamed else 0.0)
                others = self._meanwhile([name], begins)
                outline = controller.outline(plan, state, now, begins, others, streamed=streamed)
            ready = controller.prepare(outline)
            with owner.locked():
                refuse()
                state, done = owner.newest(), owner.now()
                controller.planning = done - now
                if controller.is_current(ready, done):
                    accepting()
                    controller.accept(plan, state, done, listener=listener, tolerances=tolerances, ready=ready)
                    return

    def query(self, name: str, delay: float) -> Sample:
        """Desired state of a controller's joints in `delay` seconds; see `TrajectoryController.query`.

        Raises:
            GoalError: As from `TrajectoryController.query`; or the controllers have been busy for half a second.
            HexwireError: There is no fresh state.
        """
        owner = self.owner
        state, lock = owner.newest(), owner.locked()
        if not lock.acquire(timeout=_QUERY_WAIT):
            raise GoalError(f"the arm has been busy for {_QUERY_WAIT:g} s; ask again", reason=Reason.NOT_READY)
        try:
            now = owner.now()
            return self.controllers[name].query(now + delay, now, state)
        finally:
            lock.release()

    def hold(self, name: str, why: str) -> None:
        """Hold a controller's joints at their last set-point."""
        with self.owner.locked():
            self.controllers[name].hold(why)
        self.owner.group.deliver()

    def set_points(
        self,
        positions: Mapping[str, float],
        *,
        near: float = math.inf,
        asked: Token | None = None,
        laws: Laws = None,
    ) -> None:
        """Follow set-points: all of them, or none.

        Args:
            positions: Radians by joint.
            near: A joint that follows no set-points must be this close to its first one, radians.
            asked: As in `command`.
            laws: Control laws by joint, for some of these joints.

        Raises:
            UsageError: There is none, a joint is unknown or too far from its first set-point, or a position is not
                a number or outside its limits.
            HexwireError: The arm is stopped or cannot be reached.
        """
        asked = self.mark() if asked is None else asked
        owner = self.owner
        self.teach_mode.hand.refuse()
        shares: dict[str, dict[str, float]] = {}
        for joint, angle in positions.items():
            which = next((key for key, c in self.controllers.items() if joint in c.joints), None)
            if which is None:
                raise UsageError(f"no joint {joint!r}; there are {', '.join(self._all_joints())}")
            shares.setdefault(which, {})[joint] = angle
        if not shares:
            raise UsageError("it has no positions")
        with owner.locked():
            self.teach_mode.hand.refuse()
            self._refuse_void(asked)
            state, now = owner.newest(), owner.now()
            for key, share in shares.items():
                self.controllers[key].check_set_points(share, state, near)
            self._check.posture(state.positions, positions)
            for key, share in shares.items():
                self.controllers[key].follow_set_points(share, now, laws)
        owner.group.deliver()

    # -- power and stop -------------------------------------------------------------------------------

    def stop(self, why: str) -> str:
        """Stop the arm and latch the stop. Joints with torque hold; joints without stay without. Teach mode ends.

        Returns:
            The result in words.

        Raises:
            HexwireError: Not every joint confirmed it; the controllers are stopped nevertheless.
        """
        try:
            confirmed = self.owner.stop(why)
        finally:
            self.teach_mode.abandon()
        missing = [name for name in self.settings.model.names if name not in confirmed]
        if missing:
            raise UsageError(f"stopped, but {', '.join(missing)} did not confirm it")
        return f"stopped, {self.torques().after_stop(confirmed, StopMode.HOLD)}; all joints confirmed it"

    def torques(self) -> Torques:
        """Which joints hold and which are limp, by the newest state."""
        owner = self.owner
        return Torques.of(self.settings.model.names, owner.state if owner.connected else None, owner.now())

    def refuse_stopped(self) -> None:
        """Raise a GoalError if the arm is stopped."""
        self._check.stop_latch(self.owner.group.reason)

    def reset(self, asked: Token | None = None) -> str:
        """Clear a latched stop. Nothing moves.

        Args:
            asked: As in `command`: a later stop is not cleared.

        Raises:
            HexwireError: Its cause persists, or the robot refuses.
        """
        if asked is not None and self.owner.robot.epochs.stopped_since(asked):
            raise UsageError("the arm was stopped again; reset it again")
        self.owner.reset(asked)
        return "reset; nothing moves until the next command"

    def enable(self, on: bool, asked: Token | None = None) -> str:
        """Switch torque of all controlled joints on, at the present position, or off.

        Args:
            on: On, not off.
            asked: As in `command`; torque off is never void.

        Raises:
            HexwireError: The arm is stopped or in teach mode, or not every joint confirmed it.
        """
        with self.teach_mode.hand.power:
            self.teach_mode.hand.refuse()
            if on and asked is not None:
                self._refuse_void(asked)
            switch_torque(self.owner, on, self._all_joints())
        return f"torque is {'on' if on else 'off'}"

    # -- poses and teaching -----------------------------------------------------------------------------

    def go_to(self, pose: str, asked: Token | None = None) -> str:
        """Move to a named pose, and wait for the arrival. Replaces the running motion.

        Args:
            pose: Its name.
            asked: As in `command`.

        Raises:
            HexwireError: There is no such pose, the path is not allowed, or the arm did not arrive.
        """
        asked = self.mark() if asked is None else asked
        goals = find_pose(self.settings.model, self.settings.poses, pose)
        if lost := [name for name in goals if name not in self._all_joints()]:
            raise UsageError(f"no controller moves {', '.join(lost)}; there are {', '.join(self._all_joints())}")
        with self._alone():
            off = self._carry_out(
                lambda: self.planner.to_joints(goals, speed=self.settings.pose_speed),
                f"a motion to {pose}",
                asked,
                *goals,
            )
        return ", ".join((f"at {pose}", *off))

    def teach_start(self, asked: Token | None = None) -> str:
        """Start teach mode: switch torque off and record the motion of the arm. Somebody must hold the arm.

        Args:
            asked: As in `command`.

        Raises:
            HexwireError: As `TeachMode.start`, or the arm is busy.
        """
        names = self._all_joints()
        with self._alone():
            if asked is not None:
                self._refuse_void(asked)
            self.teach_mode.hand.start(names)
        return f"teaching {', '.join(names)}; they have no torque"

    def teach_stop(self) -> str:
        """End teach mode; its joints hold their present position, also those that had no torque before.

        Raises:
            HexwireError: As `TeachMode.stop`, or the arm is busy.
        """
        with self._alone():
            return self.teach_mode.stop()

    def teach_play(self, asked: Token | None = None) -> str:
        """Move to the start of the taught motion, play it, and wait for its end.

        Args:
            asked: As in `command`.

        Raises:
            HexwireError: Nothing was taught, the path is not allowed, or the arm did not arrive.
        """
        asked = self.mark() if asked is None else asked
        taught = self.teach_mode.taught
        if taught is None:
            raise UsageError("nothing was taught since the start")
        with self._alone():
            off = self._carry_out(
                lambda: self.planner.along(taught, speed=self.settings.pose_speed),
                "the taught motion",
                asked,
                *taught.names,
            )
        return ", ".join((f"played {taught.duration:.1f} s", *off))

    # -- diagnostics ----------------------------------------------------------------------------------

    def facts(self) -> RobotFacts:
        """The input of `diagnose`."""
        owner = self.owner
        reason = owner.group.reason
        return RobotFacts(
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
            "stalls_of_the_loop": sum(c.generator.counters.slips for c in self.controllers.values()),
            "set_points_lost": sum(c.generator.counters.lost for c in self.controllers.values()),
        }
        counters = Counters.find(self.owner.robot) if self.owner.connected else None
        return own if counters is None else own | counters.host_counters()

    # -- helpers --------------------------------------------------------------------------------------

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Have the arm for a long request; it is refused while another one has it."""
        if not self._busy.acquire(blocking=False):
            raise UsageError("the arm is busy with another request; wait, or stop it")
        try:
            yield
        finally:
            self._busy.release()

    def _meanwhile(self, names: Collection[str], when: float) -> list[Trajectory]:
        """What remains of the other controllers' trajectories at a time."""
        paths = [c.generator.ahead(when) for name, c in self.controllers.items() if name not in names]
        return [path for path in paths if path is not None]

    def _refuse_void(self, asked: Token) -> None:
        """Refuse what was asked for before a stop or torque off; under the controllers' lock, or early."""
        epochs = self.owner.robot.epochs
        if not epochs.holds(asked):
            if epochs.limp_since(asked):
                raise GoalError(
                    "torque was switched off since it was asked for; ask again", reason=Reason.NOT_READY
                )
            raise GoalError("the arm was stopped since it was asked for; ask again", reason=Reason.STOPPED)

    def _all_joints(self) -> tuple[str, ...]:
        return tuple(name for controller in self.controllers.values() for name in controller.joints)

    def _carry_out(self, plan: Callable[[], Preview], title: str, asked: Token, *joints: str) -> tuple[str, ...]:
        """Hold, plan a motion of some joints from there, follow it, and wait for its end.

        Returns:
            How far off joints are then.
        """
        self.teach_mode.hand.refuse()
        self._refuse_void(asked)
        for name, controller in self.controllers.items():
            if not set(joints).isdisjoint(controller.joints):
                self.hold(name, f"replaced by {title}")
        found = plan()
        goals = found.goals(self.controllers)
        run = MotionRun(self.owner, self.controllers.values())

        def begin() -> None:
            for name, goal in goals.items():
                tolerances = self.controllers[name].settings.tolerances
                tolerances = replace(tolerances, goal_time=tolerances.goal_time or _GRACE)
                self.command(name, goal, listener=run, tolerances=tolerances, asked=asked)

        run.begin(len(goals), begin)
        run.wait(found.duration + 2.0 * _GRACE)
        return run.off
