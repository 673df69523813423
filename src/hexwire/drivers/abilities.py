"""What some robots can do and others cannot: an interface for each ability, from which such a driver derives.

Owns these interfaces and the one look-up: ``Watchdog.find(robot)`` gives the robot with the methods of a watchdog,
or None; ``Watchdog.of(robot)`` raises `NotSupportedError` instead. Must not know any particular robot.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, ClassVar, Protocol, Self

from hexwire.errors import NotSupportedError

from .values import StopMode

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from hexwire.bus.servo_bus import ServoBus
    from hexwire.link.base import Link
    from hexwire.link.diagnose import Finding
    from hexwire.model.arm import ArmModel
    from hexwire.model.state import JointState

    from .timed_path import TimedPath

__all__ = [
    "Ability",
    "BareServos",
    "Counters",
    "Leased",
    "ObeysGains",
    "OnboardPaths",
    "OwnWatchdog",
    "Reconnects",
    "RefilledPaths",
    "ServoPing",
    "ServoTables",
    "SetPoints",
    "SilenceCheck",
    "StateReports",
    "StoredCalibration",
    "Watchdog",
]


class _Robot(Protocol):
    """What the look-up needs of a `RobotDriver`."""

    model: ArmModel

    def can(self, kind: type[object]) -> bool: ...


class Ability:
    """What a robot may have; a driver derives from `RobotDriver` and from its abilities.

    If the robot behind a driver decides, the driver overrides `RobotDriver.can`.
    """

    lacking: ClassVar[str] = "{name} has not the ability {ability}"
    """The error of a robot without it."""

    @classmethod
    def find(cls, robot: _Robot) -> Self | None:
        """The robot, if it has this ability; for some robots that is known after `attach`."""
        found: object = robot
        return found if isinstance(found, cls) and robot.can(cls) else None

    @classmethod
    def of(cls, robot: _Robot) -> Self:
        """The robot with this ability.

        Raises:
            NotSupportedError: It has not.
        """
        found = cls.find(robot)
        if found is None:
            raise NotSupportedError(cls.lacking.format(name=robot.model.name, ability=cls.__name__))
        return found


class Watchdog(Ability):
    """The arm stops automatically when this program falls silent; see `RobotDriver.watched`."""

    lacking = "{name} has no watchdog to stop it when this program falls silent"

    @property
    @abstractmethod
    def watchdog_armed(self) -> bool:
        """Whether this driver has armed the watchdog."""

    @abstractmethod
    def watchdog(self, timeout: float, mode: StopMode = StopMode.HOLD) -> None:
        """Arm the watchdog: the robot stops when this program sends nothing for `timeout` seconds.

        Args:
            timeout: Seconds of silence; 0 disarms the watchdog.
            mode: How the robot stops.

        Raises:
            UsageError: The timeout is outside the robot's range.
        """


class OwnWatchdog(Watchdog):
    """The watchdog is in the robot. One in a program in between ends with that program."""


class StateReports(Ability):
    """The robot sends states without being asked."""

    lacking = "{name} sends no state reports; use read()"

    @abstractmethod
    def stream(self, period: float, timeout: float = 1.0, *, slow: float | None = None) -> Iterator[JointState]:
        """Yield the states that the robot reports periodically, until the caller stops iterating.

        Args:
            period: Seconds between reports.
            timeout: Seconds without a report after which the robot is polled; the iterator ends if it answers the
                poll but sends no reports.
            slow: Seconds between readings of what changes slowly (voltage, temperature, current), where leaving it
                out makes reports shorter; None puts everything into every report.

        Raises:
            ReplyTimeoutError: The robot no longer answers.
            UsageError: The period is outside the robot's range.
        """

    @abstractmethod
    def discard_reports(self) -> None:
        """Discard reported states that were not read yet; they are older than the last reply.

        Raises:
            LinkError: The line is lost.
        """


class OnboardPaths(Ability):
    """The robot follows a path in its own time, which is sent whole before the start."""

    lacking = "{name} follows no path in its own time"

    @abstractmethod
    def path(
        self,
        joints: Sequence[str] | None = None,
        *,
        smooth: bool = True,
        brake: float | None = None,
        outlives: bool = False,
    ) -> TimedPath:
        """Begin a path that the robot follows in its own time, whatever this program does meanwhile. Nothing moves.

        Args:
            joints: Names; all if None.
            smooth: Its points have velocities, and the joints follow cubics between them; else straight lines.
            brake: Seconds in which the joints come to rest on the path when they must; if None, as long as even
                motion at their greatest speed needs within their limits.
            outlives: Once all points have arrived, the watchdog lets it finish; `clear_path` ends it.

        Raises:
            StoppedError: A stop is latched.
            CommandRefusedError: It follows another path.
        """

    def left_path(self) -> tuple[str, ...]:
        """Joints that follow a path which outlives its program, see `path`; asks the robot."""
        return ()

    def clear_path(self, joints: Sequence[str] | None = None) -> bool:
        """Bring joints to rest that follow such a path, so that another motion can begin; `write` does so too.

        Args:
            joints: Only if one of them is on it; None for any.

        Returns:
            Whether it was ended.

        Raises:
            UsageError: Other joints are on it too, and would not get to their goals; it goes on.
            StoppedError: A stop is latched.
        """
        return False


class RefilledPaths(OnboardPaths):
    """Points of such a path may be sent and replaced after its start."""


class ObeysGains(Ability):
    """Joints follow their targets with gains, see `JointTarget.laws`; others take positions only."""

    lacking = "{name} takes positions only, no efforts and no gains"


class Leased(Ability):
    """Another program serves the arm, and lends it to one program at a time."""

    @property
    @abstractmethod
    def holder(self) -> str:
        """Who holds the lease, in words; empty if nobody does."""

    @abstractmethod
    def take(self, *, force: bool | None = None) -> None:
        """Take the lease; without effect if this program holds it.

        Args:
            force: Pre-empt another holder; as the address says if None.

        Raises:
            LeaseError: Another program holds it.
            LinkPermissionError: The certificate does not allow it.
        """

    @abstractmethod
    def release(self, *, finish: bool = False) -> None:
        """Give the lease back.

        Args:
            finish: A motion that was begun runs to its end; otherwise the arm holds.
        """


class ServoPing(Ability):
    """Servos can be asked one by one whether they are there."""

    lacking = "the servos of robot {name} cannot be pinged one by one"

    @abstractmethod
    def ping(self, servo_id: int) -> int | None:
        """Ping one servo.

        Args:
            servo_id: Its id on the bus; it need not belong to this arm.

        Returns:
            Its error byte (0 = none), or None if it does not answer.
        """


class ServoTables(Ability):
    """The registers of a servo behind a board can be read and written."""

    lacking = "{name} reads no register tables; 'hexwire bus read' reads bus servos"

    @abstractmethod
    def read_table(self, joint: str, first: int = 0, count: int | None = None) -> bytes:
        """Read registers of a joint's servo by one request, raw and in the servo's byte order; no snapshot.

        Args:
            joint: Its name.
            first: The first register.
            count: How many; all from `first` on if None.

        Raises:
            NotSupportedError: The board has no such request.
            CommandRefusedError: The servo is silent, or the robot follows a path.
        """

    @abstractmethod
    def write_table(self, joint: str, first: int, data: bytes) -> None:
        """Write registers of a joint's servo by one request; the board writes those that differ.

        It reads them back. It must be in `maintenance`. A servo keeps settings through power-off only while its
        register `lock` is 0. If a part is refused, an earlier part may be written: read it back.

        Args:
            joint: Its name.
            first: The first register.
            data: Their values, raw.

        Raises:
            NotSupportedError: The board has no such request.
            CommandRefusedError: The board is not in maintenance, or the gate lets a register not pass.
            ServoError: The servo does not keep a value.
        """

    @abstractmethod
    def maintenance(self, on: bool) -> None:
        """Switch maintenance on or off: while it is on, settings of servos can be written, and nothing moves.

        A stop, a trip of the watchdog and a reset end it too.

        Raises:
            NotSupportedError: The board has no maintenance.
            CommandRefusedError: A joint has torque.
            StoppedError: A stop is latched.
        """


class BareServos(Ability):
    """No board is before the servos: a program that sets them up can use the link to them.

    Attributes:
        bus: Their bus.
    """

    bus: ServoBus

    @property
    @abstractmethod
    def servo_link(self) -> Link:
        """The link to the servos."""


class StoredCalibration(Ability):
    """The servos may have stored a calibration, which the arm takes at its first `attach`.

    Attributes:
        uncalibrated: Joints that may be elsewhere than they report, since their servos have stored none, and why.
    """

    model: ArmModel
    uncalibrated: Mapping[str, str]

    @property
    @abstractmethod
    def may_change_model(self) -> bool:
        """Whether the next `attach` may change `model`; later ones do not."""

    @property
    def doubt(self) -> str:
        """Which joints may be elsewhere than they report, in one line; empty if none."""
        names = tuple(self.uncalibrated)
        which = ", ".join(names) if len(names) < 3 else f"{len(names)} joints"
        return f"not calibrated: {which} may be elsewhere than shown" if names else ""

    @property
    def cure(self) -> str:
        """The command that calibrates it."""
        return f"hexwire bus calibrate {self.model.name}"


class Counters(Ability):
    """The robot, or its line, counts what happens."""

    @property
    def round_trips(self) -> Sequence[float]:
        """Times from request to reply, seconds, newest last; empty if they are not measured."""
        return ()

    def host_counters(self) -> dict[str, int]:
        """Return the host's counters (requests, retries, dropped frames and so on) by name; sends nothing."""
        return {}

    def board_counters(self) -> dict[str, int]:
        """Read the board's counters since its reset, by name; empty if it has none.

        Raises:
            HexwireError: The board does not answer.
        """
        return {}


class Reconnects(Ability):
    """A lost connection is opened again by itself."""

    @property
    @abstractmethod
    def restarts(self) -> int:
        """Number of board resets detected while the connection stayed open."""

    @abstractmethod
    def auto_reconnect(self, on: bool) -> None:
        """Choose what a call does when the connection is lost.

        Args:
            on: True opens the connection again; False raises LinkLostError immediately.
        """


class SetPoints(Ability):
    """Takes the set-points of a fast loop without a `JointTarget` of each, which would cost it much of its time."""

    @abstractmethod
    def guide(self, positions: Mapping[str, float], duration: float) -> tuple[tuple[str, float], ...]:
        """`RobotDriver.write` a guided target.

        Args:
            positions: Radians by joint name; any subset of the joints.
            duration: Seconds of the motion.

        Returns:
            What was actually sent, as in `SentTarget.positions`.

        Raises:
            HexwireError: As `RobotDriver.write`.
        """


class SilenceCheck(Ability):
    """The driver finds out why nothing answers."""

    @abstractmethod
    def explain_silence(self) -> list[Finding]:
        """Find out why nothing answered `attach`; empty if no cause is found. Nothing moves.

        Raises:
            LinkError: The port cannot be opened.
        """
