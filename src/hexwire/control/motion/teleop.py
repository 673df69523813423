"""Teleoperation: turns the axes of a joystick into one target per cycle.

Owns the controller, and that the arm brakes and holds when the button is released and at the end. Must not know
devices or threads, nor the rules that make a motion safe.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from typing import TYPE_CHECKING, NoReturn

from hexwire.errors import HexwireError, LeaseError
from hexwire.model.state import JointTarget
from hexwire.motion.safety import StopReason, board_stop
from hexwire.motion.teleop import Action, within_limits

from ..loop.owner import RobotOwner
from ..loop.target import holding
from .operator_control import OVERLAP, OperatorController

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.state import JointState
    from hexwire.motion.teleop import Teleop

    from .path_check import PathCheck


__all__ = ["Stick", "TeleopController", "hold_at_end", "run_teleop"]

_BRAKES = 2.0
"""Most seconds for which the joints brake at the end."""

Stick = Callable[[], tuple[Sequence[float], int, float]]
"""Returns the newest axes (-1..1), buttons (bit i is button i) and their age in seconds, infinite at first."""


class TeleopController(OperatorController):
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
        super().__init__(rules.arm, period, on_note)
        self._rules, self._stick = rules, stick
        self._ends = False

    def let_go(self) -> None:
        """From now on the joystick counts as released: the joints brake, and `moving` ends."""
        self._ends = True

    def cycle(self, state: JointState, now: float, lead: float) -> JointTarget | None:
        """The target for the joystick's present position."""
        period = self._period(now)
        axes, buttons, age = ((), 0, 0.0) if self._ends else self._stick()
        stopped, self._stopped = self._stopped or state.stopped, False
        if stopped:
            # The joystick does not clear a stop, nor continue at once when it is cleared.
            self._rules.drop()
            age = math.inf
        lasts = OVERLAP * period
        jog = self._rules.update(axes, buttons, age, state.positions, now, lead=lasts)
        found = board_stop(state)
        self._say(found or jog.note)
        self.moving = jog.action is Action.MOVE
        if jog.action is Action.HOLD and not stopped:
            return holding(self._rules.arm, state)
        if jog.action is not Action.MOVE:
            return None
        # A joint outside its limits stays where it is.
        inside = within_limits(self._rules.arm, jog.positions)
        return JointTarget.of(inside, lasts) if inside else None


def run_teleop(
    robot: RobotDriver,
    controller: TeleopController,
    rate: float,
    *,
    check: PathCheck | None = None,
    on_ready: Callable[[], object] = lambda: None,
    shield: Callable[[], AbstractContextManager[object]] = nullcontext,
    sleep: Callable[[float], object] | None = None,
) -> NoReturn:
    """Switch torque on and move the arm until an exception, such as KeyboardInterrupt, ends it; then it holds.

    Args:
        robot: Attached.
        controller: For all joints of the robot.
        rate: Cycles per second.
        check: As in `RobotOwner`.
        on_ready: Called once, when torque is on and before anything can move.
        shield: Put around the hold at the end; keeps signals from interrupting it.
        sleep: As in `RobotOwner`.

    Raises:
        HexwireError: The robot failed or refused.
    """
    owner = RobotOwner(robot, borrowed=True, check=check, command_rate=rate, sleep=sleep)
    robot.torque(True)
    on_ready()
    with owner:
        owner.group.members = (controller,)
        try:
            while True:
                owner.turn()
        finally:
            with shield():
                brake_at_end(owner, controller)
                controller.release("it is over")
                hold_at_end(robot)


def brake_at_end(owner: RobotOwner, controller: TeleopController) -> None:
    """Let the joints brake before they are held, for as long as that takes at most, unless the robot fails."""
    controller.let_go()
    until = owner.now() + _BRAKES
    with suppress(HexwireError):
        while controller.moving and owner.now() < until:
            owner.turn()


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
