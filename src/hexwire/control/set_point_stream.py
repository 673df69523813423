"""Set-points that keep coming on one topic: a stop ends them, also if their sender does not notice.

Owns which set-points belong together, and which of them a stop voids. Must not know messages nor topics.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from hexwire.errors import GoalError, HexwireError, UsageError

from .outcomes import Reason

if TYPE_CHECKING:
    from hexwire.epochs import Token
    from hexwire.model.control_law import Laws

    from .controlled_arm import ControlledArm

__all__ = ["PAUSE", "SetPointStream"]

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
