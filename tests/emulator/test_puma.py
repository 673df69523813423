"""The emulated PUMA 260, asked frame by frame."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.emulator.puma import FRICTION, INERTIA, EmulatedPuma, Gains, Path, PumaPeer, gains_of
from hexwire.model.arms.puma260.kinematics import PUMA260, counts_to_angles
from hexwire.model.control_law import ControlLaw
from hexwire.session.connection import Connection, Role
from hexwire.session.events import Reply, Report
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Status
from hexwire.wire.commands import Identity
from hexwire.wire.modules import ModuleType
from hexwire.wire.robot_bodies import EncoderStates, JointCommands, RobotStatus, TrajectoryPoints


@st.composite
def paths(draw: st.DrawFn) -> tuple[TrajectoryPoints, tuple[float, ...], tuple[float, ...]]:
    angle = st.floats(-3, 3)
    steps = draw(st.lists(st.floats(0.01, 3), min_size=1, max_size=8))
    first = draw(st.sampled_from([0.0, 0.5]))
    times = tuple(first + sum(steps[:i]) for i in range(len(steps)))
    row = st.tuples(angle, angle)
    rows = st.lists(row, min_size=len(times), max_size=len(times)).map(tuple)
    made = TrajectoryPoints(times, draw(rows), draw(st.just(()) | rows))
    return made, draw(row), draw(row)


@given(paths())
def test_a_path_goes_through_its_waypoints_without_a_jump(case: tuple[TrajectoryPoints, ...]) -> None:
    trajectory, origin, velocity = case
    path = Path(trajectory, origin, velocity)
    assert path.duration == trajectory.times[-1]
    for when, point in zip(trajectory.times, trajectory.positions, strict=True):
        assert path.at(when) == pytest.approx(point, abs=1e-9)
    if trajectory.times[0] > 0:
        assert path.at(0.0) == pytest.approx(origin)
    assert path.at(path.duration + 100) == trajectory.positions[-1]
    # Continuous: close times give close places.
    for i in range(50):
        t = path.duration * i / 50
        here, there = path.at(t), path.at(t + 1e-7)
        assert all(abs(a - b) < 1e-3 for a, b in zip(here, there, strict=True))


def test_a_path_starts_as_fast_as_the_joint_is_and_ends_at_rest() -> None:
    path = Path(TrajectoryPoints((1.0, 2.0), ((0.5,), (1.0,))), (0.0,), (0.3,))
    assert path.at(1e-6)[0] / 1e-6 == pytest.approx(0.3, abs=1e-3)
    assert (path.at(2.0)[0] - path.at(2.0 - 1e-6)[0]) / 1e-6 == pytest.approx(0.0, abs=1e-3)


def test_speeds_at_waypoints_are_kept() -> None:
    path = Path(TrajectoryPoints((1.0, 2.0), ((0.5,), (1.0,)), ((0.8,), (-0.2,))), (0.0,), (0.0,))
    for when, speed in ((1.0, 0.8), (2.0 - 1e-6, -0.2)):
        assert (path.at(when)[0] - path.at(when - 1e-6)[0]) / 1e-6 == pytest.approx(speed, abs=1e-3)


def test_a_turning_point_is_not_overshot() -> None:
    path = Path(TrajectoryPoints((1.0, 2.0), ((1.0,), (0.0,))), (0.0,), (0.0,))
    assert max(path.at(i / 100)[0] for i in range(200)) == pytest.approx(1.0)


def test_the_law_of_joint_commands() -> None:
    # effort + kp e + clamp(ki integral) + kd de/dt + kp_velocity (speed error), with e = 0.5 rad for one second.
    law = Gains(ControlLaw(
        velocity=1.0, effort=2.0, kp_position=10.0, ki_position=4.0, kd_position=3.0, kp_velocity=5.0,
        i_effort_min=-1.0, i_effort_max=9.0,
    ))  # fmt: skip
    assert law.torque(0.5, 0.2, 1.0) == pytest.approx(2 + 5 + 4 * 0.5 - 3 * 0.2 + 5 * (1.0 - 0.2))
    assert law.acceleration(0.0, 0.0, 1.0) == pytest.approx((2 + 2 + 5) / INERTIA)
    assert Gains(ControlLaw()).acceleration(0.0, 1.0, 1.0) == pytest.approx(-FRICTION / INERTIA)


def test_the_integral_is_held_and_does_not_wind_up() -> None:
    law = Gains(ControlLaw(ki_position=2.0, i_effort_min=-1.0, i_effort_max=1.0))
    for _ in range(1000):
        assert law.torque(1.0, 0.0, 0.1) <= 1.0
    # Had it wound up to 200, it would stay at 1 for long.
    assert law.torque(-1.0, 0.0, 0.3) < 1.0
    assert law.torque(-1.0, 0.0, 1.0) == -1.0


def test_a_law_needs_an_effort_or_a_gain() -> None:
    assert gains_of(JointCommands(("J1",), position=(1.0,), velocity=(0.1,)), 0) is None
    made = gains_of(JointCommands(("J1", "J2"), velocity=(0.1, 0.2), kp_position=(3.0, 4.0)), 1)
    assert made == Gains(ControlLaw(velocity=0.2, kp_position=4.0))
    assert math.isclose(gains_of(JointCommands(("J1",), effort=(0.5,)), 0).law.effort, 0.5)  # type: ignore[union-attr]


REST = (0.0,) * 6


class Host:
    """A host of one peer; time is what the test says."""

    def __init__(self, robot: EmulatedPuma, module: ModuleType = ModuleType.PUMA260_HOST_IO_TRX) -> None:
        self.peer = robot.connect()
        self.end = Connection(Role.HOST, local=module, remote=ModuleType.PUMA260_RBT_IO_SVR, type=1, max_frame=8192)
        self.now = robot.start

    def ask(self, cmd: int, body: bytes = b"") -> Reply:
        self.end.request(cmd, body, self.now)
        for _ in range(200):
            for frame in self.end.data_to_send():
                self.peer.receive(frame, self.now)
            self.peer.step(self.now)
            self.end.receive(self.peer.data_to_send(), self.now)
            while (event := self.end.next_event()) is not None:
                if isinstance(event, Reply):
                    return event
        raise AssertionError("no reply")

    def run(self, seconds: float) -> None:
        self.now += seconds
        self.peer.step(self.now)

    def angles(self) -> tuple[float, ...]:
        rows = EncoderStates.parse(self.ask(Command.JOINT_STATES).body).rows
        return counts_to_angles([row.counts for row in rows])

    def signal(self, number: int) -> int:
        return self.ask(Command.ROBOT_SIGNAL, bytes((number,))).status


@pytest.fixture
def host() -> Host:
    return Host(EmulatedPuma(start=50.0))


def one(duration: float, **angles: float) -> bytes:
    goal = [angles.get(name, 0.0) for name in PUMA260.names]
    return TrajectoryPoints((duration,), (tuple(goal),)).serialize()


def test_it_says_who_it_is(host: Host) -> None:
    identity = Identity.parse(host.ask(Command.IDENTIFY).body)
    assert (identity.protocol, len(identity.joints), identity.max_frame) == (2, 6, tables.MAX_NETWORK_FRAME)
    status = RobotStatus.parse(host.ask(Command.ROBOT_PROBE).body)
    assert status == RobotStatus(1, 0, tables.ROBOT_FLAGS_CALIBRATED, 6)
    assert host.ask(0x7E).status == Status.UNKNOWN_COMMAND


def test_nothing_moves_without_power(host: Host) -> None:
    assert host.ask(Command.JOINT_TRAJECTORY, one(1.0, J1=0.3)).status == Status.TORQUE_OFF
    commands = JointCommands(("J1",), (0.3,)).serialize()
    assert host.ask(Command.JOINT_COMMANDS, commands).status == Status.TORQUE_OFF
    host.run(2.0)
    assert host.angles() == pytest.approx(REST, abs=1e-4)


def test_it_follows_a_trajectory(host: Host) -> None:
    assert host.signal(4) == Status.OK
    reply = host.ask(Command.JOINT_TRAJECTORY, one(1.0, J1=0.4, J5=0.5, J6=-0.2))
    assert (reply.status, reply.body) == (Status.OK, b"\x01\0")
    host.run(0.5)
    halfway = host.angles()
    assert 0.05 < halfway[0] < 0.35
    assert host.ask(Command.ROBOT_PROBE).body[5] & tables.ROBOT_FLAGS_MOVING
    host.run(1.5)
    assert host.angles() == pytest.approx((0.4, 0, 0, 0, 0.5, -0.2), abs=2e-3)
    assert not host.ask(Command.ROBOT_PROBE).body[5] & tables.ROBOT_FLAGS_MOVING


def test_time_cut_anyhow_gives_the_same_motion() -> None:
    places = []
    for cuts in (1, 7, 500):
        host = Host(EmulatedPuma(start=50.0))
        host.signal(4)
        host.ask(Command.JOINT_TRAJECTORY, one(1.0, J1=0.4))
        for i in range(cuts):
            host.now = 50.0 + 0.7 * (i + 1) / cuts
            host.peer.step(host.now)
        places.append(host.peer.robot.position[0])
    assert places[1:] == pytest.approx(places[:1] * 2, abs=1e-12)


@pytest.mark.parametrize(("number", "power"), [(1, True), (2, False)])
def test_a_stop_is_latched(host: Host, number: int, power: bool) -> None:
    host.signal(4)
    host.ask(Command.JOINT_TRAJECTORY, one(1.0, J1=0.4))
    host.run(0.5)
    assert host.signal(number) == Status.OK
    there = host.angles()
    for cmd, body in (
        (Command.JOINT_TRAJECTORY, one(1.0, J1=0.1)),
        (Command.JOINT_COMMANDS, JointCommands(("J1",), (0.1,)).serialize()),
        (Command.ROBOT_SIGNAL, b"\x04"),
        (Command.ROBOT_MODE, b"\x01"),
    ):
        reply = host.ask(cmd, body)
        assert (reply.status, reply.body) == (Status.STOPPED, b"")
    host.run(1.0)
    assert host.angles() == there
    assert host.signal(3) == Status.OK
    host.run(1.0)
    assert host.angles() == there
    assert bool(host.peer.robot.power) is power


def test_in_teach_mode_the_joints_have_no_torque(host: Host) -> None:
    host.signal(4)
    assert host.ask(Command.ROBOT_MODE, b"\x01").body == bytes((1, tables.ROBOT_FLAGS_CALIBRATED))
    assert host.signal(4) == Status.NOT_SUPPORTED
    assert host.ask(Command.JOINT_TRAJECTORY, one(1.0)).status == Status.NOT_SUPPORTED
    assert host.ask(Command.ROBOT_MODE, b"\x00").status == Status.OK
    assert host.ask(Command.JOINT_TRAJECTORY, one(1.0)).status == Status.TORQUE_OFF
    assert host.signal(4) == Status.OK


def test_limits_are_the_controllers_too(host: Host) -> None:
    host.signal(4)
    beyond = math.radians(314)
    assert host.ask(Command.JOINT_TRAJECTORY, one(1.0, J1=beyond)).status == Status.BAD_RANGE
    assert (
        host.ask(Command.JOINT_COMMANDS, JointCommands(("J1",), (beyond,)).serialize()).status == Status.BAD_RANGE
    )
    assert host.ask(Command.JOINT_COMMANDS, JointCommands(("J9",), (0.0,)).serialize()).status == Status.BAD_RANGE
    five = TrajectoryPoints((1.0,), ((0.0,) * 5,)).serialize()
    assert host.ask(Command.JOINT_TRAJECTORY, five).status == Status.BAD_RANGE
    assert not host.peer.robot.executed


def test_joint_commands_move_the_named_joints(host: Host) -> None:
    host.signal(4)
    host.ask(Command.JOINT_COMMANDS, JointCommands(("J2", "J4"), position=(0.2, -0.3)).serialize())
    host.run(0.1)
    host.ask(Command.JOINT_COMMANDS, JointCommands(("J6",), position=(0.1,)).serialize())
    host.run(2.0)
    assert host.angles() == pytest.approx((0, 0.2, 0, -0.3, 0, 0.1), abs=2e-3)


def test_a_step_is_taken_at_the_speed_limit(host: Host) -> None:
    host.signal(4)
    host.ask(Command.JOINT_COMMANDS, JointCommands(("J1",), position=(3.0,)).serialize())
    fastest = 0.0
    for _ in range(30):
        host.run(0.05)
        fastest = max(fastest, host.peer.robot.velocity[0])
    assert fastest == pytest.approx(PUMA260.joints[0].max_speed)


def test_a_velocity_runs_on_for_half_a_second_only(host: Host) -> None:
    host.signal(4)
    spin = JointCommands(("J1",), velocity=(0.2,)).serialize()
    for _ in range(4):
        host.ask(Command.JOINT_COMMANDS, spin)
        host.run(0.25)
    assert host.angles()[0] == pytest.approx(0.2, abs=0.03)
    host.run(3.0)
    assert host.angles()[0] == pytest.approx(0.2 + 0.25 * 0.2, abs=0.01)
    assert not host.peer.robot.moving


def test_a_velocity_ends_at_the_limit(host: Host) -> None:
    host.signal(4)
    for _ in range(10):
        host.ask(Command.JOINT_COMMANDS, JointCommands(("J1",), velocity=(-0.5,)).serialize())
        host.run(0.3)
    assert host.angles()[0] == pytest.approx(PUMA260.joints[0].minimum, abs=2e-3)


def keep(host: Host, commands: JointCommands, seconds: float) -> None:
    """Command the same again and again."""
    for _ in range(round(seconds / 0.4)):
        host.ask(Command.JOINT_COMMANDS, commands.serialize())
        host.run(0.4)


def test_gains_replace_the_controllers_own_loop(host: Host) -> None:
    host.signal(4)
    stiff = JointCommands(
        ("J1",), position=(0.2,), kp_position=(2.0,), kd_position=(0.6,), i_effort_min=(0.0,), i_effort_max=(0.0,)
    )
    keep(host, stiff, 4.0)
    assert host.angles()[0] == pytest.approx(0.2, abs=0.01)
    # The same with a feed-forward effort settles where it balances the spring: effort / kp further.
    keep(host, JointCommands(("J1",), (0.2,), effort=(0.1,), kp_position=(2.0,), kd_position=(0.6,)), 6.0)
    assert host.angles()[0] == pytest.approx(0.25, abs=0.01)
    # Half a second after the last command the joint is held where it is, and does not spring back.
    host.run(3.0)
    assert host.angles()[0] == pytest.approx(0.25, abs=0.01)
    assert not host.peer.robot.moving
    host.signal(1)
    stopped = host.angles()[0]
    host.run(1.0)
    assert host.angles()[0] == stopped


def test_an_effort_alone_ends_at_the_limit(host: Host) -> None:
    host.signal(4)
    host.ask(Command.JOINT_COMMANDS, JointCommands(("J1",), effort=(-5.0,)).serialize())
    host.run(3.0)
    assert host.angles()[0] == pytest.approx(PUMA260.joints[0].minimum, abs=2e-3)
    assert abs(host.peer.robot.velocity[0]) < 0.5


@pytest.mark.parametrize(
    ("cmd", "body", "status"),
    [
        (Command.ROBOT_SIGNAL, b"", Status.BAD_LENGTH),
        (Command.ROBOT_SIGNAL, b"\x01\x01", Status.BAD_LENGTH),
        (Command.ROBOT_SIGNAL, b"\x00", Status.BAD_RANGE),
        (Command.ROBOT_SIGNAL, b"\x06", Status.BAD_RANGE),
        (Command.ROBOT_MODE, b"\x02", Status.BAD_RANGE),
        (Command.ROBOT_PROBE, b"x", Status.BAD_LENGTH),
        (Command.REPORT, b"\x04\0\0", Status.BAD_RANGE),
        (Command.REPORT, b"\x04\0", Status.BAD_LENGTH),
        (Command.JOINT_COMMANDS, b"", Status.BAD_LENGTH),
        (Command.JOINT_TRAJECTORY, b"\x06\0\x01\0", Status.BAD_LENGTH),
    ],
)
def test_bad_requests_have_a_status_and_no_body(host: Host, cmd: int, body: bytes, status: Status) -> None:
    reply = host.ask(cmd, body)
    assert (reply.status, reply.body) == (status, b"")
    assert not host.peer.robot.stopped


def test_reports_go_to_who_asked_until_they_end() -> None:
    robot = EmulatedPuma(start=50.0)
    host = Host(robot, ModuleType.PUMA260_HOST_JSTATE_RX)
    assert host.ask(Command.REPORT, b"\x14\0\0").status == Status.OK
    seen = []
    for _ in range(50):
        host.run(0.01)
        host.end.receive(host.peer.data_to_send(), host.now)
        while (event := host.end.next_event()) is not None:
            if isinstance(event, Report):
                seen.append(event.frame)
    assert 24 <= len(seen) <= 26
    assert {(frame.cmd, frame.dst) for frame in seen} == {(Command.JOINT_STATES, ModuleType.PUMA260_HOST_JSTATE_RX)}
    host.ask(Command.REPORT, b"\0\0\0")
    host.run(1.0)
    assert host.peer.data_to_send() == b""
    host.ask(Command.REPORT, b"\x14\0\0")
    host.ask(Command.IDENTIFY)
    host.run(1.0)
    assert host.peer.data_to_send() == b""


def test_all_hosts_see_one_robot() -> None:
    robot = EmulatedPuma(start=50.0)
    one_host, other = Host(robot), Host(robot)
    one_host.signal(4)
    assert other.ask(Command.JOINT_TRAJECTORY, one(0.5, J1=0.2)).status == Status.OK
    one_host.run(2.0)
    other.now = one_host.now
    assert other.angles() == one_host.angles()
    assert other.angles()[0] == pytest.approx(0.2, abs=2e-3)


@given(st.lists(st.binary(max_size=120), max_size=8), st.integers(0x10, 0x40), st.binary(max_size=60))
def test_any_bytes_leave_it_working(noise: list[bytes], cmd: int, body: bytes) -> None:
    host = Host(EmulatedPuma(start=50.0))
    for piece in noise:
        host.peer.receive(piece, host.now)
        host.run(0.06)
        host.peer.data_to_send()
    if cmd not in (Command.FRAGMENT, Command.FRAGMENT_MISSING):
        assert host.ask(cmd, body).status in iter(Status)
    assert len(host.angles()) == 6


def test_a_peer_is_a_served_device() -> None:
    robot = EmulatedPuma(start=50.0)
    peer: PumaPeer = robot.connect(253)
    peer.reset(51.0)
    assert peer.next_event_time() is None
    assert robot.boot_id == 1
