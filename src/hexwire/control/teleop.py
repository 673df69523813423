"""Set-points from a stick, one a cycle: what the rules of teleoperation say becomes what the owner sends.

Owns the controller, and that the arm holds when it is let go. Must not know devices, robots or threads, nor what
makes a motion safe.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from hexwire.model.state import JointTarget
from hexwire.motion.safety import StopReason, board_stop
from hexwire.motion.teleop import Action, within_limits

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel
    from hexwire.model.state import JointState
    from hexwire.motion.teleop import Teleop

    from .outcomes import Ended, GoalListener

__all__ = ["OVERLAP", "Stick", "TeleopController", "holding"]

Stick = Callable[[], tuple[Sequence[float], int, float]]
"""Gives the newest axes (-1..1), buttons (bit i is button i) and their age in seconds; infinite if never heard."""

OVERLAP = 2.5
"""Set-points last this many cycles, so that one that is late makes no stop."""
_SETTLE = 0.05


class TeleopController:
    """Moves all joints of an arm as a stick says.

    A stop ends nothing: the arm sets out again when it was resumed, and the button released and pressed.

    Args:
        rules: What the stick means.
        stick: Asked once a cycle.
        period: Seconds between two cycles, at least.
        on_note: Told what there is to say to the person at the stick, or why the arm is stopped, when that changes.
    """

    def __init__(
        self,
        rules: Teleop,
        stick: Stick,
        period: float,
        on_note: Callable[[str | StopReason], object] = lambda said: None,
    ) -> None:
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
        """It sends its joints somewhere."""
        return self.moving

    @property
    def reason(self) -> StopReason | None:
        """None: it waits for the button after a stop, and latches nothing."""
        return None

    def judge(self, state: JointState, velocity: Sequence[float], now: float) -> None:
        """A person judges."""

    def cycle(self, state: JointState, now: float, lead: float) -> JointTarget | None:
        """What the stick asks for now."""
        # Toward a board of the chapter a cycle takes longer than asked for.
        period = self._period if math.isnan(self._last) else max(self._period, now - self._last)
        self._last = now
        axes, buttons, age = self._stick()
        stopped, self._stopped = self._stopped or state.stopped, False
        if stopped:
            # Whoever stopped the arm, it is not for a stick to end that; nor to move on when it is ended.
            age = math.inf
        jog = self._rules.update(axes, buttons, age, state.positions, now)
        found = board_stop(state)
        self._say(found or jog.note)
        self.moving = jog.action is Action.MOVE
        if jog.action is Action.HOLD and not stopped:
            return holding(self._rules.arm, state)
        if jog.action is not Action.MOVE:
            return None
        # A joint that stands outside its limits stays where it is.
        inside = within_limits(self._rules.arm, jog.positions)
        return JointTarget.of(inside, OVERLAP * period) if inside else None

    def stop(self, reason: StopReason) -> None:
        """The button must be released before anything moves again."""
        self._stopped, self.moving = True, False

    def reset(self) -> None:
        """Nothing moves by it."""

    def release(self, why: str) -> None:
        """As `stop`."""
        self._stopped, self.moving = True, False

    def take_ended(self) -> list[tuple[GoalListener, Ended]]:
        """There are no goals."""
        return []

    def _say(self, said: str | StopReason) -> None:
        if said and said != self._said:
            self._on_note(said)
        self._said = said


def holding(arm: ArmModel, state: JointState) -> JointTarget | None:
    """The target that makes joints stay where they are, within limits; None if no position is known."""
    inside = {}
    for joint in state:
        limits = arm.joint(joint.name)
        if math.isfinite(joint.position):
            inside[joint.name] = max(limits.minimum, min(limits.maximum, joint.position))
    return JointTarget.of(inside, _SETTLE) if inside else None
