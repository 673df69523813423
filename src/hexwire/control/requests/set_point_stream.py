"""Set-points that keep coming on one topic, with or without gains: a stop ends them, whatever their sender does.

Owns which set-points belong together, which of them a stop voids, and the reading of messages with a position and a
control law for each joint, without needing their class. Must not know topics, nor which positions are valid.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from hexwire.drivers.abilities import ObeysGains
from hexwire.errors import GoalError, HexwireError, UsageError
from hexwire.model.control_law import ControlLaw
from hexwire.wire.robot_bodies import COMMAND_ARRAYS, LAW_ARRAYS

from ..loop.outcomes import Reason

if TYPE_CHECKING:
    from hexwire.epochs import Token
    from hexwire.model.control_law import Laws

    from .controlled_arm import ControlledArm

__all__ = ["PAUSE", "JointCommandStream", "SetPointStream"]

PAUSE = 0.5
"""Seconds without a set-point after which the next one begins anew; `command_timeout`, if that is longer."""


class SetPointStream:
    """Set-points that were asked for when the first of them came.

    A program that streams goes on through a stop, as nobody tells it. Were each set-point a request of its own, the
    arm would leave for the newest one at the reset. So a stream that met a stop, or joints without torque, must
    pause.

    Args:
        arm: Follows them.
    """

    def __init__(self, arm: ControlledArm) -> None:
        self._arm = arm
        self._asked: Token | None = None
        self._heard, self._sent = -math.inf, -math.inf

    def follow(
        self,
        positions: Mapping[str, float],
        sent: float | None = None,
        laws: Laws = None,
    ) -> None:
        """Follow set-points; as `ControlledArm.set_points`.

        Args:
            positions: Radians by joint.
            sent: When they were sent, seconds of the sender's clock: what a network held back is no pause.
            laws: As in `ControlledArm.set_points`.

        Raises:
            GoalError: As `ControlledArm.set_points`, or they have come since before the arm could move.
            UsageError: As `ControlledArm.set_points`.
            HexwireError: As `ControlledArm.set_points`.
        """
        arm = self._arm
        if self._paused(arm.owner.now(), sent):
            self._asked = arm.mark()
        try:
            arm.refuse_stopped()
            if self._asked != arm.mark():
                text = "they have come since before the arm was stopped or had torque"
                raise GoalError(f"{text}; pause them for {self._pause:g} s", reason=Reason.STOPPED)
            arm.set_points(positions, asked=self._asked, laws=laws)
        except HexwireError as error:
            if not isinstance(error, UsageError) or arm.teach_mode.hand.active or _cannot_move(error):
                self._asked = None
            raise

    @property
    def _pause(self) -> float:
        return max(PAUSE, self._arm.settings.command_timeout)

    def _paused(self, now: float, sent: float | None) -> bool:
        heard, self._heard = now - self._heard, now
        if sent is None:
            return heard >= self._pause
        # The clock of another sender may be anywhere.
        apart, self._sent = abs(sent - self._sent), sent
        return min(heard, apart) >= self._pause


def _cannot_move(error: HexwireError) -> bool:
    return isinstance(error, GoalError) and error.reason in (Reason.STOPPED, Reason.NOT_READY)


class JointCommandStream:
    """Follows such messages: positions within the limits, and with their gains where the robot obeys them.

    Args:
        arm: Follows them.
    """

    def __init__(self, arm: ControlledArm) -> None:
        self._arm = arm
        self._stream = SetPointStream(arm)

    def follow(self, message: Any, sent: float | None = None) -> str:
        """Follow one message.

        Args:
            message: Has `name` and the arrays of a JointCommands, each of the same length or empty.
            sent: As in `SetPointStream.follow`.

        Returns:
            What of it has no effect, in words; empty if all has.

        Raises:
            UsageError: A joint is named twice, a field has the wrong length, or a value is not a finite number.
            HexwireError: As `SetPointStream.follow`.
        """
        positions, laws = _read(message)
        obeys = self._arm.owner.robot.can(ObeysGains)
        used = {name: law for name, law in laws.items() if obeys and law.acts}
        self._stream.follow(positions, sent, used)
        lost = [law for name, law in laws.items() if name not in used]
        ignored = ", ".join(field for field in LAW_ARRAYS if any(getattr(law, field) for law in lost))
        if not ignored:
            return ""
        why = "joints without an effort or a gain" if obeys else "the servos take positions only"
        return f"{why}; ignored: {ignored}"


def _read(message: Any) -> tuple[dict[str, float], dict[str, ControlLaw]]:
    """Positions and control laws by joint."""
    names = tuple(message.name)
    if len(set(names)) != len(names):
        raise UsageError(f"a joint is named twice: {', '.join(names)}")
    for field in COMMAND_ARRAYS:
        values = getattr(message, field)
        if len(values) not in {0, len(names)}:
            raise UsageError(f"{field} has {len(values)} values for {len(names)} names")
        for joint, value in zip(names, values, strict=False):
            if not math.isfinite(value):
                raise UsageError(f"the {field} of {joint} is {value}, not a number")
    given = {field: values for field in LAW_ARRAYS if len(values := getattr(message, field))}
    laws = {
        name: ControlLaw(**{field: float(values[i]) for field, values in given.items()})
        for i, name in enumerate(names)
    }
    return dict(zip(names, message.position, strict=False)), laws
