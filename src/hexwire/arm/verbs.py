"""`Arm`: go there, grip, come back.

Owns the verbs of one arm: what they take, which order they keep, and that one motion runs at a time. Must not know
how a motion is checked, planned or run, nor which kind of robot it is.
"""

from __future__ import annotations

import atexit
import logging
import math
import sys
import threading
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, Self, TextIO, TypedDict, TypeVar, Unpack, overload

from hexwire.arguments import FLAG, NAME, PORT, POSE, ROBOT, WHOLE, Wanted, check, one_of, or_none, shown, takes
from hexwire.control.loop.loop import RateLoop, check_rate
from hexwire.control.loop.outcomes import Reason
from hexwire.control.loop.power import (
    NOT_LATCHED,
    STOP_LATCHED,
    end_stop,
    require_confirmed,
    switch_torque,
    what_helps,
)
from hexwire.control.loop.reader import position_unknown, raise_if_silent, read_known, read_start
from hexwire.control.motion import motions
from hexwire.control.motion.jaws import MOST_SECONDS
from hexwire.control.motion.motion_options import unwatched_words
from hexwire.control.motion.path_check import CheckedPath
from hexwire.control.motion.played import check_played
from hexwire.control.requests.pose_file import HOME
from hexwire.control.requests.program import is_program, read_program
from hexwire.drivers.abilities import Leased, OnboardPaths
from hexwire.drivers.registry import connect as connect_driver
from hexwire.drivers.registry import is_same_arm
from hexwire.drivers.values import StopMode
from hexwire.errors import GoalError, HexwireError, LimitError, LinkError, ServoError, StoppedError, UsageError
from hexwire.model.aim import Tip
from hexwire.model.gripper import OPENINGS, Opening
from hexwire.model.state import JointTarget
from hexwire.motion.teach import Edits, Taught
from hexwire.motion.trajectory import Trajectory
from hexwire.trace.recording import RecordingWriter

from .blocks import Lesson, Recording, recording_writer
from .claim import WORK_ENDED, Claim, Claims, forget_ctrl_c
from .front import Front
from .handle import DETACHED, Handle, MotionHandle, told
from .plans import ANGLES, SECONDS, SHARE, Plans, Point, is_number, joint_angles, length
from .poses import Poses
from .programs import Asking, ProgramRun, asking

if TYPE_CHECKING:
    from hexwire.control.motion.following import Limit
    from hexwire.control.motion.motions import MotionObserver, MotionResult
    from hexwire.drivers.base import RobotDriver
    from hexwire.epochs import Token
    from hexwire.model.arm import ArmModel, JointModel
    from hexwire.model.picture import Picture
    from hexwire.model.pose import Vector
    from hexwire.model.state import JointState, NewestState

__all__ = ["Arm", "connect"]

_log = logging.getLogger(__name__)

_attached: weakref.WeakSet[Arm] = weakref.WeakSet()
"""Arms that are left when the interpreter ends."""

_R = TypeVar("_R")
_H = TypeVar("_H", bound=Handle[Any])

_Run = Callable[[Claim, motions.MotionObserver], _R]
Motion = str | Path | Taught | Trajectory | Lesson | Recording
"""A recording or a program by its file, what `Arm.teach` or `Arm.record` has recorded, or a trajectory."""
_FORCE = Wanted("a share of full effort, 0 to 1", lambda value: is_number(value) and 0 <= value <= 1)
_BEYOND = 0.05
"""How far beyond 0 and 1 the measured opening of a gripper may be."""
_FACTOR = Wanted("a factor above 0", lambda value: is_number(value) and value > 0)
_TIME = Wanted("seconds, 0 or more", lambda value: is_number(value) and value >= 0)
_END = Wanted(
    "seconds, 0 or more", lambda value: _TIME.fits(value) or (isinstance(value, float) and value == math.inf)
)
_TIMES = Wanted("a whole number, 1 or more: how often", lambda value: WHOLE.fits(value) and value >= 1, WHOLE.plain)
_STEP = Wanted("the number of a step, from 1", lambda value: WHOLE.fits(value) and value >= 1, WHOLE.plain)
_CALLED = Wanted("a function such as input", lambda value: value is None or callable(value))
_ROBOT_NAME = Wanted("the name of a robot, as in 'so101', or an arm file", lambda value: isinstance(value, str))
_FILE = Wanted("the name of a file", lambda value: isinstance(value, str | Path))
_KEPT = Wanted("the name of a file", lambda value: _FILE.fits(value) or isinstance(value, RecordingWriter))
_PRINTED = Wanted("a file that is open for text, such as sys.stderr", lambda value: hasattr(value, "write"))
_LIMIT = Wanted(
    "a number above 0, of all joints or by joint",
    lambda value: (
        all(map(_FACTOR.fits, value.values()))
        if isinstance(value, Mapping)
        else value is None or _FACTOR.fits(value)
    ),
)
_STOPPED = 5
"""Status `stopped` of PROTOCOL.md section 6.2."""
_ENDS = 5.0
"""Most seconds in which a motion that was stopped, or lost its torque, comes to its end."""


_MOVES = "is in motion: wait for it, cancel it, or stop()"
_ENDED = "this arm was detached, so the motion was ended before it arrived: connect() again"


class _How(TypedDict, total=False):
    speed: float | None
    duration: float | None


class _Tip(TypedDict, total=False):
    x: float | None
    y: float | None
    z: float | None
    down: bool
    pitch: float | None
    roll: float | None
    rpy: Vector | None
    relative: bool
    grip: Opening | None


class _Goto(_Tip, _How):
    pass


class _Lines(_Tip, total=False):
    tip_speed: float
    rounding: float


class _Play(TypedDict, total=False):
    factor: float
    begin: float
    end: float
    smooth: float
    trim: bool
    fit: bool
    repeat: int
    step: int
    ask: Asking | None


class _Follow(TypedDict, total=False):
    mirror: bool
    meet: float
    force: float
    max_speed: Limit
    max_acceleration: Limit
    rate: float


class _Grip(TypedDict, total=False):
    force: float
    duration: float


def connect(
    port: str | None = None,
    robot: str | None = None,
    *,
    speed: float = 0.5,
    table: float | None = 0.0,
    rest: str | None = None,
    trace: TextIO | None = None,
    **options: Any,
) -> Arm:
    """Open an arm of any kind: find its driver and its port, and attach. Nothing moves.

    A board with the chapter's sketch is an exception: see `Hex7BotDriver.attach`.

    Args:
        port: URL or device path, as in ``serial:///dev/ttyUSB0?baud=115200``; the address of a shared arm, as in
            ``zenoh:lab/arm1``; or that of an emulated one, ``sim://hex7bot``, ``sim://so101`` or ``sim://so100``.
            If None, the value of the environment variable HEXWIRE_PORT, else the only likely board that is plugged
            in.
        robot: Name of the robot; a shared or emulated arm names it itself, and another port has a hex7bot if None.
        speed: Share of the speed limits at which it moves, unless a verb is given another.
        table: Height of the table above the base, metres, into which no motion may go; None for no table.
        rest: Name of the pose to which it goes when its ``with`` block ends without an error; then torque is
            switched off.
        trace: Print every frame and packet of its lines here, and every state that is read; see
            `hexwire.drivers.registry.connect`.
        **options: Passed to the driver's `from_url`.

    Raises:
        UsageError: There is no such robot or pose, or no single port to choose.
        LinkError: The port cannot be opened.
        ReplyTimeoutError: Nothing answers.
    """
    check("connect", "port", or_none(PORT), port)
    check("connect", "robot", or_none(_ROBOT_NAME), robot)
    check("connect", "trace", or_none(_PRINTED), trace)
    with told():
        driver = connect_driver(port, robot, trace=trace, **options)
    try:
        return Arm(driver, speed=speed, table=table, rest=rest)
    except BaseException:
        driver.detach()
        raise


class Arm:
    """An arm in a person's hands: as a context manager it is detached at the end, and its joints hold.

    Angles are radians, lengths metres, times seconds: write ``deg(30)`` and ``mm(150)`` for others. Each motion is
    checked as a whole before anything moves; then torque is switched on where there is none, and the watchdog is
    armed. A verb returns when the arm has come to rest, or raises. Ctrl-C stops the arm. The lease of a shared arm
    is taken by the first verb, and again by the next one where it was lost, unless another program holds it. With
    ``wait=False`` a verb returns a handle at once. One motion runs at a time; any thread may read and stop. At the
    end of the program, what still moves comes to rest; after Ctrl-C it is stopped.

    Args:
        driver: The attached robot.
        speed: See `connect`.
        table: See `connect`.
        rest: See `connect`.
        front: How a front calls its verbs; None for a program.

    Attributes:
        driver: The robot's driver, for what is not here.
        speed: Share of the speed limits at which it moves, unless a verb is given another.
        table: Height of the table above the base, metres; None for no table.
        poses: Its saved poses by name: radians by joint.
    """

    def __init__(
        self,
        driver: RobotDriver,
        *,
        speed: float = 0.5,
        table: float | None = 0.0,
        rest: str | None = None,
        front: Front | None = None,
    ) -> None:
        self.driver: RobotDriver = check("Arm", "driver", ROBOT, driver)
        self._front = Front() if front is None else front
        self._told = told if front is None else nullcontext
        self.speed: float = check("connect", "speed", SHARE, speed)
        self.table = table
        self._height()
        self.poses = Poses(driver.model, self.read)
        self._plans = Plans(driver, self.poses)
        check("connect", "rest", or_none(POSE), rest)
        self._rest = rest if rest is None else self._plans.pose(rest)
        self._claims = Claims()
        self._open = True
        # The thread that detaches the arm: no other one may begin a motion.
        self._ender: int | None = None
        self._handles: list[Handle[Any]] = []
        self._warned = False
        _attached.add(self)

    # -- what it is and where -------------------------------------------------------------------------

    @property
    def model(self) -> ArmModel:
        """Its joints."""
        return self.driver.model

    @property
    def limits(self) -> dict[str, JointModel]:
        """Its joints by name: their limits of position, speed, acceleration and jerk."""
        return {joint.name: joint for joint in self.model.joints}

    def read(self) -> JointState:
        """Read all joints. A silent servo raises no error; its joint has the flag `JointFlag.SILENT`."""
        with self._asking():
            return self.driver.read()

    def newest(self) -> NewestState:
        """The newest state that is there, at once, with its age in seconds.

        An arm that another program shares sends its states unasked: `read` waits for the next one, this does not,
        and may give one from before the last order. Any other arm is asked, as by `read`.
        """
        with self._asking():
            return self.driver.newest()

    @takes(seconds=_END)
    def states(self, rate: float = 0.0, *, seconds: float = math.inf) -> Iterator[JointState]:
        """Read states again and again, also while a motion runs.

        Args:
            rate: Per second; 0 for the robot's command rate.
            seconds: When to end.

        Raises:
            UsageError: There is no such rate.
        """
        return self._states(self._rate(rate), seconds)

    def _rate(self, rate: float) -> float:
        if not is_number(rate) or rate < 0:
            raise UsageError(f"a rate is a number per second, or 0 for the robot's own, not {shown(rate)}")
        rate = rate or self.driver.command_rate
        check_rate(rate)
        return rate

    def _states(self, rate: float, seconds: float) -> Iterator[JointState]:
        for _ in RateLoop(rate).ticks(seconds):
            yield self.read()

    @property
    def tip(self) -> Tip:
        """The measured place and direction of the tip of its tool.

        Raises:
            UsageError: The arm's geometry is not known.
            ServoError: A joint does not answer.
        """
        kinematics = self._plans.kinematics
        with self._asking():
            state = read_known(self.driver, kinematics.joint_names)
            if unknown := [name for name in kinematics.joint_names if name in state.silent]:
                raise ServoError(position_unknown(unknown))
        return Tip.of(kinematics, kinematics.from_joints(state.positions))

    def picture(self, state: JointState | None = None) -> Picture:
        """Draw the arm from its model: in a notebook, the last line of a cell shows it.

        Args:
            state: Where its joints are; as they are now if None.

        Raises:
            UsageError: The geometry of this arm is not known.
        """
        from hexwire.model.geometry import make_shapes
        from hexwire.model.picture import draw_arm
        from hexwire.model.state import JointState

        check("picture", "state", or_none(one_of(JointState)), state)
        shapes = make_shapes(self._plans.kinematics)
        return draw_arm(shapes, (self.read() if state is None else state).positions, self.model.name)

    @property
    def opening(self) -> float:
        """How far the gripper is open: 0 is closed, 1 fully open.

        Raises:
            UsageError: No gripper of this arm is known.
        """
        from hexwire.drivers.tools import Gripper

        with self._told():
            return Gripper(self.driver).share(self.read())

    # -- motions --------------------------------------------------------------------------------------

    @overload
    def move(
        self,
        goal: str | Mapping[str, float] | None = None,
        /,
        *,
        relative: bool = False,
        grip: Opening | None = None,
        speed: float | None = None,
        duration: float | None = None,
        wait: Literal[True] = True,
        **joints: float,
    ) -> MotionResult: ...
    @overload
    def move(
        self,
        goal: str | Mapping[str, float] | None = None,
        /,
        *,
        relative: bool = False,
        grip: Opening | None = None,
        speed: float | None = None,
        duration: float | None = None,
        wait: Literal[False],
        **joints: float,
    ) -> MotionHandle[MotionResult]: ...
    @takes(relative=FLAG, speed=or_none(SHARE), duration=or_none(SECONDS), wait=FLAG)
    def move(
        self,
        goal: str | Mapping[str, float] | None = None,
        /,
        *,
        relative: bool = False,
        grip: Opening | None = None,
        speed: float | None = None,
        duration: float | None = None,
        wait: bool = True,
        **joints: float,
    ) -> Any:
        """Move joints together to angles; joints that are not named stay: ``arm.move(J1=deg(30))``.

        Args:
            goal: Radians by joint, or the name of a pose.
            relative: The angles count from where the joints are.
            grip: Open or close the gripper at the same time, as in `grip`; of the result, `holds` says whether it
                has an object, and `opening` how far it is open.
            speed: Share of the speed limits; that of the arm if None.
            duration: Seconds, instead of a speed; at least what the limits need.
            wait: Return when the arm has arrived; else at once with a `MotionHandle`.
            **joints: Radians by joint.

        Returns:
            A `MotionResult`, or the handle.

        Raises:
            UsageError: An argument is wrong; or another motion of this arm runs.
            LimitError: The path is not allowed; nothing moves.
            StoppedError: The arm is stopped, or was stopped on its way.
            ServoError: It did not arrive.
        """
        named: Any = {} if goal is None else goal
        if isinstance(goal, str):
            named = self._plans.pose(goal, gripper=grip is None)
        if not isinstance(named, Mapping) or not (named or joints):
            raise UsageError("move() takes angles by joint, as in move(J1=deg(30)), or the name of a pose")
        if isinstance(goal, str) and relative:
            raise UsageError("the angles of a pose do not count from where the joints are")
        angles, more = joint_angles(self.model, named), joint_angles(self.model, joints)
        if not isinstance(goal, str):
            for name in more:
                if name in angles:
                    raise UsageError(f"{name} is named twice")
        return self._move(angles | more, relative, speed, duration, wait, grip)

    @takes(goal=ANGLES, duration=_TIME, wait=FLAG)
    def send(self, goal: Mapping[str, float], /, *, duration: float = 1.0, wait: bool = True) -> MotionResult:
        """Send angles to joints as one target: each servo goes there by itself, unless the board has the path.

        Args:
            goal: Radians by joint.
            duration: Seconds; longer if a speed limit requires it.
            wait: Return when the arm has arrived; else once the target is sent: the motion outlives the program.

        Raises:
            HexwireError: As `move`.
        """
        asked = self._asked()
        target = JointTarget.of(joint_angles(self.model, goal), duration)
        how = replace(self._front.options, table=self._height())

        def run(claim: Claim, observer: MotionObserver) -> MotionResult:
            result = motions.run_motion(
                self.driver, target, how, wait=wait, observer=observer, asked=asked, rest=True
            )
            observer.ended(result)
            silent = () if result.sent is None else result.sent.silent
            raise_if_silent([(self.model.joint(name).servo_id, name) for name in silent])
            self._require(result)
            return result

        sent: MotionResult = self._run(lambda observer: (run, duration), asked, wait=True)
        return sent

    @overload
    def goto(self, *points: Point, wait: Literal[True] = True, **how: Unpack[_Goto]) -> MotionResult: ...
    @overload
    def goto(self, *points: Point, wait: Literal[False], **how: Unpack[_Goto]) -> MotionHandle[MotionResult]: ...
    @takes(down=FLAG, relative=FLAG, speed=or_none(SHARE), duration=or_none(SECONDS), wait=FLAG)
    def goto(
        self,
        *points: Point,
        x: float | None = None,
        y: float | None = None,
        z: float | None = None,
        down: bool = False,
        pitch: float | None = None,
        roll: float | None = None,
        rpy: Vector | None = None,
        relative: bool = False,
        grip: Opening | None = None,
        speed: float | None = None,
        duration: float | None = None,
        wait: bool = True,
    ) -> Any:
        """Move the tip to a place on the fastest path; of several points, only the last is a stop.

        Args:
            *points: Places ``(x, y, z)`` in metres, names of poses, or radians by joint.
            x: Instead of a point: the coordinates that are not given stay as they are.
            y: See `x`.
            z: See `x`.
            down: The tool points straight down. Without this, `pitch` or `rpy` it keeps its direction relative to
                the arm.
            pitch: Of the tool of an arm with five joints, radians: 0 is level.
            roll: With `pitch`: angle of its last joint, radians; it stays if None.
            rpy: Roll, pitch and yaw of the tool of an arm with six joints, about the base's axes, radians.
            relative: A place counts from the tip, or from the point before.
            grip: As for `move`.
            speed: As for `move`.
            duration: As for `move`.
            wait: As for `move`.

        Returns:
            A `MotionResult`, or the handle.

        Raises:
            HexwireError: As `move`; a place out of reach is a LimitError.
        """
        asked = self._asked()
        aim = self._plans.aim(down, rpy, pitch, roll)
        wanted = self._plans.points("goto", points, (x, y, z), aim, relative, gripper=grip is None)

        def plan(here: dict[str, float]) -> list[Trajectory]:
            return [self._plans.through(wanted(here), here, self._share(speed, duration), duration)]

        return self._motion(plan, self._plans.moved, asked, wait, grip)

    @overload
    def line(self, *points: Point, wait: Literal[True] = True, **how: Unpack[_Lines]) -> MotionResult: ...
    @overload
    def line(self, *points: Point, wait: Literal[False], **how: Unpack[_Lines]) -> MotionHandle[MotionResult]: ...
    @takes(down=FLAG, relative=FLAG, wait=FLAG)
    def line(
        self,
        *points: Point,
        x: float | None = None,
        y: float | None = None,
        z: float | None = None,
        down: bool = False,
        pitch: float | None = None,
        roll: float | None = None,
        rpy: Vector | None = None,
        relative: bool = False,
        grip: Opening | None = None,
        tip_speed: float = 0.05,
        rounding: float = 0.01,
        wait: bool = True,
    ) -> Any:
        """Move the tip on straight lines; it passes their corners without a stop, and rounds them.

        Args:
            *points: As for `goto`.
            x: As for `goto`, and likewise `y` and `z`.
            y: See `x`.
            z: See `x`.
            down: As for `goto`; without this, `pitch` or `rpy` the tool keeps its direction in space.
            pitch: As for `goto`.
            roll: As for `goto`.
            rpy: As for `goto`.
            relative: As for `goto`.
            grip: As for `move`.
            tip_speed: Metres per second.
            rounding: How far from a corner the tip may leave the lines, metres; 0 stops there.
            wait: As for `move`.

        Returns:
            A `MotionResult`, or the handle.

        Raises:
            HexwireError: As `goto`.
        """
        asked = self._asked()
        aim = self._plans.aim(down, rpy, pitch, roll, fixed=True)
        wanted = self._plans.points("line", points, (x, y, z), aim, relative)

        def plan(here: dict[str, float]) -> list[Trajectory]:
            return [self._plans.line(wanted(here), here, tip_speed, rounding)]

        return self._motion(plan, self._plans.moved, asked, wait, grip)

    @overload
    def home(self, *, wait: Literal[True] = True, **how: Unpack[_How]) -> MotionResult: ...
    @overload
    def home(self, *, wait: Literal[False], **how: Unpack[_How]) -> MotionHandle[MotionResult]: ...
    @takes(speed=or_none(SHARE), duration=or_none(SECONDS), wait=FLAG)
    def home(self, *, speed: float | None = None, duration: float | None = None, wait: bool = True) -> Any:
        """Go to the pose named home, which every arm has; as `move`."""
        return self._move(self._plans.pose(HOME), False, speed, duration, wait)

    @overload
    def play(self, motion: Motion, /, *, wait: Literal[True] = True, **how: Unpack[_Play]) -> MotionResult: ...
    @overload
    def play(
        self, motion: Motion, /, *, wait: Literal[False], **how: Unpack[_Play]
    ) -> MotionHandle[MotionResult]: ...
    @takes(
        factor=_FACTOR,
        begin=_TIME,
        end=_END,
        smooth=_TIME,
        trim=FLAG,
        fit=FLAG,
        repeat=_TIMES,
        step=_STEP,
        ask=_CALLED,
        wait=FLAG,
    )
    def play(
        self,
        motion: Motion,
        /,
        *,
        factor: float = 1.0,
        begin: float = 0.0,
        end: float = math.inf,
        smooth: float = 0.0,
        trim: bool = False,
        fit: bool = False,
        repeat: int = 1,
        step: int = 1,
        ask: Asking | None = None,
        wait: bool = True,
    ) -> Any:
        """Go slowly to where a motion begins, and play it; or run a program, after all of it was checked.

        Args:
            motion: A recording (.mcap), a program (.toml), what `teach` or `record` has recorded, or a trajectory.
            factor: 2 plays twice as fast.
            begin: Where a recording is to begin, seconds.
            end: Where it is to end, seconds.
            smooth: Remove tremor of a recording that is shorter than this, seconds.
            trim: Remove pauses at both ends of a recording.
            fit: Play it more slowly if it is too fast for the limits, at the largest factor that keeps them.
            repeat: How often it is played.
            step: The step with which a program begins, from 1.
            ask: Called where a program waits for a person, with what it asks for, as `input`; the program goes on
                when it returns.
            wait: As for `move`.

        Returns:
            A `MotionResult`, or the handle.

        Raises:
            HexwireError: As `move`.
        """
        asked = self._asked()
        if isinstance(motion, str | Path) and is_program(motion):
            if (factor, begin, end, smooth, trim, fit) != (1.0, 0.0, math.inf, 0.0, False, False):
                raise UsageError("factor, begin, end, smooth, trim and fit are for motions; a program has its own")
            return self._program(motion, step, repeat, ask, asked, wait)
        if step != 1 or ask is not None:
            raise UsageError("step and ask are for programs (.toml)")
        if isinstance(motion, Lesson | Recording):
            motion = motion.played()
        with self._told():
            make = self._plans.played(motion, Edits(begin, end, trim, smooth))
            names = make(factor).names

        def plan(here: dict[str, float]) -> CheckedPath:
            return check_played(self.driver, make, factor, here, self._how(), repeat=repeat, fit=fit)

        return self._motion(plan, names, asked, wait)

    # -- the gripper ----------------------------------------------------------------------------------

    @overload
    def grip(self, opening: Opening, /, *, wait: Literal[True] = True, **how: Unpack[_Grip]) -> MotionResult: ...
    @overload
    def grip(
        self, opening: Opening, /, *, wait: Literal[False], **how: Unpack[_Grip]
    ) -> MotionHandle[MotionResult]: ...
    @takes(force=_FORCE, duration=SECONDS, wait=FLAG)
    def grip(
        self,
        opening: Opening,
        /,
        *,
        force: float = 0.25,
        duration: float = 0.8,
        wait: bool = True,
    ) -> Any:
        """Open or close the gripper. Closing ends at an object, and keeps a little pressure on it.

        Args:
            opening: 0 is closed, 1 fully open; or a word.
            force: Effort from which a stationary jaw counts as holding something, fraction of full effort.
            duration: Seconds from closed to open.
            wait: As for `move`.

        Returns:
            A `MotionResult`, or the handle: `holds` says whether it has an object, `opening` how far it is open.

        Raises:
            HexwireError: As `move`.
        """
        return self._grip(opening, force, duration, wait)

    @overload
    def open(self, *, duration: float = 0.8, wait: Literal[True] = True) -> MotionResult: ...
    @overload
    def open(self, *, duration: float = 0.8, wait: Literal[False]) -> MotionHandle[MotionResult]: ...
    @takes(duration=SECONDS, wait=FLAG)
    def open(self, *, duration: float = 0.8, wait: bool = True) -> Any:
        """Open the gripper; see `grip`."""
        return self._grip("open", 0.25, duration, wait)

    @overload
    def close(self, *, wait: Literal[True] = True, **how: Unpack[_Grip]) -> MotionResult: ...
    @overload
    def close(self, *, wait: Literal[False], **how: Unpack[_Grip]) -> MotionHandle[MotionResult]: ...
    @takes(force=_FORCE, duration=SECONDS, wait=FLAG)
    def close(self, *, force: float = 0.25, duration: float = 0.8, wait: bool = True) -> Any:
        """Close the gripper; see `grip`. `detach` ends the work with the arm."""
        return self._grip("close", force, duration, wait)

    # -- by hand --------------------------------------------------------------------------------------

    @takes(file=or_none(_KEPT), seconds=_END, limp=FLAG, force=FLAG)
    def teach(
        self,
        file: str | Path | RecordingWriter | None = None,
        /,
        *,
        rate: float = 0.0,
        seconds: float = math.inf,
        limp: bool = False,
        force: bool = False,
    ) -> Lesson:
        """Switch torque off and record how a hand moves the arm, until the ``with`` block ends; then it holds.

        Hold the arm first: it sinks.

        Args:
            file: Where the recording is kept (.mcap), or a writer that the caller closes; nowhere if None.
            rate: States per second; 0 for the robot's command rate.
            seconds: When to end by itself.
            limp: Leave torque off at the end.
            force: Replace such a file.

        Returns:
            The lesson; its `taught` is what `play` plays.

        Raises:
            UsageError: Another motion of this arm runs; or the file exists, or cannot be written.
            StoppedError: The arm is stopped, so that it could not hold at the end.
            ServoError: A joint kept its torque.
        """
        checked = self._rate(rate)
        with self._asking():
            # It could not be held at the end.
            if not limp and self.driver.read().stopped:
                raise StoppedError("the lesson", _STOPPED, f"the arm is stopped; {STOP_LATCHED}")
        claim = Claim(self._claims, None, "is being taught: end() the lesson")
        with self._claimed(claim):
            if file is None or isinstance(file, RecordingWriter):
                writer: AbstractContextManager[RecordingWriter | None] = nullcontext(file)
            else:
                writer = recording_writer(file, force, self._told)
            return self._kept(Lesson(self.driver, writer, limp, checked, seconds, claim, self._told))

    @overload
    def follow(self, leader: Arm, *, wait: Literal[True] = True, **how: Unpack[_Follow]) -> None: ...
    @overload
    def follow(self, leader: Arm, *, wait: Literal[False], **how: Unpack[_Follow]) -> Handle[None]: ...
    @takes(
        mirror=FLAG, meet=SHARE, force=_FORCE, max_speed=_LIMIT, max_acceleration=_LIMIT, rate=_FACTOR, wait=FLAG
    )
    def follow(
        self,
        leader: Arm,
        *,
        mirror: bool = False,
        meet: float = 0.2,
        force: float = 0.35,
        max_speed: Limit = None,
        max_acceleration: Limit = None,
        rate: float = 100.0,
        wait: bool = True,
    ) -> Handle[None] | None:
        """Move as another arm, which is moved by hand, until Ctrl-C or a stop of either; then hold.

        Args:
            leader: The arm to follow; its torque is switched off: hold it.
            mirror: The arms face each other: base and wrist turn the other way.
            meet: Share of the speed limits until it has met the leader.
            force: Load, as a fraction of full scale, at which its gripper stops closing; 1 for no limit.
            max_speed: Most radians per second once it has met the leader, of all joints or by name; None for what
                the servos reach without a load.
            max_acceleration: Most radians per second squared, likewise.
            rate: Cycles per second.
            wait: Return at the end; else at once, with a handle whose `end` ends it, as does its ``with`` block.

        Raises:
            UsageError: It cannot follow this arm; or another motion of this arm runs.
            StoppedError: The leader or this arm is stopped, or was stopped meanwhile.
            HexwireError: An arm failed.
        """
        from hexwire.control.motion.following import Pair, run_following

        if not isinstance(leader, Arm):
            raise UsageError(f"follow() takes another arm that connect() has opened, not {shown(leader)}")
        asked = self._asked()
        check_rate(rate)
        self._check_open()
        if is_same_arm(leader.driver, self.driver):
            raise UsageError("an arm cannot follow itself")
        if leader.read().stopped:
            with self._told():
                raise StoppedError("following", _STOPPED, f"the leader is stopped; {STOP_LATCHED}")
        observer = self._front.observer or motions.MotionObserver()
        pair = Pair.of(
            leader.driver,
            self.driver,
            self._height(),
            mirror=mirror,
            meet=meet,
            force=force,
            max_speed=max_speed,
            max_acceleration=max_acceleration,
            asked=asked,
            on_note=observer.noted,
        )
        claim = Claim(self._claims, asked, "follows another: end() that", here=wait)

        def run(ending: threading.Event) -> None:
            with self._explained(asked):
                run_following(pair, rate, on_ready=lambda: observer.powered(self.model.names), ended=ending)

        # Ctrl-C is the usual end: the follower holds.
        with suppress(KeyboardInterrupt) if wait else nullcontext(), self._claimed(claim):
            if not wait:
                claim.watch()
                return self._kept(Handle(self.driver, "follow", run, claim))
            with claim.doing_it():
                run(claim.ending)
        return None

    @takes(file=_FILE, force=FLAG)
    def record(self, file: str | Path, /, *, rate: float = 0.0, force: bool = False) -> Recording:
        """Record states until the ``with`` block ends, whether the arm moves or not.

        Args:
            file: Where to (.mcap).
            rate: States per second; 0 for the robot's command rate.
            force: Replace such a file.

        Raises:
            UsageError: The file exists, or cannot be written.
        """
        checked = self._rate(rate)
        self._check_open()
        writer = recording_writer(file, force, self._told)
        return self._kept(Recording(self.driver, file, writer, lambda: self._states(checked, math.inf)))

    # -- torque and stop ------------------------------------------------------------------------------

    @takes(on=FLAG)
    def torque(self, on: bool = True, *joints: str) -> None:
        """Switch torque on, without motion, or off: then the arm sinks.

        Args:
            on: On or off.
            *joints: Only these.

        Raises:
            ServoError: A joint has not confirmed it.
        """
        wanted = tuple(self.model.joint(check("torque", "joints", NAME, name)).name for name in joints)
        self._check_open()
        self._take()
        with self._told():
            switch_torque(self.driver, on, wanted or self.model.names, self._front.observer)

    @takes(limp=FLAG)
    def stop(self, *, limp: bool = False) -> None:
        """Stop at once, whatever program moves the arm; nothing moves until `resume`. Any thread may call it.

        Args:
            limp: Switch torque off, too.

        Raises:
            ServoError: A joint has not confirmed it.
        """
        with self._told():
            done = self.driver.stop(StopMode.TORQUE_OFF if limp else StopMode.HOLD)
            require_confirmed(self.model, self.model.names, done, "the stop")

    def resume(self) -> bool:
        """End a stop; nothing moves. Returns whether a watchdog had stopped the arm."""
        with self._told():
            return end_stop(self.driver)

    # -- the end --------------------------------------------------------------------------------------

    @takes(torque_off=FLAG)
    def detach(self, *, torque_off: bool = False) -> None:
        """End what goes on, and close the connection; joints with torque hold.

        Args:
            torque_off: Switch torque off first.

        Raises:
            HexwireError: What went on had failed, and nobody had waited for it.
        """
        errors: list[BaseException] = []
        try:
            self._end_now()
            for handle in self._handles:
                try:
                    handle.close()
                except Exception as error:  # noqa: BLE001  # raised below
                    errors.append(error)
        finally:
            self._handles.clear()
            forget_ctrl_c()
            self.driver.detach(torque_off=torque_off)
            self._open = False
            _attached.discard(self)
        if errors:
            raise errors[0]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        torque_off = False
        try:
            if error is None:
                torque_off = self._finish()
        except BaseException as failure:
            error = failure
            raise
        finally:
            if error is not None:
                self._abandon(stops=isinstance(error, KeyboardInterrupt))
            self.detach(torque_off=torque_off)

    def __repr__(self) -> str:
        return f"<Arm {self.model.name} at {self.driver.url}>"

    # -- how it is done -------------------------------------------------------------------------------

    def _asked(self) -> Token:
        """The time of a call: a stop from now on voids it."""
        return self.driver.epochs.mark()

    def _check_open(self) -> None:
        if not self._open:
            raise UsageError(DETACHED)

    @contextmanager
    def _asking(self) -> Iterator[None]:
        """Ask the arm something, in a ``with`` block."""
        self._check_open()
        with self._told():
            yield

    def _finish(self) -> bool:
        """Let motions come to their end, and the arm rest; whether its torque may be switched off then."""
        for handle in self._handles:
            # Of others the end comes with `detach`; and what the program has heard already is not news.
            if isinstance(handle, MotionHandle) and not handle.told:
                handle.wait()
        self._end_now()
        if self._rest is None:
            return False
        state = self.read()
        # What was made limp stays so.
        rest = {name: angle for name, angle in self._rest.items() if name in state.torque_on}
        if state.stopped or not rest:
            return False
        self._move(rest, False, None, None, True)
        return True

    def _abandon(self, *, stops: bool) -> None:
        """End what goes on, whatever comes of it; with a stop, or with joints that come to rest."""
        claim = self._claims.now
        elsewhere = claim is not None and claim.thread != threading.get_ident()
        if stops and (elsewhere or not all(handle.done for handle in self._handles)):
            self.driver.stop()
        self._end_now()
        for handle in self._handles:
            handle.abandon()

    def _leave(self) -> None:
        """Detach at the end of the interpreter, as at the end of a ``with`` block that raises."""
        with suppress(HexwireError):
            self._abandon(stops=isinstance(getattr(sys, "last_value", None), KeyboardInterrupt))
        with suppress(HexwireError):
            self.detach()

    def _take(self) -> None:
        """Take the lease of a shared arm, also one that was lost by silence: a person asks for this."""
        if not self._front.dry_run:
            with self._told():
                if (leased := Leased.find(self.driver)) is not None:
                    leased.take()

    def _clear_path(self, joints: Sequence[str], asked: Token) -> None:
        """Bring joints to rest that a path of an earlier program still moves."""
        with self.driver.epochs.using(asked):
            if (paths := OnboardPaths.find(self.driver)) is not None:
                paths.clear_path(joints)

    @contextmanager
    def _claimed(self, claim: Claim) -> Iterator[None]:
        """Take the arm for what is begun in the block; what interrupts the block, such as Ctrl-C, ends it.

        Raises:
            UsageError: Another one goes on. One that was stopped, or lost its torque, ends at once.
            LeaseError: Another program holds the lease of this shared arm.
        """
        try:
            self._begin(claim)
            yield
        except BaseException as error:
            # Nobody will have a handle of it.
            claim.give_up(stops=isinstance(error, KeyboardInterrupt))
            raise

    def _begin(self, claim: Claim) -> None:
        self._check_open()
        self._take()
        forget_ctrl_c()
        for handle in self._handles:
            if (error := handle.unheard) is not None:
                _log.error("what went on has failed, and nobody had waited for it: %s", error)
        self._handles = [handle for handle in self._handles if not handle.done]
        before = self._claims.now
        ends = before is not None and before.asked is not None and not self.driver.epochs.holds(before.asked)
        if doing := self._claims.take(claim, _ENDS if ends else 0.0):
            raise UsageError(f"this arm {doing}")
        if self._ender not in (None, threading.get_ident()):
            raise UsageError(_ENDED)

    def _end_now(self) -> None:
        """Bring to rest what this or another thread has begun, and let no other one begin."""
        self._ender = threading.get_ident()
        claim = self._claims.now
        if claim is not None and claim.thread != self._ender:
            claim.end(WORK_ENDED)
            claim.over.wait()

    def _kept(self, handle: _H) -> _H:
        self._handles.append(handle)
        return handle

    def _move(
        self,
        angles: Mapping[str, float],
        relative: bool,
        speed: float | None,
        duration: float | None,
        wait: bool,
        grip: Opening | None = None,
    ) -> Any:
        plans = self._plans

        def plan(here: dict[str, float]) -> list[Trajectory]:
            there = {name: here[name] + angle for name, angle in angles.items()} if relative else angles
            return [plans.through([there], here, self._share(speed, duration), duration)]

        return self._motion(plan, tuple(angles), self._asked(), wait, grip)

    def _grip(self, opening: Opening, force: float, duration: float, wait: bool) -> Any:
        asked = self._asked()
        share = _opening(opening)

        def run(claim: Claim, observer: MotionObserver) -> MotionResult:
            result = motions.run_grip(
                self.driver,
                share,
                duration,
                force=force,
                observer=observer,
                cancelled=claim.ends,
                asked=asked,
            )
            return self._told_of(result, claim, observer)

        return self._run(lambda observer: (run, duration), asked, wait)

    def _motion(
        self,
        plan: Callable[[dict[str, float]], list[Trajectory] | CheckedPath],
        joints: Sequence[str],
        asked: Token,
        wait: bool,
        grip: Opening | None = None,
    ) -> Any:
        """Run a motion, which is planned and checked in this thread: the caller gets what is wrong with it."""
        opening = None if grip is None else _opening(grip)
        how = self._how()

        def prepare(
            observer: MotionObserver,
        ) -> tuple[_Run[MotionResult], float]:
            if not self._front.dry_run:
                self._clear_path(joints, asked)
            start = read_start(self.driver)
            with _beyond_limits():
                path = plan(start)
                if not isinstance(path, CheckedPath):
                    path = motions.check_path(self.driver, path, how, start=start, grip=opening)
            observer.planned(path)
            if self._front.dry_run:
                return lambda claim, observer: motions.MotionResult(None), 0.0

            def run(claim: Claim, observer: MotionObserver) -> MotionResult:
                result = motions.run_motion(
                    self.driver,
                    path,
                    how,
                    until=lambda _: claim.ends(),
                    observer=observer,
                    asked=asked,
                    rest=True,
                )
                return self._told_of(result, claim, observer)

            meanwhile = 0.0 if opening is None else MOST_SECONDS
            return run, max(meanwhile, sum(leg.duration for leg in path.legs))

        return self._run(prepare, asked, wait)

    def _program(
        self, file: str | Path, first: int, times: int, ask: Asking | None, asked: Token, wait: bool
    ) -> Any:
        """Run a program; all of it is checked in this thread."""
        how = self._how()
        with self._told():
            program = read_program(file)
            asks = asking(program, ask)
            steps = ProgramRun(self.driver, self._plans, program, first, times, how)

        def prepare(observer: MotionObserver) -> tuple[_Run[MotionResult], float]:
            if not self._front.dry_run:
                self._clear_path(self.model.names, asked)
            with _beyond_limits():
                seconds = steps.check(read_start(self.driver), observer)
            if self._front.dry_run:
                return lambda claim, observer: motions.MotionResult(None), 0.0

            def run(claim: Claim, observer: MotionObserver) -> MotionResult:
                return steps.run(
                    claim, observer, asked, asks, lambda result: self._told_of(result, claim, observer)
                )

            return run, seconds

        return self._run(prepare, asked, wait)

    def _run(
        self,
        prepare: Callable[[MotionObserver], tuple[_Run[_R], float]],
        asked: Token,
        wait: bool,
    ) -> Any:
        """Run a motion, here or in a thread of its own.

        Args:
            prepare: Gets who is told; returns what runs it and its seconds, or raises what is wrong with it.
            asked: When it was asked for.
            wait: Here.
        """
        stop = None if wait else self.driver.stop
        claim = Claim(self._claims, asked, _MOVES, here=wait, stop=stop)
        own = _Observer(self)
        observer = self._front.observer if wait and self._front.observer is not None else own
        with self._claimed(claim):
            with self._told():
                run, duration = prepare(observer)

            def explained(ending: threading.Event | None = None) -> _R:
                with self._explained(asked):
                    return run(claim, observer)

            if wait:
                with claim.doing_it():
                    result = explained()
                if claim.why and getattr(result, "cut", False):
                    raise UsageError(_ENDED)
                return result
            claim.watch()
            handle = MotionHandle(self.driver, explained, duration, claim)
            own.see = handle.see
            return self._kept(handle)

    @contextmanager
    def _explained(self, asked: Token) -> Iterator[None]:
        """Say of what was ended by a stop, or by torque off, that this is why."""
        epochs = self.driver.epochs
        try:
            with self._told(), _beyond_limits():
                yield
        except HexwireError as error:
            if epochs.limp_since(asked) and not epochs.stopped:
                raise StoppedError("the motion", _STOPPED, f"torque was switched off; {NOT_LATCHED}") from error
            # A stop may be met as a lost lease, or as a request that was refused. The end of a connection stops the
            # arm, too: then that end is the reason.
            if isinstance(error, StoppedError | LinkError) or epochs.holds(asked):
                raise
            with self._told():
                raise StoppedError(
                    "the motion", _STOPPED, f"the arm was stopped; {what_helps(self.driver)}"
                ) from error

    def _how(self) -> motions.MotionOptions:
        """How its motions are run and checked."""
        return replace(self._front.options, table=self._height())

    def _height(self) -> float | None:
        """The table's height, which a program may have set to anything."""
        return None if self.table is None else length("table", self.table)

    def _share(self, speed: float | None, duration: float | None) -> float:
        if speed is not None and duration is not None:
            raise UsageError("give a speed or a duration, not both")
        return self.speed if speed is None else speed

    def _told_of(self, result: MotionResult, claim: Claim, observer: MotionObserver) -> MotionResult:
        """Tell how a motion has ended; raises as `_require`."""
        if result.cut and claim.why:
            result = replace(result, ended=claim.why)
        observer.ended(result)
        self._require(result)
        return result

    def _require(self, result: MotionResult) -> None:
        """Raise what a person must know of a motion that has not arrived."""
        if result.stopped is not None:
            raise StoppedError("the motion", _STOPPED, f"{result.why}; {what_helps(self.driver)}")
        if not result.cut:
            result.require()


def _leave_all() -> None:
    for arm in tuple(_attached):
        arm._leave()


# Threads that move an arm would end with the interpreter, wherever the arm is then.
atexit.register(_leave_all)


@contextmanager
def _beyond_limits() -> Iterator[None]:
    """A path that is not allowed is a matter of limits, whoever has checked it."""
    try:
        yield
    except GoalError as error:
        if error.reason != Reason.PATH_NOT_ALLOWED:
            raise
        raise LimitError(*error.args) from error


def _opening(given: Opening) -> float:
    share = OPENINGS.get(given, math.nan) if isinstance(given, str) else given
    if not is_number(share):
        raise UsageError(f"grip() takes 'open', 'close' or an opening from 0 to 1, not {shown(given)}")
    # A gripper that is open or closed is a little beyond its range, and may stay so.
    return min(max(share, 0.0), 1.0) if -_BEYOND < share < 1.0 + _BEYOND else share


class _Observer(motions.MotionObserver):
    """Passes the states of a motion to its handle, and warns once of an arm that nothing watches."""

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self.see: Callable[[JointState], object] = lambda state: None

    def unwatched(self, seconds: float) -> None:
        if not self._arm._warned:
            self._arm._warned = True
            _log.warning("%s", unwatched_words(self._arm.driver, seconds))

    def planned(self, path: CheckedPath) -> None:
        if path.slowed:
            _log.warning("%s", path.slowed)

    def seen(self, state: JointState) -> None:
        self.see(state)
