from __future__ import annotations

import itertools
from collections.abc import Generator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.emulator.boards import ALL, STOPPED_FLAG, Bench, u16

from hexwire.emulator.board_bus import BoardBus
from hexwire.emulator.board_orders import BoardOrders
from hexwire.emulator.board_state import BoardSettings, BoardState
from hexwire.emulator.board_trajectory import LEAD_MS, BoardTrajectory, TrajectoryCommands
from hexwire.emulator.faults import FaultPlan
from hexwire.emulator.gate import RefusedError
from hexwire.errors import RemoteProtocolError
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
from hexwire.wire.command_frame import Command, Status
from hexwire.wire.commands import LimitRow, LimitTable
from hexwire.wire.servo_packet import make_ping, make_write

START = (2053, 2043, 2035, 2039, 2083, 2046, 2047)
NUMBER = 9


class Rider(Bench):
    """A host with a board whose joints have torque."""

    def __init__(self, baud: int = 115200) -> None:
        super().__init__(baud=baud)
        self.run(0.5)
        assert self.torque().status == Status.OK

    def load(
        self,
        way: int = 400,
        seconds: float = 1.0,
        *,
        mask: int = ALL,
        flags: int = 0,
        brake: int = 200,
        last: bool = True,
    ) -> None:
        """An even motion in ten parts."""
        assert self.ask(Command.TRAJECTORY_BEGIN, BeginRequest(NUMBER, flags, mask, brake).serialize()).status == 0
        joints = [j for j in range(7) if mask >> j & 1]
        ticks = round(seconds * 1000)
        points = [PathPoint(ticks if n else 0, tuple(START[j] + way * n // 10 for j in joints)) for n in range(11)]
        reply = self.ask(Command.TRAJECTORY_POINTS, PointsRequest.of(NUMBER, 0, points, last=last).serialize())
        assert reply.status == Status.OK

    def start(self, ahead: float | None = None) -> int:
        at = 0 if ahead is None else (self.look().time_us + round(ahead * 1e6)) & 0xFFFFFFFF
        request = StartRequest(NUMBER, int(ahead is None), at)
        return self.ask(Command.TRAJECTORY_START, request.serialize()).status

    def look(self) -> PathStatus:
        return PathStatus.parse(self.ask(Command.TRAJECTORY_STATUS).body)

    def until_over(self, within: float = 5.0) -> PathState:
        end = self.now + within
        while not (status := self.look()).state.over:
            assert self.now < end, status
            self.run(0.02)
        return status.state

    def targets(self, joint: int = 0, since: float = 0.0) -> list[tuple[float, int]]:
        found = []
        for time, packet in self.bus_sent:
            if time < since or packet[4] != 0x83 or packet[5] not in (0x29, 0x2A):
                continue
            old = packet[5] == 0x2A
            for at in range(7, len(packet) - 1, packet[6] + 1):
                if packet[at] == joint:
                    raw = packet[at + 1 : at + 3] if old else packet[at + 2 : at + 4]
                    found.append((time, int.from_bytes(raw, "big" if old else "little")))
        return found


@pytest.mark.parametrize("baud", [0, 115200])
def test_targets_follow_each_other_within_their_lead(baud: int) -> None:
    rider = Rider(baud)
    rider.load()
    since = rider.now
    assert rider.start() == Status.OK
    assert rider.until_over() == PathState.DONE
    for joint in (0, 6):
        targets = rider.targets(joint, since)
        assert targets[-1][1] == START[joint] + 400
        gaps = [b - a for (a, _), (b, _) in itertools.pairwise(targets)]
        assert max(gaps) <= LEAD_MS / 1000
    assert rider.look().late == 0
    rider.run(0.3)
    assert rider.true_positions() == pytest.approx([place + 400 for place in START], abs=6)


def test_a_board_that_is_stepped_late_keeps_the_time() -> None:
    # As behind `sim://`: only a program that reads drives it.
    rider = Rider()
    rider.load(way=800, mask=0x10)
    since = rider.now
    assert rider.start() == Status.OK
    late = rider.now
    while rider.now < late + 1.2:
        rider.now += 0.08
        rider.board.step(rider.now)
    assert rider.look().state == PathState.DONE
    gaps = [b - a for (a, _), (b, _) in itertools.pairwise(rider.targets(4, since))]
    assert len(gaps) > 80
    assert max(gaps) <= LEAD_MS / 1000
    assert max(rider.state().age or (999,)) < 50


def test_targets_do_not_wait_for_long_requests() -> None:
    rider = Rider()
    rider.load(mask=0x0F)
    since = rider.now
    rider.start()
    for _ in range(4):
        assert rider.torque(mask=0x70).status == Status.OK
        rider.torque(on=False, mask=0x70)
    assert rider.until_over() == PathState.DONE
    gaps = [b - a for (a, _), (b, _) in itertools.pairwise(rider.targets(0, since))]
    assert max(gaps) <= LEAD_MS / 1000
    # A packet that waits for its answer keeps the line, and that is told.
    rider.load(way=0, mask=0x0F)
    rider.ask(Command.JOINT_MOVE, u16(300) + b"\1\0" + u16(START[0]))
    rider.run(1.0)
    rider.load(mask=0x01)
    rider.start()
    rider.ask(Command.TRANSACT, bytes((8, 200)) + make_ping(9))
    assert rider.look().late == 1


def test_each_target_is_where_the_path_is_when_it_is_over() -> None:
    rider = Rider()
    rider.load(way=400, mask=0x01)
    clock = rider.look().time_us
    begin = rider.now
    assert rider.start(0.2) == Status.OK
    rider.until_over()
    shift = begin - clock / 1e6
    started = (clock + 200_000) / 1e6 + shift
    for time, place in rider.targets(0, begin)[:-3]:
        share = min((time - started + LEAD_MS / 1000) / 1.0, 1.0)
        assert place == pytest.approx(START[0] + 400 * share, abs=1.5)


def test_a_silent_joint_has_a_moment_of_grace() -> None:
    rider = Rider()
    rider.load(mask=0x03, seconds=2.0)
    rider.start()
    rider.run(0.3)
    rider.board.wire.faults = FaultPlan(["silent:1"])
    rider.run(0.1)
    assert rider.look().state == PathState.RUNNING
    # No targets for a joint that may have lost its torque.
    since = rider.now
    rider.run(0.02)
    assert rider.targets(0, since)
    assert not rider.targets(1, since)
    rider.board.wire.faults = FaultPlan()
    rider.run(0.15)
    assert rider.look().state == PathState.RUNNING
    assert rider.targets(1, rider.now - 0.03)
    rider.board.wire.faults = FaultPlan(["silent:1"])
    rider.run(0.3)
    assert rider.look().state == PathState.BRAKING
    rider.board.wire.faults = FaultPlan()
    since = rider.now
    assert rider.until_over() == PathState.FAULT
    assert not rider.targets(1, since), "it stays left out"


@pytest.mark.parametrize("joint", [1, 5])
def test_a_joint_that_comes_back_without_torque_ends_it_and_gets_no_target(joint: int) -> None:
    rider = Rider()
    rider.load(seconds=2.0)
    rider.start()
    rider.run(0.3)
    rider.board.wire.faults = FaultPlan([f"silent:{joint}"])
    rider.run(0.07)
    rider.board.wire[joint].registers.put("torque_enable", 0)
    rider.board.wire.faults = FaultPlan()
    since = rider.now
    rider.run(0.1)
    assert rider.look().state == PathState.BRAKING
    assert rider.look().late == 0
    assert rider.until_over() == PathState.FAULT
    assert not rider.targets(joint, since)
    assert not rider.torques()[joint]
    assert rider.true_positions()[0] < START[0] + 250


def test_without_any_joint_left_it_is_over() -> None:
    rider = Rider()
    rider.load(brake=2000)
    rider.start()
    rider.run(0.2)
    rider.torque(on=False)
    assert rider.look().state == PathState.FAULT
    since = rider.now
    rider.run(0.5)
    assert not rider.targets(0, since)
    assert not any(rider.torques())


def test_it_ends_with_a_fault_if_a_joint_is_elsewhere_at_the_start() -> None:
    rider = Rider()
    rider.load(mask=0x01)
    assert rider.start(0.6) == Status.OK
    # Until the start its joints are free.
    assert rider.move({0: START[0] + 300}, 200).status == Status.OK
    since = rider.now
    rider.run(0.7)
    assert rider.look().state == PathState.FAULT
    assert not rider.targets(0, since)


def test_it_ends_with_a_fault_if_its_path_became_too_short_before_the_start() -> None:
    rider = Rider()
    rider.load(mask=0x01)
    assert rider.start(0.3) == Status.OK
    one = PointsRequest.of(NUMBER, 0, [PathPoint(0, (START[0],))], last=False).serialize()
    assert rider.ask(Command.TRAJECTORY_POINTS, one).status == Status.OK
    since = rider.now
    rider.run(0.5)
    assert rider.look().state == PathState.FAULT
    assert not rider.targets(0, since)


def test_a_fault_is_told_even_if_it_brakes_already() -> None:
    rider = Rider()
    rider.load(brake=700)
    rider.start()
    rider.run(0.3)
    assert rider.ask(Command.TRAJECTORY_ABORT, bytes((NUMBER,))).status == Status.OK
    rider.torque(on=False, mask=1)
    assert rider.until_over() == PathState.FAULT


def test_the_watchdog_waits_only_for_a_whole_path() -> None:
    rider = Rider()
    rider.ask(Command.WATCHDOG, u16(100) + b"\0")
    rider.load(flags=PathFlag.OUTLIVES_HOST)
    rider.start()
    rider.run(0.9)
    assert not rider.board.state.stopped
    rider.run(0.3)
    assert rider.board.state.stopped
    assert rider.look().state == PathState.DONE
    assert rider.state().board_flags & tables.BOARD_FLAGS_WATCHDOG_TRIPPED
    rider.ask(Command.RESUME)
    rider.ask(Command.WATCHDOG, u16(100) + b"\0")
    rider.move(dict(enumerate(START)), 200)
    for _ in range(60):
        rider.look()
        rider.run(0.02)
    rider.load(flags=PathFlag.OUTLIVES_HOST, last=False)
    rider.start()
    rider.run(0.3)
    assert rider.look().state == PathState.STOPPED


def test_waiting_for_its_start_it_does_not_outlive_its_host() -> None:
    rider = Rider()
    rider.ask(Command.WATCHDOG, u16(100) + b"\0")
    rider.load(flags=PathFlag.OUTLIVES_HOST)
    rider.start(0.5)
    rider.run(1.0)
    assert rider.look().state == PathState.STOPPED


def test_a_stop_in_the_middle_of_a_request_ends_both() -> None:
    rider = Rider()
    rider.load(mask=0x0F)
    rider.start()
    rider.send(Command.TORQUE, b"\1" + u16(0x70))
    rider.run(0.025)
    stop = rider.send(Command.STOP, b"\0")
    assert rider.wait(Command.STOP, stop).status == Status.OK
    since = rider.now
    assert rider.ask(Command.RESUME).status == Status.OK
    rider.run(0.5)
    assert not any(rider.targets(joint, since) for joint in range(7))
    assert rider.look().state == PathState.STOPPED
    assert not rider.state().board_flags & STOPPED_FLAG


def test_no_target_is_beyond_a_limit_or_too_fast() -> None:
    rider = Rider(0)
    rider.load(way=700, seconds=0.5, mask=0x11)
    rows = [LimitRow(0, 4095, 4096)] * 7
    rows[0] = LimitRow(2000, START[0] + 300, 500)
    rider.start()
    assert rider.ask(Command.LIMITS, LimitTable(0, tuple(rows)).serialize()[1:]).status == Status.OK
    since = rider.now
    rider.until_over()
    places = rider.targets(0, since)
    assert places[-1][1] == START[0] + 300
    # A legacy servo takes distance over run time: that is below the limit.
    sent = [p for time, p in rider.bus_sent if time > since and p[5] == 0x2A and p[4] == 0x83]
    assert min(int.from_bytes(packet[10:12], "big") for packet in sent) >= LEAD_MS
    assert max(int.from_bytes(packet[10:12], "big") for packet in sent) >= 350
    rider.run(0.05)
    assert rider.true_positions()[0] < START[0] + 300


def test_in_either_dialect_its_joints_take_no_other_targets() -> None:
    rider = Rider()
    rider.load(mask=0x11, seconds=2.0)
    rider.start()
    place = START[0] + 10
    legacy = make_write(0, 0x2A, place.to_bytes(2, "big") + b"\0\x64")
    for cmd, body in (
        (Command.JOINT_MOVE, u16(100) + b"\1\xfe" + u16(place)),
        (Command.TRANSACT, b"\6\0" + legacy),
        (Command.TRANSACT, b"\6\0" + make_write(4, 0x2A, u16(place))),
        (Command.TORQUE, b"\1" + u16(0x11)),
    ):
        assert rider.ask(cmd, body).status == Status.BUSY, body.hex()
    rider.writes()
    silent = rider.ask1(Command.READ, legacy)
    assert silent == rider.ask1(Command.READ, make_write(0, 0x28, b"\1"))
    assert not [packet for packet in rider.writes() if packet[4] == 0x03]
    assert rider.ask(Command.TRANSACT, b"\0\0" + make_write(0, 0x28, b"\0")).status == Status.OK
    assert rider.until_over() == PathState.FAULT


def test_a_start_over_the_wrap_of_the_clock() -> None:
    rider = Rider(0)
    # The clock counts from the reset on.
    rider.board.state.now -= 2**32 / 1e6 - 2.0
    rider.load(mask=0x01)
    ahead = (rider.look().time_us + 2_500_000) & 0xFFFFFFFF
    assert ahead < rider.look().time_us, "it wraps"
    begin = rider.now
    reply = rider.ask(Command.TRAJECTORY_START, StartRequest(NUMBER, 0, ahead).serialize())
    assert reply.status == Status.OK
    rider.run(2.4)
    assert rider.look().state == PathState.WAITING
    assert rider.until_over() == PathState.DONE
    assert rider.targets(0, begin + 0.1)[0][0] == pytest.approx(begin + 2.5, abs=0.03)


def test_a_host_that_asks_without_a_pause_does_not_keep_the_board_from_its_servos() -> None:
    rider = Rider()
    rider.load(way=200, mask=0x02, seconds=0.2)
    assert rider.start() == Status.OK
    for _ in range(3000):
        rider.send(Command.JOINT_STATE, bytes((0,)))
        rider.now += 1e-4
    rider.take()
    report = rider.state()
    assert max(report.age or (999,)) < 50
    assert abs(report.position[1] - START[1] - 200) <= 6


PATH = 3
PLACE = 2000
BEGIN, POINTS, START_PATH = Command.TRAJECTORY_BEGIN, Command.TRAJECTORY_POINTS, Command.TRAJECTORY_START
STATUS, ABORT = Command.TRAJECTORY_STATUS, Command.TRAJECTORY_ABORT
OK_BEGIN = BeginRequest(PATH, 0, 1, 200).serialize()
COMMANDS = (BEGIN, POINTS, START_PATH, STATUS, ABORT)


class Desk:
    """The commands of a board with seven joints that have torque and stand at 2000; its servos answer nothing."""

    def __init__(self) -> None:
        self.now = 100.0
        self.state = BoardState(1, 0.0, BoardSettings(limits=[LimitRow(1000, 3000, 2000)] * 7))
        for joint in self.state.joints:
            joint.present, joint.torque_on, joint.unsure = True, True, False
            joint.position, joint.sampled_at = PLACE, 100.0
        bus = BoardBus(self.state, self.clock, paced=True)
        self.trajectory = BoardTrajectory(self.state, bus, self.clock)
        self.commands = TrajectoryCommands(
            self.state, self.trajectory, BoardOrders(self.state, bus, self.clock), self.clock
        )

    def clock(self) -> float:
        return self.now

    def ask(self, cmd: int, body: bytes = b"") -> bytes:
        return done(self.commands.handlers[cmd](body))

    def refused(self, cmd: int, body: bytes = b"") -> Status:
        with pytest.raises((RefusedError, RemoteProtocolError)) as caught:
            self.ask(cmd, body)
        return caught.value.status if isinstance(caught.value, RefusedError) else Status.BAD_LENGTH

    def look(self) -> PathStatus:
        return PathStatus.parse(self.ask(STATUS))

    def load(self, *, last: bool = True) -> None:
        self.ask(BEGIN, OK_BEGIN)
        self.ask(POINTS, points(last=last))

    def step(self) -> None:
        done(self.trajectory.step())


def done(job: Generator[Any, bytes | None, Any]) -> Any:
    """What a job returns; whatever it sends is not answered."""
    answer: bytes | None = None
    while True:
        try:
            job.send(answer)
        except StopIteration as end:
            return end.value
        answer = b""


def points(number: int = PATH, first: int = 0, *, last: bool = True, data: bytes | None = None) -> bytes:
    """Two points, one second apart."""
    own = PointsRequest.of(number, first, [PathPoint(0, (PLACE,)), PathPoint(10000, (2500,))], last=last)
    return own.serialize() if data is None else own.serialize()[:5] + data


def start(number: int = PATH, now: int = 1, time_us: int = 0) -> bytes:
    return StartRequest(number, now, time_us).serialize()


def test_one_trajectory_from_beginning_to_end() -> None:
    desk = Desk()
    assert desk.look() == (0, PathState.NONE, 0, 0, 0, 0, 100_000_000)
    reply = BeginReply.parse(desk.ask(BEGIN, OK_BEGIN))
    assert reply == (PATH, PathState.LOADING, 480, LEAD_MS)
    assert PathStatus.parse(desk.ask(POINTS, points()))[:6] == (PATH, PathState.LOADING, 2, 0, 478, 0)
    assert StartReply.parse(desk.ask(START_PATH, start())) == (PATH, PathState.WAITING, 100_000_000)
    desk.step()
    assert desk.look()[:6] == (PATH, PathState.RUNNING, 2, 1, 478, 0)
    desk.now += 1.0
    assert desk.look().state == PathState.RUNNING, "its last target is not sent yet"
    desk.step()
    desk.now += 0.01
    desk.step()
    assert desk.look()[:6] == (PATH, PathState.DONE, 2, 1, 478, 1)


@pytest.mark.parametrize("cmd", COMMANDS)
def test_every_other_length_is_refused(cmd: int) -> None:
    sound = {BEGIN: OK_BEGIN, POINTS: points(), START_PATH: start(), STATUS: b"", ABORT: bytes((PATH,))}[cmd]
    desk = Desk()
    desk.load()
    for size in range(201):
        if size != len(sound):
            assert desk.refused(cmd, (sound + bytes(200))[:size]) == Status.BAD_LENGTH, size
    assert desk.look()[:3] == (PATH, PathState.LOADING, 2)


@pytest.mark.parametrize(
    "body",
    [
        BeginRequest(PATH, 0, 0, 200),
        BeginRequest(PATH, 0, 0x80, 200),
        BeginRequest(PATH, 8, 1, 200),
        BeginRequest(PATH, 0, 1, 19),
        BeginRequest(PATH, 0, 1, 2001),
    ],
)
def test_what_is_wrong_in_itself_comes_before_the_state_of_the_board(body: BeginRequest) -> None:
    desk = Desk()
    desk.load()
    desk.ask(START_PATH, start())
    desk.step()
    assert desk.refused(BEGIN, body.serialize()) == Status.BAD_RANGE
    assert desk.refused(BEGIN, OK_BEGIN) == Status.BUSY
    desk.state.stopped = True
    desk.trajectory.stop()
    assert desk.refused(BEGIN, body.serialize()) == Status.BAD_RANGE


def test_stopped_and_maintenance() -> None:
    desk = Desk()
    desk.load()
    desk.state.maintenance = True
    assert desk.refused(BEGIN, OK_BEGIN) == Status.FORBIDDEN
    assert desk.refused(START_PATH, start()) == Status.FORBIDDEN
    desk.state.stopped = True
    desk.trajectory.stop()
    for cmd, body in ((BEGIN, OK_BEGIN), (START_PATH, start()), (POINTS, points()), (POINTS, points(data=b"x"))):
        assert desk.refused(cmd, body) == Status.STOPPED
    for cmd, body in ((START_PATH, start(now=2)), (START_PATH, start(PATH + 1)), (POINTS, points(PATH + 1))):
        assert desk.refused(cmd, body) == Status.BAD_RANGE
    assert desk.look().state == PathState.STOPPED
    assert desk.ask(ABORT, bytes((PATH,))) == bytes((PATH, PathState.STOPPED))
    desk.state.stopped = desk.state.maintenance = False
    for cmd, body in ((START_PATH, start()), (POINTS, points())):
        assert desk.refused(cmd, body) == Status.BAD_RANGE


def test_another_id_or_none() -> None:
    desk = Desk()
    for number in (0, PATH):
        for cmd, body in ((POINTS, points(number)), (START_PATH, start(number)), (ABORT, bytes((number,)))):
            assert desk.refused(cmd, body) == Status.BAD_RANGE
    desk.load()
    for cmd, body in ((POINTS, points(0)), (START_PATH, start(0)), (ABORT, b"\0")):
        assert desk.refused(cmd, body) == Status.BAD_RANGE


def test_why_a_start_is_refused() -> None:
    desk = Desk()
    desk.load()
    clock = 100_000_000
    for time_us in (clock - 1, clock + 10_000_000, clock + (1 << 31), 0):
        assert desk.refused(START_PATH, start(now=0, time_us=time_us)) == Status.BAD_RANGE
    joint = desk.state.joints[0]
    joint.position = PLACE + 65
    assert desk.refused(START_PATH, start()) == Status.BAD_RANGE
    joint.mode = 1
    assert desk.refused(START_PATH, start()) == Status.SERVO_FAULT
    joint.present = False
    assert desk.refused(START_PATH, start()) == Status.SERVO_SILENT
    joint.present, joint.torque_on = True, False
    assert desk.refused(START_PATH, start()) == Status.TORQUE_OFF
    joint.torque_on, joint.mode, joint.position = True, 0, PLACE - 64
    assert desk.look().state == PathState.LOADING
    assert desk.ask(START_PATH, start(now=0, time_us=clock + 9_999_999))[1] == PathState.WAITING
    assert desk.ask(START_PATH, start(now=0, time_us=clock))[1] == PathState.WAITING
    desk.step()
    assert desk.refused(START_PATH, start()) == Status.BAD_RANGE, "it runs"


def test_a_path_too_short_to_brake_does_not_start() -> None:
    desk = Desk()
    desk.ask(BEGIN, OK_BEGIN)
    desk.ask(POINTS, PointsRequest.of(PATH, 0, [PathPoint(0, (PLACE,))], last=False).serialize())
    assert desk.refused(START_PATH, start()) == Status.BAD_RANGE
    desk.ask(POINTS, PointsRequest.of(PATH, 1, [PathPoint(1000, (PLACE,))], last=False).serialize())
    assert desk.refused(START_PATH, start()) == Status.BAD_RANGE
    desk.ask(POINTS, PointsRequest.of(PATH, 1, [PathPoint(1001, (PLACE,))], last=False).serialize())
    assert desk.ask(START_PATH, start())[1] == PathState.WAITING


@given(st.lists(st.tuples(st.sampled_from(COMMANDS), st.binary(max_size=40), st.booleans()), max_size=25))
def test_whatever_comes_it_is_answered_and_nothing_moves_before_a_start(
    orders: list[tuple[int, bytes, bool]],
) -> None:
    desk = Desk()
    desk.load()
    for cmd, body, mine in orders:
        body = bytes((PATH,)) + body[1:] if mine else body
        try:
            desk.ask(cmd, body)
        except (RefusedError, RemoteProtocolError):
            continue
        finally:
            status = desk.look()
            assert not desk.trajectory.active
            assert status.free <= 480
        assert cmd != POINTS or status.next >= 1
