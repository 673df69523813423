"""The side of a queue at a gateway: conversations above, boards on streams below."""

from __future__ import annotations

import random

import pytest
from tests.gateway.bench import START, Bench

from hexwire.gateway.host import QueueHost
from hexwire.session.connection import Connection, Role
from hexwire.session.events import Report, Request
from hexwire.wire import tables
from hexwire.wire.addresses import Broadcast
from hexwire.wire.command_frame import EXT_REPLY, Command, Frame, Status, parse_frame, serialize_frame

ALL_ON = b"\1\x7f\0"
FIVE_SECONDS = b"\x88\x13\0"
ANGLES = b"\x32\0\1"
"""REPORT: every 50 ms, positions."""


class QueueBench(Bench):
    """A bench of which the host has a queue."""

    def connect(self) -> Connection:
        if not hasattr(self, "side"):
            self.random = random.Random(1)
            self.side = self.gateway.add(QueueHost("mq:///bench", self.gateway.lines, self.number))
        self.seen = []
        self.host = Connection(
            Role.HOST,
            local=7,
            remote=8,
            type=1,
            max_frame=tables.MAX_NETWORK_FRAME,
            epoch=START,
            numbers=self.number,
        )
        return self.host

    def number(self) -> int:
        return self.random.getrandbits(31)

    def last_frame(self, cmd: int, body: bytes = b"") -> Frame:
        """A request of the host, which is not sent yet."""
        self.host.request(cmd, body, self.now, attempts=1)
        return parse_frame(self.host.data_to_send()[-1])

    def put(self, frame: Frame) -> None:
        self.gateway.receive_host(self.side, serialize_frame(frame, tables.MAX_NETWORK_FRAME), self.now)


@pytest.fixture
def bench() -> QueueBench:
    made = QueueBench()
    made.run(0.3)
    assert made.ask(Command.IDENTIFY, to=8).status == Status.OK
    return made


def test_the_hosts_before_are_counted() -> None:
    side = QueueHost("mq:///bench", (8,), lambda: 1)
    assert side.generation == 0


def test_a_host_reaches_every_board_in_one_conversation(bench: QueueBench) -> None:
    for module in bench.boards:
        assert bench.ask(Command.TORQUE, ALL_ON, module).status == Status.OK
        assert bench.boards[module].state.joints[0].torque_on
    answers = bench.ask_all(Command.STOP, b"\0", Broadcast())
    assert set(answers.replies) == set(bench.boards)
    assert all(bench.stopped().values())
    assert bench.gateway.counters.refused == 0


def test_a_frame_is_taken_once_and_only_in_the_present_conversation(bench: QueueBench) -> None:
    on = bench.last_frame(Command.TORQUE, ALL_ON)
    bench.put(on)
    bench.run()
    sent = len(bench.to_boards[8])
    bench.put(on)
    bench.put(on._replace(sn=on.sn + 1, type=on.type ^ 1))
    bench.put(on._replace(sn=on.sn + 2, proto=1))
    bench.run()
    assert (len(bench.to_boards[8]), bench.gateway.counters.refused) == (sent, 3)


def test_a_late_frame_is_refused_but_for_a_stop(bench: QueueBench) -> None:
    on, stop = bench.last_frame(Command.TORQUE, ALL_ON), bench.last_frame(Command.STOP, b"\0")
    bench.run(2.0)
    bench.put(on)
    bench.put(stop)
    bench.run()
    assert bench.stopped()[8]
    assert [f.cmd for f in bench.to_boards[8]].count(Command.TORQUE) == 0


def test_a_repeat_reaches_the_board_only_while_that_knows_it(bench: QueueBench) -> None:
    frame = bench.last_frame(Command.TORQUE, ALL_ON)

    def torques() -> int:
        return sum(frame.cmd == Command.TORQUE for frame in bench.to_boards[8])

    def sent(again: int, body: bytes = ALL_ON, *, after: float = 0.1) -> int:
        bench.run(after)
        before = torques()
        sec = frame.time_sec + int(bench.now - START)
        bench.put(frame._replace(time_sec=sec, sn=frame.sn + again, body=body))
        bench.run(0.1)
        return torques() - before

    assert [sent(0), sent(1), sent(2)] == [1, 1, 1]
    assert sent(3, after=tables.REPEAT_WINDOW) == 0


def test_a_request_that_an_earlier_one_of_its_number_overtook_is_refused(bench: QueueBench) -> None:
    frame = bench.last_frame(Command.TORQUE, ALL_ON)
    bench.put(frame._replace(sn=frame.sn + 5))
    bench.put(frame._replace(body=b"\0\x7f\0"))
    bench.run()
    assert [f.body for f in bench.to_boards[8] if f.cmd == Command.TORQUE] == [ALL_ON]


def test_another_conversation_takes_the_boards_and_stops_what_was_left_unfinished(bench: QueueBench) -> None:
    assert bench.ask(Command.WATCHDOG, FIVE_SECONDS).status == Status.OK
    old = bench.last_frame(Command.TORQUE, ALL_ON)
    bench.connect()
    assert bench.ask(Command.IDENTIFY, to=8).status == Status.OK
    assert not any(bench.stopped().values()), "it is offered only"
    assert bench.ask(Command.STATS, to=9).status == Status.OK
    bench.run()
    assert bench.stopped() == {8: True, 9: False, 10: False}
    bench.put(old)
    assert bench.gateway.held(bench.side) == [9]


def test_a_host_that_has_ended_everything_may_be_followed_by_another(bench: QueueBench) -> None:
    assert bench.ask(Command.TORQUE, ALL_ON).status == Status.OK
    bench.connect()
    bench.ask(Command.IDENTIFY, to=8)
    bench.ask(Command.STATS, to=8)
    assert not any(bench.stopped().values())


def test_a_host_that_is_gone_leaves_no_conversation(bench: QueueBench) -> None:
    bench.ask(Command.WATCHDOG, FIVE_SECONDS)
    assert bench.side.is_heard
    assert bench.gateway.host_left(bench.side, bench.now) == [8]
    assert (bench.side.is_heard, bench.gateway.held(bench.side)) == (False, [])
    bench.put(bench.last_frame(Command.RESUME))
    bench.run()
    assert bench.stopped()[8], "of the host that is gone"


def test_a_board_that_restarts_ends_the_conversation(bench: QueueBench) -> None:
    bench.ask(Command.WATCHDOG, FIVE_SECONDS)
    bench.ask(Command.TORQUE, ALL_ON, 9)
    bench.boards[9].reset(bench.now)
    bench.host.request(Command.STATS, b"", bench.now, attempts=1)
    bench.run(1.0)
    assert not bench.side.is_heard
    assert bench.stopped()[8]


def test_boards_whose_clocks_differ_are_none_of_them_late(bench: QueueBench) -> None:
    # It began to count long after the others.
    bench.run(3.0)
    bench.boards[9].reset(bench.now)
    bench.run(0.3)
    bench.connect()
    bench.ask(Command.IDENTIFY, to=9)
    bench.ask(Command.REPORT, ANGLES, to=9)
    bench.ask(Command.STATS, to=8)
    bench.seen.clear()
    bench.run(1.0)
    assert sum(isinstance(event, Report) for event in bench.seen) > 10
    assert not any(isinstance(event, Request) for event in bench.seen)


def test_half_a_frame_is_not_continued_by_the_next_message(bench: QueueBench) -> None:
    whole = bench.last_frame(Command.STOP, b"\0")
    data = serialize_frame(whole, tables.MAX_NETWORK_FRAME)
    bench.gateway.receive_host(bench.side, data[:20], bench.now)
    bench.gateway.receive_host(bench.side, data[20:], bench.now)
    bench.run()
    assert not bench.stopped()[8]
    bench.put(whole)
    bench.run()
    assert bench.stopped()[8]


def test_as_many_answers_to_who_is_there_are_numbered_as_a_board_stores() -> None:
    host = QueueHost("mq:///bench", [8], iter(range(1, 99)).__next__)
    for seq in range(tables.STORED_REPLIES + 2):
        frame = Frame(0, 0, seq + 1, 7, 8, 1, tables.PROTO_HEXWIRE, seq, Command.IDENTIFY, b"")
        assert host.takes(frame, START)
        assert len(host._asked) == min(seq + 1, tables.STORED_REPLIES)
    reply = Frame(0, 0, 1, 8, 7, 8, tables.PROTO_HEXWIRE, 0, Command.IDENTIFY, b"", EXT_REPLY)
    host.send([reply])
    assert host.out == [], "whom it answers is forgotten"
    host.send([reply._replace(seq=tables.STORED_REPLIES)])
    assert len(host.out) == 1
