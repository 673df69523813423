"""A session asks several modules at once, and says who is silent."""

from __future__ import annotations

import pytest
from tests.ipc.channels import open_channel

from hexwire.errors import LocalProtocolError, StoppedError
from hexwire.wire import tables
from hexwire.wire.addresses import Broadcast, Multicast, Unicast
from hexwire.wire.command_frame import Command, Status
from hexwire.wire.commands import Identity, parse_stop_reply
from hexwire.wire.modules import ModuleType

ARDUINO = ModuleType.ARM_7BOT_ARDUINO_TRX
ALL_ON = b"\1\x7f\0"


def test_identify_finds_the_modules_of_a_channel() -> None:
    _, _, session = open_channel(8, 9, 10)
    found = session.request_all(Command.IDENTIFY)
    assert (list(found.replies), found.silent) == ([8, 9, 10], frozenset())
    assert session.modules == {8, 9, 10}
    for reply in found.replies.values():
        assert Identity.parse(reply.body).capabilities & tables.CAPABILITY_SEVERAL


def test_a_broadcast_names_the_known_ones_that_are_silent() -> None:
    channel, link, session = open_channel(8, 9, 10)
    session.request_all(Command.IDENTIFY)
    channel.deaf = {9}
    before = link.clock()
    answers = session.request_all(Command.STATS)
    assert (list(answers.replies), answers.silent) == ([8, 10], {9})
    assert link.clock() - before == pytest.approx(3 * tables.DIALECT2_REPLY_WINDOW, abs=0.05)
    # It is told again, and found again.
    assert session.request_all(Command.IDENTIFY).silent == {9}
    channel.deaf = set()
    assert session.request_all(Command.STATS).silent == frozenset()


def test_only_those_that_are_named_do_it() -> None:
    channel, _, session = open_channel(8, 9, 10)
    answers = session.request_all(Command.TORQUE, ALL_ON, Multicast((ARDUINO, 10)))
    assert {m: r.status for m, r in answers.replies.items()} == {8: Status.OK, 10: Status.OK}
    on = {m: [j.torque_on for j in board.state.joints] for m, board in channel.boards.items()}
    assert {m: all(each) for m, each in on.items()} == {8: True, 9: False, 10: True}
    assert list(session.request_all(Command.STATS, to=Unicast(9)).replies) == [9]
    assert list(session.request_all(Command.STATS, to=[9, 10]).replies) == [9, 10]


def test_one_stop_stops_all_and_cancels_what_was_called_before() -> None:
    channel, _, session = open_channel(8, 9)
    session.request_all(Command.IDENTIFY)
    session.request_all(Command.TORQUE, ALL_ON)
    answers = session.request_all(Command.STOP, b"\0")
    assert {m: parse_stop_reply(r.body) for m, r in answers.replies.items()} == {8: (0, 0x7F), 9: (0, 0x7F)}
    assert all(board.state.stopped for board in channel.boards.values())
    assert session.epochs.stopped
    assert not session.epochs.failed
    session.request_all(Command.RESUME)
    assert not session.epochs.stopped
    assert not any(board.state.stopped for board in channel.boards.values())


@pytest.mark.parametrize("resumes", [False, True])
def test_of_a_call_before_a_stop_nothing_is_sent_any_more(resumes: bool) -> None:
    channel, _, session = open_channel(8, 9)
    session.request_all(Command.IDENTIFY)
    call = session.epochs.token("torque on")
    session.request_all(Command.STOP, b"\0")
    if resumes:
        session.request_all(Command.RESUME)
    with session.epochs.using(call), pytest.raises(StoppedError, match="a stop came after the call"):
        session.request_all(Command.TORQUE, ALL_ON)
    assert not any(joint.torque_on for board in channel.boards.values() for joint in board.state.joints)


def test_a_stop_that_one_does_not_confirm_is_unconfirmed() -> None:
    channel, _, session = open_channel(8, 9)
    session.request_all(Command.IDENTIFY)
    channel.deaf = {9}
    assert session.request_all(Command.STOP, b"\0").silent == {9}
    assert session.epochs.failed
    with pytest.raises(StoppedError, match="not confirmed"):
        session.request_all(Command.JOINT_MOVE, b"\x64\0\1\xfe\0\x08")
    # A resume that not all have confirmed ends nothing here.
    session.request_all(Command.RESUME)
    assert session.epochs.stopped


def test_a_stop_that_is_refused_is_unconfirmed() -> None:
    _, _, session = open_channel(8, 9)
    unknown_mode = b"\x09"
    answers = session.request_all(Command.STOP, unknown_mode, [8, 9])
    assert {reply.status for reply in answers.replies.values()} == {Status.BAD_RANGE}
    assert session.epochs.failed


def test_every_frame_has_time_to_be_written(monkeypatch: pytest.MonkeyPatch) -> None:
    _, link, session = open_channel(8, 9)
    left: list[float] = []
    write = link.write

    def timed(data: bytes, deadline: float | None = None) -> None:
        assert deadline is not None
        left.append(deadline - link.clock())
        write(data, deadline)

    monkeypatch.setattr(link, "write", timed)
    session.send(Command.STATS)
    session.request(Command.STATS)
    # With a frame that waits, such as a chunk that was asked for again.
    session.connection.send_fragment(Command.FRAGMENT, bytes(9), 8, session.now())
    session.request(Command.STATS)
    assert len(left) == 4
    assert min(left) > 0.5


def test_a_command_for_one_module_is_answered_by_each() -> None:
    _, _, session = open_channel(8, 9)
    for cmd in (Command.LIMITS, Command.TRANSACT, Command.MAINTENANCE):
        answers = session.request_all(cmd, to=Multicast((8, 9)))
        assert {r.status for r in answers.replies.values()} == {Status.NOT_SUPPORTED}
    with pytest.raises(LocalProtocolError, match="one frame"):
        session.request_all(Command.JOINT_MOVE, bytes(9000), Broadcast())


def test_a_repeat_for_the_silent_one_is_done_once() -> None:
    channel, _, session = open_channel(8, 9)
    done = {module: board.connection for module, board in channel.boards.items()}
    out = channel.data_to_send
    lost = [True]

    def lose_first() -> bytes:
        data = out()
        if data and lost:
            lost.pop()
            return b""
        return data

    channel.data_to_send = lose_first  # type: ignore[method-assign]  # the line loses its first answers
    answers = session.request_all(Command.RESUME, to=[8, 9])
    assert [r.attempts for r in answers.replies.values()] == [2, 2]
    assert [connection.counters.repeats for connection in done.values()] == [1, 1]
