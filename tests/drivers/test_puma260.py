"""`Puma260Driver` against the emulated controller: in simulated time, and over real channels."""

from __future__ import annotations

import itertools
import math
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from tests.defaults import default
from tests.drivers.puma_server import Served, served_puma

from hexwire.drivers.base import Signal, StopMode
from hexwire.drivers.puma260 import Puma260Driver, Puma260Mode
from hexwire.drivers.registry import connect, load_driver, robot_names
from hexwire.emulator.puma import _REST_EFFORT, EmulatedPuma
from hexwire.emulator.serve import BoardLink, FakeClock
from hexwire.errors import (
    CommandRefusedError,
    ConfigError,
    LimitError,
    LinkLostError,
    RemoteProtocolError,
    ReplyTimeoutError,
    StoppedError,
    UsageError,
)
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session
from hexwire.model.arms.puma260.kinematics import PUMA260
from hexwire.model.state import JointTarget
from hexwire.session.policy import RetryPolicy
from hexwire.wire.command_frame import Command
from hexwire.wire.modules import ModuleType
from hexwire.wire.robot_bodies import JointCommands, RobotStatus, TrajectoryPoints

DEG = math.pi / 180


class Bench(NamedTuple):
    driver: Puma260Driver
    robot: EmulatedPuma
    link: BoardLink
    clock: FakeClock


@pytest.fixture
def bench() -> Iterator[Bench]:
    clock = FakeClock(1000.0)
    robot = EmulatedPuma(start=clock.time)
    link = BoardLink(robot.connect(253), clock)
    handle = IpcHandle.from_link(link, ModuleType.PUMA260_HOST_IO_TRX, ModuleType.PUMA260_RBT_IO_SVR)
    with Puma260Driver(Session(handle)) as driver:
        yield Bench(driver, robot, link, clock)


def line(points: int, step: float = 0.02) -> TrajectoryPoints:
    times = tuple(step * (i + 1) for i in range(points))
    rows = tuple((0.2 - 0.2 * math.cos(t), 0.1 * math.sin(2 * t), 0.0, 0.0, 0.0, 0.0) for t in times)
    return TrajectoryPoints(times, rows)


def test_it_is_found_by_its_entry_point() -> None:
    assert "puma260" in robot_names()
    assert load_driver("puma260") is Puma260Driver


def test_probe_and_read(bench: Bench) -> None:
    report = bench.driver.probe()
    assert (report.robot, report.dialect, report.stopped, report.missing) == ("puma260", 2, False, ())
    state = bench.driver.read()
    assert state.position == pytest.approx((0.0,) * 6, abs=1e-4)
    assert (state.torque_on, state.stopped, state.names) == ((), False, PUMA260.names)
    assert all(math.isnan(v) for v in state.current + state.voltage + state.temperature)


def test_a_move_and_the_states_until_its_end(bench: Bench) -> None:
    driver, _, _, clock = bench
    driver.torque(True)
    sent = driver.write(JointTarget.of({"j1": 20 * DEG, "J5": 15 * DEG, "J6": -10 * DEG}, 1.0))
    assert dict(sent.positions) == pytest.approx({"J1": 20 * DEG, "J5": 15 * DEG, "J6": -10 * DEG}, abs=2e-4)
    speeds = []
    for _ in range(20):
        clock.advance(0.1)
        speeds.append(driver.read().velocity)
    assert driver.read().position == pytest.approx((20 * DEG, 0, 0, 0, 15 * DEG, -10 * DEG), abs=1e-3)
    # The integral of the speeds is the way: encoder coupling is in both.
    for i, way in ((0, 20 * DEG), (4, 15 * DEG), (5, -10 * DEG)):
        assert 0.1 * sum(speed[i] for speed in speeds) == pytest.approx(way, rel=0.1)


def test_a_move_that_is_too_fast_gets_more_time(bench: Bench) -> None:
    bench.driver.torque(True)
    sent = bench.driver.write(JointTarget.of({"J1": 100 * DEG}, 0.1))
    assert sent.duration == pytest.approx(2.0, rel=0.01)


def test_a_joint_moved_meanwhile_is_not_sent_back(bench: Bench) -> None:
    driver, _, _, clock = bench
    driver.torque(True)
    driver.read()
    driver.command(JointCommands(("J1",), position=(0.3,)))
    clock.advance(2.0)
    driver.write(JointTarget.of({"J2": 0.1}, 0.5))
    clock.advance(2.0)
    assert driver.read().position[:2] == pytest.approx((0.3, 0.1), abs=1e-3)


@pytest.mark.parametrize(
    ("name", "degrees"),
    [(j.name, b) for j in PUMA260.joints for b in (math.degrees(j.minimum) - 1, math.degrees(j.maximum) + 1)],
)
def test_every_limit_is_kept_and_nothing_is_sent(bench: Bench, name: str, degrees: float) -> None:
    driver, robot, _, _ = bench
    driver.torque(True)
    here = [0.0] * 6
    here[PUMA260.index(name)] = degrees * DEG
    with pytest.raises(LimitError, match=f"{name}="):
        driver.write(JointTarget.of({name: degrees * DEG}))
    with pytest.raises(LimitError, match=f"{name}="):
        driver.command(JointCommands((name,), position=(degrees * DEG,)))
    with pytest.raises(LimitError, match=f"{name}="):
        driver.follow(TrajectoryPoints((100.0,), (tuple(here),)))
    assert not robot.executed


def test_invalid_values_are_refused(bench: Bench) -> None:
    driver, robot, _, _ = bench
    driver.torque(True)
    with pytest.raises(UsageError, match="too early for the speed limits"):
        driver.follow(TrajectoryPoints((1.0, 1.1), ((0.0,) * 6, (1.0, 0, 0, 0, 0, 0))))
    with pytest.raises(UsageError, match="trajectory of 5 joints"):
        driver.follow(TrajectoryPoints((1.0,), ((0.0,) * 5,)))
    with pytest.raises(UsageError, match="no joint 'J7'"):
        driver.command(JointCommands(("J7",), position=(0.0,)))
    with pytest.raises(UsageError, match=r"J1 at 57\.3 deg/s is over its limit of 50"):
        driver.command(JointCommands(("j1",), velocity=(1.0,)))
    with pytest.raises(UsageError, match="one power switch"):
        driver.torque(False, ["J1"])
    with pytest.raises(UsageError, match="no signal 9"):
        driver.signal(9)
    with pytest.raises(UsageError, match="no ioctl 0x13; it has 0x32 ROBOT_MODE"):
        driver.ioctl(Command.JOINT_MOVE)
    with pytest.raises(UsageError, match="no option dialect"):
        Puma260Driver.from_url("udp://127.0.0.1:1", dialect=1)
    assert not robot.executed


def test_every_signal(bench: Bench) -> None:
    driver, robot, _, _ = bench
    driver.signal(Signal.TORQUE_ON)
    assert robot.power
    driver.signal(Signal.STOP)
    assert robot.stopped
    assert robot.power
    with pytest.raises(StoppedError):
        driver.write(JointTarget.of({"J1": 0.1}))
    driver.signal(Signal.RESUME)
    driver.signal(Signal.STOP_TORQUE_OFF)
    assert robot.stopped
    assert not robot.power
    assert driver.read().stopped
    driver.signal(Signal.RESUME)
    assert not robot.stopped
    driver.signal(Signal.TORQUE_ON)
    driver.signal(Signal.TORQUE_OFF)
    assert not robot.power


def test_modes_and_ioctl(bench: Bench) -> None:
    driver = bench.driver
    driver.torque(True)
    driver.set_mode(Puma260Mode.TEACH)
    assert driver.probe().capabilities == ("teach",)
    with pytest.raises(CommandRefusedError):
        driver.write(JointTarget.of({"J1": 0.1}))
    driver.ioctl(Command.ROBOT_MODE, bytes((Puma260Mode.POSITION,)))
    assert RobotStatus.parse(driver.ioctl(Command.ROBOT_PROBE)).mode == Puma260Mode.POSITION
    with pytest.raises(CommandRefusedError, match="bad range"):
        driver.ioctl(Command.ROBOT_MODE, b"\x07")


def test_every_field_of_joint_commands_arrives(bench: Bench) -> None:
    driver, robot, _, _ = bench
    driver.torque(True)
    commands = JointCommands(
        ("J2", "J6"), (0.1, 0.2), (0.3, 0.4), (0.5, 0.6), (0.7, 0.8), (0.9, 1.0), (1.1, 1.2), (1.3, 1.4),
        (-1.5, -1.6), (1.7, 1.8),
    )  # fmt: skip
    driver.command(commands)
    assert list(robot.executed) == [commands]


def test_a_load_is_a_share_of_the_most_torque(bench: Bench) -> None:
    driver, _, _, _ = bench
    assert driver.read().load == (0.0,) * 6
    driver.torque(True)
    assert driver.read().load == pytest.approx((_REST_EFFORT,) * 6)


def test_joint_commands_are_sent_with_the_joints_own_names(bench: Bench) -> None:
    driver, robot, _, _ = bench
    driver.torque(True)
    driver.command(JointCommands(("j2",), position=(0.1,)))
    assert list(robot.executed) == [JointCommands(("J2",), position=(0.1,))]


def test_a_long_trajectory_goes_in_fragments_and_is_followed(bench: Bench) -> None:
    driver, robot, link, clock = bench
    driver.torque(True)
    trajectory = line(2000)
    assert len(trajectory.serialize()) > 100_000
    driver.follow(trajectory)
    assert max(map(len, link.written)) <= 253
    assert list(robot.executed) == [trajectory]
    began = clock()
    worst = 0.0
    for _ in range(100):
        clock.advance(0.2)
        state = driver.read()
        t = clock() - began - 0.1  # the arm is a little behind
        worst = max(worst, abs(state.position[0] - 0.2 + 0.2 * math.cos(t)))
    assert worst < 0.02


def test_a_stream_of_states(bench: Bench) -> None:
    driver, _, _, clock = bench
    stamps = []
    for state in driver.stream(0.05):
        stamps.append(state.board_time)
        if len(stamps) == 10:
            break
    assert [b - a for a, b in itertools.pairwise(stamps)] == pytest.approx([0.05] * 9, abs=1e-3)
    driver.read()
    clock.advance(1.0)
    assert driver.session.poll_reports() is None


def test_a_stranger_in_its_place(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench.link.device.robot, "states", lambda now: _Two())  # type: ignore[attr-defined]
    with pytest.raises(RemoteProtocolError, match="2 joints; puma260 has 6"):
        bench.driver.read()


class _Two:
    def serialize(self) -> bytes:
        return bytes(5) + b"\x02" + bytes(20)


def test_nobody_there() -> None:
    driver = Puma260Driver.from_url("udp://127.0.0.1:9", boot_window=0.1)
    with pytest.raises(ReplyTimeoutError, match="IDENTIFY on udp"):
        driver.attach()
    assert not driver.session.is_open


# -- over real channels -----------------------------------------------------------------------------


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    # Its thread may wait for a busy machine.
    default(monkeypatch, RetryPolicy, attempts=150)
    with served_puma() as server:
        yield server


CONF = """\
# module_name | direction | destination module(enum) | interface type |
    device handle (address) | port number

PUMA260_HOST_IO_TRX      CLIENT_TRX
    PUMA260_RBT_IO_SVR {kind} 127.0.0.1 {port}
PUMA260_HOST_JNT_CMD_TX CLIENT_TRX
    PUMA260_RBT_IO_SVR {kind} 127.0.0.1 {port}
"""
MORE = """\
PUMA260_HOST_JSTATE_RX  CLIENT_RX
    PUMA260_RBT_IO_SVR {kind} 127.0.0.1 {port}
PUMA260_HOST_JTRAJ_TX   CLIENT_TX
    PUMA260_RBT_IO_SVR {kind} 127.0.0.1 {port}
"""


def drive(driver: Puma260Driver, robot: EmulatedPuma) -> None:
    """Everything once: states, commands, a trajectory in fragments, a stop in the middle of it."""
    with driver:
        driver.torque(True)
        driver.command(JointCommands(("J3",), position=(0.001,)))
        trajectory = line(4000)
        driver.follow(trajectory)
        assert robot.executed[-1] == trajectory
        end = time.monotonic() + 30
        while not any(abs(v) > 0.01 for v in driver.read().velocity) and time.monotonic() < end:
            time.sleep(0.02)
        assert driver.stop() == driver.model.names
        state = driver.read()
        assert state.stopped
        assert state.velocity == pytest.approx((0.0,) * 6)
        driver.resume()
        driver.detach(torque_off=True)
    assert not robot.power


@pytest.mark.system
def test_four_channels_over_tcp(served: Served) -> None:
    driver = Puma260Driver.from_url(served.tcp)
    sessions = [driver.session, driver.commands, driver.states, driver.trajectories]
    assert len(set(map(id, sessions))) == 4
    modules = [session.ipc.module.name for session in sessions]
    assert modules == [
        "PUMA260_HOST_IO_TRX",
        "PUMA260_HOST_JNT_CMD_TX",
        "PUMA260_HOST_JSTATE_RX",
        "PUMA260_HOST_JTRAJ_TX",
    ]
    drive(driver, served.robot)


@pytest.mark.system
def test_one_channel_over_udp(served: Served) -> None:
    driver = Puma260Driver.from_url(served.udp)
    assert driver.trajectories is driver.session
    drive(driver, served.robot)


@pytest.mark.system
@pytest.mark.parametrize("kind", ["TCP", "UDP"])
@pytest.mark.parametrize("more", ["", MORE])
def test_channels_of_the_chapters_file(served: Served, tmp_path: Path, kind: str, more: str) -> None:
    port = served.listener.port if kind == "TCP" else served.udp_link.port
    file = tmp_path / "ipc_msg.conf"
    file.write_text((CONF + more).format(kind=kind, port=port))
    driver = Puma260Driver.from_conf(file)
    channels = len({id(s) for s in (driver.session, driver.commands, driver.states, driver.trajectories)})
    assert channels == (1 if kind == "UDP" else 3 if more else 2), "one that only receives asks nothing"
    drive(driver, served.robot)


def test_a_file_without_the_io_channel(tmp_path: Path) -> None:
    file = tmp_path / "ipc_msg.conf"
    file.write_text("JOY_STICK CLIENT_TX ROS1_HOST UDP 127.0.0.1 15031\n")
    with pytest.raises(ConfigError, match=r"ipc_msg\.conf: no channel of PUMA260_HOST_IO_TRX"):
        Puma260Driver.from_conf(file)


@pytest.mark.system
def test_a_stop_passes_a_trajectory_that_is_being_sent(served: Served) -> None:
    with Puma260Driver.from_url(served.tcp) as driver:
        driver.torque(True)
        trajectory = line(18_000)
        assert len(trajectory.serialize()) > 1_000_000
        ended: list[object] = []

        def send() -> None:
            try:
                driver.follow(trajectory)
                ended.append("taken")
            except StoppedError as error:
                ended.append(error)

        sender = threading.Thread(target=send)
        sender.start()
        driver.stop(StopMode.HOLD)
        assert served.robot.stopped
        sender.join(30)
        state = driver.read()
        assert state.stopped
        assert state.velocity == pytest.approx((0.0,) * 6)
        assert len(ended) == 1


@pytest.mark.system
def test_a_stop_voids_what_waits_for_another_channel(served: Served) -> None:
    with Puma260Driver.from_url(served.tcp) as driver:
        driver.torque(True)
        taken, done = threading.Event(), threading.Event()
        turn = driver.trajectories._turn
        outcome: list[object] = []

        def hold() -> None:
            with turn.taken():
                taken.set()
                done.wait(30)

        def write() -> None:
            try:
                outcome.append(driver.write(JointTarget.of({"J1": 0.1}, 1.0)))
            except StoppedError as error:
                outcome.append(error)

        holder, writer = threading.Thread(target=hold), threading.Thread(target=write)
        holder.start()
        assert taken.wait(30)
        writer.start()
        time.sleep(0.2)
        before = list(served.robot.executed)
        driver.stop()
        done.set()
        for thread in (holder, writer):
            thread.join(30)
        driver.resume()
        assert isinstance(outcome[0], StoppedError)
        assert list(served.robot.executed) == before
        assert driver.read().velocity == pytest.approx((0.0,) * 6)


def test_a_raw_stop_and_a_raw_resume_are_recognised(bench: Bench) -> None:
    session = bench.driver.session
    with session.epochs.calling("a move"):
        session.request(Command.ROBOT_SIGNAL, b"\1")
        with pytest.raises(StoppedError, match="was not sent"):
            session.request(Command.ROBOT_SIGNAL, b"\4")
    session.request(Command.ROBOT_SIGNAL, b"\3")
    assert not session.epochs.stopped
    bench.driver.torque(True)


@pytest.mark.system
def test_a_line_that_breaks_is_made_again_and_nothing_moves_twice(served: Served) -> None:
    with connect(served.tcp, robot="puma260") as driver:
        assert isinstance(driver, Puma260Driver)
        driver.torque(True)
        _break(driver.states)
        assert driver.read().torque_on == driver.model.names
        assert driver.states.reconnects == 1
        _break(driver.trajectories)
        with pytest.raises(LinkLostError, match="JOINT_TRAJECTORY was not repeated"):
            driver.write(JointTarget.of({"J1": 0.1}, 0.5))
        assert not served.robot.executed
        driver.write(JointTarget.of({"J1": 0.1}, 0.5))
        states = driver.stream(0.02)
        next(states)
        _break(driver.states)
        assert next(states).names == driver.model.names
        while driver.states.reconnects == 1:
            next(states)  # of those that had come before
        # Also while reports end: that they have ended is all that is asked for.
        _break(driver.states)
        states.close()
        assert driver.states.reconnects == 3
        assert driver.read().names == driver.model.names


def _break(session: Session) -> None:
    """Cut the connection as a network does."""
    import os
    import socket

    fd = session.ipc.link.fileno()  # type: ignore[attr-defined]
    with socket.socket(fileno=os.dup(fd)) as cut:
        cut.shutdown(socket.SHUT_RDWR)
