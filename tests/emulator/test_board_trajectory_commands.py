from __future__ import annotations

from collections.abc import Generator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.emulator.board_bus import BoardBus
from hexwire.emulator.board_orders import BoardOrders
from hexwire.emulator.board_state import BoardState, Settings
from hexwire.emulator.board_trajectory import LEAD_MS, Trajectory
from hexwire.emulator.board_trajectory_commands import TrajectoryCommands
from hexwire.emulator.gate import RefusedError
from hexwire.errors import RemoteProtocolError
from hexwire.wire.board_trajectory import (
    BeginReply,
    BeginRequest,
    PathPoint,
    PathState,
    PathStatus,
    PointsRequest,
    StartReply,
    StartRequest,
)
from hexwire.wire.command_frame import Command, Status
from hexwire.wire.commands import LimitRow

NUMBER = 3
PLACE = 2000
BEGIN, POINTS, START = Command.TRAJECTORY_BEGIN, Command.TRAJECTORY_POINTS, Command.TRAJECTORY_START
STATUS, ABORT = Command.TRAJECTORY_STATUS, Command.TRAJECTORY_ABORT
OK_BEGIN = BeginRequest(NUMBER, 0, 1, 200).serialize()
COMMANDS = (BEGIN, POINTS, START, STATUS, ABORT)


class Desk:
    """The commands of a board with seven joints that have torque and stand at 2000; its servos answer nothing."""

    def __init__(self) -> None:
        self.now = 100.0
        self.state = BoardState(1, 0.0, Settings(limits=[LimitRow(1000, 3000, 2000)] * 7))
        for joint in self.state.joints:
            joint.present, joint.torque_on, joint.unsure = True, True, False
            joint.position, joint.sampled_at = PLACE, 100.0
        bus = BoardBus(self.state, self.clock, paced=True)
        self.trajectory = Trajectory(self.state, bus, self.clock)
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


def points(number: int = NUMBER, first: int = 0, *, last: bool = True, data: bytes | None = None) -> bytes:
    """Two points, one second apart."""
    own = PointsRequest.of(number, first, [PathPoint(0, (PLACE,)), PathPoint(10000, (2500,))], last=last)
    return own.serialize() if data is None else own.serialize()[:5] + data


def start(number: int = NUMBER, now: int = 1, time_us: int = 0) -> bytes:
    return StartRequest(number, now, time_us).serialize()


def test_one_trajectory_from_beginning_to_end() -> None:
    desk = Desk()
    assert desk.look() == (0, PathState.NONE, 0, 0, 0, 0, 100_000_000)
    reply = BeginReply.parse(desk.ask(BEGIN, OK_BEGIN))
    assert reply == (NUMBER, PathState.LOADING, 480, LEAD_MS)
    assert PathStatus.parse(desk.ask(POINTS, points()))[:6] == (NUMBER, PathState.LOADING, 2, 0, 478, 0)
    assert StartReply.parse(desk.ask(START, start())) == (NUMBER, PathState.WAITING, 100_000_000)
    desk.step()
    assert desk.look()[:6] == (NUMBER, PathState.RUNNING, 2, 1, 478, 0)
    desk.now += 1.0
    assert desk.look().state == PathState.RUNNING, "its last target is not sent yet"
    desk.step()
    desk.now += 0.01
    desk.step()
    assert desk.look()[:6] == (NUMBER, PathState.DONE, 2, 1, 478, 1)


@pytest.mark.parametrize("cmd", COMMANDS)
def test_every_other_length_is_refused(cmd: int) -> None:
    sound = {BEGIN: OK_BEGIN, POINTS: points(), START: start(), STATUS: b"", ABORT: bytes((NUMBER,))}[cmd]
    desk = Desk()
    desk.load()
    for size in range(201):
        if size != len(sound):
            assert desk.refused(cmd, (sound + bytes(200))[:size]) == Status.BAD_LENGTH, size
    assert desk.look()[:3] == (NUMBER, PathState.LOADING, 2)


@pytest.mark.parametrize(
    "body",
    [
        BeginRequest(NUMBER, 0, 0, 200),
        BeginRequest(NUMBER, 0, 0x80, 200),
        BeginRequest(NUMBER, 8, 1, 200),
        BeginRequest(NUMBER, 0, 1, 19),
        BeginRequest(NUMBER, 0, 1, 2001),
    ],
)
def test_what_is_wrong_in_itself_comes_before_the_state_of_the_board(body: BeginRequest) -> None:
    desk = Desk()
    desk.load()
    desk.ask(START, start())
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
    assert desk.refused(START, start()) == Status.FORBIDDEN
    desk.state.stopped = True
    desk.trajectory.stop()
    for cmd, body in ((BEGIN, OK_BEGIN), (START, start()), (POINTS, points()), (POINTS, points(data=b"x"))):
        assert desk.refused(cmd, body) == Status.STOPPED
    for cmd, body in ((START, start(now=2)), (START, start(NUMBER + 1)), (POINTS, points(NUMBER + 1))):
        assert desk.refused(cmd, body) == Status.BAD_RANGE
    assert desk.look().state == PathState.STOPPED
    assert desk.ask(ABORT, bytes((NUMBER,))) == bytes((NUMBER, PathState.STOPPED))
    desk.state.stopped = desk.state.maintenance = False
    for cmd, body in ((START, start()), (POINTS, points())):
        assert desk.refused(cmd, body) == Status.BAD_RANGE


def test_another_id_or_none() -> None:
    desk = Desk()
    for number in (0, NUMBER):
        for cmd, body in ((POINTS, points(number)), (START, start(number)), (ABORT, bytes((number,)))):
            assert desk.refused(cmd, body) == Status.BAD_RANGE
    desk.load()
    for cmd, body in ((POINTS, points(0)), (START, start(0)), (ABORT, b"\0")):
        assert desk.refused(cmd, body) == Status.BAD_RANGE


def test_why_a_start_is_refused() -> None:
    desk = Desk()
    desk.load()
    clock = 100_000_000
    for time_us in (clock - 1, clock + 10_000_000, clock + (1 << 31), 0):
        assert desk.refused(START, start(now=0, time_us=time_us)) == Status.BAD_RANGE
    joint = desk.state.joints[0]
    joint.position = PLACE + 65
    assert desk.refused(START, start()) == Status.BAD_RANGE
    joint.mode = 1
    assert desk.refused(START, start()) == Status.SERVO_FAULT
    joint.present = False
    assert desk.refused(START, start()) == Status.SERVO_SILENT
    joint.present, joint.torque_on = True, False
    assert desk.refused(START, start()) == Status.TORQUE_OFF
    joint.torque_on, joint.mode, joint.position = True, 0, PLACE - 64
    assert desk.look().state == PathState.LOADING
    assert desk.ask(START, start(now=0, time_us=clock + 9_999_999))[1] == PathState.WAITING
    assert desk.ask(START, start(now=0, time_us=clock))[1] == PathState.WAITING
    desk.step()
    assert desk.refused(START, start()) == Status.BAD_RANGE, "it runs"


def test_a_path_too_short_to_brake_does_not_start() -> None:
    desk = Desk()
    desk.ask(BEGIN, OK_BEGIN)
    desk.ask(POINTS, PointsRequest.of(NUMBER, 0, [PathPoint(0, (PLACE,))], last=False).serialize())
    assert desk.refused(START, start()) == Status.BAD_RANGE
    desk.ask(POINTS, PointsRequest.of(NUMBER, 1, [PathPoint(1000, (PLACE,))], last=False).serialize())
    assert desk.refused(START, start()) == Status.BAD_RANGE
    desk.ask(POINTS, PointsRequest.of(NUMBER, 1, [PathPoint(1001, (PLACE,))], last=False).serialize())
    assert desk.ask(START, start())[1] == PathState.WAITING


@given(st.lists(st.tuples(st.sampled_from(COMMANDS), st.binary(max_size=40), st.booleans()), max_size=25))
def test_whatever_comes_it_is_answered_and_nothing_moves_before_a_start(
    orders: list[tuple[int, bytes, bool]],
) -> None:
    desk = Desk()
    desk.load()
    for cmd, body, mine in orders:
        body = bytes((NUMBER,)) + body[1:] if mine else body
        try:
            desk.ask(cmd, body)
        except (RefusedError, RemoteProtocolError):
            continue
        finally:
            status = desk.look()
            assert not desk.trajectory.active
            assert status.free <= 480
        assert cmd != POINTS or status.next >= 1
