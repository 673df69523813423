"""The ELF on the simulated chip: what only the chip can show, and every fault of its lines and memory."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator

import pytest
from tests.avr.client import Client
from tests.avr.machines import ChipBoard

from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame, Status
from hexwire.wire.commands import STATS_FIELDS, Identity, JointReport
from hexwire.wire.servo_packet import Instruction, make_packet, make_ping, make_read, make_sync_write

# The first one builds.

START = (2053, 2043, 2035, 2039, 2083, 2046, 2047)
ALL = b"\x7f\0"
Chip = Callable[..., tuple[ChipBoard, Client]]


@pytest.fixture
def chip() -> Iterator[Chip]:
    made: list[ChipBoard] = []

    def start(*faults: str, settle: float = 0.15, **options: int) -> tuple[ChipBoard, Client]:
        board = ChipBoard(faults, **options)
        made.append(board)
        board.settle(settle)
        return board, Client(board)

    yield start
    for board in made:
        assert board.overruns == 0, "the chip's receiver lost bytes: an interrupt was off for too long"
        board.close()


def move(duration_ms: int, targets: dict[int, int]) -> bytes:
    rows = b"".join(bytes((i,)) + p.to_bytes(2, "little", signed=True) for i, p in targets.items())
    return duration_ms.to_bytes(2, "little") + bytes((len(targets),)) + rows


def state(client: Client, fields: int = 0) -> JointReport:
    return JointReport.parse(client.ask(Command.JOINT_STATE, bytes((fields,))).body)


def stats(client: Client) -> dict[str, int]:
    body = client.ask(Command.STATS).body
    return {name: int.from_bytes(body[4 * i : 4 * i + 4], "little") for i, name in enumerate(STATS_FIELDS)}


def status(frame: Frame) -> int:
    return frame.cmd_ext & tables.EXT_STATUS_MASK


def targets_sent(board: ChipBoard) -> list[bytes]:
    return [p for _, p in board.line.sent if p[4] == 0x83 and p[5] in (0x29, 0x2A)]


def test_nothing_moves_at_start(chip: Chip) -> None:
    board, client = chip()
    assert targets_sent(board) == []
    assert {p[4] for _, p in board.line.sent} <= {0x02, 0x82}  # reads and sync reads
    assert state(client).position == START


def test_the_chapters_log(chip: Chip) -> None:
    """The log's two requests, byte for byte, get the log's replies but for clock, numbers and the real tail."""
    board, _ = chip()
    head = "5A FA FA 5A DB 9A 7A 68 {} 07 00 00 00 08 00 00 00 03 00 00 00 34 00 00 00 {}"
    load = head.format("E0 4E 00 0D 2E 00 00 00", "82 01 2E 00 08 00 02 00 FF FF 06 04 02 3C 02 B5 14 22 0D 0A")
    place = head.format("08 B7 9E 10 2F 00 00 00", "82 01 2F 00 08 00 02 00 FF FF 00 04 02 38 02 BF 3D 86 0D 0A")
    log = ((load, "FF FF 06 04 00 34 00 C1"), (place, "FF F5 00 04 00 05 08 EE"))
    for number, (request, answer) in enumerate(log, 1):
        reply = board.exchange(bytes.fromhex(request))
        assert len(reply) == 52
        assert reply[:4] == bytes.fromhex("5AFAFA5A")
        assert reply[12:32] == bytes((number, 0, 0, 0)) + bytes.fromhex("08000000 00000000 08000000 34000000")
        assert reply[32:40] == bytes((0x82, 1, number, 0, 8, 0, 2, 0))
        assert reply[40:] == bytes.fromhex(answer) + bytes.fromhex("FFFF 0D0A")


def test_at_start_a_joint_with_torque_is_held(chip: Chip) -> None:
    board, client = chip()
    client.ask(Command.TORQUE, b"\1" + ALL)
    client.ask(Command.JOINT_MOVE, move(2000, dict.fromkeys(range(7), 2500)))
    client.run(1.0)
    board.line.sent.clear()
    board.reset()
    client.run(0.3)
    held = [servo.present_position for servo in board.wire.servos]
    assert len(targets_sent(board)) == 2
    assert all(2100 < position < 2450 for position in held)
    client.run(1.5)
    now = [servo.present_position for servo in board.wire.servos]
    assert all(abs(a - b) < 12 for a, b in zip(held, now, strict=True)), (held, now)
    assert all(servo.torque_on for servo in board.wire.servos)


def test_the_boot_id_counts_resets(chip: Chip) -> None:
    board, client = chip()
    first = Identity.parse(client.ask(Command.IDENTIFY).body).boot_id
    for n in range(1, 4):
        board.reset()
        board.settle()
        client.frames()
        assert Identity.parse(client.ask(Command.IDENTIFY).body).boot_id == first + n


@pytest.mark.parametrize(("stored", "expected"), [(0xFFFFFFFF, 2), (0xFFFFFFFE, 2), (0, 2), (1000, 1001)])
def test_the_boot_id_goes_on_from_that_of_earlier_firmware(chip: Chip, stored: int, expected: int) -> None:
    board, client = chip()
    assert Identity.parse(client.ask(Command.IDENTIFY).body).boot_id == 1
    board.write_eeprom(0, stored.to_bytes(4, "little"))
    board.reset()
    board.settle()
    client.frames()
    assert Identity.parse(client.ask(Command.IDENTIFY).body).boot_id == expected


def test_a_hanging_program_is_reset_by_the_watchdog(chip: Chip) -> None:
    board, client = chip()
    assert not client.ask(Command.IDENTIFY).body[12] & tables.BOARD_FLAGS_WATCHDOG_RESET
    before = board.resets
    client.run(0.013)
    mend = board.hang()
    client.run(0.2)
    assert board.resets == before
    while board.resets == before:
        client.run(0.001)
        assert board.now < 5
    mend()
    board.settle()
    client.frames()
    assert client.ask(Command.IDENTIFY).body[12] & tables.BOARD_FLAGS_WATCHDOG_RESET
    assert state(client).position == START


def test_the_watchdog_leaves_a_working_program_alone(chip: Chip) -> None:
    board, client = chip()
    before = board.resets
    client.ask(Command.REPORT, b"\x05\0\x3f")
    client.run(3.0)
    assert board.resets == before


@pytest.mark.slow
def test_it_sleeps_when_it_has_nothing_to_do(chip: Chip) -> None:
    board, _ = chip(settle=3.0)
    asleep = 0
    for _ in range(2000):
        board.advance(0.000137)
        asleep += board.asleep
    assert asleep > 1600


def test_bytes_lost_on_the_host_line(chip: Chip) -> None:
    _, client = chip()
    client.ask(Command.TORQUE, b"\1" + ALL)
    for lost in (0, 3, 31, 33, 38, 41, 44, 47):
        frame = client.frame(Command.JOINT_MOVE, move(50, {0: 3000}))
        client.machine.send(frame[:lost] + frame[lost + 1 :])
        assert client.run(0.1) == []
        assert status(client.ask(Command.JOINT_STATE, b"\0")) == Status.OK
    assert state(client).position[0] == START[0]
    counted = stats(client)
    assert counted["bad_frames"] + counted["resyncs"] >= 8


def test_every_damaged_byte_of_a_frame_is_noticed(chip: Chip) -> None:
    board, client = chip()
    client.ask(Command.TORQUE, b"\1" + ALL)
    dice = random.Random(5)
    for at in range(0, 56, 3):
        frame = bytearray(client.frame(Command.JOINT_MOVE, move(50, {0: 3000})))
        if at >= len(frame):
            break
        frame[at] ^= 1 << dice.randrange(8)
        if at == 33 or 46 < at < 54:
            continue  # another dialect, or the pad bytes: nobody looks at those
        client.machine.send(bytes(frame))
        assert client.run(0.08) == [], at
    assert state(client).position[0] == START[0]
    assert targets_sent(board)[2:] == []  # two from switching torque on


@pytest.mark.parametrize(
    "faults", [("bus.flip:0.1", "bus.drop:0.05", "bus.junk:0.05"), ("babble:3:0.3", "bus.cut:0.05")]
)
def test_noise_on_the_servo_line_spoils_nothing(chip: Chip, faults: tuple[str, ...]) -> None:
    _, client = chip(*faults, settle=0.5)
    for _ in range(40):
        report = state(client)
        for i, (position, flags) in enumerate(zip(report.position, report.status, strict=True)):
            assert position == START[i] or flags & tables.SERVO_FLAGS_SILENT
        client.run(0.02)
    counted = stats(client)
    assert counted["bus_bad"] + counted["bus_timeouts"] > 10
    assert counted["bus_retries"] > 5


@pytest.mark.slow
def test_a_silent_servo_costs_the_others_little(chip: Chip) -> None:
    board, client = chip("silent:2", settle=0.6)
    report = state(client)
    assert [bool(s & tables.SERVO_FLAGS_SILENT) for s in report.status] == [i == 2 for i in range(7)]
    identity = Identity.parse(client.ask(Command.IDENTIFY).body)
    assert [row.present for row in identity.joints] == [i != 2 for i in range(7)]
    client.ask(Command.REPORT, b"\x05\0\0")
    client.run(0.2)
    assert len([f for f in client.run(1.0) if f.is_unsolicited]) > 85
    assert client.ask_chapter(Command.READ, make_read(2, 0x38, 2)) == bytes.fromhex(
        "FFF502040100 00F8".replace(" ", "")
    )
    assert board.wire.servos[2].present_position == START[2]


def test_a_servo_that_comes_back_is_found(chip: Chip) -> None:
    board, client = chip(settle=0.3)
    answer = board.wire.servos[5].receive
    board.wire.servos[5].receive = lambda packet, now: None  # type: ignore[method-assign]  # unplugged
    for _ in range(10):
        state(client)
    assert state(client).status[5] & tables.SERVO_FLAGS_SILENT
    board.wire.servos[5].receive = answer  # type: ignore[method-assign]
    client.run(0.7)
    assert not state(client).status[5] & tables.SERVO_FLAGS_SILENT


def test_a_servo_that_was_without_power_has_lost_its_torque(chip: Chip) -> None:
    board, client = chip()
    client.ask(Command.TORQUE, b"\1" + ALL)
    for servo_id in (2, 5):
        servo = board.wire.servos[servo_id]
        servo.power_cycle(board.now, 0.3)
        for _ in range(20):
            state(client)
        assert state(client).status[servo_id] & tables.SERVO_FLAGS_SILENT
        client.run(1.0)
        for _ in range(3):
            state(client)
        assert not state(client).status[servo_id] & (tables.SERVO_FLAGS_SILENT | tables.SERVO_FLAGS_TORQUE_ON)
        assert status(client.ask(Command.JOINT_MOVE, move(100, {servo_id: 2047}))) == Status.TORQUE_OFF


def test_a_stop_that_is_lost_to_noise_is_sent_again(chip: Chip) -> None:
    board, client = chip()
    client.ask(Command.TORQUE, b"\1" + ALL)
    transact = board.wire.transact
    lost = []

    def deaf_once(packet: bytes, now: float) -> tuple[bytes, float]:
        if packet[4:7] == b"\x83\x28\x01" and not lost:
            lost.append(packet)
            packet = packet[:-1] + bytes((packet[-1] ^ 1,))
        return transact(packet, now)

    board.wire.transact = deaf_once  # type: ignore[method-assign]
    assert client.ask(Command.STOP, b"\1").body == b"\1\x7f\0"
    assert lost
    assert not any(servo.torque_on for servo in board.wire.servos)


def test_babble_after_every_answer_delays_but_does_not_stop(chip: Chip) -> None:
    board, client = chip()
    board.line.babble = bytes(range(0x40, 0x54))
    client.run(0.3)
    assert client.ask_chapter(Command.READ, make_read(0, 0x38, 2)) == bytes.fromhex(
        "FFF5000400050 8EE".replace(" ", "")
    )
    report = state(client)
    assert report.position == START
    board.line.sent.clear()
    client.ask(Command.STOP, b"\1")
    assert any(p[4:7] == b"\x83\x28\x01" for _, p in board.line.sent)


@pytest.mark.slow
def test_an_adapter_that_echoes(chip: Chip) -> None:
    _, client = chip("bus.echo", settle=0.3)
    assert state(client).position == START
    assert client.ask_chapter(Command.PING, make_ping(4)) == bytes.fromhex("FFFF040200F9")
    assert client.ask_chapter(Command.READ, make_read(6, 0x3C, 2)) == bytes.fromhex("FFFF0604003400C1")
    client.ask(Command.REPORT, b"\x05\0\0")
    client.run(0.2)
    assert len([f for f in client.run(1.0) if f.is_unsolicited]) > 70
    assert stats(client)["bus_timeouts"] == 0


def test_a_frame_that_never_ends_is_given_up(chip: Chip) -> None:
    _, client = chip()
    longest = client.frame(Command.TRANSACT, b"\0\0" + bytes(206))
    assert len(longest) == 252
    client.machine.send(longest[:200])
    client.run(0.02)
    client.machine.send(b"\x0d\x0a")
    client.run(0.08)
    assert status(client.ask(Command.IDENTIFY)) == Status.OK
    assert stats(client)["bad_frames"] == 1
    # Without the silence it swallows what follows, and gives it back when it turns out to be no frame.
    client.machine.send(longest[:190] + client.frame(Command.IDENTIFY) + client.frame(Command.JOINT_STATE, b"\0"))
    got = client.run(0.3)
    assert [frame.cmd for frame in got] == [Command.IDENTIFY, Command.JOINT_STATE]


def test_the_longest_frame(chip: Chip) -> None:
    board, client = chip()
    rows = b"".join(bytes((i,)) + b"\xe8\3\x20\x20\0\0" for i in (4, 5, 6)) * 9
    packet = make_packet(0xFE, Instruction.SYNC_WRITE, b"\x30\6" + rows)
    body = b"\0\0" + packet
    board.line.sent.clear()
    assert len(client.frame(Command.TRANSACT, body)) > 230
    assert status(client.ask(Command.TRANSACT, body)) == Status.OK
    assert packet in [p for _, p in board.line.sent]
    full = b"\0\0" + bytes(206)
    assert len(client.frame(Command.TRANSACT, full)) == 252
    assert status(client.ask(Command.TRANSACT, full)) == Status.BAD_RANGE


def test_requests_back_to_back_are_answered_in_order(chip: Chip) -> None:
    _, client = chip()
    requests = [client.frame(Command.READ, make_read(i, 0x38, 2), proto=1) for i in range(7)]
    client.machine.send(b"".join(requests))
    answers = [f.body for f in client.run(0.3)]
    assert [a[2] for a in answers] == list(range(7))
    assert [a[5] | a[6] << 8 for a in answers] == list(START)
    # Far more than there is room for: what does not fit is refused, nothing is lost without a word.
    burst = [client.frame(Command.READ, make_read(9, 0x38, 2)) for _ in range(60)]
    client.machine.send(b"".join(burst))
    answers = client.run(4.0)
    assert {status(f) for f in answers} <= {Status.SERVO_SILENT, Status.BUSY}
    assert len(answers) == 60
    assert status(client.ask(Command.IDENTIFY)) == Status.OK


def test_stop_goes_before_what_is_queued(chip: Chip) -> None:
    board, client = chip()
    client.ask(Command.TORQUE, b"\1" + ALL)
    board.line.sent.clear()
    slow = b"\x08\xff" + make_read(9, 0x38, 2)  # 255 ms for a servo that is not there
    client.machine.send(client.frame(Command.TRANSACT, slow))
    client.machine.send(client.frame(Command.JOINT_MOVE, move(500, {0: 2500})))
    client.machine.send(client.frame(Command.STOP, b"\1"))
    got = client.run(0.1)
    assert [status(f) for f in got] == [Status.STOPPED, Status.STOPPED, Status.OK]
    assert got[2].seq == client.seq
    assert got[2].body == b"\1\x7f\0"
    client.run(0.7)
    assert targets_sent(board) == []
    assert not any(servo.torque_on for servo in board.wire.servos)


def test_the_host_falls_silent_during_a_move(chip: Chip) -> None:
    board, client = chip()
    client.ask(Command.TORQUE, b"\1" + ALL)
    client.ask(Command.WATCHDOG, b"\x64\0\0")
    client.ask(Command.JOINT_MOVE, move(3000, dict.fromkeys(range(7), 3000)))
    client.run(0.5)
    held = [servo.present_position for servo in board.wire.servos]
    client.run(1.0)
    now = [servo.present_position for servo in board.wire.servos]
    assert all(abs(a - b) < 12 for a, b in zip(held, now, strict=True)), (held, now)
    assert max(now) < 2500
    report = state(client)
    assert report.board_flags & tables.BOARD_FLAGS_WATCHDOG_TRIPPED
    assert report.board_flags & tables.BOARD_FLAGS_STOPPED
    assert stats(client)["watchdog_trips"] == 1
    assert status(client.ask(Command.JOINT_MOVE, move(100, {0: 2047}))) == Status.STOPPED
    client.ask(Command.RESUME)
    assert status(client.ask(Command.JOINT_MOVE, move(100, {0: 2300}))) == Status.OK


def test_damaged_eeprom_gives_defaults_and_says_so(chip: Chip) -> None:
    board, client = chip()
    assert client.ask(Command.IDENTIFY).body[12] & tables.BOARD_FLAGS_SETTINGS_DEFAULT
    defaults = client.ask(Command.LIMITS).body
    limits = b"\7" + b"\x64\0\xb8\x0b\xe8\3" * 7
    offsets = b"\7" + b"\xff\7\1" * 7
    assert status(client.ask(Command.LIMITS, limits)) == Status.OK
    assert client.ask(Command.IDENTIFY).body[12] & tables.BOARD_FLAGS_SETTINGS_DEFAULT
    assert status(client.ask(Command.OFFSETS, offsets)) == Status.OK
    board.reset()
    board.settle()
    client.frames()
    assert not client.ask(Command.IDENTIFY).body[12] & tables.BOARD_FLAGS_SETTINGS_DEFAULT
    assert client.ask(Command.LIMITS).body[1:] == limits
    stored = board.eeprom(16, 46)
    assert limits[1:] in stored
    for at in (0, 1, 2, 20, 45):
        damaged = bytearray(stored)
        damaged[at] ^= 0x10
        board.write_eeprom(16, bytes(damaged))
        board.reset()
        board.settle()
        client.frames()
        assert client.ask(Command.IDENTIFY).body[12] & tables.BOARD_FLAGS_SETTINGS_DEFAULT
        assert client.ask(Command.LIMITS).body == defaults
    assert client.ask(Command.OFFSETS).body[1:] == offsets


def test_a_reset_while_settings_are_stored(chip: Chip) -> None:
    board, client = chip()
    limits = b"\7" + b"\x64\0\xb8\x0b\xe8\3" * 7
    client.machine.send(client.frame(Command.LIMITS, limits))
    while board.eeprom(16, 12) == b"\xff" * 12:
        client.run(0.0002)
    assert board.eeprom(50, 12) == b"\xff" * 12
    board.reset()
    board.settle()
    client.frames()
    # Neither half-old nor half-new: the defaults.
    assert client.ask(Command.LIMITS).body == b"\1\7" + b"\0\0\xff\x0f\0\x10" * 7
    assert status(client.ask(Command.LIMITS, limits)) == Status.OK


def test_a_stop_while_settings_are_stored(chip: Chip) -> None:
    board, client = chip()
    limits = b"\7" + b"\x64\0\xb8\x0b\xe8\3" * 7
    client.machine.send(client.frame(Command.LIMITS, limits))
    saved = client.seq
    while board.eeprom(16, 12) == b"\xff" * 12:
        client.run(0.0002)
    client.machine.send(client.frame(Command.STOP, b"\1"))
    got = {frame.seq: frame for frame in client.run(0.4)}
    # The request is void, but what has begun is ended: half of it would be worse.
    assert status(got[saved]) == Status.STOPPED
    assert status(got[client.seq]) == Status.OK
    assert client.ask(Command.LIMITS).body[1:] == limits
    assert status(client.ask(Command.LIMITS, limits)) == Status.STOPPED
    client.ask(Command.RESUME)
    other = b"\7" + b"\x65\0\xb8\x0b\xe8\3" * 7
    assert client.ask(Command.LIMITS, other).body[1:] == other


def test_targets_outside_the_limits_are_clamped_or_refused(chip: Chip) -> None:
    board, client = chip()
    client.ask(Command.LIMITS, b"\7" + b"\xd0\7\x34\x08\0\x10" * 7)  # 2000..2100
    client.ask(Command.TORQUE, b"\1" + ALL)
    reply = client.ask(Command.JOINT_MOVE, move(100, {0: 3000, 4: 100, 5: 2050}))
    assert reply.body[3:] == b"\0\x34\x08\1" + b"\4\xd0\7\1" + b"\5\x02\x08\0"
    client.run(0.5)
    data = {1: b"\xff\x0f\x64\0", 6: b"\0\0\x64\0"}
    client.machine.send(client.frame(Command.SYNC_WRITE, make_sync_write(0x2A, data), proto=1))
    client.run(1.0)
    positions = [servo.present_position for servo in board.wire.servos]
    assert all(1998 <= p <= 2102 for p in positions), positions
    report = state(client)
    clamped = [bool(s & tables.SERVO_FLAGS_CLAMPED) for s in report.status]
    assert clamped == [True, True, False, False, True, False, True]


def test_the_chapters_move_never_touches_a_current_ceiling(chip: Chip) -> None:
    board, client = chip()
    ceiling = [board.wire.servos[i].registers.get("goal_torque") for i in (4, 5, 6)]
    client.ask(Command.TORQUE, b"\1" + ALL)
    data = {i: (2200).to_bytes(2, "little") + (1720).to_bytes(2, "little") for i in range(7)}
    client.machine.send(client.frame(Command.SYNC_WRITE, make_sync_write(0x2A, data), proto=1))
    client.run(2.5)
    assert [board.wire.servos[i].registers.get("goal_torque") for i in (4, 5, 6)] == ceiling
    assert all(abs(servo.present_position - 2200) < 12 for servo in board.wire.servos)


def test_outputs(chip: Chip) -> None:
    board, client = chip()
    assert client.ask(Command.IO, b"\5\5").body == b"\5\5"
    # Arduino pins 40, 36 and 37 are PG1, PC1 and PC0.
    assert board.peek(0x34) & 0x02
    assert board.peek(0x28) & 0x03 == 0x01


def test_the_first_bytes_after_a_reset_are_not_lost(chip: Chip) -> None:
    board, client = chip()
    board.reset()
    client.run(0.006)
    assert status(client.ask(Command.IDENTIFY)) == Status.OK


@pytest.mark.slow
def test_the_host_line_at_500000(chip: Chip) -> None:
    _, client = chip(host_baud=500000)
    assert state(client, 0x3F).position == START
    client.ask(Command.REPORT, b"\x05\0\x3f")
    client.run(0.2)
    assert len([f for f in client.run(1.0) if f.is_unsolicited]) > 86
