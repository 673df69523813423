"""Frames for one module, several and all (PROTOCOL.md section 6.9), asked of every board."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.conformance_board.adapter import EVERY_BOARD, BoardUnderTest

from hexwire.wire import tables
from hexwire.wire.addresses import Broadcast, Multicast
from hexwire.wire.command_frame import Command, Frame, Status
from hexwire.wire.commands import Identity
from hexwire.wire.servo_packet import make_sync_write

# The first one builds.

EVERYBODY = [Broadcast().dst, Multicast((8,)).dst, Multicast(range(30)).dst]
NOBODY = [0, 7, 9, 30, Multicast((7, 9)).dst, 0x40000000, -2, -(2**31), 0x3FFFFFFF]
HERE = make_sync_write(0x2A, {0: b"\x08\x05\0\x64"})
FOR_SEVERAL = {
    Command.SYNC_WRITE: HERE,
    Command.IDENTIFY: b"",
    Command.JOINT_STATE: b"\0",
    Command.REPORT: b"\0\0\0",
    Command.JOINT_MOVE: b"\x64\0\1\0\x05\x08",
    Command.TORQUE: b"\1\x7f\0",
    Command.STOP: b"\0",
    Command.RESUME: b"",
    Command.WATCHDOG: b"\0\0\0",
    Command.STATS: b"",
    Command.TRAJECTORY_START: b"\5\1\0\0\0\0",
    Command.TRAJECTORY_STATUS: b"",
    Command.TRAJECTORY_ABORT: b"\5",
}


@pytest.fixture(params=EVERY_BOARD)
def board(request: pytest.FixtureRequest) -> Iterator[BoardUnderTest]:
    made = BoardUnderTest(request.param)
    yield made
    made.close()


def ask(board: BoardUnderTest, cmd: int, body: bytes, dst: int, *, seq: int | None = None) -> list[Frame]:
    """What comes back, within what a stop takes."""
    board.client.frames()
    board.machine.send(board.client.frame(cmd, body, dst=dst, seq=seq))
    end, found = board.machine.now + 0.6, []
    while board.machine.now < end and not found:
        found = [frame for frame in board.client.run(0.005) if frame.is_reply]
    return found


def test_the_board_says_that_it_can(board: BoardUnderTest) -> None:
    (reply,) = ask(board, Command.IDENTIFY, b"", -1)
    assert Identity.parse(reply.body).capabilities & tables.CAPABILITY_SEVERAL


@pytest.mark.parametrize("dst", EVERYBODY)
def test_each_command_that_may_go_to_several(board: BoardUnderTest, dst: int) -> None:
    """Each is answered as one to this board alone."""
    for cmd, body in FOR_SEVERAL.items():
        (reply,) = ask(board, cmd, body, dst)
        assert (reply.src, reply.dst, reply.seq, reply.cmd) == (8, 7, board.client.seq, cmd)
        (alone,) = ask(board, cmd, body, 8)
        assert reply.status == alone.status, Command(cmd).name
        assert len(reply.body) == len(alone.body)
        if cmd == Command.STOP:
            assert ask(board, Command.RESUME, b"", 8)[0].status == Status.OK


@pytest.mark.parametrize("dst", EVERYBODY)
def test_every_other_command_is_not_supported(board: BoardUnderTest, dst: int) -> None:
    for cmd in (*(c for c in range(1, 0x40) if c not in FOR_SEVERAL), 0xFF):
        (reply,) = ask(board, cmd, b"\1\0", dst)
        assert (reply.cmd, reply.status, reply.body) == (cmd, Status.NOT_SUPPORTED, b"")
    # The answer is not stored: the same to this board alone is a new request.
    (reply,) = ask(board, Command.LIMITS, b"", -1)
    (alone,) = ask(board, Command.LIMITS, b"", 8, seq=reply.seq)
    assert alone.status == Status.OK


def test_a_frame_for_others_is_as_if_it_had_not_come(board: BoardUnderTest) -> None:
    assert ask(board, Command.WATCHDOG, b"\xe8\3\0", 8)[0].status == Status.OK
    for dst in NOBODY:
        assert ask(board, Command.STATS, b"", dst) == []
    # Half a second each: the watchdog has had nothing for long.
    state = ask(board, Command.JOINT_STATE, b"\0", 8)[0]
    assert state.body[5] & tables.BOARD_FLAGS_WATCHDOG_TRIPPED


def test_one_for_all_feeds_the_watchdog_even_if_it_is_refused(board: BoardUnderTest) -> None:
    assert ask(board, Command.WATCHDOG, b"\x90\1\0", 8)[0].status == Status.OK
    for cmd in (Command.STATS, Command.LIMITS, Command.STATS, Command.TRANSACT):
        board.advance(0.25)
        assert len(ask(board, cmd, b"", -1)) == 1
    state = ask(board, Command.JOINT_STATE, b"\0", 8)[0]
    assert not state.body[5] & tables.BOARD_FLAGS_WATCHDOG_TRIPPED


def test_a_repeat_by_another_way_is_done_once(board: BoardUnderTest) -> None:
    (first,) = ask(board, Command.TORQUE, b"\1\x7f\0", -1)
    before = len(board.bus_writes(0x28))
    for dst in (Multicast((8, 9)).dst, 8):
        (again,) = ask(board, Command.TORQUE, b"\1\x7f\0", dst, seq=first.seq)
        assert (again.status, again.body) == (first.status, first.body)
    assert len(board.bus_writes(0x28)) == before


def test_a_stop_for_all_goes_before_what_waits(board: BoardUnderTest) -> None:
    assert ask(board, Command.TORQUE, b"\1\x7f\0", -1)[0].status == Status.OK
    requests = [board.client.frame(Command.JOINT_MOVE, b"\x64\0\1\xfe\0\x08") for _ in range(4)]
    board.machine.send(b"".join(requests) + board.client.frame(Command.STOP, b"\0", dst=-1))
    replies = {frame.seq: frame for frame in board.client.run(1.0) if frame.is_reply}
    assert replies[board.client.seq].status == Status.OK
    assert Status.STOPPED in {frame.status for frame in replies.values()}
    assert ask(board, Command.JOINT_MOVE, b"\x64\0\1\xfe\0\x08", -1)[0].status == Status.STOPPED
