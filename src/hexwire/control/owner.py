"""The one owner of a moving robot: it reads, lets the controllers decide, and writes.

Owns the order read-update-write, the watchdog while that goes on, and what happens when the robot fails: everything
stops and goals end. It runs in a thread of its own and reconnects, or in the caller's thread with a robot that is
the caller's. Must not know who asks, nor what is done with what it reports.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from typing import TYPE_CHECKING, Self, TypeVar

from hexwire.drivers.values import StopMode
from hexwire.errors import (
    DeviceError,
    HexwireError,
    LinkError,
    LinkLostError,
    LinkPermissionError,
    PreemptedError,
    ReplyTimeoutError,
    UsageError,
)
from hexwire.motion.safety import StopReason, board_stop

from .calls import QueuedCalls, voided_by_stop
from .group import ControllerGroup
from .newest import LatestState
from .output import Output
from .reader import StateReader
from .waiting import join_or_abort

if TYPE_CHECKING:
    from types import TracebackType

    from hexwire.drivers.base import ProbeReport, RobotDriver
    from hexwire.model.state import JointState, SentTarget

    from .group import Controller
    from .known_state import KnownState
    from .loop import RateLoop

__all__ = ["RobotOwner"]

_log = logging.getLogger(__name__)

_T = TypeVar("_T")

_RETRY = 0.5
"""Seconds between two tries to get a lost robot back."""
_PERIODS = 4.0
"""Periods in the time of the watchdog of a borrowed robot."""
_FEEDS = 4.0
"""States in the time of the watchdog: between them a driver tells the board that somebody is there."""
_FRESH = 1.0
"""Seconds that a state is good for as the start of a motion; on a slow line three targets' time."""
_SILENT = 0.5
"""Seconds that a silent joint is published for; on a slow line likewise."""
_PATIENCE, _PATIENCE_LOST = 5.0, 2.0
"""Seconds until the owner is hung up on at the end: with a robot, and while it looks for one."""


class RobotOwner:
    """A robot, and the one that alone reads and moves it.

    `connect` once, then `start` a thread or call `turn` oneself; `shutdown` at the end. Any thread may call the
    others.

    Args:
        robot: Not attached, unless it is borrowed.
        borrowed: The robot is attached, and stays so at the end. It is asked for a state before every target, and a
            failure stops the arm and comes out of `turn`. Else `connect` attaches it, it reports states by itself
            where it can, and it is looked for when it was lost.
        publish_rate: States a second; less where the line gives less.
        command_rate: Targets a second; what the robot's line takes if 0.
        watchdog: Seconds of silence after which the board stops by itself; 0 for never. More with a borrowed robot
            whose cycles are slow.
        watchdog_mode: What the board does then.
        stop_on_failure: Stop the arm when the robot fails or `shutdown` ends a motion; False for a caller who makes
            it safe by other means.
        on_state: Called with every new state and what is to be published of it, in the owner's thread.
        on_sent: Called with what was really sent, in the owner's thread.
        clock: Monotonic seconds; the robot's clock if None.
        sleep: Waits for so many seconds; until `shutdown` at the latest if None.

    Attributes:
        robot: As given.
        group: The controllers, which decide; `start` fills it.
        connected: The robot answers.
        error: Why not; empty if it does.
        reconnects: Number of reconnections.
        probe: What the robot said of itself when it was found last.
        crash: What ended the thread, if that was a fault of the program.
        observers: Called with every state, in the owner's thread.
    """

    def __init__(
        self,
        robot: RobotDriver,
        *,
        borrowed: bool = False,
        publish_rate: float = 100.0,
        command_rate: float = 0.0,
        watchdog: float = 1.0,
        watchdog_mode: StopMode = StopMode.HOLD,
        stop_on_failure: bool = True,
        on_state: Callable[[JointState, KnownState], object] = lambda state, published: None,
        on_sent: Callable[[SentTarget], object] = lambda sent: None,
        clock: Callable[[], float] | None = None,
        sleep: Callable[[float], object] | None = None,
    ) -> None:
        self.robot = robot
        self.group = ControllerGroup()
        self.connected = False
        self.error = "not connected yet"
        self.reconnects = 0
        self.probe: ProbeReport | None = None
        self.crash: BaseException | None = None
        self.observers: list[Callable[[JointState], object]] = []
        self._borrowed = borrowed
        self._publish_rate, self._command_rate = publish_rate, command_rate
        self._wanted_watchdog, self._watchdog_mode, self._watched = watchdog, watchdog_mode, ExitStack()
        self._stop_on_failure = stop_on_failure
        self._ending = threading.Event()
        self._on_state = on_state
        self._output = Output(robot, self.group, borrowed=borrowed, on_sent=on_sent, look_again=self._look_again)
        self._clock, self._sleep = clock or robot.now, sleep or self._ending.wait
        self._reader: StateReader | None = None
        self._restarts = 0
        self._latest = LatestState(publish_rate)
        self._calls = QueuedCalls()
        self._thread: threading.Thread | None = None
        # Whose turn it is: what this thread wants done is done at once.
        self._turning = 0
        if not borrowed:
            # Whoever owns a robot decides what a lost link means; one that reconnects by itself would hide it.
            robot.auto_reconnect(on=False)

    # -- coming and going ---------------------------------------------------------------------------

    def connect(self, timeout: float = 0.0) -> None:
        """Find the robot. Nothing moves.

        Args:
            timeout: Seconds to go on trying for, while there is no port or nobody answers.

        Raises:
            LinkError: The port cannot be opened.
            DeviceError: Nobody answers, or not what was expected.
        """
        self._turning = threading.get_ident()
        if self._borrowed and not self.connected:
            self._begin()
        deadline, said = self._clock() + timeout, ""
        while not self.connected:
            try:
                self._attach()
            except LinkPermissionError:
                raise
            except (LinkError, ReplyTimeoutError) as error:
                if self._clock() >= deadline or self._ending.is_set():
                    raise
                if said != (said := str(error)):
                    _log.info("%s; waiting for it", said)
                self._sleep(_RETRY)

    def start(self, controllers: Sequence[Controller]) -> None:
        """Run `turn` in a thread of its own until `shutdown`."""
        self.group.members = controllers
        self._thread = threading.Thread(target=self._run, name="owner", daemon=True)
        self._thread.start()

    def shutdown(self, *, torque_off: bool = False) -> None:
        """End the thread and let go of the robot: a motion under way is stopped, and stays stopped.

        Args:
            torque_off: Take the torque away; the arm may fall.
        """
        self._ending.set()
        moving = self.group.moving
        self.group.stop(StopReason("asked", "the program ends"))
        with suppress(HexwireError):
            if self.connected and moving and self._stop_on_failure:
                self.robot.stop()
        self._end_thread()
        self._calls.fail(LinkLostError("the program ends"))
        with suppress(HexwireError):
            if not self.alive:
                self._close_reader()
            if self.connected or self._borrowed:
                self._watched.close()
        if not self._borrowed:
            with suppress(HexwireError):
                self.robot.detach(torque_off=torque_off and self.connected)
        self.connected, self.error = False, "the program has ended"

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.shutdown()

    def _end_thread(self) -> None:
        patience = _PATIENCE if self.connected else _PATIENCE_LOST
        if self._thread is not None and not join_or_abort(self._thread, patience, self.robot.abort, _PATIENCE):
            _log.error("the owner's thread does not end")

    @property
    def alive(self) -> bool:
        """The thread runs."""
        return self._thread is not None and self._thread.is_alive()

    @property
    def command_period(self) -> float:
        """Seconds between two targets; known once the robot is connected."""
        return 1.0 / (self._command_rate or self.robot.command_rate)

    @property
    def lead(self) -> float:
        """Seconds ahead for which a target is sent: a period and a half, so that a late cycle is no pause."""
        return 1.5 * self.command_period

    @property
    def watchdog(self) -> float:
        """Seconds of silence after which the board stops the arm by itself; 0 where nothing is armed."""
        return self._wanted_watchdog if self.robot.watchdog_armed else 0.0

    @property
    def timing(self) -> RateLoop:
        """The loop behind the turns of a robot that is asked for its states.

        Raises:
            UsageError: There was no turn yet.
        """
        if self._reader is None:
            raise UsageError("there was no turn yet")
        return self._reader.timing

    @property
    def rate(self) -> float:
        """States a second that were published over the last while."""
        return self._latest.rate(self._clock())

    @property
    def state(self) -> JointState | None:
        """The newest state, or None."""
        return self._latest.state

    @property
    def state_age(self) -> float:
        """Seconds since a state came that could be published; infinite before the first."""
        return self._latest.age(self._clock())

    # -- what any thread may ask ----------------------------------------------------------------------

    def locked(self) -> threading.RLock:
        """The lock that guards the controllers. Never wait for anything under it."""
        return self.group.lock

    def now(self) -> float:
        """This clock, seconds."""
        return self._clock()

    def newest(self) -> JointState:
        """The newest state; what is to move may begin there.

        Raises:
            LinkLostError: The robot is not there.
            DeviceError: None came for too long.
        """
        self._check_reachable()
        state, age = self._latest.state, self._clock() - self._latest.heard
        if state is None or age > max(_FRESH, 3.0 * self.command_period):
            raise DeviceError(f"the robot has told nothing for {age:.1f} s; wait until it does")
        return state

    def hurry(self) -> None:
        """Let the next state lead to a target, if there was none for a period: something has begun."""
        self._output.hurry()

    def call(self, job: Callable[[], _T]) -> _T:
        """Have something done by the owner between two states, and wait for it.

        Raises:
            LinkLostError: The robot is not there.
            DeviceError: It was not done in time, or the owner is gone.
            HexwireError: What the job raised.
        """
        self._check_reachable()
        if threading.get_ident() == self._turning:
            return job()
        return self._calls.call(voided_by_stop(job, self.robot.epochs))

    def stop(self, why: str) -> tuple[str, ...]:
        """Latched stop, ahead of everything else; the joints hold.

        Returns:
            Names of the joints that confirmed it.

        Raises:
            HexwireError: The robot could not be told; the controllers are stopped all the same.
        """
        self.group.stop(StopReason("asked", why))
        if not self.connected:
            raise LinkLostError(f"the robot cannot be told: {self.error}")
        return self.robot.stop()

    def reset(self) -> None:
        """End a stop. Nothing moves by it.

        Raises:
            UsageError: What caused it is still there, or somebody stopped the arm meanwhile.
            HexwireError: The robot refuses.
        """
        stops = self.group.stops
        self.call(lambda: self._output.reset(stops))

    def torque(self, on: bool, names: Sequence[str]) -> tuple[str, ...]:
        """Torque on, where the joints are, or off; a motion of joints that had none ends, or that lose it.

        Returns:
            Names of the joints that confirmed it.

        Raises:
            HexwireError: Stopped, or the robot refuses.
        """
        return self.call(lambda: self._output.torque(on, names))

    # -- the owner's turn -------------------------------------------------------------------------------

    def turn(self) -> None:
        """One state and what follows from it, or one try to find a lost robot.

        Raises:
            HexwireError: A borrowed robot failed; it was told to stop, if it could be.
        """
        self._turning = threading.get_ident()
        if not self.connected:
            if self._borrowed:
                raise LinkLostError(self.error)
            self._find_again()
            return
        try:
            if self._reader is None:
                self._reader = self._begin_reading()
            state = self._reader.next()
            if state is not None:
                self._take(state)
                if not self._borrowed:
                    self._see_restarts()
                self._output.update(
                    state, self._latest.speeds(state.names), self._clock(), self.command_period, self.lead
                )
            self._calls.run()
        except PreemptedError:
            # A stop took the line from what waited there: no failure, and whoever stopped sees to the rest.
            self._close_reader()
        except HexwireError as error:
            self._lose(error)
            if self._borrowed:
                raise

    def _run(self) -> None:
        try:
            while not self._ending.is_set():
                self.turn()
        except BaseException as error:  # noqa: BLE001  # handed on in `crash`
            # A fault of the program: whoever watches this thread must hear of it, and the arm must not go on.
            _log.exception("the owner's thread failed")
            self.crash = error
            self.group.stop(StopReason("lost", f"the program failed: {error}"))
            self._calls.fail(DeviceError(f"the program failed: {error}"))
            with suppress(HexwireError):
                self.robot.stop()

    def _attach(self) -> None:
        self.robot.attach()
        try:
            probe = self.robot.probe()
            if self.probe is not None and not probe.same_kind(self.probe):
                # What the arm may be told how often, and when it counts as lost, is of the one that was there.
                raise DeviceError(
                    f"a board of dialect {probe.dialect} is there, where one of dialect {self.probe.dialect} was; "
                    "plug that in again, or start the node anew"
                )
            state = self.robot.read()
            self.probe = probe
        except BaseException:
            with suppress(HexwireError):
                self.robot.detach()
            raise
        self._begin()
        self._take(state)

    def _begin(self) -> None:
        self._latest.begin(1.0 / self._publish_rate, max(_SILENT, 3.0 * self.command_period))
        self._reader, self.connected, self.error = None, True, ""

    def _begin_reading(self) -> StateReader:
        # First, since arming a watchdog makes the board forget that it tripped.
        if self.state is not None and (found := board_stop(self.state)) is not None:
            self.group.stop(found)
            self._output.tell(logging.WARNING, "%s; reset it before it is to move", found)
        # Only now: between `connect` and the first turn nobody feeds a watchdog.
        self._arm_watchdog()
        rate = 1.0 / self.command_period
        if not self._borrowed:
            # Every target needs a state, however seldom states are published.
            rate = max(self._publish_rate, rate, _FEEDS / self.watchdog if self.watchdog else 0.0)
        reader = StateReader(self.robot, rate, ask=self._borrowed, clock=self._clock, sleep=self._sleep)
        self._latest.begin(reader.period, max(_SILENT, 3.0 * self.command_period))
        self._restarts = self.robot.restarts
        return reader

    def _arm_watchdog(self) -> None:
        if self._borrowed and self._wanted_watchdog:
            self._wanted_watchdog = max(self._wanted_watchdog, _PERIODS * self.command_period)
        if self._wanted_watchdog:
            # Whoever borrows a robot may leave a stop to be looked into; an owner for good has just noted it.
            watched = self.robot.watched(self._wanted_watchdog, self._watchdog_mode, always=not self._borrowed)
            self._watched.enter_context(watched)

    def _find_again(self) -> None:
        self._fail_calls()
        try:
            self._attach()
        except HexwireError as error:
            self.error = str(error)
            self._fail_calls()
            self._sleep(_RETRY)
        else:
            self.reconnects += 1
            _log.warning("the robot is back")

    def _lose(self, error: HexwireError) -> None:
        # At the end of everything an emulated board ends as well.
        self._output.tell(logging.INFO if self._ending.is_set() else logging.ERROR, "%s", error)
        self.connected, self.error = False, str(error)
        self.group.stop(StopReason("lost", f"the robot was lost: {error}"))
        self._fail_calls()
        if self._stop_on_failure:
            with suppress(HexwireError):
                self.robot.stop()
        self._close_reader()
        if not self._borrowed:
            with suppress(HexwireError):
                self.robot.detach()
            # Only now, when nothing can be sent any more: a board that did not hear the stop must stop by itself.
            with suppress(HexwireError):
                self._watched.close()

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

    def _see_restarts(self) -> None:
        """A board that was reset has forgotten its stop, and its servos may have been without power."""
        restarts = self.robot.restarts
        if restarts == self._restarts:
            return
        self._restarts = restarts
        if self.group.busy or self.group.reason is not None:
            self._output.stop(StopReason("board", "the board was reset"))
        self.group.release("the board was reset")
        # A probe ends reports.
        self._close_reader()
        self.probe = self.robot.probe()

    def _take(self, state: JointState) -> None:
        published = self._latest.take(state, self._clock())
        for observer in self.observers:
            observer(state)
        if published is not None:
            self._on_state(state, published)

    def _look_again(self) -> None:
        """Something was done: what waits to be read tells of a time before it, and must not be believed."""
        state = self.robot.read()
        if self._reader is not None:
            self._reader.drop_waiting()
        self._take(state)

    def deliver(self) -> None:
        """Tell goals that have ended so; after every change from outside."""
        self.group.deliver()
