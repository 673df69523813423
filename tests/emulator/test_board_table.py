"""Register tables on the emulated board: the pieces on the servo line, and what is left alone."""

from __future__ import annotations

import pytest
from tests.emulator.boards import Bench

from hexwire.wire.command_frame import Command, Status
from hexwire.wire.servo_table import ServoTable

READ, WRITE = 0x02, 0x03


@pytest.fixture
def bench() -> Bench:
    made = Bench()
    made.run(0.3)
    return made


def pieces(bench: Bench, servo: int, instruction: int, since: int) -> list[tuple[int, int]]:
    """Address and length of the packets of a kind for a servo."""
    packets = [packet for _, packet in bench.bus_sent[since:] if packet[2] == servo and packet[4] == instruction]
    return [(p[5], p[6] if instruction == READ else len(p) - 7) for p in packets]


@pytest.mark.parametrize(
    ("servo", "first", "count", "expected"),
    [
        (5, 0, 128, [(0, 64), (64, 64)]),
        (5, 7, 100, [(7, 64), (71, 36)]),
        (1, 5, 5, [(5, 2), (7, 2), (9, 1)]),
    ],
)
def test_a_table_is_read_in_as_many_pieces_as_the_series_needs(
    bench: Bench, servo: int, first: int, count: int, expected: list[tuple[int, int]]
) -> None:
    since = len(bench.bus_sent)
    reply = bench.ask(Command.SERVO_TABLE, ServoTable(servo, first, count).serialize())
    assert reply.status == Status.OK
    assert pieces(bench, servo, READ, since) == expected


def test_a_servo_that_answers_late_is_asked_once_more() -> None:
    bench = Bench(faults=["silent:5"])
    bench.run(0.3)
    since = len(bench.bus_sent)
    assert bench.ask(Command.SERVO_TABLE, ServoTable(5, 0, 200).serialize()).status == Status.SERVO_SILENT
    assert pieces(bench, 5, READ, since) == [(0, 64), (0, 64)]


def test_a_write_reads_writes_and_reads_back_what_differs(bench: Bench) -> None:
    assert bench.ask(Command.MAINTENANCE, b"\1").status == Status.OK
    data = bytearray(bench.board.wire[5].registers.read(6, 34))
    data[33] = (data[33] + 1) & 0x3F
    since = len(bench.bus_sent)
    assert bench.ask(Command.SERVO_TABLE, ServoTable(5, 6, 34, bytes(data)).serialize()).status == Status.OK
    assert pieces(bench, 5, WRITE, since) == [(38, 2)]
    assert [p for p in pieces(bench, 5, READ, since) if p[0] in (6, 38)] == [(6, 32), (38, 2), (38, 2)]


def test_what_a_servo_does_not_keep_is_told(bench: Bench) -> None:
    bench.ask(Command.MAINTENANCE, b"\1")
    table = ServoTable(5, 66, 1, b"\x55").serialize()
    assert bench.ask(Command.SERVO_TABLE, table).status == Status.SERVO_FAULT


def test_torque_off_by_a_table_is_known_at_once(bench: Bench) -> None:
    bench.ask(Command.MAINTENANCE, b"\1")
    joint = bench.board.state.joints[5]
    joint.torque_on, joint.unsure = True, False
    assert bench.ask(Command.SERVO_TABLE, ServoTable(5, 40, 1, b"\0").serialize()).status == Status.OK
    assert not joint.torque_on
    assert joint.unsure
