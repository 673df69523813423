"""Which answers of a dialect-1 board are believed, seen from the driver that reads through it."""

from __future__ import annotations

import math

import pytest
from tests.drivers.arms import Arm

from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.wire import servo_packet as sp


def test_a_late_servo_never_gives_its_answer_to_another() -> None:
    arm = Arm(1, 115200, ("late:1:0.15:0.5", "late:5:0.3:0.4"))
    truth = [2053, 2043, 2035, 2039, 2083, 2046, 2047]
    for _ in range(40):
        state = arm.driver.read()
        for reading, joint, counts in zip(state, HEX7BOT.joints, truth, strict=True):
            assert math.isnan(reading.position) or joint.angle_to_counts(reading.position) == counts


def test_a_ping_through_an_echoing_adapter_asks_by_a_read() -> None:
    arm = Arm(1, 115200, ("bus.echo", "overload:5", "silent:6"))
    assert [arm.driver.ping(servo_id) for servo_id in range(7)] == [0, 0, 0, 0, 0, 0x20, None]


def test_an_echoing_adapter_is_seen_through() -> None:
    state = Arm(1, 0, ("host.echo",)).driver.read()
    assert state.silent == ()
    assert math.degrees(state["J1"].position) == pytest.approx(-4.47257, abs=1e-4)  # as the chapter prints it


@pytest.mark.parametrize("faults", [("bus.echo",), ("bus.echo", "bus.junk:0.2"), ("bus.junk:0.3", "bus.flip:0.2")])
def test_junk_and_echoes_on_the_boards_bus_give_no_wrong_value(faults: tuple[str, ...]) -> None:
    arm = Arm(1, 115200, faults)
    truth = [2053, 2043, 2035, 2039, 2083, 2046, 2047]
    seen = 0
    for _ in range(30):
        state = arm.driver.read()
        for reading, joint, counts in zip(state, HEX7BOT.joints, truth, strict=True):
            assert math.isnan(reading.position) or joint.angle_to_counts(reading.position) == counts
            seen += not math.isnan(reading.position)
    assert seen


@pytest.mark.parametrize("echo", [(), ("bus.echo",)])
def test_an_hls_servo_that_answers_in_the_bytes_of_its_request_is_read_by_its_neighbours(echo: tuple[str]) -> None:
    arm = Arm(1, 0, echo)
    servo = arm.board.wire[4]
    plain = servo.receive
    memory = bytes(56) + b"\x38\x02" + bytes(200)

    def receive(packet: sp.ServoPacket, now: float) -> bytes | None:
        if packet.instruction == sp.Instruction.READ and packet.servo_id == 4:
            first, count = packet.params
            return sp.make_status(4, 2, memory[first : first + count])
        return plain(packet, now)

    servo.receive = receive
    joint = HEX7BOT.joint("J5")
    assert joint.servo_id == 4
    state = arm.driver.read()
    assert joint.angle_to_counts(state["J5"].position) == 568


def test_a_damaged_echo_is_no_value_of_a_legacy_servo() -> None:
    arm = Arm(1, 0)
    servo = arm.board.wire[0]
    servo.receive = lambda packet, now: sp.make_status(0, 0, b"\x12\x05")
    assert math.isnan(arm.driver.read()["J1"].position)
