"""The one owner of a moving robot: it reads states, lets the controllers decide, and writes targets.

Owns the read-update-write cycle, the watchdog during it, calls that other threads queue for it, with their time
limits, that a robot has one owner in a program (two would send targets in turn and disarm each other's watchdog),
and the reaction to a failure of the robot: everything stops and goals end. It runs in its own thread and
reconnects, or in the caller's thread with a robot borrowed from the caller.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, wait
from contextlib import ExitStack, suppress
from typing import TYPE_CHECKING, Any, Self, TypeVar
from weakref import WeakValueDictionary

from hexwire.arguments import ROBOT
from hexwire.arguments import check as check_argument
from hexwire.drivers.abilities import Reconnects, Watchdog
from hexwire.drivers.values import StopMode
from hexwire.errors import (
    DeviceError,
    HexwireError,
    LeaseError,
    LinkError,
    LinkLostError,
    LinkPermissionError,
    PreemptedError,
    ReplyTimeoutError,
    StoppedError,
    UsageError,
    WrongDeviceError,
)
from hexwire.motion.safety import STOP_COMMAND, StopReason, board_stop

from ..motion.path_check import PathCheck
from .group import ControllerGroup
from .known_state import LatestState
from .output import Output
from .reader import StateReader, check_joints
from .target import AHEAD

if TYPE_CHECKING:
    from types import TracebackType

    from hexwire.drivers.base import ProbeReport, RobotDriver
    from hexwire.drivers.timed_path import PathStart
    from hexwire.epochs import Epochs, Token
    from hexwire.model.arm import ArmModel
    from hexwire.model.state import JointState, JointTarget, SentTarget

    from .group import Controller, ControllerLock
    from .known_state import KnownState
    from .loop import RateLoop

__all__ = ["QueuedCalls", "RobotOwner", "claim", "join_or_abort", "release", "voided_by_stop"]

# By the robot's `id`, which stays the robot's as long as its owner exists, since the owner refers to it.
_owners: WeakValueDictionary[int, object] = WeakValueDictionary()


def claim(robot: RobotDriver, owner: object) -> None:
    """Make this the owner of a robot.

    Raises:
        UsageError: Another owner has it.
    """
    if _owners.setdefault(id(robot), owner) is not owner:
        raise UsageError("the robot is already in motion for another caller; wait until that ends, or stop it")


def release(robot: RobotDriver, owner: object) -> None:
    """Give a robot up; without effect if another owner has it."""
    if _owners.get(id(robot)) is owner:
        del _owners[id(robot)]


_T = TypeVar("_T")


def voided_by_stop(call: Callable[[], _T], epochs: Epochs | None) -> Callable[[], _T]:
    """Wrap a call so that a stop between now and its execution voids it.

    Args:
        call: The call.
        epochs: The stops of the robot, if it has any.
    """
    if epochs is None:
        return call
    # Perhaps part of an earlier call, such as an order that arrived before the stop.
    asked = epochs.of_this_call or epochs.mark()

    def dated() -> _T:
        with epochs.using(asked):
            return call()

    return dated


class QueuedCalls:
    """Calls from other threads that wait for the owner.

    Args:
        timeout: Seconds that a caller waits until its call begins, and then until it ends.
    """

    def __init__(self, timeout: float = 10.0) -> None:
        self._timeout = timeout
        self._waiting: deque[tuple[Callable[[], Any], Future[Any]]] = deque()

    def call(self, call: Callable[[], _T]) -> _T:
        """Queue a call and wait for its result.

        Raises:
            DeviceError: It did not begin in time and was dropped; or it did not end in time.
            Exception: What the call raised, or the error passed to `fail`.
        """
        future: Future[_T] = Future()
        self._waiting.append((call, future))
        # Not `result(timeout)`, whose timeout looks like one raised by the call.
        wait((future,), self._timeout)
        if future.cancel():
            raise DeviceError(f"the robot was busy for {self._timeout:g} s; nothing was done")
        # It is running or done.
        wait((future,), self._timeout)
        if not future.done():
            raise DeviceError(f"the robot has not finished within {self._timeout:g} s")
        return future.result()

    def run(self) -> None:
        """Run all queued calls, in the owner's thread.

        Raises:
            LinkError: A call found the line lost; both its caller and the owner get the error.
            PreemptedError: A stop interrupted a call; likewise.
        """
        while self._waiting:
            call, future = self._waiting.popleft()
            if not future.set_running_or_notify_cancel():
                continue
            try:
                result = call()
            except BaseException as error:
                future.set_exception(error)
                # A lost line concerns the owner too, and so does an error that is not an Exception.
                if isinstance(error, LinkError | PreemptedError) or not isinstance(error, Exception):
                    raise
            else:
                future.set_result(result)

    def fail(self, error: Exception) -> None:
        """Raise an error in all queued callers; none of their calls runs."""
        while self._waiting:
            _, future = self._waiting.popleft()
            if future.set_running_or_notify_cancel():
                future.set_exception(error)


_ABORTS = 20
"""How often a blocking operation is aborted."""


def join_or_abort(thread: threading.Thread, patience: float, abort: Callable[[], object], more: float) -> bool:
    """Wait for a thread to end; if it does not, abort its blocking operation.

    Args:
        thread: The thread.
        patience: Seconds to wait first.
        abort: Aborts the operation. Called repeatedly, since the thread may be about to start another one.
        more: Seconds to wait while aborting.

    Returns:
        Whether the thread has ended.
    """
    thread.join(patience)
    for _ in range(_ABORTS):
        if not thread.is_alive():
            return True
        abort()
        thread.join(more / _ABORTS)
    return not thread.is_alive()


_log = logging.getLogger(__name__)

_RETRY = 0.5
"""Seconds between two attempts to reconnect."""
_PERIODS = 4.0
"""Least watchdog timeout of a borrowed robot, in periods."""
_FEEDS = 4.0
"""States read per watchdog timeout: a driver feeds the watchdog between them."""
_SHORT = 0.02
"""Seconds for which a shutdown may wait until the owner notices it."""
_UNUSED = 2.0
"""Seconds for which an arm is not in use until its states are read rarely."""
_RARELY = 5.0
"""States per second then; so late somebody who needs them gets the first one."""
_FRESH = 1.0
"""Greatest age in seconds of a state from which a motion may begin; on a slow line, three command periods."""
_SILENT = 0.5
"""Seconds for which a silent joint is still published; on a slow line, three command periods."""
_PATIENCE, _PATIENCE_LOST = 5.0, 2.0
"""Seconds at shutdown until the owner's link is aborted: if connected, and while reconnecting."""


class RobotOwner:
    """The only object that reads and moves a robot.

    Call `connect` once, then `start` its thread or call `turn` in a loop; finally `shutdown`. Any thread may call
    the other methods.

    Args:
        robot: Not attached, unless it is borrowed.
        borrowed: The robot is attached, and stays attached at the end. A state is read before every target, and a
            failure stops the arm and is raised by `turn`. Otherwise `connect` attaches the robot, the robot reports
            its states if it can, and the owner reconnects after a failure.
        check: Checks what the controllers send together; if None, with the robot's geometry and a table at the
            height of its base. `PathCheck.limits_only` switches that off.
        publish_rate: States per second; fewer on a slow line.
        command_rate: Targets per second; 0 for the rate that the robot's line allows.
        watchdog: Seconds of silence after which the board stops the arm; 0 for never. Longer for a borrowed robot
            with slow cycles.
        watchdog_mode: What the board does then.
        timed: Trajectories of the controllers are sent ahead to a robot that executes trajectories itself.
        stop_on_failure: Stop the arm when the robot fails or `shutdown` ends a motion; False for a caller that
            makes it safe by other means.
        on_state: Called with every new state and the part of it to publish, in the owner's thread.
        on_sent: Called with every target as sent, in the owner's thread.
        asked: Marks when the motion was asked for; a later stop cancels it. Now if None.
        clock: Monotonic seconds; the robot's clock if None.
        sleep: Waits for a number of seconds; if None, a wait that `shutdown` ends.
        read: Reads a state of a borrowed robot; the robot's `read` if None.

    Attributes:
        robot: The robot.
        group: The controllers; `start` fills it.
        connected: The robot answers.
        error: Why it is not connected; empty if it is.
        waits_for: Why `connect` still waits.
        reconnects: Number of reconnections.
        probe: The report of the last probe.
        crash: The programming error that ended the thread, if any.
        observers: Called in the owner's thread with every state, before it becomes the newest; see `observe`.
        needed: Whether somebody needs the states of an arm that rests without torque; otherwise they are read
            rarely.
    """

    def __init__(
        self,
        robot: RobotDriver,
        *,
        borrowed: bool = False,
        check: PathCheck | None = None,
        publish_rate: float = 100.0,
        command_rate: float = 0.0,
        watchdog: float = 1.0,
        watchdog_mode: StopMode = StopMode.HOLD,
        timed: bool = False,
        stop_on_failure: bool = True,
        on_state: Callable[[JointState, KnownState], object] = lambda state, published: None,
        on_sent: Callable[[SentTarget], object] = lambda sent: None,
        asked: Token | None = None,
        clock: Callable[[], float] | None = None,
        sleep: Callable[[float], object] | None = None,
        read: Callable[[], JointState] | None = None,
    ) -> None:
        check_argument("RobotOwner", "robot", ROBOT, robot)
        self.robot = robot
        self._read = read
        # What ends one motion of a borrowed robot, such as the end of this program's use, voids no call of others.
        epochs = None if borrowed else robot.epochs
        self.group = ControllerGroup(check=check or PathCheck.of(robot), epochs=epochs)
        self.connected, self.error, self.waits_for = False, "not connected yet", ""
        self.reconnects = 0
        self.probe: ProbeReport | None = None
        self.crash: BaseException | None = None
        self.observers: tuple[Callable[[JointState], object], ...] = ()
        # Re-entrant, since a signal handler may stop the arm, which ends a motion and what observes it.
        self._observing = threading.RLock()
        self._borrowed, self._stop_on_failure = borrowed, stop_on_failure
        self._publish_rate, self._command_rate = publish_rate, command_rate
        self._wanted_watchdog, self._watchdog_mode, self._watched = watchdog, watchdog_mode, ExitStack()
        self._covered = False
        self._ending, self._on_state = threading.Event(), on_state
        self._clock, self._sleep = clock or robot.now, sleep or self._wait
        self._output = Output(
            robot,
            self.group,
            borrowed=borrowed,
            on_sent=on_sent,
            look_again=self._look_again,
            arm_watchdog=self.arm_watchdog,
            asked=asked,
            clock=clock,
            sleep=self._sleep,
            timed=timed,
        )
        # A stop that could not be sent, and must be when the robot is back.
        self._owes_stop = False
        # What failed in another thread since the last turn.
        self._failed: HexwireError | None = None
        self.needed: Callable[[], bool] = lambda: True
        self._reader: StateReader | None = None
        # States per second while the arm is in use; since when it has not been, and whether fewer are read.
        self._rate = 0.0
        self._unused_since: float | None = None
        self._reads_rarely = False
        self._restarts = 0
        self._latest, self._calls = LatestState(publish_rate), QueuedCalls()
        self._thread: threading.Thread | None = None
        self._still_armed: HexwireError | None = None
        # Id of the thread that turns: its calls run at once.
        self._turning = 0
        self._line = Reconnects.find(robot)
        if self._line is not None and not borrowed:
            # The owner must notice a lost link and stop the arm; automatic reconnection would hide it.
            self._line.auto_reconnect(on=False)

    # -- start and shutdown -------------------------------------------------------------------------

    def connect(self, timeout: float = 0.0) -> None:
        """Connect to the robot; as `RobotDriver.attach`, nothing is sent that moves it.

        Args:
            timeout: Seconds to keep trying while there is no port or no answer.

        Raises:
            LinkError: The port cannot be opened.
            DeviceError: The robot does not answer; at once if a different one does.
            UsageError: Another owner has the robot.
        """
        claim(self.robot, self)
        self._turning = threading.get_ident()
        if self._borrowed and not self.connected:
            self._begin()
        deadline, said = self._clock() + timeout, ""
        while not self.connected:
            if self._ending.is_set():
                raise LinkLostError("the program ends")
            try:
                self._attach()
            except (LinkPermissionError, WrongDeviceError):
                raise
            except (LinkError, ReplyTimeoutError) as error:
                if self._clock() >= deadline or self._ending.is_set():
                    raise
                if said != (said := str(error)):
                    _log.info("%s; waiting for it", said)
                self.waits_for = said
                self._sleep(_RETRY)

    def start(self, controllers: Sequence[Controller]) -> None:
        """Run `turn` in the owner's thread until `shutdown`."""
        self.group.members = controllers
        self._thread = threading.Thread(target=self._run, name="owner", daemon=True)
        self._thread.start()

    def give_up(self) -> None:
        """End a `connect` that waits in another thread: it raises a LinkError soon."""
        self._ending.set()
        if not self.connected:
            self.robot.abort()

    def shutdown(self, *, torque_off: bool = False) -> None:
        """End the thread and detach from the robot; a motion in progress is stopped, and stays stopped.

        Args:
            torque_off: Switch torque off; the arm may fall.

        Raises:
            UsageError: It is called in the owner's own thread.
        """
        if self._thread is threading.current_thread():
            raise UsageError("the thread of the owner cannot end itself; call shutdown in another thread")
        self._ending.set()
        # In reverse order; each step follows whatever the others raise.
        with ExitStack() as steps:
            steps.callback(release, self.robot, self)
            steps.callback(self._leave, torque_off)
            steps.callback(self._disarm)
            steps.callback(self._end_thread)
            # Targets that a borrowed robot got past its controllers belong to its caller; and its motion may have
            # arrived before the time of its last target is over.
            moving = self.group.moving or (not self._borrowed and bool(self.running()))
            steps.callback(self.group.settle)
            self.group.announce(StopReason("asked", "the program ends"))
            with suppress(HexwireError):
                if self.connected and moving and self._stop_on_failure:
                    self.robot.stop()

    def _end_thread(self) -> None:
        patience = _PATIENCE if self.connected else _PATIENCE_LOST
        if self._thread is not None and not join_or_abort(self._thread, patience, self.robot.abort, _PATIENCE):
            _log.error("the robot's thread does not end")
        self._calls.fail(LinkLostError("the program ends"))

    def _disarm(self) -> None:
        try:
            if not self.alive:
                self._close_reader()
            if self.connected or self._borrowed:
                self._watched.close()
        except HexwireError as error:
            self._still_armed = error

    def _leave(self, torque_off: bool) -> None:
        connected, self.connected, self.error = self.connected, False, "the program has ended"
        if not self._borrowed:
            with suppress(HexwireError):
                self.robot.detach(torque_off=torque_off and connected)

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.shutdown()
        if error is None and self._borrowed and self._still_armed is not None:
            # The board will stop the arm: the caller must not take the motion for a success.
            raise self._still_armed

    @property
    def model(self) -> ArmModel:
        """The robot's joints."""
        return self.robot.model

    @property
    def alive(self) -> bool:
        """The thread runs."""
        return self._thread is not None and self._thread.is_alive()

    @property
    def command_period(self) -> float:
        """Seconds between two targets; available once the robot is connected."""
        return 1.0 / (self._command_rate or self.robot.command_rate)

    @property
    def lead(self) -> float:
        """Duration of a target, seconds."""
        return AHEAD * self.command_period

    @property
    def watchdog(self) -> float:
        """Seconds of silence after which the board stops the arm; 0 if no watchdog is armed."""
        dog = Watchdog.find(self.robot)
        return self._wanted_watchdog if dog is not None and dog.watchdog_armed else 0.0

    @property
    def timing(self) -> RateLoop:
        """The loop that paces the turns when states are read on request.

        Raises:
            UsageError: There was no turn yet.
        """
        if self._reader is None:
            raise UsageError("there was no turn yet")
        return self._reader.timing

    @property
    def rate(self) -> float:
        """States published per second, over the last seconds."""
        return self._latest.rate(self._clock())

    @property
    def state(self) -> JointState | None:
        """The newest state, or None."""
        return self._latest.state

    @property
    def state_age(self) -> float:
        """Seconds since the last state that could be published; infinite before the first."""
        return self._latest.age(self._clock())

    # -- requests from any thread ---------------------------------------------------------------------

    def locked(self) -> ControllerLock:
        """The lock that guards the controllers. Do not block while holding it."""
        return self.group.lock

    def now(self) -> float:
        """Time of the owner's clock, seconds."""
        return self._clock()

    def newest(self) -> JointState:
        """The newest state, fresh enough for a motion to begin there.

        Raises:
            LinkLostError: The robot is not connected.
            DeviceError: The last state is too old.
        """
        self._check_reachable()
        state, age = self._latest.state, self._clock() - self._latest.heard
        # The usual case first: each set-point of a shared arm asks for it.
        if state is None or (age > _FRESH and age > 3.0 * self.command_period):
            raise DeviceError(f"no state from the robot for {age:.1f} s; wait for one")
        return state

    def observe(self, observer: Callable[[JointState], object], *, on: bool = True) -> None:
        """Call something with every state from the next one on, or no more."""
        # None is lost that another thread adds at the same time, or that comes after one which ends now.
        with self._observing:
            others = tuple([one for one in self.observers if one != observer])
            self.observers = (*others, observer) if on else others

    def hurry(self) -> None:
        """Send a target after the next state, if none was sent for a period: a motion has begun."""
        self._output.hurry()

    def begin_at_once(self) -> None:
        """As `hurry`, but in the caller's thread, without waiting for the next state.

        Do not hold the lock of the controllers, nor another one that the owner takes. What fails here is reported
        by the owner's next turn.
        """
        state = self._latest.state
        if state is None or not self.connected or not self._may_send():
            self._output.hurry()
            return
        try:
            self._output.begin(state, self.command_period, self.lead)
        except PreemptedError:
            # A stop interrupted it, and handles the rest.
            return
        except HexwireError as error:
            self._failed = error

    def call(self, call: Callable[[], _T]) -> _T:
        """Run a call in the owner's thread between two states, and wait for its result.

        Raises:
            LinkLostError: The robot is not connected.
            DeviceError: The call did not finish in time, or the owner has failed.
            HexwireError: What the call raised.
        """
        self._check_reachable()
        if threading.get_ident() == self._turning:
            return call()
        return self._calls.call(voided_by_stop(call, self.robot.epochs))

    def probe_again(self) -> ProbeReport:
        """Probe the robot, between two states; raises as `call`."""

        def probe() -> ProbeReport:
            try:
                return self.robot.probe()
            finally:
                # A probe ends the reports.
                self._close_reader()

        return self.call(probe)

    def speeds(self, names: tuple[str, ...]) -> list[float]:
        """Velocities of joints out of the last positions, radians per second; NaN if unknown."""
        return self._latest.speeds(names)

    def deciding(self) -> threading.RLock:
        """The lock that is held while a target is decided and sent. A stop does not wait for it."""
        return self._output.deciding

    def guard(self, before: Callable[[], object], refusal: Callable[[], HexwireError | None]) -> None:
        """Subject the controllers to an authority.

        Args:
            before: Called in the owner's thread before targets are decided, while it holds `deciding`.
            refusal: Returns the error with which a target is refused right before its bytes leave, or None.
        """
        self._output.before, self._output.refusal = before, refusal

    def command(self, sub_cmd: int, data: bytes) -> bytes:
        """Send a special command; see `RobotDriver.ioctl`. Joints that it may move count as moving.

        Raises:
            HexwireError: As `call`, and as the command.
        """

        def command() -> bytes:
            if self.robot.may_move(sub_cmd, data):
                # First: without an answer the robot may have received it nevertheless.
                self._output.set_free()
            return self.robot.ioctl(sub_cmd, data)

        return self.call(command)

    def running(self) -> tuple[str, ...]:
        """Joints that are moving to the last target sent, or may be."""
        return self._output.running()

    def time_left(self) -> float:
        """Seconds until the last joint has reached its last target; 0 if none moves."""
        return self._output.time_left()

    def settle(self, why: str) -> None:
        """End all motions of the controllers; joints that follow a path of the robot are at rest when it returns.

        Args:
            why: In words.

        Raises:
            HexwireError: As `brake`.
        """
        self.group.release(why)
        self.brake()

    @property
    def path_start(self) -> PathStart | None:
        """When the path that the robot follows in its own time starts or has started; None if there is none."""
        return self._output.path_start

    def brake(self) -> tuple[str, ...]:
        """Bring joints that follow a path of the robot to rest on it, and wait for that; returns them.

        Raises:
            HexwireError: They do not come to rest, or the robot does not answer.
        """
        return self._output.brake()

    def send(self, target: JointTarget, asked: Token, *, holds: bool = False) -> SentTarget:
        """Send a target from any thread, between two cycles; the controllers of its joints end their motions.

        Args:
            target: Checked by the caller.
            asked: When it was asked for; a stop since then cancels it.
            holds: It ends the motion of its joints where they are.

        Raises:
            LinkLostError: The robot is not connected.
            DeviceError: The watchdog is not armed yet, right after the robot was connected.
            StoppedError: The arm is stopped, or was stopped since.
            HexwireError: As `RobotDriver.write`.
        """
        self._check_reachable()
        if not self._may_send():
            # Do not wait for the owner's thread: the caller may hold `deciding`.
            raise DeviceError("the watchdog is not armed yet; try again in a moment")
        return self._output.send(target, asked, holds=holds)

    def _may_send(self) -> bool:
        """Whether other threads may send: the owner's thread arms the watchdog, in its first cycle."""
        return self._covered or not (self._wanted_watchdog and self.robot.can(Watchdog))

    def stop(self, why: str, mode: StopMode = StopMode.HOLD) -> tuple[str, ...]:
        """Latched stop, ahead of everything else: it does not wait for the lock of the controllers.

        Args:
            why: The reason, for display.
            mode: How the arm stops.

        Returns:
            Names of the joints that confirmed it.

        Raises:
            HexwireError: The robot could not be reached; the controllers are stopped nevertheless.
        """
        # First: from here on nothing is accepted that was asked for before, and no target is decided.
        self.group.announce(StopReason("asked", why))
        try:
            if not self.connected:
                self._owes_stop = not self._borrowed
                raise LinkLostError(f"the stop cannot be sent to the robot: {self.error}")
            return self.robot.stop(mode)
        finally:
            self.group.settle()

    def reset(self, asked: Token | None = None) -> None:
        """Clear a latched stop. Nothing moves.

        Args:
            asked: When it was asked for, a mark of the robot's stops; a later stop is not cleared. Now if None.

        Raises:
            UsageError: Its cause persists, or the arm was stopped again.
            HexwireError: The robot refuses.
        """
        when = self.robot.epochs.mark() if asked is None else asked
        self.call(lambda: self._output.reset(when))

    def torque(self, on: bool, names: Sequence[str]) -> tuple[str, ...]:
        """Switch torque on, at the present position, or off; a motion of the switched joints ends.

        Returns:
            Names of the joints that confirmed it.

        Raises:
            HexwireError: The arm is stopped, or the robot refuses.
        """
        return self.call(lambda: self._output.torque(on, names))

    def arm_watchdog(self) -> None:
        """Arm the watchdog, if it is wanted and not armed yet: no target is sent without it. Owner's thread only.

        Raises:
            StoppedError: A borrowed robot is stopped; arming would hide that its watchdog has tripped.
        """
        if self._covered or not self._wanted_watchdog:
            return
        if self._borrowed:
            self._wanted_watchdog = max(self._wanted_watchdog, _PERIODS * self.command_period)
        # If the owner attached the robot, it has reported a stop before.
        watched = self.robot.watched(self._wanted_watchdog, self._watchdog_mode, always=not self._borrowed)
        self._watched.enter_context(watched)
        self._covered = True

    # -- the cycle --------------------------------------------------------------------------------------

    def turn(self) -> None:
        """Run one cycle, or one attempt to reconnect.

        Raises:
            HexwireError: A borrowed robot failed; the owner tried to stop it.
        """
        self._turning = threading.get_ident()
        if not self.connected:
            if self._borrowed:
                raise LinkLostError(self.error)
            self._reconnect()
            return
        try:
            if self._failed is not None:
                raise self._failed
            if self._reader is None:
                self._reader = self._begin_reading()
            state = self._reader.next()
            if state is not None:
                self._take(state)
                if self._line is not None and not self._borrowed:
                    self._see_restarts()
                now, period = self._clock(), self.command_period
                self._output.update(state, self._latest.speeds(state.names), now, period, AHEAD * period)
                self._choose_rate(self._reader, state)
            self._calls.run()
        except PreemptedError:
            # A stop interrupted the exchange on the line: not a failure, and the stop handles the rest.
            self._close_reader()
            if self._borrowed and self.group.reason is None:
                # The one motion of a borrowed robot is over; its target may never have been sent.
                self.group.stop(StopReason("board", STOP_COMMAND))
        except HexwireError as error:
            self._lose(error)
            if self._borrowed:
                raise

    def _run(self) -> None:
        try:
            while not self._ending.is_set():
                self.turn()
        except BaseException as error:  # noqa: BLE001  # passed on in `crash`
            # A programming error: stop the arm, and let the program see the error.
            _log.exception("the robot's thread failed")
            self.crash = error
            self.group.announce(StopReason("lost", f"the program failed: {error}"))
            self._calls.fail(DeviceError(f"the program failed: {error}"))
            with suppress(HexwireError):
                self.robot.stop()
            self.group.settle()

    def _attach(self) -> None:
        self.robot.attach()
        try:
            probe = self.robot.probe()
            if self.probe is not None and not probe.same_kind(self.probe):
                # Rates and timeouts were chosen for the previous board.
                raise DeviceError(
                    f"a board of dialect {probe.dialect} replaced one of dialect {self.probe.dialect}; "
                    "plug the old one in again, or restart the program"
                )
            self._catch_up()
            state = self.robot.read()
            self.probe = probe
        except BaseException:
            with suppress(HexwireError):
                self.robot.detach()
            raise
        self._begin()
        self._take(state)

    def _catch_up(self) -> None:
        """Send the stop that was owed while the robot could not be reached: its last target may be far away."""
        if not self._owes_stop:
            return
        try:
            self.robot.stop()
        except (LinkError, ReplyTimeoutError):
            raise
        except HexwireError as error:
            _log.error("after the reconnection the stop was not confirmed: %s", error)
        self._owes_stop = False

    def _begin(self) -> None:
        self._latest.begin(1.0 / self._publish_rate, max(_SILENT, 3.0 * self.command_period))
        self._output.forget_path()
        self._reader, self._covered, self._failed = None, False, None
        self.connected, self.error = True, ""

    def _begin_reading(self) -> StateReader:
        # First, since arming the watchdog clears the board's flag that it tripped.
        if self.state is not None and (found := board_stop(self.state)) is not None:
            self.group.stop(found)
            self._output.tell(logging.WARNING, "%s; reset it before the next motion", found)
        # Not earlier, since nothing feeds the watchdog between `connect` and the first turn. For an arm that is
        # stopped it is armed before the first target.
        with suppress(StoppedError):
            self.arm_watchdog()
        rate = 1.0 / self.command_period
        if not self._borrowed:
            # Every target needs a state, even if states are published rarely.
            rate = max(self._publish_rate, rate, _FEEDS / self.watchdog if self.watchdog else 0.0)
        reader = StateReader(
            self.robot, rate, ask=self._borrowed, read=self._read, clock=self._clock, sleep=self._sleep
        )
        self._latest.begin(reader.period, max(_SILENT, 3.0 * self.command_period))
        self._restarts = self._resets()
        self._rate, self._unused_since, self._reads_rarely = rate, None, False
        return reader

    def _choose_rate(self, reader: StateReader, state: JointState) -> None:
        """Read rarely while the arm is not in use: without torque, and nobody needs to know."""
        if self.needed() or self.group.busy or state.torque_on or self.running():
            self._unused_since = None
            if self._reads_rarely:
                self._reads_rarely = False
                reader.change_rate(self._rate)
        elif self._unused_since is None:
            self._unused_since = self._clock()
        elif not self._reads_rarely and self._clock() - self._unused_since >= _UNUSED:
            self._reads_rarely = True
            rarely = max(_RARELY, _FEEDS / self.watchdog if self.watchdog else 0.0)
            reader.change_rate(min(rarely, self._rate))

    def _reconnect(self) -> None:
        self._fail_calls()
        try:
            self._attach()
        except HexwireError as error:
            self.error = str(error)
            self._fail_calls()
            self._sleep(_RETRY)
        else:
            self.reconnects += 1
            _log.warning("reconnected to the robot at %s", self.robot.url)

    def _lose(self, error: HexwireError) -> None:
        # During a shutdown this is normal: an emulated board ends too.
        self._output.tell(logging.INFO if self._ending.is_set() else logging.ERROR, "%s", error)
        self.connected, self.error = False, str(error)
        moving = self.group.moving or bool(self.running())
        self.group.announce(StopReason("lost", f"the robot was lost: {error}"))
        self._fail_calls()
        # An arm whose lease was lost holds, or moves for another program, which must not be stopped by this one.
        if self._stop_on_failure and not isinstance(error, LeaseError):
            try:
                self.robot.stop()
            except HexwireError:
                self._owes_stop = moving and not self._borrowed
        self.group.settle()
        self._close_reader()
        if not self._borrowed:
            with suppress(HexwireError):
                self.robot.detach()
            # Last, when nothing can be sent: if the board did not receive the stop, its watchdog must stop the arm.
            with suppress(HexwireError):
                self._watched.close()

    def _wait(self, seconds: float) -> None:
        # The wait of an event costs several times a plain sleep, and this is asked for with every state.
        if 0.0 < seconds < _SHORT:
            time.sleep(seconds)
        else:
            self._ending.wait(seconds)

    def _fail_calls(self) -> None:
        self._calls.fail(LinkLostError(f"the robot cannot be reached: {self.error}"))

    def _check_reachable(self) -> None:
        if self.crash is not None:
            raise DeviceError(f"the program failed: {self.crash}")
        if not self.connected or self._ending.is_set():
            raise LinkLostError(f"the robot cannot be reached: {self.error or 'the program ends'}")

    def _close_reader(self) -> None:
        if self._reader is not None:
            self._reader.close()

    def _resets(self) -> int:
        return 0 if self._line is None else self._line.restarts

    def _see_restarts(self) -> None:
        """Stop after a reset of the board, which loses its stop latch; its servos may have been without power."""
        restarts = self._resets()
        if restarts == self._restarts:
            return
        self._restarts = restarts
        if self.group.busy or self.group.reason is not None:
            self._output.stop(StopReason("board", "the board was reset"))
        self.group.release("the board was reset")
        # A probe ends the reports.
        self._close_reader()
        self.probe = self.robot.probe()

    def _take(self, state: JointState) -> None:
        check_joints(state, self.robot.model)
        # First, since other programs wait for this.
        for observer in self.observers:
            observer(state)
        published = self._latest.take(state, self._clock())
        if published is not None:
            self._on_state(state, published)

    def _look_again(self) -> None:
        """Read a new state after a change; reports that are waiting are from before it, and are dropped."""
        state = self.robot.read()
        if self._reader is not None:
            self._reader.drop_waiting()
        self._take(state)
