"""Robots by name, found through the entry-point groups ``hexwire.arms`` and ``hexwire.robots``.

Owns the lookup. A package names the record of an arm in the first, which names its `RobotDriver`, or the
`RobotDriver` of a robot of which nothing else is to be known in the second; nothing here lists robots.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from importlib.metadata import EntryPoint
from typing import TYPE_CHECKING, Any, TextIO, TypeVar

from hexwire.arguments import Wanted, check
from hexwire.errors import HexwireError, UsageError
from hexwire.extras import extras_named, installed
from hexwire.link.tap import TRACE_VARIABLE, wrap_new_links
from hexwire.model.arms import arm_names, record_of

from .base import RobotDriver

if TYPE_CHECKING:
    from hexwire.model.state import JointState

    from .bus_arm import BusArm

__all__ = [
    "DEFAULT_ROBOT",
    "PORT_VARIABLE",
    "bus_arm_names",
    "connect",
    "is_address",
    "is_same_arm",
    "load_bus_arm",
    "load_driver",
    "make_driver",
    "observed",
    "robot_at",
    "robot_names",
]

_R = TypeVar("_R", bound=RobotDriver)

PORT_VARIABLE = "HEXWIRE_PORT"
"""Environment variable with the default port."""

DEFAULT_ROBOT = "hex7bot"
"""The robot on a port, unless another one is named."""

_ROBOT = Wanted("the name of a robot, as in 'so101'", lambda value: value is None or isinstance(value, str))
# A tracer only observes: it would lose its lines without a word.
_STREAM = Wanted(
    "a stream of text, as in sys.stderr",
    lambda value: (
        value is None
        or (callable(getattr(value, "write", None)) and not isinstance(value, io.RawIOBase | io.BufferedIOBase))
    ),
)
_EMULATED = "sim://"
_GROUP = "hexwire.robots"
_ADDRESSES = "hexwire.addresses"
"""Entry points of drivers for addresses that name a robot, not a link to one: ``zenoh:lab/arm1``."""


def robot_names() -> tuple[str, ...]:
    """Names of the installed robots, sorted."""
    return tuple(sorted({*arm_names(), *(point.name for point in installed(_GROUP))}))


@cache
def _file_class(package: str, file: str) -> type[RobotDriver]:
    """The driver class of an arm on a servo bus, of the TOML file in a package."""
    from importlib import resources

    from .bus_arm import arm_class

    with resources.as_file(resources.files(package) / file) as path:
        return arm_class(path)


def load_driver(name: str) -> type[RobotDriver]:
    """Load the driver class of a robot.

    Args:
        name: Name of an installed robot, or path of a TOML file that describes an arm on a servo bus.

    Raises:
        UsageError: No such robot is installed; the text lists those that are.
        ConfigError: The file is invalid.
    """
    if name.endswith(".toml"):
        from .bus_arm import arm_class

        return arm_class(name)
    record = record_of(name)
    if record is not None:
        package, _, file = record.driver.partition(":")
        if file.endswith(".toml"):
            return _file_class(package, file)
        point: EntryPoint | None = EntryPoint(name, record.driver, _GROUP)
    else:
        point = next((point for point in installed(_GROUP) if point.name == name), None)
    if point is None:
        raise UsageError(f"no robot {name!r}; installed are {', '.join(robot_names()) or 'none'}")
    driver = point.load()
    if not (isinstance(driver, type) and issubclass(driver, RobotDriver)):
        raise UsageError(f"entry point {point.value!r} of robot {name!r} is not a RobotDriver class")
    return driver


def observed(driver: type[_R], observer: Callable[[RobotDriver, JointState], object]) -> type[_R]:
    """Make the class of a driver whose every state that `read` returns also goes to an observer, with the robot.

    Args:
        driver: The class; its `from_url` makes robots of the class that it is called on, as the contract says.
        observer: Is called in the thread that reads. It must not fail: see `hexwire.link.tap.Missed.guard`.
    """

    def read(robot: _R) -> JointState:
        state = driver.read(robot)
        observer(robot, state)
        return state

    return type(driver.__name__, (driver,), {"read": read, "__doc__": driver.__doc__})


def load_bus_arm(name: str) -> type[BusArm]:
    """Load the driver class of an arm on a servo bus; arguments and errors as `load_driver`.

    Raises:
        UsageError: The robot is not an arm on a servo bus.
    """
    from .bus_arm import BusArm

    driver = load_driver(name)
    if not issubclass(driver, BusArm):
        raise UsageError(f"{name} is not an arm on a servo bus")
    return driver


def bus_arm_names() -> tuple[str, ...]:
    """Names of the installed arms on a servo bus, sorted; a robot whose driver cannot be loaded is none."""
    found = []
    for name in robot_names():
        with suppress(HexwireError, ImportError):
            load_bus_arm(name)
            found.append(name)
    return tuple(found)


def make_driver(
    port: str,
    robot: str | None = None,
    *,
    prepare: Callable[[type[RobotDriver]], type[RobotDriver]] = lambda driver: driver,
    **options: Any,
) -> RobotDriver:
    """Make the driver for a port or an address; it is not attached yet.

    Args:
        port: As for `connect`. An address that names a robot, as in ``zenoh:lab/arm1``, is asked which robot it is.
        robot: Name of the robot; if None, `robot_at` the port.
        prepare: Changes the driver's class before a robot is made of it, such as `observed`.
        **options: Passed to the driver's `from_url`.

    Raises:
        UsageError: There is no such robot, or the address is wrong or leads to another robot.
        LinkError: Nobody answers at the address.
    """
    if is_address(port):
        point = next(point for point in installed(_ADDRESSES) if point.name == port.partition(":")[0])
        with extras_named():
            driver = point.load()
        return prepare(driver).from_url(port, robot=robot, **options)
    return prepare(load_driver(robot or robot_at(port))).from_url(port, **options)


def robot_at(port: str | None) -> str:
    """Name of the robot on a port if none is given: an emulated arm is named by its address, as in ``sim://so101``."""
    if port is not None and port.startswith(_EMULATED):
        name = re.split("[/?]", port.removeprefix(_EMULATED), maxsplit=1)[0]
        if name in robot_names():
            return name
    return DEFAULT_ROBOT


def is_address(port: str) -> bool:
    """Whether a text names a robot, as in ``zenoh:lab/arm1``, and not a link to one."""
    scheme, colon, _ = port.partition(":")
    return bool(colon) and any(point.name == scheme for point in installed(_ADDRESSES))


def is_same_arm(one: RobotDriver, other: RobotDriver) -> bool:
    """Whether two drivers move one arm, as far as their addresses tell; each ``sim://`` is an arm of its own."""
    return one is other or (one.url == other.url and not one.url.startswith("sim://"))


def connect(
    port: str | None = None, robot: str | None = None, *, trace: TextIO | None = None, **options: Any
) -> RobotDriver:
    """Open a robot: find its driver and its port, and attach; nothing is sent that moves it.

    A board with the chapter's sketch is an exception: see `Hex7BotDriver.attach`.

    Args:
        port: URL or device path, as in ``serial:///dev/ttyUSB0?baud=115200``; the address of a shared arm, as in
            ``zenoh:lab/arm1``; or that of an emulated one, ``sim://hex7bot``, ``sim://so101`` or ``sim://so100``.
            If None, the value of the environment variable HEXWIRE_PORT, else the only likely board that is plugged
            in.
        robot: Name of the robot; a shared or emulated arm names it itself, and another port has a hex7bot if None.
        trace: Print every frame and packet of its lines here, and every state that is read, as ``--trace`` of the
            commands does. ``HEXWIRE_TRACE=1`` does so on standard error for every link of the program. A stream
            that is slow, closed or broken loses lines; the line to the robot waits for it 0.1 s at
            most, once, and 1 s when it is closed.
        **options: Passed to the driver's `from_url`.

    Returns:
        The attached driver; use it as a context manager, or call `detach`.

    Raises:
        UsageError: There is no such robot, or no single port to choose.
        LinkError: The port cannot be opened.
        ReplyTimeoutError: Nothing answers.
    """
    if port is None:
        port = os.environ.get(PORT_VARIABLE)
    if port is None:
        from hexwire.link.ports import find_only_board

        port = find_only_board()
    if not isinstance(port, str):
        raise UsageError(f"a port is text, as in 'serial:///dev/ttyUSB0'; this is {port!r}")
    check("connect", "robot", _ROBOT, robot)
    check("connect", "trace", _STREAM, trace)
    tracer = None
    if trace is not None or TRACE_VARIABLE in os.environ:
        from hexwire.trace.live import Tracer, process_tracer

        tracer = process_tracer() if trace is None else Tracer(trace)
    if tracer is None:
        driver = make_driver(port, robot, **options)
        driver.attach()
        return driver
    with wrap_new_links(tracer.tap):
        driver = make_driver(port, robot, prepare=lambda kind: observed(kind, tracer.state), **options)
        # Some drivers make their links here.
        driver.attach()
    return driver
