"""`Arm`: go there, grip, come back.

Owns the verbs of one arm: what they take, which order they keep, and that one motion runs at a time. Must not know
how a motion is checked, planned or run, nor which kind of robot it is.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, Self, TextIO, TypedDict, TypeVar, Unpack, overload

from hexwire.arguments import WHOLE, Wanted, check
from hexwire.control import motions
from hexwire.control import rest as resting
from hexwire.control.following import Pair, following_rules, run_following
from hexwire.control.gripping import GripResult, run_grip
from hexwire.control.pose_file import HOME
from hexwire.control.power import end_stop
from hexwire.control.reader import read_known, read_start
from hexwire.drivers.registry import connect as connect_driver
from hexwire.drivers.values import StopMode
from hexwire.errors import HexwireError, ServoError, StoppedError, UsageError
from hexwire.model.aim import Tip
from hexwire.motion.teach import Taught
from hexwire.motion.waypoints import Trajectory

from .blocks import Lesson, Recording, recording_writer
from .handle import STOP_ENDS, Handle, MotionHandle, told
from .plans import SHARE, Plans, Point, approached, is_number, joint_angles, length
from .poses import Poses

if TYPE_CHECKING:
    from hexwire.control.motions import MotionObserver, MotionResult
    from hexwire.drivers.base import RobotDriver
    from hexwire.epochs import Token
    from hexwire.model.arm import ArmModel, JointModel
    from hexwire.model.picture import Picture
    from hexwire.model.pose import Vector
    from hexwire.model.state import JointState

__all__ = ["Arm", "connect"]

_log = logging.getLogger(__name__)

_R = TypeVar("_R")
_H = TypeVar("_H", bound=Handle[Any])

Motion = str | Path | Taught | Trajectory
"""A recording by its file, what `Arm.teach` has recorded, or a trajectory."""
Opening = float | Literal["open", "close"]
"""0 is closed, 1 fully open; or a word."""

_OPENINGS = {"open": 1.0, "close": 0.0}
_FORCE = Wanted("a share of full effort, 0 to 1", lambda value: is_number(value) and 0 <= value <= 1)
_STOPPED = 5
"""Status `stopped` of PROTOCOL.md section 6.2."""
_UNWATCHED = "%s has no watchdog: if this program dies, the arm moves on for up to %.2g s"


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
    repeat: int


class _Follow(TypedDict, total=False):
    mirror: bool
    meet: float
    force: float
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
    armed. A verb returns when the arm has come to rest, or raises. Ctrl-C stops the arm. With ``wait=False`` a verb
    returns a handle at once. One motion runs at a time; any thread may read and stop.

    Args:
        driver: The attached robot.
        speed: See `connect`.
        table: Likewise.
        rest: Likewise.

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
    ) -> None:
        self.driver = driver
        self.speed: float = check("connect", "speed", SHARE, speed)
        self.table = None if table is None else length("table", table)
        self.poses = Poses(driver.model, self.read)
        self._plans = Plans(driver, self.poses)
        self._rest = rest if rest is None else self._plans.pose(rest)
        self._free = threading.Lock()
        self._doing = ""
        self._open = True
        self._handles: list[Handle[Any]] = []
        self._warned = False

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
        self._check_open()
        return self.driver.read()

    def states(self, rate: float = 0.0, *, seconds: float = math.inf) -> Iterator[JointState]:
        """Read states again and again, also while a motion runs.

        Args:
            rate: Per second; 0 for the robot's command rate.
            seconds: When to end.

        Raises:
            UsageError: There is no such rate.
        """
        if not is_number(rate) or rate < 0:
            raise UsageError(f"a rate is a number per second, or 0 for the robot's own, not {rate!r}")
        return self._states(1.0 / (rate or self.driver.command_rate), seconds)

    def _states(self, period: float, seconds: float) -> Iterator[JointState]:
        due = begin = time.monotonic()
        while due - begin < seconds:
            yield self.read()
            # After a pause, states are not made up for.
            due = max(due + period, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))

    @property
    def tip(self) -> Tip:
        """The measured place and direction of the tip of its tool.

        Raises:
            UsageError: The arm's geometry is not known.
            ServoError: A joint does not answer.
        """
        kinematics = self._plans.kinematics
        state = read_known(self.driver, kinematics.joint_names)
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

        shapes = make_shapes(self._plans.kinematics)
        return draw_arm(shapes, (state or self.read()).positions, self.model.name)

    @property
    def opening(self) -> float:
        """How far the gripper is open: 0 is closed, 1 fully open.

        Raises:
            UsageError: No gripper of this arm is known.
        """
        from hexwire.drivers.tools import Gripper

        return Gripper(self.driver).share(self.read())

    # -- motions --------------------------------------------------------------------------------------

    @overload
    def move(
        self,
        goal: str | Mapping[str, float] | None = None,
        /,
        *,
        relative: bool = False,
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
        speed: float | None = None,
        duration: float | None = None,
        wait: Literal[False],
        **joints: float,
    ) -> MotionHandle[MotionResult]: ...
    def move(
        self,
        goal: str | Mapping[str, float] | None = None,
        /,
        *,
        relative: bool = False,
        speed: float | None = None,
        duration: float | None = None,
        wait: bool = True,
        **joints: float,
    ) -> Any:
        """Move joints together to angles; joints that are not named stay: ``arm.move(J1=deg(30))``.

        Args:
            goal: Radians by joint, or the name of a pose.
            relative: The angles count from where the joints are.
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
        named: Any = self._plans.pose(goal) if isinstance(goal, str) else goal or {}
        if not isinstance(named, Mapping) or not (named or joints):
            raise UsageError("move() takes angles by joint, as in move(J1=deg(30)), or the name of a pose")
        if isinstance(goal, str) and relative:
            raise UsageError("the angles of a pose do not count from where the joints are")
        angles, more = joint_angles(self.model, named), joint_angles(self.model, joints)
        if not isinstance(goal, str):
            for name in more:
                if name in angles:
                    raise UsageError(f"{name} is named twice")
        return self._move(angles | more, relative, speed, duration, wait)

    @overload
    def goto(self, *points: Point, wait: Literal[True] = True, **how: Unpack[_Goto]) -> MotionResult: ...
    @overload
    def goto(self, *points: Point, wait: Literal[False], **how: Unpack[_Goto]) -> MotionHandle[MotionResult]: ...
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
            speed: As for `move`.
            duration: As for `move`.
            wait: As for `move`.

        Returns:
            A `MotionResult`, or the handle.

        Raises:
            HexwireError: As `move`; a place out of reach is a LimitError.
        """
        asked = self._asked()
        wanted = self._plans.points("goto", points, (x, y, z), self._plans.aim(down, rpy, pitch, roll), relative)

        def plan(here: dict[str, float]) -> list[Trajectory]:
            return [self._plans.through(wanted(here), here, self._share(speed, duration), duration)]

        return self._motion(plan, asked, wait)

    @overload
    def line(self, *points: Point, wait: Literal[True] = True, **how: Unpack[_Lines]) -> MotionResult: ...
    @overload
    def line(self, *points: Point, wait: Literal[False], **how: Unpack[_Lines]) -> MotionHandle[MotionResult]: ...
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

        return self._motion(plan, asked, wait)

    @overload
    def home(self, *, wait: Literal[True] = True, **how: Unpack[_How]) -> MotionResult: ...
    @overload
    def home(self, *, wait: Literal[False], **how: Unpack[_How]) -> MotionHandle[MotionResult]: ...
    def home(self, *, speed: float | None = None, duration: float | None = None, wait: bool = True) -> Any:
        """Go to the pose named home, which every arm has; as `move`."""
        return self._move(self._plans.pose(HOME), False, speed, duration, wait)

    @overload
    def play(self, motion: Motion, /, *, wait: Literal[True] = True, **how: Unpack[_Play]) -> MotionResult: ...
    @overload
    def play(
        self, motion: Motion, /, *, wait: Literal[False], **how: Unpack[_Play]
    ) -> MotionHandle[MotionResult]: ...
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
        repeat: int = 1,
        wait: bool = True,
    ) -> Any:
        """Go slowly to where a motion begins, and play it.

        Args:
            motion: A recording (.mcap), what `teach` has recorded, or a trajectory.
            factor: 2 plays twice as fast.
            begin: Where a recording is to begin, seconds.
            end: Where it is to end, seconds.
            smooth: Remove tremor of a recording that is shorter than this, seconds.
            trim: Remove pauses at both ends of a recording.
            repeat: How often it is played.
            wait: As for `move`.

        Returns:
            A `MotionResult`, or the handle.

        Raises:
            HexwireError: As `move`.
        """
        asked = self._asked()
        if check("play", "repeat", WHOLE, repeat) < 1:
            raise UsageError(f"play() repeats a motion at least once, not {repeat} times")
        path = self._plans.played(motion, factor, begin, end, smooth, trim)

        def plan(here: dict[str, float]) -> list[Trajectory]:
            return approached(self.model, path, here, repeat)

        return self._motion(plan, asked, wait)

    # -- the gripper ----------------------------------------------------------------------------------

    @overload
    def grip(self, opening: Opening, /, *, wait: Literal[True] = True, **how: Unpack[_Grip]) -> GripResult: ...
    @overload
    def grip(
        self, opening: Opening, /, *, wait: Literal[False], **how: Unpack[_Grip]
    ) -> MotionHandle[GripResult]: ...
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
            A `GripResult`, or the handle.

        Raises:
            HexwireError: As `move`.
        """
        return self._grip(opening, force, duration, wait)

    @overload
    def open(self, *, duration: float = 0.8, wait: Literal[True] = True) -> GripResult: ...
    @overload
    def open(self, *, duration: float = 0.8, wait: Literal[False]) -> MotionHandle[GripResult]: ...
    def open(self, *, duration: float = 0.8, wait: bool = True) -> Any:
        """Open the gripper; see `grip`."""
        return self._grip("open", 0.25, duration, wait)

    @overload
    def close(self, *, wait: Literal[True] = True, **how: Unpack[_Grip]) -> GripResult: ...
    @overload
    def close(self, *, wait: Literal[False], **how: Unpack[_Grip]) -> MotionHandle[GripResult]: ...
    def close(self, *, force: float = 0.25, duration: float = 0.8, wait: bool = True) -> Any:
        """Close the gripper; see `grip`. `detach` ends the work with the arm."""
        return self._grip("close", force, duration, wait)

    # -- by hand --------------------------------------------------------------------------------------

    def teach(self, file: str | Path | None = None, /, *, limp: bool = False, force: bool = False) -> Lesson:
        """Switch torque off and record how a hand moves the arm, until the ``with`` block ends; then it holds.

        Hold the arm first: it sinks.

        Args:
            file: Where the recording is kept (.mcap); nowhere if None.
            limp: Leave torque off at the end.
            force: Replace such a file.

        Returns:
            The lesson; its `taught` is what `play` plays.

        Raises:
            UsageError: Another motion of this arm runs; or the file exists, or cannot be written.
            StoppedError: The arm is stopped, so that it could not hold at the end.
            ServoError: A joint kept its torque.
        """
        if not limp and self.read().stopped:
            # It could not be held at the end.
            raise StoppedError("the lesson", _STOPPED, f"the arm is stopped; {STOP_ENDS}")
        self._claim("is being taught: end() the lesson")
        try:
            writer = None if file is None else recording_writer(file, force)
        except BaseException:
            self._free.release()
            raise
        # From here on the end of the lesson gives the arm free, also if it fails at once.
        return self._kept(Lesson(self.driver, writer, limp, self._free.release))

    @overload
    def follow(self, leader: Arm, *, wait: Literal[True] = True, **how: Unpack[_Follow]) -> None: ...
    @overload
    def follow(self, leader: Arm, *, wait: Literal[False], **how: Unpack[_Follow]) -> Handle[None]: ...
    def follow(
        self,
        leader: Arm,
        *,
        mirror: bool = False,
        meet: float = 0.2,
        force: float = 0.35,
        rate: float = 100.0,
        wait: bool = True,
    ) -> Handle[None] | None:
        """Move as another arm, which is moved by hand, until Ctrl-C or a stop; then hold.

        Args:
            leader: The arm to follow; its torque is switched off: hold it.
            mirror: The arms face each other: base and wrist turn the other way.
            meet: Share of the speed limits until it has met the leader.
            force: Load, as a fraction of full scale, at which its gripper stops closing; 1 for no limit.
            rate: Cycles per second.
            wait: Return at the end; else at once, with a handle whose `end` ends it, as does its ``with`` block.

        Raises:
            UsageError: It cannot follow this arm; or another motion of this arm runs.
            HexwireError: An arm failed.
        """
        if not isinstance(leader, Arm):
            raise UsageError(f"follow() takes another arm that connect() has opened, not {leader!r}")
        if leader is self or leader.driver.url == self.driver.url:
            raise UsageError("an arm cannot follow itself")
        checks = motions.MotionOptions(table=self.table).checks(self.driver)
        rules = following_rules(leader.driver, self.driver, checks, mirror=mirror, meet=meet, force=force)
        pair = Pair(leader.driver, self.driver, rules, lambda said: _log.info("%s", said), check=checks)
        self._claim("follows another: end() that")

        def run(ending: threading.Event) -> None:
            try:
                run_following([pair], rate, ended=ending)
            finally:
                self._free.release()

        if not wait:
            return self._kept(Handle(self.driver, "follow", run))
        # Ctrl-C is the usual end: the follower holds.
        with suppress(KeyboardInterrupt):
            run(threading.Event())
        return None

    def record(self, file: str | Path, /, *, rate: float = 0.0, force: bool = False) -> Recording:
        """Record states until the ``with`` block ends, whether the arm moves or not.

        Args:
            file: Where to (.mcap).
            rate: States per second; 0 for the robot's command rate.
            force: Replace such a file.

        Raises:
            UsageError: The file exists, or cannot be written.
        """
        return self._kept(Recording(self.driver, file, force, lambda: self.states(rate)))

    # -- torque and stop ------------------------------------------------------------------------------

    def torque(self, on: bool = True, *joints: str) -> None:
        """Switch torque on, without motion, or off: then the arm sinks.

        Args:
            on: On or off.
            *joints: Only these.

        Raises:
            ServoError: A joint has not confirmed it.
        """
        wanted = tuple(self.model.joint(name).name for name in joints) or self.model.names
        with told():
            done = self.driver.torque(on, joints or None)
        if missing := [name for name in wanted if name not in done]:
            raise ServoError(f"{', '.join(missing)} did not confirm that torque is {'on' if on else 'off'}")

    def stop(self, *, limp: bool = False) -> None:
        """Stop at once, whatever program moves the arm; nothing moves until `resume`. Any thread may call it.

        Args:
            limp: Switch torque off, too.

        Raises:
            ServoError: A joint has not confirmed it.
        """
        done = self.driver.stop(StopMode.TORQUE_OFF if limp else StopMode.HOLD)
        if missing := [name for name in self.model.names if name not in done]:
            raise ServoError(f"{', '.join(missing)} did not confirm the stop; check the arm")

    def resume(self) -> None:
        """End a stop; nothing moves."""
        end_stop(self.driver)

    # -- the end --------------------------------------------------------------------------------------

    def detach(self, *, torque_off: bool = False) -> None:
        """End what goes on, and close the connection; joints with torque hold.

        Args:
            torque_off: Switch torque off first.

        Raises:
            HexwireError: What went on had failed, and nobody had waited for it.
        """
        errors: list[BaseException] = []
        try:
            for handle in self._handles:
                try:
                    handle.close()
                except Exception as error:  # noqa: BLE001  # raised below
                    errors.append(error)
        finally:
            self._handles.clear()
            self.driver.detach(torque_off=torque_off)
            self._open = False
        if errors:
            raise errors[0]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            if isinstance(error, KeyboardInterrupt) and not all(handle.done for handle in self._handles):
                self.driver.stop()
            for handle in self._handles:
                handle.abandon()
            self.detach()
            return
        torque_off = False
        try:
            for handle in self._handles:
                # A motion that was begun comes to its end.
                if isinstance(handle, MotionHandle):
                    handle.wait()
            if self._rest is not None and not self.read().stopped:
                self._move(self._rest, False, None, None, True)
                torque_off = True
        finally:
            self.detach(torque_off=torque_off)

    def __repr__(self) -> str:
        return f"<Arm {self.model.name} at {self.driver.url}>"

    # -- how it is done -------------------------------------------------------------------------------

    def _asked(self) -> Token:
        """The time of a call: a stop from now on voids it."""
        return self.driver.epochs.mark()

    def _check_open(self) -> None:
        if not self._open:
            raise UsageError("this arm is detached, as at the end of its with block: connect() again")

    def _claim(self, doing: str = "is in motion: wait for it, cancel it, or stop()") -> None:
        self._check_open()
        for handle in self._handles:
            if (error := handle.unheard) is not None:
                _log.error("what went on has failed, and nobody had waited for it: %s", error)
        self._handles = [handle for handle in self._handles if not handle.done]
        if not self._free.acquire(blocking=False):
            raise UsageError(f"this arm {self._doing}")
        self._doing = doing

    def _kept(self, handle: _H) -> _H:
        self._handles.append(handle)
        return handle

    def _move(
        self, angles: Mapping[str, float], relative: bool, speed: float | None, duration: float | None, wait: bool
    ) -> Any:
        plans = self._plans

        def plan(here: dict[str, float]) -> list[Trajectory]:
            there = {name: here[name] + angle for name, angle in angles.items()} if relative else angles
            return [plans.through([there], here, self._share(speed, duration), duration)]

        return self._motion(plan, self._asked(), wait)

    def _grip(self, opening: float | str, force: float, duration: float, wait: bool) -> Any:
        asked = self._asked()
        share = _OPENINGS.get(opening, math.nan) if isinstance(opening, str) else opening
        if not is_number(share):
            raise UsageError(f"grip() takes 'open', 'close' or an opening from 0 to 1, not {opening!r}")

        held = check("grip", "force", _FORCE, force)

        def run(ending: threading.Event, observer: MotionObserver) -> GripResult:
            result = run_grip(
                self.driver,
                share,
                duration,
                force=held,
                observer=observer,
                cancelled=ending.is_set,
                asked=asked,
            )
            self._require(result.motion)
            return result

        return self._run(lambda: (run, duration), asked, wait)

    def _motion(self, plan: Callable[[dict[str, float]], list[Trajectory]], asked: Token, wait: bool) -> Any:
        """Run a motion, which is planned and checked in this thread: the caller gets what is wrong with it."""

        def prepare() -> tuple[Callable[[threading.Event, MotionObserver], MotionResult], float]:
            # Joints that a path of an earlier program still moves come to rest first.
            with self.driver.epochs.using(asked):
                self.driver.clear_path()
            how = motions.MotionOptions(table=self.table)
            path = motions.check_path(self.driver, plan(read_start(self.driver)), how)
            last = path.legs[-1]
            goal = dict(zip(last.names, last.goal, strict=True))

            def run(ending: threading.Event, observer: MotionObserver) -> MotionResult:
                result = motions.run_motion(
                    self.driver,
                    path,
                    how,
                    until=lambda _: ending.is_set(),
                    observer=observer,
                    asked=asked,
                )
                self._require(result)
                return result if result.cut else replace(result, rest=resting.come_to_rest(self.driver, goal))

            return run, sum(leg.duration for leg in path.legs)

        return self._run(prepare, asked, wait)

    def _run(
        self,
        prepare: Callable[[], tuple[Callable[[threading.Event, MotionObserver], _R], float]],
        asked: Token,
        wait: bool,
    ) -> Any:
        """Run a motion, here or in a thread of its own.

        Args:
            prepare: Returns what runs it and its seconds, or raises what is wrong with it.
            asked: When it was asked for.
            wait: Here.
        """
        self._claim()
        observer = _Observer(self)
        try:
            run, duration = prepare()
        except BaseException:
            self._free.release()
            raise

        def claimed(ending: threading.Event) -> _R:
            try:
                with told():
                    return run(ending, observer)
            except HexwireError as error:
                # A stop may be met as a lost lease, or as a request that was refused.
                if isinstance(error, StoppedError) or self.driver.epochs.holds(asked):
                    raise
                raise StoppedError("the motion", _STOPPED, f"the arm was stopped; {STOP_ENDS}") from error
            finally:
                self._free.release()

        if wait:
            return claimed(threading.Event())
        handle = MotionHandle(self.driver, claimed, duration)
        observer.see = handle.see
        return self._kept(handle)

    def _share(self, speed: float | None, duration: float | None) -> float:
        if speed is not None and duration is not None:
            raise UsageError("give a speed or a duration, not both")
        return self.speed if speed is None else speed

    def _require(self, result: MotionResult) -> None:
        """Raise what a person must know of a motion that has not arrived."""
        if result.stopped is not None:
            raise StoppedError("the motion", _STOPPED, f"{result.why}; {STOP_ENDS}")
        if not result.cut:
            result.require()


class _Observer(motions.MotionObserver):
    """Passes the states of a motion to its handle, and warns once of an arm that nothing watches."""

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self.see: Callable[[JointState], object] = lambda state: None

    def unwatched(self, seconds: float) -> None:
        if not self._arm._warned:
            self._arm._warned = True
            _log.warning(_UNWATCHED, self._arm.model.name, seconds)

    def seen(self, state: JointState) -> None:
        self.see(state)
