"""Values of a robot besides its joints: signals, stop modes, stop causes, a latched stop, probe results.

Owns these values. Must not know drivers, links or callers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, IntEnum

__all__ = ["JointProbe", "ProbeReport", "Signal", "StopCause", "StopLatch", "StopMode"]


class Signal(IntEnum):
    """Signal numbers of `RobotDriver.signal`. They are this project's own: the chapter's are not public."""

    STOP = 1
    """Latched stop; the joints hold where they are."""
    STOP_TORQUE_OFF = 2
    """Latched stop that switches the torque off: the arm may fall."""
    RESUME = 3
    """Ends a stop; nothing moves."""
    TORQUE_ON = 4
    """Torque on for all joints, at their present positions."""
    TORQUE_OFF = 5
    """Torque off for all joints."""


class StopMode(IntEnum):
    """How a stop, or the board's watchdog, stops the arm."""

    HOLD = 0
    TORQUE_OFF = 1


class StopCause(Enum):
    """What stopped a robot since its last `resume`; the value is a text for display."""

    NONE = ""
    """It is not stopped."""
    HERE = "this program stopped it"
    """`stop` was called in this program, or this user's stop from an earlier program still holds."""
    WATCHDOG = "its watchdog stopped it because the host fell silent"
    ELSEWHERE = "it was stopped from elsewhere"
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
    """The probe of one joint.

    Attributes:
        name: The joint.
        servo_id: Id of its servo.
        series: Series of the servo, by its answer.
        present: Whether the servo answers.
        note: The fault found; empty if there is none.
        model: Model and firmware that the servo reports, as in ``sts3215 3.10``; empty if it reports none.
        supply: Lowest and highest supply voltage, volts; None if the servo does not report them.
        max_temperature: Degrees Celsius at which the servo protects itself; None if it does not report it.
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
        """The note and the model, for display."""
        return ", ".join(filter(None, (self.note, self.model)))


@dataclass(frozen=True, slots=True)
class ProbeReport:
    """The result of a probe.

    Attributes:
        robot: Name of the model.
        link: URL of the link.
        dialect: 1 or 2; 0 if the robot has no dialect.
        firmware: As in ``2.0.1``; empty if the board does not report it.
        boot_id: Changes at every reset of the board; None if it has none.
        capabilities: Names of the board's abilities.
        stopped: A stop is latched.
        joints: One row per joint.
        counters: The board's and the host's counters by name.
        maintenance: The board allows writes to servo settings, and no motion.
        unprotected: Protections that this robot lacks, for display; empty if it lacks none.
    """

    robot: str
    link: str = ""
    dialect: int = 0
    firmware: str = ""
    boot_id: int | None = None
    capabilities: tuple[str, ...] = ()
    stopped: bool = False
    joints: tuple[JointProbe, ...] = ()
    counters: dict[str, int] = field(default_factory=dict)
    maintenance: bool = False
    unprotected: str = ""

    @property
    def chapter(self) -> bool:
        """Whether it is a board of the chapter, with the chapter's dialect."""
        return self.dialect == 1

    @property
    def dialect_name(self) -> str:
        """The dialect for display."""
        return str(self.dialect) if self.dialect else "none: servo bus"

    @property
    def missing(self) -> tuple[str, ...]:
        """Names of the joints whose servo does not answer."""
        return tuple(joint.name for joint in self.joints if not joint.present)

    def same_kind(self, other: ProbeReport) -> bool:
        """Whether a robot found again has the rates and abilities of the previous one."""
        return (self.robot, self.dialect) == (other.robot, other.dialect)
