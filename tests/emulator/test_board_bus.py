from __future__ import annotations

import pytest
from tests.emulator.boards import ALL, Bench, u16

from hexwire.emulator.board_bus import BusBuffer
from hexwire.wire import servo_packet as sp
from hexwire.wire.command_frame import Command, Status
from hexwire.wire.commands import Stats, TransactRequest


def test_bytes_are_there_from_their_time_on_and_are_read_once() -> None:
    buffer = BusBuffer()
    buffer.put(b"ab", 1.0)
    buffer.put(b"c", 2.0)
    assert (buffer.waiting(0.9), buffer.read(0.9)) == (0, b"")
    assert (buffer.waiting(1.0), buffer.waiting(2.0)) == (2, 3)
    assert buffer.read(1.5) == b"ab"
    assert buffer.read(1.5) == b""
    assert (buffer.waiting(3.0), buffer.read(3.0)) == (1, b"c")


def counters(bench: Bench) -> dict[str, int]:
    return Stats.parse(bench.ask(Command.STATS).body).counters


@pytest.mark.parametrize("baud", [0, 115200])
def test_an_echo_on_the_bus_changes_nothing(baud: int) -> None:
    plain, echoing = Bench(baud=baud), Bench(baud=baud, faults=["echo"])
    for bench in (plain, echoing):
        bench.run(0.3)
        assert bench.torque().status == Status.OK
        bench.move({0: 2200, 4: 2200}, 400)
        bench.run(1)
    assert echoing.state().position == plain.state().position
    raw = TransactRequest(8, 0, sp.make_read(0, 56, 2)).serialize()
    assert echoing.ask(Command.TRANSACT, raw).body == plain.ask(Command.TRANSACT, raw).body
    assert echoing.ask1(Command.READ, sp.make_read(1, 56, 2)) == plain.ask1(Command.READ, sp.make_read(1, 56, 2))
    assert counters(echoing)["bus_bad"] == 0


@pytest.mark.parametrize("late", [0.003, 0.008, 0.05, 0.4])
@pytest.mark.parametrize("servo_id", [1, 5])
def test_a_late_answer_is_never_taken_for_another_servos(servo_id: int, late: float) -> None:
    bench = Bench(baud=115200, faults=[f"late:{servo_id}:{late}:0.5"])
    bench.run(0.2)
    start = (2053, 2043, 2035, 2039, 2083, 2046, 2047)
    for _ in range(60):
        report = bench.state()
        for i, position in enumerate(report.position):
            assert position == start[i] or (i == servo_id and report.age is not None and report.age[i] == 0xFFFF)
        bench.run(0.02)
    assert late < 0.005 or counters(bench)["bus_timeouts"] > 0


@pytest.mark.parametrize("kind", ["flip", "drop", "dup", "junk", "cut"])
def test_a_spoilt_bus_gives_true_positions_and_counts_every_loss(kind: str) -> None:
    bench = Bench(baud=115200, faults=[f"bus.{kind}:0.04"], seed=8)
    bench.run(0.2)
    bench.torque()
    bench.move(dict.fromkeys(range(7), 2600), 4000)
    for _ in range(150):
        report = bench.state()
        true = bench.true_positions()
        assert report.age is not None
        for position, where, age in zip(report.position, true, report.age, strict=True):
            # 150 counts a second, and what the bus takes to say so.
            assert abs(position - where) <= 2 + 160 * (age / 1000 + 0.02)
        bench.run(0.02)
    stats = counters(bench)
    assert stats["bus_timeouts"] + stats["bus_bad"] > 20 or kind == "junk"
    assert stats["bus_retries"] > 0 or kind == "junk"


def test_a_babbling_servo_does_not_hide_the_others() -> None:
    bench = Bench(baud=115200, faults=["babble:2:0.3"])
    for _ in range(50):
        bench.run(0.05)
        report = bench.state()
        assert report.position == (2053, 2043, 2035, 2039, 2083, 2046, 2047)


def test_a_servo_that_was_without_supply_shows_its_lost_torque() -> None:
    bench = Bench(baud=115200)
    bench.run(0.2)
    bench.torque()
    servo = bench.board.wire[4]
    servo.power_cycle(bench.now, 0.3)
    bench.run(0.1)
    assert bench.state(0).status[4] & 0x80
    bench.run(0.6)
    assert bench.state(0).status[4] == 0
    assert bench.move({4: 2100}).status == Status.TORQUE_OFF


def test_at_start_a_joint_with_torque_stops_where_it_is() -> None:
    bench = Bench(baud=115200)
    bench.run(0.2)
    bench.torque(mask=0x11)
    bench.move({0: 3500, 4: 3500}, 3000)
    bench.run(1.0)
    bench.board.reset(bench.now)
    at = bench.true_positions()
    bench.run(1.0)
    stopped = bench.true_positions()
    assert stopped == pytest.approx(at, abs=60)
    bench.run(1.0)
    assert bench.true_positions() == pytest.approx(stopped, abs=1)
    assert bench.torques() == [True, False, False, False, True, False, False]
    assert [bool(s & 0x40) for s in bench.state(0).status] == bench.torques()


def test_the_ceiling_of_an_hls_servo_is_the_one_found_at_start() -> None:
    bench = Bench(baud=115200)
    bench.board.wire[5].registers.put("goal_torque", 99)
    bench.run(0.3)
    bench.torque()
    bench.move({4: 2200, 5: 2200}, 500)
    assert bench.board.wire[5].registers.get("goal_torque") == 99
    four = bench.board.wire[4].registers
    assert four.get("goal_torque") == four.get("protection_current") > 0


def test_the_blocks_that_go_to_each_series() -> None:
    bench = Bench()
    bench.run(0.1)
    bench.torque()
    sent: list[bytes] = []
    transact = bench.board.wire.transact

    def spy(packet: bytes, now: float) -> tuple[bytes, float]:
        sent.append(packet)
        return transact(packet, now)

    bench.board.wire.transact = spy  # type: ignore[method-assign]  # a spy
    bench.move({0: 2153, 4: 2583}, 1000)
    writes = [p for p in sent if p[4] == 0x83]
    ceiling = bench.board.wire[4].registers.get("protection_current")
    assert writes == [
        sp.make_sync_write(0x2A, {0: (2153).to_bytes(2, "big") + (1000).to_bytes(2, "big")}),
        sp.make_sync_write(0x29, {4: b"\0" + u16(2583) + u16(ceiling) + u16(10)}),
    ]


def test_a_servo_that_is_not_in_position_mode_gets_no_torque() -> None:
    """With it the servo would turn at once."""
    bench = Bench()
    bench.run(0.3)
    bench.board.wire[5].registers.put("mode", 1)
    reply = bench.torque()
    assert reply.status == Status.SERVO_FAULT
    assert int.from_bytes(reply.body[1:], "little") == ALL & ~(1 << 5)
    assert bench.torques() == [i != 5 for i in range(7)]


def test_a_torque_write_that_got_lost_is_sent_again() -> None:
    missed = 0
    for seed in range(30):
        bench = Bench(baud=115200, faults=["bus.drop:0.05"], seed=seed)
        bench.run(0.3)
        reply = bench.torque(False)
        mask = int.from_bytes(reply.body[1:], "little")
        missed += mask != ALL
        assert not any(on for i, on in enumerate(bench.torques()) if mask >> i & 1)
    assert missed < 5
