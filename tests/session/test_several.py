"""Requests to several modules: one frame, an answer from each, and who did not answer."""

from __future__ import annotations

import pytest
from tests.session.wires import board, events, host

from hexwire.errors import LocalProtocolError
from hexwire.session.connection import Connection
from hexwire.session.events import Answers, Request, Stale
from hexwire.session.several import To
from hexwire.wire import tables
from hexwire.wire.addresses import Broadcast, Multicast
from hexwire.wire.command_frame import Command, Frame, Status, parse_frame

WINDOW = tables.DIALECT2_REPLY_WINDOW
MODULES = (8, 9, 12)


class Bus:
    """A line with several boards; some of them may be deaf."""

    def __init__(self) -> None:
        self.host = host()
        self.boards = {module: board(local=module) for module in MODULES}
        self.deaf: set[int] = set()
        self.mute: set[int] = set()
        self.done: list[tuple[int, int]] = []
        self.frames: list[Frame] = []
        self.now = 0.0

    def ask(self, to: Multicast | Broadcast, *known: int, cmd: int = Command.STATS, body: bytes = b"") -> int:
        return self.host.several.request(To(to, known), cmd, body, self.now)

    def carry(self) -> None:
        for data in self.host.data_to_send():
            self.frames.append(parse_frame(data))
            for module, end in self.boards.items():
                if module not in self.deaf:
                    self._serve(module, end, data)

    def _serve(self, module: int, end: Connection, data: bytes) -> None:
        end.receive(data, self.now)
        for event in events(end):
            if isinstance(event, Request):
                self.done.append((module, event.frame.cmd))
                end.reply(event, Status.OK, bytes((module,)), self.now)
        for answer in end.data_to_send():
            if module not in self.mute:
                self.host.receive(answer, self.now)

    def wait(self) -> None:
        due = self.host.next_timeout()
        assert due is not None
        self.now = due
        self.host.handle_timeout(due)
        self.carry()

    def end(self) -> Answers:
        (found,) = (event for event in events(self.host) if isinstance(event, Answers))
        return found


@pytest.fixture
def bus() -> Bus:
    return Bus()


def test_a_multicast_is_one_frame_and_ends_when_all_have_answered(bus: Bus) -> None:
    ticket = bus.ask(Multicast((8, 12)))
    bus.carry()
    end = bus.end()
    assert (end.ticket, end.cmd, end.silent) == (ticket, Command.STATS, frozenset())
    assert {module: reply.body for module, reply in end.replies.items()} == {8: b"\x08", 12: b"\x0c"}
    assert [frame.dst for frame in bus.frames] == [0x40000000 | 1 << 8 | 1 << 12]
    assert bus.host.next_timeout() is None


def test_a_broadcast_reaches_all_and_ends_with_those_that_are_known(bus: Bus) -> None:
    bus.ask(Broadcast(), *MODULES)
    bus.carry()
    assert list(bus.end().replies) == list(MODULES)
    assert [frame.dst for frame in bus.frames] == [-1]


def test_a_broadcast_with_nobody_known_takes_its_time(bus: Bus) -> None:
    bus.ask(Broadcast())
    bus.carry()
    assert events(bus.host) == []
    for _ in range(3):
        bus.wait()
    end = bus.end()
    assert (list(end.replies), end.silent) == (list(MODULES), frozenset())
    assert bus.now == pytest.approx(3 * WINDOW)


def test_repeats_go_to_the_silent_ones_only_and_who_never_answers_is_told(bus: Bus) -> None:
    bus.deaf = {9}
    bus.mute = {12}
    bus.ask(Multicast(MODULES))
    bus.carry()
    bus.mute = set()
    bus.wait()
    bus.wait()
    bus.wait()
    end = bus.end()
    assert (list(end.replies), end.silent) == ([8, 12], {9})
    assert end.replies[12].attempts == 2
    three = Multicast(MODULES).dst
    assert [frame.dst for frame in bus.frames] == [three, Multicast((9, 12)).dst, Multicast((9,)).dst]
    assert len({frame.seq for frame in bus.frames}) == 1
    # Whose answer was lost has done it once.
    assert bus.done == [(8, Command.STATS), (12, Command.STATS)]


def test_answers_of_others_and_doubles_are_no_answers(bus: Bus) -> None:
    bus.ask(Multicast((8, 9)))
    (data,) = bus.host.data_to_send()
    request = parse_frame(data)

    def answer(module: int, **changes: object) -> None:
        frame = request._replace(src=module, dst=7, type=8, cmd_ext=0x80, **changes)
        end = Connection(bus.boards[8].role, local=module, remote=7, type=8)
        bus.host.receive(end.build(2, frame.cmd, b"", frame.seq, 0.0, 0x80, dst=frame.dst), 0.0)

    answer(12)
    answer(8, cmd=Command.STOP)
    answer(8, seq=99)
    assert [type(event) for event in events(bus.host)] == [Stale] * 3
    answer(8)
    answer(8)
    assert events(bus.host) == []
    answer(9)
    assert list(bus.end().replies) == [8, 9]


def test_a_stop_voids_them_but_not_other_stops(bus: Bus) -> None:
    bus.ask(Broadcast())
    stop = bus.host.several.request(To(Broadcast(), ()), Command.STOP, b"\0", 0.0, urgent=True)
    assert [parse_frame(data).cmd for data in bus.host.data_to_send()] == [Command.STOP, Command.STATS]
    kept = bus.host.several.request(To(Broadcast(), ()), Command.STATS, b"", 0.0)
    again = bus.host.several.request(To(Broadcast(), ()), Command.STOP, b"\1", 0.0, urgent=True)
    bus.host.void()
    assert [parse_frame(data).body for data in bus.host.data_to_send()] == [b"\1"]
    assert [bus.host.holds(ticket) for ticket in (stop, kept, again)] == [True, False, True]


def test_what_is_abandoned_gets_no_answer_and_may_be_held_back(bus: Bus) -> None:
    ticket = bus.ask(Broadcast())
    assert not bus.host.abandon(ticket), "nothing of it has left"
    assert bus.host.data_to_send() == []
    ticket = bus.ask(Broadcast())
    bus.carry()
    assert bus.host.abandon(ticket)
    bus.carry()
    assert bus.host.next_timeout() is None


def test_what_cannot_go_to_several(bus: Bus) -> None:
    with pytest.raises(LocalProtocolError, match="one frame"):
        bus.ask(Broadcast(), body=bytes(209))
    for far in (host(dialect=1), host(numbers=lambda: 5)):
        with pytest.raises(LocalProtocolError, match="several modules"):
            far.several.request(To(Broadcast(), ()), Command.STATS, b"", 0.0)
    begun = host(numbers=lambda: 5)
    begun.conversations.begin(Frame(0, 0, 1, 8, 7, 5, 2, 1, Command.IDENTIFY, b"", 0x80), 0.0)  # type: ignore[union-attr]
    with pytest.raises(LocalProtocolError, match="one module"):
        begun.several.request(To(Broadcast(), ()), Command.IDENTIFY, b"", 0.0)
    assert begun.several.request(To(Broadcast(), ()), Command.STATS, b"", 0.0)
    assert bus.host.data_to_send() == []


def test_numbers_are_not_shared_with_other_requests(bus: Bus) -> None:
    bus.ask(Broadcast())
    for _ in range(255):
        bus.host.request(Command.STATS, b"", 0.0)
    assert len({parse_frame(data).seq for data in bus.host.data_to_send()}) == 256
    with pytest.raises(LocalProtocolError, match="256"):
        bus.ask(Broadcast())


@pytest.mark.parametrize("dst", [-1, Multicast((8,)).dst])
def test_a_command_for_one_module_is_refused_each_time(dst: int) -> None:
    end = board()
    for cmd in (Command.FRAGMENT, Command.FRAGMENT_MISSING, Command.TRANSACT, Command.LIMITS, 0x77):
        for _ in range(2):
            end.receive(host().build(2, cmd, b"\1\0\0\0", 1, 0.0, dst=dst), 0.0)
            assert events(end) == []
            (reply,) = (parse_frame(data) for data in end.data_to_send())
            assert (reply.cmd, reply.seq, reply.cmd_ext, reply.dst) == (cmd, 1, 0x80 | Status.NOT_SUPPORTED, 7)
    assert end.counters.not_for_several == 10
    assert end.counters.repeats == 0
