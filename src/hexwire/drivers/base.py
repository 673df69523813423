"""`RobotDriver`: what every robot can be told and asked, whatever board, bus or program is behind it.

Owns the contract between robots and the fronts: the chapter's verbs, and what a robot that cannot do something
says. Must not know any particular robot, how bytes reach it, nor whether a person or a program is asking.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

from hexwire.epochs import Epochs
from hexwire.errors import HexwireError, NotSupportedError, UsageError

from .values import JointProbe, ProbeReport, Signal, StopCause, StopLatch, StopMode

if TYPE_CHECKING:
    from types import TracebackType

    from hexwire.link.diagnose import Finding
    from hexwire.model.arm import ArmModel
    from hexwire.model.state import JointState, JointTarget, SentTarget

__all__ = ["JointProbe", "ProbeReport", "RobotDriver", "Signal", "StopCause", "StopLatch", "StopMode"]

_COMMAND_RATE = 20.0


class RobotDriver(ABC):
    """A robot. Constructing one does no I/O; `attach` does.

    Every robot implements the abstract members. The others have a default for robots without the ability: a
    property that says so, or `NotSupportedError` with a sentence. Times are in seconds, angles in radians.

    A call that needs the robot raises `UsageError` before `attach`, and a `LinkError` or `DeviceError` if the robot
    cannot be reached.

    Attributes:
        model: The arm's joints and limits.
        port_leads_to: The device on a serial port that leads to the robot: a controller board, or an adapter to a
            servo bus.
    """

    model: ArmModel
    port_leads_to: ClassVar[Literal["board", "adapter"]] = "board"

    def __init__(self) -> None:
        self._epochs = Epochs()

    # -- what it is, without asking it ----------------------------------------------------------------

    @property
    def url(self) -> str:
        """Address of the robot, as in ``serial:///dev/ttyUSB0``; empty if it has none."""
        return ""

    @property
    @abstractmethod
    def is_attached(self) -> bool:
        """Whether the connection is open; `attach` opens it, `detach` and `abort` close it."""

    @property
    def epochs(self) -> Epochs:
        """The stops of this robot, and what they void."""
        return self._epochs

    @property
    def command_rate(self) -> float:
        """Targets per second that the robot accepts while it is being read too; known once it is attached."""
        return _COMMAND_RATE

    @property
    def has_watchdog(self) -> bool:
        """Whether the robot can stop by itself when this program falls silent; known once it is attached."""
        return False

    @property
    def reports_states(self) -> bool:
        """Whether the robot can send states without being asked, see `stream`; known once it is attached."""
        return False

    @property
    def stop_kept_by(self) -> str:
        """Who keeps a stop beyond this program: ``board``, ``user`` (a file of this user's), or nobody if empty."""
        return "board"

    def now(self) -> float:
        """Seconds of the clock that the stamps of states count in; monotonic."""
        return time.monotonic()

    # -- what was counted -----------------------------------------------------------------------------

    @property
    def round_trips(self) -> Sequence[float]:
        """Seconds from request to answer, the newest last; empty if they are not measured."""
        return ()

    @property
    def restarts(self) -> int:
        """Resets of the board that were noticed while the connection stayed open."""
        return 0

    def host_counters(self) -> dict[str, int]:
        """This side's counters (requests, retries, dropped frames and so on) by name; sends nothing."""
        return {}

    def board_counters(self) -> dict[str, int]:
        """The board's own counters since its reset, by name; empty if it has none.

        Raises:
            HexwireError: The board does not answer.
        """
        return {}

    # -- when this program falls silent ---------------------------------------------------------------

    @property
    def watchdog_armed(self) -> bool:
        """Whether a watchdog is armed from here."""
        return False

    def watchdog(self, timeout: float, mode: StopMode = StopMode.HOLD) -> None:
        """Have the robot stop by itself when this program sends nothing for a while.

        Args:
            timeout: Seconds of silence; 0 switches it off.
            mode: What the robot does then.

        Raises:
            NotSupportedError: Nothing behind this robot can do that; see `has_watchdog`.
            UsageError: The time is outside the robot's range.
        """
        raise NotSupportedError(f"nothing behind {self.model.name} stops it when this program falls silent")

    @contextmanager
    def watched(
        self, timeout: float = 1.0, mode: StopMode = StopMode.HOLD, *, always: bool = False
    ) -> Iterator[bool]:
        """While this lasts, the board stops the arm if this program dies or stalls; around everything that moves.

        Whatever is sent feeds the watchdog, so that who sends nothing for `timeout` seconds is stopped. At the end
        it is off again; one that was armed before stays. Where the arm is stopped, nothing is armed
        unless `always`.

        Args:
            timeout: Seconds of silence.
            mode: What the board does then.
            always: Arm it though the arm is stopped; the board forgets then that its watchdog has tripped.

        Yields:
            Whether somebody stands by; False where the robot has nobody who could.
        """
        if not self.has_watchdog:
            yield False
            return
        armed = not self.watchdog_armed and (always or not self.read().stopped)
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

    # -- the verbs ------------------------------------------------------------------------------------

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
        """Open the connection and find out who is there. Nothing moves.

        Raises:
            LinkError: The port cannot be opened.
            ReplyTimeoutError: Nobody answers.
        """

    @abstractmethod
    def detach(self, *, torque_off: bool = False) -> None:
        """Close the connection. Harmless if it is closed.

        Args:
            torque_off: Take the torque away first. Without it the joints hold what they hold.
        """

    @abstractmethod
    def probe(self) -> ProbeReport:
        """Ask the board and each servo who they are and how they do."""

    @abstractmethod
    def read(self) -> JointState:
        """Read all joints. A silent servo does not raise: its joint says so."""

    def stream(self, period: float, timeout: float = 1.0, *, slow: float | None = None) -> Iterator[JointState]:
        """Yield the states that the robot sends without being asked, until the caller stops iterating.

        Args:
            period: Seconds between two states.
            timeout: Seconds of silence after which the robot is asked whether it is there; the iterator ends if the
                robot answers but sends no states.
            slow: Seconds between two readings of what changes slowly (voltage, temperature, current), if leaving
                that out makes reports shorter; None puts everything into every report.

        Raises:
            NotSupportedError: The robot sends none, see `reports_states`; `read` asks for one.
            ReplyTimeoutError: The robot is not there any more.
            UsageError: The period is outside the robot's range.
        """
        raise NotSupportedError(f"{self.model.name} sends no states by itself; read() asks for one")

    def discard_reports(self) -> None:  # noqa: B027  # a robot that sends none has none to forget
        """Discard states that were sent and not read yet: they are older than the last answer.

        Raises:
            LinkError: The line is lost.
        """

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

    def stop_latch(self) -> StopLatch:
        """Read whether the robot is stopped, and what has stopped it since the last `resume`.

        Raises:
            HexwireError: As `read`.
        """
        state = self.read()
        if not (state.stopped or self.epochs.failed):
            return StopLatch(StopCause.NONE)
        if state.watchdog_tripped:
            return StopLatch(StopCause.WATCHDOG)
        return StopLatch(StopCause.HERE if self.epochs.stopped else StopCause.ELSEWHERE)

    def ping(self, servo_id: int) -> int | None:
        """Ask one servo whether it is there.

        Args:
            servo_id: Its id on the bus, of this arm or not.

        Returns:
            Its error byte (0 = none), or None if it does not answer.

        Raises:
            NotSupportedError: The robot has no servos that can be asked one by one.
        """
        raise NotSupportedError(f"robot {self.model.name} has no servos that can be asked one by one")

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

    # -- what is wrong with it ------------------------------------------------------------------------

    def examine(self) -> list[Finding]:
        """Check the attached robot; each finding says what to do. Nothing moves.

        Raises:
            HexwireError: As `probe` and `read`.
        """
        from .checkup import examine

        return examine(self.probe(), self.read())

    def explain_silence(self) -> list[Finding]:
        """Find out why nobody answered `attach`; empty if no more can be found out. Nothing moves.

        Raises:
            LinkError: The port cannot be opened.
        """
        return []

    # -- losing it ------------------------------------------------------------------------------------

    def auto_reconnect(self, on: bool) -> None:  # noqa: B027  # not every robot has a connection to lose
        """Choose what a call does when the connection is lost.

        Args:
            on: Open the connection again; otherwise raise LinkLostError immediately.
        """

    def abort(self) -> None:
        """Close the connection from any thread; a call that waits in another thread ends with a LinkError.

        Nothing is sent. For a robot whose calls never wait, this is `detach`.
        """
        self.detach()

    def __enter__(self) -> Self:
        if not self.is_attached:
            self.attach()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.detach()
