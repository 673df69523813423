"""SERVO_TABLE of the firmware's core (PROTOCOL.md section 6.10): the registers of a servo as one request."""

from __future__ import annotations

import random
from collections.abc import Iterator

import pytest
from tests.avr.client import Client
from tests.avr.machines import CoreBoard
from tests.avr.messages import MessageHost
from tests.conformance_board.test_trajectory import Rider, line
from tests.frames import frame_bytes

from hexwire.wire.board_trajectory import PathState
from hexwire.wire.command_frame import Command, Status
from hexwire.wire.commands import FragmentHead, serialize_missing

# The first one builds.

TABLE = Command.SERVO_TABLE
READ, WRITE = 0x02, 0x03
MIN_LIMIT, GAIN, TORQUE, TARGET, LOCK = 9, 21, 40, 42, 55


class Host:
    """A host of a board, with its servos."""

    def __init__(self) -> None:
        self.board = CoreBoard()
        self.board.settle()
        self.client = Client(self.board)
        self.messages = MessageHost(self.client)

    def read(self, servo: int, first: int, count: int) -> tuple[int, bytes]:
        """The status and the registers."""
        head = bytes((servo, first)) + count.to_bytes(2, "little")
        frame, body = self.messages.ask(TABLE, head)
        if frame.cmd == TABLE and frame.status != Status.OK:
            return frame.status, body
        assert body[:4] == head
        return Status.OK, body[4:]

    def write(self, servo: int, first: int, data: bytes, *, size: int = 0) -> int:
        body = bytes((servo, first)) + len(data).to_bytes(2, "little") + data
        reply = self.messages.send(TABLE, body, size) if size else self.client.ask(TABLE, body, within=4.0)
        assert reply.body == (body[:4] if reply.status == Status.OK else b"")
        return reply.status

    def maintain(self) -> None:
        assert self.client.ask(Command.MAINTENANCE, b"\1").status == Status.OK

    def table(self, servo: int) -> bytes:
        """The servo's registers, from behind the board's back."""
        return bytes(self.board.wire[servo].registers.read(0, 256))

    def packets(self, instruction: int) -> list[bytes]:
        """Packets of that kind that the board has sent to one servo."""
        return [p for _, p in self.board.line.sent if p[4] == instruction]


@pytest.fixture
def host() -> Iterator[Host]:
    made = Host()
    yield made
    made.board.close()


@pytest.mark.parametrize("servo", [0, 3, 4, 6])
def test_registers_are_read_as_they_are(host: Host, servo: int) -> None:
    ends = ((0, 1), (9, 2), (0, 128), (0, 129), (0, 256), (100, 156), (63, 130), (255, 1), (1, 255))
    for first, count in ends:
        status, data = host.read(servo, first, count)
        assert (status, len(data)) == (Status.OK, count), (first, count)
        there = host.table(servo)[first : first + count]
        # What a servo measures changes meanwhile.
        settings = [i for i in range(count) if first + i < TORQUE or first + i > 80]
        assert [data[i] for i in settings] == [there[i] for i in settings], (first, count)
        # A long one was asked for again meanwhile; what answers that is none of the next one's.
        host.client.run(1.5)


def test_few_reads_for_many_registers(host: Host) -> None:
    for servo, count, each in ((4, 256, 64), (4, 128, 64), (4, 70, 64), (0, 130, 2), (0, 7, 2)):
        host.board.line.sent.clear()
        assert host.read(servo, 0, count)[0] == Status.OK
        # The board's own polling asks for other registers, or for more or fewer of them.
        found = {(p[5], p[6]) for p in host.packets(READ) if p[2] == servo}
        assert {(at, min(each, count - at)) for at in range(0, count, each)} <= found


@pytest.mark.parametrize(
    ("body", "status"),
    [
        (b"\4\0\1", Status.BAD_LENGTH),
        (b"\7\0\1\0", Status.BAD_RANGE),
        (b"\xfe\0\1\0", Status.BAD_RANGE),
        (b"\4\0\0\0", Status.BAD_RANGE),
        (b"\4\1\0\1", Status.BAD_RANGE),
        (b"\4\xff\2\0", Status.BAD_RANGE),
        (b"\4\0\xff\xff", Status.BAD_RANGE),
        (b"\4\x09\2\0\0\0", Status.FORBIDDEN),
    ],
)
def test_what_is_no_table_is_refused(host: Host, body: bytes, status: Status) -> None:
    assert host.client.ask(TABLE, body).status == status


@pytest.mark.parametrize("count", [4, 256])
def test_a_silent_servo(host: Host, count: int) -> None:
    host.board.wire[4].power_cycle(host.board.now, 10.0)
    assert host.read(4, 0, count)[0] == Status.SERVO_SILENT
    assert host.read(5, 0, count)[0] == Status.OK


def test_a_servo_that_falls_silent_between_two_chunks(host: Host) -> None:
    host.board.send(host.client.frame(TABLE, b"\0\0\0\1", seq=5))
    host.client.run(0.15)
    host.board.wire[0].power_cycle(host.board.now, 10.0)
    replies = [f for f in host.client.run(0.3) if f.is_reply]
    assert [(f.cmd, f.seq, f.status) for f in replies] == [(TABLE, 5, Status.SERVO_SILENT)]
    # The message is gone with it.
    host.messages.missing(0x105, 0)
    assert host.client.run(0.2) == []


def test_reading_is_possible_while_stopped(host: Host) -> None:
    host.client.ask(Command.STOP, b"\0")
    assert host.read(4, 0, 256)[0] == Status.OK


def test_a_chunk_that_the_host_misses_is_made_again(host: Host) -> None:
    host.board.send(host.client.frame(TABLE, b"\4\0\0\1", seq=5))
    chunks = [f for f in host.client.run(0.2) if f.cmd == Command.FRAGMENT]
    heads = [FragmentHead.parse(f.body) for f in chunks]
    assert [(h.number, h.chunks, h.message_id & 0xFF) for h in heads] == [(0, 2, 5), (1, 2, 5)]
    assert [len(f.body) - 8 for f in chunks] == [132, 128]
    message = heads[0].message_id
    # It is read again: a register that has changed meanwhile shows its new value.
    host.board.wire[4].registers.put("min_position_limit", 0x77)
    for wanted, came in (((0,), [0]), ((1, 0), [0, 1]), ((1, 1, 9), [1]), ((2, 0xFFFF), [])):
        host.messages.missing(message, *wanted)
        again = [f for f in host.client.run(0.2) if f.cmd == Command.FRAGMENT]
        assert [FragmentHead.parse(f.body).number for f in again] == came
        for each in again:
            number = FragmentHead.parse(each.body).number
            before = chunks[number].body
            if number == 0:
                assert each.body[8 + 4 + MIN_LIMIT : 8 + 4 + MIN_LIMIT + 2] == b"\x77\0"
            assert (each.body[:12], len(each.body)) == (before[:12], len(before))
    # Not of a message that is confirmed, of another host, or of another number.
    host.messages.missing(message + 0x100, 0)
    MessageHost(host.client, src=3).missing(message, 0)
    assert host.client.run(0.2) == []
    host.messages.missing(message)
    host.messages.missing(message, 0)
    assert host.client.run(0.2) == []


def test_a_reply_in_fragments_is_kept_for_two_seconds(host: Host) -> None:
    host.board.send(host.client.frame(TABLE, b"\4\0\0\1", seq=5))
    (first, _) = (FragmentHead.parse(f.body) for f in host.client.run(0.2) if f.cmd == Command.FRAGMENT)
    host.client.run(1.5)
    host.messages.missing(first.message_id, 0)
    assert len(host.client.run(0.2)) == 1
    host.client.run(2.0)
    host.messages.missing(first.message_id, 0)
    assert host.client.run(0.2) == []


@pytest.mark.parametrize("event", [(Command.IDENTIFY, b""), (Command.STOP, b"\0"), (TABLE, b"\5\0\0\1")])
def test_what_ends_a_reply_in_fragments(host: Host, event: tuple[int, bytes]) -> None:
    host.board.send(host.client.frame(TABLE, b"\4\0\0\1", seq=5))
    (first, _) = (FragmentHead.parse(f.body) for f in host.client.run(0.2) if f.cmd == Command.FRAGMENT)
    host.board.send(host.client.frame(*event, seq=6))
    host.client.run(0.4)
    host.messages.missing(first.message_id, 0)
    assert host.client.run(0.2) == []


def test_one_reply_in_fragments_for_one_host(host: Host) -> None:
    host.board.send(host.client.frame(TABLE, b"\4\0\0\1", seq=5))
    assert len(host.client.run(0.2)) == 2
    for body, status in ((b"\4\0\0\1", Status.BUSY), (b"\4\0\x80\0", Status.OK), (b"\4\1\0\1", Status.BAD_RANGE)):
        host.board.send(frame_bytes(TABLE, body, seq=body[2], sn=1, src=3, dst=8))
        (reply,) = host.client.run(0.2)
        assert (reply.dst, reply.status) == (3, status)


def test_a_repeat_of_a_long_read_is_executed_again(host: Host) -> None:
    ids = []
    for _ in range(2):
        host.board.send(host.client.frame(TABLE, b"\4\0\0\1", seq=5))
        ids.append({FragmentHead.parse(f.body).message_id for f in host.client.run(0.2)})
    assert len(ids[0]) == len(ids[1]) == 1
    assert ids[0] != ids[1]
    # A short one is answered from store.
    host.board.line.sent.clear()
    for _ in range(2):
        host.board.send(host.client.frame(TABLE, b"\4\0\x40\0", seq=6))
        (reply,) = host.client.run(0.1)
    assert (reply.status, len(reply.body)) == (Status.OK, 68)
    assert len([p for p in host.packets(READ) if p[2] == 4 and p[6] == 64]) == 1


def test_a_line_that_loses_frames_only_takes_longer(host: Host) -> None:
    for seed in range(6):
        dice = random.Random(seed)
        host.messages.lost = lambda dice=dice: dice.random() < 0.25
        assert host.read(5, 0, 256)[1][: MIN_LIMIT + 4] == host.table(5)[: MIN_LIMIT + 4], f"seed {seed}"


def test_targets_of_a_trajectory_do_not_wait_for_a_table() -> None:
    rider = Rider("core", ())
    try:
        rider.begin(1)
        rider.add(line(200, 4, 0.1, [0]), last=True)
        assert rider.start(0.2) == Status.OK
        for state in (PathState.WAITING, PathState.RUNNING):
            assert rider.state() == state
            assert rider.ask(TABLE, b"\4\0\4\0").status == Status.BUSY
            rider.run(0.25)
        rider.until(PathState.DONE)
        assert rider.ask(TABLE, b"\4\0\4\0").status == Status.OK
    finally:
        rider.board.close()


# -- writing ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [0, 5, 7, 16, 200])
@pytest.mark.parametrize("servo", [1, 5])
def test_registers_are_written(host: Host, servo: int, size: int) -> None:
    host.maintain()
    before = host.table(servo)
    data = bytearray(before[MIN_LIMIT : MIN_LIMIT + 20])
    # Limits of 256 to 3840 counts, and gains.
    data[0:4] = b"\1\0\x0f\0" if servo < 4 else b"\0\1\0\x0f"
    if servo >= 4:
        data[GAIN - MIN_LIMIT] = 44
    assert host.write(servo, MIN_LIMIT, bytes(data), size=size) == Status.OK
    assert host.table(servo)[MIN_LIMIT : MIN_LIMIT + 20] == bytes(data)
    assert host.table(servo)[:MIN_LIMIT] == before[:MIN_LIMIT]


def test_nothing_is_written_that_is_there_already(host: Host) -> None:
    host.maintain()
    host.board.line.sent.clear()
    same = host.table(5)[0:39]
    assert host.write(5, 0, same) == Status.OK
    assert host.packets(WRITE) == []
    other = bytearray(same)
    other[MIN_LIMIT] ^= 1
    assert host.write(5, 0, bytes(other)) == Status.OK
    assert [(p[2], p[5], len(p) - 7) for p in host.packets(WRITE)] == [(5, 0, 32)]


def test_all_of_a_frame_must_pass_the_gate_before_any_of_it_is_written(host: Host) -> None:
    host.maintain()
    before = host.table(5)
    data = bytearray(before[MIN_LIMIT : TORQUE + 1])
    data[0] ^= 1
    data[-1] = 1
    assert host.write(5, MIN_LIMIT, bytes(data)) == Status.FORBIDDEN
    assert host.table(5) == before
    assert host.write(5, TARGET, b"\0\4") == Status.FORBIDDEN
    assert host.write(5, TARGET, b"\0") == Status.BAD_RANGE
    assert host.write(5, TARGET + 2, b"\0") == Status.BAD_RANGE
    assert host.table(5) == before


def test_a_later_chunk_that_is_refused_leaves_what_was_written(host: Host) -> None:
    host.maintain()
    data = bytearray(host.table(5)[MIN_LIMIT : TARGET + 2])
    data[0] ^= 1
    assert host.write(5, MIN_LIMIT, bytes(data), size=20) == Status.FORBIDDEN
    assert host.table(5)[MIN_LIMIT] == data[0]


@pytest.mark.parametrize("size", [0, 8])
def test_a_value_that_the_servo_does_not_take(host: Host, size: int) -> None:
    host.maintain()
    # Firmware and model are read only.
    assert host.write(5, 0, b"\x63\x63\0\0", size=size) == Status.SERVO_FAULT
    host.board.wire[5].power_cycle(host.board.now, 10.0)
    assert host.write(5, 0, b"\x63\x63\0\0", size=size) == Status.SERVO_SILENT
    assert host.write(4, MIN_LIMIT, host.table(4)[MIN_LIMIT : MIN_LIMIT + 4], size=size) == Status.OK


def test_a_servo_that_does_not_confirm_writes(host: Host) -> None:
    host.maintain()
    host.board.wire[5].answers_writes = False
    assert host.write(5, MIN_LIMIT, b"\5\0") == Status.OK
    assert host.table(5)[MIN_LIMIT] == 5


@pytest.mark.parametrize("size", [0, 5])
def test_writing_is_for_maintenance_only(host: Host, size: int) -> None:
    assert host.write(5, MIN_LIMIT, b"\5\0", size=size) == Status.FORBIDDEN
    host.client.ask(Command.STOP, b"\0")
    assert host.write(5, MIN_LIMIT, b"\5\0", size=size) == Status.STOPPED
    host.client.ask(Command.RESUME)
    host.maintain()
    assert host.client.ask(TABLE, b"\5\x09\2\0\5").status == Status.BAD_LENGTH
    assert host.client.ask(TABLE, b"\5\x09\2\0\5\0\0").status == Status.BAD_LENGTH
    host.client.ask(Command.MAINTENANCE, b"\0")
    assert host.write(5, MIN_LIMIT, b"\5\0", size=size) == Status.FORBIDDEN
    assert host.table(5)[MIN_LIMIT] == 0


def test_maintenance_that_ends_ends_a_message(host: Host) -> None:
    host.maintain()
    data = host.table(5)[MIN_LIMIT : MIN_LIMIT + 30]
    host.messages.chunk(0x305, 0, 3, TABLE, b"\5\x09\x1e\0" + data[:10])
    assert [f.cmd for f in host.client.run(0.1)] == [Command.FRAGMENT_MISSING]
    host.client.ask(Command.MAINTENANCE, b"\0")
    host.messages.chunk(0x305, 1, 3, TABLE, data[10:24])
    (reply,) = [f for f in host.client.run(0.06) if f.is_reply]
    assert (reply.cmd, reply.seq, reply.status) == (TABLE, 5, Status.FORBIDDEN)


def test_a_stop_ends_a_write(host: Host) -> None:
    host.maintain()
    host.board.wire[0].answers_writes = False
    before = host.table(0)
    data = bytes(b ^ 1 for b in before[MIN_LIMIT : MIN_LIMIT + 10])
    host.messages.chunk(0x205, 0, 1, TABLE, b"\0\x09\x0a\0" + data)
    host.client.run(0.05)
    host.board.send(host.client.frame(Command.STOP, b"\0", seq=9))
    said = [(f.cmd, f.seq, f.status) for f in host.client.run(0.4) if f.is_reply]
    assert said.count((TABLE, 5, Status.STOPPED)) == 1
    assert (Command.STOP, 9, Status.OK) in said
    assert host.table(0)[MIN_LIMIT : MIN_LIMIT + 10] != data
    host.client.ask(Command.RESUME)
    host.messages.chunk(0x205, 0, 1, TABLE, b"\0\x09\x0a\0" + data)
    (again,) = [f for f in host.client.run(0.1) if f.is_reply]
    assert again.status == Status.STOPPED


def test_a_restarted_host_ends_a_write(host: Host) -> None:
    host.maintain()
    host.board.wire[0].answers_writes = False
    data = bytes(b ^ 1 for b in host.table(0)[MIN_LIMIT : MIN_LIMIT + 10])
    host.messages.chunk(0x205, 0, 1, TABLE, b"\0\x09\x0a\0" + data)
    host.client.run(0.05)
    assert host.client.ask(Command.IDENTIFY, within=1.0).status == Status.OK
    heard = host.client.run(0.5)
    assert [f for f in heard if f.cmd in (TABLE, Command.FRAGMENT_MISSING)] == []
    host.messages.chunk(0x205, 1, 2, TABLE, data[9:])
    (asked,) = host.client.run(0.05)
    assert asked.body == serialize_missing(0x205, (0,))


def test_the_torque_that_a_table_takes_is_known(host: Host) -> None:
    host.maintain()
    # Nothing has torque in maintenance; a servo that got it on its own is told.
    host.board.wire[5].registers.put("torque_enable", 1)
    assert host.write(5, TORQUE, b"\0") == Status.OK
    assert host.table(5)[TORQUE] == 0
    assert host.client.ask(Command.MAINTENANCE, b"\0").status == Status.OK


def test_missing_chunks_of_nothing_are_ignored(host: Host) -> None:
    host.board.send(host.client.frame(Command.FRAGMENT_MISSING, serialize_missing(5, (0,))))
    assert host.client.run(0.1) == []
