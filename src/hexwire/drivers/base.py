"""`RobotDriver`: what every robot can be told, whatever board or bus is behind it.

Owns the abstract driver with the chapter's verbs and the values they share. Must not know any particular
robot, nor whether a person or a program is asking.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any, Self

from hexwire.errors import CommandRefusedError, HexwireError, NotSupportedError, StoppedError, UsageError
from hexwire.model.state import JointFlag
from hexwire.wire.command_frame import Command, Status, command_name, status_name

if TYPE_CHECKING:
    from types import TracebackType

    from hexwire.epochs import Epochs
    from hexwire.ipc.session import Session
    from hexwire.model.arm import ArmModel
    from hexwire.model.state import JointState, JointTarget, SentTarget
    from hexwire.session.events import Reply

__all__ = ["JointProbe", "ProbeReport", "RobotDriver", "Signal", "StopMode", "check_reply", "torque_flag"]


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

    @property
    def missing(self) -> tuple[str, ...]:
        """Names of the joints whose servo does not answer."""
        return tuple(joint.name for joint in self.joints if not joint.present)


class RobotDriver(ABC):
    """A robot behind a session. Constructing one does no I/O; `attach` does.

    Args:
        session: The conversation with the board or robot controller.

    Attributes:
        model: The arm's joints and limits.
    """

    model: ArmModel

    def __init__(self, session: Session) -> None:
        self.session = session

    @property
    def sessions(self) -> tuple[Session, ...]:
        """Every session that leads to this robot."""
        return (self.session,)

    @property
    def command_rate(self) -> float:
        """Targets a second that the line takes, besides being read."""
        return _COMMAND_RATE

    @property
    def epochs(self) -> Epochs:
        """The stops of this robot, and what they void."""
        return self.session.epochs

    @property
    def stop_kept_by(self) -> str:
        """Who keeps a stop beyond this program: ``board``, ``user`` (a file of this user's), or nobody if empty."""
        return "board"

    # -- when this program falls silent ---------------------------------------------------------------

    @property
    def has_watchdog(self) -> bool:
        """Whether the board can stop by itself when this program falls silent."""
        return False

    @property
    def stands_by(self) -> bool:
        """Whether a watchdog is armed from here: the board stops by itself when this program falls silent."""
        return False

    def watchdog(self, timeout: float, mode: StopMode = StopMode.HOLD) -> None:
        """Have the board stop by itself when nothing comes from this program for `timeout` seconds; 0 = never.

        Raises:
            NotSupportedError: Nothing behind this robot can do that.
        """
        raise NotSupportedError(f"nothing behind {self.model.name} stops it when this program falls silent")

    @contextmanager
    def watched(self, timeout: float = 1.0, mode: StopMode = StopMode.HOLD) -> Iterator[bool]:
        """While this lasts, the board stops the arm if this program dies or stalls; around everything that moves.

        Whatever is sent feeds the watchdog, so that who sends nothing for `timeout` seconds is stopped. At the end
        it is off again; one that was armed before stays. Where the arm is stopped, nothing is armed.

        Args:
            timeout: Seconds of silence.
            mode: What the board does then.

        Yields:
            Whether somebody stands by; False where the robot has nobody who could.
        """
        if not self.has_watchdog:
            yield False
            return
        armed = not self.stands_by and not self.read().stopped
        if armed:
            self.watchdog(timeout, mode)
        try:
            yield True
        except BaseException:
            if armed:
                # What went wrong is what is to be heard of, not that this fails as well.
                with suppress(HexwireError):
                    self.watchdog(0.0)
            raise
        if armed:
            self.watchdog(0.0)

    @classmethod
    @abstractmethod
    def from_url(cls, url: str, **options: Any) -> Self:
        """A driver over the link that `url` names; not attached yet.

        Args:
            url: As in ``serial:///dev/ttyUSB0?baud=115200``.
            **options: The driver's own.

        Raises:
            UsageError: The URL makes no sense.
        """

    @abstractmethod
    def attach(self) -> None:
        """Open the session and find out who is there. Nothing moves.

        Raises:
            LinkError: The port cannot be opened.
            ReplyTimeoutError: Nobody answers.
        """

    @abstractmethod
    def detach(self, *, torque_off: bool = False) -> None:
        """Close the session. Harmless if it is closed.

        Args:
            torque_off: Take the torque away first. Without it the joints hold what they hold.
        """

    @abstractmethod
    def probe(self) -> ProbeReport:
        """Ask the board and each servo who they are and how they do."""

    @abstractmethod
    def read(self) -> JointState:
        """Read all joints. A silent servo does not raise: its joint says so."""

    @abstractmethod
    def write(self, target: JointTarget) -> SentTarget:
        """Send joints to a target and return at once with what was really sent.

        Raises:
            LimitError: A target is outside the limits; nothing was sent.
            StoppedError: A stop is latched.
            CommandRefusedError: For one, a joint has no torque.
        """

    @abstractmethod
    def ioctl(self, sub_cmd: int, data: bytes = b"") -> bytes:
        """Special commands; each driver documents its own.

        Raises:
            NotSupportedError: This robot, board or dialect has no such command.
        """

    @abstractmethod
    def torque(self, on: bool, joints: Sequence[str] | None = None) -> tuple[str, ...]:
        """Torque on, without moving, or off.

        Args:
            on: Which.
            joints: Names; all if None.

        Returns:
            Names of the joints that confirmed it.
        """

    @abstractmethod
    def stop(self, mode: StopMode = StopMode.HOLD) -> tuple[str, ...]:
        """Latched stop, ahead of everything else, from any thread.

        Returns:
            Names of the joints that confirmed it.
        """

    @abstractmethod
    def resume(self) -> None:
        """End a stop. Nothing moves by it."""

    def signal(self, number: int) -> None:
        """Send a `Signal` by number, as the chapter's drivers do.

        Raises:
            UsageError: There is no such signal.
        """
        try:
            signal = Signal(number)
        except ValueError:
            known = ", ".join(f"{s.value} {s.name}" for s in Signal)
            raise UsageError(f"no signal {number}; there are {known}") from None
        if signal is Signal.RESUME:
            self.resume()
        elif signal is Signal.STOP or signal is Signal.STOP_TORQUE_OFF:
            self.stop(StopMode.HOLD if signal is Signal.STOP else StopMode.TORQUE_OFF)
        else:
            self.torque(signal is Signal.TORQUE_ON)

    def __enter__(self) -> Self:
        if not self.session.is_open:
            self.attach()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.detach()


_COMMAND_RATE = 20.0
_ADVICE: dict[int, str] = {
    Status.STOPPED: "the arm is stopped; `hexwire resume` ends that",
    Status.TORQUE_OFF: "a joint has no torque; `hexwire torque on` first",
    Status.BUSY: "the board is busy; try again",
    Status.SERVO_SILENT: "a servo does not answer; `hexwire ping` tells which",
    Status.SERVO_FAULT: "a servo is not in position mode; set its register `mode` to 0 in maintenance",
    Status.FORBIDDEN: (
        "the board lets no such packet to a servo: move joints with `write`, give torque with `torque`; "
        "settings of servos need `maintenance(True)`, and nothing moves until `maintenance(False)`"
    ),
}
_FORBIDDEN_MAINTENANCE = "a joint has torque; `hexwire torque off` first"
_FORBIDDEN_MOTION = "the board is in maintenance; `maintenance(False)` ends that"


def torque_flag(torque: bool | None) -> int:
    """The flag of a joint whose torque is on, off, or not known."""
    if torque is None:
        return int(JointFlag.TORQUE_UNKNOWN)
    return int(JointFlag.TORQUE_ON) if torque else 0


def check_reply(reply: Reply, *accepted: Status) -> Reply:
    """Turn a status other than ok into an error.

    Args:
        reply: The reply.
        *accepted: Further status codes that the caller will look at itself.

    Raises:
        StoppedError: The arm is stopped.
        CommandRefusedError: Any other status.
    """
    status = reply.status
    if status == Status.OK or status in accepted:
        return reply
    reason = _ADVICE.get(status) or status_name(status)
    if status == Status.FORBIDDEN and reply.cmd == Command.MAINTENANCE:
        reason = _FORBIDDEN_MAINTENANCE
    elif status == Status.FORBIDDEN and reply.cmd in (Command.JOINT_MOVE, Command.TORQUE, Command.SYNC_WRITE):
        reason = _FORBIDDEN_MOTION
    kind = StoppedError if status == Status.STOPPED else CommandRefusedError
    raise kind(command_name(reply.cmd), status, reason)
