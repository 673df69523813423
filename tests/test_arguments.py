"""Whatever a program passes to a public method of a robot or a session: it says in one line what it wants."""

from __future__ import annotations

import inspect
import math
import time
from collections.abc import Callable, Iterator, Sequence
from types import GeneratorType
from typing import Any

import pytest
from tests.drivers.test_base import Guarded

from hexwire.arguments import DATA, FLAG, NAME, NAMES, SECONDS, WHOLE, check, checked, or_none
from hexwire.arm.verbs import Arm
from hexwire.control.loop.owner import RobotOwner
from hexwire.control.motion.motions import MotionOptions, check_path, run_motion
from hexwire.drivers.abilities import Leased, OnboardPaths, Watchdog
from hexwire.drivers.base import RobotDriver
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.drivers.puma260 import Puma260Driver
from hexwire.drivers.registry import load_bus_arm
from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.bus_arms import make_bus_arm
from hexwire.emulator.bus_device import BusDevice
from hexwire.emulator.puma import EmulatedPuma
from hexwire.emulator.serve import BoardLink, FakeClock, ServedDevice
from hexwire.errors import HexwireError, UsageError
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session
from hexwire.link.base import Link
from hexwire.model.state import JointTarget
from hexwire.wire.command_frame import Command
from hexwire.wire.modules import ModuleType
from hexwire.wire.robot_bodies import JointCommands, TrajectoryPoints

ODD = (
    None, "J1", "off", "", 7, -1, 256, 10**30, 3.5, math.nan, {"J1": 0.1}, ["J1"], ["J9"], [1], [None],
    (), b"x", True, object(), "a\nb",
)  # fmt: skip
GOOD: dict[str, Any] = {
    "on": True, "cmd": Command.STATS, "sub_cmd": Command.STATS, "servo_id": 1, "number": 3, "period": 0.1,
    "timeout": 0.5, "first": 0, "kind": Watchdog, "data": b"", "body": b"",
}  # fmt: skip
_TIMES = ("attempts", "boot_window", "timeout", "window")
NOT_CALLED = {
    # Hooks of a driver, which get what its verbs have checked.
    "on_hold", "on_read", "on_target", "on_torque",
    # The connection itself; classes have their own tests of addresses.
    "abort", "attach", "close", "detach", "from_conf", "from_url", "open", "share_stops", "sleep",
}  # fmt: skip


def hex7bot(link: Link) -> RobotDriver:
    return Hex7BotDriver(Session(IpcHandle.from_link(link)))


def puma260(link: Link) -> RobotDriver:
    ends = ModuleType.PUMA260_HOST_IO_TRX, ModuleType.PUMA260_RBT_IO_SVR
    return Puma260Driver(Session(IpcHandle.from_link(link, *ends)))


ROBOTS: dict[str, tuple[Callable[[float], ServedDevice], Callable[[Link], RobotDriver]]] = {
    "board": (lambda start: make_hex7bot_board(start=start), hex7bot),
    "chapter's board": (lambda start: make_hex7bot_board(dialect=1, start=start), hex7bot),
    "servos": (lambda start: BusDevice(make_bus_arm("so101", start=start).servos), load_bus_arm("so101")),
    "puma260": (lambda start: EmulatedPuma(start=start).connect(), puma260),
}


def attached(robot: str) -> RobotDriver:
    device, make = ROBOTS[robot]
    clock = FakeClock(time.monotonic())
    made = make(BoardLink(device(clock.time), clock))
    made.attach()
    return made


def calls(of: object, own: dict[str, Any]) -> Iterator[tuple[str, str, Callable[[object], Any]]]:
    """Every argument of every public method, and how to call it with something else."""
    for name in dir(type(of)):
        method = None if name.startswith("_") or name in NOT_CALLED else inspect.getattr_static(of, name)
        if not inspect.isfunction(method):
            continue
        bound = getattr(of, name)
        wanted = [row for row in inspect.signature(bound).parameters.values() if row.kind is not row.VAR_KEYWORD]
        needed = {row.name: (GOOD | own)[row.name] for row in wanted if row.default is row.empty}
        for row in wanted:

            def call(value: object, method: Any = bound, given: Any = needed, argument: str = row.name) -> None:
                made = method(**{**given, argument: value})
                if isinstance(made, GeneratorType):
                    next(made, None)
                elif hasattr(made, "__enter__"):
                    with made:
                        pass

            yield name, row.name, call


def assert_told(of: object, own: dict[str, Any]) -> int:
    """Nothing but the project's own errors, of one line; returns how many arguments have been tried."""
    count = 0
    for method, argument, call in calls(of, own):
        count += 1
        for value in ODD:
            if value == 10**30 and argument in _TIMES:
                continue  # it waits for so long
            try:
                call(value)
            except HexwireError as error:
                if "\n" in str(error):
                    pytest.fail(f"{method}({argument}={value!r}) is told in several lines: {error}")
            except Exception as error:  # noqa: BLE001  # which one it is, is what this is about
                pytest.fail(f"{method}({argument}={value!r}): {error!r}")
    return count


@pytest.mark.parametrize("robot", ROBOTS)
def test_every_verb_of_a_robot(robot: str) -> None:
    driver = attached(robot)
    joint = driver.model.names[0]
    own: dict[str, Any] = {
        "packet": b"", "reply_length": 0, "rows": (), "mode": 0,
        "trajectory": TrajectoryPoints((0.0,), ((0.0,) * 6,)), "commands": JointCommands(("J1",), (0.0,)),
    }  # fmt: skip
    here = {joint: driver.read().positions[joint]}
    own |= {"joint": joint, "positions": here, "duration": 0.02, "target": JointTarget.of(here)}
    assert assert_told(driver, own) >= {"servos": 15, "puma260": 21}.get(robot, 26)
    # And it is as it was.
    driver.resume()
    assert driver.read().positions


def test_every_call_of_a_session() -> None:
    driver = attached("board")
    assert isinstance(driver, Hex7BotDriver)
    request = object()
    assert assert_told(driver.session, {"request": request}) > 20
    assert driver.read().positions


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda robot: robot.torque("off"), "torque(on) takes True or False; this is 'off'"),
        (lambda robot: robot.torque(True, "J1"), "torque(joints) takes several names, as in ['J1']; this is 'J1'"),
        (lambda robot: robot.torque(True, [1]), "torque(joints) takes several names, as in ['J1']; this is [1]"),
        (lambda robot: robot.stop("hold"), "stop(mode) takes a StopMode; this is 'hold'"),
        (lambda robot: robot.stop(True), "stop(mode) takes a StopMode; this is True"),
        (lambda robot: robot.watchdog("1 s"), "watchdog(timeout) takes a number of seconds; this is '1 s'"),
        (lambda robot: robot.ping("J1"), "ping(servo_id) takes a whole number; this is 'J1'"),
        (lambda robot: robot.ioctl(2, "x"), "ioctl(data) takes bytes, as in b'\\x01'; this is 'x'"),
        (
            lambda robot: next(robot.stream(period="fast")),
            "stream(period) takes a number of seconds; this is 'fast'",
        ),
        (lambda robot: robot.session.request("STATS"), "request(cmd) takes a whole number; this is 'STATS'"),
        (lambda robot: robot.session.request_all(2, to="all"), "request_all(to) takes modules, as in (8, 9); this"),
    ],
)
def test_what_is_wanted_is_said(call: Callable[[Any], object], text: str) -> None:
    driver = attached("board")
    before = driver.session.connection.counters.requests  # type: ignore[attr-defined]
    with pytest.raises(UsageError) as told:
        call(driver)
    assert text in str(told.value)
    assert driver.session.connection.counters.requests == before  # type: ignore[attr-defined]


class Bare(Guarded, OnboardPaths, Leased):
    """Defines only what every such robot must."""

    def path(self, joints: Sequence[str] | None = None, **how: Any) -> Any:
        """None."""

    holder = ""

    def take(self, *, force: bool | None = None) -> None:
        """As it is asked."""

    def release(self, *, finish: bool = False) -> None:
        """As it is asked."""

    def auto_reconnect(self, on: bool) -> None:
        """As it is asked."""


class Adds:
    """Adds a method without being a robot itself."""

    def auto_reconnect(self, on: bool) -> None:
        """Take whatever comes."""


class Mixed(Adds, Bare):
    """Has it from there."""


@pytest.mark.parametrize("kind", [Bare, Mixed])
def test_what_a_robot_does_not_define_itself_is_checked_too(kind: type[Guarded]) -> None:
    robot: Any = kind()
    for call, text in (
        (lambda: robot.auto_reconnect("off"), "auto_reconnect(on) takes True or False; this is 'off'"),
        (lambda: robot.clear_path("J1"), "clear_path(joints) takes several names, as in ['J1']; this is 'J1'"),
        (lambda: robot.take(force="yes"), "take(force) takes True or False; this is 'yes'"),
        (lambda: robot.release(finish="yes"), "release(finish) takes True or False; this is 'yes'"),
        (lambda: robot.watched("1 s"), "watched(timeout) takes a number of seconds; this is '1 s'"),
        (lambda: robot.watched(always="no"), "watched(always) takes True or False; this is 'no'"),
        (lambda: setattr(robot, "kinematics", 5), f"{kind.__name__}(kinematics) takes a KinematicModel; this is 5"),
    ):
        with pytest.raises(UsageError) as told:
            call()
        assert str(told.value) == text


def test_a_motion_says_what_it_takes() -> None:
    driver = attached("board")
    arm: Any = Arm(driver)
    target = JointTarget.of({"J1": 0.0})
    wanted = (
        "the driver of a robot: arm.driver of the arm that hexwire.connect() returns, which itself has verbs, "
        "as in arm.move(J1=0.1)"
    )
    for call, text in (
        (lambda: run_motion("sim://hex7bot", target), f"run_motion(robot) takes {wanted}; this is 'sim://hex7bot'"),
        (lambda: run_motion(arm, target), f"run_motion(robot) takes {wanted}; this is <Arm "),
        (lambda: run_motion(arm, {"J1": 0.1}), f"run_motion(robot) takes {wanted}; this is <Arm "),
        (lambda: check_path(arm, []), f"check_path(robot) takes {wanted}; this is <Arm "),
        (lambda: RobotOwner(arm), f"RobotOwner(robot) takes {wanted}; this is <Arm "),
        (
            lambda: run_motion(driver, {"J1": 0.2}),
            "a motion is a trajectory, several of them, or a JointTarget, as in JointTarget.of({'J1': 0.1})",
        ),
        (lambda: run_motion(driver, target, wait="no"), "run_motion(wait) takes True or False; this is 'no'"),
        (lambda: run_motion(driver, target, []), "options are MotionOptions, as in MotionOptions(table=None)"),
        (lambda: MotionOptions(table="none"), "MotionOptions(table) takes a number; this is 'none'"),
        (lambda: MotionOptions(table=True), "MotionOptions(table) takes a number; this is True"),
        (lambda: MotionOptions(tolerance=None), "MotionOptions(tolerance) takes a number; this is None"),
        (lambda: MotionOptions(host_timed="no"), "MotionOptions(host_timed) takes True or False; this is 'no'"),
        (
            lambda: MotionOptions(limits={"lag": 1}),
            "MotionOptions(limits) takes a SafetyLimits; this is {'lag': 1}",
        ),
        (
            lambda: MotionOptions(sleep=1),
            "MotionOptions(sleep) takes something to call, as in time.sleep; this is 1",
        ),
    ):
        with pytest.raises(UsageError) as told:
            call()  # type: ignore[no-untyped-call]  # what it is called with is wrong on purpose
        assert str(told.value).startswith(text)


def test_what_is_made_of_something_else_is_told() -> None:
    wrong: Any = "sim://hex7bot"
    with pytest.raises(UsageError, match=r"^Session\(ipc\) takes an IpcHandle, as in IpcHandle.from_url"):
        Session(wrong)
    with pytest.raises(UsageError, match=r"^Hex7BotDriver\(session\) takes a Session, as in Session.from_url"):
        Hex7BotDriver(wrong)


def test_kinds() -> None:
    fitting = {
        FLAG: (True, False, 0, 1), WHOLE: (0, -1, 10**30), SECONDS: (0, 1.5, math.inf), DATA: (b"", bytearray(2)),
        NAME: ("", "J1"), NAMES: ((), ["J1"], {"J1": 1}, frozenset(("a",))), or_none(WHOLE): (None, 1),
    }  # fmt: skip
    for kind, values in fitting.items():
        assert all(kind.fits(value) for value in values), kind.text
    other = {
        FLAG: (2, "on", None), WHOLE: (True, 1.0, "1"), SECONDS: (True, "1", None, math.nan), DATA: ("x", None),
        NAME: (1, b"x"), NAMES: ("J1", [1], None, 7), or_none(WHOLE): ("",),
    }  # fmt: skip
    for kind, values in other.items():
        assert not any(kind.fits(value) for value in values), kind.text  # type: ignore[attr-defined]


def test_the_value_is_shown_in_one_short_line() -> None:
    for value in ("a\n" * 1000, list(range(1000)), dict.fromkeys(range(500), "x" * 500)):
        with pytest.raises(UsageError) as told:
            check("ping", "servo_id", WHOLE, value)
        assert len(str(told.value)) < 200
        assert "\n" not in str(told.value)


def test_a_checked_method_takes_its_arguments_in_any_way() -> None:
    class Thing:
        def call(self, first: int, second: float = 0.0, *, third: object = None) -> tuple[object, ...]:
            """Say what it got."""
            return first, second, third

    wrapped = checked(Thing.call, {"first": WHOLE, "second": SECONDS, "third": NAME})
    assert wrapped(Thing(), 1, 2.0, third="x") == wrapped(Thing(), third="x", second=2.0, first=1) == (1, 2.0, "x")
    assert (wrapped.__name__, wrapped.__doc__) == ("call", "Say what it got.")
    for given, named in (((1.5,), {}), ((1, "x"), {}), ((1,), {"third": 3}), ((), {"first": "x"})):
        with pytest.raises(UsageError, match=r"^call\((first|second|third)\) takes "):
            wrapped(Thing(), *given, **named)
    with pytest.raises(TypeError, match="missing 1 required positional argument"):
        wrapped(Thing())


def test_bytes_and_numbers_of_other_kinds_are_taken_as_pythons_own() -> None:
    assert DATA.plain(memoryview(b"ab")) == b"ab"
    assert type(DATA.plain(bytearray(b"ab"))) is bytes
    words = memoryview(b"abcd").cast("H")
    assert DATA.plain(words) is words, "not of bytes"
    assert DATA.plain("ab") == "ab"

    class Scalar:
        ndim = 0

        def item(self) -> int:
            return 5

    assert WHOLE.plain(Scalar()) == 5
