"""`RobotDriver`: the interface of every robot, whatever board, bus or program is behind it.

Owns the contract between robots and fronts: the chapter's verbs, and what a robot without an ability answers. Must
not know any particular robot.
"""

from __future__ import annotations

import inspect
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial, wraps
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

from hexwire.arguments import DATA, FLAG, NAME, NAMES, SECONDS, WHOLE, Wanted, check, checked, one_of, or_none
from hexwire.epochs import Epochs
from hexwire.errors import HexwireError, LinkError, NotSupportedError, ReplyTimeoutError, StoppedError, UsageError
from hexwire.model.state import JointState, JointTarget, NewestState, SentTarget

from .abilities import Counters, ObeysGains, Watchdog
from .robot_state import RobotState
from .values import JointProbe, ProbeReport, Signal, StopCause, StopLatch, StopMode

if TYPE_CHECKING:
    from types import TracebackType

    from hexwire.link.diagnose import Finding
    from hexwire.model.arm import ArmModel
    from hexwire.model.kinematics import KinematicModel


__all__ = ["JointProbe", "ProbeReport", "RobotDriver", "RobotState", "Signal", "StopCause", "StopLatch", "StopMode"]

_COMMAND_RATE = 20.0


# An int, too: programs write 0 and 1 as the chapter does. But not a bool, which says nothing.
_MODE = Wanted("a StopMode", lambda value: WHOLE.fits(value) and value in (*StopMode,))
_TARGET = Wanted("a JointTarget, as in JointTarget.of({'J1': 0.1})", lambda value: isinstance(value, JointTarget))
_MANY = or_none(NAMES)
_ABILITY = Wanted("an ability, as in can(Watchdog)", lambda value: isinstance(value, type))
_ARGUMENTS: dict[str, dict[str, Wanted]] = {
    "can": {"kind": _ABILITY},
    "torque": {"on": FLAG, "joints": _MANY},
    "path": {"joints": _MANY, "smooth": FLAG, "brake": or_none(SECONDS), "outlives": FLAG},
    "clear_path": {"joints": _MANY},
    "stop": {"mode": _MODE},
    "watchdog": {"timeout": SECONDS, "mode": _MODE},
    "watched": {"timeout": SECONDS, "mode": _MODE, "always": FLAG},
    "take": {"force": or_none(FLAG)},
    "release": {"finish": FLAG},
    "stream": {"period": SECONDS, "timeout": SECONDS, "slow": or_none(SECONDS)},
    "read_positions": {"within": SECONDS},
    "ioctl": {"sub_cmd": WHOLE, "data": DATA},
    "may_move": {"sub_cmd": WHOLE, "data": DATA},
    "ping": {"servo_id": WHOLE},
    "read_table": {"joint": NAME, "first": WHOLE, "count": or_none(WHOLE)},
    "write_table": {"joint": NAME, "first": WHOLE, "data": DATA},
    "auto_reconnect": {"on": FLAG},
}
"""The arguments of methods that robots define."""


def _check_arguments(cls: Any) -> None:
    """Have the methods of a robot refuse what a program passes by mistake, before anything is sent."""
    for name, wanted in ({"write": {}} | _ARGUMENTS | cls._arguments).items():
        owner = next((base for base in cls.__mro__ if name in vars(base)), None)
        # A robot class above has this already, but a class that only adds methods has not.
        if owner is not None and (owner is cls or not issubclass(owner, RobotDriver)):
            method = vars(owner)[name]
            if (adding := _WRAPPED.get(name)) is not None:
                method = adding(method)
            setattr(cls, name, checked(method, wanted) if wanted else method)


def _refusing(write: Callable[..., SentTarget]) -> Callable[..., SentTarget]:
    """Have a robot refuse what is no target, and gains that it would not obey, rather than follow without them."""

    @wraps(write)
    def refusing(self: RobotDriver, target: JointTarget) -> SentTarget:
        if type(target) is not JointTarget:
            check("write", "target", _TARGET, target)
        if target.laws:
            ObeysGains.of(self)
        return write(self, target)

    return refusing


def _voiding(torque: Callable[..., tuple[str, ...]]) -> Callable[..., tuple[str, ...]]:
    """Have torque off void what was asked for before it, which would give torque again; no stop voids it."""

    @wraps(torque)
    def voiding(self: RobotDriver, on: bool, joints: Sequence[str] | None = None) -> tuple[str, ...]:
        if on:
            return torque(self, on, joints)
        return self.epochs.free(partial(torque, self, on, joints))

    return voiding


_WRAPPED: dict[str, Callable[[Callable[..., Any]], Callable[..., Any]]] = {
    "write": _refusing,
    "torque": _voiding,
}
"""What every robot adds to methods of these names."""


class RobotDriver(ABC):
    """A robot. The constructor does no I/O; `attach` does.

    Every robot implements the abstract members; the others have a default. What only some robots can do is in
    `hexwire.drivers.abilities`, and `can` says whether this one can. Times are in seconds, angles in radians.

    A call that needs the robot raises `UsageError` before `attach`, and a `LinkError` or `DeviceError` if the robot
    cannot be reached.

    Attributes:
        model: The arm's joints and limits; fixed, but for the first `attach` of a robot with `StoredCalibration`.
        port_leads_to: The device on a serial port that leads to the robot: a controller board, or an adapter to a
            servo bus.
    """

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if hasattr(cls, "watchdog") and not issubclass(cls, Watchdog):
            # Nobody would find it, and motions would begin without it.
            raise TypeError(f"{cls.__name__} has a watchdog: derive it from hexwire.drivers.abilities.Watchdog too")
        # Here rather than in each robot.
        _check_arguments(cls)

    _arguments: ClassVar[dict[str, dict[str, Wanted]]] = {}
    """The arguments of a robot's own methods, as `_ARGUMENTS`."""

    model: ArmModel
    port_leads_to: ClassVar[Literal["board", "adapter"]] = "board"

    _kinematics: KinematicModel | None = None

    def __init__(self) -> None:
        self._epochs = Epochs()

    # -- properties; nothing is sent ------------------------------------------------------------------

    @property
    def url(self) -> str:
        """Address of the robot, as in ``serial:///dev/ttyUSB0``; empty if it has none."""
        return ""

    @property
    @abstractmethod
    def is_attached(self) -> bool:
        """Whether the connection is open; `attach` opens it, `detach` and `abort` close it."""

    @property
    def kinematics(self) -> KinematicModel | None:
        """The arm's geometry, with which its motions are planned and checked; None for an arm without a known one.

        By default that of `model`. Set another one for other links, as in
        ``arm.kinematics = kinematics_for(arm.model, "B")``.
        """
        if self._kinematics is None:
            from hexwire.model.geometry import kinematics_for

            self._kinematics = kinematics_for(self.model)
        return self._kinematics

    @kinematics.setter
    def kinematics(self, kinematics: KinematicModel) -> None:
        from hexwire.model.kinematics import KinematicModel

        check(type(self).__name__, "kinematics", or_none(one_of(KinematicModel)), kinematics)
        self._kinematics = kinematics

    @property
    def epochs(self) -> Epochs:
        """The stops of this robot, and the calls that they cancel."""
        return self._epochs

    @property
    def command_rate(self) -> float:
        """Targets per second that the robot accepts while its state is also read; known after `attach`."""
        return _COMMAND_RATE

    def can(self, kind: type[object]) -> bool:
        """Whether the robot has an ability, as in ``robot.can(Watchdog)``; for some, that is known after `attach`.

        By default what the driver derives from. `Ability.find` and `Ability.of` give the robot with the methods.
        """
        return isinstance(self, kind)

    @property
    def stop_kept_by(self) -> str:
        """Where a stop is kept after this program has ended.

        ``board``, ``server`` (the program that shares the arm), ``user`` (a file of this user), or empty for
        nowhere.
        """
        return "board"

    def now(self) -> float:
        """Present time of the clock that stamps states, seconds; monotonic."""
        return time.monotonic()

    # -- watchdog -------------------------------------------------------------------------------------

    @contextmanager
    def watched(
        self, timeout: float = 1.0, mode: StopMode = StopMode.HOLD, *, always: bool = False
    ) -> Iterator[bool]:
        """Arm the watchdog for a `with` block, so that the robot stops if this program dies or stalls.

        Put it around everything that moves. Every request feeds the watchdog. On exit the watchdog is disarmed,
        unless it was armed before.

        Args:
            timeout: Seconds of silence.
            mode: How the robot stops.
            always: Arm it even if the arm is stopped; the board then forgets that its watchdog has tripped.

        Yields:
            Whether a watchdog protects the block; False if the robot has none.

        Raises:
            StoppedError: The arm is stopped, and `always` is not set. Otherwise the block would move an arm that
                somebody resumes meanwhile, without a watchdog.
        """
        dog = Watchdog.find(self)
        if dog is None:
            yield False
            return
        armed = not dog.watchdog_armed
        if armed:
            if not always and (state := self.read()).stopped:
                why = f" (its watchdog stopped it because {state.trip_reason})" if state.watchdog_tripped else ""
                text = f"the arm is stopped{why}; `hexwire resume` ends that"
                raise StoppedError.unsent("a motion", StoppedError.STATUS, text)
            dog.watchdog(timeout, mode)
        try:
            yield True
        except BaseException:
            if armed:
                # Report the original error, not a failure to disarm.
                with suppress(HexwireError):
                    dog.watchdog(0.0)
            raise
        if armed:
            dog.watchdog(0.0)

    # -- verbs ----------------------------------------------------------------------------------------

    @classmethod
    def from_url(cls, url: str, **options: Any) -> Self:
        """Make a driver for the link that `url` names; it is not attached yet.

        By default the only robot of its kind, wherever `url` leads.

        Args:
            url: As in ``serial:///dev/ttyUSB0?baud=115200``.
            **options: Options of the driver; by default arguments of the constructor.

        Raises:
            UsageError: The URL is invalid, or there is no such option.
        """
        known = inspect.signature(cls).parameters
        takes_any = any(row.kind is row.VAR_KEYWORD for row in known.values())
        if (unknown := set(options) - set(known)) and not takes_any:
            raise UsageError(f"a {cls.__name__} has no option {', '.join(sorted(unknown))}")
        return cls._on_link(url, options)

    @classmethod
    def _on_link(cls, url: str, options: dict[str, Any]) -> Self:
        """Make the driver, given options that its constructor has."""
        return cls(**options)

    @abstractmethod
    def attach(self) -> None:
        """Open the connection and identify the robot; nothing is sent that moves it.

        A board with the chapter's sketch is an exception that no host can prevent: see `Hex7BotDriver.attach`.

        Raises:
            LinkError: The port cannot be opened.
            ReplyTimeoutError: Nothing answers.
        """

    @abstractmethod
    def detach(self, *, torque_off: bool = False) -> None:
        """Close the connection; does nothing if it is closed.

        Args:
            torque_off: Switch the torque off first; otherwise the joints keep their torque.
        """

    def probe(self) -> ProbeReport:
        """Identify the board and each servo, and report what is wrong with them.

        By default the joints of `model`, and what `read` says of them.
        """
        state, joints, counters = self.read(), self.model.joints, Counters.find(self)
        return ProbeReport(
            robot=self.model.name,
            link=self.url,
            stopped=state.stopped,
            joints=tuple(JointProbe(j.name, j.servo_id, j.series, j.name not in state.silent) for j in joints),
            counters={} if counters is None else counters.host_counters(),
        )

    @abstractmethod
    def read(self) -> JointState:
        """Read all joints. A silent servo raises no error; its joint has the flag `JointFlag.SILENT`."""

    def newest(self) -> NewestState:
        """The newest state that is there, at once, with its age.

        A robot that sends no states unasked is asked, as by `read`. One that does may have sent it before the last
        order of this program was carried out.

        Raises:
            HexwireError: As `read`.
        """
        state = self.read()
        return NewestState(state, max(0.0, self.now() - state.stamp))

    def read_positions(self, within: float = 0.0) -> JointState:
        """Read at least the positions of all joints, in the shortest time; the rest may be NaN. Else as `read`.

        Args:
            within: The last state will do if it is not older than this, seconds: where reading costs a loop much
                of its time. Drivers may read in any case.
        """
        return self.read()

    def read_loads(self) -> JointState:
        """Read at least positions and loads, in the shortest time; the rest may be NaN. Else as `read`."""
        return self.read()

    @abstractmethod
    def write(self, target: JointTarget) -> SentTarget:
        """Send joints to a target and return, without waiting for the motion, what was actually sent.

        Raises:
            LimitError: A target is outside the limits; nothing was sent.
            NotSupportedError: The target has gains, and the robot obeys none, see `ObeysGains`.
            StoppedError: A stop is latched.
            CommandRefusedError: The robot refuses, for example because a joint has no torque.
        """

    def ioctl(self, sub_cmd: int, data: bytes = b"") -> bytes:
        """Send a special command; each driver documents its own.

        Raises:
            NotSupportedError: This robot, board or dialect has no such command.
        """
        raise NotSupportedError(f"{self.model.name} has no special commands")

    def may_move(self, sub_cmd: int, data: bytes = b"") -> bool:
        """Whether a special command may move joints; True if the driver does not know."""
        return True

    @abstractmethod
    def torque(self, on: bool, joints: Sequence[str] | None = None) -> tuple[str, ...]:
        """Switch torque on, without motion, or off.

        Args:
            on: True for on, False for off.
            joints: Names; all if None.

        Returns:
            Names of the joints that confirmed it.
        """

    @abstractmethod
    def stop(self, mode: StopMode = StopMode.HOLD) -> tuple[str, ...]:
        """Stop the robot until `resume`, ahead of all other requests; may be called from any thread.

        Returns:
            Names of the joints that confirmed it.
        """

    @abstractmethod
    def resume(self) -> None:
        """End a stop. Nothing moves."""

    def stop_latch(self) -> StopLatch:
        """Read whether the robot is stopped, and what stopped it since the last `resume`.

        Raises:
            HexwireError: As `read`.
        """
        state = self.read()
        if not (state.stopped or self.epochs.failed):
            return StopLatch(StopCause.NONE)
        if state.watchdog_tripped:
            return StopLatch(StopCause.WATCHDOG)
        return StopLatch(StopCause.HERE if self.epochs.stopped else StopCause.ELSEWHERE)

    def robot_state(self) -> RobotState:
        """The state of the whole robot, the chapter's ``m_rbtState``; reads the joints if it is attached.

        Raises:
            HexwireError: As `read`, except that a robot without an answer is LOST.
        """
        if not self.is_attached:
            return RobotState.DETACHED
        try:
            return RobotState.of(self.read())
        except (LinkError, ReplyTimeoutError):
            return RobotState.LOST

    def signal(self, number: int) -> None:
        """Send a `Signal` by number.

        Raises:
            UsageError: There is no such signal.
        """
        check("signal", "number", WHOLE, number)
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

    # -- diagnosis ------------------------------------------------------------------------------------

    def examine(self) -> list[Finding]:
        """Check the attached robot; each finding says what to do. Nothing moves.

        Raises:
            HexwireError: As `probe` and `read`.
        """
        from .checkup import examine

        return examine(self.probe(), self.read())

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


# What a robot does not define is the same for all of them.
_check_arguments(RobotDriver)
