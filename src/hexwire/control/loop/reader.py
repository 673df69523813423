"""Reads the states of a robot one after the other, from its reports if it sends them, else on request.

Owns the choice between the two, the rate, ending the reports, the check that no joint is missing, and how often a
joint that does not answer is asked again.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Generator, Iterable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

from hexwire.drivers.abilities import StateReports
from hexwire.errors import DeviceError, HexwireError, ServoError
from hexwire.motion.limits import resting_inside

from .loop import RateLoop

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.arm import ArmModel
    from hexwire.model.state import JointState

__all__ = [
    "StateReader",
    "check_joints",
    "position_unknown",
    "raise_if_silent",
    "read_known",
    "read_start",
    "read_state",
]

_SILENCE = 0.5
"""Seconds without a report after which the robot is pinged."""
_SLOW = 2.0
"""Seconds between two reports that include slowly changing values, which make reports long."""
_MIN_PERIOD = 0.005
_MAX_PERIOD = 0.25
"""Seconds between two reports: boards refuse shorter periods, and longer ones would delay noticing silence."""
_TRIES, _MOST_TRIES, _AGAIN, _PATIENCE = 4, 24, 0.025, 0.6
"""How often joints are asked before they are silent: a few times, and more often for so many seconds from the first
try, with a pause between two. That is longer than the half second after which a board asks a silent servo again."""


def check_joints(state: JointState, arm: ArmModel) -> JointState:
    """Return a state that has the joints of the arm, in its order.

    Raises:
        DeviceError: It has others: a value would be taken for that of another joint.
    """
    if state.names != arm.names:
        raise DeviceError(
            f"the robot reports the joints {', '.join(state.names) or '(none)'}, but {arm.name} has "
            f"{', '.join(arm.names)}; correct its driver"
        )
    return state


def read_state(robot: RobotDriver) -> JointState:
    """Read all joints of a robot.

    Raises:
        HexwireError: As `RobotDriver.read` and `check_joints`.
    """
    return check_joints(robot.read(), robot.model)


def read_known(
    robot: RobotDriver, joints: Collection[str] | None = None, *, sleep: Callable[[float], object] = time.sleep
) -> JointState:
    """Read all joints of a robot before a motion, a few times if one does not answer at once.

    A single missed answer, such as of an arm behind a busy computer, does not mean that a position is unknown.

    Args:
        robot: The robot.
        joints: Those that the motion depends on; all if None.
        sleep: Waits for a number of seconds.

    Returns:
        The newest state; joints that are silent in it have not answered for more than half a second.

    Raises:
        HexwireError: As `read_state`.
    """
    began, state = robot.now(), read_state(robot)
    for tried in range(1, _MOST_TRIES):
        if all(name not in state.silent for name in (state.names if joints is None else joints)):
            break
        if tried >= _TRIES and robot.now() - began > _PATIENCE:
            break
        sleep(_AGAIN)
        state = read_state(robot)
    return state


def read_start(robot: RobotDriver) -> dict[str, float]:
    """Where a motion may begin: radians by joint; one that rests on its stop is at its limit.

    Raises:
        ServoError: A joint does not answer.
        HexwireError: As `read_state`.
    """
    state = read_known(robot)
    if state.silent:
        raise ServoError(position_unknown(state.silent))
    return resting_inside(robot.model, state.positions)


def raise_if_silent(servos: Sequence[tuple[int, str | None]]) -> None:
    """Raise an error that names the servos (pairs of id and joint) that did not answer, if there are any."""
    if servos:
        names = ", ".join(f"{servo_id} ({joint})" if joint else f"{servo_id}" for servo_id, joint in servos)
        several = len(servos) > 1
        raise ServoError(
            f"servo{'s' if several else ''} {names} {'do' if several else 'does'} not answer: "
            "check cable, power and id",
            servo_id=servos[0][0],
        )


def position_unknown(joints: Iterable[str]) -> str:
    """Why nothing can be done that depends on where these joints are."""
    return f"the position of {', '.join(joints)} is unknown: no answer; check cable, power and id"


class StateReader:
    """Reads an attached robot. One thread only.

    Args:
        robot: The robot.
        rate: States per second, as far as the line allows.
        ask: Request every state, even if the robot could report it.
        read: Requests one; the robot's `read` if None.
        clock: Monotonic seconds.
        sleep: Waits for a number of seconds.

    Attributes:
        period: Seconds between two states.
        timing: The loop that requests states, if the robot does not report them.
    """

    def __init__(
        self,
        robot: RobotDriver,
        rate: float,
        *,
        ask: bool = False,
        read: Callable[[], JointState] | None = None,
        clock: Callable[[], float],
        sleep: Callable[[float], object],
    ) -> None:
        self._ask, self._clock, self._sleep = ask, clock, sleep
        self._set_rate(rate)
        self._robot = robot
        self._ask_for = read
        self._states: Generator[JointState, None, None] | None = None
        self._reports: StateReports | None = None

    def _set_rate(self, rate: float) -> None:
        self.period = 1.0 / rate if self._ask else min(max(1.0 / rate, _MIN_PERIOD), _MAX_PERIOD)
        self.timing = RateLoop(1.0 / self.period, clock=self._clock, sleep=self._sleep)

    def change_rate(self, rate: float) -> None:
        """Read at another rate, states per second, from the next state on."""
        self.close()
        self._set_rate(rate)

    def next(self) -> JointState | None:
        """The next state; None if the robot answers, but its reports have ended.

        Raises:
            HexwireError: As `RobotDriver.read`. Continue with `next`, or `close`.
        """
        if self._states is None:
            self._states = self._read()
        try:
            state = next(self._states, None)
        except HexwireError:
            self._states = None
            raise
        if state is None:
            self._states = None
        return state

    def drop_waiting(self) -> None:
        """Drop waiting reports: they are older than the last answer.

        Raises:
            LinkError: The line is lost.
        """
        if self._reports is not None:
            self._reports.discard_reports()

    def close(self) -> None:
        """End the robot's reports, if it can still be reached."""
        states, self._states = self._states, None
        if states is not None:
            with suppress(HexwireError):
                states.close()

    def _read(self) -> Generator[JointState, None, None]:
        self._reports = None if self._ask else StateReports.find(self._robot)
        if self._reports is not None:
            yield from self._reports.stream(self.period, _SILENCE, slow=_SLOW)
            return
        for _ in self.timing.ticks():
            yield self._robot.read() if self._ask_for is None else self._ask_for()
