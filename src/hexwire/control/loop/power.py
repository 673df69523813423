"""Switches torque on and off, requires that every joint confirms it, ends a stop, and says which joints hold.

Owns the error if a joint does not confirm, and what is said of an arm's torque. Must not know motions.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from hexwire.drivers.abilities import Watchdog
from hexwire.drivers.values import StopCause, StopMode
from hexwire.errors import HexwireError, ServoError
from hexwire.model.state import JointFlag

from .known_state import known_joints
from .reader import raise_if_silent

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.arm import ArmModel
    from hexwire.model.state import JointState

    from ..motion.motion_options import MotionObserver
    from .owner import RobotOwner

__all__ = [
    "NOT_LATCHED",
    "STOP_LATCHED",
    "Stopped",
    "Torques",
    "end_stop",
    "give_torque",
    "require_confirmed",
    "switch_torque",
    "what_helps",
]

STOP_LATCHED = "`hexwire resume` ends that"
"""What to do after a stop that is latched."""
NOT_LATCHED = "nothing is latched: ask for it again"
"""What to do after any other end."""


@dataclass(frozen=True, slots=True)
class Torques:
    """What the joints of an arm that does not move do, by name: each is in one of three lists.

    Attributes:
        holding: They have torque.
        limp: They have none: under weight they sink.
        unknown: Nobody knows; such a joint may have torque, and may move.
    """

    holding: tuple[str, ...] = ()
    limp: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()

    @classmethod
    def of(cls, names: Sequence[str], state: JointState | None, now: float) -> Torques:
        """By the newest state.

        Args:
            names: The joints.
            state: The newest state; None if there is none, or if the robot is not connected.
            now: The clock of the state's `stamp`.
        """
        known = set(known_joints(state, now))
        flags = dict(zip(state.names, state.flags, strict=True)) if state is not None else {}
        return cls.by_flags({name: flags[name] if name in known else JointFlag.TORQUE_UNKNOWN for name in names})

    @classmethod
    def by_flags(cls, flags: Mapping[str, int]) -> Torques:
        """By the `JointFlag` bits of each joint."""
        rows: dict[str, list[str]] = {"holding": [], "limp": [], "unknown": []}
        for name, bits in flags.items():
            unknown = bits & (JointFlag.TORQUE_UNKNOWN | JointFlag.SILENT)
            rows["unknown" if unknown else "holding" if bits & JointFlag.TORQUE_ON else "limp"].append(name)
        return cls(*(tuple(row) for row in rows.values()))

    def after_stop(self, confirmed: Collection[str], mode: StopMode) -> Torques:
        """After a stop: it takes torque or leaves it, and gives none. What has not confirmed it may do anything.

        Args:
            confirmed: Joints that have confirmed the stop.
            mode: How they were stopped.
        """
        names = self.holding + self.limp + self.unknown
        if mode is StopMode.TORQUE_OFF:
            limp = tuple(name for name in names if name in confirmed)
            return Torques((), limp, tuple(name for name in names if name not in confirmed))
        holding, limp = (tuple(n for n in row if n in confirmed) for row in (self.holding, self.limp))
        return Torques(holding, limp, tuple(n for n in names if n not in holding and n not in limp))

    @property
    def short(self) -> str:
        """``on``, ``off``, the names of the joints that have torque, or empty if that is unknown of any."""
        if self.unknown:
            return ""
        return "off" if not self.holding else "on" if not self.limp else " ".join(self.holding)

    def __str__(self) -> str:
        """In words, as in ``holding: J1 J2; limp: J3; unknown: J4``."""
        rows = (("holding", self.holding), ("limp", self.limp), ("unknown", self.unknown))
        return "; ".join(f"{words}: {' '.join(names)}" for words, names in rows if names) or "unknown"


@dataclass(frozen=True, slots=True)
class Stopped:
    """What became of the stop of one arm.

    Attributes:
        name: Its name, or the route by which it was not found.
        confirmed: Its server says that all that can confirm has confirmed.
        joints: Joints that confirmed.
        error: Why it is not confirmed; empty if it is.
        seconds: How long the answer took.
        kept: Why the arm holds although torque off was asked for; otherwise empty.
        torques: Which of its joints hold, are limp, and are unknown.
    """

    name: str
    confirmed: bool
    joints: tuple[str, ...] = ()
    error: str = ""
    seconds: float = 0.0
    kept: str = ""
    torques: Torques = field(default_factory=Torques)

    @property
    def with_torque(self) -> bool:
        """Whether it may have torque although torque off was asked for."""
        return bool(self.kept and (self.torques.holding or self.torques.unknown))

    def __str__(self) -> str:
        """What became of it, and what the arm does, in a line."""
        if not self.confirmed:
            return f"{self.name}: NOT CONFIRMED: {self.error}; {self.torques}"
        kept = f"; with torque: {self.kept}" if self.with_torque else ""
        return f"{self.name}: stopped, {self.torques} ({1000 * self.seconds:.0f} ms){kept}"


def give_torque(robot: RobotDriver, names: Sequence[str], state: JointState) -> tuple[str, ...]:
    """Switch torque on for those joints that have none. Nothing moves.

    Args:
        robot: Attached.
        names: Joints.
        state: Just read.

    Returns:
        Names of the joints whose torque was switched on.

    Raises:
        ServoError: A joint did not confirm it.
        StoppedError: A stop is latched.
    """
    missing = [name for name in names if name not in state.torque_on]
    if not missing:
        return ()
    confirmed = robot.torque(True, missing)
    raise_if_silent([(robot.model.joint(name).servo_id, name) for name in missing if name not in confirmed])
    return confirmed


def switch_torque(
    robot: RobotOwner | RobotDriver, on: bool, names: Sequence[str], observer: MotionObserver | None = None
) -> None:
    """Switch torque on or off, and require that every joint confirms it, after the observer was told which do.

    Raises:
        HexwireError: As `RobotOwner.torque`; or a joint did not confirm it, and the text names it.
    """
    confirmed = robot.torque(on, names)
    if observer is not None:
        observer.switched(names, confirmed)
    require_confirmed(robot.model, names, confirmed, f"that torque is {'on' if on else 'off'}")


def require_confirmed(model: ArmModel, names: Sequence[str], confirmed: Collection[str], what: str) -> None:
    """Raise an error that names the joints, and their servos, that did not confirm something, if there are any."""
    missing = [model.joint(name) for name in names if name not in confirmed]
    if missing:
        servos = ", ".join(f"{joint.name} (servo {joint.servo_id})" for joint in missing)
        raise ServoError(f"{servos} did not confirm {what}", servo_id=missing[0].servo_id)


def what_helps(robot: RobotDriver, state: JointState | None = None) -> str:
    """What to do after a stop of what was going on: the stop may be over by now, or was none that is latched.

    Args:
        robot: Attached.
        state: Just read; None to read one.
    """
    with suppress(HexwireError):
        if not (robot.epochs.stopped or (robot.read() if state is None else state).stopped):
            return NOT_LATCHED
    return STOP_LATCHED


def end_stop(robot: RobotDriver) -> bool:
    """End a stop. Nothing moves, and torque that the stop switched off stays off.

    A watchdog that stopped the arm because its program died is switched off: otherwise it would stop the arm again
    as soon as this program ends.

    Returns:
        Whether a watchdog had stopped the arm.

    Raises:
        HexwireError: The robot failed or refused.
    """
    tripped = robot.stop_latch().cause is StopCause.WATCHDOG
    robot.resume()
    if tripped:
        Watchdog.of(robot).watchdog(0.0)
    return tripped
