"""May a host leave a board as it is?"""

from __future__ import annotations

import pytest

from hexwire.gateway.line import Use
from hexwire.wire.board_trajectory import (
    BeginRequest,
    PathFlag,
    PathPoint,
    PathState,
    PathStatus,
    PointsRequest,
    StartRequest,
)
from hexwire.wire.command_frame import Command, Frame, Status

ARM, DISARM = b"\xe8\3\1", b"\0\0\0"
BEGIN = BeginRequest(5, PathFlag.OUTLIVES_HOST, 1, 200).serialize()
LAST = PointsRequest.of(5, 0, [PathPoint(0, (1,))], last=True).serialize()
MORE = PointsRequest.of(5, 0, [PathPoint(0, (1,))], last=False).serialize()
START = StartRequest(5, 1, 0).serialize()


class Talk:
    def __init__(self) -> None:
        self.use = Use()
        self.seq = 0

    def ask(self, cmd: int, body: bytes = b"") -> Frame:
        self.seq += 1
        frame = Frame(0, 0, 0, 7, 8, 1, 2, self.seq, cmd, body)
        self.use.asked(frame)
        return frame

    def done(self, cmd: int, body: bytes = b"", reply: bytes = b"", status: int = Status.OK) -> None:
        frame = self.ask(cmd, body)
        self.use.answered(frame._replace(src=8, dst=7, cmd_ext=0x80 | status, body=reply))


def status(state: PathState) -> bytes:
    return PathStatus(5, state, 1, 0, 9, 0, 0).serialize()


@pytest.fixture
def talk() -> Talk:
    return Talk()


def test_nothing_asked_is_in_order(talk: Talk) -> None:
    assert talk.use.in_order
    assert not talk.use.finishes


def test_an_armed_watchdog_is_in_use_until_it_is_disarmed(talk: Talk) -> None:
    talk.done(Command.WATCHDOG, ARM)
    assert (talk.use.in_order, talk.use.mode) == (False, 1)
    talk.done(Command.WATCHDOG, DISARM, status=Status.BUSY)
    assert not talk.use.in_order, "it was refused"
    talk.done(Command.WATCHDOG, DISARM)
    assert talk.use.in_order


def test_what_acts_must_be_answered_what_reads_need_not(talk: Talk) -> None:
    talk.ask(Command.JOINT_STATE, b"\0")
    assert talk.use.in_order
    frame = talk.ask(Command.JOINT_MOVE, b"\1\2\3")
    assert not talk.use.in_order
    talk.use.answered(frame._replace(cmd=Command.STATS, dst=7, cmd_ext=0x80))
    assert not talk.use.in_order, "that answers something else"
    talk.use.answered(frame._replace(src=8, dst=7, cmd_ext=0x80))
    assert talk.use.in_order
    talk.use.ended(talk.ask(Command.RESUME))
    assert talk.use.in_order


@pytest.mark.parametrize("state", [PathState.DONE, PathState.DRY, PathState.ABORTED, PathState.NONE])
def test_a_path_is_in_use_until_it_is_over(talk: Talk, state: PathState) -> None:
    talk.done(Command.TRAJECTORY_BEGIN, bytes(6))
    talk.done(Command.TRAJECTORY_START, START)
    assert not talk.use.in_order
    talk.done(Command.TRAJECTORY_STATUS, reply=status(PathState.RUNNING))
    assert not talk.use.in_order
    talk.done(Command.TRAJECTORY_STATUS, reply=status(state))
    assert talk.use.in_order


@pytest.mark.parametrize(
    ("cmd", "body", "code"),
    [(Command.STOP, b"\0", Status.OK), (Command.TRAJECTORY_ABORT, b"\5", Status.OK), (Command.TORQUE, b"", 5)],
)
def test_a_stop_ends_the_path(talk: Talk, cmd: int, body: bytes, code: int) -> None:
    talk.done(Command.TRAJECTORY_START, START)
    talk.done(cmd, body, status=code)
    assert talk.use.in_order


def test_only_a_whole_path_that_runs_and_may_is_finished_alone(talk: Talk) -> None:
    talk.done(Command.WATCHDOG, ARM)
    talk.done(Command.TRAJECTORY_BEGIN, BEGIN)
    talk.done(Command.TRAJECTORY_POINTS, MORE, status(PathState.LOADING))
    talk.done(Command.TRAJECTORY_START, START)
    assert not talk.use.finishes, "points are missing"
    talk.done(Command.TRAJECTORY_POINTS, LAST, status(PathState.RUNNING))
    assert talk.use.finishes
    assert talk.use.in_order
    talk.done(Command.TRAJECTORY_STATUS, reply=status(PathState.DONE))
    assert not talk.use.finishes
    talk.done(Command.TRAJECTORY_BEGIN, BEGIN)
    talk.done(Command.TRAJECTORY_START, START)
    assert not talk.use.finishes, "a new path is not whole"


def test_a_reply_that_is_cut_changes_nothing(talk: Talk) -> None:
    talk.done(Command.TRAJECTORY_START, START)
    talk.done(Command.TRAJECTORY_STATUS, reply=b"\1\2")
    assert not talk.use.in_order


def test_a_host_that_asks_without_end_does_not_leave_in_order(talk: Talk) -> None:
    for source in range(2000):
        talk.use.asked(Frame(0, 0, 0, source, 8, 1, 2, 1, Command.STATS, b""))
    assert not talk.use.in_order
    assert len(talk.use._asked) == 512
