"""Shared parts of the commands: options, opening a robot, JSON and aligned text.

Owns the options that select a robot, and the format of the output. Must not know any one command.
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
from typing import TYPE_CHECKING, Any, TypeVar

import click

from hexwire.errors import UsageError

from .exits import note
from .numbers import number_option
from .output import format_table, print_json

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.arm import ArmModel
    from hexwire.model.state import JointReading, JointState

__all__ = [
    "RobotOptions",
    "arm_option",
    "attached",
    "confirm",
    "early_port",
    "fault_names",
    "force_option",
    "format_table",
    "group_port_option",
    "host_timed_option",
    "is_typed",
    "joint_json",
    "json_option",
    "line_options",
    "make_robot",
    "observed_driver",
    "observing_states",
    "on_terminal",
    "open_robot",
    "port_option",
    "print_json",
    "raise_if_silent",
    "refuse_idle_force",
    "refuse_idle_table",
    "resolve_url",
    "robot_at_port",
    "robot_options",
    "table_options",
]

_F = TypeVar("_F", bound=Callable[..., Any])
_R = TypeVar("_R", bound="RobotDriver")

DEFAULT_ROBOT = "hex7bot"
_TYPED = click.core.ParameterSource.COMMANDLINE

_StateObserver = Callable[["RobotDriver", "JointState"], None]
_state_observer: ContextVar[_StateObserver | None] = ContextVar("hexwire_state_observer", default=None)

_PATIENCE = 1.0
"""Seconds without an answer after which the command says what it waits for."""


# -- selecting a robot ----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class RobotOptions:
    """The robot and the link to it.

    Attributes:
        port: URL of the link or path of the serial device; the only likely board if None.
        robot: Name in the registry.
        baud: Rate of a serial port; the link's default if None.
        dialect: The only dialect to use; try both if None.
        timeout: Seconds to wait for a board that is booting; the driver's default if None.
        take: Command a shared arm even if another program holds it.
        observed: Its states go to the observer of `observing_states`.
        raise_baud: Rate to which the line is raised once the board is known; None leaves it.
    """

    port: str | None
    robot: str
    baud: int | None
    dialect: int | None
    timeout: float | None
    take: bool = False
    observed: bool = True
    raise_baud: int | None = None


def port_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """``--port``, which may also come before the command or from HEXWIRE_PORT."""

    @functools.wraps(command)
    def packed(*args: Any, port: str | None, **rest: Any) -> Any:
        return command(*args, port=early_port(port), **rest)

    return click.option(
        "--port",
        metavar="URL",
        envvar="HEXWIRE_PORT",
        show_envvar=True,
        help="Device, link, shared or emulated arm, such as /dev/ttyUSB0, tcp://host:port, ipc_msg.conf, "
        "zenoh:lab/arm1 or sim://so101. Optional if one likely board is plugged in.",
    )(packed)


group_port_option = click.option(
    "--port", metavar="URL", help="Port to use, for every command below that takes --port."
)
"""``--port`` of a group: `hexwire bus --port URL scan`."""


def early_port(port: str | None) -> str | None:
    """The port of this command: typed after it, otherwise before it, otherwise `port` (from the environment)."""
    if is_typed("port"):
        return port
    context = click.get_current_context().parent
    while context is not None:
        early: str | None = context.params.get("port")
        if early:
            return early
        context = context.parent
    return port


def line_options(command: _F) -> _F:
    """``--baud``, ``--raise-baud``, ``--dialect`` and ``--timeout``: parameters of the connection to the board."""
    command = number_option(
        "--timeout", "SECONDS", "Time to wait for a board that does not answer yet (5, enough to boot).", minimum=0
    )(command)
    command = click.option(
        "--dialect", type=click.IntRange(1, 2), metavar="1|2", help="Use only this dialect instead of trying both."
    )(command)
    command = click.option(
        "--raise-baud",
        type=click.IntRange(min=1),
        metavar="N",
        help="Raise the rate of the line while this command runs, such as to 500000, if board and line can.",
    )(command)
    return click.option("--baud", type=click.IntRange(min=1), metavar="N", help="Rate of a serial port (115200).")(
        command
    )


def robot_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """``--port``, ``--robot`` and `line_options`; the command gets them as ``options: RobotOptions``."""

    @functools.wraps(command)
    def packed(
        *args: Any,
        port: str | None,
        robot: str | None,
        baud: int | None,
        raise_baud: int | None,
        dialect: int | None,
        timeout: float | None,
        take: bool,
        **rest: Any,
    ) -> Any:
        # It may also come before the command: `hexwire --robot puma260 state`.
        robot = robot or click.get_current_context().find_root().params.get("robot")
        if robot is None:
            robot = robot_at_port(port)
        options = RobotOptions(port, robot, baud, dialect, timeout, take, raise_baud=raise_baud)
        return command(*args, options=options, **rest)

    robot_option = click.option(
        "--robot", metavar="NAME", help=f"Type of robot on the port.  [default: {DEFAULT_ROBOT}]"
    )
    take_option = click.option(
        "--take", is_flag=True, help="Command a shared arm even if another program holds its lease."
    )
    return port_option(robot_option(line_options(take_option(packed))))


def robot_at_port(port: str | None) -> str:
    """Name of the robot, if none is typed: a shared arm is asked."""
    from hexwire.drivers.registry import is_address, make_driver, robot_at

    return make_driver(port).model.name if port and is_address(port) else robot_at(port)


def table_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """``--table`` and ``--no-table``; the command gets ``table``: metres above the arm's base, or None."""

    @functools.wraps(command)
    def packed(*args: Any, table: float, no_table: bool, **rest: Any) -> Any:
        if no_table and is_typed("table"):
            raise UsageError("--table and --no-table contradict each other")
        return command(*args, table=None if no_table else table / 1000, **rest)

    height = number_option("--table", "MM", "Height of the table above the arm's base.", default=0.0)
    return height(
        click.option("--no-table", is_flag=True, help="Do not check for collisions with a table.")(packed)
    )


def is_typed(option: str) -> bool:
    """Whether an option stands on the command line, and is not a default or from the environment."""
    return click.get_current_context().get_parameter_source(option) is _TYPED


def refuse_idle_table(robot: RobotDriver) -> None:
    """Refuse ``--table`` for an arm without a geometry, because the table would not be checked.

    Raises:
        UsageError: ``--table`` was typed.
    """
    if robot.kinematics is None and is_typed("table"):
        raise UsageError(
            f"no geometry is known for {robot.model.name}, so the table cannot be checked; leave out --table"
        )


def resolve_url(port: str | None, baud: int | None = None, raise_baud: int | None = None) -> str:
    """The URL to open.

    Args:
        port: As typed; that of the only likely board if None.
        baud: Rate for a serial port.
        raise_baud: Rate to which it is raised later.

    Raises:
        LinkNotFoundError: No port was named and no board is plugged in.
        UsageError: Several boards are plugged in, or a rate does not apply to the URL.
    """
    from hexwire.drivers.registry import is_address

    if not port:
        from hexwire.link.ports import find_only_board

        port = find_only_board()
    if is_address(port):
        raise UsageError(f"{port} is a shared arm; this command needs the port itself, where its server runs")
    return _with_rate(_with_rate(port, "--baud", "baud", baud), "--raise-baud", "raise", raise_baud)


def _with_rate(port: str, option: str, key: str, rate: int | None) -> str:
    """The URL with a rate in its query, if one is given."""
    if rate is None:
        return port
    from hexwire.link.url import parse_url

    url = parse_url(port)
    if url.scheme != "serial":
        raise UsageError(f"{option} does not apply to {port}: only a serial port has a rate")
    if key in url.query:
        raise UsageError(f"{option} {rate} and {port}: give the rate only once")
    return f"{port}{'&' if url.query else '?'}{key}={rate}"


def make_robot(options: RobotOptions) -> RobotDriver:
    """Create the driver that the options name. Opens nothing; ``with`` attaches it, or use `open_robot`.

    Raises:
        UsageError: No such robot, a malformed URL, or an option that this robot does not support.
        LinkNotFoundError: No port was named and no likely board is plugged in.
    """
    from hexwire.drivers.registry import is_address, make_driver

    given = {"boot_window": options.timeout, "dialect": options.dialect}
    given = {name: value for name, value in given.items() if value is not None}
    prepare = observed_driver if options.observed else _unchanged
    if options.port and is_address(options.port):
        if given or options.baud is not None or options.raise_baud is not None:
            raise UsageError(
                "--baud, --raise-baud, --dialect and --timeout belong to a port; a shared arm's server has them"
            )
        _note_no_trace(options.port)
        take = f"{'&' if '?' in options.port else '?'}take=1" if options.take else ""
        return make_driver(f"{options.port}{take}", options.robot, prepare=prepare)
    if options.take:
        raise UsageError("--take is for a shared arm, as in --port zenoh:lab/arm1")
    url = resolve_url(options.port, options.baud, options.raise_baud)
    return make_driver(url, options.robot, prepare=prepare, **given)


def _unchanged(driver: type[_R]) -> type[_R]:
    return driver


def _note_no_trace(port: str) -> None:
    context = click.get_current_context(silent=True)
    options = context.find_root().params if context is not None else {}
    if options.get("trace") or options.get("explain"):
        note(f"note: no bytes to show: the line of {port} is at its server; use 'hexwire --trace serve' there")


@contextmanager
def open_robot(options: RobotOptions) -> Iterator[RobotDriver]:
    """Create and attach the robot, and detach it at the end; the torque does not change.

    Raises:
        HexwireError: As `make_robot` and `RobotDriver.attach`.
    """
    with attached(make_robot(options)) as robot:
        yield robot


@contextmanager
def attached(robot: RobotDriver) -> Iterator[RobotDriver]:
    """Attach a robot; print a note if that takes longer than usual."""
    text = f"waiting for an answer on {robot.url} ..."
    patience = threading.Timer(_PATIENCE, note, (text,))
    patience.daemon = True
    if sys.stderr.isatty():
        patience.start()
    try:
        robot.attach()
    finally:
        patience.cancel()
    try:
        yield robot
    finally:
        robot.detach()


@contextmanager
def observing_states(observer: _StateObserver) -> Iterator[None]:
    """In this context every state that a robot of an `observed_driver` reads also goes to `observer`.

    `observer` gets the robot and the state. It must not fail: see `hexwire.link.tap.Missed.guard`. Observers of
    contexts around this one get the state, too.
    """
    outer = _state_observer.get()

    def both(robot: RobotDriver, state: JointState) -> None:
        if outer is not None:
            outer(robot, state)
        observer(robot, state)

    token = _state_observer.set(both)
    try:
        yield
    finally:
        _state_observer.reset(token)


def observed_driver(driver: type[_R]) -> type[_R]:
    """The class from which a command makes its robot, see `observing_states`."""
    from hexwire.drivers.registry import observed

    observer = _state_observer.get()
    return driver if observer is None else observed(driver, observer)


# -- output ---------------------------------------------------------------------------------------------


def confirm(question: str, yes: bool, *, alone: str = "") -> None:
    """Ask for confirmation on standard error before something irreversible happens; ``--yes`` confirms.

    Args:
        question: The question.
        yes: Already confirmed.
        alone: Error text if no input is available; the question if empty.

    Raises:
        click.Abort: The answer is no.
        UsageError: No input is available.
    """
    if yes:
        return
    if sys.stdin.isatty():
        click.confirm(question, abort=True, err=True)
        return
    # Accept `yes | hexwire ...`, too.
    answer = sys.stdin.readline()
    if not answer:
        raise UsageError(alone or f"{question} There is no terminal to answer on: confirm with --yes")
    if answer.strip().lower() not in ("y", "yes"):
        raise click.Abort


def host_timed_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """``--host-timed``: the way of boards that cannot keep the time."""
    return click.option(
        "--host-timed", is_flag=True, help="Send targets one by one, although the board can keep the time."
    )(command)


def force_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """``--force``, for a command that writes a file; the command gets ``force``."""

    @functools.wraps(command)
    def packed(*args: Any, force: bool, **rest: Any) -> Any:
        # Together with --record it applies to both files.
        early = click.get_current_context().find_root().params
        return command(*args, force=force or bool(early.get("force")), **rest)

    return click.option("--force", is_flag=True, help="Overwrite an existing file.")(packed)


def arm_option(command: _F) -> _F:
    """``--arm``, for a recording that may be of several arms; the command gets ``arm``, or None."""
    return click.option("--arm", metavar="NAME", help="Arm to use from a recording of several arms.")(command)


def refuse_idle_force(force: bool, words: str) -> None:
    """Refuse ``--force`` if no file is written: a user might think that it forces something else.

    Raises:
        UsageError: It was given, and not for --record either.
    """
    if force and not click.get_current_context().find_root().params.get("force"):
        raise UsageError(f"--force applies only to {words}, and none is given; it lifts no limit")


json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON for programs.")


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
    """Names of a servo's faults, such as ``overload``; silence does not count as a fault."""
    from hexwire.model.state import JointFlag

    return [flag.name.lower() for flag in JointFlag(flags).faults & ~JointFlag.SILENT if flag.name]


def raise_if_silent(servos: Sequence[tuple[int, str | None]]) -> None:
    """Raise an error that names the servos (pairs of id and joint) that did not answer, if there are any."""
    from hexwire.errors import ServoError

    if servos:
        names = ", ".join(f"{servo_id} ({joint})" if joint else f"{servo_id}" for servo_id, joint in servos)
        several = len(servos) > 1
        raise ServoError(
            f"servo{'s' if several else ''} {names} {'do' if several else 'does'} not answer: "
            "check cable, power and id",
            servo_id=servos[0][0],
        )
