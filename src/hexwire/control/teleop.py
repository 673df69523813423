"""Teleoperation: turns the axes of a joystick into one target per cycle.

Owns the controller, and that the arm holds when the button is released and at the end. Must not know devices or
threads, nor the rules that make a motion safe.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, NoReturn

from hexwire.errors import HexwireError, LeaseError
from hexwire.model.state import JointTarget
from hexwire.motion.safety import StopReason, board_stop
from hexwire.motion.teleop import Action, within_limits

from .loop import check_rate
from .owner import RobotOwner
from .target import holding

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.state import JointState
    from hexwire.motion.teleop import Teleop

    from .outcomes import Ended, GoalListener

__all__ = ["OVERLAP", "Stick", "TeleopController", "hold_at_end", "run_teleop"]

Stick = Callable[[], tuple[Sequence[float], int, float]]
"""Returns the newest axes (-1..1), buttons (bit i is button i) and their age in seconds, infinite at first."""

OVERLAP = 2.5
"""Duration of a target in cycles, so that a late one does not pause the motion."""


class TeleopController:
    """Moves all joints of an arm with a joystick.

    After a stop, the arm moves again when it was resumed and the button was released and pressed again.

    Args:
        rules: The meaning of the joystick's axes and buttons.
        stick: Called once per cycle.
        period: Least seconds between two cycles.
        on_note: Called with a new note for the operator, or with the reason for a stop.
    """

    def __init__(
        self,
        rules: Teleop,
        stick: Stick,
        period: float,
        on_note: Callable[[str | StopReason], object] = lambda said: None,
    ) -> None:
        check_rate(1.0 / period)
        self._rules, self._stick, self._period, self._on_note = rules, stick, period, on_note
        self._last = math.nan
        self._said: str | StopReason = ""
        self._stopped = False
        self.moving = False

    @property
    def joints(self) -> tuple[str, ...]:
        """Names."""
        return self._rules.arm.names

    @property
    def busy(self) -> bool:
        """It is moving its joints."""
        return self.moving

    @property
    def reason(self) -> StopReason | None:
        """Always None: it latches no stop, but waits for the button."""
        return None

    def judge(self, state: JointState, velocity: Sequence[float], now: float) -> None:
        """Do nothing: the operator watches the arm."""

    def cycle(self, state: JointState, now: float, lead: float) -> JointTarget | None:
        """The target for the joystick's present position."""
        # With the chapter's board, a cycle takes longer than requested.
        period = self._period if math.isnan(self._last) else max(self._period, now - self._last)
        self._last = now
        axes, buttons, age = self._stick()
        stopped, self._stopped = self._stopped or state.stopped, False
        if stopped:
            # The joystick does not clear a stop, nor continue at once when it is cleared.
            age = math.inf
        jog = self._rules.update(axes, buttons, age, state.positions, now)
        found = board_stop(state)
        self._say(found or jog.note)
        self.moving = jog.action is Action.MOVE
        if jog.action is Action.HOLD and not stopped:
            return holding(self._rules.arm, state)
        if jog.action is not Action.MOVE:
            return None
        # A joint outside its limits stays where it is.
        inside = within_limits(self._rules.arm, jog.positions)
        return JointTarget.of(inside, OVERLAP * period) if inside else None

    def stop(self, reason: StopReason) -> None:
        """Require that the button is released before the arm moves again."""
        self._stopped, self.moving = True, False

    def reset(self) -> None:
        """Do nothing: nothing moves."""

    def release(self, why: str) -> None:
        """Same as `stop`."""
        self._stopped, self.moving = True, False

    def take_ended(self) -> list[tuple[GoalListener, Ended]]:
        """There are no goals."""
        return []

    def _say(self, said: str | StopReason) -> None:
        if said and said != self._said:
            self._on_note(said)
        self._said = said


def run_teleop(
    robot: RobotDriver,
    controller: TeleopController,
    rate: float,
    *,
    on_ready: Callable[[], object] = lambda: None,
    shield: Callable[[], AbstractContextManager[object]] = nullcontext,
    sleep: Callable[[float], object] | None = None,
) -> NoReturn:
    """Switch torque on and move the arm until an exception, such as KeyboardInterrupt, ends it; then it holds.

    Args:
        robot: Attached.
        controller: For all joints of the robot.
        rate: Cycles per second.
        on_ready: Called once, when torque is on and before anything can move.
        shield: Put around the hold at the end; keeps signals from interrupting it.
        sleep: As in `RobotOwner`.

    Raises:
        HexwireError: The robot failed or refused.
    """
    owner = RobotOwner(robot, borrowed=True, command_rate=rate, sleep=sleep)
    robot.torque(True)
    on_ready()
    with owner:
        owner.group.members = (controller,)
        try:
            while True:
                owner.turn()
        finally:
            with shield():
                controller.release("it is over")
                hold_at_end(robot)


def hold_at_end(robot: RobotDriver) -> None:
    """Hold the arm where it is, also after an error; if that fails, stop it."""
    try:
        state = robot.read()
        target = None if state.stopped else holding(robot.model, state)
        if target is not None:
            robot.write(target)
    except LeaseError:
        # Another program has the arm, or it holds.
        pass
    except HexwireError:
        robot.stop()
