"""Set-points with gains: messages with a position and a control law for each joint, as nodes send them.

Owns reading them, without needing their class, and what of them a robot does not obey. Must not know topics, nor
which positions are valid.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from hexwire.errors import UsageError
from hexwire.model.control_law import ControlLaw
from hexwire.wire.robot_bodies import COMMAND_ARRAYS, LAW_ARRAYS

from .set_point_stream import SetPointStream

if TYPE_CHECKING:
    from .controlled_arm import ControlledArm

__all__ = ["JointCommandStream"]


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
        obeys = self._arm.owner.robot.obeys_gains
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
