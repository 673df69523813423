"""One sentence each about conversations over datagrams, for any order, loss, doubling and delay of them."""

from __future__ import annotations

import random

from hypothesis import given, settings
from hypothesis import strategies as st

from hexwire.errors import LocalProtocolError
from hexwire.session.connection import Connection, Role
from hexwire.session.events import Reply, Request
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame, serialize_frame

MODULES = {Role.HOST: (7, 8), Role.BOARD: (8, 7)}
BODIES = (b"\x01\x7f\x00", b"\x00\x7f\x00", b"\x01\x01\x00")


def end(role: Role, seed: int) -> Connection:
    local, remote = MODULES[role]
    chance = random.Random(seed)
    return Connection(
        role, local=local, remote=remote, type=3, max_frame=8192, numbers=lambda: chance.getrandbits(31)
    )


def deliver(connection: Connection, data: bytes, now: float) -> tuple[list[tuple[int, bytes]], list[bytes]]:
    """What a board does for a datagram, and what it sends back."""
    done = []
    connection.receive(data, now, end_of_message=True)
    while (event := connection.next_event()) is not None:
        if isinstance(event, Request):
            if event.frame.cmd != Command.IDENTIFY:
                done.append((event.frame.cmd, event.frame.body))
            connection.reply(event, 0, b"", now)
    return done, connection.data_to_send()


def recorded(seed: int, commands: list[int], board: Connection, start: float) -> tuple[list[bytes], Connection]:
    """A conversation as it went: every datagram of the host, and the host."""
    host, now, sent = end(Role.HOST, seed), start, []
    for number, choice in enumerate([-1, *commands]):
        cmd, body = (Command.IDENTIFY, b"") if number == 0 else (Command.TORQUE, BODIES[choice])
        host.request(cmd, body, now)
        (data,) = host.data_to_send()
        sent.append(data)
        for answer in deliver(board, data, now)[1]:
            host.receive(answer, now, end_of_message=True)
        while host.next_event() is not None:
            pass
        now += 0.01
    return sent, host


COMMANDS = st.lists(st.integers(0, 2), min_size=1, max_size=12)
PICKS = st.lists(st.tuples(st.integers(0, 1 << 16), st.floats(0.0, 200.0)), max_size=40)


@given(st.integers(0, 9), COMMANDS, PICKS)
def test_nothing_recorded_is_ever_executed_again(
    seed: int, commands: list[int], picks: list[tuple[int, float]]
) -> None:
    board = end(Role.BOARD, 100 + seed)
    sent, _ = recorded(seed, commands, board, 50.0)
    now = 60.0
    for pick, pause in picks:
        now += pause
        assert deliver(board, sent[pick % len(sent)], now)[0] == []


@given(st.integers(0, 9), COMMANDS, PICKS)
def test_a_board_started_later_executes_nothing_recorded(
    seed: int, commands: list[int], picks: list[tuple[int, float]]
) -> None:
    sent, _ = recorded(seed, commands, end(Role.BOARD, 100 + seed), 50.0)
    later, now = end(Role.BOARD, 200 + seed), 60.0
    for pick, pause in picks:
        now += pause
        assert deliver(later, sent[pick % len(sent)], now)[0] == []


@given(st.integers(0, 9), COMMANDS, PICKS)
def test_replayed_datagrams_hold_up_nobody(seed: int, commands: list[int], picks: list[tuple[int, float]]) -> None:
    board = end(Role.BOARD, 100 + seed)
    sent, host = recorded(seed, commands, board, 50.0)
    for pick, _ in picks:
        deliver(board, sent[pick % len(sent)], 50.5)
    host.request(Command.STATS, b"", 50.6)
    (data,) = host.data_to_send()
    done, answers = deliver(board, data, 50.6)
    assert done == [(Command.STATS, b"")]
    host.receive(answers[0], 50.6, end_of_message=True)
    assert any(isinstance(event, Reply) for event in iter(host.next_event, None))


@given(COMMANDS, st.randoms(use_true_random=False), st.lists(st.floats(0.0, 2.0), min_size=13, max_size=13))
def test_each_is_executed_at_most_once_and_never_late(
    commands: list[int], chance: random.Random, delays: list[float]
) -> None:
    board, host, now = end(Role.BOARD, 1), end(Role.HOST, 2), 50.0
    _, answers = _identify(host, board, now)
    host.receive(answers[0], now, end_of_message=True)
    flying = []
    for number, _ in enumerate(commands):
        host.request(Command.TORQUE, number.to_bytes(2, "little"), now)
        (data,) = host.data_to_send()
        flying += [(now + delays[number] * chance.random() ** copy, now, data) for copy in range(3)]
    done: list[tuple[int, bytes]] = []
    for due, sent_at, data in sorted(flying, key=lambda row: row[0]):
        did, _ = deliver(board, data, due)
        done += did
        # The answer to IDENTIFY was at once, so the clocks are known to the microsecond.
        assert not did or due - sent_at <= tables.DATAGRAM_LATE + 1e-3 * (due - now) + 1e-6
    assert len(done) == len(set(done))


def _identify(host: Connection, board: Connection, now: float) -> tuple[list[tuple[int, bytes]], list[bytes]]:
    host.request(Command.IDENTIFY, b"", now)
    (data,) = host.data_to_send()
    return deliver(board, data, now)


FIELD = st.integers(0, 2**32 - 1) | st.integers(0, 20)
FORGED = st.builds(
    lambda proto, cmd, ext, seq, body, sn, sec, kind, src, dst: serialize_frame(Frame(
        proto=proto, cmd=cmd, cmd_ext=ext, seq=seq, body=body, sn=sn, src=src, dst=dst, type=kind,
        time_sec=sec, time_nsec=0,
    )),
    st.sampled_from((1, 2, 2, 2)),
    st.sampled_from([int(cmd) for cmd in Command]),
    st.sampled_from((0, 0, 0x40, 0x80, 0x85)),
    st.integers(0, 255),
    st.binary(max_size=24),
    FIELD,
    FIELD,
    st.integers(-(2**31), 2**31 - 1) | st.integers(-1, 8),
    st.sampled_from((-1, 7, 8)),
    st.sampled_from((-1, 7, 8)),
)  # fmt: skip


@given(st.sampled_from(list(Role)), st.booleans(), st.lists(FORGED | st.binary(max_size=80), max_size=20))
@settings(max_examples=300)
def test_bytes_of_any_kind_raise_nothing_and_do_nothing(role: Role, begun: bool, hostile: list[bytes]) -> None:
    host, board = end(Role.HOST, 1), end(Role.BOARD, 2)
    if begun:
        _, answers = _identify(host, board, 50.0)
        host.receive(answers[0], 50.0, end_of_message=True)
        list(iter(host.next_event, None))
    target = host if role is Role.HOST else board
    for number, data in enumerate(hostile):
        now = 50.0 + number * 0.01
        target.receive(data, now, end_of_message=True)
        for event in iter(target.next_event, None):
            assert not isinstance(event, Reply)
            if isinstance(event, Request):
                assert event.frame.cmd == Command.IDENTIFY
                target.reply(event, 0, b"", now)
        target.handle_timeout(now)
        target.data_to_send()
        if target.conversations is not None:
            assert len(target.conversations._offered) <= 16
            assert len(target.conversations._asked) <= 16
    # And whoever means it is heard all the same.
    if begun:
        host.request(Command.STATS, b"", 51.0)
        done, _ = deliver(board, host.data_to_send()[-1], 51.0)
        assert done == [(Command.STATS, b"")]
    else:
        try:
            host.request(Command.STATS, b"", 51.0)
        except LocalProtocolError:
            return
        raise AssertionError("a forged answer began a conversation")
