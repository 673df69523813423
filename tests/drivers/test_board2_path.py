"""A path that the driver sends ahead to an emulated board."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import pytest
from tests.drivers.arms import Arm

from hexwire.drivers.abilities import OnboardPaths
from hexwire.drivers.board2 import Board2
from hexwire.drivers.board2_path import BoardTime
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.drivers.timed_path import PathState, TimedPath, TimedPoint
from hexwire.emulator.board_path import BoardPath
from hexwire.emulator.gate import RefusedError
from hexwire.errors import CommandRefusedError, LimitError, NotSupportedError, StoppedError, UsageError
from hexwire.session.events import Reply
from hexwire.wire.command_frame import Command, Status, parse_frame
from hexwire.wire.tables import CAPABILITY_FINE_POSITIONS, CAPABILITY_FRAGMENTS

PATIENCE = 20.0
"""Seconds that no path here takes."""


@pytest.fixture
def arm() -> Arm:
    made = Arm(2)
    made.driver.torque(True)
    return made


@pytest.fixture
def robot(arm: Arm) -> Hex7BotDriver:
    """Its time passes only as the test says: a machine that stalls would let a path run dry."""
    return arm.driver


def wave(start: float, way: float, seconds: float, steps: int) -> list[TimedPoint]:
    points = []
    for i in range(steps + 1):
        angle = 2.0 * math.pi * i / steps
        speed = way * math.pi / seconds * math.sin(angle)
        points.append(TimedPoint(seconds * i / steps, (start + way * (1 - math.cos(angle)) / 2,), (speed,)))
    return points


def until_over(arm: Arm, path: TimedPath) -> PathState:
    deadline = arm.clock.time + PATIENCE
    while not (state := path.report().state).over:
        assert arm.clock.time < deadline, state.name
        arm.wait(0.02)
    return state


def test_a_whole_path_is_followed(arm: Arm, robot: Hex7BotDriver) -> None:
    here = robot.read().positions["J2"]
    path = robot.path(["J2"])
    assert robot.can(OnboardPaths)
    assert path.joints == ("J2",)
    points = wave(here, 0.3, 1.0, 20)
    assert path.send(points, last=True) == 21
    before = robot.now()
    start = path.start()
    assert before - 0.5 < start.time < robot.now() + 0.5
    assert 0.0 <= start.uncertainty < 0.5
    far = 0.0
    deadline = arm.clock.time + PATIENCE
    while not (report := path.report()).state.over:
        far = max(far, robot.read().positions["J2"] - here)
        assert arm.clock.time < deadline
        arm.wait(0.02)
    assert (report.state, report.sent, report.towards) == (PathState.DONE, 21, 20)
    assert far == pytest.approx(0.3, abs=0.05)
    assert robot.read().positions["J2"] == pytest.approx(here, abs=0.02)


def test_a_start_can_be_set_for_later(arm: Arm, robot: Hex7BotDriver) -> None:
    here = robot.read().positions["J1"]
    path = robot.path(["J1"])
    path.send(wave(here, 0.2, 0.5, 10), last=True)
    wanted = robot.now() + 1.0
    start = path.start(wanted)
    assert start.time == pytest.approx(wanted, abs=0.05 + start.uncertainty)
    assert path.report().state is PathState.WAITING
    assert until_over(arm, path) is PathState.DONE


def test_more_points_than_fit_are_taken_in_parts(arm: Arm, robot: Hex7BotDriver) -> None:
    here = robot.read().positions["J1"]
    path = robot.path(["J1"], smooth=False)
    points = [
        TimedPoint(0.002 * i, (here + 0.0002 * abs(i % 200 - 100) - 0.02,)) for i in range(path.capacity + 300)
    ]
    sent = path.send(points, last=True)
    assert sent == path.capacity
    path.start()
    deadline = arm.clock.time + PATIENCE
    while sent < len(points):
        sent += path.send(points[sent:], last=True)
        assert arm.clock.time < deadline
        arm.wait(0.02)
    assert until_over(arm, path) is PathState.DONE
    assert path.report().sent == len(points)


def test_points_that_are_ahead_can_be_replaced(arm: Arm, robot: Hex7BotDriver) -> None:
    here = robot.read().positions["J1"]
    path = robot.path(["J1"], smooth=False)
    path.send([TimedPoint(0.25 * i, (here + 0.05 * i,)) for i in range(9)], last=True)
    path.start()
    towards = path.report().towards
    with pytest.raises(UsageError, match="none can be sent as number 10"):
        path.send([TimedPoint(9.0, (here,))], first=10)
    back = here + 0.05 * (towards + 1)
    new = [TimedPoint(0.25 * (towards + 2), (back,)), TimedPoint(0.25 * (towards + 3), (back,))]
    assert path.send(new, last=True, first=towards + 2) == 2
    assert until_over(arm, path) is PathState.DONE
    assert robot.read().positions["J1"] == pytest.approx(back, abs=0.02)


def test_a_stop_ends_it(robot: Hex7BotDriver) -> None:
    here = robot.read().positions["J1"]
    path = robot.path(["J1"])
    path.send(wave(here, 0.4, 2.0, 40), last=True)
    path.start()
    robot.stop()
    assert path.report().state is PathState.STOPPED
    with pytest.raises(StoppedError):
        robot.path(["J1"])
    robot.resume()
    with pytest.raises(CommandRefusedError):
        path.start()
    assert path.report().state is PathState.STOPPED


def test_an_abort_brings_it_to_rest(arm: Arm, robot: Hex7BotDriver) -> None:
    here = robot.read().positions["J1"]
    path = robot.path(["J1"], brake=0.1)
    path.send(wave(here, 0.4, 2.0, 40), last=True)
    path.start()
    assert path.abort() is PathState.BRAKING
    assert until_over(arm, path) is PathState.ABORTED
    assert path.abort() is PathState.ABORTED


def test_another_path_takes_its_place(robot: Hex7BotDriver) -> None:
    first, second = robot.path(["J1"]), robot.path(["J2"])
    assert first.report().state is PathState.NONE
    assert second.report().state is PathState.LOADING


@pytest.mark.parametrize(
    ("points", "error", "text"),
    [
        ([TimedPoint(0.1, (0.0,), (0.0,))], UsageError, "begins at 0 s"),
        ([TimedPoint(0.0, (0.0,))], UsageError, "positions and velocities of J1"),
        ([TimedPoint(0.0, (0.0, 0.0), (0.0, 0.0))], UsageError, "positions and velocities of J1"),
        ([TimedPoint(0.0, (9.0,), (0.0,))], LimitError, "J1"),
        ([TimedPoint(0.0, (0.0,), (99.0,))], LimitError, "J1 would pass"),
        ([TimedPoint(0.0, (0.0,), (0.0,)), TimedPoint(0.01, (0.5,), (0.0,))], LimitError, "J1 would turn 28.6 deg"),
        ([TimedPoint(0.0, (0.0,), (0.0,)), TimedPoint(0.0, (0.0,), (0.0,))], UsageError, "after the one before"),
        ([TimedPoint(0.0, (0.0,), (0.0,)), TimedPoint(7.0, (0.0,), (0.0,))], UsageError, "at most 6.5 s"),
        ([TimedPoint(0.0, (math.nan,), (0.0,))], LimitError, "J1"),
        ([TimedPoint(0.0, (0.0,), (math.nan,))], LimitError, "J1"),
    ],
)
def test_a_point_that_cannot_be_is_refused_before_anything_is_sent(
    robot: Hex7BotDriver, points: list[TimedPoint], error: type[Exception], text: str
) -> None:
    path = robot.path(["J1"])
    with pytest.raises(error, match=text):
        path.send(points)
    assert path.report().sent == 0


def test_the_time_to_come_to_rest_is_bounded(robot: Hex7BotDriver) -> None:
    with pytest.raises(UsageError, match=r"0.02\.\.2 s"):
        robot.path(["J1"], brake=3.0)


def test_a_board_of_the_chapters_dialect_keeps_no_time() -> None:
    with Hex7BotDriver.from_url("sim://hex7bot?name=chapter&dialect=1") as robot:
        assert not robot.can(OnboardPaths)
        with pytest.raises(NotSupportedError):
            robot.path(["J1"])


def test_the_time_on_the_line_narrows_the_relation_of_the_clocks() -> None:
    now = [100.0]
    slow, bare = BoardTime(lambda: now[0], 115200), BoardTime(lambda: now[0], 0)
    reply = Reply(1, 0x23, 0, bytes(16), None, 0.012, 1)
    assert slow.note(reply, 0, 5_000_000) == bare.note(reply, 0, 5_000_000) == 5.0
    # 44 bytes take 3.8 ms, 60 take 5.2 ms.
    assert bare.relation.host_time(5.0).uncertainty == pytest.approx(0.006)
    assert slow.relation.host_time(5.0).uncertainty == pytest.approx((0.012 - 104 * 10 / 115200) / 2)
    # An emulated line may be faster than its rate.
    now[0], quick = 101.0, reply._replace(rtt=0.001)
    slow.note(quick, 0, 6_000_000)
    assert slow.relation.host_time(6.0).time == pytest.approx(101.0, abs=0.02)


def test_a_line_of_known_rate_tells_more_of_when_a_path_starts() -> None:
    def doubt(told: int) -> float:
        arm = Arm(2, 115200, attach=False)
        arm.link.baud = told  # type: ignore[attr-defined]  # as that of a serial port
        arm.driver.attach()
        arm.driver.torque(True)
        path = arm.driver.path()
        path.send(line_of(arm, 20), last=True)
        return path.start().uncertainty

    assert doubt(115200) < 0.5 * doubt(0)


def line_of(arm: Arm, count: int, *, way: float = 0.2) -> list[TimedPoint]:
    """An even motion of all joints."""
    here = arm.driver.read().position
    return [
        TimedPoint(0.05 * n, tuple(p + way * n / count for p in here), (way / count / 0.05,) * 7)
        for n in range(count)
    ]


@pytest.mark.parametrize("whole", [True, False])
def test_a_whole_path_is_one_request_where_the_board_takes_fragments(whole: bool) -> None:
    arm = Arm(2)
    arm.driver.torque(True)
    board = arm.driver._board
    assert isinstance(board, Board2)
    if not whole:
        board.identity = board.identity._replace(capabilities=board.identity.capabilities & ~CAPABILITY_FRAGMENTS)
    points = line_of(arm, 60)
    path = arm.driver.path()
    before = len(arm.link.written)
    assert path.send(points, last=True) == 60
    commands = Counter(parse_frame(data).cmd for data in arm.link.written[before:])
    # 60 points of 30 bytes: chunks of 200 bytes, or six points a frame.
    assert commands == ({Command.FRAGMENT: 10} if whole else {Command.TRAJECTORY_POINTS: 10})
    assert path.report().sent == 60
    # Points that replace others do not go in fragments; what follows them may.
    before = len(arm.link.written)
    assert path.send(points, last=True, first=0) == 60
    assert parse_frame(arm.link.written[before]).cmd == Command.TRAJECTORY_POINTS
    assert path.report().sent == 60


def test_more_points_than_fit_go_in_a_message_that_fits() -> None:
    arm = Arm(2)
    arm.driver.torque(True)
    path = arm.driver.path()
    points = line_of(arm, 90)
    assert path.send(points, last=True) == path.capacity == 64
    path.start()
    arm.wait(2.0)
    assert path.report().room > 30
    assert path.send(points[64:], last=True) == 26
    arm.wait(3.5)
    assert path.report().state is PathState.DONE


@pytest.mark.parametrize("fine", [True, False])
def test_positions_keep_eighths_of_a_count_where_the_board_does(fine: bool) -> None:
    arm = Arm(2)
    arm.driver.torque(True)
    board = arm.driver._board
    assert isinstance(board, Board2)
    if not fine:
        board.identity = board.identity._replace(
            capabilities=board.identity.capabilities & ~CAPABILITY_FINE_POSITIONS
        )
    here = arm.driver.read().positions["J2"]
    joint = arm.driver.model.joint("J2")
    path = arm.driver.path(["J2"], smooth=False)
    angle = here + 10.3 * joint.scale
    path.send([TimedPoint(0.0, (here,)), TimedPoint(1.0, (angle,))], last=True)
    made = arm.board.trajectory.path
    assert made is not None
    counts = (angle - joint.offset) / joint.scale * joint.sign + joint.neutral
    unit = 8 if fine else 1
    assert made._knots[-1].positions == (round(counts * unit),)
    path.start()
    arm.wait(1.5)
    assert path.report().state is PathState.DONE
    assert arm.shaft(1) == pytest.approx(counts, abs=3)


def test_an_answer_to_a_repeat_says_nothing_of_the_clock() -> None:
    times = BoardTime(lambda: 10.0, 0)
    reply = Reply(1, Command.TRAJECTORY_STATUS, 0, b"", None, 0.001, 2)
    times.note(reply, 0, 5_000_000)
    assert not times.relation
    times.note(reply._replace(attempts=1), 0, 5_000_000)
    assert times.relation


def test_paths_of_two_programs_are_not_taken_for_each_other() -> None:
    numbers = set()
    for i in range(8):
        with Hex7BotDriver.from_url(f"sim://hex7bot?name=number{i}") as robot:
            robot.path(["J2"])
            numbers.add(robot.ioctl(Command.TRAJECTORY_STATUS)[0])
    # All the same by chance: once in 10^16.
    assert len(numbers) > 1


# -- coming to rest if nothing else is sent ---------------------------------------------------------------------


def ramp(here: float, begin: int, end: int) -> list[TimedPoint]:
    """Even motion at 0.2 rad/s, a point every 50 ms."""
    return [TimedPoint(0.05 * i, (here + 0.01 * i,), (0.2,)) for i in range(begin, end)]


def rest_after(point: TimedPoint) -> list[TimedPoint]:
    """Two points to rest."""
    (here,) = point.positions
    return [
        TimedPoint(point.time + 0.1 * i, (here + far,), (v,)) for i, far, v in ((1, 0.015, 0.1), (2, 0.02, 0.0))
    ]


def test_without_further_points_the_joints_come_to_rest_on_those_that_were_sent_for_it(
    arm: Arm, robot: Hex7BotDriver
) -> None:
    here = robot.read().positions["J1"]
    path = robot.path(["J1"])
    assert path.send([TimedPoint(0.0, (here,), (0.0,)), *ramp(here, 1, 11)], rest=rest_after) == 11
    report = path.report()
    assert (report.sent, report.room, report.rest) == (11, path.capacity - 11, None)
    path.start()
    arm.wait(0.3)
    assert path.report().state is PathState.RUNNING
    arm.wait(0.3)
    report = path.report()
    assert (report.state, report.sent) == (PathState.BRAKING, 11)
    with pytest.raises((CommandRefusedError, UsageError)):
        path.send(ramp(here, 11, 14), rest=rest_after)
    assert until_over(arm, path) is PathState.DRY
    assert path.report().rest == pytest.approx((here + 0.12,))
    assert robot.read().positions["J1"] == pytest.approx(here + 0.12, abs=0.005)


@pytest.mark.parametrize("joints", [1, 7])
def test_points_that_come_in_time_replace_the_rest(joints: int, arm: Arm, robot: Hex7BotDriver) -> None:
    names = robot.model.names[:joints]
    here = robot.read().positions

    def points(begin: int, end: int) -> list[TimedPoint]:
        still = [here[name] for name in names[1:]]
        return [
            TimedPoint(p.time, (*p.positions, *still), (*(p.velocities or ()), *[0.0] * len(still)))
            for p in ([TimedPoint(0.0, (here["J1"],), (0.0,))] if begin == 0 else ramp(here["J1"], begin, end))
        ]

    def rest(point: TimedPoint) -> list[TimedPoint]:
        tail = rest_after(TimedPoint(point.time, point.positions[:1], (0.2,)))
        still = point.positions[1:]
        return [
            TimedPoint(p.time, (*p.positions, *still), (*(p.velocities or ()), *[0.0] * len(still))) for p in tail
        ]

    path = robot.path(names)
    path.send([*points(0, 1), *points(1, 9)], rest=rest)
    path.start()
    for n in range(9, 60, 3):
        assert path.report().state is PathState.RUNNING
        assert path.send(points(n, n + 3), rest=rest) == 3
        # After each call the board has a path to rest.
        assert arm.board.trajectory.path is not None
        assert arm.board.trajectory.path.whole
        arm.wait(0.12)
    assert path.send(points(60, 61), rest=rest) == 1
    assert until_over(arm, path) is PathState.DRY
    assert robot.read().positions["J1"] == pytest.approx(here["J1"] + 0.62, abs=0.01)


def test_the_last_points_need_no_rest_and_a_path_without_one_is_as_before(arm: Arm, robot: Hex7BotDriver) -> None:
    here = robot.read().positions["J1"]
    path = robot.path(["J1"])
    points = wave(here, 0.1, 1.0, 20)
    path.send(points[:15], rest=lambda point: ())
    assert arm.board.trajectory.path is not None
    assert not arm.board.trajectory.path.whole
    path.send(points[15:], last=True, rest=rest_after)
    path.start()
    assert until_over(arm, path) is PathState.DONE
    assert path.report().rest is None
    assert path.report().sent == 21


@pytest.mark.parametrize(("ahead", "requests"), [(0.3, [True, False, True]), (1.2, [False, True])])
def test_only_a_board_with_few_points_needs_a_rest_in_every_request(
    ahead: float, requests: list[bool], arm: Arm, robot: Hex7BotDriver
) -> None:
    """Seven joints have 6 points in a request, of which a rest takes up to 3."""
    here = robot.read().positions
    names = robot.model.names

    def points(begin: int, end: int) -> list[TimedPoint]:
        return [TimedPoint(0.05 * n, tuple(here[name] for name in names), (0.0,) * 7) for n in range(begin, end)]

    def rest(point: TimedPoint) -> list[TimedPoint]:
        return [TimedPoint(point.time + 0.03 * i, point.positions, (0.0,) * 7) for i in (1, 2, 3)]

    path = robot.path()
    count = round(ahead / 0.05)
    path.send(points(0, count), rest=rest)
    path.start()
    path.report()
    before = len(arm.link.written)
    # Three with a rest, until there are enough for 0.6 s; then six without; the last three with one.
    path.send(points(count, count + (12 if ahead < 0.6 else 9)), rest=rest)
    frames = [parse_frame(raw) for raw in arm.link.written[before:]]
    asked = [bool(frame.body[1]) for frame in frames if frame.cmd == Command.TRAJECTORY_POINTS]
    assert asked == requests


def test_a_board_whose_points_are_replaced_is_not_left_with_few(arm: Arm, robot: Hex7BotDriver) -> None:
    """What is behind the first request is gone before the second one comes."""
    here = robot.read().positions
    names = robot.model.names

    def points(begin: int, end: int) -> list[TimedPoint]:
        return [TimedPoint(0.02 * n, tuple(here[name] for name in names), (0.0,) * 7) for n in range(begin, end)]

    def rest(point: TimedPoint) -> list[TimedPoint]:
        return [TimedPoint(point.time + 0.1 * i, point.positions, (0.0,) * 7) for i in (1, 2, 3)]

    path = robot.path(brake=0.5)
    path.send(points(0, 58), rest=rest)
    path.start()
    arm.wait(0.1)
    path.report()
    seen: list[bool] = []
    put = BoardPath.put

    def watched(board: BoardPath, *args: Any, **named: Any) -> None:
        put(board, *args, **named)
        seen.append(board.whole)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BoardPath, "put", watched)
        path.send(points(12, 30), first=12, rest=rest)
    assert len(seen) > 2
    assert all(seen)
    assert path.report().state is PathState.RUNNING


def test_what_a_request_left_on_a_running_path_counts_although_the_next_is_refused(
    arm: Arm, robot: Hex7BotDriver
) -> None:
    here = robot.read().positions
    row = tuple(here[name] for name in robot.model.names)
    path = robot.path(brake=0.5)
    path.send([TimedPoint(0.02 * n, row, (0.0,) * 7) for n in range(58)])
    path.start()
    arm.wait(0.1)
    path.report()
    put, taken = BoardPath.put, list[int]()

    def once(board: BoardPath, first: int, points: Any, *args: Any, **named: Any) -> None:
        if taken:
            raise RefusedError(Status.BAD_RANGE)
        put(board, first, points, *args, **named)
        taken.append(len(points))

    more = [TimedPoint(0.02 * n, row, (0.0,) * 7) for n in range(12, 30)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BoardPath, "put", once)
        assert path.send(more, first=12) == taken[0] < len(more)
        with pytest.raises(CommandRefusedError):
            path.send(more[taken[0] :])
    assert path.report().sent == 12 + taken[0]
