"""A trajectory on the board (PROTOCOL.md section 6.7), asked of every board."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import pytest
from tests.conformance_board.adapter import EVERY_BOARD, BoardUnderTest

from hexwire.emulator.faults import FaultPlan
from hexwire.wire import tables
from hexwire.wire.board_trajectory import (
    BeginReply,
    BeginRequest,
    PathFlag,
    PathPoint,
    PathState,
    PathStatus,
    PointsRequest,
    StartReply,
    StartRequest,
)
from hexwire.wire.command_frame import Command, Frame, Status
from hexwire.wire.commands import Identity, JointReport
from hexwire.wire.servo_packet import make_write

# The first one builds.

START = (2053, 2043, 2035, 2039, 2083, 2046, 2047)
ALL = 0x7F
LEGACY, HLS = range(4), range(4, 7)
NUMBER = 5
MOVE_SYNC = 0x83

Make = Callable[..., "Rider"]


@dataclass(frozen=True)
class Sent:
    """A target that the board sent: when it began, for which joint, and where."""

    time: float
    joint: int
    target: int


class Rider:
    """A host that sends trajectories to a board whose joints have torque."""

    def __init__(self, kind: str, faults: tuple[str, ...]) -> None:
        self.board = BoardUnderTest(kind, faults)
        self.machine, self.client = self.board.machine, self.board.client
        self.next = 0
        assert self.ask(Command.TORQUE, b"\1\x7f\0").status == Status.OK

    def ask(self, command: int, body: bytes = b"") -> Frame:
        return self.client.ask(command, body, within=1.5)

    def begin(
        self,
        mask: int = ALL,
        *,
        hermite: bool = False,
        outlives: bool = False,
        fine: bool = False,
        brake: int = 200,
    ) -> int:
        flags = (PathFlag.HERMITE if hermite else 0) | (PathFlag.OUTLIVES_HOST if outlives else 0)
        flags |= PathFlag.FINE if fine else 0
        self.next = 0
        return self.ask(Command.TRAJECTORY_BEGIN, BeginRequest(NUMBER, flags, mask, brake).serialize()).status

    def add(self, points: Sequence[PathPoint], *, last: bool = False) -> int:
        """Add points, in as many requests as they need; the first status that is not OK."""
        size = 2 + len(points[0].positions) * (4 if points[0].velocities else 2)
        each = min(255, 203 // size)
        for at in range(0, len(points), each):
            chunk = points[at : at + each]
            final = last and at + each >= len(points)
            request = PointsRequest.of(NUMBER, self.next, chunk, last=final)
            status = self.ask(Command.TRAJECTORY_POINTS, request.serialize()).status
            if status != Status.OK:
                return status
            self.next += len(chunk)
        return Status.OK

    def start(self, ahead: float | None = None) -> int:
        """Start now, or so many seconds ahead."""
        clock = self.status().time_us
        time_us = clock + round(1e6 * ahead) if ahead is not None else 0
        request = StartRequest(NUMBER, int(ahead is None), time_us & 0xFFFFFFFF)
        return self.ask(Command.TRAJECTORY_START, request.serialize()).status

    def status(self) -> PathStatus:
        return PathStatus.parse(self.ask(Command.TRAJECTORY_STATUS).body)

    def state(self) -> PathState:
        return self.status().state

    def run(self, seconds: float) -> None:
        self.client.run(seconds)

    def until(self, state: PathState, within: float = 4.0) -> None:
        end = self.machine.now + within
        while (now := self.state()) != state:
            assert self.machine.now < end, f"{now.name} instead of {state.name}"
            self.run(0.02)

    def sent(self, since: float = 0.0) -> list[Sent]:
        """The targets on the servo line."""
        found = []
        for time, packet in self.machine.line.sent:
            if time < since or len(packet) < 8 or packet[4] != MOVE_SYNC or packet[5] not in (0x29, 0x2A):
                continue
            old = packet[5] == 0x2A
            for at in range(7, len(packet) - 1, packet[6] + 1):
                raw = packet[at + 1 : at + 3] if old else packet[at + 2 : at + 4]
                found.append(Sent(time, packet[at], int.from_bytes(raw, "big" if old else "little")))
        return found

    def shafts(self) -> list[float]:
        self.machine.wire.step(self.machine.now)
        return [self.machine.wire[i].motion.position for i in range(7)]

    def rests(self, seconds: float = 0.4) -> None:
        """Nothing moves for a while."""
        before = self.shafts()
        self.run(seconds)
        assert self.shafts() == pytest.approx(before, abs=4)


@pytest.fixture(params=EVERY_BOARD)
def make(request: pytest.FixtureRequest) -> Iterator[Make]:
    made: list[Rider] = []

    def build(*faults: str) -> Rider:
        made.append(Rider(request.param, faults))
        return made[-1]

    yield build
    for rider in made:
        rider.board.close()


def line(way: int, steps: int, seconds: float, joints: Sequence[int] = range(7)) -> list[PathPoint]:
    """An even motion of some joints."""
    ticks = round(seconds * 1e4)
    return [
        PathPoint(ticks if n else 0, tuple(START[j] + round(way * n / steps) for j in joints))
        for n in range(steps + 1)
    ]


def wave(way: float, period: float, steps: int, joints: Sequence[int] = range(7)) -> list[PathPoint]:
    """A motion away and back that begins and ends at rest, with velocities."""
    points = []
    for n in range(steps + 1):
        angle = 2 * math.pi * n / steps
        place = round(way * (1 - math.cos(angle)) / 2)
        speed = round(way * math.pi / period * math.sin(angle))
        points.append(
            PathPoint(
                round(period / steps * 1e4) if n else 0,
                tuple(START[j] + place for j in joints),
                (speed,) * len(joints),
            )
        )
    return points


def test_the_board_says_that_it_has_trajectories(make: Make) -> None:
    rider = make()
    assert Identity.parse(rider.ask(Command.IDENTIFY).body).capabilities & tables.CAPABILITY_TRAJECTORY
    assert rider.status()[:5] == (0, PathState.NONE, 0, 0, rider.status().free)
    reply = BeginReply.parse(
        rider.ask(Command.TRAJECTORY_BEGIN, BeginRequest(NUMBER, PathFlag.HERMITE, ALL, 200).serialize()).body
    )
    assert reply.capacity >= 64
    assert 10 <= reply.lead_ms <= 100


def test_joints_follow_a_straight_path_and_hold_at_its_end(make: Make) -> None:
    rider = make()
    assert rider.begin() == Status.OK
    assert rider.state() == PathState.LOADING
    assert rider.add(line(200, 4, 0.25), last=True) == Status.OK
    assert not rider.sent()[7:], "nothing moves before the start"
    since = rider.machine.now
    assert rider.start() == Status.OK
    rider.until(PathState.DONE)
    rider.run(0.1)
    targets = rider.sent(since)
    for joint in range(7):
        own = [each for each in targets if each.joint == joint]
        assert own[-1].target == START[joint] + 200
        # Evenly, and without a pause: 200 counts a second.
        middle = [each for each in own if START[joint] + 20 < each.target < START[joint] + 180]
        assert len(middle) > 30
        for a, b in itertools.pairwise(middle):
            assert b.target - a.target == pytest.approx(200 * (b.time - a.time), abs=1.5)
    rider.run(0.5)
    assert rider.shafts() == pytest.approx([place + 200 for place in START], abs=6)
    rider.rests()


def test_velocities_make_it_a_smooth_curve(make: Make) -> None:
    rider = make()
    rider.begin(hermite=True)
    period, way = 2.0, 300.0
    assert rider.add(wave(way, period, 40), last=True) == Status.OK
    since = rider.machine.now
    rider.start()
    rider.until(PathState.DONE)
    for joint in (0, 6):
        own = [each for each in rider.sent(since) if each.joint == joint]
        # The phase that fits best; then every target is on the curve.
        moments = [each.time - own[0].time for each in own]

        def off(lead: float, own: list[Sent] = own, joint: int = joint, moments: list[float] = moments) -> float:
            errors = []
            for moment, each in zip(moments, own, strict=True):
                angle = 2 * math.pi * min(moment + lead, period) / period
                errors.append(abs(each.target - START[joint] - way * (1 - math.cos(angle)) / 2))
            return max(errors)

        assert min(off(0.001 * ms) for ms in range(60)) <= 2.5


def test_a_path_may_be_longer_than_the_boards_memory(make: Make) -> None:
    rider = make()
    rider.begin(1)
    points = [PathPoint(100 if n else 0, (START[0] + n % 400,)) for n in range(400)]
    points += [PathPoint(100, (START[0] + 400 - n % 400,)) for n in range(400)]
    assert rider.add(points[:300]) == Status.OK
    rider.start()
    at = 300
    while at < len(points):
        free = rider.status().free
        chunk = points[at : at + min(free, 50)]
        if chunk:
            assert rider.add(chunk, last=at + len(chunk) == len(points)) == Status.OK
        at += len(chunk)
        rider.run(0.1)
    rider.until(PathState.DONE, 12.0)
    assert rider.status().next == len(points)
    assert rider.sent()[-1].target == START[0] + 1
    assert rider.status().late == 0


def test_points_that_do_not_fit_are_not_stored(make: Make) -> None:
    rider = make()
    rider.begin(1)
    capacity = rider.status().free
    assert rider.add([PathPoint(10 if n else 0, (START[0],)) for n in range(capacity - 10)]) == Status.OK
    assert rider.status().free == 10
    assert rider.add([PathPoint(10, (START[0],))] * 11) == Status.BUSY
    assert rider.status().free == 10
    assert rider.add([PathPoint(10, (START[0],))] * 10) == Status.OK
    assert rider.status().free == 0


def test_points_that_are_still_ahead_can_be_replaced(make: Make) -> None:
    rider = make()
    rider.begin(1)
    assert rider.add(line(300, 6, 0.25, [0]), last=True) == Status.OK
    since = rider.machine.now
    rider.start()
    rider.run(0.3)
    index = rider.status().towards
    assert index == 2
    # The point that the joint moves to stays; from the next one on it turns back.
    rider.next = index
    back = [PathPoint(2500, (START[0] + 50,)), PathPoint(2500, (START[0],))]
    assert rider.add(back) == Status.BAD_RANGE
    rider.next = index + 1
    assert rider.add(back) == Status.OK
    assert rider.status().next == index + 3
    assert rider.add([PathPoint(2500, (START[0],))], last=True) == Status.OK
    rider.next = index + 3
    assert rider.add([PathPoint(2500, (START[0] + 5,))], last=True) == Status.OK
    rider.until(PathState.DONE)
    targets = [each.target for each in rider.sent(since)]
    assert START[0] + 95 <= max(targets) <= START[0] + 100
    assert targets[-1] == START[0] + 5
    assert rider.status().next == index + 4


def test_before_the_start_all_points_can_be_replaced(make: Make) -> None:
    rider = make()
    rider.begin(1)
    rider.add(line(300, 6, 0.25, [0]), last=True)
    rider.next = 0
    assert rider.add(line(-80, 2, 0.25, [0]), last=True) == Status.OK
    assert rider.status().next == 3
    rider.start()
    rider.until(PathState.DONE)
    assert rider.sent()[-1].target == START[0] - 80


def test_it_starts_at_a_time_of_the_boards_clock(make: Make) -> None:
    rider = make()
    rider.begin()
    rider.add(line(100, 2, 0.25), last=True)
    before = rider.machine.now
    assert rider.start(0.5) == Status.OK
    assert rider.state() == PathState.WAITING
    rider.until(PathState.DONE)
    first = rider.sent(before)[0].time - before
    assert 0.49 <= first <= 0.56


def test_a_start_that_has_passed_or_is_far_ahead_is_refused(make: Make) -> None:
    rider = make()
    rider.begin()
    rider.add(line(100, 2, 0.25), last=True)
    assert rider.start(-0.001) == Status.BAD_RANGE
    assert rider.start(10.5) == Status.BAD_RANGE
    assert rider.state() == PathState.LOADING
    assert rider.start(9.0) == Status.OK
    # Another one changes the time.
    assert rider.start(0.1) == Status.OK
    rider.until(PathState.DONE)


def test_the_reply_has_the_time_of_the_start(make: Make) -> None:
    rider = make()
    rider.begin()
    rider.add(line(50, 2, 0.25), last=True)
    clock = rider.status().time_us
    reply = rider.ask(Command.TRAJECTORY_START, StartRequest(NUMBER, 0, clock + 300_000).serialize())
    assert StartReply.parse(reply.body) == (NUMBER, PathState.WAITING, clock + 300_000)


@pytest.mark.parametrize(
    ("body", "status"),
    [
        (BeginRequest(NUMBER, 0, 0, 200), Status.BAD_RANGE),
        (BeginRequest(NUMBER, 0, 0x80, 200), Status.BAD_RANGE),
        (BeginRequest(NUMBER, 8, ALL, 200), Status.BAD_RANGE),
        (BeginRequest(NUMBER, 0, ALL, 19), Status.BAD_RANGE),
        (BeginRequest(NUMBER, 0, ALL, 2001), Status.BAD_RANGE),
    ],
)
def test_a_beginning_out_of_range_is_refused(make: Make, body: BeginRequest, status: Status) -> None:
    rider = make()
    assert rider.ask(Command.TRAJECTORY_BEGIN, body.serialize()).status == status
    assert rider.ask(Command.TRAJECTORY_BEGIN, body.serialize()[:-1]).status == Status.BAD_LENGTH
    assert rider.state() == PathState.NONE


def test_a_bad_point_is_refused_with_all_of_its_request(make: Make) -> None:
    rider = make()
    good = line(40, 2, 0.25, [0])
    limit = 4095
    for bad in (
        [PathPoint(1, (START[0],))],  # the first has no time
        [*good, PathPoint(0, (START[0] + 40,))],
        [*good, PathPoint(2500, (limit + 1,))],
        [*good, PathPoint(100, (START[0] + 1000,))],
        [*good, PathPoint(2500, (-1,))],
    ):
        rider.begin(1)
        assert rider.add(bad) == Status.BAD_RANGE, bad
        assert rider.status().next == 0
    rider.begin(1)
    assert rider.add(good) == Status.OK
    far = PointsRequest.of(NUMBER, 5, good[1:], last=False).serialize()
    assert rider.ask(Command.TRAJECTORY_POINTS, far).status == Status.BAD_RANGE
    other = PointsRequest.of(NUMBER + 1, 3, good[1:], last=False).serialize()
    assert rider.ask(Command.TRAJECTORY_POINTS, other).status == Status.BAD_RANGE
    short = PointsRequest.of(NUMBER, 3, good[1:], last=False).serialize()[:-1]
    assert rider.ask(Command.TRAJECTORY_POINTS, short).status == Status.BAD_LENGTH
    none = PointsRequest(NUMBER, 0, 3, 0, b"").serialize()
    assert rider.ask(Command.TRAJECTORY_POINTS, none).status == Status.BAD_LENGTH
    assert rider.add([PathPoint(2500, (START[0] + 40,))], last=True) == Status.OK
    # After the last one no other.
    assert rider.add([PathPoint(2500, (START[0] + 40,))]) == Status.BAD_RANGE


def test_a_velocity_beyond_the_limit_is_refused(make: Make) -> None:
    rider = make()
    limits = rider.ask(Command.LIMITS).body
    speed = int.from_bytes(limits[6:8], "little")
    rider.begin(1, hermite=True)
    assert rider.add([PathPoint(0, (START[0],), (speed + 1,))]) == Status.BAD_RANGE
    assert rider.add([PathPoint(0, (START[0],), (-speed - 1,))]) == Status.BAD_RANGE
    assert rider.add([PathPoint(0, (START[0],), (-speed,))]) == Status.OK


def test_it_does_not_start_elsewhere_nor_with_too_little_path_nor_without_torque(make: Make) -> None:
    rider = make()
    assert rider.start() == Status.BAD_RANGE, "there is none"
    rider.begin(1)
    rider.add([PathPoint(0, (START[0] + 100,)), PathPoint(5000, (START[0] + 120,))], last=True)
    assert rider.start() == Status.BAD_RANGE, "the joint is elsewhere"
    rider.begin(1)
    rider.add([PathPoint(0, (START[0],))])
    assert rider.start() == Status.BAD_RANGE, "one point is no path"
    rider.add([PathPoint(500, (START[0],))])
    assert rider.start() == Status.BAD_RANGE, "it would be dry before it can brake"
    rider.add([PathPoint(5000, (START[0],))])
    rider.ask(Command.TORQUE, b"\0\1\0")
    assert rider.start() == Status.TORQUE_OFF
    assert rider.state() == PathState.LOADING
    rider.rests()


def test_one_at_a_time(make: Make) -> None:
    rider = make()
    rider.begin()
    rider.add(line(200, 4, 0.25), last=True)
    rider.start()
    assert rider.begin() == Status.BUSY
    rider.until(PathState.DONE)
    assert rider.begin() == Status.OK
    assert rider.status().next == 0


def test_its_joints_take_no_other_targets_but_others_do(make: Make) -> None:
    rider = make()
    rider.begin(0b0010001)
    rider.add(line(200, 4, 0.25, [0, 4]), last=True)
    rider.start()
    for joint in (0, 4):
        body = b"\x64\0\1" + bytes((joint,)) + (START[joint] + 50).to_bytes(2, "little")
        assert rider.ask(Command.JOINT_MOVE, body).status == Status.BUSY
    packet = make_write(4, 0x2A, (START[4] + 50).to_bytes(2, "little"))
    assert rider.ask(Command.TRANSACT, b"\6\0" + packet).status == Status.BUSY
    assert rider.ask(Command.TORQUE, b"\1\1\0").status == Status.BUSY
    body = b"\x64\0\1\1" + (START[1] + 50).to_bytes(2, "little")
    assert rider.ask(Command.JOINT_MOVE, body).status == Status.OK
    rider.until(PathState.DONE)
    rider.run(0.5)
    at = rider.shafts()
    assert at[:2] == pytest.approx([START[0] + 200, START[1] + 50], abs=6)
    assert at[4] == pytest.approx(START[4] + 200, abs=6)


def test_states_are_read_and_reported_meanwhile(make: Make) -> None:
    rider = make()
    rider.ask(Command.REPORT, b"\x14\0\0")
    rider.begin()
    rider.add(line(200, 4, 0.25), last=True)
    rider.start()
    frames = rider.client.run(0.8)
    reports = [JointReport.parse(f.body) for f in frames if f.cmd == Command.JOINT_STATE]
    assert len(reports) >= 30
    assert reports[-1].position[0] > reports[0].position[0] + 50


# -- ends -------------------------------------------------------------------------------------------------------


def test_without_further_points_it_brakes_on_its_path(make: Make) -> None:
    rider = make()
    rider.begin()
    rider.add(line(200, 4, 0.25))
    since = rider.machine.now
    rider.start()
    rider.until(PathState.BRAKING)
    assert rider.add([PathPoint(2500, tuple(START))]) == Status.BAD_RANGE
    rider.until(PathState.DRY)
    rider.run(0.1)
    own = [each for each in rider.sent(since) if each.joint == 0]
    # It does not get to the last point, and becomes slower and slower.
    assert START[0] + 100 < own[-1].target <= START[0] + 200
    ways = [b.target - a.target for a, b in zip(own[-10:], own[-9:], strict=False)]
    assert ways[-1] <= 1 < ways[0]
    assert all(a >= b - 1 for a, b in itertools.pairwise(ways))
    rider.rests()
    assert rider.start() == Status.BAD_RANGE


def test_an_abort_brakes_too_and_may_be_repeated(make: Make) -> None:
    rider = make()
    assert rider.ask(Command.TRAJECTORY_ABORT, bytes((0,))).status == Status.BAD_RANGE
    rider.begin()
    rider.add(line(300, 6, 0.25), last=True)
    assert rider.ask(Command.TRAJECTORY_ABORT, bytes((NUMBER + 1,))).status == Status.BAD_RANGE
    rider.start()
    rider.run(0.4)
    reply = rider.ask(Command.TRAJECTORY_ABORT, bytes((NUMBER,)))
    assert (reply.status, reply.body) == (Status.OK, bytes((NUMBER, PathState.BRAKING)))
    rider.until(PathState.ABORTED)
    reply = rider.ask(Command.TRAJECTORY_ABORT, bytes((NUMBER,)))
    assert (reply.status, reply.body) == (Status.OK, bytes((NUMBER, PathState.ABORTED)))
    assert rider.shafts()[0] < START[0] + 250
    rider.rests()


def test_one_that_waits_is_aborted_at_once(make: Make) -> None:
    rider = make()
    rider.begin()
    rider.add(line(200, 4, 0.25), last=True)
    rider.start(0.5)
    assert rider.ask(Command.TRAJECTORY_ABORT, bytes((NUMBER,))).body[1] == PathState.ABORTED
    since = rider.machine.now
    rider.run(1.0)
    assert not rider.sent(since)


@pytest.mark.parametrize("mode", [0, 1])
@pytest.mark.parametrize("when", ["loading", "waiting", "running"])
def test_a_stop_ends_it_and_resume_continues_nothing(make: Make, mode: int, when: str) -> None:
    rider = make()
    rider.begin()
    rider.add(line(300, 6, 0.25), last=True)
    if when != "loading":
        rider.start(0.3 if when == "waiting" else None)
    if when == "running":
        rider.run(0.4)
    assert rider.ask(Command.STOP, bytes((mode,))).status == Status.OK
    assert rider.state() == PathState.STOPPED
    assert rider.begin() == Status.STOPPED
    assert rider.ask(Command.RESUME).status == Status.OK
    assert rider.state() == PathState.STOPPED
    assert rider.start() == Status.BAD_RANGE
    assert rider.add([PathPoint(2500, tuple(START))]) == Status.BAD_RANGE
    since = rider.machine.now
    rider.run(1.0)
    assert not rider.sent(since)


def test_orders_that_wait_at_a_stop_are_void(make: Make) -> None:
    rider = make()
    client = rider.client
    begin = client.frame(Command.TRAJECTORY_BEGIN, BeginRequest(NUMBER, 0, ALL, 200).serialize())
    points = PointsRequest.of(NUMBER, 0, line(200, 4, 0.25), last=True).serialize()
    frames = begin + client.frame(Command.TRAJECTORY_POINTS, points)
    frames += client.frame(Command.TRAJECTORY_START, StartRequest(NUMBER, 1, 0).serialize())
    slow = client.frame(Command.TRANSACT, bytes((8, 200)) + bytes((0xFF, 0xFF, 9, 2, 1, 0xF3)))
    rider.machine.send(slow + frames + client.frame(Command.STOP, b"\0"))
    rider.run(0.6)
    rider.machine.send(frames)
    rider.ask(Command.RESUME)
    since = rider.machine.now
    rider.run(1.0)
    assert not rider.sent(since)
    assert rider.state() == PathState.NONE


def test_the_watchdog_stops_it_unless_it_was_told_to_let_it_finish(make: Make) -> None:
    rider = make()
    rider.ask(Command.WATCHDOG, b"\xc8\0\0")
    rider.begin()
    rider.add(line(300, 6, 0.25), last=True)
    rider.start()
    rider.run(1.0)
    assert rider.state() == PathState.STOPPED
    assert rider.shafts()[0] < START[0] + 150
    rider.ask(Command.RESUME)


def test_a_whole_trajectory_may_outlive_its_host(make: Make) -> None:
    rider = make()
    rider.ask(Command.WATCHDOG, b"\xc8\0\0")
    rider.begin(outlives=True)
    rider.add(line(300, 6, 0.25), last=True)
    rider.start()
    rider.run(2.4)
    status = rider.status()
    assert status.state == PathState.DONE
    assert rider.shafts() == pytest.approx([place + 300 for place in START], abs=6)
    # Afterwards the host was silent for too long.
    flags = JointReport.parse(rider.ask(Command.JOINT_STATE, b"\0").body).board_flags
    assert flags & tables.BOARD_FLAGS_WATCHDOG_TRIPPED


def test_an_unfinished_trajectory_does_not_outlive_its_host(make: Make) -> None:
    rider = make()
    rider.ask(Command.WATCHDOG, b"\xc8\0\0")
    rider.begin(outlives=True)
    rider.add(line(300, 6, 0.25))
    rider.start()
    rider.run(1.0)
    assert rider.state() == PathState.STOPPED


@pytest.mark.parametrize("joint", [1, 5])
def test_torque_off_ends_it_for_that_joint_and_the_others_brake(make: Make, joint: int) -> None:
    rider = make()
    rider.begin()
    rider.add(line(300, 6, 0.25), last=True)
    rider.start()
    rider.run(0.4)
    assert rider.ask(Command.TORQUE, b"\0" + bytes((1 << joint, 0))).status == Status.OK
    since = rider.machine.now
    rider.until(PathState.FAULT)
    rider.run(0.1)
    assert not rider.machine.wire[joint].torque_on
    named = {each.joint for each in rider.sent(since)}
    assert joint not in named
    assert rider.shafts()[0] < START[0] + 250
    rider.rests()


@pytest.mark.parametrize("joint", [2, 6])
def test_a_joint_that_falls_silent_ends_it(make: Make, joint: int) -> None:
    rider = make()
    rider.begin()
    rider.add(line(300, 6, 0.25), last=True)
    rider.start()
    rider.run(0.3)
    rider.machine.wire.faults = FaultPlan([f"silent:{joint}"])
    rider.until(PathState.FAULT)
    others = [i for i in range(7) if i != joint]
    assert all(rider.shafts()[i] < START[i] + 280 for i in others)
    rider.rests()


def test_a_reset_forgets_it(make: Make) -> None:
    rider = make()
    rider.begin()
    rider.add(line(300, 6, 0.25), last=True)
    rider.start()
    rider.run(0.4)
    rider.machine.reset()
    rider.run(1.0)
    assert rider.state() == PathState.NONE
    rider.rests()


def test_a_clamped_path_stays_within_changed_limits(make: Make) -> None:
    rider = make()
    rider.begin(1)
    rider.add(line(300, 6, 0.25, [0]), last=True)
    rider.start()
    table = bytearray(rider.ask(Command.LIMITS).body[1:])
    table[3:5] = (START[0] + 150).to_bytes(2, "little")
    assert rider.ask(Command.LIMITS, bytes(table)).status == Status.OK
    rider.until(PathState.DONE)
    assert rider.sent()[-1].target == START[0] + 150


# -- fine positions ---------------------------------------------------------------------------------------------


def in_eighths(points: Sequence[PathPoint], more: int = 0) -> list[PathPoint]:
    """The same points in eighths of a count, each so many eighths further on."""
    return [point._replace(positions=tuple(8 * place + more for place in point.positions)) for point in points]


def test_a_fine_path_is_rounded_when_it_is_sent(make: Make) -> None:
    rider = make()
    assert rider.begin(fine=True) == Status.OK
    # 30 counts in two seconds, 0.625 of a count beside whole ones.
    points = [PathPoint(20000 if n else 0, tuple(8 * p + 5 + 240 * n for p in START)) for n in range(2)]
    assert rider.add(points, last=True) == Status.OK
    since = rider.machine.now
    assert rider.start() == Status.OK
    rider.until(PathState.DONE)
    rider.run(0.1)
    for joint in range(7):
        own = [each for each in rider.sent(since) if each.joint == joint]
        assert own[-1].target == START[joint] + 31
        steps = [(b.time, b.target) for a, b in itertools.pairwise(own) if b.target > a.target]
        # Whole counts are passed every 66.7 ms; the first is at 0.875 of a count, since halves go either way.
        inner = [time for time, target in steps if START[joint] + 3 < target < START[joint] + 28]
        gaps = [b - a for a, b in itertools.pairwise(inner)]
        assert sum(gaps) / len(gaps) == pytest.approx(2.0 / 30, rel=0.02)


def test_a_fine_cubic_path_follows_its_velocities(make: Make) -> None:
    rider = make()
    assert rider.begin(hermite=True, fine=True) == Status.OK
    assert rider.add(in_eighths(wave(150, 1.0, 20), 3), last=True) == Status.OK
    since = rider.machine.now
    assert rider.start() == Status.OK
    rider.until(PathState.DONE)
    targets = [each for each in rider.sent(since) if each.joint == 4]
    assert max(each.target for each in targets) == pytest.approx(START[4] + 150, abs=1)
    assert targets[-1].target == START[4]


def test_fine_points_are_checked_to_an_eighth(make: Make) -> None:
    rider = make()
    assert rider.begin(0b1, fine=True) == Status.OK
    # The usual limits are 0 to 4095 counts, or 32760 eighths.
    for place in (-1, 32761, 32767, -32768):
        assert rider.add([PathPoint(0, (place,))]) == Status.BAD_RANGE
    assert rider.add([PathPoint(0, (32760,))]) == Status.OK
    assert rider.begin(0b1, fine=True) == Status.OK
    speed = tables.DEFAULT_SPEED
    assert rider.add([PathPoint(0, (16000,))]) == Status.OK
    far = 8 * speed // 100
    assert rider.add([PathPoint(100, (16000 + far + 2,))]) == Status.BAD_RANGE
    assert rider.add([PathPoint(100, (16000 + far + 1,))]) == Status.OK


@pytest.mark.parametrize(("beside", "expected"), [(64 * 8 + 3, Status.OK), (64 * 8 + 4, Status.BAD_RANGE)])
def test_a_fine_start_is_compared_in_counts(make: Make, beside: int, expected: int) -> None:
    rider = make()
    assert rider.begin(0b1, fine=True) == Status.OK
    place = JointReport.parse(rider.ask(Command.JOINT_STATE, b"\0").body).position[0]
    points = [PathPoint(10000 * n, (8 * place + beside + n,)) for n in range(2)]
    assert rider.add(points, last=True) == Status.OK
    assert rider.start() == expected
