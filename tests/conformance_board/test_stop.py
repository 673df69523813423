"""What a stop voids and what it confirms (PROTOCOL.md sections 6.3 and 6.5), asked of every board."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
from tests.conformance_board.adapter import EVERY_BOARD, BoardUnderTest

from hexwire.emulator.servo import EmulatedServo
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame, Status
from hexwire.wire.commands import JointReport
from hexwire.wire.servo_packet import ServoPacket, make_ping

# The first one builds.

START = (2053, 2043, 2035, 2039, 2083, 2046, 2047)
ALL = 0x7F
ABSENT = 9
STOPPED, TRIPPED = tables.BOARD_FLAGS_STOPPED, tables.BOARD_FLAGS_WATCHDOG_TRIPPED

Make = Callable[..., BoardUnderTest]


@pytest.fixture(params=EVERY_BOARD)
def make(request: pytest.FixtureRequest) -> Iterator[Make]:
    made: list[BoardUnderTest] = []

    def build(*faults: str) -> BoardUnderTest:
        made.append(BoardUnderTest(request.param, faults))
        return made[-1]

    yield build
    for board in made:
        board.close()


def move(position: int, ms: int = 600, ids: range = range(7)) -> bytes:
    rows = b"".join(bytes((i,)) + position.to_bytes(2, "little", signed=True) for i in ids)
    return ms.to_bytes(2, "little") + bytes((len(ids),)) + rows


def slow(ms: int = 250) -> bytes:
    """A TRANSACT that nobody answers."""
    return bytes((8, ms)) + make_ping(ABSENT)


def torque(board: BoardUnderTest) -> None:
    assert board.client.ask(Command.TORQUE, b"\1\x7f\0", within=1.0).status == Status.OK


def stop(board: BoardUnderTest, mode: int = 0) -> Frame:
    return board.client.ask(Command.STOP, bytes((mode,)), within=1.0)


def burst(board: BoardUnderTest, *requests: tuple[int, bytes]) -> list[int]:
    """Send frames back to back; their sequence numbers."""
    seqs = []
    data = b""
    for cmd, body in requests:
        data += board.client.frame(cmd, body)
        seqs.append(board.client.seq)
    board.machine.send(data)
    return seqs


def statuses(frames: list[Frame], seqs: list[int]) -> list[int | None]:
    replies = [(f.seq, f.status) for f in frames if f.is_reply]
    found = dict(replies)
    assert len(found) == len(replies), "answered once"
    return [found.get(seq) for seq in seqs]


def flags(board: BoardUnderTest) -> int:
    return JointReport.parse(board.client.ask(Command.JOINT_STATE, b"\0").body).board_flags


def shafts(board: BoardUnderTest) -> list[float]:
    board.machine.wire.step(board.machine.now)
    return [board.machine.wire[i].motion.position for i in range(7)]


def spin(servo: EmulatedServo) -> None:
    """Put an HLS servo into speed mode, turning, behind the board's back."""
    servo.registers.put_stored("mode", 1)
    servo.registers.put("goal_speed", 20)
    servo.registers.put("torque_enable", 1)
    servo._watch()


@pytest.mark.parametrize("mode", [0, 1])
def test_nothing_sent_before_a_stop_is_executed_after_it(make: Make, mode: int) -> None:
    board = make()
    torque(board)
    stop(board)
    before = shafts(board)
    requests = [(Command.TRANSACT, slow()), (Command.RESUME, b""), (Command.TORQUE, b"\1\x7f\0")]
    requests += [(Command.JOINT_MOVE, move(2400)), (Command.IO, b"\1\1"), (Command.STOP, bytes((mode,)))]
    seqs = burst(board, *requests)
    frames = board.client.run(1.5)
    assert statuses(frames, seqs) == [Status.STOPPED] * 5 + [Status.OK]
    assert flags(board) & STOPPED
    assert shafts(board) == pytest.approx(before, abs=30)
    assert board.machine.wire[0].torque_on == (mode == 0)


def test_a_stop_does_not_wait_for_the_time_out_of_what_is_under_way(make: Make) -> None:
    board = make()
    torque(board)
    board.machine.send(board.client.frame(Command.JOINT_MOVE, move(3500, 3000)))
    board.client.run(0.3)
    board.machine.send(board.client.frame(Command.TRANSACT, slow(255)))
    board.client.run(0.03)
    board.machine.send(board.client.frame(Command.STOP, b"\1"))
    board.client.run(0.08)
    assert not any(board.machine.wire[i].torque_on for i in range(7))


def test_queued_requests_are_void_when_the_watchdog_trips(make: Make) -> None:
    board = make()
    torque(board)
    stop(board)
    assert board.client.ask(Command.RESUME).status == Status.OK
    board.client.ask(Command.WATCHDOG, b"\x64\0\0")
    before = shafts(board)
    seqs = burst(
        board,
        (Command.TRANSACT, slow()),
        (Command.TRANSACT, slow()),
        (Command.RESUME, b""),
        (Command.JOINT_MOVE, move(2400)),
    )
    frames = board.client.run(1.5)
    assert statuses(frames, seqs) == [Status.STOPPED] * 4
    assert flags(board) & (STOPPED | TRIPPED) == STOPPED | TRIPPED
    assert shafts(board) == pytest.approx(before, abs=30)


def test_a_repeat_of_a_voided_request_is_answered_stopped_and_not_executed(make: Make) -> None:
    board = make()
    torque(board)
    moves = [board.client.frame(Command.JOINT_MOVE, move(2300 + i)) for i in range(10)]
    first = board.client.seq - 9
    board.machine.send(board.client.frame(Command.TRANSACT, slow()))
    board.machine.send(b"".join(moves))
    board.machine.send(board.client.frame(Command.STOP, b"\0"))
    board.client.run(0.9)
    board.client.ask(Command.RESUME)
    before = shafts(board)
    for data in moves:
        board.machine.send(data)
    frames = board.client.run(0.5)
    assert statuses(frames, [first + i for i in range(10)]) == [Status.STOPPED] * 10
    assert shafts(board) == pytest.approx(before, abs=5)
    # What is asked anew is done.
    assert board.client.ask(Command.JOINT_MOVE, move(2300)).status == Status.OK


LASTING = pytest.mark.parametrize(
    ("command", "body"), [(Command.RESUME, b""), (Command.TORQUE, b"\1\x7f\0"), (Command.MAINTENANCE, b"\0")]
)


def is_void_after_a_stop(board: BoardUnderTest, frame: bytes, seq: int) -> None:
    stop(board)
    # More than the board keeps answers of.
    for _ in range(6):
        board.client.ask(Command.STATS)
    before = flags(board)
    board.machine.send(frame)
    assert statuses(board.client.run(0.3), [seq]) == [Status.STOPPED]
    assert flags(board) == before
    assert before & STOPPED


@LASTING
def test_requests_executed_before_a_stop_are_not_executed_again(make: Make, command: int, body: bytes) -> None:
    board = make()
    torque(board)
    done = board.client.frame(command, body)
    seq = board.client.seq
    board.machine.send(done)
    assert statuses(board.client.run(0.3), [seq]) == [Status.OK]
    is_void_after_a_stop(board, done, seq)


@LASTING
def test_requests_refused_as_busy_before_a_stop_are_not_executed_after_it(
    make: Make, command: int, body: bytes
) -> None:
    board = make()
    torque(board)
    refused = board.client.frame(command, body)
    seq = board.client.seq
    burst(board, *[(Command.TRANSACT, slow())] * 26)
    board.machine.send(refused)
    assert statuses(board.client.run(0.2), [seq]) == [Status.BUSY]
    is_void_after_a_stop(board, refused, seq)


def test_five_stops_in_a_row_find_room_when_everything_is_full(make: Make) -> None:
    board = make()
    torque(board)
    burst(board, *[(Command.TRANSACT, slow())] * 30)
    board.client.run(0.05)
    seqs = burst(board, *[(Command.STOP, b"\0")] * 5)
    frames = board.client.run(2.0)
    assert statuses(frames, seqs) == [Status.OK] * 5


def test_a_flood_of_stops_neither_starves_nor_restarts_the_hold(make: Make) -> None:
    board = make()
    torque(board)
    board.machine.send(board.client.frame(Command.JOINT_MOVE, move(3500, 3000)))
    board.client.run(0.5)
    seqs: list[int] = []
    frames: list[Frame] = []
    for _ in range(150):
        seqs += burst(board, (Command.STOP, b"\0"))
        frames += board.client.run(0.006)
    at = shafts(board)
    frames += board.client.run(1.5)
    answered = [s for s in statuses(frames, seqs) if s is not None]
    # Only so many wait together; the others are told so.
    assert set(answered) <= {Status.OK, Status.BUSY}
    assert answered.count(Status.OK) >= 16
    assert shafts(board) == pytest.approx(at, abs=4)
    assert all(board.machine.wire[i].torque_on for i in range(7))


def test_a_stop_that_takes_the_torque_goes_before_one_that_holds(make: Make) -> None:
    board = make()
    torque(board)
    board.machine.send(board.client.frame(Command.JOINT_MOVE, move(3500, 3000)))
    board.client.run(0.5)
    seqs = burst(board, (Command.STOP, b"\0"), (Command.STOP, b"\1"))
    frames = board.client.run(1.5)
    assert statuses(frames, seqs) == [Status.OK, Status.OK]
    assert [f.seq for f in frames if f.seq in seqs] == [seqs[1], seqs[0]]
    assert not any(board.machine.wire[i].torque_on for i in range(7))


def test_requests_after_a_stop_wait_for_it(make: Make) -> None:
    board = make()
    torque(board)
    seqs = burst(board, (Command.STOP, b"\0"), (Command.RESUME, b""), (Command.JOINT_MOVE, move(2200)))
    frames = board.client.run(2.0)
    assert statuses(frames, seqs) == [Status.OK] * 3
    assert [f.seq for f in frames if f.seq in seqs] == seqs
    assert shafts(board) == pytest.approx([2200] * 7, abs=4)


@pytest.mark.parametrize("body", [b"", b"\2", b"\0\0"])
def test_a_stop_that_is_none_voids_nothing(make: Make, body: bytes) -> None:
    board = make()
    torque(board)
    seqs = burst(board, (Command.TRANSACT, slow(60)), (Command.JOINT_MOVE, move(2200)), (Command.STOP, body))
    frames = board.client.run(1.5)
    bad = Status.BAD_RANGE if body == b"\2" else Status.BAD_LENGTH
    assert statuses(frames, seqs) == [Status.SERVO_SILENT, Status.OK, bad]


def test_a_turning_servo_does_not_count_as_holding(make: Make) -> None:
    board = make()
    torque(board)
    spin(board.machine.wire[5])
    board.client.run(0.2)
    reply = stop(board)
    assert (reply.status, reply.body) == (Status.SERVO_FAULT, b"\0\x7f\0")
    at = shafts(board)
    assert [board.machine.wire[i].torque_on for i in range(7)] == [i != 5 for i in range(7)]
    board.client.run(2.0)
    assert shafts(board) == pytest.approx(at, abs=30)
    assert flags(board) & STOPPED


@pytest.mark.parametrize("servo_id", [1, 5])
def test_a_servo_that_does_not_take_the_target_loses_its_torque(make: Make, servo_id: int) -> None:
    board = make()
    torque(board)
    board.client.ask(Command.JOINT_MOVE, move(3500, 8000))
    board.client.run(0.3)
    servo = board.machine.wire[servo_id]
    receive = servo.receive

    def deaf_to_targets(packet: ServoPacket, now: float) -> bytes | None:
        return None if packet.instruction == 0x83 and packet.params[0] in (0x29, 0x2A) else receive(packet, now)

    servo.receive = deaf_to_targets  # type: ignore[method-assign]  # a servo with a fault of its own
    reply = stop(board)
    assert (reply.status, reply.body) == (Status.SERVO_FAULT, b"\0\x7f\0")
    assert [board.machine.wire[i].torque_on for i in range(7)] == [i != servo_id for i in range(7)]
    at = shafts(board)
    board.client.run(1.0)
    assert shafts(board) == pytest.approx(at, abs=60)


@pytest.mark.parametrize("servo_id", [2, 6])
def test_a_servo_that_keeps_moving_loses_its_torque(make: Make, servo_id: int) -> None:
    board = make()
    torque(board)
    servo = board.machine.wire[servo_id]
    refresh = servo.refresh
    looks = 0

    def drift() -> None:
        nonlocal looks
        refresh()
        looks += 1
        servo.registers.put("present_position", 1000 + 10 * looks)

    servo.refresh = drift  # type: ignore[method-assign]  # as if something turned it
    begin = board.machine.now
    reply = stop(board)
    assert (reply.status, reply.body) == (Status.SERVO_FAULT, b"\0\x7f\0")
    assert 0.4 < board.machine.now - begin < 0.8
    assert [board.machine.wire[i].torque_on for i in range(7)] == [i != servo_id for i in range(7)]


def test_a_servo_that_turns_at_start_loses_its_torque(make: Make) -> None:
    board = make()
    torque(board)
    spin(board.machine.wire[5])
    board.machine.reset()
    board.client.run(1.0)
    assert [board.machine.wire[i].torque_on for i in range(7)] == [i != 5 for i in range(7)]
    # And does not get it back.
    reply = board.client.ask(Command.TORQUE, b"\1\x7f\0", within=1.0)
    assert (reply.status, reply.body) == (Status.SERVO_FAULT, b"\1\x5f\0")
    assert not board.machine.wire[5].torque_on


def test_a_stop_says_what_stands_after_a_fast_move(make: Make) -> None:
    board = make()
    torque(board)
    board.client.ask(Command.JOINT_MOVE, move(3800, 0))
    board.client.run(0.2)
    reply = stop(board)
    at = shafts(board)
    assert (reply.status, reply.body) == (Status.OK, b"\0\x7f\0")
    board.client.run(1.0)
    # An HLS servo creeps back to where it was told to hold, from where its brakes let it come to rest.
    assert shafts(board) == pytest.approx(at, abs=120)


def test_a_trip_is_known_until_resume(make: Make) -> None:
    board = make()
    torque(board)
    board.client.ask(Command.WATCHDOG, b"\x64\0\0")
    board.client.run(1.0)
    assert flags(board) & TRIPPED
    board.client.ask(Command.WATCHDOG, b"\0\0\0")
    assert flags(board) & (TRIPPED | STOPPED) == TRIPPED | STOPPED
    board.client.ask(Command.RESUME)
    assert flags(board) & (TRIPPED | STOPPED) == 0
