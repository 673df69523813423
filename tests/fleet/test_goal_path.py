"""A path that the server of a shared arm follows: with a server in the test's hand, and one over a socket."""

from __future__ import annotations

import math

import pytest
from tests.fleet.conftest import Serve
from tests.motion.arms import rest_to_rest

from hexwire.control.motion.motions import MotionOptions, run_motion
from hexwire.drivers import registry
from hexwire.drivers.abilities import OnboardPaths, RefilledPaths
from hexwire.drivers.timed_path import PathState, TimedPoint
from hexwire.errors import GoalError, NotSupportedError, UsageError
from hexwire.fleet import messages as m
from hexwire.fleet.remote import GoalPath, RemoteRobot
from hexwire.motion.trajectory import Spline

POINTS = [TimedPoint(0.1 * i, (0.1 * i * i,), (0.2 * i,)) for i in range(11)]


class FakeServer:
    def __init__(self) -> None:
        self.time = 100.0
        self.sent: list[tuple[Spline, float, bool]] = []
        self.cancelled: list[int] = []
        self.row: m.Goal | None = m.Goal(7, 100.0)
        self.clock_offset = (3.0, 0.004)

    def follow(self, path: Spline, start: float, *, anywhere: bool = False) -> int:
        self.sent.append((path, start, anywhere))
        return 7

    def goal(self, number: int) -> m.Goal:
        if self.row is None:
            raise GoalError(f"there is no goal {number}")
        return self.row

    def cancel(self, number: int) -> None:
        self.cancelled.append(number)

    def path(self) -> GoalPath:
        return GoalPath(self, ["J1"], now=lambda: self.time)


def test_it_is_sent_whole_at_the_start() -> None:
    server = FakeServer()
    path = server.path()
    assert path.send(POINTS[:6]) == 6
    assert path.send(POINTS[4:], first=4, last=True) == 7
    assert path.report().state is PathState.LOADING
    start = path.start()
    assert 100.0 < start.time < 101.0
    assert start.uncertainty == 0.004
    ((sent, at, anywhere),) = server.sent
    assert (at, anywhere) == (start.time, True)
    assert [point.time for point in sent.waypoints] == [point.time for point in POINTS]
    assert sent.waypoints[10].velocity == (2.0,)
    assert path.report().state is PathState.WAITING
    server.time = start.time + 0.1
    assert path.report().state is PathState.RUNNING
    with pytest.raises(UsageError, match="no points after the start"):
        path.send(POINTS)
    path.abort()
    assert server.cancelled == [7]


def test_an_order_that_comes_too_late_is_given_more_time() -> None:
    server = FakeServer()
    follow, tried = server.follow, []

    def late(path: Spline, start: float, *, anywhere: bool = False) -> int:
        tried.append(start)
        server.time += 0.5
        if len(tried) < 3:
            raise GoalError("the start time is 0.1 s ago", reason="too late")
        return follow(path, start, anywhere=anywhere)

    server.follow = late  # type: ignore[method-assign]  # the network is slow
    path = server.path()
    path.send(POINTS, last=True)
    assert path.start().time == tried[2] > 102.0


def test_an_order_with_a_time_or_another_fault_is_not_repeated() -> None:
    server, tried = FakeServer(), []

    def refused(path: Spline, start: float, *, anywhere: bool = False) -> int:
        tried.append(start)
        raise GoalError("no", reason="too late" if server.time < 101.0 else "stopped")

    server.follow = refused  # type: ignore[method-assign]
    path = server.path()
    path.send(POINTS, last=True)
    with pytest.raises(GoalError):
        path.start(at=100.5)
    server.time = 200.0
    with pytest.raises(GoalError):
        path.start()
    assert len(tried) == 2


def test_two_points_are_a_path() -> None:
    server = FakeServer()
    path = server.path()
    path.send(POINTS[:2], last=True)
    path.start()
    assert len(server.sent) == 1


def test_a_path_that_is_not_whole_is_not_begun() -> None:
    server = FakeServer()
    path = server.path()
    path.send(POINTS)
    with pytest.raises(UsageError, match="at once"):
        path.start()
    with pytest.raises(UsageError, match="none can be sent as number 20"):
        path.send(POINTS, first=20)
    many = [TimedPoint(0.01 * i, (0.0,)) for i in range(path.capacity + 1)]
    assert path.send(many, first=0, last=True) == path.capacity
    with pytest.raises(UsageError, match="at once"):
        path.start()
    assert not server.sent
    assert not server.cancelled
    path.abort()


@pytest.mark.parametrize(
    ("outcome", "reason", "state"),
    [
        ("succeeded", "reached", PathState.DONE),
        ("aborted", "stopped", PathState.STOPPED),
        ("aborted", "path tolerance", PathState.ABORTED),
        ("preempted", "replaced", PathState.ABORTED),
    ],
)
def test_its_end_is_that_of_the_goal(outcome: str, reason: str, state: PathState) -> None:
    server = FakeServer()
    path = server.path()
    path.send(POINTS, last=True)
    path.start()
    server.row = m.Goal(7, 100.0, outcome, reason, "words")
    report = path.report()
    assert report.state is state
    assert report.why == ("" if state is PathState.DONE else "words")


def test_a_goal_that_waits_for_its_joints_is_done_and_one_that_was_replaced_is_gone() -> None:
    server = FakeServer()
    path = server.path()
    path.send(POINTS, last=True)
    server.time = path.start().time + 1.2
    assert path.report().state is PathState.RUNNING
    server.time += 0.2
    assert path.report().state is PathState.DONE
    server.row = None
    report = path.report()
    assert report.state is PathState.NONE
    assert "there is no goal" in report.why


@pytest.mark.slow
def test_a_motion_of_a_client_is_followed_by_the_board(serve: Serve) -> None:
    serve("lab/arm1", lease=2.0, port="sim://hex7bot?name=goalpath")
    with registry.connect("zenoh:lab/arm1") as robot:
        assert isinstance(robot, RemoteRobot)
        assert robot.can(OnboardPaths)
        assert not robot.can(RefilledPaths)
        # The server's controller moves all joints.
        robot.torque(True)
        here = robot.read()["J4"].position
        way = rest_to_rest(("J4",), (here,), (here + 0.2,), 0.6)
        result = run_motion(robot, way, MotionOptions(table=None, grace=20.0))
        assert result.arrived, result.why
        assert result.timed
        assert robot.read()["J4"].position == pytest.approx(here + 0.2, abs=0.03)
        with pytest.raises(UsageError, match="does not go on without the program"):
            robot.path(outlives=True)


@pytest.mark.slow
@pytest.mark.parametrize("host_timed", [False, True])
def test_what_a_server_does_not_allow_is_said_as_it_is(serve: Serve, host_timed: bool) -> None:
    """A client without a table, and the table of the server: a path is refused whole, a target when it comes."""
    serve("lab/arm1", lease=2.0, port="sim://hex7bot?name=goaltable")
    with registry.connect("zenoh:lab/arm1") as robot:
        robot.torque(True)
        here = robot.read().positions
        assert robot.kinematics is not None
        names = robot.kinematics.joint_names
        bent = [here["J1"], 0.0, math.radians(60.0), 0.0, 0.0, here["J6"]]
        way = rest_to_rest(names, [here[name] for name in names], bent, 2.0)
        with pytest.raises(UsageError, match="below the table") as refused:
            run_motion(robot, way, MotionOptions(table=None, host_timed=host_timed))
        moved = max(abs(robot.read()[name].position - here[name]) for name in names)
        if host_timed:
            assert moved > 0.05
            assert str(refused.value).endswith(": the motion ended on its way")
        else:
            assert moved < 0.01
            assert "nothing was sent" in str(refused.value)


def test_a_server_that_sends_targets_itself_gets_targets(serve: Serve) -> None:
    serve("lab/arm1", lease=2.0, port="sim://hex7bot?name=goalhost", host_timed=True)
    with registry.connect("zenoh:lab/arm1") as robot:
        assert not robot.can(OnboardPaths)
        with pytest.raises(NotSupportedError):
            robot.path()


def test_what_a_server_follows_is_reported_without_points_that_wait_for_room() -> None:
    server = FakeServer()
    path = server.path()
    path.send(POINTS[:6])
    assert path.report() == (PathState.LOADING, 6, 0, path.capacity - 6, 0, "", None)
    path.send(POINTS[6:], first=6, last=True)
    path.start()
    assert path.report() == (PathState.WAITING, 11, 0, 0, 0, "", None)
