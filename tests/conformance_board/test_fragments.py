"""Messages in fragments to and from a board (PROTOCOL.md section 6.10), asked of every board."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
from tests.conformance_board.adapter import EVERY_BOARD, BoardUnderTest
from tests.conformance_board.messages import MessageHost, Sent

from hexwire.wire.board_trajectory import BeginRequest, PathFlag, PathPoint, PathStatus, PointsRequest
from hexwire.wire.command_frame import Command, Status
from hexwire.wire.servo_table import ServoTable

# The first one builds.

START = (2053, 2043, 2035, 2039, 2083, 2046, 2047)
NUMBER = 5
POINTS = Command.TRAJECTORY_POINTS
TABLE = Command.SERVO_TABLE
KP = 50
"""A setting of an HLS servo in RAM; it keeps any value up to 254."""

Make = Callable[..., MessageHost]


@pytest.fixture(params=EVERY_BOARD)
def make(request: pytest.FixtureRequest) -> Iterator[Make]:
    made: list[MessageHost] = []

    def build(*faults: str) -> MessageHost:
        made.append(MessageHost(BoardUnderTest(request.param, faults)))
        return made[-1]

    yield build
    for host in made:
        host.board.close()


def path(count: int, *, way: int = 120, seconds: float = 2.0) -> list[PathPoint]:
    """An even motion of all joints with velocities."""
    ticks = round(seconds * 1e4 / (count - 1))
    speed = round(way / seconds)
    return [
        PathPoint(ticks if n else 0, tuple(p + round(way * n / (count - 1)) for p in START), (speed,) * 7)
        for n in range(count)
    ]


def body_of(points: list[PathPoint], *, first: int = 0, last: bool = True, number: int = NUMBER) -> bytes:
    return PointsRequest.of(number, first, points, last=last).serialize()


def begin(host: MessageHost) -> None:
    assert (
        host.ask(Command.TRAJECTORY_BEGIN, BeginRequest(NUMBER, PathFlag.HERMITE, 0x7F, 200).serialize()).status
        == 0
    )


def status(host: MessageHost) -> PathStatus:
    return PathStatus.parse(host.ask(Command.TRAJECTORY_STATUS).body)


@pytest.mark.parametrize("size", [200, 37])
def test_a_whole_trajectory_is_one_request(make: Make, size: int) -> None:
    host = make()
    assert host.ask(Command.TORQUE, b"\1\x7f\0").status == Status.OK
    begin(host)
    body = body_of(path(40))
    sent = host.send(POINTS, body, size=size)
    assert sent.status == Status.OK
    assert sent.reply is not None
    assert PathStatus.parse(sent.reply.body).next == 40
    count = -(-len(body) // size)
    pairs = [tuple(range(n, min(n + 2, count))) for n in range(1, count, 2)]
    assert sent.asks == [*pairs, ()]
    assert host.ask(Command.TRAJECTORY_START, bytes((NUMBER, 1)) + bytes(4)).status == Status.OK
    host.client.run(2.6)
    assert status(host).state.over
    host.machine.wire.step(host.machine.now)
    shafts = [host.machine.wire[i].motion.position for i in range(7)]
    assert shafts == pytest.approx([place + 120 for place in START], abs=8)


def test_points_count_when_all_have_come(make: Make) -> None:
    host = make()
    begin(host)
    free = status(host).free
    number, body = host.new_id(), body_of(path(20))
    chunks = [body[at : at + 200] for at in range(0, len(body), 200)]
    for index in range(len(chunks) - 1):
        host.put(number, index, len(chunks), POINTS, chunks[index])
        host.client.run(0.03)
        host.client.seq += 50
        assert status(host)[2:5] == (0, 0, free)
        host.client.seq = number & 0xFF
    host.put(number, len(chunks) - 1, len(chunks), POINTS, chunks[-1])
    sent = Sent()
    while host.hear(number, sent, 0.2) is not None:
        pass
    assert sent.status == Status.OK
    host.client.seq += 1
    assert status(host)[2:5] == (20, 0, free - 20)


@pytest.mark.parametrize("lost", [0, 1, 2, 5])
def test_a_lost_chunk_is_asked_for(make: Make, lost: int) -> None:
    host = make()
    begin(host)
    sent = host.send(POINTS, body_of(path(40)), lose=lambda index, time: index == lost and time == 1, wait=0.5)
    assert sent.status == Status.OK
    assert status(host).next == 40


def test_a_chunk_that_comes_twice_is_used_once(make: Make) -> None:
    host = make()
    begin(host)
    number, body = host.new_id(), body_of(path(20))
    chunks = [body[at : at + 200] for at in range(0, len(body), 200)]
    sent = Sent()
    for index in (0, 0, 1, 0, 1, 2, 2, 3):
        host.put(number, index, len(chunks), POINTS, chunks[index])
        host.client.run(0.03)
    while host.hear(number, sent, 0.2) is not None:
        pass
    assert status(host).next == 20


def test_one_that_is_finished_is_confirmed_and_answered_again(make: Make) -> None:
    host = make()
    begin(host)
    number, body = host.new_id(), body_of(path(20))
    first = host.send(POINTS, body, message_id=number)
    assert first.status == Status.OK
    again, count = Sent(), -(-len(body) // 200)
    host.put(number, 0, count, POINTS, body[:200])
    assert host.hear(number, again, 0.2) == ()
    host.hear(number, again, 0.2)
    assert again.reply is not None
    assert first.reply is not None
    assert again.reply.body[:10] == first.reply.body[:10]
    later = Sent()
    host.put(number, 2, count, POINTS, body[400:600])
    assert host.hear(number, later, 0.2) == ()
    assert later.reply is None
    assert status(host).next == 20


@pytest.mark.parametrize(
    ("points", "expected"),
    [
        ({"number": 6}, Status.BAD_RANGE),
        ({"first": 3}, Status.BAD_RANGE),
        ({"first": 0xFFFF}, Status.BAD_RANGE),
    ],
)
def test_a_message_is_refused_by_its_first_chunk(make: Make, points: dict[str, int], expected: int) -> None:
    host = make()
    begin(host)
    sent = host.send(POINTS, body_of(path(20), **points))  # type: ignore[arg-type]  # numbers
    assert (sent.status, sent.asks) == (expected, [])
    assert status(host).next == 0


def test_points_that_do_not_fit_are_refused_before_they_come(make: Make) -> None:
    host = make()
    begin(host)
    free = status(host).free
    sent = host.send(POINTS, body_of(path(free + 1)))
    assert (sent.status, sent.asks) == (Status.BUSY, [])
    assert host.send(POINTS, body_of(path(free))).status == Status.OK
    assert status(host).free == 0


def test_a_bad_point_ends_the_message_and_nothing_of_it_stays(make: Make) -> None:
    host = make()
    begin(host)
    points = path(40)
    points[20] = points[20]._replace(positions=(9999, *points[20].positions[1:]))
    sent = host.send(POINTS, body_of(points))
    assert sent.status == Status.BAD_RANGE
    assert 0 < len(sent.asks) < 4
    assert status(host).next == 0
    assert host.send(POINTS, body_of(path(40))).status == Status.OK


@pytest.mark.parametrize("change", [-1, 1])
def test_a_last_chunk_of_another_length_is_refused(make: Make, change: int) -> None:
    host = make()
    begin(host)
    body = body_of(path(20))
    number, count = host.new_id(), -(-len(body) // 200)
    chunks = [body[at : at + 200] for at in range(0, len(body), 200)]
    chunks[-1] = chunks[-1][:-1] if change < 0 else chunks[-1] + b"\0"
    sent = Sent()
    for index in range(count):
        host.put(number, index, count, POINTS, chunks[index])
        host.hear(number, sent, 0.2)
    assert sent.status == Status.BAD_LENGTH
    assert status(host).next == 0


def test_wrong_counts_and_lengths(make: Make) -> None:
    host = make()
    begin(host)
    body = body_of(path(20))
    for count, chunk in ((3, body[:200]), (5, body[:200]), (4, body[:4]), (4, b""), (0xFFFF, body[:200])):
        number, sent = host.new_id(), Sent()
        host.put(number, 0, count, POINTS, chunk)
        assert host.hear(number, sent, 0.2) is None
        assert sent.status == Status.BAD_LENGTH, (count, len(chunk))
    host.machine.send(host.client.frame(Command.FRAGMENT, b"\1\0\0\0\1\0\x21"))
    assert host.client.reply().status == Status.BAD_LENGTH
    for bad in (b"\1\0\0\0\0\0\x21\0", b"\1\0\2\0\2\0\x21\0", b"\1\0\0\0\2\0\x21\x80"):
        host.machine.send(host.client.frame(Command.FRAGMENT, bad + body[:100]))
        assert host.client.reply().status == Status.BAD_RANGE
    host.machine.send(host.client.frame(Command.FRAGMENT_MISSING, b"\1\0\2\0\1\0"))
    assert host.client.reply().status == Status.BAD_LENGTH
    number, sent = host.new_id(), Sent()
    host.put(number, 0, 2, Command.STATS, b"x" * 10)
    host.hear(number, sent, 0.2)
    assert sent.status == Status.NOT_SUPPORTED
    assert status(host).next == 0


def test_a_chunk_of_an_unknown_message_is_answered_with_a_question_for_its_first(make: Make) -> None:
    host = make()
    begin(host)
    number, sent = host.new_id(), Sent()
    host.put(number, 2, 4, POINTS, bytes(200))
    assert host.hear(number, sent, 0.05) == (0,)


def test_the_board_asks_again_and_forgets_after_two_seconds(make: Make) -> None:
    host = make()
    begin(host)
    number, body, sent = host.new_id(), body_of(path(20)), Sent()
    host.put(number, 0, -(-len(body) // 200), POINTS, body[:200])
    began = host.machine.now
    while host.hear(number, sent, 0.5) is not None:
        pass
    assert set(sent.asks) == {(1, 2)}
    assert 15 <= len(sent.asks) <= 21
    assert host.machine.now - began == pytest.approx(2.5, abs=0.15)
    host.put(number, 1, 4, POINTS, body[200:400])
    assert host.hear(number, sent, 0.1) == (0,)


def test_another_request_for_points_waits_until_the_message_is_there(make: Make) -> None:
    host = make()
    begin(host)
    number, body = host.new_id(), body_of(path(20))
    host.put(number, 0, 4, POINTS, body[:200])
    host.client.run(0.03)
    host.client.seq += 20
    assert host.ask(POINTS, body_of(path(3)[:2])).status == Status.BUSY
    assert host.ask(POINTS, body_of(path(3)[:2], first=2)).status == Status.BAD_RANGE
    assert host.ask(POINTS, body_of(path(3)[:2])[:-1]).status == Status.BAD_LENGTH
    # A new trajectory drops it without a word.
    begin(host)
    assert host.ask(POINTS, body_of(path(3)[:2])).status == Status.OK
    sent = Sent()
    host.put(number, 1, 4, POINTS, body[200:400])
    assert host.hear(number, sent, 0.05) == (0,)


@pytest.mark.parametrize("end", ["stop", "identify", "reset"])
def test_what_ends_a_message_under_way(make: Make, end: str) -> None:
    host = make()
    begin(host)
    number, body, sent = host.new_id(), body_of(path(20)), Sent()
    host.put(number, 0, 4, POINTS, body[:200])
    assert host.hear(number, sent, 0.1) == (1, 2)
    if end == "reset":
        host.machine.reset()
        host.machine.settle(0.5)
        host.client.frames()
    else:
        host.client.seq = (number + 40) & 0xFF
        cmd, order = (Command.STOP, b"\0") if end == "stop" else (Command.IDENTIFY, b"")
        host.machine.send(host.client.frame(cmd, order))
        replies = {f.cmd: f for f in host.client.run(0.7) if f.is_reply}
        assert cmd in replies
        assert (POINTS in replies) == (end == "stop")
        if end == "stop":
            assert (replies[POINTS].status, replies[POINTS].seq) == (Status.STOPPED, number & 0xFF)
    asked = Sent()
    host.put(number, 1, 4, POINTS, body[200:400])
    if end == "stop":
        assert host.hear(number, asked, 0.1) is None
        assert asked.status == Status.STOPPED
    else:
        assert host.hear(number, asked, 0.1) == (0,)


def test_a_stop_voids_chunks_that_wait(make: Make) -> None:
    host = make()
    begin(host)
    number, body = host.new_id(), body_of(path(20))
    for index in range(4):
        host.put(number, index, 4, POINTS, body[index * 200 : index * 200 + 200])
    host.client.seq = (number + 40) & 0xFF
    host.machine.send(host.client.frame(Command.STOP, b"\0"))
    host.client.run(1.0)
    assert host.ask(Command.RESUME).status == Status.OK
    # All of it arrived before the stop; whatever was in time counts as a whole or not at all.
    assert status(host).next in (0, 20)


# -- tables -----------------------------------------------------------------------------------------------------


def maintenance(host: MessageHost) -> None:
    assert host.ask(Command.MAINTENANCE, b"\1").status == Status.OK


def registers(host: MessageHost, servo: int, first: int, count: int) -> bytes:
    """What the servo itself holds."""
    return bytes(host.machine.wire[servo].registers.read(first, count))


@pytest.mark.parametrize("servo", [1, 5])
@pytest.mark.parametrize(("first", "count"), [(5, 1), (0, 55), (5, 128)])
def test_registers_of_one_servo_in_one_frame(make: Make, servo: int, first: int, count: int) -> None:
    host = make()
    reply = host.ask(TABLE, ServoTable(servo, first, count).serialize())
    assert reply.status == Status.OK
    table = ServoTable.parse(reply.body)
    assert (table.servo_id, table.first, table.count, len(table.data)) == (servo, first, count, count)
    still = slice(0, min(40 - first, count))
    assert table.data[still] == registers(host, servo, first, count)[still]


@pytest.mark.parametrize("servo", [1, 5])
def test_the_whole_table_is_one_request(make: Make, servo: int) -> None:
    host = make()
    data = host.read_table(servo, 0, 256)
    assert isinstance(data, bytes)
    assert data[:40] == registers(host, servo, 0, 40)


@pytest.mark.parametrize("lost", [0, 1])
def test_a_lost_chunk_of_a_table_is_read_again(make: Make, lost: int) -> None:
    host = make()
    data = host.read_table(5, 0, 256, lose=lambda index, time: index == lost and time == 1)
    assert isinstance(data, bytes)
    assert data[:40] == registers(host, 5, 0, 40)


def test_a_table_is_checked_before_a_servo_is_asked(make: Make) -> None:
    host = make("silent:2")
    for body in (b"", b"\5\0\1", ServoTable(5, 0, 0).serialize()):
        assert host.ask(TABLE, body).status == (Status.BAD_LENGTH if len(body) < 4 else Status.BAD_RANGE)
    for table in (ServoTable(9, 0, 1), ServoTable(0xFE, 0, 1), ServoTable(5, 1, 256), ServoTable(5, 255, 2)):
        assert host.ask(TABLE, table.serialize()).status == Status.BAD_RANGE
    assert host.ask(TABLE, ServoTable(2, 0, 10).serialize()).status == Status.SERVO_SILENT
    reply = host.read_table(2, 0, 200)
    assert not isinstance(reply, bytes)
    assert reply.status == Status.SERVO_SILENT


def test_a_table_is_written_in_maintenance_only(make: Make) -> None:
    host = make()
    table = ServoTable(5, KP, 2, b"\x11\x22").serialize()
    assert host.ask(TABLE, table).status == Status.FORBIDDEN
    maintenance(host)
    reply = host.ask(TABLE, table)
    assert (reply.status, reply.body) == (Status.OK, ServoTable(5, KP, 2).serialize())
    assert registers(host, 5, KP, 2) == b"\x11\x22"
    assert host.ask(TABLE, table[:-1]).status == Status.BAD_LENGTH
    assert host.ask(TABLE, table + b"\0").status == Status.BAD_LENGTH
    # The gate: no torque, no target.
    assert host.ask(TABLE, ServoTable(5, 40, 1, b"\1").serialize()).status == Status.FORBIDDEN
    assert host.ask(TABLE, ServoTable(5, 42, 2, b"\0\x08").serialize()).status == Status.FORBIDDEN
    assert host.ask(Command.STOP, b"\0").status == Status.OK
    assert host.ask(TABLE, table).status == Status.STOPPED
    assert host.ask(TABLE, ServoTable(5, KP, 2).serialize()).status == Status.OK


def test_only_what_differs_is_written(make: Make) -> None:
    host = make()
    maintenance(host)
    before = registers(host, 5, 9, 4)
    sent = len(host.machine.line.sent)
    assert host.ask(TABLE, ServoTable(5, 9, 4, before).serialize()).status == Status.OK
    packets = [packet for _, packet in host.machine.line.sent[sent:]]
    assert not [p for p in packets if p[2] == 5 and p[4] == 0x03]


def test_a_table_in_fragments_is_written_chunk_by_chunk(make: Make) -> None:
    host = make()
    maintenance(host)
    # Every register from the gains to the mode, as they are but for two gains far apart.
    data = bytearray(registers(host, 5, 6, 34))
    data[21 - 6], data[37 - 6] = 77, 88
    sent = host.send(TABLE, ServoTable(5, 6, 34, bytes(data)).serialize(), size=16)
    assert sent.status == Status.OK
    assert sent.reply is not None
    assert sent.reply.body == ServoTable(5, 6, 34).serialize()
    assert (registers(host, 5, 21, 1), registers(host, 5, 37, 1)) == (b"\x4d", b"\x58")


def test_what_a_later_chunk_refuses_leaves_the_earlier_ones_written(make: Make) -> None:
    host = make()
    maintenance(host)
    data = bytearray(registers(host, 5, 21, 21))
    data[0], data[40 - 21] = 66, 1
    sent = host.send(TABLE, ServoTable(5, 21, 21, bytes(data)).serialize(), size=14)
    assert sent.status == Status.FORBIDDEN
    assert registers(host, 5, 21, 1) == b"\x42"


def test_no_table_is_read_while_a_trajectory_runs(make: Make) -> None:
    host = make()
    assert host.ask(Command.TORQUE, b"\1\x7f\0").status == Status.OK
    begin(host)
    assert host.send(POINTS, body_of(path(20))).status == Status.OK
    assert host.ask(Command.TRAJECTORY_START, bytes((NUMBER, 1)) + bytes(4)).status == Status.OK
    host.client.run(0.2)
    assert host.ask(TABLE, ServoTable(5, 0, 10).serialize()).status == Status.BUSY
    host.ask(Command.TRAJECTORY_ABORT, bytes((NUMBER,)))
    host.client.run(0.6)
    assert host.ask(TABLE, ServoTable(5, 0, 10).serialize()).status == Status.OK
