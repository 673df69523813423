"""A shared arm as a `RobotDriver`: the whole contract, the same as of the robot behind it."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from tests.fleet.conftest import Serve
from tests.fleet.emulated import KINDS, emulated
from tests.waits import PATIENCE, eventually

from hexwire.control.motion.motions import MotionObserver, run_motion
from hexwire.drivers import registry
from hexwire.drivers.abilities import Counters, OwnWatchdog, ServoPing, StateReports, Watchdog
from hexwire.drivers.base import RobotDriver
from hexwire.drivers.registry import make_driver
from hexwire.drivers.values import Signal, StopCause, StopMode
from hexwire.errors import HexwireError, LeaseError, LinkNotFoundError, UsageError
from hexwire.fleet.remote import RemoteRobot
from hexwire.fleet.service import Service
from hexwire.model.state import JointState, JointTarget


@pytest.fixture
def shared(serve: Serve) -> Service:
    return serve("lab/arm1")


@pytest.fixture
def robot(shared: Service) -> Iterator[RobotDriver]:
    with registry.connect("zenoh:lab/arm1") as robot:
        yield robot


def other(**options: str) -> RemoteRobot:
    """A second program."""
    robot = make_driver("zenoh:lab/arm1" + "".join(f"?{key}={value}" for key, value in options.items()))
    assert isinstance(robot, RemoteRobot)
    return robot


# -- the contract -----------------------------------------------------------------------------------------


def write(angle: float, *others: int) -> Callable[[RobotDriver], object]:
    """Send the first joint, and others by their number, to an angle."""
    return lambda robot: robot.write(
        JointTarget.of({robot.model.names[i]: angle for i in (0, *others)}, 2.0 if angle else 0.05)
    )


def _read(robot: RobotDriver) -> JointState:
    """A state with an answer of every servo: a busy machine lets one miss its time."""
    return eventually(lambda: None if (state := robot.read()).silent else state)


def _stopped(robot: RobotDriver) -> object:
    return _read(robot).stopped, robot.stop_latch().cause is not StopCause.NONE


def if_own(call: Callable[[RobotDriver], object]) -> Callable[[RobotDriver], object]:
    """For what only a board with hexwire's firmware can do, and every shared arm: a server does it."""
    return lambda robot: call(robot) if robot.can(OwnWatchdog) else None


def _armed(robot: RobotDriver) -> bool:
    dog = Watchdog.find(robot)
    return dog is not None and dog.watchdog_armed


def _bad(robot: RobotDriver) -> object:
    return [row.text for row in robot.examine() if row.level.value == "BAD"]


def _refuses(call: Callable[[], object]) -> None:
    with pytest.raises(HexwireError):
        call()


CALLS: list[Callable[[RobotDriver], object]] = [
    lambda robot: robot.model,
    lambda robot: robot.is_attached,
    lambda robot: (robot.can(OwnWatchdog), _armed(robot), robot.stop_kept_by == "board", robot.command_rate),
    if_own(lambda robot: (robot.can(Watchdog), robot.can(StateReports))),
    lambda robot: (_read(robot).names, _read(robot).torque_on),
    # A PUMA 260 switches all on.
    lambda robot: robot.torque(True, robot.model.names[:2])[:2],
    lambda robot: robot.torque(True),
    lambda robot: robot.torque(True, ["J9"]),
    lambda robot: _read(robot).torque_on,
    write(0.2, 2),
    write(7.0),
    lambda robot: robot.write(JointTarget.of({"J9": 0.0}, 0.05)),
    lambda robot: robot.write(JointTarget.of({robot.model.names[0]: 0.2}, -1.0)),
    lambda robot: (ServoPing.of(robot).ping(3), ServoPing.of(robot).ping(77)),
    lambda robot: ServoPing.of(robot).ping(-1),
    lambda robot: robot.probe().same_kind(robot.probe()),
    lambda robot: [(row.name, row.servo_id, row.present) for row in robot.probe().joints],
    if_own(lambda robot: Watchdog.of(robot).watchdog(0.01)),
    # Longer than a busy machine stands still between two of these calls.
    if_own(lambda robot: Watchdog.of(robot).watchdog(10.0)),
    if_own(_armed),
    write(0.1),
    lambda robot: Watchdog.of(robot).watchdog(0.0) if robot.can(Watchdog) else None,
    lambda robot: _armed(robot),
    lambda robot: robot.stop(),
    _stopped,
    write(0.0),
    lambda robot: robot.torque(True),
    lambda robot: robot.resume(),
    _stopped,
    lambda robot: robot.resume(),
    lambda robot: robot.stop(StopMode.TORQUE_OFF),
    lambda robot: (_stopped(robot), _read(robot).torque_on),
    lambda robot: robot.signal(Signal.RESUME),
    lambda robot: robot.signal(Signal.TORQUE_ON),
    lambda robot: robot.signal(99),
    lambda robot: robot.ioctl(0xEE),
    if_own(lambda robot: len(next(StateReports.of(robot).stream(0.02)).names)),
    if_own(lambda robot: next(StateReports.of(robot).stream(0.0))),
    _bad,
    if_own(lambda robot: StateReports.of(robot).discard_reports()),
    lambda robot: "requests" in Counters.of(robot).host_counters() if robot.can(OwnWatchdog) else None,
    lambda robot: robot.detach(torque_off=True),
    lambda robot: robot.is_attached,
    lambda robot: robot.detach(),
    lambda robot: _refuses(robot.read),
    lambda robot: _refuses(robot.stop),
    lambda robot: robot.attach(),
    lambda robot: _read(robot).torque_on,
]


def outcome(call: Callable[[RobotDriver], object], robot: RobotDriver) -> object:
    try:
        value: Any = call(robot)
    except HexwireError as error:
        # Whose fault it is decides the exit status; a text may say more of a shared arm.
        return "UsageError" if isinstance(error, UsageError) else "DeviceError"
    if hasattr(value, "positions") and hasattr(value, "clamped"):
        return [(name, round(angle, 2)) for name, angle in value.positions], value.clamped, value.silent
    return value


@pytest.fixture(
    params=[pytest.param(kind, marks=() if kind in ("dialect 2", "so101") else pytest.mark.slow) for kind in KINDS]
)
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def robots(kind: str, serve: Serve) -> Iterator[tuple[RobotDriver, RobotDriver]]:
    """A robot at its port, and another one of its kind that is shared."""
    with emulated(kind) as own, emulated(kind) as behind:
        service = serve("lab/arm1", **behind)
        direct, remote = registry.connect(str(own["port"]), str(own["robot"])), registry.connect("zenoh:lab/arm1")
        with direct, remote:
            yield direct, remote
        # While there is a robot to be made safe.
        service.close()


def test_every_call_ends_as_that_of_the_robot_behind_it(robots: tuple[RobotDriver, RobotDriver]) -> None:
    direct, remote = robots
    for number, call in enumerate(CALLS):
        assert (number, outcome(call, remote)) == (number, outcome(call, direct))


def test_a_motion_arrives_and_tells_what_remains_if_the_server_dies(
    kind: str, robots: tuple[RobotDriver, RobotDriver]
) -> None:
    _, robot = robots
    unwatched: list[float] = []

    class Observer(MotionObserver):
        def unwatched(self, seconds: float) -> None:
            unwatched.append(seconds)

    joint = robot.model.names[0]
    goal = robot.read()[joint].position + 0.2
    result = run_motion(robot, JointTarget.of({joint: goal}, 0.6), observer=Observer())
    assert result.arrived, result.why
    state = robot.read()
    assert state[joint].position == pytest.approx(goal, abs=0.03)
    # It may arrive early; the end of a motion is no stop.
    assert not state.stopped
    assert unwatched == ([] if kind == "dialect 2" else [pytest.approx(1.5 / robot.command_rate)])


# -- the address ------------------------------------------------------------------------------------------


def test_the_address_may_come_from_the_environment(shared: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HEXWIRE_PORT", "zenoh:lab/arm1")
    with registry.connect() as robot:
        assert (robot.url, robot.model.name) == ("zenoh:lab/arm1", "hex7bot")


def test_what_an_address_cannot_be_given_is_refused(shared: Service) -> None:
    with pytest.raises(UsageError, match="is a hex7bot, not a so101"):
        registry.connect("zenoh:lab/arm1", "so101")
    with pytest.raises(UsageError, match="no option dialect"):
        registry.connect("zenoh:lab/arm1", dialect=2)
    with pytest.raises(LinkNotFoundError, match="no arm lab/arm2 is served"):
        registry.connect("zenoh:lab/arm2")
    make_driver("zenoh:lab/arm1", "hex7bot")


def test_before_attach_nothing_works_and_attaching_again_does(shared: Service) -> None:
    robot = other()
    for call in (robot.read, robot.stop, robot.probe, lambda: robot.torque(True)):
        with pytest.raises(UsageError, match="not attached"):
            call()
    for _ in range(2):
        with robot:
            robot.torque(True)
        assert not robot.is_attached


# -- states -----------------------------------------------------------------------------------------------


def test_a_state_is_from_after_the_call_and_from_after_every_own_order(robot: RobotDriver) -> None:
    for on in (True, False, True):
        robot.torque(on)
        assert bool(robot.read().torque_on) is on
    for _ in range(3):
        robot.stop()
        assert robot.read().stopped
        robot.resume()
        assert not robot.read().stopped
    # Each call waits for one that arrives after it.
    states = [robot.read() for _ in range(3)]
    assert states[0].stamp < states[1].stamp < states[2].stamp <= robot.now()


def test_velocities_are_there_although_short_reports_leave_them_out(robot: RobotDriver) -> None:
    eventually(lambda: all(abs(speed) < 10.0 for speed in robot.read().velocity))


def test_the_states_of_a_stream_are_in_order(robot: RobotDriver) -> None:
    stamps = [state.stamp for state in itertools.islice(robot.stream(0.05, slow=2.0), 5)]
    assert stamps == sorted(set(stamps))


def newest(robot: RobotDriver) -> int:
    """Number of the newest state that has been taken."""
    assert isinstance(robot, RemoteRobot)
    assert robot._states.newest is not None
    return robot._states.newest.sequence


def test_discarded_reports_are_not_read(robot: RobotDriver) -> None:
    states = robot.stream(0.05)
    next(states)
    # Long enough for the next ones to have arrived.
    time.sleep(0.2)
    robot.discard_reports()
    # Not by its stamp: while the machine stalls, a state is on its way for long.
    discarded = newest(robot)
    next(states)
    assert newest(robot) > discarded


@pytest.mark.slow
def test_a_stream_ends_when_the_server_answers_but_has_no_states(shared: Service, robot: RobotDriver) -> None:
    (served,) = shared._arms
    assert served.server is not None
    states = robot.stream(0.02, timeout=1.0)
    next(states)
    served.arm.owner.observers = ()
    assert len(list(states)) < 5


@pytest.mark.slow
def test_a_read_waits_as_long_as_the_robot_is_busy(shared: Service, robot: RobotDriver) -> None:
    owner = shared._arms[0].arm.owner
    busy, free = threading.Event(), threading.Event()

    def occupy() -> None:
        busy.set()
        free.wait(PATIENCE)

    thread = threading.Thread(target=lambda: owner.call(occupy))
    thread.start()
    busy.wait(PATIENCE)
    # Longer than the silence after which the reason is asked for.
    threading.Timer(1.3, free.set).start()
    asked = robot.now()
    # The first few may have been under way when the robot became busy; clocks differ by some milliseconds.
    stamps = [robot.read().stamp for _ in range(10)]
    assert min(stamp for stamp in stamps if stamp > asked + 0.1) > asked + 1.0
    thread.join()


# -- losing the lease -------------------------------------------------------------------------------------


def test_a_motion_ends_with_the_loss_of_its_lease_and_stops_nobody_else(robot: RobotDriver) -> None:
    robot.torque(True)
    ended: list[BaseException] = []

    def move() -> None:
        try:
            run_motion(robot, JointTarget.of({"J1": 1.0}, 20.0))
        except HexwireError as error:
            ended.append(error)

    thread = threading.Thread(target=move)
    thread.start()
    eventually(lambda: robot.watchdog_armed and robot.holder)
    with other(take="1") as second:
        second.write(JointTarget.of({"J2": second.read().positions["J2"]}, 0.2))
        thread.join(PATIENCE)
        assert [type(error) for error in ended] == [LeaseError]
        assert second.holder.split(",")[0] in str(ended[0])
        # The first one does not stop what the second one commands.
        assert not second.read().stopped
        with pytest.raises(LeaseError):
            robot.write(JointTarget.of({"J1": 0.0}, 0.2))


def test_without_a_motion_of_its_own_a_program_that_lost_its_lease_goes_on_reading(robot: RobotDriver) -> None:
    robot.torque(True)
    with other(take="1") as second:
        second.torque(True)
        with pytest.raises(LeaseError):
            robot.torque(True)
        assert robot.read().torque_on


@pytest.mark.slow
def test_a_motion_runs_to_its_end_after_the_program_has_left(shared: Service) -> None:
    with other() as second:
        with other() as first:
            first.torque(True)
            first.write(JointTarget.of({"J1": 0.4}, 1.5))
        assert second.read().positions["J1"] < 0.35
        eventually(lambda: abs(second.read().positions["J1"] - 0.4) < 0.02)
        eventually(lambda: not second.holder)
        assert (second.held, second.read().stopped) == ("", False)
