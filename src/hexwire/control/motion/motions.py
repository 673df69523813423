"""Runs one complete motion for a program, or opens and closes its gripper.

Owns the check of its path, and what may be asked for. Must not know terminals, nor where a motion comes from.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import TYPE_CHECKING

from hexwire.arguments import FLAG, ROBOT, check
from hexwire.drivers.tools import Gripper
from hexwire.errors import UsageError
from hexwire.model.state import JointTarget
from hexwire.motion.checks import InJoints
from hexwire.motion.limits import Slower, slow_enough
from hexwire.motion.trajectory import Trajectory

from ..loop.reader import read_known
from .execution import Execution, Until
from .jaws import GRACE, MOST_SECONDS, Closing, JawsMeanwhile, jaw_tolerance
from .motion_options import MotionObserver, MotionOptions, wanted_options
from .motion_result import MotionResult
from .path_check import CheckedPath
from .rest import come_to_rest

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.epochs import Token
    from hexwire.model.state import JointState

__all__ = ["CheckedPath", "MotionObserver", "MotionOptions", "MotionResult", "check_path", "run_grip", "run_motion"]


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
    if grip is not None and (joint := JawsMeanwhile(robot, grip).joint) in legs[0].names:
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
    observer = observer or MotionObserver()
    wait = bool(check("run_motion", "wait", FLAG, wait))
    execution = Execution(robot, options, observer, asked, until, safe)
    clock = options.clock or robot.now
    began = clock()
    if isinstance(motion, JointTarget):
        result = execution.target(motion, wait=wait)
        goal = motion.positions if result.cut else () if result.sent is None else result.sent.positions
    else:
        path = motion if isinstance(motion, CheckedPath) else check_path(robot, motion, options)
        began = clock()
        result = replace(execution.path(path.legs, path.grip), slowed=path.slowed)
        goal = tuple(zip(path.legs[-1].names, path.legs[-1].goal, strict=True))
    if wait:
        result = replace(result, seconds=clock() - began)
    if not (rest and goal and result.stopped is None and (result.arrived or result.cut)):
        return result
    return replace(result, rest=come_to_rest(robot, dict(goal), clock=clock, sleep=options.sleep))


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

    def until(state: JointState) -> bool | JointTarget:
        return gripper.grasp(state) if closing.see(state) else cancelled()

    near = jaw_tolerance(joint)
    how = MotionOptions(tolerance=near.position, standing=near.velocity, grace=GRACE, early=False)
    result = run_motion(robot, target, how, until=until, observer=observer, asked=asked, rest=True)
    found = math.nan if result.state is None else gripper.share(result.state)
    return replace(result, holds=closing.holds, opening=found)
