from __future__ import annotations

import itertools
from collections.abc import Sequence

import pytest
from tests.emulator.boards import ALL, STOPPED_FLAG, Bench, u16

from hexwire.wire import servo_packet as sp
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Status
from hexwire.wire.commands import (
    AGE_NEVER,
    Identity,
    JointReport,
    LimitRow,
    LimitTable,
    MoveReply,
    MoveRequest,
    MoveRow,
    OffsetRow,
    OffsetTable,
    Stats,
    TransactRequest,
    parse_stop_reply,
)

START = (2053, 2043, 2035, 2039, 2083, 2046, 2047)
BAUDS = pytest.mark.parametrize("baud", [0, 115200])


def ready(**options: object) -> Bench:
    bench = Bench(**options)
    bench.run(0.3)
    return bench


# --- who and how -----------------------------------------------------------------------------------------------


@BAUDS
def test_identify(baud: int) -> None:
    bench = ready(baud=baud, faults=["silent:3"])
    identity = Identity.parse(bench.ask(Command.IDENTIFY).body)
    assert identity.protocol == 2
    assert identity.max_frame == 253
    # A line without a rate.
    lacking = {"host_baud"}
    can = sum(bit for name, bit in tables.CAPABILITIES.items() if name not in lacking)
    assert identity.capabilities == can
    assert [(r.servo_id, r.series, r.present) for r in identity.joints] == [
        (i, 1 if i < 4 else 4, i != 3) for i in range(7)
    ]
    assert identity.board_flags == tables.BOARD_FLAGS_SETTINGS_DEFAULT


@BAUDS
def test_joint_state_has_the_fields_that_were_asked_for(baud: int) -> None:
    bench = ready(baud=baud)
    for fields in range(64):
        report = bench.state(fields)
        assert report.fields == fields
        assert report.position == START
        assert report.status == (0,) * 7
    full = bench.state()
    assert full.load == (0, 0, 0, 0, 0, 0, 52)
    assert full.voltage is not None
    assert full.temperature is not None
    assert full.voltage[:4] == (0,) * 4
    assert full.voltage[4:] == (60,) * 3
    assert full.temperature[4:] == (28,) * 3
    assert full.age is not None
    assert max(full.age) < 40


def test_a_silent_servo_keeps_its_position_and_its_age_grows() -> None:
    bench = ready(baud=115200)
    bench.torque()
    bench.move({4: 2300}, 500)
    bench.run(1.0)
    bench.board.wire.servos[4].registers.put("id", 77)
    bench.run(2.0)
    report = bench.state()
    assert report.status[4] & 0x80
    assert report.position[4] == pytest.approx(2300, abs=2)
    assert report.age is not None
    assert report.age[4] == pytest.approx(2000, abs=60)
    assert max(a for i, a in enumerate(report.age) if i != 4) < 60
    bench.board.wire.servos[4].registers.put("id", 4)
    bench.run(0.2)
    assert not bench.state().status[4] & 0x80


def test_a_servo_that_never_answered_has_age_never() -> None:
    bench = ready(faults=["silent:2"])
    report = bench.state()
    assert report.age is not None
    assert report.age[2] == AGE_NEVER
    assert report.status[2] == 0x80


def test_speed_of_a_legacy_servo_is_estimated_from_its_last_two_positions() -> None:
    bench = ready(baud=115200)
    bench.torque()
    bench.move({0: 2053 + 1000, 4: 2083 + 1000}, 2000)
    bench.run(1.0)
    report = bench.state()
    assert report.speed is not None
    assert report.speed[0] == pytest.approx(500, abs=90)
    assert report.speed[4] == pytest.approx(500, abs=60)
    assert report.speed[1] == 0


def test_the_microsecond_clock_is_at_the_newest_sample_and_wraps() -> None:
    bench = ready(baud=115200)
    reply = bench.ask(Command.JOINT_STATE, b"\0")
    sent = reply.time_sec * 1_000_000 + reply.time_nsec // 1000
    assert 0 <= sent - JointReport.parse(reply.body).time_us < 12_000
    late = Bench()
    late.now = 4295.0
    reply = late.ask(Command.JOINT_STATE, b"\0")
    assert JointReport.parse(reply.body).time_us == 4295_000_000 - (1 << 32)
    assert reply.time_sec == 4295


# --- good and bad bodies ---------------------------------------------------------------------------------------

LENGTHS = {
    Command.IDENTIFY: 0,
    Command.JOINT_STATE: 1,
    Command.REPORT: 3,
    Command.TORQUE: 3,
    Command.STOP: 1,
    Command.RESUME: 0,
    Command.WATCHDOG: 3,
    Command.STATS: 0,
    Command.IO: 2,
}


@pytest.mark.parametrize(("cmd", "length"), LENGTHS.items())
def test_a_body_of_another_length_is_refused_and_does_nothing(cmd: Command, length: int) -> None:
    bench = ready()
    before = bench.state()
    for size in (*range(length), length + 1, length + 7, 200):
        reply = bench.ask(cmd, bytes(size))
        assert (reply.status, reply.body) == (Status.BAD_LENGTH, b""), size
    after = bench.state()
    assert (after.position, after.status, after.board_flags) == (before.position, before.status, before.board_flags)
    bench.run(2.0)
    assert not [f for _, f in bench.frames if f.is_unsolicited]


MOVE_LENGTHS = [b"", b"\0\0", b"\0\0\0", b"\0\0\2" + bytes(3), b"\0\0\1" + bytes(4), b"\0\0\xff"]
BAD = [
    *((Command.JOINT_MOVE, body, Status.BAD_LENGTH) for body in MOVE_LENGTHS),
    (Command.JOINT_MOVE, MoveRequest(9, (MoveRow(9, 2000),)).serialize(), Status.BAD_RANGE),
    (Command.JOINT_MOVE, MoveRequest(9, (MoveRow(1, 2000), MoveRow(1, 2001))).serialize(), Status.BAD_RANGE),
    (Command.JOINT_MOVE, MoveRequest(9, (MoveRow(0xFE, 2000), MoveRow(1, 2001))).serialize(), Status.BAD_RANGE),
    (Command.JOINT_MOVE, MoveRequest(9, (MoveRow(1, 2000),)).serialize(), Status.TORQUE_OFF),
    (Command.JOINT_STATE, b"\x40", Status.BAD_RANGE),
    (Command.REPORT, u16(4) + b"\0", Status.BAD_RANGE),
    (Command.REPORT, u16(10001) + b"\0", Status.BAD_RANGE),
    (Command.REPORT, u16(20) + b"\x80", Status.BAD_RANGE),
    (Command.TORQUE, b"\2\1\0", Status.BAD_RANGE),
    (Command.TORQUE, b"\1\x80\0", Status.BAD_RANGE),
    (Command.TORQUE, b"\0\1\1", Status.BAD_RANGE),
    (Command.STOP, b"\2", Status.BAD_RANGE),
    (Command.WATCHDOG, u16(49) + b"\0", Status.BAD_RANGE),
    (Command.WATCHDOG, u16(60001) + b"\0", Status.BAD_RANGE),
    (Command.WATCHDOG, u16(100) + b"\2", Status.BAD_RANGE),
    (Command.LIMITS, b"\7", Status.BAD_LENGTH),
    (Command.LIMITS, LimitTable.serialize_request((LimitRow(0, 1, 1),)), Status.BAD_LENGTH),
    (Command.LIMITS, LimitTable.serialize_request((LimitRow(5, 5, 1),) * 7), Status.BAD_RANGE),
    (Command.LIMITS, LimitTable.serialize_request((LimitRow(5, 6, 0),) * 7), Status.BAD_RANGE),
    (Command.OFFSETS, b"\1", Status.BAD_LENGTH),
    (Command.OFFSETS, OffsetTable.serialize_request((OffsetRow(5, 1),) * 6), Status.BAD_LENGTH),
    (Command.OFFSETS, OffsetTable.serialize_request((OffsetRow(5, 0),) * 7), Status.BAD_RANGE),
    (Command.OFFSETS, OffsetTable.serialize_request((OffsetRow(5, 1),) * 6 + (OffsetRow(5, 2),)), Status.BAD_RANGE),
    (Command.TRANSACT, b"", Status.BAD_LENGTH),
    (Command.TRANSACT, b"\0", Status.BAD_LENGTH),
    (Command.TRANSACT, b"\0\0", Status.BAD_RANGE),
    (Command.TRANSACT, b"\x08\0" + sp.make_read(0, 56, 2)[:-1], Status.BAD_RANGE),
    (Command.TRANSACT, b"\x79\0" + sp.make_read(0, 56, 2), Status.BAD_RANGE),
    (Command.TRANSACT, b"\x06\0" + sp.make_packet(0, 2, b"\x38\0"), Status.BAD_RANGE),
    (Command.TRANSACT, b"\x06\0" + sp.make_read(0, 56, 115), Status.BAD_RANGE),
    (Command.PING, b"", Status.BAD_RANGE),
    (Command.READ, b"\xff\xff\0", Status.BAD_RANGE),
    (Command.SYNC_WRITE, b"", Status.BAD_RANGE),
    (Command.SYNC_WRITE, sp.make_sync_write(0x30, {0: b"\x08\x08\0\0"}), Status.BAD_RANGE),
    (Command.SYNC_WRITE, sp.make_write(0, 0x2A, b"\x08\x08\0\0"), Status.BAD_RANGE),
    (Command.IO, b"\x08\0", Status.BAD_RANGE),
    (0x42, b"", Status.UNKNOWN_COMMAND),
    (0x00, b"", Status.UNKNOWN_COMMAND),
]


@pytest.mark.parametrize(("cmd", "body", "status"), BAD)
def test_bad_bodies_and_what_they_are_called(cmd: int, body: bytes, status: Status) -> None:
    bench = ready()
    reply = bench.ask(cmd, body)
    assert (reply.status, reply.body) == (status, b"")
    bench.run(0.5)
    assert bench.true_positions() == list(START)
    assert bench.torques() == [False] * 7
    assert not bench.state().board_flags & STOPPED_FLAG


@BAUDS
def test_ping_read_and_sync_write_in_a_dialect_2_frame(baud: int) -> None:
    bench = ready(baud=baud, faults=["silent:3"])
    assert bench.ask(Command.PING, sp.make_ping(0)).body == bytes.fromhex("FF F5 00 06 00 F9")
    assert bench.ask(Command.READ, sp.make_read(0, 56, 2)).body == bytes.fromhex("FF F5 00 04 00 05 08 EE")
    assert bench.ask(Command.PING, sp.make_ping(3)).status == Status.SERVO_SILENT
    assert bench.ask(Command.READ, sp.make_read(3, 56, 2)).status == Status.SERVO_SILENT
    rows = bench.ask(Command.READ, sp.make_sync_read(56, 2, [4, 5])).body
    assert [p.servo_id for p in sp.iter_status(rows)] == [4, 5]
    assert bench.torque().status == Status.SERVO_SILENT
    moved = bench.ask(Command.SYNC_WRITE, sp.make_sync_write(0x2A, {0: u16(2100) + u16(100)}))
    assert (moved.status, moved.body) == (Status.OK, b"")
    bench.run(1.0)
    assert bench.true_positions()[0] == pytest.approx(2100, abs=1)


# --- motion ----------------------------------------------------------------------------------------------------


@BAUDS
def test_torque_on_moves_nothing_and_is_confirmed(baud: int) -> None:
    bench = ready(baud=baud)
    reply = bench.torque()
    assert (reply.status, parse_stop_reply(reply.body)) == (Status.OK, (1, ALL))
    bench.run(1.0)
    assert bench.torques() == [True] * 7
    assert bench.true_positions() == pytest.approx(START, abs=1)
    assert all(s & 0x40 for s in bench.state().status)
    reply = bench.torque(False, 0b0010001)
    assert parse_stop_reply(reply.body) == (0, 0b0010001)
    assert bench.torques() == [False, True, True, True, False, True, True]


@BAUDS
def test_torque_says_which_servo_is_silent(baud: int) -> None:
    bench = ready(baud=baud, faults=["silent:5"])
    reply = bench.torque()
    assert (reply.status, parse_stop_reply(reply.body)) == (Status.SERVO_SILENT, (1, ALL & ~0x20))
    # It is not known where that joint is: it gets no torque.
    assert not bench.torques()[5]


@BAUDS
def test_a_move_is_clamped_to_the_stored_limits_and_says_so(baud: int) -> None:
    bench = ready(baud=baud)
    rows = (LimitRow(1950, 2150, 4000),) * 7
    assert LimitTable.parse(bench.ask(Command.LIMITS, LimitTable.serialize_request(rows)).body).rows == rows
    bench.torque()
    sent = MoveReply.parse(bench.move({0: 4000, 4: -30000, 5: 2100}, 800).body)
    assert [(r.servo_id, r.position, r.clamped) for r in sent.rows] == [
        (0, 2150, True),
        (4, 1950, True),
        (5, 2100, False),
    ]
    bench.run(2.0)
    assert bench.true_positions()[0] == pytest.approx(2150, abs=2)
    assert bench.true_positions()[4] == pytest.approx(1950, abs=2)
    assert [bool(s & 0x10) for s in bench.state().status] == [True, False, False, False, True, False, False]


@BAUDS
def test_a_move_too_fast_for_the_speed_limit_is_lengthened(baud: int) -> None:
    bench = ready(baud=baud)
    assert bench.ask(Command.LIMITS, LimitTable.serialize_request((LimitRow(0, 4095, 200),) * 7)).status == 0
    bench.torque()
    sent = MoveReply.parse(bench.move({0: 2053 + 400}, 100).body)
    assert sent.duration_ms == 2000
    bench.run(1.0)
    assert bench.true_positions()[0] == pytest.approx(2253, abs=60)


def test_a_move_to_all_joints_by_the_broadcast_id() -> None:
    bench = ready()
    bench.torque()
    sent = MoveReply.parse(bench.move({0xFE: 2100}, 800).body)
    assert [r.servo_id for r in sent.rows] == list(range(7))
    bench.run(1.5)
    assert bench.true_positions() == pytest.approx([2100] * 7, abs=2)


def test_a_move_with_a_silent_servo_moves_the_others_and_says_so() -> None:
    bench = ready(baud=115200)
    bench.torque()
    bench.board.wire.servos[2].registers.put("id", 50)
    bench.run(0.2)
    reply = bench.move({1: 2100, 2: 2100}, 500)
    assert reply.status == Status.SERVO_SILENT
    assert [r.servo_id for r in MoveReply.parse(reply.body).rows] == [1]


@BAUDS
@pytest.mark.parametrize("ms", [800, *(pytest.param(ms, marks=pytest.mark.slow) for ms in (1500, 3000))])
def test_all_seven_joints_arrive_at_the_asked_time(baud: int, ms: int) -> None:
    bench = ready(baud=baud)
    targets = {i: START[i] + (700 if i % 2 else -700) for i in range(7)}
    bench.torque()
    before = bench.true_positions()
    bench.run(0.5)
    assert bench.true_positions() == pytest.approx(before, abs=0.6)
    begun = bench.now
    assert MoveReply.parse(bench.move(targets, ms).body).duration_ms == ms
    arrived: dict[int, float] = {}
    while bench.now < begun + 2 * ms / 1000:
        bench.run(0.005)
        for i, position in enumerate(bench.true_positions()):
            if abs(position - targets[i]) <= 2:
                arrived.setdefault(i, bench.now - begun)
    assert bench.true_positions() == pytest.approx(list(targets.values()), abs=2)
    assert list(bench.state().position) == pytest.approx(list(targets.values()), abs=2)
    # Within the 10 % asked for, and what a bus of 115200 takes to carry it.
    assert all(when == pytest.approx(ms / 1000, rel=0.10, abs=0.02) for when in arrived.values()), arrived
    assert len(arrived) == 7


# --- stop ------------------------------------------------------------------------------------------------------


def moving(baud: int = 115200, **options: object) -> Bench:
    bench = ready(baud=baud, **options)
    bench.torque()
    bench.move({i: START[i] + 900 for i in range(7)}, 2000)
    bench.run(1.0)
    return bench


@BAUDS
def test_stop_holds_where_the_joints_are(baud: int) -> None:
    bench = moving(baud)
    at = bench.true_positions()
    reply = bench.ask(Command.STOP, b"\0")
    assert (reply.status, parse_stop_reply(reply.body)) == (Status.OK, (0, ALL))
    bench.run(0.3)
    stopped = bench.true_positions()
    # They went at 450 counts/s: this is what the bus and the brakes may take.
    assert all(-3 <= b - a < 60 for a, b in zip(at, stopped, strict=True)), (at, stopped)
    bench.run(1.5)
    assert bench.true_positions() == pytest.approx(stopped, abs=30)
    assert bench.torques() == [True] * 7
    assert bench.state().board_flags & STOPPED_FLAG


def test_while_stopped_only_what_cannot_move_is_accepted() -> None:
    bench = ready()
    bench.torque(mask=0x0F)
    assert bench.ask(Command.STOP, b"\0").status == Status.OK
    refused = [
        (Command.JOINT_MOVE, MoveRequest(9, (MoveRow(1, 2000),)).serialize()),
        (Command.TORQUE, b"\1\x7f\0"),
        (Command.LIMITS, LimitTable.serialize_request((LimitRow(1, 2, 3),) * 7)),
        (Command.OFFSETS, OffsetTable.serialize_request((OffsetRow(1, 1),) * 7)),
        (Command.IO, b"\1\1"),
        (Command.SYNC_WRITE, sp.make_sync_write(0x2A, {0: u16(2100) + u16(100)})),
        (Command.READ, sp.make_write(4, 0x28, b"\1")),
        (Command.TRANSACT, TransactRequest(6, 20, sp.make_write(4, 0x28, b"\1")).serialize()),
        (Command.TRANSACT, TransactRequest(0, 20, sp.make_action()).serialize()),
        (Command.TRANSACT, TransactRequest(0, 20, sp.make_reboot(4)).serialize()),
    ]
    for cmd, body in refused:
        reply = bench.ask(cmd, body)
        assert (reply.status, reply.body) == (Status.STOPPED, b""), cmd
    accepted = [
        (Command.IDENTIFY, b""),
        (Command.JOINT_STATE, b"\0"),
        (Command.STATS, b""),
        (Command.REPORT, u16(0) + b"\0"),
        (Command.WATCHDOG, u16(0) + b"\0"),
        (Command.LIMITS, b""),
        (Command.OFFSETS, b""),
        (Command.IO, b"\0\0"),
        (Command.PING, sp.make_ping(1)),
        (Command.READ, sp.make_read(1, 56, 2)),
        (Command.TRANSACT, TransactRequest(8, 20, sp.make_read(1, 56, 2)).serialize()),
        (Command.STOP, b"\0"),
        (Command.TORQUE, b"\0\x7f\0"),
    ]
    for cmd, body in accepted:
        assert bench.ask(cmd, body).status == Status.OK, cmd
    assert bench.torques() == [False] * 7
    assert bench.true_positions() == pytest.approx(START, abs=1)


def sequences() -> list[tuple[str, list[tuple[int, bytes]]]]:
    move = MoveRequest(600, tuple(MoveRow(i, START[i] + 600) for i in range(7))).serialize()
    raw = TransactRequest(6, 20, sp.make_write(4, 0x2A, u16(2700))).serialize()
    return [
        ("torque", [(Command.TORQUE, b"\1\x7f\0")]),
        ("moves", [(Command.TORQUE, b"\1\x7f\0"), (Command.JOINT_MOVE, move), (Command.JOINT_MOVE, move)]),
        ("raw", [(Command.TRANSACT, raw), (Command.READ, sp.make_write(5, 0x2A, u16(2700)))] * 3),
        ("chapter", [(Command.SYNC_WRITE, sp.make_sync_write(0x2A, {i: u16(2700) + u16(9) for i in range(7)}))]),
    ]


FAULTS = [[], ["late:4:0.004:0.5", "silent:5:0.5"], ["bus.flip:0.1", "bus.drop:0.1"]]


def test_nothing_gets_torque_or_moves_after_a_stop_whenever_it_comes() -> None:
    for number, ((name, requests), faults) in enumerate(itertools.product(sequences(), FAULTS)):
        _stop_after(name, requests, faults, number % 2, [0.0, 0.0041, 0.0246])


@pytest.mark.slow
@pytest.mark.parametrize("mode", [0, 1])
@pytest.mark.parametrize("faults", FAULTS)
@pytest.mark.parametrize(("name", "requests"), sequences())
def test_nothing_gets_torque_or_moves_after_a_stop_at_any_moment(
    name: str, requests: list[tuple[int, bytes]], faults: list[str], mode: int
) -> None:
    _stop_after(name, requests, faults, mode, [i * 0.0041 for i in range(14)])


def _stop_after(
    name: str, requests: list[tuple[int, bytes]], faults: list[str], mode: int, delays: Sequence[float]
) -> None:
    for delay in delays:
        bench = ready(baud=115200, faults=faults)
        for cmd, body in requests:
            bench.send(cmd, body)
        bench.run(delay)
        reply = bench.ask(Command.STOP, bytes((mode,)))
        torques, positions = bench.torques(), bench.true_positions()
        bench.run(0.6)
        if faults[:1] != ["bus.flip:0.1"]:
            # A stop that a spoilt bus did not let through says so by its mask.
            assert reply.status == Status.OK or faults, (name, delay)
        on = [after and not before for before, after in zip(torques, bench.torques(), strict=True)]
        assert not any(on), (name, delay)
        _, mask = parse_stop_reply(reply.body)
        if mode:
            assert not any(t for i, t in enumerate(bench.torques()) if mask >> i & 1), (name, delay)
        confirmed = [i for i in range(7) if mask >> i & 1]
        drift = [abs(bench.true_positions()[i] - positions[i]) for i in confirmed]
        # What the brakes, or the gears without power, need from full speed.
        assert max(drift, default=0) < 150, (name, delay, drift)


# --- watchdog --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", [0, 1])
def test_the_watchdog_stops_by_itself_is_reported_and_needs_resume(mode: int) -> None:
    bench = ready()
    bench.torque()
    bench.move({0: 3000, 4: 3000}, 4000)
    assert bench.ask(Command.WATCHDOG, u16(200) + bytes((mode,))).status == Status.OK
    for _ in range(10):  # fed by whatever valid frame
        bench.run(0.15)
        bench.state(0)
    assert not bench.state(0).board_flags & STOPPED_FLAG
    bench.run(0.3)
    positions = bench.true_positions()
    bench.run(1.0)
    assert bench.torques() == ([False] * 7 if mode else [True] * 7)
    assert bench.true_positions() == pytest.approx(positions, abs=30)
    flags = bench.state(0).board_flags
    assert flags & STOPPED_FLAG
    assert flags & tables.BOARD_FLAGS_WATCHDOG_TRIPPED
    assert bench.torque().status == Status.STOPPED
    stats = Stats.parse(bench.ask(Command.STATS).body).counters
    assert stats["watchdog_trips"] == 1
    assert bench.ask(Command.RESUME).body[0] & (STOPPED_FLAG | tables.BOARD_FLAGS_WATCHDOG_TRIPPED) == 0
    bench.run(0.5)
    assert bench.state(0).board_flags & tables.BOARD_FLAGS_WATCHDOG_TRIPPED  # still armed


def test_repeats_feed_the_watchdog_and_frames_for_others_do_not() -> None:
    bench = ready()
    bench.ask(Command.WATCHDOG, u16(200) + b"\0")
    seq = bench.send(Command.STATS)
    for _ in range(8):
        bench.run(0.15)
        bench.send(Command.STATS, seq=seq)
    assert not bench.board.state.watchdog_tripped
    for _ in range(4):
        bench.run(0.15)
        bench.send(Command.STATS, dst=5)
    assert bench.board.state.watchdog_tripped


def test_a_watchdog_of_0_never_trips() -> None:
    bench = ready()
    bench.ask(Command.WATCHDOG, u16(100) + b"\0")
    bench.ask(Command.WATCHDOG, u16(0) + b"\0")
    bench.run(5)
    assert not bench.state(0).board_flags & STOPPED_FLAG


# --- reports ---------------------------------------------------------------------------------------------------


@BAUDS
@pytest.mark.parametrize("ms", [20, *(pytest.param(ms, marks=pytest.mark.slow) for ms in (50, 500))])
def test_reports_come_at_their_rate(baud: int, ms: int) -> None:
    bench = ready(baud=baud)
    bench.ask(Command.REPORT, u16(ms) + b"\x3f")
    bench.run(5)
    times = [when for when, f in bench.frames if f.is_unsolicited and f.cmd == Command.JOINT_STATE]
    assert len(times) == pytest.approx(5000 / ms, abs=2)
    gaps = [b - a for a, b in itertools.pairwise(times)]
    assert min(gaps) > 0.5 * ms / 1000
    assert max(gaps) < 1.5 * ms / 1000
    assert len({f.seq for f in bench.take()}) > 5
    bench.ask(Command.REPORT, u16(0) + b"\0")
    bench.take()
    bench.run(3)
    assert bench.take() == []


def test_reports_never_burst_after_the_bus_was_taken() -> None:
    bench = ready(baud=115200)
    bench.ask(Command.REPORT, u16(10) + b"\0")
    body = TransactRequest(100, 250, sp.make_ping(4)).serialize()
    for _ in range(4):
        bench.send(Command.TRANSACT, body)
    bench.run(2)
    times = [when for when, f in bench.frames if f.is_unsolicited]
    assert min(b - a for a, b in itertools.pairwise(times)) > 0.004


def test_a_board_whose_frames_are_not_taken_leaves_reports_out() -> None:
    bench = ready()
    bench.ask(Command.REPORT, u16(10) + b"\0")
    for i in range(1, 101):
        bench.board.step(bench.now + i / 100)
    bench.now += 1
    bench._collect()
    assert len(bench.take()) == 1


# --- settings, stats, io, raw packets --------------------------------------------------------------------------


def test_limits_and_offsets_survive_a_reset() -> None:
    bench = ready()
    limits = tuple(LimitRow(i, 4000 - i, 100 + i) for i in range(7))
    offsets = tuple(OffsetRow(2040 + i, -1 if i % 2 else 1) for i in range(7))
    assert bench.ask(Command.LIMITS, LimitTable.serialize_request(limits)).status == 0
    assert bench.state(0).board_flags & tables.BOARD_FLAGS_SETTINGS_DEFAULT
    assert bench.ask(Command.OFFSETS, OffsetTable.serialize_request(offsets)).status == 0
    assert not bench.state(0).board_flags & tables.BOARD_FLAGS_SETTINGS_DEFAULT
    before = Identity.parse(bench.ask(Command.IDENTIFY).body).boot_id
    bench.board.reset(bench.now)
    assert Identity.parse(bench.ask(Command.IDENTIFY).body).boot_id != before
    table = LimitTable.parse(bench.ask(Command.LIMITS).body)
    assert (table.version, table.rows) == (tables.SETTINGS_VERSION, limits)
    assert OffsetTable.parse(bench.ask(Command.OFFSETS).body).rows == offsets


def test_default_limits_and_offsets() -> None:
    bench = ready()
    assert LimitTable.parse(bench.ask(Command.LIMITS).body).rows == (LimitRow(0, 4095, 4096),) * 7
    assert OffsetTable.parse(bench.ask(Command.OFFSETS).body).rows == (OffsetRow(2047, 1),) * 7


@BAUDS
def test_transact_gives_the_answers_bytes_unswapped(baud: int) -> None:
    bench = ready(baud=baud)

    def ask(packet: bytes, length: int, ms: int = 0) -> tuple[int, bytes]:
        reply = bench.ask(Command.TRANSACT, TransactRequest(length, ms, packet).serialize())
        return reply.status, reply.body

    assert ask(sp.make_read(0, 56, 2), 8) == (0, bytes.fromhex("FF F5 00 04 00 08 05 EE"))
    assert ask(sp.make_read(4, 56, 15), 21)[1][:5] == bytes.fromhex("FF FF 04 11 00")
    assert ask(sp.make_read(9, 56, 2), 8) == (Status.SERVO_SILENT, b"")
    bench.torque()
    assert ask(sp.make_sync_write(0x28, {0: b"\0", 4: b"\0"}), 0) == (0, b"")
    # At once, not when the board has come round to reading it.
    assert [bool(s & 0x40) for s in bench.state(0).status] == [False, True, True, True, False, True, True]
    bench.run(0.1)
    assert [bool(s & 0x40) for s in bench.state(0).status] == [False, True, True, True, False, True, True]
    assert ask(sp.make_sync_read(56, 15, [4, 5, 6]), 63)[1].count(b"\xff\xff") == 3


def test_a_move_straight_after_raw_torque_off_is_refused() -> None:
    bench = ready(baud=115200)
    bench.torque()
    body = TransactRequest(0, 0, sp.make_sync_write(0x28, {0: b"\0"})).serialize()
    bench.send(Command.TRANSACT, body)
    assert bench.move({0: 2100}, 100).status == Status.TORQUE_OFF


OUTSIDE = [
    sp.make_write(0, 0x2A, (3000).to_bytes(2, "big")),
    sp.make_write(0, 0x2A, (3000).to_bytes(2, "big") + b"\0\x64"),
    sp.make_write(4, 0x2A, u16(3000)),
    sp.make_write(4, 0x29, b"\0" + u16(3000) + b"\x9a\0\x10\0"),
    sp.make_write(4, 0x28, b"\0\0" + u16(3000)),
    sp.make_write(4, 0x2A, u16(0x8000 | 5)),
    sp.make_write(4, 0x2A, b"\x08"),
    sp.make_write(4, 0x2B, b"\x0f"),
    sp.make_write(4, 0x29, b"\0\x08"),
    sp.make_sync_write(0x2A, {5: u16(2050), 6: u16(3000)}),
    sp.make_sync_write(0x29, {5: b"\0" + u16(2050), 6: b"\0" + u16(3000)}),
]


@pytest.mark.parametrize("packet", OUTSIDE)
@pytest.mark.parametrize("cmd", [Command.TRANSACT, Command.READ])
def test_a_raw_write_of_a_target_outside_the_limits_is_refused(cmd: Command, packet: bytes) -> None:
    bench = ready()
    limits = LimitTable.serialize_request((LimitRow(1500, 2800, 4000),) * 7)
    assert bench.ask(Command.LIMITS, limits).status == Status.OK
    bench.torque()
    bench.writes()
    body = packet if cmd == Command.READ else TransactRequest(6, 0, packet).serialize()
    assert bench.ask(cmd, body).status == Status.BAD_RANGE
    assert bench.writes() == []
    good = TransactRequest(6, 0, sp.make_write(4, 0x29, b"\0" + u16(2700) + u16(154) + u16(16))).serialize()
    assert bench.ask(Command.TRANSACT, good).status == Status.OK


def test_a_raw_write_is_sent_once_only() -> None:
    bench = ready(faults=["silent:4"])
    packet = sp.make_write(4, 0x30, u16(500))
    bench.ask(Command.READ, packet)
    assert bench.writes() == [packet]


def test_stats_count_up_and_in_their_order() -> None:
    bench = ready(baud=115200, faults=["silent:2"])
    first = Stats.parse(bench.ask(Command.STATS).body).counters
    bench.board.receive(b"\x5a\xfa\xfa\x5agarbage" + bytes(60), bench.now)
    seq = bench.send(Command.JOINT_STATE, b"\0")
    bench.run(0.1)
    bench.send(Command.JOINT_STATE, b"\0", seq=seq)
    bench.run(0.5)
    bench.take()
    second = Stats.parse(bench.ask(Command.STATS).body).counters
    assert all(second[name] >= first[name] for name in first)
    assert second["uptime_ms"] - first["uptime_ms"] == pytest.approx(600, abs=20)
    assert second["bytes_dropped"] > 0
    assert second["repeats"] == 1
    assert second["bus_timeouts"] > first["bus_timeouts"]
    assert second["frames_received"] == first["frames_received"] + 3
    assert len(bench.ask(Command.STATS).body) == 60


def test_io() -> None:
    bench = ready()
    assert bench.ask(Command.IO, b"\7\5").body == b"\7\5"
    assert bench.ask(Command.IO, b"\1\0").body == b"\1\4"
    assert bench.ask(Command.IO, b"\0\7").body == b"\0\4"


# --- repeats, addressing, other frames -------------------------------------------------------------------------


def test_a_repeat_of_what_is_not_answered_yet_is_executed_and_answered_once() -> None:
    bench = ready(baud=115200)
    seq = bench.send(Command.TORQUE, b"\1\x7f\0")
    bench.send(Command.TORQUE, b"\1\x7f\0", seq=seq)
    bench.run(0.5)
    assert len(bench.take()) == 1


def test_a_full_queue_is_busy_and_bounded() -> None:
    bench = ready(baud=115200)
    body = TransactRequest(100, 100, sp.make_ping(4)).serialize()
    for _ in range(60):
        bench.send(Command.TRANSACT, body)
    busy = [f for f in bench.take() if f.status == Status.BUSY]
    assert len(busy) >= 34
    bench.run(5)
    assert len(bench.take()) == 60 - len(busy)
    assert Stats.parse(bench.ask(Command.STATS).body).counters["queue_high_water"] == 24
