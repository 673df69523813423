"""Runs one complete motion for a program, or opens and closes its gripper.

Owns the check of its path, what may be asked for, the order (torque, watchdog, motion, arrival, rest) and what ends
it early: along a path that the board keeps, or target by target. A trajectory is monitored for following error,
load, faults and old states. Must not know terminals, nor where a motion comes from.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

from hexwire.arguments import FLAG, ROBOT, check
from hexwire.drivers.abilities import OnboardPaths, OwnWatchdog, RefilledPaths, Watchdog
from hexwire.drivers.timed_path import PathState
from hexwire.drivers.tools import Gripper
from hexwire.errors import (
    CommandRefusedError,
    DeviceError,
    GoalError,
    HexwireError,
    LeaseError,
    LimitError,
    PreemptedError,
    ServoError,
    StoppedError,
    UsageError,
)
from hexwire.model.state import JointTarget, SentTarget
from hexwire.motion.checks import InJoints
from hexwire.motion.joined import Joined
from hexwire.motion.limits import Slower, check_target, resting_inside, slow_enough, smooth_duration
from hexwire.motion.safety import STOP_COMMAND, TORQUE_OFF, SafetyLimits, StopReason, board_stop
from hexwire.motion.trajectory import Spline, Trajectory, Waypoint
from hexwire.wire.command_frame import Status

from ..loop.controller import TrajectoryController
from ..loop.holding import brake_at_end
from ..loop.outcomes import Outcome, Reason
from ..loop.owner import RobotOwner
from ..loop.power import NOT_LATCHED, give_torque, what_helps
from ..loop.reader import position_unknown, read_known, read_state
from ..loop.target import TargetController, holding
from ..requests.settings import ControllerSettings
from .arrival import Tolerance
from .board_path_feeder import BoardPathFeeder
from .goals import Tolerances
from .jaws import GRACE, MOST_SECONDS, Closing, jaw_tolerance
from .motion_options import MotionObserver, MotionOptions, wanted_options
from .motion_result import MotionResult
from .motion_run import MotionRun
from .path_check import CheckedPath
from .rest import come_to_rest

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.epochs import Token
    from hexwire.model.state import JointState

    from ..loop.group import Controller

__all__ = [
    "CheckedPath",
    "Execution",
    "MotionObserver",
    "MotionOptions",
    "MotionResult",
    "Until",
    "apart",
    "check_path",
    "path_to",
    "run_grip",
    "run_motion",
    "sent_as",
]

Until = Callable[["JointState"], bool | JointTarget | None]
"""Called with every state: whether the motion is to end now, or a target that replaces it."""

_LOOK = 0.1
"""Seconds between two states that show whether a joint is moving."""
_APART = math.radians(0.4)
"""A trajectory that begins further from the arm than this, more than a few counts, is joined from there."""
_FLICKER = math.radians(0.2)
"""Two counts: a smaller difference is noise, not motion."""
_BRIEF = 0.05
"""Seconds; a shorter motion is one target."""
_MOVING = math.radians(20.0)
"""Radians per second; a faster joint is turning, and a path begins at rest. Flicker by a count is slower."""
_POINTS = 12
"""Parts of a path: enough for a twentieth of a count over half a turn, and few enough to fit on any board."""
_LONGEST = 6.0
"""Most seconds between two points; a board takes 6.5."""
_TICK = 1e-4
"""Seconds, of which the times of points are multiples."""
_TOO_SLOW = "the board came to rest on its path, because this program was too slow to send the next points"


class Execution:
    """One motion; see `run_motion`. Call `run` once.

    Args:
        robot: Attached.
        options: How it is run and checked.
        observer: Is called at its events.
        asked: When it was asked for; a stop since then voids it.
        until: As in `run_motion`.
        safe: As in `run_motion`.
        closing: Of a target of the gripper: whether its jaws hold an object, which ends the motion.
    """

    def __init__(
        self,
        robot: RobotDriver,
        options: MotionOptions,
        observer: MotionObserver,
        asked: Token,
        until: Until | None = None,
        safe: AbstractContextManager[object] | None = None,
        closing: Closing | None = None,
    ) -> None:
        self._robot, self._options, self._observer, self._asked = robot, options, observer, asked
        self._until, self._safe, self._closing = until, safe, closing
        self._rate = options.rate or robot.command_rate
        # Of a path that the board keeps; None if targets are sent.
        self._feeder: BoardPathFeeder | None = None
        # A stop of the arm has ended that path.
        self._stopped = False

    def run(
        self,
        motion: Trajectory | Sequence[Trajectory] | CheckedPath | JointTarget,
        *,
        wait: bool = True,
        rest: bool = False,
    ) -> MotionResult:
        """Run it; as `run_motion`."""
        robot, options = self._robot, self._options
        clock = options.clock or robot.now
        began = clock()
        if isinstance(motion, JointTarget):
            result = self._target(motion, wait=wait)
            goal = motion.positions if result.cut else () if result.sent is None else result.sent.positions
        else:
            path = motion if isinstance(motion, CheckedPath) else check_path(robot, motion, options)
            began = clock()
            result = replace(self._path(path.legs, path.grip), slowed=path.slowed)
            goal = tuple(zip(path.legs[-1].names, path.legs[-1].goal, strict=True))
        if wait:
            result = replace(result, seconds=clock() - began)
        if not (rest and goal and result.stopped is None and (result.arrived or result.cut)):
            return result
        return replace(result, rest=come_to_rest(robot, dict(goal), clock=clock, sleep=options.sleep))

    def _path(self, legs: Sequence[Trajectory], grip: float | None = None) -> MotionResult:
        """Follow checked trajectories, each from where the previous one ends.

        Args:
            legs: The trajectories.
            grip: As in `CheckedPath`.
        """
        robot, options, names = self._robot, self._options, legs[0].names
        gripper = None if grip is None else Gripper(robot)
        jaws: TargetController | None = None
        jaws_at = {} if gripper is None or grip is None else {gripper.joint.name: gripper.angle(grip)}
        every = (*names, *jaws_at)
        none = Tolerances(dict.fromkeys(names, Tolerance()), dict.fromkeys(names, Tolerance()))
        last = Tolerances(none.path, options.goal(names), options.grace)
        limits = options.limits or SafetyLimits.at_period(1.0 / self._rate)
        # The paths are checked, but not the way from the arm to the first one.
        kept = ControllerSettings("", names, True, none), robot.model, limits
        controller = TrajectoryController(*kept, check=options.checks(robot))
        arrived, end = False, None
        # The server of a shared arm follows a path as its goal, which a target for the gripper would end.
        timed = robot.can(OnboardPaths) and not options.host_timed and (grip is None or robot.can(RefilledPaths))
        # And with it, it holds the joints that are not on the path.
        driven = every if not timed or robot.can(RefilledPaths) else robot.model.names

        def was_sent(sent: SentTarget) -> None:
            if jaws is not None:
                jaws.was_sent(sent)

        with self._owned(was_sent) as owner:
            powered = self._give_torque(driven, read_state(robot))
            self._start(owner, controller)
            if timed and (here := self._here(owner)) is not None:
                whole = legs[0] if len(legs) == 1 else Joined(legs)
                whole = _from_here(controller, whole, here)

                def shifted(by: float) -> None:
                    with owner.locked():
                        controller.generator.shift(by)

                # A path of no length has one point, which no robot starts: one target says the same.
                if whole.duration > 0.0 and self._feed_path(
                    whole, outlives=options.outlives, owner=owner, shifted=shifted
                ):
                    legs = (whole,)
                    controller.generator.waits = False
            if gripper is not None and grip is not None and (here := self._here(owner)) is not None:
                jaws = self._jaws(Closing(gripper, grip, here), jaws_at, here)
                with owner.locked():
                    owner.group.members = (controller, jaws)
            for leg in legs:
                here = self._here(owner)
                # Stopped before it began: `stopped` has the reason.
                if here is None:
                    break
                arrived, end = self._follow(owner, controller, leg, here, last if leg is legs[-1] else none)
                if not arrived:
                    break
            self._come_to_rest(owner, abort=bool(end) or not arrived)
            off, without_torque = controller.off, tuple[str, ...]()
            if jaws is not None:
                if arrived and not end:
                    end = self._turn(owner, lambda: jaws.over or owner.group.reason is not None)
                arrived = arrived and (jaws.holds or jaws.arrived)
                off, without_torque = (*off, *jaws.off), jaws.without_torque
            braking = [controller] if jaws is None or jaws.over else [controller, jaws]
            reason = self._end_at(owner, end, every, *braking)
            controller.hold("it is over")
            if jaws is not None:
                jaws.release("it is over")
            return MotionResult(
                arrived,
                owner.group.reason or reason,
                off,
                without_torque,
                cut=bool(end),
                powered=powered,
                state=owner.state,
                timing=owner.timing.counters,
                timed=self._feeder is not None,
                holds=jaws is not None and jaws.holds,
                opening=math.nan if gripper is None or owner.state is None else gripper.share(owner.state),
            )

    def _jaws(self, closing: Closing, goal: Mapping[str, float], state: JointState) -> TargetController:
        """What moves the gripper while the other joints follow a path."""
        arm, here, joint = self._robot.model, state.positions, closing.gripper.joint
        target = JointTarget.of(goal, max(MOST_SECONDS, smooth_duration(arm, here, goal)))
        # In steps, like the targets of the others: one target of all joints has one duration.
        step = None if self._feeder is not None else 1.0 / self._rate
        return TargetController(
            check_target(arm, target, here),
            here,
            {joint.name: jaw_tolerance(joint)},
            grace=self._options.grace,
            step=step,
            early=False,
            arm=arm,
            closing=closing,
            eases=step,
        )

    def _target(self, target: JointTarget, *, wait: bool) -> MotionResult:
        """Move joints to a target.

        Args:
            target: Not checked.
            wait: Watch it until it has arrived.
        """
        robot, options, observer = self._robot, self._options, self._observer
        state = _check_target(robot, dict(target.positions), options)
        target = check_target(robot.model, target, {})
        gripper = None if self._closing is None else self._closing.gripper
        goal = dict(target.positions)
        with self._asked_then():
            cleared = robot.can(OnboardPaths) and OnboardPaths.of(robot).clear_path(list(goal))
        if cleared:
            # The joints are elsewhere now, and at rest.
            state = _check_target(robot, goal, options)
        # Its ends are smooth; a longer time that was asked for stays.
        target = replace(target, duration=max(target.duration, smooth_duration(robot.model, state.positions, goal)))
        powered = self._give_torque(list(goal), state)
        # What `until` ends is replaced at once, but a path comes to rest first. And the server of a shared arm,
        # which refills none, follows a path as a goal: it would stop an arm whose gripper meets an object.
        timed = robot.can(RefilledPaths) and not options.host_timed and self._until is None
        if not wait:
            sent = self._send_and_leave(target, timed=timed)
            return MotionResult(
                None, powered=powered, sent=sent, seconds=sent.duration, timed=self._feeder is not None
            )
        step = None if robot.can(Watchdog) else 1.0 / self._rate
        here = state.positions
        if step is not None:
            target = check_target(robot.model, target, here)
        controller = TargetController(
            target,
            here,
            options.goal(list(goal)),
            grace=options.grace,
            step=step,
            early=options.early,
            waits=timed,
            arm=robot.model,
            closing=self._closing,
        )

        def was_sent(sent: SentTarget) -> None:
            controller.was_sent(sent)
            if step is None and not controller.holds:
                observer.sent(sent)

        with self._owned(was_sent) as owner:

            def ended(found: StopReason) -> None:
                if self._stopped:
                    owner.group.stop(found)
                    return
                # The next states say what is wrong.
                with owner.locked():
                    controller.cut(str(found), owner.now())

            if step is not None:
                observer.sent(SentTarget(target.positions, target.duration))
            self._start(owner, controller)
            newest = self._here(owner) if timed and not controller.over else None
            if newest is not None and (path := path_to(robot, target, newest)) is not None:
                self._feed_path(path, outlives=options.outlives, owner=owner, apart=apart(path))
                if self._feeder is not None:
                    # Its end may be judged by this program's clock: the grace is longer than what clocks differ.
                    with owner.locked():
                        controller.on_path(sent_as(robot, path), self._feeder.origin)
                    observer.sent(sent_as(robot, path))
            if self._feeder is None:
                controller.go()
            end = self._turn(owner, lambda: controller.over, ended)
            self._come_to_rest(owner, abort=not controller.arrived)
            reason = self._end_at(owner, end, goal, controller)
            controller.release("it is over")
            return MotionResult(
                controller.arrived,
                controller.reason or reason,
                controller.off,
                controller.without_torque,
                cut=bool(end) or controller.holds,
                powered=powered,
                sent=controller.sent,
                state=owner.state,
                timing=owner.timing.counters,
                timed=self._feeder is not None,
                ended=controller.ended,
                holds=controller.holds,
                opening=math.nan if gripper is None or owner.state is None else gripper.share(owner.state),
            )

    # -- the steps ----------------------------------------------------------------------------------

    @contextmanager
    def _asked_then(self) -> Iterator[None]:
        """Requests inside the block count as made when the motion was asked for, so that a later stop voids them.

        Raises:
            StoppedError: There was a stop since then, or torque was switched off.
        """
        self._robot.epochs.check(self._asked, "the motion")
        with self._robot.epochs.using(self._asked):
            yield

    @property
    def _limp(self) -> bool:
        """Torque was switched off since the motion was asked for."""
        return self._robot.epochs.limp_since(self._asked)

    @contextmanager
    def _owned(self, on_sent: Callable[[SentTarget], object] = lambda sent: None) -> Iterator[RobotOwner]:
        options = self._options
        owner = RobotOwner(
            self._robot,
            borrowed=True,
            check=options.checks(self._robot),
            asked=self._asked,
            on_sent=on_sent,
            command_rate=self._rate,
            watchdog=options.watchdog,
            watchdog_mode=options.watchdog_mode,
            stop_on_failure=self._safe is None,
            clock=options.clock,
            sleep=options.sleep,
        )
        if not self._robot.can(OwnWatchdog):
            self._observer.unwatched(owner.lead)
        owner.observe(self._observer.seen)
        with owner, self._safe or nullcontext():
            yield owner

    def _give_torque(self, names: Sequence[str], state: JointState) -> tuple[str, ...]:
        with self._asked_then():
            powered = give_torque(self._robot, names, state)
        if powered:
            self._observer.powered(powered)
        return powered

    def _start(self, owner: RobotOwner, controller: Controller) -> None:
        """Begin to turn.

        Raises:
            StoppedError: The arm is stopped, or was stopped or without torque since the motion was asked for.
        """
        owner.group.members = (controller,)
        owner.turn()
        reason, state = owner.group.reason, owner.state
        is_stopped = (state is not None and state.stopped) or not self._robot.epochs.holds(self._asked)
        if reason is not None and reason.kind == "board" and is_stopped:
            helps = NOT_LATCHED if self._limp else what_helps(self._robot, state)
            raise StoppedError("the motion", Status.STOPPED, f"{reason}; {helps}")
        self._observer.started(owner.timing)

    def _here(self, owner: RobotOwner) -> JointState | None:
        """The newest state, for a motion to begin there; None if it was stopped before.

        This thread alone asks for states: if it was late, it first asks for one.
        """
        if owner.group.reason is None:
            try:
                return owner.newest()
            except DeviceError:
                owner.turn()
        return owner.newest() if owner.group.reason is None else None

    def _follow(
        self,
        owner: RobotOwner,
        controller: TrajectoryController,
        leg: Trajectory,
        here: JointState,
        tolerances: Tolerances,
    ) -> tuple[bool, JointTarget | Literal[True] | None]:
        """Follow one trajectory from a state; returns whether it has arrived, and what `_turn` returns."""
        run = MotionRun(owner, (controller,))

        def begin() -> None:
            with owner.locked():
                begins = owner.now() if self._feeder is None else self._feeder.origin
                controller.follow(leg, here, begins, listener=run, tolerances=tolerances)

        run.begin(1, begin)
        end = self._turn(owner, lambda: run.over, owner.group.stop)
        return run.outcome is Outcome.SUCCEEDED, end

    def _turn(
        self,
        owner: RobotOwner,
        over: Callable[[], bool],
        ended: Callable[[StopReason], object] | None = None,
    ) -> JointTarget | Literal[True] | None:
        """Turn until `over` returns true, or `until` ends the motion; returns what it ended it with, or None.

        Args:
            owner: Of the robot.
            over: Whether the motion is over.
            ended: Called with the reason if the board does not follow its path any more; None if the path is over.

        Raises:
            LimitError: A server or robot does not allow the next target, although the path was allowed here.
        """
        while not over():
            if ended is not None and (found := self._feed()) is not None:
                ended(found)
                if over():
                    break
            try:
                owner.turn()
            except LimitError as error:
                words = str(error).removesuffix("; nothing was sent")
                raise LimitError(f"{words}: the motion ended on its way") from error
            if self._until is not None and owner.state is not None and (end := self._until(owner.state)):
                return end
        return None

    def _end_at(
        self,
        owner: RobotOwner,
        end: JointTarget | Literal[True] | None,
        joints: Collection[str],
        *controllers: TrajectoryController | TargetController,
    ) -> StopReason | None:
        """Brake what `until` has ended, or send what replaces it; returns the reason if the arm is stopped.

        Args:
            owner: Of the robot.
            end: As `_turn` returned it.
            joints: That have moved.
            *controllers: That move them, target by target.

        Raises:
            LimitError: The path to a target is not allowed; the joints are held instead.
        """
        if not end or (end is True and self._feeder is None and brake_at_end(owner, *controllers)):
            return None
        robot = self._robot
        state = owner.state or read_state(robot)
        # Otherwise the robot completes what was sent: all of a target, or more than a second with dialect 1.
        target: JointTarget | None = holding(robot.model, state, joints)
        refusal: LimitError | None = None
        if isinstance(end, JointTarget):
            try:
                self._options.checks(robot).target(state.positions, dict(end.positions))
                target = end
            except LimitError as error:
                refusal = error
        try:
            with self._asked_then():
                if target is not None:
                    owner.arm_watchdog()
                    robot.write(target)
        except CommandRefusedError as error:
            # A robot may say first that a joint has no torque.
            if not isinstance(error, StoppedError) and not self._limp:
                raise
            return board_stop(read_state(robot)) or StopReason("board", str(error))
        if refusal is not None:
            raise refusal
        return None

    def _send_and_leave(self, target: JointTarget, *, timed: bool) -> SentTarget:
        """Send a target that nobody waits for."""
        robot = self._robot
        with self._asked_then():
            joints = [name for name, _ in target.positions]
            state = read_known(robot, joints, sleep=self._options.sleep) if timed else None
            path = None if state is None else path_to(robot, target, state)
            if path is not None and self._feed_path(path, outlives=True, apart=apart(path)):
                sent = sent_as(robot, path)
            else:
                sent = robot.write(target)
        self._observer.sent(sent)
        return sent

    # -- along a path of the board ------------------------------------------------------------------

    def _feed_path(
        self,
        path: Trajectory,
        *,
        outlives: bool,
        owner: RobotOwner | None = None,
        apart: float | None = None,
        shifted: Callable[[float], object] = lambda by: None,
    ) -> bool:
        """Have the board follow a path in its own time; False if it refuses it, and nothing moves.

        Args:
            path: Checked.
            outlives: As in `OnboardPaths.path`.
            owner: Who feeds it from now on; None for nobody.
            apart: As in `BoardPathFeeder.begin`; it is the path of a target then.
            shifted: As in `BoardPathFeeder`.

        Raises:
            StoppedError: The arm is stopped.
            GoalError: The server of a shared arm does not allow the path; nothing moves.
            HexwireError: It does not answer.
        """
        robot = self._robot
        now = self._options.clock or robot.now
        feeder = BoardPathFeeder(robot, now, shifted, fixed=True)
        if owner is not None:
            feeder.pace.period = owner.command_period
        try:
            with self._asked_then():
                feeder.begin(path, now(), apart=apart, outlives=outlives)
        except (StoppedError, PreemptedError):
            raise
        except (CommandRefusedError, UsageError) as error:
            if isinstance(error, GoalError) and error.reason != Reason.TOO_LATE:
                # The server of a shared arm has checked the path as a whole, with its table and its limits.
                raise
            # Its limits may be tighter than the model's: targets one by one are clamped and given more time there.
            observer = self._observer if apart is None else MotionObserver()
            observer.refused(error.reason if isinstance(error, CommandRefusedError) else str(error))
            return False
        except BaseException:
            # Without an answer it may have started, and no controller knows of it yet.
            if feeder.path is not None and (self._safe is None or owner is None):
                with suppress(HexwireError):
                    robot.stop()
            raise
        self._feeder = feeder
        return True

    def _feed(self) -> StopReason | None:
        """Send the next points if there is room, and see where the board is; why it does not follow, or None."""
        feeder = self._feeder
        if feeder is None or feeder.path is None:
            return None
        try:
            with self._asked_then():
                report = feeder.turn()
        except (StoppedError, PreemptedError):
            self._stopped = True
            return StopReason("board", TORQUE_OFF if self._limp else STOP_COMMAND)
        except LeaseError as error:
            return StopReason("board", str(error))
        if report is None:
            why = feeder.refused or (_TOO_SLOW if feeder.starved else "")
            return StopReason("board", why) if why else None
        self._stopped = report.state is PathState.STOPPED
        reason = feeder.ended_by(report)
        if report.state is PathState.FAULT:
            _, reason = feeder.fault(report, self._robot.read())
        elif report.state is PathState.DRY:
            reason = StopReason("board", _TOO_SLOW)
        feeder.drop()
        return reason

    def _come_to_rest(self, owner: RobotOwner, *, abort: bool) -> None:
        """Wait until the joints are at rest on a path of the board, whatever ended the motion.

        This program must not leave, and disarm the watchdog, while they move. And another motion would be refused.

        Args:
            owner: Of the robot.
            abort: Bring them to rest; otherwise the path is known to be at its end.

        Raises:
            DeviceError: They do not come to rest.
            HexwireError: As `TimedPath`.
        """
        feeder = self._feeder
        if feeder is None or feeder.path is None:
            return
        try:
            if abort and not feeder.leaving and not feeder.at_rest():
                try:
                    feeder.leave()
                except CommandRefusedError:
                    # It has ended meanwhile; or the arm is stopped, and takes no points of a brake.
                    if not feeder.at_rest():
                        feeder.path.abort()
            feeder.wait_for_rest(owner.turn)
        except BaseException:
            if self._safe is None:
                with suppress(HexwireError):
                    self._robot.stop()
            raise


def _check_target(robot: RobotDriver, goal: Mapping[str, float], options: MotionOptions) -> JointState:
    """Check the straight path to a target; returns the present state.

    Raises:
        LimitError: The path is not allowed; nothing was sent.
        ServoError: A joint on which the path depends does not answer.
        UsageError: Other joints are still moving, so that the path cannot be checked.
    """
    check = options.checks(robot)
    check.limits(goal)
    known = check.joint_names
    if set(goal).isdisjoint(known):
        return read_known(robot, list(goal), sleep=options.sleep)
    before = read_known(robot, [*known, *goal], sleep=options.sleep)
    options.sleep(_LOOK)
    state = read_state(robot)
    unknown = [name for name in known if not math.isfinite(state[name].position)]
    if unknown:
        raise ServoError(position_unknown(unknown))
    # A path begins too slowly to be seen.
    paths = OnboardPaths.find(robot)
    left = () if paths is None else paths.left_path()
    turned = [
        name
        for name in known
        if name not in goal and (name in left or not abs(state[name].position - before[name].position) <= _FLICKER)
    ]
    if turned:
        words = f"still moving: {', '.join(turned)}; wait until the arm has stopped, or move all joints together"
        raise UsageError(f"{words}; nothing was sent")
    check.target(state.positions, goal)
    return state


def _from_here(controller: TrajectoryController, trajectory: Trajectory, state: JointState) -> Trajectory:
    """The trajectory, from the arm's position if that is not its start: a board would jump there."""
    gaps = [abs(state.positions[name] - at) for name, at in zip(trajectory.names, trajectory.start, strict=True)]
    if not _APART < max(gaps) < math.inf:
        return trajectory
    controller.generator.observe(state)
    return controller.generator.join(trajectory)


def path_to(robot: RobotDriver, target: JointTarget, state: JointState) -> Spline | None:
    """The way from rest to rest, all joints together, with limited jerk.

    Args:
        robot: Attached; it executes trajectories.
        target: Checked, with the arm's own names.
        state: Just read.

    Returns:
        The path; None if the target itself must be sent: a joint is turning, or its position is unknown.
    """
    names, goal = tuple([name for name, _ in target.positions]), tuple([angle for _, angle in target.positions])
    here = resting_inside(robot.model, {name: state[name].position for name in names})
    duration = max(target.duration, smooth_duration(robot.model, here, dict(target.positions)))
    unknown = not all(map(math.isfinite, here.values()))
    if unknown or duration < _BRIEF or any(abs(state[name].velocity) > _MOVING for name in names):
        return None
    rest = (0.0,) * len(names)
    start = tuple([here[name] for name in names])
    return Spline(names, [Waypoint(0.0, start, rest, rest), Waypoint(duration, goal, rest, rest)])


def apart(path: Spline) -> float:
    """Seconds between two points of the path to a target."""
    parts = max(_POINTS, math.ceil(path.duration / _LONGEST))
    # In whole ticks, and not more: the last part may be longer, but would be twice as long if it were shorter.
    return math.floor(path.duration / parts / _TICK) * _TICK


def sent_as(robot: RobotDriver, path: Spline) -> SentTarget:
    """What the servos are sent at the end of the path to a target: whole counts."""
    joints = [robot.model.joint(name) for name in path.names]
    rows = zip(joints, path.goal, strict=True)
    goal = tuple([(joint.name, joint.counts_to_angle(joint.angle_to_counts(angle))) for joint, angle in rows])
    return SentTarget(goal, path.duration)


_MUCH = 1.5
"""How many times slower a path is when a person is told of it."""


def check_path(
    robot: RobotDriver,
    motion: Trajectory | Sequence[Trajectory],
    options: MotionOptions | None = None,
    *,
    start: Mapping[str, float] | None = None,
    grip: float | None = None,
) -> CheckedPath:
    """Check trajectories before anything moves; nothing is sent.

    Args:
        robot: Attached; its joint positions are read unless `start` gives them.
        motion: One trajectory, or several, each from where the previous one ends. A line of the tip is slowed
            down where joints need that.
        options: Table for the check, or that it is switched off.
        start: Positions of all joints, radians.
        grip: As in `CheckedPath`.

    Raises:
        GoalError: The path is not allowed; the text says why.
        UsageError: The gripper cannot open so far, or is moved by the trajectories, too; or they are none.
    """
    check("check_path", "robot", ROBOT, robot)
    options = wanted_options(options or MotionOptions())
    given: object = motion
    legs = (given,) if isinstance(given, Trajectory) else tuple(given) if isinstance(given, Iterable) else ()
    if not legs or not all(isinstance(leg, Trajectory) for leg in legs):
        raise UsageError(
            "a motion is a trajectory, several of them, or a JointTarget, as in JointTarget.of({'J1': 0.1}); "
            f"this is {given!r}"
        )
    if any(leg.names != legs[0].names for leg in legs):
        raise UsageError("the legs of a motion must move the same joints")
    if grip is not None:
        gripper = Gripper(robot)
        gripper.angle(grip)
        if (joint := gripper.joint.name) in legs[0].names:
            raise UsageError(f"{joint} is the gripper: give its angle, or how far it opens, not both")
    begin = read_known(robot, sleep=options.sleep).positions if start is None else start
    where = dict(begin)
    path_check = options.checks(robot)
    reports = []
    # The joints turn as a line of the tip wants it: it was planned without their limits.
    legs = tuple([slow_enough(robot.model, leg) if isinstance(leg, InJoints) else leg for leg in legs])
    for leg in legs:
        reports.append(path_check.trajectory(leg, where, goes_on=leg is not legs[-1]))
        where.update(zip(leg.names, leg.goal, strict=True))
    return CheckedPath(legs, tuple(reports), begin, grip, _slowed(robot, legs, begin))


def _slowed(robot: RobotDriver, legs: Sequence[Trajectory], start: Mapping[str, float]) -> str:
    """How long a path takes, and why, if a joint makes it much slower than was asked for; else empty."""
    slower = [leg for leg in legs if isinstance(leg, Slower) and leg.duration > _MUCH * leg.planned]
    if not slower:
        return ""
    worst = max(slower, key=lambda leg: leg.duration / leg.planned)
    kinematics, near = robot.kinematics, tuple[str, ...]()
    if kinematics is not None:
        near = kinematics.singularity(kinematics.from_joints({**start, **worst.place})).near
    why = f"{worst.joint} cannot follow faster"
    if near:
        why += f" near a singularity ({', '.join(near)}): choose another line, or move the joints"
    seconds = sum(leg.duration for leg in legs)
    return f"this takes {seconds:.1f} s, {worst.duration / worst.planned:.0f} times as long as planned, since {why}"


def run_motion(
    robot: RobotDriver,
    motion: Trajectory | Sequence[Trajectory] | CheckedPath | JointTarget,
    options: MotionOptions | None = None,
    *,
    wait: bool = True,
    until: Until | None = None,
    observer: MotionObserver | None = None,
    safe: AbstractContextManager[object] | None = None,
    asked: Token | None = None,
    rest: bool = False,
) -> MotionResult:
    """Run one motion: check its path, switch torque on, arm the watchdog, monitor it, and check the arrival.

    A robot that executes trajectories follows a path: the trajectory, or a smooth way to the target. Otherwise
    a trajectory is sent cycle by cycle, and a target once; without a watchdog, it is sent in short steps. An
    exception during the motion, including Ctrl-C, stops the arm.

    Args:
        robot: Attached.
        motion: Trajectories of the robot's joints, or a target.
        options: How it is run and checked.
        wait: False returns as soon as a single target is sent; it is then not monitored, and outlives this program.
        until: Called with every state once the motion has started; True ends it: the joints brake, or hold where a
            target moves them; a target ends it and is sent instead. With it, a target is no path.
        observer: Is called at the events of the motion.
        safe: Entered before anything moves, and left while the watchdog is still armed, whatever ends the motion.
            It makes the arm safe instead of the stop on an exception; not used without `wait`.
        asked: When it was asked for, as `robot.epochs.mark` returned it; now if None. A stop since then voids it.
        rest: After the arrival, or if `until` has ended it, find out where the arm comes to rest beside its goal;
            see `come_to_rest`.

    Returns:
        How the motion ended.

    Raises:
        UsageError: The path is not allowed; nothing was sent.
        ServoError: A joint did not confirm torque, or one on which the path depends does not answer.
        StoppedError: The arm is stopped, or was stopped before the motion started.
        HexwireError: The robot failed or refused; the arm was stopped if it could be reached.
    """
    check("run_motion", "robot", ROBOT, robot)
    # From here on a stop voids the motion, however long the steps before it take.
    asked = robot.epochs.mark() if asked is None else asked
    options = MotionOptions() if options is None else wanted_options(options)
    wait = bool(check("run_motion", "wait", FLAG, wait))
    execution = Execution(robot, options, observer or MotionObserver(), asked, until, safe)
    return execution.run(motion, wait=wait, rest=rest)


def run_grip(
    robot: RobotDriver,
    opening: float,
    duration: float = MOST_SECONDS,
    *,
    force: float = 0.25,
    observer: MotionObserver | None = None,
    cancelled: Callable[[], bool] = lambda: False,
    asked: Token | None = None,
) -> MotionResult:
    """Move the gripper to an opening; see `run_motion` for what else is done.

    Args:
        robot: Attached.
        opening: 0 is closed, 1 fully open.
        duration: Seconds from closed to open.
        force: Effort from which a stationary jaw counts as holding something, fraction of full effort.
        observer: Is called at the events of the motion.
        cancelled: Whether it is to end now.
        asked: As in `run_motion`.

    Returns:
        How it ended; `holds` and `opening` say what became of the gripper, `rest` how far it is off.

    Raises:
        UsageError: The robot has no gripper, or the opening is not within 0..1.
        HexwireError: As `run_motion`.
    """
    gripper = Gripper(robot, held=force)
    joint = gripper.joint
    target = JointTarget.of({joint.name: gripper.angle(opening)}, duration)
    closing = Closing(gripper, opening, robot.read())
    near = jaw_tolerance(joint)
    how = MotionOptions(tolerance=near.position, standing=near.velocity, grace=GRACE, early=False)
    asked = robot.epochs.mark() if asked is None else asked
    execution = Execution(
        robot, how, observer or MotionObserver(), asked, until=lambda state: cancelled(), closing=closing
    )
    return execution.run(target, rest=True)
