"""How one motion of a program is run and checked, and who is told of its events.

Owns these values.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hexwire.arguments import FLAG, SECONDS, Wanted, check, one_of, or_none
from hexwire.drivers.abilities import Watchdog
from hexwire.drivers.values import StopMode
from hexwire.errors import UsageError
from hexwire.motion.safety import SafetyLimits, StopReason

from ..loop.loop import RateLoop, check_rate
from .arrival import Tolerance
from .path_check import PathCheck

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.state import JointState, SentTarget

    from .motion_result import MotionResult
    from .path_check import CheckedPath

__all__ = ["MotionObserver", "MotionOptions", "unwatched_words", "wanted_options"]

_log = logging.getLogger(__name__)

_NUMBER = Wanted(
    "a number", lambda value: isinstance(value, int | float) and not isinstance(value, bool), SECONDS.plain
)
_CALLED = Wanted("something to call, as in time.sleep", callable)
_WANTED = {
    **dict.fromkeys(("check_geometry", "early", "host_timed", "outlives"), FLAG),
    **dict.fromkeys(("tolerance", "standing", "grace", "rate", "watchdog"), _NUMBER),
    "table": or_none(_NUMBER),
    "limits": or_none(one_of(SafetyLimits)),
    "watchdog_mode": one_of(StopMode),
    "clock": or_none(_CALLED),
    "sleep": _CALLED,
}


@dataclass(frozen=True, slots=True)
class MotionOptions:
    """How a motion is run and checked. Angles are in radians, times in seconds, lengths in metres.

    Attributes:
        check_geometry: Check the path against the joint coupling limits and the table with the robot's
            `kinematics`. Of an arm without a known geometry, neither can be checked.
        table: Height of the table above the base; None for no table.
        tolerance: Position tolerance of each joint at the goal.
        standing: Velocity below which a joint counts as stopped, required at the goal; 0 is not checked.
        grace: Seconds after the motion's duration in which the joints must arrive.
        early: A single target may count as reached before its duration is over.
        rate: Cycles per second; 0 for the rate that the robot allows.
        limits: Thresholds that stop a trajectory; None for the defaults at this rate.
        watchdog: Seconds of silence after which the board stops the arm; longer at a slow rate.
        watchdog_mode: What the board does then.
        clock: Monotonic seconds; the robot's clock if None.
        sleep: Waits for a number of seconds.
        host_timed: Send a trajectory target by target, also to a robot that executes trajectories itself.
        outlives: Once all of a trajectory has been sent to such a robot, the watchdog lets it finish.

    Raises:
        UsageError: A value is not a number, or outside its range.
    """

    check_geometry: bool = True
    table: float | None = 0.0
    tolerance: float = math.radians(1.5)
    standing: float = 0.0
    grace: float = 3.0
    early: bool = True
    rate: float = 0.0
    limits: SafetyLimits | None = None
    watchdog: float = 1.0
    watchdog_mode: StopMode = StopMode.HOLD
    clock: Callable[[], float] | None = None
    sleep: Callable[[float], object] = time.sleep
    host_timed: bool = False
    outlives: bool = False

    def __post_init__(self) -> None:
        for name, wanted in _WANTED.items():
            check("MotionOptions", name, wanted, getattr(self, name))
        # To the check of arrival, a tolerance of 0 means "not checked", and a grace of 0 means "forever".
        for name in ("tolerance", "grace"):
            if not 0.0 < (value := getattr(self, name)) < math.inf:
                raise UsageError(f"{name} must be finite and above 0, not {value:g}")
        for name in ("standing", "watchdog"):
            if not 0.0 <= (value := getattr(self, name)) < math.inf:
                raise UsageError(f"{name} must be finite and not below 0, not {value:g}")
        if self.table is not None and not math.isfinite(self.table):
            raise UsageError(f"table must be finite, not {self.table:g}")
        if self.rate != 0.0:
            check_rate(self.rate)

    def checks(self, robot: RobotDriver) -> PathCheck:
        """The checks of a robot's path."""
        return PathCheck.of(robot, self.table) if self.check_geometry else PathCheck.limits_only(robot.model)

    def goal(self, names: Sequence[str]) -> dict[str, Tolerance]:
        """Tolerances of joints at the goal."""
        return dict.fromkeys(names, Tolerance(self.tolerance, self.standing))


def wanted_options(options: object) -> MotionOptions:
    """The options, if they are some.

    Raises:
        UsageError: They are something else.
    """
    if not isinstance(options, MotionOptions):
        raise UsageError(f"options are MotionOptions, as in MotionOptions(table=None); this is {options!r}")
    return options


def unwatched_words(robot: RobotDriver, seconds: float) -> str:
    """That nothing stops the arm if this program, or the server of a shared arm, dies.

    Args:
        robot: The arm.
        seconds: How long it then moves on.
    """
    where, dies = ("at its server", "its server") if robot.can(Watchdog) else ("on this port", "this program")
    return (
        f"{robot.model.name} has no watchdog {where}: if {dies} dies, the arm moves on to its last target, "
        f"for up to {seconds:.2g} s"
    )


class MotionObserver:
    """Is called at the events of a motion, in the caller's thread. Override the methods you need.

    They do nothing here, but for `refused`, which logs a warning, and `noted`, which logs.
    """

    def planned(self, path: CheckedPath) -> None:
        """A verb of an arm has checked its path; nothing has moved yet."""

    def step(self, number: str) -> None:
        """A step of a program begins; `number` as in `Program.run_from`."""

    def checked(self, number: str, path: CheckedPath) -> None:
        """The path of a step of a program was checked, before any of them begins."""

    def powered(self, joints: Sequence[str]) -> None:
        """Torque was switched on for these joints."""

    def switched(self, joints: Sequence[str], confirmed: Sequence[str]) -> None:
        """A verb has switched the torque of joints, and some have confirmed it; it then raises if not all have."""

    def unwatched(self, seconds: float) -> None:
        """There is no watchdog: if this program dies, the arm moves on for up to this many seconds."""

    def sent(self, sent: SentTarget) -> None:
        """A target was sent, or its first step."""

    def refused(self, why: str) -> None:
        """The board does not follow the trajectory in its own time; targets are sent one by one instead."""
        _log.warning("targets are sent one by one, since the board does not follow this path itself: %s", why)

    def noted(self, said: str | StopReason) -> None:
        """What an operator must know who guides the arm, such as that it has met its leader."""
        _log.info("%s", said)

    def started(self, timing: RateLoop) -> None:
        """The motion starts; `timing` has the timing of its cycles."""

    def seen(self, state: JointState) -> None:
        """A state was read during the motion."""

    def ended(self, result: MotionResult) -> None:
        """The motion of a verb has ended; it then raises what a person must know of one that has not arrived."""
