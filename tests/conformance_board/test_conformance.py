"""The same requests, the same bytes back, from the emulator, from the core, and from the chip.

What may differ is written down in `adapter.comparable`, and in docs/firmware.md for people.
"""

from __future__ import annotations

from ast import literal_eval
from collections.abc import Callable, Iterator

import pytest
from tests.conformance_board.adapter import BoardUnderTest

from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Status
from hexwire.wire.modules import ModuleType
from hexwire.wire.servo_packet import (
    make_action,
    make_ping,
    make_read,
    make_reg_write,
    make_sync_read,
    make_sync_write,
    make_write,
)

# The first one builds.

Pair = list[BoardUnderTest]
ABSENT = 9


# What is the same as the core is the same as the emulator.
@pytest.fixture(params=["emulator-core", pytest.param("core-chip", marks=pytest.mark.slow)])
def boards(request: pytest.FixtureRequest) -> Iterator[Callable[..., Pair]]:
    made: Pair = []

    def make(*faults: str) -> Pair:
        made.extend(BoardUnderTest(kind, faults) for kind in request.param.split("-"))
        return made

    yield make
    for board in made:
        board.close()


def same(pair: Pair, cmd: int, body: bytes = b"", *, proto: int = 2, expect: int | None = 1, **frame: int) -> bytes:
    """Ask both; they must answer with the same bytes. Returns them."""
    answers = {
        b.machine.name: b.exchange(b.client.frame(cmd, body, proto=proto, **frame), 0.4 if expect else 0.15)
        for b in pair
    }
    first = next(iter(answers.values()))
    assert all(answer == first for answer in answers.values()), answers
    if expect is not None:
        assert len(first) == expect, answers
    return b"".join(first)


def all_advance(pair: Pair, seconds: float) -> None:
    for board in pair:
        board.advance(seconds)


def rows(*targets: tuple[int, int]) -> bytes:
    return bytes((len(targets),)) + b"".join(bytes((i,)) + p.to_bytes(2, "little", signed=True) for i, p in targets)


def move(duration_ms: int, *targets: tuple[int, int]) -> bytes:
    return duration_ms.to_bytes(2, "little") + rows(*targets)


def test_dialect_1_reads_and_pings(boards: Callable[..., Pair]) -> None:
    pair = boards()
    assert b"ff f5 00 04 00 05 08 ee" in same(pair, 2, make_read(0, 0x38, 2), proto=1)
    for servo_id in (0, 3, 4, 6):
        same(pair, 1, make_ping(servo_id), proto=1)
        same(pair, 2, make_read(servo_id, 0x38, 2), proto=1)
        same(pair, 2, make_read(servo_id, 0x28, 1), proto=1)
    assert b"ff ff 06 04 00 34 00 c1" in same(pair, 2, make_read(6, 0x3C, 2), proto=1)
    same(pair, 2, make_read(5, 0x38, 8), proto=1)
    same(pair, 2, make_ping(2), proto=1)


def test_dialect_1_errors(boards: Callable[..., Pair]) -> None:
    pair = boards()
    assert b"ff f5 09 04 01 00 00 f1" in same(pair, 2, make_read(ABSENT, 0x38, 2), proto=1)
    assert b"ff f5 09 06 05 eb" in same(pair, 1, make_ping(ABSENT), proto=1)
    assert b"ff f5 ff 06 07 f3" in same(pair, 0x55, b"\1\2\3", proto=1)
    same(pair, 0x10, proto=1)
    same(pair, 2, b"", proto=1)
    same(pair, 2, b"\xff\xff\x00\x04\x02\x38\x02\x00", proto=1)
    same(pair, 2, make_read(0, 0x38, 2) + b"\0", proto=1)


def test_to_whom_an_answer_goes(boards: Callable[..., Pair]) -> None:
    """In dialect 1 to module 0 with the board's own count, in dialect 2 to who asked, with the number given."""
    pair = boards()
    counts = []
    for _ in range(2):
        (sn, src, dst, *_), (proto, seq, cmd, _), _ = literal_eval(
            same(pair, 2, make_read(0, 0x38, 2), proto=1, seq=77).decode()
        )
        assert (src, dst, proto, cmd) == (ModuleType.ARM_7BOT_ARDUINO_TRX, ModuleType.ROS1_HOST, 1, 2)
        assert seq == sn & 0xFF
        counts.append(sn)
    assert counts[1] == counts[0] + 1
    (_, _, dst, *_), (_, seq, *_), _ = literal_eval(same(pair, Command.IDENTIFY, seq=99).decode())
    assert (dst, seq) == (ModuleType.ARM_7BOT_SERIAL_TRX, 99)


def test_a_short_frame_gets_no_answer(boards: Callable[..., Pair]) -> None:
    """The chapter's sketch answers with error 04. Here it is dropped and counted, whatever its size says."""
    for board in boards():
        good = board.client.frame(2, make_read(0, 0x38, 2), proto=1)
        for size in (32, 36, 40):
            short = good[:28] + size.to_bytes(4, "little") + good[32 : size - 2] + b"\r\n"
            assert board.exchange(short[:size], 0.2) == [], (board.machine.name, size)
        assert len(board.exchange(board.client.frame(Command.IDENTIFY))) == 1


def test_dialect_1_writes_pass_through(boards: Callable[..., Pair]) -> None:
    pair = boards()
    same(pair, 2, make_write(4, 0x28, b"\1"), proto=1)
    same(pair, 2, make_read(4, 0x28, 1), proto=1)
    same(pair, 2, make_write(4, 0x29, b"\0\x64\x08\x64\0\x0a\0"), proto=1)
    # What waits in a servo no stop can void.
    same(pair, 2, make_reg_write(4, 0x29, b"\0\x80\x08\x64\0\x0a\0"), proto=1)
    same(pair, 2, make_action(4), proto=1)
    all_advance(pair, 1.0)
    same(pair, 2, make_read(4, 0x38, 2), proto=1)


def test_dialect_1_sync_write_is_never_answered(boards: Callable[..., Pair]) -> None:
    pair = boards()
    same(pair, Command.TORQUE, b"\1\x7f\0")
    data = {i: (2100 + i).to_bytes(2, "little") + (300).to_bytes(2, "little") for i in range(7)}
    same(pair, 3, make_sync_write(0x2A, data), proto=1, expect=0)
    all_advance(pair, 2.0)
    for servo_id in range(7):
        same(pair, 2, make_read(servo_id, 0x38, 2), proto=1)
    # Not to this register, and not with a bad checksum.
    same(pair, 3, make_sync_write(0x30, data), proto=1, expect=0)
    same(pair, 3, make_sync_write(0x2A, data)[:-1] + b"\0", proto=1, expect=0)
    all_advance(pair, 0.5)
    same(pair, 2, make_read(1, 0x38, 2), proto=1)


def test_identify_and_joint_state(boards: Callable[..., Pair]) -> None:
    pair = boards()
    assert b"05 04 01 06 04 01" in same(pair, Command.IDENTIFY)
    same(pair, Command.IDENTIFY, b"\0")
    for fields in (0x00, 0x01, 0x02, 0x20, 0x21):
        same(pair, Command.JOINT_STATE, bytes((fields,)))
    # The slow items take turns; after a few seconds everybody has had all of them.
    for board in pair:
        for _ in range(12):
            board.exchange(board.client.frame(Command.JOINT_STATE, b"\0"))
            board.advance(0.2)
    for board in pair:
        board.client.sn = board.client.seq = 0
    assert len({b.exchange(b.client.frame(Command.JOINT_STATE, b"\x3f", seq=99))[0] for b in pair}) == 1
    for body in (b"", b"\0\0", b"\x40", b"\xff"):
        same(pair, Command.JOINT_STATE, body)


def test_torque_and_move(boards: Callable[..., Pair]) -> None:
    pair = boards()
    same(pair, Command.JOINT_MOVE, move(100, (0, 2100)))  # no torque yet
    same(pair, Command.TORQUE, b"\1\x7f\0")
    same(pair, Command.JOINT_STATE, b"\0")
    same(pair, Command.JOINT_MOVE, move(400, (4, 2100), (1, 2000)))
    all_advance(pair, 2.0)
    same(pair, Command.JOINT_STATE, b"\0")
    same(pair, Command.JOINT_MOVE, move(300, (0, 5000), (6, -5)))  # clamped, and lengthened
    all_advance(pair, 3.0)
    same(pair, Command.JOINT_STATE, b"\0")
    same(pair, Command.JOINT_MOVE, move(2000, (0xFE, 2047)))
    all_advance(pair, 3.0)
    same(pair, Command.JOINT_STATE, b"\0")
    for body in (
        b"",
        b"\0\0",
        move(100),
        move(100, (0, 1))[:-1],
        move(100, (0, 1)) + b"\0",
        move(100, (7, 2000)),
        move(100, (1, 2000), (1, 2001)),
        move(100, (0xFE, 2000), (1, 2001)),
    ):
        same(pair, Command.JOINT_MOVE, body)
    for body in (b"\2\1\0", b"\1\0\1", b"\0\x80\0", b"\1", b""):
        same(pair, Command.TORQUE, body)
    same(pair, Command.TORQUE, b"\0\x03\0")
    same(pair, Command.JOINT_STATE, b"\0")


def test_stop_and_resume(boards: Callable[..., Pair]) -> None:
    pair = boards()
    same(pair, Command.TORQUE, b"\1\x7f\0")
    for mode in (b"\0", b"\1"):
        same(pair, Command.STOP, mode)
        same(pair, Command.JOINT_STATE, b"\0")
        for cmd, body in (
            (Command.JOINT_MOVE, move(100, (0, 2000))),
            (Command.TORQUE, b"\1\x7f\0"),
            (Command.SYNC_WRITE, make_sync_write(0x2A, {0: b"\0\x08\0\0"})),
            (Command.READ, make_write(4, 0x28, b"\1")),
            (Command.TRANSACT, b"\6\0" + make_write(4, 0x28, b"\1")),
            (Command.LIMITS, b"\7" + b"\0\0\xff\x0f\0\x10" * 7),
            (Command.OFFSETS, b"\7" + b"\xff\7\1" * 7),
            (Command.IO, b"\1\1"),
        ):
            same(pair, cmd, body)
        for cmd, body in (
            (Command.IDENTIFY, b""),
            (Command.READ, make_read(1, 0x38, 2)),
            (Command.PING, make_ping(5)),
            (Command.TRANSACT, b"\x08\0" + make_read(4, 0x38, 2)),
            (Command.LIMITS, b""),
            (Command.IO, b"\0\0"),
            (Command.REPORT, b"\0\0\0"),
            (Command.WATCHDOG, b"\0\0\0"),
        ):
            same(pair, cmd, body)
        same(pair, 2, make_write(4, 0x28, b"\1"), proto=1)
        same(pair, 2, make_read(4, 0x28, 1), proto=1)
        same(pair, Command.RESUME)
        same(pair, Command.JOINT_STATE, b"\0")
    for body in (b"", b"\2", b"\0\0"):
        same(pair, Command.STOP, body)
    same(pair, Command.RESUME, b"\0")


def test_ranges(boards: Callable[..., Pair]) -> None:
    pair = boards()
    for cmd, bodies in {
        Command.REPORT: (b"\4\0\0", b"\x11\x27\0", b"\x0a\0\x40", b"\x0a\0", b"\0\0\0\0"),
        Command.WATCHDOG: (b"\x31\0\0", b"\x61\xea\0", b"\x64\0\2", b"\x64\0", b"\0\0\0"),
        Command.IO: (b"\x08\0", b"\7\7", b"\0\0", b"\2\0", b"\0\0", b"\1"),
        Command.STATS: (b"\0",),
        0x7E: (b"", b"123"),
    }.items():
        for body in bodies:
            same(pair, cmd, body)


def test_settings(boards: Callable[..., Pair]) -> None:
    pair = boards()
    good = b"\7" + b"".join(
        (100 + i).to_bytes(2, "little") + (3000).to_bytes(2, "little") + b"\xe8\3" for i in range(7)
    )
    same(pair, Command.LIMITS)
    same(pair, Command.OFFSETS)
    same(pair, Command.LIMITS, good)
    same(pair, Command.LIMITS)
    for body in (
        good[:-1],
        b"\6" + good[1:-6],
        good[:1] + b"\xff\x0f\0\0" + good[5:],
        good[:5] + b"\0\0" + good[7:],
    ):
        same(pair, Command.LIMITS, body)
    same(pair, Command.LIMITS)
    offsets = b"\7" + b"\xff\7\1" * 3 + b"\0\x08\xff" * 4
    same(pair, Command.OFFSETS, offsets)
    same(pair, Command.OFFSETS, offsets[:-1] + b"\0")
    same(pair, Command.OFFSETS)
    for board in pair:
        board.machine.reset()
        board.machine.settle(0.3)
        board.client.frames()
    same(pair, Command.LIMITS)
    same(pair, Command.OFFSETS)
    # The new limits hold for every way to a target.
    same(pair, Command.TORQUE, b"\1\x7f\0")
    same(pair, Command.JOINT_MOVE, move(100, (0, 50), (5, 3500)))
    same(pair, Command.TRANSACT, b"\6\0" + make_write(4, 0x2A, (3500).to_bytes(2, "little")))
    same(pair, Command.READ, make_write(4, 0x2A, (50).to_bytes(2, "little")))
    same(pair, Command.TRANSACT, b"\0\0" + make_sync_write(0x2A, {1: b"\x0d\xac\0\0"}))
    same(pair, 2, make_write(4, 0x2A, (50).to_bytes(2, "little")), proto=1)
    same(pair, 2, make_read(4, 0x2A, 2), proto=1)


def test_settings_are_stored_64_times_in_a_row(boards: Callable[..., Pair]) -> None:
    pair = boards()

    def store(neutral: int) -> int:
        body = b"\7" + neutral.to_bytes(2, "little") + b"\1" + b"\xff\7\1" * 6
        (status,) = {board.client.ask(Command.OFFSETS, body).status for board in pair}
        return status

    assert {store(2000 + n) for n in range(tables.SETTINGS_STORES)} == {Status.OK}
    busy = b"\7" + b"\1\1\1" * 7
    same(pair, Command.OFFSETS, busy)
    same(pair, Command.LIMITS, b"\7" + (b"\x64\0\xb8\x0b\xe8\3" * 7))
    same(pair, Command.LIMITS, b"\7" + bytes(42))
    assert {board.client.ask(Command.OFFSETS, busy).status for board in pair} == {Status.BUSY}
    # What is stored already may be stored again.
    assert store(2000 + tables.SETTINGS_STORES - 1) == Status.OK
    same(pair, Command.OFFSETS)
    same(pair, Command.LIMITS)


def test_packets_in_dialect_2(boards: Callable[..., Pair]) -> None:
    pair = boards()
    same(pair, Command.PING, make_ping(0))
    same(pair, Command.READ, make_read(0, 0x38, 2))
    same(pair, Command.READ, make_read(5, 0x38, 2))
    same(pair, Command.PING, make_ping(ABSENT))
    same(pair, Command.READ, make_read(ABSENT, 0x38, 2))
    same(pair, Command.READ, b"\1\2\3")
    same(pair, Command.SYNC_WRITE, make_sync_write(0x2A, {0: b"\x05\x08\0\0"}))
    same(pair, Command.TRANSACT, b"\x08\0" + make_read(0, 0x38, 2))
    same(pair, Command.TRANSACT, b"\x18\0" + make_sync_read(0x38, 2, [4, 5, 6]))
    same(pair, Command.TRANSACT, b"\x08\x05" + make_read(ABSENT, 0x38, 2))
    same(pair, Command.TRANSACT, b"\0\0" + make_sync_write(0x28, {4: b"\1"}))
    for body in (b"", b"\1", b"\x08\0", b"\x08\0\xff\xff\1", b"\x79\0" + make_read(0, 0x38, 2)):
        same(pair, Command.TRANSACT, body)


def test_bad_frames_are_not_answered(boards: Callable[..., Pair]) -> None:
    pair = boards()
    answers = []
    for board in pair:
        good = board.client.frame(Command.IDENTIFY)
        bad_check = good[:40] + bytes((good[40] ^ 1,)) + good[41:]
        unchecked = good[:40] + b"\xff\xff" + good[42:]
        assert board.exchange(bad_check, 0.1) == []
        assert board.exchange(unchecked, 0.1) == []
        assert board.exchange(board.client.frame(Command.IDENTIFY, dst=7), 0.1) == []
        assert board.exchange(board.client.frame(Command.IDENTIFY, cmd_ext=0x80), 0.1) == []
        assert board.exchange(board.client.frame(Command.IDENTIFY, cmd_ext=0x40), 0.1) == []
        # Noise, a false sync word, half a frame and then silence: the next good frame is found.
        answers.append(board.exchange(b"\x5a\xfa\xfanoise" + good[:30] + board.client.frame(Command.IDENTIFY)))
        assert board.exchange(good[:41], 0.12) == []
        answers[-1] += board.exchange(b"\x5a\xfa\xfa" + board.client.frame(Command.JOINT_STATE, b"\0"))
    assert answers[0] == answers[1]
    assert len(answers[0]) == 2


def test_a_repeat_is_not_executed_again(boards: Callable[..., Pair]) -> None:
    pair = boards()
    same(pair, Command.TORQUE, b"\1\x7f\0")
    for board in pair:
        frame = board.client.frame(Command.JOINT_MOVE, move(200, (0, 2100)))
        first = board.exchange(frame)
        count = len(board.bus_writes(0x2A))
        again = board.exchange(frame)
        assert len(first) == len(again) == 1
        assert first[0].split(b")", 1)[1] == again[0].split(b")", 1)[1]  # all but the board's own frame count
        assert len(board.bus_writes(0x2A)) == count
        board.advance(2.1)
        board.exchange(frame)
        assert len(board.bus_writes(0x2A)) == count + 1


def test_reports(boards: Callable[..., Pair]) -> None:
    for board in boards():
        board.exchange(board.client.frame(Command.REPORT, b"\x32\0\x01"))
        reports = [f for f in board.client.run(1.0) if f.is_unsolicited]
        assert 18 <= len(reports) <= 21
        assert all(f.cmd == Command.JOINT_STATE and f.dst == 7 for f in reports)
        assert [f.seq for f in reports] == [(reports[0].seq + i) & 0xFF for i in range(len(reports))]
        board.exchange(board.client.frame(Command.IDENTIFY))
        board.advance(0.1)
        assert board.client.run(0.3) == []


def test_watchdog(boards: Callable[..., Pair]) -> None:
    pair = boards()
    same(pair, Command.TORQUE, b"\1\x7f\0")
    same(pair, Command.WATCHDOG, b"\xc8\0\1")
    all_advance(pair, 0.15)
    same(pair, Command.JOINT_STATE, b"\0")
    all_advance(pair, 0.5)
    state = same(pair, Command.JOINT_STATE, b"\0")
    assert b"'00 00 00 00 00 07 07 00" in state  # stopped, tripped, torque taken away
    same(pair, Command.JOINT_MOVE, move(100, (0, 2000)))
    same(pair, Command.WATCHDOG, b"\0\0\0")
    same(pair, Command.JOINT_STATE, b"\0")
    same(pair, Command.RESUME)
    same(pair, Command.JOINT_STATE, b"\0")


@pytest.mark.parametrize("fault", ["silent:4", "silent:1", "bus.echo", "late:2:0.001"])
def test_with_the_same_fault(boards: Callable[..., Pair], fault: str) -> None:
    pair = boards(fault)
    all_advance(pair, 1.0)
    same(pair, Command.IDENTIFY)
    for servo_id in (1, 2, 4, 5):
        same(pair, 1, make_ping(servo_id), proto=1)
        same(pair, 2, make_read(servo_id, 0x38, 2), proto=1)
        same(pair, Command.READ, make_read(servo_id, 0x38, 2))
        same(pair, Command.TRANSACT, b"\x08\0" + make_read(servo_id, 0x38, 2))
    same(pair, Command.TORQUE, b"\1\x7f\0")
    same(pair, Command.JOINT_MOVE, move(500, (1, 2100), (4, 2100), (5, 2100)))
    all_advance(pair, 1.5)
    same(pair, Command.JOINT_STATE, b"\0")
    same(pair, Command.STOP, b"\1")
