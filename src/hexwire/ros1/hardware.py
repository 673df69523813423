"""The one owner of a robot while a node runs: it reads, lets the controllers decide, writes, and reconnects.

Owns the thread, the order read-update-write, and what happens when the robot fails: everything stops, goals end,
and the robot is looked for until it is back. Must not know ROS, nor what is done with what it reports.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, TypeVar

from hexwire.drivers.base import StopMode
from hexwire.errors import (
    CommandRefusedError,
    HexwireError,
    LinkError,
    LinkLostError,
    LinkPermissionError,
    NotSupportedError,
    PreemptedError,
    StoppedError,
    UsageError,
)
from hexwire.model.state import JointFlag, JointTarget
from hexwire.motion.loop import RateLoop
from hexwire.motion.safety import StopReason
from hexwire.session.policy import ReconnectPolicy

from .jobs import Jobs
from .states import StateFilter

if TYPE_CHECKING:
    from hexwire.drivers.base import ProbeReport, RobotDriver
    from hexwire.model.state import JointState

    from .controller import TrajectoryController
    from .states import PublishedState

__all__ = ["Hardware"]

_log = logging.getLogger(__name__)

_T = TypeVar("_T")

_RETRY = 0.5
"""Seconds between two tries to get a lost robot back."""
_SILENCE = 0.5
"""Seconds without a report after which the robot is asked whether it is there."""
_RATE_WINDOW = 2.0
_JOIN_TIMEOUT = 5.0


class Hardware:
    """A robot, and the thread that alone reads and moves it.

    `connect` once, then `start` or call `turn` oneself; `shutdown` at the end. Any thread may call the others.

    Args:
        robot: Not attached.
        publish_rate: States a second; less where the line gives less.
        command_rate: Targets a second; what the robot's line takes if 0.
        watchdog: Seconds of silence after which the board stops by itself; 0 for never.
        on_state: Called with every new state and what is to be published of it, in the owner's thread.
        clock: Monotonic seconds.
        sleep: Waits for so many seconds.

    Attributes:
        robot: As given.
        controllers: What decides; set by `start`.
        connected: The robot answers.
        error: Why not; empty if it does.
        reconnects: How often it was back.
        probe: What the robot said of itself when it was found last.
        state: The newest state, or None.
        watchdog: In force, seconds; 0 where there is none.
        crash: What ended the thread, if that was a fault of the program.
    """

    def __init__(
        self,
        robot: RobotDriver,
        *,
        publish_rate: float = 100.0,
        command_rate: float = 0.0,
        watchdog: float = 1.0,
        on_state: Callable[[JointState, PublishedState], object] = lambda state, published: None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], object] = time.sleep,
    ) -> None:
        self.robot = robot
        self.controllers: Sequence[TrajectoryController] = ()
        self.connected = False
        self.error = "not connected yet"
        self.reconnects = 0
        self.probe: ProbeReport | None = None
        self.state: JointState | None = None
        self.watchdog = 0.0
        self.crash: BaseException | None = None
        self.observers: list[Callable[[JointState], object]] = []
        self._publish_rate, self._command_rate, self._wanted_watchdog = publish_rate, command_rate, watchdog
        self._on_state, self._clock, self._sleep = on_state, clock, sleep
        self._lock = threading.RLock()
        self._filter = StateFilter()
        self._speeds: dict[str, float] = {}
        self._states: Iterator[JointState] | None = None
        self._published: deque[float] = deque()
        self._due = -math.inf
        self._jobs = Jobs()
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None
        # Whoever owns a robot decides what a lost link means; a session that reconnects by itself would hide it.
        for session in robot.sessions:
            session.reconnect = ReconnectPolicy(enabled=False)

    # -- coming and going ---------------------------------------------------------------------------

    def connect(self, timeout: float = 0.0) -> None:
        """Find the robot. Nothing moves.

        Args:
            timeout: Seconds to wait for a port that is not there yet.

        Raises:
            LinkError: The port cannot be opened.
            DeviceError: Nobody answers, or not what was expected.
        """
        deadline = self._clock() + timeout
        while True:
            try:
                self._attach()
            except LinkPermissionError:
                raise
            except LinkError as error:
                if self._clock() >= deadline or self._ending.is_set():
                    raise
                _log.info("%s; waiting for it", error)
                self._sleep(_RETRY)
            else:
                return

    def start(self, controllers: Sequence[TrajectoryController]) -> None:
        """Run `turn` in a thread of its own until `shutdown`."""
        self.controllers = controllers
        self._thread = threading.Thread(target=self._run, name="hardware", daemon=True)
        self._thread.start()

    def shutdown(self, *, torque_off: bool = False) -> None:
        """End the thread and let go of the robot: a motion under way is stopped, and stays stopped.

        Args:
            torque_off: Take the torque away; the arm may fall.
        """
        self._ending.set()
        thread = self._thread
        if thread is not None:
            thread.join(_JOIN_TIMEOUT)
            if thread.is_alive():
                # It waits for a robot that does not answer.
                self.robot.session.close()
                thread.join(_JOIN_TIMEOUT)
        reason = StopReason("asked", "the node ends")
        with self._lock:
            moving = any(not controller.follower.done for controller in self.controllers)
            for controller in self.controllers:
                controller.stop(reason)
        self._deliver()
        self._jobs.fail(LinkLostError("the node ends"))
        with suppress(HexwireError):
            if self.connected and moving:
                self.robot.stop()
        self._close_states()
        with suppress(HexwireError):
            if self.connected and self.watchdog:
                self._arm_watchdog(0.0)
        with suppress(HexwireError):
            self.robot.detach(torque_off=torque_off and self.connected)
        self.connected = False

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
    def rate(self) -> float:
        """States a second over the last while."""
        now = self._clock()
        with self._lock:
            while self._published and self._published[0] < now - _RATE_WINDOW:
                self._published.popleft()
            count = len(self._published)
            if count < 2:
                return 0.0
            return (count - 1) / max(self._published[-1] - self._published[0], 1e-9)

    @property
    def state_age(self) -> float:
        """Seconds since a state came; infinite before the first."""
        with self._lock:
            return self._clock() - self._published[-1] if self._published else math.inf

    # -- what any thread may ask ----------------------------------------------------------------------

    def locked(self) -> threading.RLock:
        """The lock that guards the controllers. Never wait for anything under it."""
        return self._lock

    def now(self) -> float:
        """This clock, seconds."""
        return self._clock()

    def newest(self) -> JointState:
        """The newest state.

        Raises:
            LinkLostError: The robot is not there.
        """
        if not self.connected or self.state is None:
            raise LinkLostError(f"the robot cannot be reached: {self.error}")
        return self.state

    def hurry(self) -> None:
        """Let the next state lead to a target, without waiting for the next one due."""
        self._due = -math.inf

    def call(self, job: Callable[[], _T]) -> _T:
        """Have something done by the owner between two states, and wait for it.

        Raises:
            LinkLostError: The robot is not there.
            DeviceError: It was not done in time.
            HexwireError: What the job raised.
        """
        if threading.current_thread() is self._thread:
            return job()
        self.newest()
        return self._jobs.call(job)

    def stop(self, why: str, mode: StopMode = StopMode.HOLD) -> tuple[str, ...]:
        """Latched stop, ahead of everything else.

        Returns:
            Names of the joints that confirmed it.

        Raises:
            HexwireError: The robot could not be told; the controllers are stopped all the same.
        """
        self._stop_controllers(StopReason("asked", why))
        if not self.connected:
            raise LinkLostError(f"the robot cannot be told: {self.error}")
        return self.robot.stop(mode)

    def reset(self) -> None:
        """End a stop. Nothing moves by it.

        Raises:
            UsageError: What caused it is still there.
            HexwireError: The robot refuses.
        """
        self.call(self._reset)

    def torque(self, on: bool, names: Sequence[str]) -> tuple[str, ...]:
        """Torque on, where the joints are, or off; a motion under way ends.

        Returns:
            Names of the joints that confirmed it.

        Raises:
            HexwireError: Stopped, or the robot refuses.
        """

        def job() -> tuple[str, ...]:
            if on and any(controller.follower.reason for controller in self.controllers):
                raise UsageError("the arm is stopped; reset it first")
            if not on:
                self._release("the torque was taken away")
            whole = len(names) == len(self.robot.model.names)
            confirmed = self.robot.torque(on, None if whole else names)
            if not any(controller.busy for controller in self.controllers):
                # A hand may have moved the arm since the last command.
                self._release("")
            # The next goal must see it.
            self._take(self.robot.read())
            return confirmed

        return self.call(job)

    # -- the owner's turn -------------------------------------------------------------------------------

    def turn(self) -> None:
        """One state and what follows from it, or one try to find a lost robot."""
        if not self.connected:
            self._find_again()
            return
        try:
            if self._states is None:
                self._states = self._read_states()
            state = next(self._states, None)
            if state is None:
                # The robot is there, but its reports stayed away.
                self._states = None
            else:
                self._take(state)
                self._update(state)
            self._jobs.run()
        except PreemptedError:
            # A stop took the line from what waited there: no failure, and whoever stopped has seen to the rest.
            self._states = None
        except HexwireError as error:
            self._lose(error)

    def _run(self) -> None:
        try:
            while not self._ending.is_set():
                self.turn()
        except BaseException as error:  # noqa: BLE001  # handed on in `crash`
            # A fault of the program: whoever watches this thread must hear of it, and the arm must not go on.
            _log.exception("the hardware thread failed")
            self.crash = error
            self._stop_controllers(StopReason("lost", f"the node failed: {error}"))
            with suppress(HexwireError):
                self.robot.stop()

    def _attach(self) -> None:
        self.robot.attach()
        try:
            self.probe = self.robot.probe()
            self.watchdog = 0.0
            if self._wanted_watchdog:
                self._arm_watchdog(self._wanted_watchdog)
            state = self.robot.read()
        except BaseException:
            with suppress(HexwireError):
                self.robot.detach()
            raise
        self._filter = StateFilter(max_age=max(0.5, 3.0 * self.command_period))
        self.connected, self.error = True, ""
        self._take(state)

    def _arm_watchdog(self, seconds: float) -> None:
        watchdog = getattr(self.robot, "watchdog", None)
        if watchdog is not None:
            with suppress(NotSupportedError):
                watchdog(seconds)
                self.watchdog = seconds

    def _find_again(self) -> None:
        try:
            self._attach()
        except HexwireError as error:
            self.error = str(error)
            self._jobs.fail(LinkLostError(f"the robot cannot be reached: {self.error}"))
            self._ending.wait(_RETRY)
        else:
            self.reconnects += 1
            _log.warning("the robot is back")

    def _lose(self, error: HexwireError) -> None:
        _log.error("%s", error)
        self.connected, self.error = False, str(error)
        self._stop_controllers(StopReason("lost", f"the robot was lost: {error}"))
        self._states = None
        with suppress(HexwireError):
            self.robot.stop()
        with suppress(HexwireError):
            self.robot.detach()
        self._jobs.fail(LinkLostError(f"the robot cannot be reached: {self.error}"))

    def _read_states(self) -> Iterator[JointState]:
        period = 1.0 / self._publish_rate
        stream = getattr(self.robot, "stream", None)
        if stream is not None:
            try:
                yield from stream(period, _SILENCE)
                return
            except NotSupportedError:
                pass
        for _ in RateLoop(self._publish_rate, clock=self._clock, sleep=self._sleep).ticks():
            yield self.robot.read()

    def _close_states(self) -> None:
        states, self._states = self._states, None
        if states is not None:
            with suppress(HexwireError):
                states.close()  # type: ignore[attr-defined]  # a generator

    def _take(self, state: JointState) -> None:
        with self._lock:
            self.state = state
            published = self._filter.take(state)
            if published is not None:
                self._published.append(self._clock())
                self._speeds = dict(zip(published.names, published.velocity, strict=True))
        for observer in self.observers:
            observer(state)
        if published is not None:
            self._on_state(state, published)

    def _update(self, state: JointState) -> None:
        """Judge at every state, decide and write at the raster of commands."""
        now = self._clock()
        due = now >= self._due
        orders: list[JointTarget | StopReason | None] = []
        with self._lock:
            speeds = [self._speeds.get(name, math.nan) for name in state.names]
            for controller in self.controllers:
                controller.judge(state, speeds, now)
                if due:
                    orders.append(controller.cycle(state, now, self.lead))
        if due:
            period = self.command_period
            self._due = self._due + period if now < self._due + period else now + period
        reason = next((order for order in orders if isinstance(order, StopReason)), None)
        targets = [pair for order in orders if isinstance(order, JointTarget) for pair in order.positions]
        if reason is not None:
            _log.error("stopped: %s", reason)
            self._stop_controllers(reason)
            self.robot.stop()
        elif targets:
            self._write(JointTarget(tuple(targets), self.lead))
        self._deliver()

    def _write(self, target: JointTarget) -> None:
        try:
            self.robot.write(target)
        except StoppedError:
            self._stop_controllers(StopReason("board", "the board has stopped the arm"))
        except (CommandRefusedError, UsageError) as error:
            # As when somebody else took the torque: this motion is over, and what was commanded means nothing now.
            _log.error("%s", error)
            self._release(str(error))

    def _reset(self) -> None:
        state = self.robot.read()
        faults = {joint.name: JointFlag(joint.flags).faults for joint in state if JointFlag(joint.flags).faults}
        for controller in self.controllers:
            reason = controller.follower.reason
            if reason is not None and reason.joint in faults:
                raise UsageError(f"{reason.joint} still reports {faults[reason.joint]}; see to it first")
        self.robot.resume()
        with self._lock:
            for controller in self.controllers:
                controller.reset()
        self._take(self.robot.read())

    def _stop_controllers(self, reason: StopReason) -> None:
        with self._lock:
            for controller in self.controllers:
                controller.stop(reason)
        self._deliver()

    def _release(self, why: str) -> None:
        with self._lock:
            for controller in self.controllers:
                controller.release(why)
        self._deliver()

    def _deliver(self) -> None:
        """Tell goals how they ended; never under the lock, since who is told may take locks of its own."""
        with self._lock:
            ended = [row for controller in self.controllers for row in controller.take_ended()]
        for goal, end in ended:
            goal.ended(end)

    def deliver(self) -> None:
        """Tell goals that have ended so; after every change from outside."""
        self._deliver()
