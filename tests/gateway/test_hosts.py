"""Several hosts at one gateway: each has its own boards, feeds only their watchdogs, and may stop them all."""

from __future__ import annotations

import pytest
from tests.gateway.bench import Bench

from hexwire.gateway.host import Host
from hexwire.session.decoder import FrameDecoder
from hexwire.wire import tables
from hexwire.wire.addresses import Broadcast, Multicast
from hexwire.wire.command_frame import Command, Frame, Status, serialize_frame

ALL_ON = b"\1\x7f\0"
HALF_SECOND = b"\xf4\1\0"


class Other:
    """A second host of a bench, frame by frame."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.side: Host = bench.gateway.host_came("other:1")

    def send(self, cmd: int, body: bytes = b"", to: int = 8, *, seq: int = 1) -> list[Frame]:
        """Send one frame; returns what has come after a while."""
        frame = Frame(0, 0, 0, 7, to, 1, 2, seq, cmd, body)
        self.bench.gateway.receive_host(self.side, serialize_frame(frame, tables.MAX_NETWORK_FRAME), self.bench.now)
        return self.wait()

    def wait(self, seconds: float = 0.2) -> list[Frame]:
        self.bench.run(seconds)
        decoder = FrameDecoder(tables.MAX_NETWORK_FRAME)
        decoder.receive(self.bench.gateway.host_data(self.side), self.bench.now)
        found = []
        while (event := decoder.next_event()) is not None:
            assert isinstance(event, Frame)
            found.append(event)
        return found


@pytest.fixture
def bench() -> Bench:
    made = Bench()
    made.run(0.3)
    made.ask(Command.IDENTIFY, to=8)
    return made


def status(frame: Frame) -> int:
    return frame.cmd_ext & tables.EXT_STATUS_MASK


def test_every_host_has_the_boards_that_it_names_first(bench: Bench) -> None:
    other = Other(bench)
    (answer,) = other.send(Command.IDENTIFY, to=9)
    assert (status(answer), answer.src) == (Status.OK, 9)
    assert bench.ask(Command.TORQUE, ALL_ON, 8).status == Status.OK
    (answer,) = other.send(Command.TORQUE, ALL_ON, 9, seq=2)
    assert status(answer) == Status.OK
    assert [bench.gateway.held(side) for side in bench.gateway.hosts] == [[8], [9]]
    # The end of one frees its boards and touches no other.
    bench.ask(Command.WATCHDOG, HALF_SECOND, 8)
    assert bench.gateway.host_gone(other.side, bench.now, broken=True) == [9]
    assert bench.gateway.held(bench.side) == [8]


def test_nothing_of_a_stranger_reaches_a_board_but_a_stop(bench: Bench) -> None:
    other = Other(bench)
    bench.ask(Command.WATCHDOG, HALF_SECOND, 8)
    before = len(bench.to_boards[8])
    for cmd in Command:
        if cmd in (Command.STOP, Command.FRAGMENT, Command.FRAGMENT_MISSING):
            continue
        (answer,) = other.send(cmd, ALL_ON if cmd == Command.TORQUE else b"", seq=int(cmd))
        assert (status(answer), answer.cmd, answer.src) == (Status.BUSY, cmd, 8), cmd
        assert b"module 8 has another host, the bench" in answer.body, cmd
    assert len(bench.to_boards[8]) == before
    # So it has fed no watchdog: that of a host that has fallen silent meanwhile has stopped the board.
    assert bench.stopped()[8]


@pytest.mark.parametrize("to", [8, Broadcast().dst, Multicast((8, 9)).dst])
@pytest.mark.parametrize("mode", [0, 1])
def test_a_stop_of_anybody_gets_through_even_with_the_hosts_own_number(bench: Bench, to: int, mode: int) -> None:
    other = Other(bench)
    # The board would take a stop with the number of one before for its repeat.
    bench.ask(Command.TORQUE, ALL_ON, 8)
    reply = bench.ask(Command.STOP, b"\0", 8)
    assert reply.frame is not None
    bench.ask(Command.RESUME, to=8)
    assert not bench.stopped()[8]
    answers = other.send(Command.STOP, bytes((mode,)), to, seq=reply.frame.seq)
    assert bench.stopped()[8]
    assert [(status(a), a.cmd, a.seq, a.dst) for a in answers if a.src == 8] == [
        (Status.OK, Command.STOP, reply.frame.seq, 7)
    ]
    assert any(j.torque_on for j in bench.boards[8].state.joints) == (not mode)
    # What the host asks for afterwards is refused by the board itself.
    assert bench.ask(Command.TORQUE, ALL_ON, 8).status == Status.STOPPED


@pytest.mark.parametrize("whose", ["its own board", "that of another host"])
def test_a_burst_of_stops_is_two_stops_and_every_one_is_answered(bench: Bench, whose: str) -> None:
    other, module = Other(bench), 9 if whose == "its own board" else 8
    if module == 9:
        other.send(Command.IDENTIFY, to=module)
    before = len(bench.to_boards[module])
    # 256 numbers there are; 2,357 stops, as fast as a network brings them.
    for seq in range(2357):
        frame = Frame(0, 0, 0, 7, module, 1, 2, seq & 0xFF, Command.STOP, b"\0")
        bench.gateway.receive_host(other.side, serialize_frame(frame, tables.MAX_NETWORK_FRAME), bench.now)
    answers = other.wait()
    assert {a.seq for a in answers} == set(range(256))
    assert {(status(a), a.src) for a in answers} == {(Status.OK, module)}
    assert 1 <= len(bench.to_boards[module]) - before <= 2
    assert bench.stopped()[module]
    # Nothing of it is left: who resumes the arm afterwards has it.
    host = other if module == 9 else None
    resumed = host.send(Command.RESUME, to=9)[0] if host else bench.ask(Command.RESUME, to=8).frame
    assert resumed is not None
    assert status(resumed) == Status.OK
    bench.run(1.0)
    assert not bench.stopped()[module]


def test_a_stop_voids_what_waits_of_the_host(bench: Bench) -> None:
    bench.boards[8].wire.baud = 0
    other = Other(bench)
    tickets = [bench.host.request(Command.TORQUE, ALL_ON, bench.now) for _ in range(3)]
    for data in bench.host.data_to_send():
        bench.gateway.receive_host(bench.side, data, bench.now)
    other.send(Command.STOP, b"\0")
    for ticket in tickets:
        bench.wait(ticket)
    assert not any(j.torque_on for j in bench.boards[8].state.joints)


def test_who_looks_for_boards_finds_those_of_others_too(bench: Bench) -> None:
    other = Other(bench)
    answers = other.send(Command.IDENTIFY, to=Broadcast().dst)
    assert [(a.src, status(a)) for a in answers] == [(8, Status.OK), (9, Status.OK), (10, Status.OK)]
    # It has become the host of none by that; what it asks for next takes the free ones.
    assert bench.gateway.held(other.side) == []
    resumed = other.send(Command.RESUME, to=Broadcast().dst, seq=2)
    assert [status(a) for a in resumed] == [Status.BUSY, Status.OK, Status.OK]


@pytest.mark.slow
def test_who_looks_for_boards_or_stops_them_keeps_nobody_out(bench: Bench) -> None:
    """However often, and while it stays connected."""
    watcher, other = Other(bench), Other(bench)
    for seq in range(20):
        told = watcher.send(Command.IDENTIFY, to=(Broadcast(), Multicast((8, 9)))[seq % 2].dst, seq=seq)
        assert {status(a) for a in told} == {Status.OK}
        for to in (9, Multicast((9, 10)).dst, Broadcast().dst):
            stopped = watcher.send(Command.STOP, b"\0", to, seq=seq)
            assert {status(a) for a in stopped} == {Status.OK}
        assert bench.gateway.held(watcher.side) == []
    (taken,) = other.send(Command.IDENTIFY, to=9)
    assert (status(taken), taken.src) == (Status.OK, 9)
    (resumed,) = other.send(Command.RESUME, to=9, seq=2)
    assert status(resumed) == Status.OK
    assert bench.gateway.held(other.side) == [9]
    # Its end stops nothing of the others.
    assert bench.gateway.host_gone(watcher.side, bench.now, broken=True) == []


def test_a_burst_of_those_who_look_for_boards_does_not_fill_a_line(bench: Bench) -> None:
    watcher = Other(bench)
    before = len(bench.to_boards[9])
    for seq in range(2000):
        frame = Frame(0, 0, 0, 7, Broadcast().dst, 1, 2, seq & 0xFF, Command.IDENTIFY, b"")
        bench.gateway.receive_host(watcher.side, serialize_frame(frame, tables.MAX_NETWORK_FRAME), bench.now)
    answers = watcher.wait()
    assert {a.seq for a in answers if a.src == 9} == set(range(256))
    assert len(bench.to_boards[9]) == before + 1


def test_who_looks_for_boards_is_told_of_one_that_is_silent_also_after_a_stop(bench: Bench) -> None:
    watcher, other = Other(bench), Other(bench)
    bench.dead = {10}
    frame = Frame(0, 0, 0, 7, Broadcast().dst, 1, 2, 5, Command.IDENTIFY, b"")
    bench.gateway.receive_host(watcher.side, serialize_frame(frame, tables.MAX_NETWORK_FRAME), bench.now)
    other.send(Command.STOP, b"\0", Broadcast().dst)
    assert {(a.src, status(a)) for a in watcher.wait()} == {
        (8, Status.OK),
        (9, Status.OK),
        (10, Status.UNREACHABLE),
    }


def test_a_stop_of_a_lost_board_by_another_reaches_it_when_it_is_back(bench: Bench) -> None:
    other = Other(bench)
    bench.gateway.lines[8].lost()
    assert other.send(Command.STOP, b"\1") == []
    bench.gateway.lines[8].back(bench.now)
    bench.run(0.5)
    assert bench.stopped()[8]


def next_host(bench: Bench) -> Other:
    """The host has left in order, and another one comes; both give the same numbers."""
    bench.gateway.host_gone(bench.side, bench.now, broken=False)
    return Other(bench)


@pytest.mark.parametrize("stop", ["another host's", "the watchdog's"])
@pytest.mark.parametrize("to", [8, Broadcast().dst, Multicast((8, 9)).dst])
def test_a_board_takes_no_request_for_a_repeat_of_one_by_the_host_before(bench: Bench, to: int, stop: str) -> None:
    first, asked = Other(bench), [(Command.RESUME, b""), (Command.TORQUE, ALL_ON), (Command.STOP, b"\0")]
    bench.gateway.host_gone(bench.side, bench.now, broken=False)
    for seq, (cmd, body) in enumerate(asked):
        assert {status(a) for a in first.send(cmd, body, 8, seq=seq)} == {Status.OK}
    first.send(Command.RESUME, to=8, seq=9)
    assert bench.gateway.host_gone(first.side, bench.now, broken=False) == []
    if stop == "another host's":
        Other(bench).send(Command.STOP, b"\1")
    else:
        bench.boards[8].state.watchdog_due = bench.now
        bench.run(0.1)
    assert bench.stopped()[8]
    second = Other(bench)
    second.send(Command.IDENTIFY, to=to, seq=8)
    for seq, (cmd, body) in enumerate(asked):
        assert {status(a) for a in second.send(cmd, body, to, seq=seq) if a.src == 8} == {Status.OK}, cmd
        board = bench.boards[8].state
        assert board.stopped == (cmd == Command.STOP)
        assert cmd != Command.TORQUE or all(joint.torque_on for joint in board.joints)


def test_a_stop_of_a_host_that_the_board_does_not_know_yet_is_no_repeat(bench: Bench) -> None:
    bench.ask(Command.TORQUE, ALL_ON, 8)
    reply = bench.ask(Command.STOP, b"\0", 8)
    assert reply.frame is not None
    bench.ask(Command.RESUME, to=8)
    second = next_host(bench)
    # What tells the board of the host is lost on the way.
    bench.drop = lambda module, frame: frame.cmd == Command.IDENTIFY
    assert second.send(Command.JOINT_STATE, b"\1\0", 8, seq=200) == []
    assert bench.gateway.held(second.side) == [8]
    answers = second.send(Command.STOP, b"\0", 8, seq=reply.frame.seq)
    assert {(status(a), a.cmd, a.seq) for a in answers} == {
        (Status.STOPPED, Command.JOINT_STATE, 200),
        (Status.OK, Command.STOP, reply.frame.seq),
    }
    assert bench.stopped()[8]


def test_a_board_is_told_of_a_host_until_it_answers_and_nothing_goes_before_that(bench: Bench) -> None:
    second, lost = next_host(bench), 3

    def drop(module: int, frame: Frame) -> bool:
        nonlocal lost
        lost -= frame.cmd == Command.IDENTIFY
        return lost >= 0

    bench.drop = drop
    before = len(bench.to_boards[8])
    (torque,) = second.send(Command.TORQUE, ALL_ON, 8) or second.wait(0.5)
    assert status(torque) == Status.OK
    commands = [frame.cmd for frame in bench.to_boards[8][before:]]
    assert commands == [Command.IDENTIFY] * 4 + [Command.TORQUE]
    # It does not know that the gateway has asked in its name.
    assert second.wait() == []


def test_a_board_that_a_stop_kept_from_knowing_its_host_is_told_again(bench: Bench) -> None:
    second, stopper = next_host(bench), Other(bench)
    bench.drop = lambda module, frame: frame.cmd == Command.IDENTIFY
    second.send(Command.RESUME, to=8, seq=5)
    stopper.send(Command.STOP, b"\0")
    assert [(status(a), a.seq) for a in second.wait()] == [(Status.STOPPED, 5)]
    bench.drop = lambda module, frame: False
    line, asked = bench.gateway.lines[8], bench.to_boards[8]
    before = len(asked)
    (resumed,) = second.send(Command.RESUME, to=8, seq=6)
    assert status(resumed) == Status.OK
    assert [frame.cmd for frame in asked[before:]] == [Command.IDENTIFY, Command.RESUME]
    assert not bench.stopped()[8]
    assert not line.stops_itself
