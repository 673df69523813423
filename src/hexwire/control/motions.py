"""Runs one complete motion for a program.

Owns the order (path check, torque, watchdog, motion, arrival) and the result as a value. A trajectory is monitored
for following error, load, faults and old states. Must not know terminals, nor where a motion comes from.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Literal

from hexwire.arguments import FLAG, Wanted, check
from hexwire.errors import HexwireError, LimitError, ServoError, StoppedError, UsageError
from hexwire.model.state import JointTarget, SentTarget
from hexwire.motion.checks import InJoints
from hexwire.motion.joined import Joined
from hexwire.motion.limits import check_target, slow_enough, smooth_duration
from hexwire.motion.safety import SafetyLimits, StopReason, board_stop
from hexwire.motion.waypoints import Trajectory

from .arrival import Tolerance
from .controller import TrajectoryController
from .goals import Tolerances
from .holding import brake_at_end
from .motion_options import MotionObserver, MotionOptions, wanted_options
from .motion_result import MotionResult
from .outcomes import Outcome
from .owner import RobotOwner
from .power import give_torque
from .reader import position_unknown, read_known, read_state
from .settings import ControllerSettings
from .target import TargetController, holding
from .target_path import apart, path_to, sent_as
from .timed_motion import PathFeed, begin_feed
from .waiting import Waiter

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.epochs import Token
    from hexwire.model.state import JointState
    from hexwire.motion.checks import MotionReport

__all__ = ["CheckedPath", "MotionObserver", "MotionOptions", "MotionResult", "check_path", "run_motion"]

Until = Callable[["JointState"], bool | JointTarget | None]
"""Called with every state: whether the motion is to end now, or a target that replaces it."""

_ROBOT = Wanted(
    "a robot, as hexwire.connect() returns it",
    lambda value: hasattr(value, "epochs") and not isinstance(value, type),
)
_LOOK = 0.1
"""Seconds between two states that show whether a joint is moving."""
_APART = math.radians(0.4)
"""A trajectory that begins further from the arm than this, more than a few counts, is joined from there."""
_FLICKER = math.radians(0.2)
"""Two counts: a smaller difference is noise, not motion."""


@dataclass(frozen=True, slots=True)
class CheckedPath:
    """Trajectories that passed the path check, to run one after the other.

    Attributes:
        legs: The trajectories; each begins where the previous one ends.
        reports: The result of the path check for each.
    """

    legs: tuple[Trajectory, ...]
    reports: tuple[MotionReport, ...]


def check_path(
    robot: RobotDriver,
    motion: Trajectory | Sequence[Trajectory],
    options: MotionOptions | None = None,
    *,
    start: Mapping[str, float] | None = None,
) -> CheckedPath:
    """Check trajectories before anything moves; nothing is sent.

    Args:
        robot: Attached; its joint positions are read unless `start` gives them.
        motion: One trajectory, or several, each from where the previous one ends. A line of the tip is slowed
            down where joints need that.
        options: Table for the check, or that it is switched off.
        start: Positions of all joints, radians.

    Raises:
        GoalError: The path is not allowed; the text says why.
    """
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
    where = dict(read_known(robot, sleep=options.sleep).positions if start is None else start)
    check = options.checks(robot)
    reports = []
    # The joints turn as a line of the tip wants it: it was planned without their limits.
    legs = tuple([slow_enough(robot.model, leg) if isinstance(leg, InJoints) else leg for leg in legs])
    for leg in legs:
        reports.append(check.trajectory(leg, where, goes_on=leg is not legs[-1]))
        where.update(zip(leg.names, leg.goal, strict=True))
    return CheckedPath(legs, tuple(reports))


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
) -> MotionResult:
    """Run one motion: check its path, switch torque on, arm the watchdog, monitor it, and check the arrival.

    A robot that keeps the time of a motion follows a path: the trajectory, or a smooth way to the target. Otherwise
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

    Returns:
        How the motion ended.

    Raises:
        UsageError: The path is not allowed; nothing was sent.
        ServoError: A joint did not confirm torque, or one on which the path depends does not answer.
        StoppedError: The arm was stopped before the motion started.
        HexwireError: The robot failed or refused; the arm was stopped if it could be reached.
    """
    check("run_motion", "robot", _ROBOT, robot)
    # From here on a stop voids the motion, however long the steps before it take.
    asked = robot.epochs.mark() if asked is None else asked
    options = MotionOptions() if options is None else wanted_options(options)
    observer = observer or MotionObserver()
    wait = bool(check("run_motion", "wait", FLAG, wait))
    if isinstance(motion, JointTarget):
        return _run_target(robot, motion, options, observer, wait, until, safe, asked)
    path = motion if isinstance(motion, CheckedPath) else check_path(robot, motion, options)
    return _run_path(robot, path, options, observer, until, safe, asked)


@contextmanager
def _asked_then(robot: RobotDriver, asked: Token) -> Iterator[None]:
    """Requests inside the block count as made at the time `asked`, so that a later stop voids them.

    Raises:
        StoppedError: There was a stop since then.
    """
    robot.epochs.check(asked, "the motion")
    with robot.epochs.using(asked):
        yield


@contextmanager
def _owner(
    robot: RobotDriver,
    rate: float,
    options: MotionOptions,
    observer: MotionObserver,
    asked: Token,
    on_sent: Callable[[SentTarget], object] = lambda sent: None,
    safe: AbstractContextManager[object] | None = None,
) -> Iterator[RobotOwner]:
    owner = RobotOwner(
        robot,
        borrowed=True,
        check=options.checks(robot),
        asked=asked,
        on_sent=on_sent,
        command_rate=rate,
        watchdog=options.watchdog,
        watchdog_mode=options.watchdog_mode,
        stop_on_failure=safe is None,
        clock=options.clock,
        sleep=options.sleep,
    )
    if not robot.has_own_watchdog:
        observer.unwatched(owner.lead)
    owner.observers.append(observer.seen)
    with owner, safe or nullcontext():
        yield owner


def _turn_until(
    owner: RobotOwner, over: Callable[[], bool], until: Until | None
) -> JointTarget | Literal[True] | None:
    """Call `turn` until `over` returns true; returns what `until` ended the motion with, or None."""
    while not over():
        owner.turn()
        if until is not None and owner.state is not None and (end := until(owner.state)):
            return end
    return None


def _end_at(
    owner: RobotOwner,
    end: JointTarget | Literal[True],
    joints: Collection[str],
    options: MotionOptions,
    asked: Token,
) -> StopReason | None:
    """Send what replaces an ended motion; returns the reason if the arm is stopped.

    Raises:
        LimitError: The path to a target is not allowed; the joints are held instead.
    """
    robot = owner.robot
    state = owner.state or read_state(robot)
    # Otherwise the robot completes what was sent: all of a target, or more than a second with dialect 1.
    target: JointTarget | None = holding(robot.model, state, joints)
    refusal: LimitError | None = None
    if isinstance(end, JointTarget):
        try:
            options.checks(robot).target(state.positions, dict(end.positions))
            target = end
        except LimitError as error:
            refusal = error
    try:
        with _asked_then(robot, asked):
            if target is not None:
                owner.arm_watchdog()
                robot.write(target)
    except StoppedError as error:
        return board_stop(read_state(robot)) or StopReason("board", str(error))
    if refusal is not None:
        raise refusal
    return None


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
    left = robot.left_path()
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
    controller.follower.observe(state)
    return controller.follower.join(trajectory)


def _run_path(
    robot: RobotDriver,
    path: CheckedPath,
    options: MotionOptions,
    observer: MotionObserver,
    until: Until | None,
    safe: AbstractContextManager[object] | None,
    asked: Token,
) -> MotionResult:
    names = path.legs[0].names
    rate = options.rate or robot.command_rate
    none = Tolerances(dict.fromkeys(names, Tolerance()), dict.fromkeys(names, Tolerance()))
    last = Tolerances(none.path, options.goal(names), options.grace)
    limits = options.limits or SafetyLimits.at_period(1.0 / rate)
    # The paths are checked, but not the way from the arm to the first one.
    kept = ControllerSettings("", names, True, none), robot.model, limits
    controller = TrajectoryController(*kept, check=options.checks(robot))
    arrived, reason = False, None
    end: JointTarget | Literal[True] | None = None
    legs: Sequence[Trajectory] = path.legs
    with _owner(robot, rate, options, observer, asked, safe=safe) as owner:
        with _asked_then(robot, asked):
            powered = give_torque(robot, names, read_state(robot))
        if powered:
            observer.powered(powered)
        owner.group.members = (controller,)
        owner.turn()
        observer.started(owner.timing)
        feed = None
        if robot.times_motion and not options.host_timed and owner.group.reason is None:
            whole = legs[0] if len(legs) == 1 else Joined(legs)
            whole = _from_here(controller, whole, owner.newest())
            feed = begin_feed(
                robot,
                whole,
                asked,
                outlives=options.outlives,
                stop_on_failure=safe is None,
                period=owner.command_period,
                refused=observer.refused,
            )
            if feed is not None:
                legs = (whole,)
                controller.follower.waits = False
        for leg in legs:
            # Stopped before it began: `stopped` has the reason.
            if owner.group.reason is not None:
                break
            waiter = Waiter()
            tolerances = last if leg is legs[-1] else none
            with owner.locked():
                begins = owner.now() if feed is None else feed.start.time
                controller.follow(leg, owner.newest(), begins, listener=waiter, tolerances=tolerances)
            over = waiter.is_over
            if feed is not None:
                over = feed.until(owner, controller.follower.keep_start, owner.group.stop, over)
            end = _turn_until(owner, over, until)
            arrived = waiter.end is not None and waiter.end.outcome is Outcome.SUCCEEDED
            if not arrived:
                break
        if feed is not None:
            _end_feed(feed, owner, safe, abort=bool(end) or not arrived)
        if end and not (end is True and feed is None and brake_at_end(owner, controller)):
            reason = _end_at(owner, end, names, options, asked)
        controller.hold("it is over")
        seconds = sum(leg.duration for leg in path.legs) + options.grace
        return MotionResult(
            arrived,
            owner.group.reason or reason,
            controller.off,
            cut=bool(end),
            powered=powered,
            seconds=seconds,
            state=owner.state,
            timing=owner.timing.counters,
            timed=feed is not None,
        )


def _end_feed(
    feed: PathFeed, owner: RobotOwner, safe: AbstractContextManager[object] | None, *, abort: bool
) -> None:
    """Wait until the joints are at rest, whatever ended the motion.

    This program must not leave, and disarm the watchdog, while they move. And another motion would be refused.
    """
    try:
        feed.end(owner.turn, abort=abort)
    except BaseException:
        if safe is None:
            with suppress(HexwireError):
                owner.robot.stop()
        raise


def _see_end(owner: RobotOwner, controller: TargetController, feed: PathFeed, found: StopReason) -> None:
    """The board does not follow the path any more: the arm is stopped, or the next states say what is wrong."""
    if feed.stopped:
        owner.group.stop(found)
        return
    with owner.locked():
        controller.cut(str(found), owner.now())


def _run_target(
    robot: RobotDriver,
    target: JointTarget,
    options: MotionOptions,
    observer: MotionObserver,
    wait: bool,
    until: Until | None,
    safe: AbstractContextManager[object] | None,
    asked: Token,
) -> MotionResult:
    state = _check_target(robot, dict(target.positions), options)
    target = check_target(robot.model, target, {})
    goal = dict(target.positions)
    with _asked_then(robot, asked):
        cleared = robot.clear_path(list(goal))
    if cleared:
        # The joints are elsewhere now, and at rest.
        state = _check_target(robot, goal, options)
    # Its ends are smooth; a longer time that was asked for stays.
    target = replace(target, duration=max(target.duration, smooth_duration(robot.model, state.positions, goal)))
    with _asked_then(robot, asked):
        powered = give_torque(robot, list(goal), state)
    if powered:
        observer.powered(powered)
    # What `until` ends is replaced at once, but a path comes to rest first. And the server of a shared arm, which
    # refills none, follows a path as a goal: it would stop an arm whose gripper meets an object.
    timed = robot.refills_paths and not options.host_timed and until is None
    if not wait:
        with _asked_then(robot, asked):
            path = path_to(robot, target, read_known(robot, list(goal), sleep=options.sleep)) if timed else None
            whole = None if path is None else begin_feed(robot, path, asked, outlives=True, apart=apart(path))
            sent = robot.write(target) if path is None or whole is None else sent_as(robot, path)
        observer.sent(sent)
        return MotionResult(None, powered=powered, sent=sent, seconds=sent.duration, timed=whole is not None)
    rate = options.rate or robot.command_rate
    step = None if robot.has_watchdog else 1.0 / rate
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
    )

    def was_sent(sent: SentTarget) -> None:
        controller.was_sent(sent)
        if step is None:
            observer.sent(sent)

    def over() -> bool:
        return controller.over

    with _owner(robot, rate, options, observer, asked, was_sent, safe) as owner:
        owner.group.members = (controller,)
        if step is not None:
            observer.sent(SentTarget(target.positions, target.duration))
        owner.turn()
        observer.started(owner.timing)
        feed = None
        if timed and not controller.over and (path := path_to(robot, target, owner.newest())) is not None:
            feed = begin_feed(
                robot,
                path,
                asked,
                outlives=options.outlives,
                stop_on_failure=safe is None,
                apart=apart(path),
            )
            if feed is not None:
                with owner.locked():
                    controller.on_path(sent_as(robot, path), feed.start.time)
                observer.sent(sent_as(robot, path))
                # Its end may be judged by this program's clock: the grace is longer than what clocks differ.
                over = feed.until(owner, lambda first, last: None, partial(_see_end, owner, controller, feed), over)
        if feed is None:
            controller.go()
        end = _turn_until(owner, over, until)
        if feed is not None:
            _end_feed(feed, owner, safe, abort=not controller.arrived)
        reason = None
        if end and not (end is True and brake_at_end(owner, controller)):
            reason = _end_at(owner, end, goal, options, asked)
        controller.release("it is over")
        sent_duration = controller.sent.duration if controller.sent is not None else target.duration
        return MotionResult(
            controller.arrived,
            controller.reason or reason,
            controller.off,
            controller.without_torque,
            bool(end),
            powered,
            controller.sent,
            sent_duration + options.grace,
            owner.state,
            owner.timing.counters,
            feed is not None,
            controller.ended,
        )
