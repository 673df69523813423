"""The rate of the host line (PROTOCOL.md section 6.8), asked of every board."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.conformance_board.adapter import EVERY_BOARD, BoardUnderTest

from hexwire.wire import tables
from hexwire.wire.board_trajectory import BeginRequest, PathFlag, PathPoint, PointsRequest, StartRequest
from hexwire.wire.command_frame import Command, Frame, Status
from hexwire.wire.commands import Identity

# The first one builds.

OWN = 115200
ANSWER = 1.0


class Line:
    """A board, and a host that changes the rate of the line."""

    def __init__(self, kind: str) -> None:
        self.board = BoardUnderTest(kind)
        self.client, self.machine = self.board.client, self.board.machine

    def baud(self, rate: int) -> int:
        """Ask for a rate; the status. The host stays at its own."""
        reply = self.client.ask(Command.HOST_BAUD, rate.to_bytes(4, "little"), within=ANSWER)
        assert reply.body in (b"", rate.to_bytes(4, "little"))
        return reply.status

    def switch(self, rate: int) -> None:
        """Change the rate of both ends."""
        assert self.baud(rate) == Status.OK
        self.machine.set_rate(rate)
        self.client.run(0.02)

    def answers(self) -> bool:
        """Whether the board answers at the host's rate. Unlike a request of its own, this is any valid frame."""
        try:
            return self.client.ask(Command.STATS, within=0.05).status == Status.OK
        except AssertionError:
            return False

    def ask(self, command: int, body: bytes = b"") -> Frame:
        reply = self.client.ask(command, body, within=ANSWER)
        assert reply.status == Status.OK, reply
        return reply

    def silent_until_back(self, seconds: float) -> None:
        """The board is at its own rate after these seconds, and not yet 0.3 s before."""
        self.client.run(seconds - 0.3)
        self.machine.set_rate(OWN)
        assert not self.answers()
        self.client.run(0.3)
        assert self.answers()


@pytest.fixture(params=EVERY_BOARD)
def line(request: pytest.FixtureRequest) -> Iterator[Line]:
    made = Line(request.param)
    yield made
    made.board.close()


def test_a_board_says_that_it_can(line: Line) -> None:
    assert Identity.parse(line.ask(Command.IDENTIFY).body).capabilities & tables.CAPABILITY_HOST_BAUD


@pytest.mark.parametrize("rate", [250_000, 500_000, 1_000_000])
def test_the_rate_is_raised_and_lowered(line: Line, rate: int) -> None:
    line.switch(rate)
    assert line.answers()
    line.machine.set_rate(OWN)
    assert not line.answers()
    line.machine.set_rate(rate)
    line.switch(OWN)
    assert line.answers()
    line.client.run(2.5)
    assert line.answers()


@pytest.mark.parametrize("rate", [0, 9600, 115_201, 2_000_000])
def test_other_rates_are_refused(line: Line, rate: int) -> None:
    assert line.baud(rate) == Status.BAD_RANGE
    assert line.client.ask(Command.HOST_BAUD, b"\0\0\0").status == Status.BAD_LENGTH
    assert line.answers()


def test_a_lost_answer_ends_the_raised_rate_after_a_second(line: Line) -> None:
    assert line.baud(500_000) == Status.OK
    line.silent_until_back(tables.HOST_BAUD_TRIAL + 0.1)


def test_a_host_that_died_ends_the_raised_rate_after_two_seconds(line: Line) -> None:
    line.switch(500_000)
    assert line.answers()
    line.silent_until_back(tables.HOST_BAUD_SILENCE + 0.1)


def test_a_program_at_the_old_rate_does_not_keep_the_raised_one(line: Line) -> None:
    line.switch(500_000)
    assert line.answers()
    line.machine.set_rate(OWN)
    tries = 0
    while not line.answers():
        tries += 1
        line.client.run(0.1)
        assert tries < 18
    assert tries > 8


def test_the_present_rate_keeps_it(line: Line) -> None:
    line.switch(1_000_000)
    assert line.answers()
    for _ in range(3):
        line.client.run(1.5)
        assert line.baud(1_000_000) == Status.OK
    assert line.answers()


def test_a_reset_ends_it(line: Line) -> None:
    line.switch(500_000)
    assert line.answers()
    line.machine.reset()
    line.machine.set_rate(OWN)
    line.client.run(0.3)
    assert line.answers()


def test_it_does_not_feed_the_watchdog(line: Line) -> None:
    line.switch(500_000)
    line.ask(Command.WATCHDOG, (300).to_bytes(2, "little") + b"\0")
    for _ in range(8):
        line.client.run(0.05)
        assert line.baud(500_000) in (Status.OK, Status.STOPPED)
    flags = line.ask(Command.JOINT_STATE, b"\0").body[5]
    assert flags & tables.BOARD_FLAGS_WATCHDOG_TRIPPED


def test_it_is_never_answered_from_store(line: Line) -> None:
    request = line.client.frame(Command.HOST_BAUD, (500_000).to_bytes(4, "little"))
    line.machine.send(request)
    assert line.client.reply(ANSWER).status == Status.OK
    # The answer counts as lost. The board is back before the repeat, which raises the rate again.
    line.client.run(1.2)
    assert line.answers()
    line.machine.send(request)
    replies = [f for f in line.client.run(ANSWER / 2) if f.cmd == Command.HOST_BAUD]
    assert [f.status for f in replies] == [Status.OK]
    line.machine.set_rate(500_000)
    assert line.answers()


def test_not_while_a_joint_moves(line: Line) -> None:
    line.ask(Command.TORQUE, b"\1\x7f\0")
    move = (2000).to_bytes(2, "little") + b"\1\x00" + (2300).to_bytes(2, "little")
    line.ask(Command.JOINT_MOVE, move)
    line.client.run(0.3)
    assert line.baud(500_000) == Status.BUSY
    # Its own rate is never refused.
    assert line.baud(OWN) == Status.OK
    line.client.run(2.5)
    line.switch(500_000)
    line.ask(Command.JOINT_MOVE, move[:4] + (2053).to_bytes(2, "little"))
    line.client.run(0.3)
    assert line.baud(1_000_000) == Status.BUSY
    assert line.baud(500_000) == Status.OK
    line.switch(OWN)
    assert line.answers()


def test_a_joint_without_torque_may_move(line: Line) -> None:
    servo = line.machine.wire.servos[0]
    before = servo.present_position
    servo.motion.hand = lambda position, velocity: 0.3
    line.client.run(0.1)
    assert line.baud(500_000) == Status.OK
    assert abs(servo.present_position - before) > 20


def test_not_while_a_trajectory_waits_or_runs(line: Line) -> None:
    line.ask(Command.TORQUE, b"\1\x7f\0")
    line.ask(Command.TRAJECTORY_BEGIN, BeginRequest(1, PathFlag(0), 1, 100).serialize())
    # It stands still, but could be stopped.
    points = [PathPoint(10_000 if i else 0, (2053,)) for i in range(2)]
    line.ask(Command.TRAJECTORY_POINTS, PointsRequest.of(1, 0, points, last=True).serialize())
    assert line.baud(OWN) == Status.OK
    line.ask(Command.TRAJECTORY_START, StartRequest(1, 1, 0).serialize())
    assert line.baud(500_000) == Status.BUSY
    line.client.run(1.2)
    assert line.baud(500_000) == Status.OK


def test_a_stop_at_a_raised_rate(line: Line) -> None:
    line.ask(Command.TORQUE, b"\1\x7f\0")
    line.switch(500_000)
    assert line.ask(Command.STOP, b"\1").body[1:] == b"\x7f\0"
    assert not any(servo.torque_on for servo in line.machine.wire.servos)
    # Nothing moves, so the rate may be changed while stopped.
    line.switch(1_000_000)
    assert line.answers()


def test_a_stop_while_the_rate_changes(line: Line) -> None:
    line.ask(Command.TORQUE, b"\1\x7f\0")
    line.switch(1_000_000)
    assert line.baud(OWN) == Status.OK
    # The answer has just come: the board changes its rate in about 2 ms, and the frame takes half a millisecond.
    line.machine.send(line.client.frame(Command.STOP, b"\1"))
    line.client.run(0.06)
    assert not any(servo.torque_on for servo in line.machine.wire.servos)
    line.machine.set_rate(OWN)
    assert line.answers()
