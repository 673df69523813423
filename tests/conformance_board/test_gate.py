"""What a board lets through to a servo (PROTOCOL.md section 6.4), and maintenance, asked of every board."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.conformance_board.adapter import EVERY_BOARD, BoardUnderTest

from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame, Status
from hexwire.wire.commands import Identity, JointReport, LimitRow, LimitTable
from hexwire.wire.servo_packet import (
    Instruction,
    make_action,
    make_packet,
    make_read,
    make_reg_write,
    make_restore,
    make_sync_write,
    make_write,
)

# The first one builds.

START = (2053, 2043, 2035, 2039, 2083, 2046, 2047)
STOPPED, MAINTENANCE = tables.BOARD_FLAGS_STOPPED, tables.BOARD_FLAGS_MAINTENANCE
TORQUE_ON = tables.SERVO_FLAGS_TORQUE_ON


@pytest.fixture(params=EVERY_BOARD)
def board(request: pytest.FixtureRequest) -> Iterator[BoardUnderTest]:
    made = BoardUnderTest(request.param)
    yield made
    made.close()


def u16(value: int) -> bytes:
    return value.to_bytes(2, "little")


def be(value: int) -> bytes:
    return value.to_bytes(2, "big")


def torque(board: BoardUnderTest, on: int = 1) -> None:
    assert board.client.ask(Command.TORQUE, bytes((on, 0x7F, 0)), within=1.0).status == Status.OK


def maintenance(board: BoardUnderTest, on: int) -> Frame:
    return board.client.ask(Command.MAINTENANCE, bytes((on,)), within=1.0)


def limits(board: BoardUnderTest, minimum: int = 1000, maximum: int = 3000, speed: int = 1000) -> None:
    body = LimitTable.serialize_request((LimitRow(minimum, maximum, speed),) * 7)
    assert board.client.ask(Command.LIMITS, body, within=1.0).status == Status.OK


def ask(board: BoardUnderTest, cmd: int, packet: bytes, length: int = 6) -> int:
    """The status of a packet sent with TRANSACT, READ or SYNC_WRITE."""
    body = bytes((length, 0)) + packet if cmd == Command.TRANSACT else packet
    return board.client.ask(cmd, body, within=1.0).status


def shafts(board: BoardUnderTest) -> list[float]:
    board.machine.wire.step(board.machine.now)
    return [servo.motion.position for servo in board.machine.wire.servos]


def torques(board: BoardUnderTest) -> list[bool]:
    return [board.machine.wire[i].torque_on for i in range(7)]


def state(board: BoardUnderTest) -> JointReport:
    return JointReport.parse(board.client.ask(Command.JOINT_STATE, b"\0").body)


def fastest(board: BoardUnderTest, servo_id: int, seconds: float) -> float:
    """The greatest speed of a shaft in a time, counts/s."""
    most, last = 0.0, shafts(board)[servo_id]
    for _ in range(round(seconds / 0.005)):
        board.client.run(0.005)
        now = shafts(board)[servo_id]
        most, last = max(most, abs(now - last) / 0.005), now
    return most


ROWS = {i: u16(2300) + u16(0) for i in range(7)}
MOVES = [
    (Command.SYNC_WRITE, make_sync_write(0x2A, ROWS)),
    (Command.READ, make_write(0, 0x2A, be(2300) + be(0))),
    (Command.READ, make_write(4, 0x2A, u16(2300))),
    (Command.TRANSACT, make_write(0, 0x2A, be(2300))),
    (Command.TRANSACT, make_write(4, 0x29, b"\0" + u16(2300) + u16(154) + u16(100))),
    (Command.TRANSACT, make_sync_write(0x2A, {4: u16(2300), 5: u16(2300)})),
]


def test_a_target_gives_no_torque_in_dialect_2(board: BoardUnderTest) -> None:
    for cmd, packet in MOVES:
        assert ask(board, cmd, packet) == Status.TORQUE_OFF, (cmd, packet)
        board.client.run(0.5)
        assert not any(torques(board)), (cmd, packet)
        assert shafts(board) == pytest.approx(START, abs=1), (cmd, packet)


@pytest.mark.parametrize("cmd", [Command.TRANSACT, Command.READ])
def test_torque_is_given_by_torque_only_in_dialect_2(board: BoardUnderTest, cmd: int) -> None:
    for packet in (make_write(4, 0x28, b"\1"), make_sync_write(0x28, {0: b"\1", 4: b"\1"})):
        assert ask(board, cmd, packet, 0) == Status.FORBIDDEN
    assert not any(torques(board))
    torque(board)
    assert ask(board, cmd, make_sync_write(0x28, {0: b"\0", 4: b"\0"}), 0) in (Status.OK, Status.SERVO_SILENT)
    # At once.
    assert [bool(s & TORQUE_ON) for s in state(board).status] == [i not in (0, 4) for i in range(7)]
    assert torques(board) == [i not in (0, 4) for i in range(7)]


FAR = [
    (0, Command.SYNC_WRITE, make_sync_write(0x2A, {0: u16(2900) + u16(0)})),
    (0, Command.TRANSACT, make_write(0, 0x2A, be(2900) + be(0))),
    (0, Command.READ, make_write(0, 0x2A, be(2900))),
    (4, Command.TRANSACT, make_write(4, 0x2A, u16(2900))),
    (4, Command.TRANSACT, make_write(4, 0x29, b"\0" + u16(2900) + u16(154) + u16(0))),
    (4, Command.READ, make_write(4, 0x29, b"\0" + u16(2900) + u16(154) + u16(150))),
    (4, Command.TRANSACT, make_sync_write(0x29, {4: b"\0" + u16(2900) + u16(154) + u16(0)})),
]


def test_a_target_keeps_the_speed_limit_by_every_command(board: BoardUnderTest) -> None:
    limits(board)
    torque(board)
    for servo_id, cmd, packet in FAR:
        assert ask(board, cmd, packet, 0) in (Status.OK, Status.SERVO_SILENT), packet
        # A legacy servo makes up for its ramps.
        assert fastest(board, servo_id, 1.5) < 1060, packet
        assert shafts(board)[servo_id] == pytest.approx(2900, abs=4), packet
        back = b"\xd0\7\1" + bytes((servo_id,)) + u16(START[servo_id])
        assert board.client.ask(Command.JOINT_MOVE, back).status == Status.OK
        board.client.run(2.5)


def test_a_joint_that_moves_brakes_as_hard_as_it_can_whatever_ramp_it_is_given(board: BoardUnderTest) -> None:
    limits(board)
    torque(board)
    block = b"\0" + u16(1000) + u16(154) + u16(0)
    assert ask(board, Command.TRANSACT, make_write(4, 0x29, block)) == Status.OK
    while shafts(board)[4] > 1200:
        board.client.run(0.005)
    # 2000 counts/s^2: 250 counts from this speed, and there are 200.
    gentle = b"\x14" + u16(1150) + u16(154) + u16(0)
    assert ask(board, Command.TRANSACT, make_write(4, 0x29, gentle)) == Status.OK
    lowest = min(shafts(board)[4] for _ in range(100) if board.client.run(0.01) is not None)
    assert lowest >= 1000
    assert shafts(board)[4] == pytest.approx(1150, abs=4)
    # One that stands has the ramp it was given.
    assert ask(board, Command.TRANSACT, make_write(4, 0x29, b"\x14" + u16(2000) + u16(154) + u16(0))) == Status.OK
    assert make_write(4, 0x29, b"\x14" + u16(2000) + u16(154) + u16(20)) in board.bus_writes(0x29)


@pytest.mark.parametrize("servo_id", [0, 4])
def test_in_dialect_1_a_target_moves_a_joint_within_the_limits(board: BoardUnderTest, servo_id: int) -> None:
    limits(board)
    order = be if servo_id < 4 else u16
    outside = make_write(servo_id, 0x2A, order(3001))
    assert board.client.ask_chapter(2, outside) == bytes.fromhex(
        f"FFF50{servo_id}04010000F{'A' if not servo_id else '6'}"
    )
    assert not torques(board)[servo_id]
    board.client.ask_chapter(2, make_write(servo_id, 0x2A, order(2900)))
    # Known at once.
    assert state(board).status[servo_id] & TORQUE_ON
    assert fastest(board, servo_id, 1.5) < 1060
    assert shafts(board)[servo_id] == pytest.approx(2900, abs=4)
    assert torques(board) == [i == servo_id for i in range(7)]
    board.client.ask(Command.STOP, b"\0", within=1.0)
    board.client.ask_chapter(2, make_write(servo_id, 0x2A, order(2500)))
    board.client.run(0.5)
    assert shafts(board)[servo_id] == pytest.approx(2900, abs=4)


def test_in_dialect_1_torque_is_given_where_the_joint_stands(board: BoardUnderTest) -> None:
    # A target of long ago, which torque would bring to life.
    for i in (0, 4):
        servo = board.machine.wire[i]
        servo.registers.put("target_position" if i == 0 else "goal_position", 2800)
        board.client.ask_chapter(2, make_write(i, 0x28, b"\1"))
        assert state(board).status[i] & TORQUE_ON
    board.client.run(1.0)
    assert torques(board) == [i in (0, 4) for i in range(7)]
    assert shafts(board) == pytest.approx(START, abs=2)
    assert board.bus_writes(0x2A) or board.bus_writes(0x29)


def test_the_chapters_sync_write_is_clamped_and_leaves_out_who_is_silent(board: BoardUnderTest) -> None:
    limits(board)
    board.machine.wire.servos[3].registers.put("id", 77)
    board.client.run(1.0)
    rows = {i: u16(3900) + u16(0) for i in range(7)}
    board.machine.send(board.client.frame(3, make_sync_write(0x2A, rows), proto=1))
    assert fastest(board, 0, 2.0) < 1060
    # The gripper ends at its mechanical stop.
    jaws = board.machine.wire.servos[6].motion.stops
    assert jaws is not None
    expected = [3000] * 5 + [min(3000.0, jaws[1])]
    assert [s for i, s in enumerate(shafts(board)) if i != 3] == pytest.approx(expected, abs=4)


HOSTILE = [
    make_packet(0xFE, Instruction.SYNC_WRITE, b"\x2a\xff\4\0\0\0"),
    make_packet(0xFE, Instruction.SYNC_WRITE, b"\x2a\0\4\0\0\0"),
    make_packet(0xFE, Instruction.SYNC_WRITE, b"\x2a\xff"),
    make_packet(0xFE, Instruction.SYNC_WRITE, b"\x2a\4"),
    make_packet(0xFE, Instruction.SYNC_WRITE, b""),
    make_packet(4, Instruction.WRITE, b""),
    make_packet(4, Instruction.WRITE, b"\x2a"),
    make_packet(4, Instruction.WRITE, b"\xff" + bytes(5)),
    make_packet(4, Instruction.READ, b"\x38\xff"),
    make_packet(0xFE, Instruction.SYNC_READ, b"\x38\xff\4\5"),
]


def test_hostile_fields_have_their_status(board: BoardUnderTest) -> None:
    for packet in HOSTILE:
        assert ask(board, Command.TRANSACT, packet) == Status.BAD_RANGE, packet
        assert ask(board, Command.READ, packet) == Status.BAD_RANGE, packet
        if packet[4] == Instruction.SYNC_WRITE:
            assert ask(board, Command.SYNC_WRITE, packet) == Status.BAD_RANGE, packet
        for cmd in (1, 2, 3):
            board.client.ask_chapter(cmd, packet)
        assert board.client.ask(Command.IDENTIFY).status == Status.OK, packet
        assert shafts(board) == pytest.approx(START, abs=1), packet


FORBIDDEN = [
    make_reg_write(4, 0x2A, u16(2100)),
    make_action(),
    make_write(4, 0x21, b"\1"),
    make_sync_write(0x21, {4: b"\1", 5: b"\2", 6: b"\3"}),
    make_write(4, 5, b"\x09"),
    make_write(4, 0x37, b"\0"),
    make_write(0, 9, be(0) + be(1)),
    make_write(4, 0x2E, u16(50)),
    make_write(0, 0x2C, be(0)),
    make_write(4, 0x28, b"\x80"),
    make_write(0xFE, 0x30, u16(500)),
    make_write(9, 0x30, u16(500)),
    make_restore(4),
]


def test_settings_and_deferred_writes_are_forbidden(board: BoardUnderTest) -> None:
    torque(board)
    before = [bytes(servo.registers.read(0, 56)) for servo in board.machine.wire.servos]
    for packet in FORBIDDEN:
        for cmd in (Command.TRANSACT, Command.READ):
            assert ask(board, cmd, packet) == Status.FORBIDDEN, (cmd, packet)
        assert packet not in [sent for _, sent in board.machine.line.sent]
        board.client.ask_chapter(2, packet)
        assert packet not in [sent for _, sent in board.machine.line.sent]
        after = [bytes(servo.registers.read(0, 56)) for servo in board.machine.wire.servos]
        assert after == before, packet


def test_maintenance(board: BoardUnderTest) -> None:
    assert Identity.parse(board.client.ask(Command.IDENTIFY).body).capabilities & tables.CAPABILITY_MAINTENANCE
    torque(board)
    assert maintenance(board, 1).status == Status.FORBIDDEN
    assert not state(board).board_flags & MAINTENANCE
    torque(board, 0)
    reply = maintenance(board, 1)
    assert reply.status == Status.OK
    assert reply.body[0] == 1
    assert reply.body[1] & MAINTENANCE
    assert state(board).board_flags & MAINTENANCE
    # Settings may be written, and nothing moves.
    assert ask(board, Command.TRANSACT, make_write(4, 0x21, b"\1")) == Status.OK
    assert board.machine.wire[4].registers.get("mode") == 1
    move = b"\x64\0\1\0" + u16(2100)
    for cmd, body in (
        (Command.JOINT_MOVE, move),
        (Command.TORQUE, b"\1\x7f\0"),
        (Command.SYNC_WRITE, make_sync_write(0x2A, ROWS)),
        (Command.TRANSACT, b"\6\0" + make_write(5, 0x2A, u16(2100))),
        (Command.TRANSACT, b"\6\0" + make_write(5, 0x28, b"\1")),
        (Command.TRANSACT, b"\6\0" + make_write(4, 0x2E, u16(20))),
        (Command.TRANSACT, b"\0\0" + make_action()),
    ):
        assert board.client.ask(cmd, body, within=1.0).status == Status.FORBIDDEN
    board.client.ask_chapter(2, make_write(0, 0x2A, be(2300)))
    board.machine.send(board.client.frame(3, make_sync_write(0x2A, ROWS), proto=1))
    board.client.run(0.5)
    assert shafts(board) == pytest.approx(START, abs=1)
    assert not any(torques(board))
    # A servo that is in another mode now gets no torque.
    assert maintenance(board, 0).body[0] == 0
    reply = board.client.ask(Command.TORQUE, b"\1\x7f\0", within=1.0)
    assert (reply.status, reply.body) == (Status.SERVO_FAULT, b"\1\x6f\0")
    assert torques(board) == [i != 4 for i in range(7)]
    for body in (b"", b"\2", b"\1\0"):
        status = board.client.ask(Command.MAINTENANCE, body).status
        assert status == (Status.BAD_RANGE if body == b"\2" else Status.BAD_LENGTH)


@pytest.mark.parametrize("how", ["stop", "watchdog", "reset"])
def test_a_stop_a_trip_and_a_reset_end_maintenance(board: BoardUnderTest, how: str) -> None:
    assert board.client.ask(Command.MAINTENANCE, b"\1", within=1.0).status == Status.OK
    if how == "stop":
        board.client.ask(Command.STOP, b"\0", within=1.0)
    elif how == "watchdog":
        board.client.ask(Command.WATCHDOG, b"\x64\0\0")
        board.client.run(1.0)
    else:
        board.machine.reset()
        board.client.run(1.0)
    assert not state(board).board_flags & MAINTENANCE
    if how != "reset":
        assert board.client.ask(Command.MAINTENANCE, b"\1", within=1.0).status == Status.STOPPED
        board.client.ask(Command.RESUME)
    assert ask(board, Command.TRANSACT, make_write(4, 0x21, b"\1")) == Status.FORBIDDEN


def test_the_version_and_the_boot_id(board: BoardUnderTest) -> None:
    who = Identity.parse(board.client.ask(Command.IDENTIFY).body)
    assert who.firmware == (tables.VERSION_MAJOR, tables.VERSION_MINOR, tables.VERSION_PATCH)
    assert who.boot_id != 0
    assert board.client.ask(Command.READ, make_read(0, 0x38, 2)).status == Status.OK
