"""What of a robot's state may be published as sensor_msgs/JointState, and with which velocities.

Owns the choice of joints, the estimate of velocities that a driver does not give, and the rule that stamps rise.
Pure: time comes with the states. Must not know messages, drivers or clocks.
"""

from __future__ import annotations

from dataclasses import dataclass

from hexwire.model.state import JointState

__all__ = ["PublishedState", "StateFilter"]


@dataclass(frozen=True, slots=True)
class PublishedState:
    """Joints that are known, at one time.

    Attributes:
        names: Joint names.
        position: Radians.
        velocity: Radians per second.
        age: Seconds from the newest sample to the state's `stamp`.
    """

    names: tuple[str, ...]
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    age: float


class StateFilter:
    """Turns one robot's states into what is published.

    Args:
        max_age: A silent joint is published for so long after its last sample, seconds.
    """

    def __init__(self, max_age: float = 0.5) -> None:
        self._max_age = max_age

    def take(self, state: JointState) -> PublishedState | None:
        """The next state; None if there is nothing to publish."""
        raise NotImplementedError
