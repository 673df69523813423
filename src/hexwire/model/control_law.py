"""`ControlLaw`: gains with which a robot's controller shall follow the position of one joint.

Owns the values, those of osrf_msgs/JointCommands.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

from hexwire.errors import UsageError

__all__ = ["ControlLaw", "Laws"]


@dataclass(frozen=True, slots=True)
class ControlLaw:
    """How a controller computes the effort of one joint, in place of its own loop.

    With the position error e, the effort is effort + kp_position * e + ki_position * (integral of e, its effort
    limited to i_effort_min..i_effort_max) + kd_position * de/dt + kp_velocity * (velocity error). Units: radians,
    seconds, newton metres. Source: osrf_msgs/JointCommands.

    Raises:
        UsageError: A value is not a finite number.
    """

    velocity: float = 0.0
    effort: float = 0.0
    kp_position: float = 0.0
    ki_position: float = 0.0
    kd_position: float = 0.0
    kp_velocity: float = 0.0
    i_effort_min: float = 0.0
    i_effort_max: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not math.isfinite(value):
                raise UsageError(f"{field.name} is {value}, not a number")

    @property
    def acts(self) -> bool:
        """Whether it has an effort or a gain; without one the controller's own loop follows the position."""
        return any((self.effort, self.kp_position, self.ki_position, self.kd_position, self.kp_velocity))


Laws = Mapping[str, ControlLaw] | None
"""Control laws by joint; None for none."""
