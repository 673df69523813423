"""The order of stops, and what a hold makes of servos that do not play along."""

from __future__ import annotations

import pytest
from tests.emulator.boards import Bench
from tests.frames import frame_bytes

from hexwire.emulator.board_stop import StopQueue
from hexwire.session.events import Request
from hexwire.wire.command_frame import Command, Status, parse_frame
from hexwire.wire.commands import FragmentHead, MoveRequest, MoveRow, parse_stop_reply

START = (2053, 2043, 2035, 2039, 2083, 2046, 2047)


def request(seq: int) -> Request:
    return Request(parse_frame(frame_bytes(Command.STOP, b"\0", seq=seq)))


def ready(**options: object) -> Bench:
    bench = Bench(baud=115200, **options)
    bench.run(0.3)
    return bench


def test_stops_of_a_mode_are_answered_together_and_taking_torque_goes_first() -> None:
    stops = StopQueue()
    holds = [request(i) for i in range(3)]
    off = request(9)
    assert stops.add(0, holds[0])
    assert stops.start() == 0
    # One that comes while its mode is under way joins it; the watchdog asks for no answer.
    assert stops.add(0, holds[1])
    assert stops.add(0, None)
    assert not stops
    assert stops.add(1, off)
    assert stops.interrupts
    stops.put_back()
    assert stops.add(0, holds[2])
    assert stops.start() == 1
    assert not stops.interrupts
    assert stops.finish() == [off]
    assert stops.start() == 0
    assert stops.finish() == holds
    assert not stops


def test_there_is_room_for_sixteen_answers_and_always_for_the_watchdog() -> None:
    stops = StopQueue()
    assert all(stops.add(0, request(i)) for i in range(10))
    stops.start()
    assert all(stops.add(i % 2, request(10 + i)) for i in range(6))
    assert not stops.add(0, request(16))
    assert not stops.add(1, request(17))
    assert stops.add(1, None)


def test_a_joint_that_does_not_take_its_target_loses_its_torque() -> None:
    bench = ready()
    bench.torque()
    servo = bench.board.wire[5]
    # Its register of the target is stuck.
    read = servo.registers.read
    servo.registers.read = lambda address, count: (  # type: ignore[method-assign]
        b"\x64\0" if (address, count) == (0x2A, 2) else read(address, count)
    )
    reply = bench.ask(Command.STOP, b"\0")
    assert (reply.status, parse_stop_reply(reply.body)) == (Status.SERVO_FAULT, (0, 0x7F))
    assert bench.torques() == [i != 5 for i in range(7)]


def test_a_joint_that_is_pushed_on_loses_its_torque() -> None:
    bench = ready()
    bench.torque()
    shaft = bench.board.wire[4].motion
    shaft.external_torque, shaft.stops = 3.0, None
    bench.run(0.02)
    reply = bench.ask(Command.STOP, b"\0")
    assert reply.status == Status.SERVO_FAULT
    assert bench.torques() == [i != 4 for i in range(7)]


def test_a_servo_that_fell_silent_with_torque_is_told_to_let_go_and_is_not_confirmed() -> None:
    bench = ready()
    bench.torque()
    servo = bench.board.wire.servos[4]
    receive = servo.receive
    # It hears, and its answers are lost.
    servo.receive = lambda packet, now: receive(packet, now) and None  # type: ignore[func-returns-value,method-assign]
    bench.run(0.1)
    reply = bench.ask(Command.STOP, b"\0")
    assert (reply.status, parse_stop_reply(reply.body)) == (Status.SERVO_SILENT, (0, 0x6F))
    assert bench.torques() == [i != 4 for i in range(7)]


def test_a_stop_before_the_board_knows_its_servos_holds_those_with_torque() -> None:
    bench = Bench(baud=115200)
    bench.run(0.3)
    bench.torque()
    bench.move({i: START[i] + 800 for i in range(7)}, 3000)
    bench.run(0.5)
    bench.board.reset(bench.now)
    bench.run(0.002)
    assert bench.ask(Command.STOP, b"\0").status == Status.OK
    at = bench.true_positions()
    bench.run(2.0)
    assert bench.true_positions() == pytest.approx(at, abs=40)
    assert bench.torques() == [True] * 7
    bench.ask(Command.RESUME)
    assert bench.move({4: START[4]}, 500).status == Status.OK


def test_a_message_that_began_before_a_stop_is_void() -> None:
    bench = ready()
    bench.torque()
    body = MoveRequest(300, tuple(MoveRow(i, 2500) for i in range(7))).serialize()
    chunks = [
        FragmentHead(0x0142, i, 2, Command.JOINT_MOVE, 0).serialize() + part
        for i, part in enumerate((body[:12], body[12:]))
    ]
    bench.send(Command.FRAGMENT, chunks[0])
    bench.ask(Command.STOP, b"\0")
    bench.ask(Command.RESUME)
    bench.send(Command.FRAGMENT, chunks[1])
    bench.run(0.6)
    assert bench.true_positions() == pytest.approx(START, abs=2)
