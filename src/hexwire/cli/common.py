"""What the commands share: options, opening a robot, JSON and aligned text.

Owns the options that say which robot is meant, and the form of what is printed. Must not know any one command.
"""

from __future__ import annotations

import functools
import math
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, Any, TypeVar

import click

from hexwire.errors import UsageError

from .exits import note
from .output import format_table, print_json

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver, StopMode
    from hexwire.model.arm import ArmModel
    from hexwire.model.state import JointReading, JointState

__all__ = [
    "FiniteFloat",
    "RobotOptions",
    "attached",
    "confirm",
    "early_port",
    "fault_names",
    "force_option",
    "format_table",
    "group_port_option",
    "joint_json",
    "json_option",
    "line_options",
    "make_robot",
    "name_of",
    "numbers_argument",
    "observing_states",
    "on_terminal",
    "open_robot",
    "port_option",
    "print_json",
    "raise_if_silent",
    "refuse_idle_force",
    "refuse_table",
    "resolve_url",
    "robot_options",
    "table_options",
    "watched",
]

_F = TypeVar("_F", bound=Callable[..., Any])

DEFAULT_ROBOT = "hex7bot"
_TYPED = click.core.ParameterSource.COMMANDLINE

_StateObserver = Callable[["JointState"], None]
_state_observer: ContextVar[_StateObserver | None] = ContextVar("hexwire_state_observer", default=None)

_WATCHDOG, _PERIODS = 1.0, 4.0
"""Seconds, and cycles, of silence after which the board stops the arm by itself."""
_PATIENCE = 1.0
"""Seconds without an answer after which a person is told what is being waited for."""


class FiniteFloat(click.ParamType[float]):
    """A number that is neither infinite nor NaN, with bounds.

    Args:
        name: What help calls it, as in ``SECONDS``.
        minimum: Smallest value.
        above: The value must be above this one.
    """

    def __init__(self, name: str, *, minimum: float = -math.inf, above: float = -math.inf) -> None:
        self.name = name
        self._minimum = minimum
        self._above = above

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a number", param, ctx)
        if number < self._minimum:
            self.fail(f"{value} is less than {self._minimum:g}", param, ctx)
        if number <= self._above:
            self.fail(f"{value} is not above {self._above:g}", param, ctx)
        return number


def numbers_argument(name: str, metavar: str, kind: FiniteFloat) -> Callable[[_F], _F]:
    """An argument of several numbers, which usage and errors call by what is typed.

    Args:
        name: Of the command's parameter.
        metavar: As ``X Y Z``: a word a number.
        kind: What each is.
    """
    count = len(metavar.split())

    def check(ctx: click.Context, param: click.Parameter, value: tuple[float, ...]) -> tuple[float, ...]:
        if len(value) != count:
            raise click.UsageError(f"{metavar} takes {count} values, not {len(value)}", ctx)
        return value

    return click.argument(name, nargs=-1, required=True, type=kind, metavar=metavar, callback=check)


# -- which robot ----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class RobotOptions:
    """Which robot, and how to reach it.

    Attributes:
        port: URL of the link or path of the serial device; the only likely board if None.
        robot: Name in the registry.
        baud: Rate of a serial port; the link's own if None.
        dialect: Ask only in this dialect; both if None.
        timeout: Seconds to wait for a board that is booting; the driver's own if None.
    """

    port: str | None
    robot: str
    baud: int | None
    dialect: int | None
    timeout: float | None


def port_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """``--port``, which may stand before the command as well, and which HEXWIRE_PORT sets too."""

    @functools.wraps(command)
    def packed(*args: Any, port: str | None, **rest: Any) -> Any:
        return command(*args, port=early_port(port), **rest)

    return click.option(
        "--port",
        metavar="URL",
        envvar="HEXWIRE_PORT",
        show_envvar=True,
        help="Device or link, as /dev/ttyUSB0 or tcp://host:port. Not needed if one likely board is plugged in.",
    )(packed)


group_port_option = click.option(
    "--port", metavar="URL", help="Where it is, for every command below that takes --port."
)
"""``--port`` of a group: `hexwire bus --port URL scan`."""


def early_port(port: str | None) -> str | None:
    """The port of this command: typed behind it, else before it, else `port`, as from the environment."""
    if _is_typed("port"):
        return port
    context = click.get_current_context().parent
    while context is not None:
        early: str | None = context.params.get("port")
        if early:
            return early
        context = context.parent
    return port


def line_options(command: _F) -> _F:
    """``--baud``, ``--dialect`` and ``--timeout``: how to speak to the board."""
    command = click.option(
        "--timeout",
        type=FiniteFloat("seconds", minimum=0),
        metavar="SECONDS",
        help="How long to wait for a board that does not answer yet (5, enough for one that boots).",
    )(command)
    command = click.option(
        "--dialect", type=click.IntRange(1, 2), metavar="1|2", help="Ask in this dialect only, not in both."
    )(command)
    return click.option("--baud", type=click.IntRange(min=1), metavar="N", help="Rate of a serial port (115200).")(
        command
    )


def robot_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """``--port``, ``--robot`` and how to speak to it; the command gets them as ``options: RobotOptions``."""

    @functools.wraps(command)
    def packed(
        *args: Any,
        port: str | None,
        robot: str | None,
        baud: int | None,
        dialect: int | None,
        timeout: float | None,
        **rest: Any,
    ) -> Any:
        # It may stand before the command as well: `hexwire --robot puma260 state`.
        robot = robot or click.get_current_context().find_root().params.get("robot") or DEFAULT_ROBOT
        return command(*args, options=RobotOptions(port, robot, baud, dialect, timeout), **rest)

    robot_option = click.option(
        "--robot", metavar="NAME", help=f"Which robot is behind the port.  [default: {DEFAULT_ROBOT}]"
    )
    return port_option(robot_option(line_options(packed)))


def table_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """``--table`` and ``--no-table``; the command gets ``table``: metres above the arm's base, or None for none."""

    @functools.wraps(command)
    def packed(*args: Any, table: float, no_table: bool, **rest: Any) -> Any:
        if no_table and _is_typed("table"):
            raise UsageError("--table and --no-table contradict each other")
        return command(*args, table=None if no_table else table / 1000, **rest)

    height = click.option(
        "--table",
        type=FiniteFloat("mm"),
        default=0.0,
        show_default=True,
        metavar="MM",
        help="Height of the table above the arm's base.",
    )
    return height(
        click.option("--no-table", is_flag=True, help="There is no table that the arm could hit.")(packed)
    )


def _is_typed(option: str) -> bool:
    return click.get_current_context().get_parameter_source(option) is _TYPED


def refuse_table(model: ArmModel) -> None:
    """Refuse ``--table`` for an arm without a geometry: somebody would rely on what nobody looks at.

    Raises:
        UsageError: It was typed.
    """
    if _is_typed("table"):
        raise UsageError(f"no geometry of {model.name}, so nothing can be said of a table; leave out --table")


def resolve_url(port: str | None, baud: int | None = None) -> str:
    """The URL to open.

    Args:
        port: As typed; the only likely board's if None.
        baud: Rate for a serial port.

    Raises:
        LinkNotFoundError: None was named and none is plugged in.
        UsageError: Several may be meant, or `baud` does not go with the URL.
    """
    if not port:
        from hexwire.link.ports import find_only_board

        port = find_only_board()
    if baud is None:
        return port
    from hexwire.link.url import parse_url

    url = parse_url(port)
    if url.scheme != "serial":
        raise UsageError(f"--baud makes no sense for {port}: only a serial port has a rate")
    if "baud" in url.query:
        raise UsageError(f"--baud {baud} and {port}: name the rate once")
    return f"{port}{'&' if url.query else '?'}baud={baud}"


def make_robot(options: RobotOptions) -> RobotDriver:
    """Build the driver that the options name. Opens nothing; ``with`` attaches it, or use `open_robot`.

    Raises:
        UsageError: No such robot, a malformed URL, or an option that this robot does not know.
        LinkNotFoundError: No port was named and no likely board is plugged in.
    """
    from hexwire.drivers.registry import load_driver

    wanted = {"boot_window": options.timeout, "dialect": options.dialect}
    given = {name: value for name, value in wanted.items() if value is not None}
    return load_driver(options.robot).from_url(resolve_url(options.port, options.baud), **given)


@contextmanager
def open_robot(options: RobotOptions) -> Iterator[RobotDriver]:
    """Make the robot, attach it, and detach it in the end; the torque stays as it is.

    Raises:
        HexwireError: As `make_robot` and `RobotDriver.attach`.
    """
    with attached(make_robot(options)) as robot:
        yield robot


@contextmanager
def attached(robot: RobotDriver) -> Iterator[RobotDriver]:
    """Attach a robot; a person is told if that takes longer than usual."""
    text = f"waiting for an answer on {robot.url} ..."
    patience = threading.Timer(_PATIENCE, note, (text,))
    patience.daemon = True
    if sys.stderr.isatty():
        patience.start()
    try:
        robot.attach()
    finally:
        patience.cancel()
    _show_states(robot)
    try:
        yield robot
    finally:
        robot.detach()


@contextmanager
def watched(robot: RobotDriver, left: float, period: float = 0.0, mode: StopMode | None = None) -> Iterator[bool]:
    """While this lasts, the board stops the arm if this program dies or stalls; told if nobody can.

    Args:
        robot: Attached.
        left: Seconds of motion that the arm may have been sent ahead, to be told of.
        period: Seconds between two cycles of the caller; a slow one gets a more patient watchdog.
        mode: What the board does; holds if None.

    Yields:
        Whether somebody stands by.
    """
    from hexwire.drivers.base import StopMode

    timeout = max(_WATCHDOG, _PERIODS * period)
    with robot.watched(timeout, StopMode.HOLD if mode is None else mode) as covered:
        if not covered:
            note(
                f"note: {robot.model.name} has no watchdog behind this port: "
                f"if this program dies, the arm goes on with what it was sent, for up to {left:.2g} s"
            )
        yield covered


@contextmanager
def observing_states(observer: _StateObserver) -> Iterator[None]:
    """While this lasts, every state that an attached robot reads goes to `observer` too, in the reader's thread.

    It must not fail: see `hexwire.link.tap.Missed.guard`.
    """
    token = _state_observer.set(observer)
    try:
        yield
    finally:
        _state_observer.reset(token)


def _show_states(robot: RobotDriver) -> None:
    observer, read = _state_observer.get(), robot.read
    if observer is None:
        return

    def read_and_show() -> JointState:
        state = read()
        observer(state)
        return state

    robot.read = read_and_show  # type: ignore[method-assign]  # a driver has no other place to look on


# -- what is printed ------------------------------------------------------------------------------------


def confirm(question: str, yes: bool, *, alone: str = "") -> None:
    """Ask a person on standard error before something happens that cannot be taken back; ``--yes`` answers it.

    Args:
        question: Whether to go on.
        yes: It is answered already.
        alone: What to say if nobody is there to answer; the question if empty.

    Raises:
        click.Abort: The answer is no.
        UsageError: Nobody is there to answer.
    """
    if yes:
        return
    if sys.stdin.isatty():
        click.confirm(question, abort=True, err=True)
        return
    # `yes | hexwire ...` counts, too.
    answer = sys.stdin.readline()
    if not answer:
        raise UsageError(alone or f"{question} Nobody is there to answer: say so with --yes")
    if answer.strip().lower() not in ("y", "yes"):
        raise click.Abort


def force_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """``--force``, for a command that writes a file; the command gets ``force``."""

    @functools.wraps(command)
    def packed(*args: Any, force: bool, **rest: Any) -> Any:
        # Beside --record it counts for both files.
        early = click.get_current_context().find_root().params
        return command(*args, force=force or bool(early.get("force")), **rest)

    return click.option("--force", is_flag=True, help="Write over a file that is there.")(packed)


def refuse_idle_force(force: bool, words: str) -> None:
    """Refuse ``--force`` where no file is written: somebody would think that it forces something else.

    Raises:
        UsageError: It was given, and not for --record either.
    """
    if force and not click.get_current_context().find_root().params.get("force"):
        raise UsageError(f"--force is for {words}, and none is named; it lifts no limit")


json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON for a program to read.")


def name_of(file: IO[bytes]) -> str:
    """What an error calls a file that click has opened."""
    name = getattr(file, "name", None)
    return name if isinstance(name, str) and name != "<stdin>" else "standard input"


def on_terminal() -> bool:
    """Whether standard output is a terminal that can be drawn on."""
    import os

    return sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb"


def joint_json(joint: JointReading, model: ArmModel) -> dict[str, object]:
    """One joint for JSON, each key with its unit."""
    from hexwire.model.state import JointFlag

    return {
        "name": joint.name,
        "servo_id": model.joint(joint.name).servo_id,
        "position_rad": joint.position,
        "position_deg": math.degrees(joint.position),
        "velocity_rad_per_s": joint.velocity,
        "velocity_deg_per_s": math.degrees(joint.velocity),
        "load_fraction": joint.load,
        "current_a": joint.current,
        "voltage_v": joint.voltage,
        "temperature_degc": joint.temperature,
        "age_s": joint.age,
        "torque_on": None if joint.flags & JointFlag.TORQUE_UNKNOWN else bool(joint.flags & JointFlag.TORQUE_ON),
        "silent": bool(joint.flags & JointFlag.SILENT),
        "clamped": bool(joint.flags & JointFlag.CLAMPED),
        "faults": fault_names(joint.flags),
    }


def fault_names(flags: int) -> list[str]:
    """Names of what is wrong with a servo, as ``overload``; without silence, which is told apart from faults."""
    from hexwire.model.state import JointFlag

    return [flag.name.lower() for flag in JointFlag(flags).faults & ~JointFlag.SILENT if flag.name]


def raise_if_silent(servos: Sequence[tuple[int, str | None]]) -> None:
    """End with an error that names the servos that did not answer, pairs of id and joint; pass if there is none."""
    from hexwire.errors import ServoError

    if servos:
        names = ", ".join(f"{servo_id} ({joint})" if joint else f"{servo_id}" for servo_id, joint in servos)
        several = len(servos) > 1
        raise ServoError(
            f"servo{'s' if several else ''} {names} {'do' if several else 'does'} not answer: "
            "check cable, power and id",
            servo_id=servos[0][0],
        )
