"""Messages in fragments to the firmware's core (PROTOCOL.md section 6.10): a whole trajectory as one request."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator

import pytest
from tests.avr.client import Client
from tests.avr.machines import ChipBoard, CoreBoard, Machine
from tests.avr.messages import MessageHost
from tests.conformance_board.test_trajectory import START, Rider, wave
from tests.few import few
from tests.frames import frame_bytes

from hexwire.wire.board_trajectory import PathPoint, PathState, PathStatus, PointsRequest
from hexwire.wire.command_frame import Command, Frame, Status
from hexwire.wire.commands import parse_missing

# The first one builds.

NUMBER = 5
POINTS = Command.TRAJECTORY_POINTS


@pytest.fixture
def rider() -> Iterator[Rider]:
    made = Rider("core", ())
    yield made
    made.board.close()


@pytest.fixture
def host(rider: Rider) -> MessageHost:
    return MessageHost(rider.client)


def request(points: list[PathPoint], *, last: bool = False, first: int = 0) -> bytes:
    return PointsRequest.of(NUMBER, first, points, last=last).serialize()


def still(count: int) -> list[PathPoint]:
    """Points of joint 1 at one place."""
    return [PathPoint(100 if n else 0, (START[0],)) for n in range(count)]


def answers(host: MessageHost, seconds: float = 0.05) -> list[tuple[int, ...]]:
    """What the board says to messages: (command, status) of a reply, (command, indices) of a question."""
    found: list[tuple[int, ...]] = []
    for frame in host.run(seconds):
        asked = frame.cmd == Command.FRAGMENT_MISSING and not frame.is_reply
        found.append((frame.cmd, *parse_missing(frame.body)[1]) if asked else (frame.cmd, frame.status))
    return found


MISSING = Command.FRAGMENT_MISSING


@few("size", [5, 17, 32, 100, 199, 200], 5, 200)
def test_a_whole_trajectory_is_one_request(rider: Rider, host: MessageHost, size: int) -> None:
    rider.begin(hermite=True)
    points = wave(300.0, 1.0, 20)
    reply = host.send(POINTS, request(points, last=True), size)
    assert reply.status == Status.OK
    said = PathStatus.parse(reply.body)
    assert (said.state, said.next, said.free) == (PathState.LOADING, 21, 64 - 21)
    chunks = -(-(5 + 30 * 21) // size)
    assert [i for asked in host.asked for i in asked] == list(range(1, chunks))
    assert all(len(asked) <= 2 for asked in host.asked)
    if size == 200:
        since = rider.machine.now
        assert rider.start() == Status.OK
        rider.until(PathState.DONE)
        by_requests = Rider("core", ())
        try:
            by_requests.begin(hermite=True)
            assert by_requests.add(points, last=True) == Status.OK
            after = by_requests.machine.now
            by_requests.start()
            by_requests.until(PathState.DONE)
            ours = [each.target for each in rider.sent(since) if each.joint == 3]
            theirs = [each.target for each in by_requests.sent(after) if each.joint == 3]
            assert abs(len(ours) - len(theirs)) <= 2
            assert max(ours) == max(theirs)
        finally:
            by_requests.board.close()


def test_a_line_that_loses_frames_only_takes_longer(rider: Rider) -> None:
    for seed in range(12):
        dice = random.Random(seed)
        host = MessageHost(rider.client, lost=lambda dice=dice: dice.random() < 0.25)
        rider.begin(hermite=True)
        reply = host.send(POINTS, request(wave(300.0, 1.0, 20), last=True), 120, within=12.0)
        assert (reply.status, PathStatus.parse(reply.body).next) == (Status.OK, 21), f"seed {seed}"


def test_points_go_on_while_the_path_runs(rider: Rider, host: MessageHost) -> None:
    rider.begin(1)
    points = [PathPoint(100 if n else 0, (START[0] + n % 400,)) for n in range(400)]
    assert host.send(POINTS, request(points[:250])).status == Status.OK
    assert rider.start() == Status.OK
    assert host.send(POINTS, request(points[250:], first=250, last=True)).status == Status.OK
    rider.until(PathState.DONE, 8.0)
    assert rider.status().next == 400
    assert rider.sent()[-1].target == START[0] + 399


def test_points_count_when_all_have_come(rider: Rider, host: MessageHost) -> None:
    rider.begin(1)
    body = request(still(100))
    message = host.new_id()
    free = rider.status().free
    for index, ask in ((0, (MISSING, 1, 2)), (1, None), (2, None)):
        host.chunk(message, index, 3, POINTS, body[200 * index : 200 * index + 200])
        heard = answers(host)
        if ask:
            assert heard == [ask]
        if index < 2:
            assert (rider.status().next, rider.status().free) == (0, free)
            assert rider.start() == Status.BAD_RANGE
    assert (rider.status().next, rider.status().free) == (100, free - 100)


@pytest.mark.parametrize("at", [0, 39, 40, 99])
def test_a_trajectory_is_refused_as_a_whole(rider: Rider, host: MessageHost, at: int) -> None:
    rider.begin(1)
    assert rider.add(still(3)) == Status.OK
    points = [PathPoint(100, (START[0],))] * 100
    points[at] = PathPoint(100, (5000,))
    assert host.send(POINTS, request(points, first=3)).status == Status.BAD_RANGE
    assert rider.status().next == 3
    points[at] = PathPoint(100, (START[0],))
    assert host.send(POINTS, request(points, first=3)).status == Status.OK
    assert rider.status().next == 103


def test_more_points_than_fit_are_refused_at_once(rider: Rider, host: MessageHost) -> None:
    rider.begin(hermite=True)
    points = wave(100.0, 2.0, 64)
    assert host.send(POINTS, request(points)).status == Status.BUSY
    assert host.asked == []
    assert host.send(POINTS, request(points[:64])).status == Status.OK
    assert rider.status().free == 0


def test_only_the_next_points_can_come_in_fragments(rider: Rider, host: MessageHost) -> None:
    rider.begin(1)
    assert rider.add(still(5)) == Status.OK
    more = [PathPoint(100, (START[0],))] * 40
    for first in (4, 6, 0):
        assert host.send(POINTS, request(more, first=first)).status == Status.BAD_RANGE
    assert host.send(POINTS, request(more, first=5, last=True)).status == Status.OK
    assert host.send(POINTS, request(more, first=45)).status == Status.BAD_RANGE


# Each: what is changed in (index, count, cmd, cmd_ext, data) of chunk 0 of 3, and what the board says.
HEAD = request(still(100))[:200]
FIRST = [
    ((1, 1, POINTS, 0, HEAD), (Command.FRAGMENT, Status.BAD_RANGE)),
    ((0, 0, POINTS, 0, HEAD), (Command.FRAGMENT, Status.BAD_RANGE)),
    ((0, 3, POINTS, 0x80, HEAD), (Command.FRAGMENT, Status.BAD_RANGE)),
    ((0, 3, Command.STATS, 0, HEAD), (Command.STATS, Status.NOT_SUPPORTED)),
    ((0, 3, Command.FRAGMENT, 0, HEAD), (Command.FRAGMENT, Status.NOT_SUPPORTED)),
    ((0, 3, Command.IDENTIFY, 0, b""), (Command.IDENTIFY, Status.NOT_SUPPORTED)),
    ((0, 2, POINTS, 0, HEAD), (POINTS, Status.BAD_LENGTH)),
    ((0, 4, POINTS, 0, HEAD), (POINTS, Status.BAD_LENGTH)),
    ((0, 3, POINTS, 0, HEAD[:-1]), (MISSING, 1, 2)),
    ((0, 3, POINTS, 0, HEAD[:4]), (POINTS, Status.BAD_LENGTH)),
    ((0, 3, POINTS, 0, b""), (POINTS, Status.BAD_LENGTH)),
    ((0, 81, POINTS, 0, HEAD[:5]), (MISSING, 1, 2)),
    ((0, 3, POINTS, 0, bytes((NUMBER + 1,)) + HEAD[1:]), (POINTS, Status.BAD_RANGE)),
    ((0, 3, POINTS, 0, HEAD[:1] + b"\2" + HEAD[2:]), (POINTS, Status.BAD_RANGE)),
    ((0, 3, POINTS, 0, HEAD[:4] + b"\0" + HEAD[5:]), (POINTS, Status.BAD_LENGTH)),
    ((2, 3, POINTS, 0, HEAD), (MISSING, 0)),
    ((1, 3, Command.STATS, 0, HEAD), (MISSING, 0)),
]


@pytest.mark.parametrize(("chunk", "said"), FIRST)
def test_each_fault_of_a_first_chunk_has_its_answer(
    rider: Rider, host: MessageHost, chunk: tuple[int, int, int, int, bytes], said: tuple[int, ...]
) -> None:
    rider.begin(1)
    index, count, cmd, ext, data = chunk
    host.chunk(host.new_id(), index, count, cmd, data, cmd_ext=ext)
    assert answers(host) == [said]


def test_a_fragment_without_its_head(rider: Rider) -> None:
    assert rider.ask(Command.FRAGMENT, bytes(7)).status == Status.BAD_LENGTH
    assert rider.ask(MISSING, bytes(3)).status == Status.BAD_LENGTH
    assert rider.ask(MISSING, bytes(5)).status == Status.BAD_LENGTH
    assert rider.ask(MISSING, b"\0\0\2\0\0\0").status == Status.BAD_LENGTH


@pytest.mark.parametrize("wrong", [199, 100, 0])
def test_all_chunks_but_the_last_are_equally_long(rider: Rider, host: MessageHost, wrong: int) -> None:
    rider.begin(1)
    body = request(still(100))
    message = host.new_id()
    host.chunk(message, 0, 3, POINTS, body[:200])
    assert answers(host) == [(MISSING, 1, 2)]
    host.chunk(message, 1, 3, POINTS, body[200 : 200 + wrong])
    assert answers(host) == [(POINTS, Status.BAD_LENGTH)]
    # The message is over: its chunks are those of a new one.
    host.chunk(message, 1, 3, POINTS, body[200:400])
    assert answers(host) == [(MISSING, 0)]
    host.chunk(message, 0, 3, POINTS, body[:200])
    host.chunk(message, 1, 3, POINTS, body[200:400])
    host.chunk(message, 2, 3, POINTS, body[400:] + b"\0")
    assert answers(host, 0.1) == [(MISSING, 1, 2), (POINTS, Status.BAD_LENGTH)]
    assert rider.status().next == 0


def test_chunks_that_were_not_asked_for_are_dropped(rider: Rider, host: MessageHost) -> None:
    rider.begin(1)
    body = request(still(100))
    message = host.new_id()
    host.chunk(message, 0, 3, POINTS, body[:200])
    assert answers(host) == [(MISSING, 1, 2)]
    for _ in range(3):
        host.chunk(message, 2, 3, POINTS, body[400:])
        host.chunk(message, 0, 3, POINTS, body[:200])
    # Not one question for each; the board asks again in time.
    assert len(answers(host, 0.14)) <= 2
    host.chunk(message, 1, 3, POINTS, body[200:400])
    host.chunk(message, 2, 3, POINTS, body[400:])
    assert answers(host, 0.05)[-2:] == [(MISSING,), (POINTS, Status.OK)]


def test_the_board_asks_again_every_tenth_of_a_second_for_two_seconds(rider: Rider, host: MessageHost) -> None:
    rider.begin(1)
    body = request(still(100))
    message = host.new_id()
    host.chunk(message, 0, 3, POINTS, body[:200])
    heard = answers(host, 3.0)
    assert set(heard) == {(MISSING, 1, 2)}
    assert 20 <= len(heard) <= 21  # the first at once
    host.chunk(message, 1, 3, POINTS, body[200:400])
    assert answers(host) == [(MISSING, 0)]
    assert rider.status().next == 0


def test_a_message_that_is_finished_is_confirmed_again(rider: Rider, host: MessageHost) -> None:
    rider.begin(1)
    body = request(still(60))
    message = host.new_id()
    host.chunk(message, 0, 2, POINTS, body[:200])
    host.chunk(message, 1, 2, POINTS, body[200:])
    assert answers(host, 0.06) == [(MISSING, 1), (MISSING,), (POINTS, Status.OK)]
    host.chunk(message, 1, 2, POINTS, body[200:])
    assert answers(host) == [(MISSING,)]
    host.chunk(message, 0, 2, POINTS, body[:200])
    assert answers(host) == [(MISSING,), (POINTS, Status.OK)]
    assert rider.status().next == 60
    # After four other replies only that it is finished is known, and after two seconds nothing.
    for _ in range(4):
        rider.status()
    host.chunk(message, 0, 2, POINTS, body[:200])
    assert answers(host) == [(MISSING,)]
    rider.run(2.0)
    host.chunk(message, 0, 2, POINTS, body[:200])
    assert answers(host) == [(POINTS, Status.BAD_RANGE)]


def test_one_message_at_a_time(rider: Rider, host: MessageHost) -> None:
    rider.begin(1)
    body = request(still(100))
    message = host.new_id()
    host.chunk(message, 0, 3, POINTS, body[:200])
    assert answers(host) == [(MISSING, 1, 2)]
    # Another host must wait, in whatever way it comes.
    other = MessageHost(rider.client, src=3)
    for index in (0, 1):
        other.chunk(7, index, 3, POINTS, body[:200])
        assert answers(other) == [(POINTS, Status.BUSY)]
    # So must points in one frame, but only if nothing else is wrong with them.
    assert rider.ask(POINTS, request(still(2))).status == Status.BUSY
    assert rider.ask(POINTS, request(still(2), first=1)).status == Status.BAD_RANGE
    assert rider.ask(POINTS, request([PathPoint(0, (5000,))])).status == Status.BAD_RANGE
    # The same host may begin another one instead.
    host.chunk(message + 1, 0, 3, POINTS, body[:200])
    assert answers(host)[-1] == (MISSING, 1, 2)
    host.chunk(message, 1, 3, POINTS, body[200:400])
    assert (MISSING, 0) in answers(host)
    host.chunk(message + 1, 1, 3, POINTS, body[200:400])
    host.chunk(message + 1, 2, 3, POINTS, body[400:])
    assert answers(host, 0.06)[-2:] == [(MISSING,), (POINTS, Status.OK)]
    assert other.send(POINTS, request(still(99)[1:], first=100)).status == Status.OK


def _begin_again(rider: Rider) -> None:
    assert rider.begin(1) == Status.OK


def _identify(rider: Rider) -> None:
    rider.ask(Command.IDENTIFY)


def _reset(rider: Rider) -> None:
    rider.machine.reset()
    rider.machine.settle()


@pytest.mark.parametrize("event", [_begin_again, _identify, _reset])
def test_what_ends_a_message_without_an_answer(
    rider: Rider, host: MessageHost, event: Callable[[Rider], None]
) -> None:
    rider.begin(1)
    body = request(still(100))
    message = host.new_id()
    host.chunk(message, 0, 3, POINTS, body[:200])
    assert answers(host) == [(MISSING, 1, 2)]
    event(rider)
    assert answers(host, 0.3) == []
    host.chunk(message, 1, 3, POINTS, body[200:400])
    assert answers(host) == [(MISSING, 0)]
    if event is not _reset:
        assert rider.ask(POINTS, request(still(2))).status == Status.OK


def test_identify_forgets_what_was_finished_too(rider: Rider, host: MessageHost) -> None:
    rider.begin(1)
    body = request(still(60))
    for _ in range(2):
        host.chunk(0x105, 0, 2, POINTS, body[:200])
        host.chunk(0x105, 1, 2, POINTS, body[200:])
        assert answers(host, 0.06) == [(MISSING, 1), (MISSING,), (POINTS, Status.OK)]
        rider.ask(Command.IDENTIFY)
        rider.begin(1)


@pytest.mark.parametrize("resume", [False, True])
def test_a_stop_voids_a_message(rider: Rider, host: MessageHost, resume: bool) -> None:
    rider.begin(1)
    body = request(still(100))
    message = host.new_id()
    host.chunk(message, 0, 3, POINTS, body[:200])
    assert answers(host) == [(MISSING, 1, 2)]
    rider.machine.send(rider.client.frame(Command.STOP, b"\0", seq=200))
    heard = answers(host, 0.3)
    assert heard.count((POINTS, Status.STOPPED)) == 1
    if resume:
        assert rider.ask(Command.RESUME).status == Status.OK
        rider.begin(1)
    for index in (1, 0, 2):
        host.chunk(message, index, 3, POINTS, body[200 * index : 200 * index + 200])
        assert answers(host) == [(POINTS, Status.STOPPED)]
    assert rider.status().next == 0
    if resume:
        rider.run(2.1)
        host.chunk(message, 0, 3, POINTS, body[:200])
        assert answers(host) == [(MISSING, 1, 2)]


def test_a_stop_voids_a_chunk_that_waits(rider: Rider, host: MessageHost) -> None:
    rider.begin(1)
    body = request(still(60))
    message = host.new_id()
    # The state of the joints after a pause takes a while, so that the chunk waits behind it.
    rider.run(2.5)
    rider.machine.send(rider.client.frame(Command.TORQUE, b"\1\x7f\0", seq=100))
    host.chunk(message, 0, 2, POINTS, body[:200])
    rider.machine.send(rider.client.frame(Command.STOP, b"\0", seq=101))
    heard = answers(host, 0.4)
    assert (Command.STOP, Status.OK) in heard
    host.chunk(message, 0, 2, POINTS, body[:200])
    assert answers(host)[-1] == (POINTS, Status.STOPPED)


def test_a_full_queue_is_busy(rider: Rider, host: MessageHost) -> None:
    rider.begin(1)
    rider.run(2.5)
    message = host.new_id()
    found: list[Frame] = []
    body = request(still(255))
    for index in range(6):
        rider.machine.send(rider.client.frame(Command.TORQUE, b"\1\x7f\0", seq=100 + index))
        host.chunk(message + index, 0, 3, POINTS, body[:200])
    found += rider.client.run(1.0)
    assert (Command.FRAGMENT, Status.BUSY) in [(f.cmd, f.status) for f in found if f.is_reply] or len(found) >= 12


def test_a_fragment_for_several_is_refused(rider: Rider, host: MessageHost) -> None:
    rider.begin(1)
    host.chunk(host.new_id(), 0, 3, POINTS, request(still(100))[:200], dst=-1)
    assert answers(host) == [(Command.FRAGMENT, Status.NOT_SUPPORTED)]


@pytest.mark.parametrize("machine", [CoreBoard, ChipBoard])
def test_frames_of_fragments_are_built_as_all_others(machine: Callable[[], Machine]) -> None:
    board = machine()
    try:
        board.settle()
        client = Client(board)
        client.ask(Command.TRAJECTORY_BEGIN, bytes((NUMBER, 0)) + b"\1\0" + b"\xc8\0")
        body = request(still(60), last=True)
        reply = MessageHost(client).send(POINTS, body, 64)
        assert (reply.status, PathStatus.parse(reply.body).next) == (Status.OK, 60)
        assert client.run(0.05) == []
    finally:
        board.close()


def test_any_chunks_leave_the_board_whole(rider: Rider) -> None:
    dice = random.Random(5)
    body = request(still(100))
    for n in range(400):
        if n % 50 == 0:
            rider.begin(1)
        data = dice.choice((body[:200], body[200:400], body[400:], dice.randbytes(dice.randrange(201))))
        head = bytes((dice.randrange(3), 1, dice.randrange(4), 0, dice.choice((3, 3, 3, 0, 255)), 0))
        cmd = dice.choice((POINTS, POINTS, Command.SERVO_TABLE, dice.randrange(256)))
        frame = frame_bytes(
            Command.FRAGMENT, head + bytes((cmd, 0)) + data, seq=n & 0xFF, sn=n, src=dice.choice((7, 7, 3))
        )
        rider.machine.send(frame)
        rider.run(0.025)
    assert rider.ask(Command.IDENTIFY).status == Status.OK
    rider.begin(1)
    assert MessageHost(rider.client).send(POINTS, body, 100).status == Status.OK
