from __future__ import annotations

import math

import pytest

from hexwire.emulator.bus_arms import HEX7BOT_START, make_hex7bot_servos
from hexwire.emulator.hand import HandOrder, Hands
from hexwire.emulator.servo_wire import ServoWire
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.units import CHAPTER_RADIANS_PER_COUNT
from hexwire.wire import servo_packet as sp
from hexwire.wire.registers import Series

# Degrees printed in the chapter's log, and the offsets in radians that explain them.
PRINTED = (-4.47257, 54.6484, -3.55452, -0.703134, 3.1641, -0.0878917)
OFFSETS = (-0.087265, 0.95993, -0.04363, 0.0, 0.0, 0.0)


def test_seven_servos_of_two_kinds_without_torque() -> None:
    servos = make_hex7bot_servos()
    assert [servo.servo_id for servo in servos] == list(range(7))
    assert [servo.series for servo in servos] == [Series.SEVEN_BOT] * 4 + [Series.HLS] * 3
    assert {servo.baud for servo in servos} == {115200}
    assert not any(servo.torque_on for servo in servos)


@pytest.mark.parametrize("joint", range(6))
def test_start_positions_give_the_printed_angles(joint: int) -> None:
    angle = (HEX7BOT_START[joint] - 2047) * CHAPTER_RADIANS_PER_COUNT + OFFSETS[joint]
    assert f"{math.degrees(angle):.6g}" == f"{PRINTED[joint]:.6g}"


def test_the_chapters_log_is_answered_byte_for_byte() -> None:
    wire = ServoWire(make_hex7bot_servos(), baud=115200)
    assert wire.transact(bytes.fromhex("FF FF 06 04 02 3C 02 B5"), 14.0)[0].hex() == "ffff0604003400c1"
    assert wire.transact(bytes.fromhex("FF FF 00 04 02 38 02 BF"), 14.1)[0].hex() == "fff50004000805ee"


def test_the_arm_stays_where_it_is_without_power() -> None:
    wire = ServoWire(make_hex7bot_servos(start=50.0))
    wire.step(60.0)
    assert tuple(servo.present_position for servo in wire.servos) == HEX7BOT_START


@pytest.mark.parametrize("joint", range(7))
def test_joints_end_at_stops_beyond_the_limits_of_the_arm(joint: int) -> None:
    model, beyond = HEX7BOT.joints[joint], 30.0 if joint == 6 else 5.0
    for sign, limit in ((1, model.maximum), (-1, model.minimum)):
        servos = make_hex7bot_servos()
        grip = Hands(servos, HEX7BOT).take(HandOrder(model.name, sign * 360.0, 8.0, force=0.5), 0.0)
        result = grip.step(10.0)
        assert result is not None
        assert result.blocked
        there = model.counts_to_angle(servos[joint].motion.position)
        assert math.degrees(there) == pytest.approx(math.degrees(limit) + sign * beyond, abs=0.1)


def test_gravity_can_be_seen_and_held() -> None:
    wire = ServoWire(make_hex7bot_servos())
    wire.transact(sp.make_write(sp.BROADCAST_ID, 40, b"\x01"), 0.0)
    wire.step(1.0)
    assert tuple(servo.present_position for servo in wire.servos) == HEX7BOT_START
    assert wire[2].motion.torque == pytest.approx(0.10, abs=0.01)
    answer, _ = wire.transact(sp.make_read(4, 60, 2), 1.0)
    found = sp.find_status(answer, 4, 2)
    assert found is not None
    assert Series.HLS.register("present_load").decode(found[0].params) == pytest.approx(50, abs=2)


def test_seeds_are_used_for_noise_only() -> None:
    for servo, other in zip(make_hex7bot_servos(seed=1), make_hex7bot_servos(seed=2), strict=True):
        servo.refresh()
        other.refresh()
        assert servo.registers.read(0, 256) == other.registers.read(0, 256)
