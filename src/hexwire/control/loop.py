"""A loop at a fixed rate, on absolute deadlines; and the one that moves a robot by it.

Owns when the next cycle is due and how well that was kept, and the order read, update, write. The one place of
`motion` that knows a clock; must not know what is decided in a cycle.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from hexwire.errors import HexwireError, StoppedError, UsageError
from hexwire.model.state import LONGEST
from hexwire.motion.safety import StopReason, board_stop

_SILENCE, _SILENT_PERIODS = 1.0, 4.0
"""Seconds, and periods, without a word after which the board stops the arm by itself."""
_FASTEST = 10_000.0
"""Cycles a second that no machine does."""

if TYPE_CHECKING:
    from hexwire.model.state import JointState, JointTarget
    from hexwire.motion.follower import Follower
    from hexwire.motion.waypoints import Trajectory

__all__ = ["LoopCounters", "MotionLoop", "RateLoop", "Robot"]


@dataclass(slots=True)
class LoopCounters:
    """How a loop kept its time.

    Attributes:
        cycles: Cycles that were started.
        late: Cycles that started after their deadline by more than `RateLoop.tolerance`.
        skipped: Deadlines that were passed over because a cycle took longer than a period.
        worst: Longest delay behind a deadline, seconds.
        late_by: Delays of the late cycles together, seconds.
    """

    cycles: int = 0
    late: int = 0
    skipped: int = 0
    worst: float = 0.0
    late_by: float = 0.0


class RateLoop:
    """Start cycles at multiples of a period after the first; errors do not add up.

    A cycle that overruns its period is not made up for in a burst, which would send set-points faster than the
    arm was promised: the deadlines it ran over are skipped and counted, and the loop stays on its raster.

    Args:
        rate: Cycles a second.
        clock: Monotonic seconds.
        sleep: Waits for so many seconds.
        tolerance: Seconds behind its deadline from which a cycle counts as late; a tenth of the period if None.

    Attributes:
        period: Seconds.
        counters: Kept up to date while it runs.
    """

    def __init__(
        self,
        rate: float,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], object] = time.sleep,
        tolerance: float | None = None,
    ) -> None:
        if not 1 / LONGEST <= rate <= _FASTEST:
            raise UsageError(f"a rate of {rate:g} Hz makes no sense; it is at most {_FASTEST:g} Hz")
        self.period = 1.0 / rate
        self.tolerance = 0.1 * self.period if tolerance is None else tolerance
        self.counters = LoopCounters()
        self._clock = clock
        self._sleep = sleep
        self._started = math.nan
        self._last = math.nan

    def ticks(self, duration: float = math.inf) -> Iterator[float]:
        """Yield at every deadline the seconds from the first cycle to that deadline.

        What is yielded is the raster, not the clock: a trajectory sampled with it is as smooth as planned even if
        a cycle starts a little late.

        Args:
            duration: No cycle is started from this time on; the last one still has its period to end.
        """
        counters = self.counters
        # A hair less, so that 0.3 s of 0.1 s periods are three cycles and not four.
        cycles = duration / self.period - 1e-6
        self._started = start = self._clock()
        tick = 0
        while tick < cycles:
            due = tick * self.period
            delay = self._wait_until(start + due)
            self._last = start + due + delay
            counters.cycles += 1
            counters.worst = max(counters.worst, delay)
            if delay > self.tolerance:
                counters.late += 1
                counters.late_by += delay
            yield due
            # The next deadline that is not over; a cycle that ends within the tolerance is only late.
            behind = self._clock() - start - self.tolerance
            following = max(tick + 1, math.ceil(behind / self.period))
            counters.skipped += following - tick - 1
            tick = following
        if math.isfinite(duration):
            self._wait_until(start + duration)

    @property
    def achieved(self) -> float:
        """Cycles a second from the start of the first to the start of the last; 0 before there were two."""
        elapsed = self._last - self._started
        return (self.counters.cycles - 1) / elapsed if elapsed > 0 else 0.0

    def _wait_until(self, deadline: float) -> float:
        """Sleep until a deadline; returns how late it is then, seconds."""
        while (left := deadline - self._clock()) > 0:
            self._sleep(left)
        return -left


class Robot(Protocol):
    """What a motion loop needs of a robot; every driver has it.

    Drivers also have `watched` and `epochs`, which a loop uses where they are there.
    """

    def read(self) -> JointState:
        """Read all joints."""

    def write(self, target: JointTarget) -> object:
        """Send joints to a target."""

    def stop(self) -> object:
        """Latched stop, from any thread."""


class MotionLoop:
    """Read, update, write at a fixed rate: the one owner of a robot in motion.

    One thread calls `run`. Any thread may call the others. While it runs, the board's watchdog stands by where
    there is one: if the program dies, or stalls for a second or four periods, the board stops the arm. What was
    asked for before a stop of the robot is not sent after it, even if it was resumed between two cycles.

    Args:
        robot: An attached robot.
        follower: What decides.
        rate: Cycles a second.
        lead: Seconds that a target is sent ahead; one period and a half if None, so that a late cycle is no pause.
        clock: Monotonic seconds.
        sleep: Waits for so many seconds.

    Attributes:
        timing: The loop's `RateLoop`, with its counters.
        state: The state read last, or None.
    """

    def __init__(
        self,
        robot: Robot,
        follower: Follower,
        rate: float = 20.0,
        *,
        lead: float | None = None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], object] = time.sleep,
    ) -> None:
        self.robot = robot
        self.follower = follower
        self.timing = RateLoop(rate, clock=clock, sleep=sleep)
        self.lead = 1.5 * self.timing.period if lead is None else lead
        self.state: JointState | None = None
        self._clock = clock
        self._lock = threading.Lock()
        self._epochs = getattr(robot, "epochs", None)
        self._asked = self._mark()

    def _mark(self) -> Any:
        return None if self._epochs is None else self._epochs.mark()

    def follow(self, trajectory: Trajectory) -> None:
        """Follow a trajectory; see `Follower.follow`."""
        asked = self._mark()
        with self._lock:
            self.follower.follow(trajectory, self._clock())
            self._asked = asked

    def set_point(self, positions: Mapping[str, float]) -> None:
        """Pursue a set-point; see `Follower.set_point`."""
        asked = self._mark()
        with self._lock:
            self.follower.set_point(positions, self._clock())
            self._asked = asked

    def hold(self) -> None:
        """Stay where the last command was."""
        with self._lock:
            self.follower.hold()

    def emergency_stop(self, why: str = "emergency stop") -> None:
        """Latch a stop and tell the robot at once, ahead of whatever the loop waits for."""
        with self._lock:
            self.follower.stop(why)
        self.robot.stop()

    def cycle(self) -> None:
        """One cycle: read, update, write.

        Raises:
            HexwireError: The robot failed; the follower is stopped and the robot was told so, if it could be.
        """
        try:
            state = self.robot.read()
            with self._lock:
                self.state = state
                order = self.follower.cycle(state, self._clock(), self.lead)
            if isinstance(order, StopReason):
                self.robot.stop()
            elif order is not None:
                self._write(order)
        except HexwireError as error:
            with self._lock:
                self.follower.stop(StopReason("lost", f"the robot failed: {error}"))
            with suppress(HexwireError):
                self.robot.stop()
            raise

    def _write(self, order: JointTarget) -> None:
        try:
            with nullcontext() if self._epochs is None else self._epochs.using(self._asked):
                self.robot.write(order)
        except StoppedError as error:
            # Stopped from elsewhere since it was asked for: that is no failure.
            found = board_stop(self.robot.read()) or StopReason("board", str(error))
            with self._lock:
                self.follower.stop(found)

    def run(
        self,
        duration: float = math.inf,
        *,
        until_done: bool = False,
        each: Callable[[JointState], object] | None = None,
    ) -> StopReason | None:
        """Run cycles.

        Args:
            duration: Seconds.
            until_done: End when nothing is followed any more.
            each: Called with every state, in this thread.

        Returns:
            Why the arm was stopped, or None if it was not.

        Raises:
            HexwireError: As `cycle`.
        """
        watched = getattr(self.robot, "watched", None)
        silence = max(_SILENCE, _SILENT_PERIODS * self.timing.period)
        with nullcontext() if watched is None else watched(silence):
            for _ in self.timing.ticks(duration):
                self.cycle()
                if each is not None and self.state is not None:
                    each(self.state)
                if self.follower.reason is not None or (until_done and self.follower.done):
                    break
        return self.follower.reason
