"""What a robot is told and tells besides its joints: signals, kinds of stop, what a probe finds, a latched stop.

Owns these values. Must not know drivers, links or who asks.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum

__all__ = ["JointProbe", "ProbeReport", "Signal", "StopCause", "StopLatch", "StopMode"]


class Signal(IntEnum):
    """Signal numbers of `RobotDriver.signal`. They are this project's own: the chapter's are not public."""

    STOP = 1
    """Latched stop; the joints hold where they are."""
    STOP_TORQUE_OFF = 2
    """Latched stop that takes the torque away: the arm may fall."""
    RESUME = 3
    """Ends a stop; nothing moves by it."""
    TORQUE_ON = 4
    """Torque on for all joints, where they stand."""
    TORQUE_OFF = 5
    """Torque off for all joints."""


class StopMode(IntEnum):
    """What a stop, or the board's watchdog, does."""

    HOLD = 0
    TORQUE_OFF = 1


class StopCause(Enum):
    """What stopped a robot since its last `resume`, in words for people."""

    NONE = ""
    """It is not stopped."""
    HERE = "this program stopped it"
    """`stop` was called in this program, or this user's stop of an earlier one holds."""
    WATCHDOG = "its watchdog stopped it, because the host fell silent"
    ELSEWHERE = "it was told to stop from elsewhere"
    """Another program, or a button."""


@dataclass(frozen=True, slots=True)
class StopLatch:
    """A stop that holds until `resume`, or none.

    Attributes:
        cause: What stopped the robot.
    """

    cause: StopCause

    @property
    def stopped(self) -> bool:
        """Whether the robot is stopped."""
        return self.cause is not StopCause.NONE


@dataclass(frozen=True, slots=True)
class JointProbe:
    """What a probe found of one joint.

    Attributes:
        name: The joint.
        servo_id: Id of its servo.
        series: Series of it, as it answers.
        present: It answers.
        note: What is wrong with it; empty if nothing is.
        model: What the servo says it is, as in ``sts3215 3.10``; empty if it does not say.
        supply: Least and most volts that it wants; None if it does not say.
        max_temperature: Degrees Celsius from which it protects itself; None if it does not say.
    """

    name: str
    servo_id: int
    series: str
    present: bool
    note: str = ""
    model: str = ""
    supply: tuple[float, float] | None = None
    max_temperature: float | None = None

    @property
    def remarks(self) -> str:
        """What is wrong, and what it is, for a person."""
        return ", ".join(filter(None, (self.note, self.model)))


@dataclass(frozen=True, slots=True)
class ProbeReport:
    """What a probe found.

    Attributes:
        robot: Name of the model.
        link: URL of the link.
        dialect: 1 or 2; 0 where there is no such thing.
        firmware: As in ``2.0.1``; empty if the board does not say.
        boot_id: Changes at every reset of the board; None if it has none.
        capabilities: Words for what the board can do.
        stopped: A stop is latched.
        joints: One row a joint.
        counters: The board's and the host's counters by name.
        maintenance: The board lets settings of servos be written, and nothing move.
        unprotected: What protects other robots and is missing here, in words; empty if nothing is.
    """

    robot: str
    link: str
    dialect: int
    firmware: str
    boot_id: int | None
    capabilities: tuple[str, ...]
    stopped: bool
    joints: tuple[JointProbe, ...]
    counters: dict[str, int]
    maintenance: bool = False
    unprotected: str = ""

    @property
    def missing(self) -> tuple[str, ...]:
        """Names of the joints whose servo does not answer."""
        return tuple(joint.name for joint in self.joints if not joint.present)

    def same_kind(self, other: ProbeReport) -> bool:
        """Whether a robot that was found anew has the rates and abilities of the one that was there before."""
        return (self.robot, self.dialect) == (other.robot, other.dialect)
