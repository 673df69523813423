"""What several commands share: options and arguments, and opening the robot that they name.

Owns the kinds and bounds of arguments, the options that select a robot, a router or a file, and the questions
before something happens. Must not know any one command.
"""

from __future__ import annotations

import functools
import math
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, Any, TypeVar

import click

from hexwire.errors import UsageError
from hexwire.model.arms import record_of
from hexwire.model.gripper import OPENINGS

from .exits import note
from .output import printing_json

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.state import JointState

__all__ = [
    "FiniteFloat",
    "InputFile",
    "NumbersCommand",
    "RobotOptions",
    "arm_option",
    "arm_settings",
    "attached",
    "camera_option",
    "certificate_options",
    "confirm",
    "early_port",
    "early_robot",
    "force_option",
    "group_port_option",
    "host_timed_option",
    "is_number",
    "is_typed",
    "json_option",
    "line_options",
    "links_option",
    "make_robot",
    "make_robot_with",
    "name_of",
    "number_option",
    "numbers_argument",
    "observed_driver",
    "observing_states",
    "on_terminal",
    "open_robot",
    "parse_opening",
    "port_option",
    "refuse_idle_force",
    "refuse_idle_table",
    "resolve_url",
    "robot_at_port",
    "robot_options",
    "router_options",
    "table_options",
    "unit_of",
]

_F = TypeVar("_F", bound=Callable[..., Any])


class NumbersCommand(click.Command):
    """A command some of whose arguments may be negative: -30 is a number there, and any other -word an option."""

    ignore_unknown_options = True

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        options = {
            name: param
            for param in self.get_params(ctx)
            if isinstance(param, click.Option)
            for name in (*param.opts, *param.secondary_opts)
        }
        words = iter(args[: args.index("--")] if "--" in args else args)
        for word in words:
            if not word.startswith("-") or word == "-" or is_number(word):
                continue
            name, given, _ = word.partition("=")
            option = options.get(name)
            if option is None:
                raise click.NoSuchOption(name, possibilities=options, ctx=ctx)
            if not given and not option.is_flag:
                for _ in range(option.nargs):
                    next(words, None)
        return super().parse_args(ctx, args)


def is_number(word: str) -> bool:
    """Whether a word is a number, be it infinite or NaN."""
    try:
        float(word)
    except ValueError:
        return False
    return True


class FiniteFloat(click.ParamType[float]):
    """A number that is neither infinite nor NaN, with bounds.

    Args:
        name: Name in the help text, such as ``SECONDS``.
        minimum: Smallest value.
        above: Exclusive lower bound.
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


def parse_opening(how: str) -> float:
    """How far a gripper is to open, 0 to 1: of `open`, `close` or a percentage."""
    if how in OPENINGS:
        return OPENINGS[how]
    with suppress(ValueError):
        float(how.removesuffix("%"))
        return FiniteFloat("percent", minimum=0).convert(how.removesuffix("%"), None, None) / 100
    raise UsageError(f"a gripper opens to open, close or a percentage, as in 40%, not {how!r}")


def number_option(
    name: str,
    metavar: str,
    help_text: str,
    *,
    minimum: float = -math.inf,
    above: float = -math.inf,
    default: float | None = None,
    dest: str | None = None,
) -> Callable[[_F], _F]:
    """An option that takes a finite number within bounds; a default stands in its help.

    Args:
        name: As typed.
        metavar: What the number is, for the help.
        help_text: Text of the help.
        minimum: Smallest value.
        above: Exclusive lower bound.
        default: Value if it is not given.
        dest: Name of the command's parameter, if it has another one.
    """
    kind = FiniteFloat(metavar.lower(), minimum=minimum, above=above)
    shown = default is not None
    names = (name,) if dest is None else (name, dest)
    return click.option(*names, type=kind, default=default, show_default=shown, metavar=metavar, help=help_text)


def numbers_argument(name: str, metavar: str, kind: FiniteFloat) -> Callable[[_F], _F]:
    """An argument of several numbers, named by its metavar in usage and errors.

    Args:
        name: Name of the command's parameter.
        metavar: One word per number, such as ``X Y Z``.
        kind: Type of each number.
    """
    count = len(metavar.split())

    def check(ctx: click.Context, param: click.Parameter, value: tuple[float, ...]) -> tuple[float, ...]:
        if len(value) != count:
            raise click.UsageError(f"{metavar} takes {count} values, not {len(value)}", ctx)
        return value

    return click.argument(name, nargs=-1, required=True, type=kind, metavar=metavar, callback=check)


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


def early_robot(robot: str | None) -> str | None:
    """The robot that is typed after a command, otherwise before it: `hexwire --robot puma260 state`."""
    early: str | None = click.get_current_context().find_root().params.get("robot")
    return robot or early


def arm_settings(links: str, table: float | None) -> dict[str, object]:
    """Settings of an arm (`hexwire.control.requests.settings`) by `links_option` and `table_options`."""
    settings: dict[str, object] = {"check_table": table is not None}
    if is_typed("links"):
        settings["links"] = links
    if is_typed("table") and table is not None:
        settings["table_height"] = table
    return settings


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
        robot = early_robot(robot) or robot_at_port(port)
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
        from hexwire.arm.plans import FARTHEST

        # Farther has no other effect; the verb takes it for a mistake.
        height = min(max(table / 1000, -FARTHEST), FARTHEST)
        return command(*args, table=None if no_table else height, **rest)

    height = number_option("--table", "MM", "Height of the table above the arm's base.", default=0.0)
    return height(
        click.option("--no-table", is_flag=True, help="Do not check for collisions with a table.")(packed)
    )


def links_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """``--links``: the link set of the 7Bot."""
    return click.option(
        "--links",
        default="A",
        show_default=True,
        metavar="A|B|V1|FILE",
        help="Link set of the 7Bot: a published one, or a TOML file with your own.",
    )(command)


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


def make_robot_with(links: str, options: RobotOptions) -> RobotDriver:
    """As `make_robot`; the geometry of a 7Bot has a link set as in `make_kinematics`."""
    from hexwire.model.geometry import kinematics_for

    robot = make_robot(options)
    if links != "A" and (geometry := kinematics_for(robot.model, links)) is not None:
        robot.kinematics = geometry
    return robot


def unit_of(robot: str) -> float:
    """Metres in the unit of a robot's coordinates."""
    record = record_of(robot)
    return 1e-3 if record is None else record.unit


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
    """Attach a robot; print a note if that takes longer than usual, or if its angles may be wrong."""
    from hexwire.drivers.abilities import StoredCalibration

    text = f"waiting for an answer on {robot.url} ..."
    patience = threading.Timer(_PATIENCE, note, (text,))
    patience.daemon = True
    if sys.stderr.isatty():
        patience.start()
    try:
        robot.attach()
    finally:
        patience.cancel()
    arm = StoredCalibration.find(robot)
    if arm is not None and arm.doubt and not robot.url.startswith("sim://"):
        note(f"note: {arm.doubt}: `{arm.cure}`")
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
    """``--host-timed``: the way of boards that cannot execute trajectories."""
    return click.option(
        "--host-timed", is_flag=True, help="Send targets one by one, even if the board can execute trajectories."
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


def json_option(command: Callable[..., Any], words: str = "Print JSON for programs.") -> Callable[..., Any]:
    """``--json``; while the command runs, `output` prints JSON only."""

    @functools.wraps(command)
    def packed(*args: Any, as_json: bool, **rest: Any) -> Any:
        with printing_json(as_json):
            return command(*args, **rest)

    return click.option("--json", "as_json", is_flag=True, help=words)(packed)


def on_terminal() -> bool:
    """Whether standard output is a terminal that can be drawn on."""
    import os

    return sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb"


class InputFile(click.File):
    """A file to read, opened once and closed at the end of the command; ``-`` is standard input, perhaps a pipe.

    It is opened with the other arguments: nothing else has been opened, written or moved when it is refused.
    """

    def __init__(self) -> None:
        super().__init__("rb")

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> IO[Any]:
        """Open it; raises as `open_file`."""
        if value == "-":
            return sys.stdin.buffer
        from hexwire.inputs import open_file

        file = open_file(value)
        if ctx is not None:
            ctx.call_on_close(file.close)
        return file


def name_of(file: IO[bytes]) -> str:
    """Name for error texts of an `InputFile`."""
    name = getattr(file, "name", None)
    return name if isinstance(name, str) and name != "<stdin>" else "standard input"


def camera_option(viewers: str) -> Callable[[_F], _F]:
    """``--camera``, which may be given several times; the command gets ``cameras``.

    Args:
        viewers: To whom a camera is shown, for the help.
    """
    return click.option(
        "--camera",
        "cameras",
        multiple=True,
        metavar="DEVICE",
        help=f"Also show a camera of this computer to {viewers}: its device, as /dev/video0, or all.",
    )


def certificate_options(owner: str) -> Callable[[_F], _F]:
    """``--ca``, ``--cert``, ``--key`` and ``--reachable-without-certificates``, under these names.

    Args:
        owner: Owner of the certificate, for the help.
    """
    files = (
        ("--ca", "Certificate of the lab's authority, for tls endpoints."),
        ("--cert", f"Certificate of {owner}."),
        ("--key", "Its key."),
    )

    def add(command: _F) -> _F:
        command = click.option(
            "--reachable-without-certificates",
            is_flag=True,
            help="Allow tcp endpoints beyond this machine: anybody there can then move the arms.",
        )(command)
        for name, words in reversed(files):
            command = click.option(name, default="", metavar="FILE", help=words)(command)
        return command

    return add


def router_options(command: Callable[..., Any], *, stops: bool = False) -> Callable[..., Any]:
    """``--router`` and `certificate_options`; the command gets ``router``, a Network or None.

    What is not typed comes from the file in HEXWIRE_FLEET.

    Args:
        command: The command.
        stops: It stops arms: certificates that cannot be used keep no stop from the arms of this machine.
    """

    @functools.wraps(command)
    def packed(
        *args: Any, router: str, ca: str, cert: str, key: str, reachable_without_certificates: bool, **rest: Any
    ) -> Any:
        from hexwire.fleet.address import router_network

        plain = reachable_without_certificates
        try:
            network = router_network(router, ca=ca, cert=cert, key=key, without_certificates=plain, check=not stops)
        except UsageError as error:
            raise UsageError(f"nothing was stopped: {error}") if stops else error from None
        return command(*args, router=network, **rest)

    with_certificates = certificate_options("this program")(packed)
    return click.option(
        "--router",
        default="",
        metavar="ENDPOINT",
        help="Router of the fleet, as in tls/lab-pc:7447.  [env var: HEXWIRE_FLEET]",
    )(with_certificates)
