"""Hands that move emulated joints."""

from __future__ import annotations

import pytest

from hexwire.emulator.bus_arms import make_hex7bot_servos
from hexwire.emulator.hand import Grip, Hand, HandOrder, HandResult, Hands, usual_seconds
from hexwire.emulator.servo import EmulatedServo
from hexwire.emulator.servo_motion import TICK, Mechanics, Motion, MotorDrive
from hexwire.errors import UsageError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.wire.registers import Series

DEGREE = 4096 / 360


def servo(**options: object) -> EmulatedServo:
    return EmulatedServo(Series.STS_SMS, 3, position=2048, **options)  # type: ignore[arg-type]


def finish(grip: Grip, start: float = 0.0) -> HandResult:
    for count in range(1, 1000):
        result = grip.step(start + count * 0.05)
        if result is not None:
            return result
    raise AssertionError("the hand never lets go")


def hold(one: EmulatedServo, *, torque_limit: int = 1000) -> None:
    registers = one.series.registers
    one._write(registers["torque_limit"].address, torque_limit.to_bytes(2, "little"))
    one._write(registers["torque_enable"].address, b"\x01")


@pytest.mark.parametrize("degrees", [40.0, -40.0, 0.5, 300.0])
def test_a_joint_without_torque_goes_along_and_stays(degrees: float) -> None:
    one = servo()
    result = finish(Hands([one]).take(HandOrder("3", degrees, usual_seconds(degrees)), 0.0))
    assert result == HandResult("servo 3", pytest.approx(degrees, abs=0.2), False, False)
    one.step(60.0)
    assert one.motion.position == pytest.approx(2048 + degrees * DEGREE, abs=2)
    assert one.motion.settled


def test_the_motion_takes_its_time_and_has_no_jerk() -> None:
    motion = Motion(Mechanics(5000.0), 1000.0)
    Hand(motion, 500.0, 0.5, 0.0, 1.0)
    halfway, fastest, before = 0.0, 0.0, 0.0
    for count in range(700):
        motion.tick()
        # Twice the greatest acceleration of the path: the hand does not tear at the joint.
        assert abs(motion.velocity - before) < 2 * 5.8 * 500 / 0.5**2 * TICK
        fastest, before = max(fastest, motion.velocity), motion.velocity
        halfway = motion.position if count == 250 else halfway
    assert halfway == pytest.approx(1250.0, abs=10)
    assert fastest == pytest.approx(1.875 * 500 / 0.5, rel=0.05)


def test_a_joint_with_torque_gives_way_like_a_spring_and_goes_back() -> None:
    one = servo()
    hold(one)
    result = finish(Hands([one]).take(HandOrder("3", 40.0, 0.5), 0.0))
    # A hand of 0.6 of the stall torque against 1/64 a count and the friction of 0.02.
    assert result == HandResult("servo 3", pytest.approx(0.58 * 64 / DEGREE, abs=0.2), True, False)
    one.step(60.0)
    assert one.motion.position == pytest.approx(2048, abs=1.5)
    assert one.motion.settled


def test_a_joint_with_little_torque_is_overcome_and_goes_back() -> None:
    one = servo()
    hold(one, torque_limit=300)
    result = finish(Hands([one]).take(HandOrder("3", 40.0, 0.5), 0.0))
    assert result.moved == pytest.approx(40.0, abs=1.0)
    one.step(60.0)
    assert one.motion.position == pytest.approx(2048, abs=1.5)


def test_too_little_force_does_not_move_the_gears() -> None:
    one = servo()
    result = finish(Hands([one]).take(HandOrder("3", 40.0, 0.5, force=0.1), 0.0))
    assert result.moved == pytest.approx(0.0, abs=0.1)


def test_a_hand_ends_at_the_stops_of_the_arm_and_so_does_the_motor() -> None:
    one = servo(stops=(1900.0, 2200.0))
    result = finish(Hands([one]).take(HandOrder("3", 40.0, 0.5), 0.0))
    assert result == HandResult("servo 3", pytest.approx((2200 - 2048) / DEGREE, abs=0.01), False, True)
    one._write(one.series.registers["goal_position"].address, (1000).to_bytes(2, "little"))
    one.step(30.0)
    assert one.motion.position == 1900.0
    assert one.motion.blocked


def test_a_hand_holds_a_joint_against_gravity_until_it_lets_go() -> None:
    one = servo(gravity=lambda shaft: -0.3)
    grip = Hands([one]).take(HandOrder("3", 20.0, 0.5, hold=2.0), 0.0)
    assert grip.step(2.5) is None
    assert one.motion.position == pytest.approx(2048 + 20 * DEGREE, abs=3)
    assert finish(grip, 2.5).moved == pytest.approx(20.0, abs=0.3)
    before = one.motion.position
    one.step(10.0)
    assert one.motion.position < before - 100


def test_it_can_let_go_early() -> None:
    one = servo()
    grip = Hands([one]).take(HandOrder("3", 40.0, 1.0), 0.0)
    assert grip.step(0.5) is None
    grip.let_go()
    assert grip.step(0.51) == HandResult("servo 3", pytest.approx(20.0, abs=1.0), False, False)
    one.step(5.0)
    assert one.motion.position == pytest.approx(2048 + 20 * DEGREE, abs=30)


def test_only_one_hand_at_a_joint_and_one_at_each_other() -> None:
    servos = [servo(), EmulatedServo(Series.STS_SMS, 4)]
    hands = Hands(servos)
    grip = hands.take(HandOrder("3", 10.0, 0.5), 0.0)
    with pytest.raises(UsageError, match="another hand holds servo 3"):
        hands.take(HandOrder("3", 10.0, 0.5), 0.1)
    hands.take(HandOrder("4", 10.0, 0.5), 0.1)
    finish(grip)
    hands.take(HandOrder("3", 10.0, 0.5), 9.0)


def test_a_restart_of_the_servo_ends_the_hand() -> None:
    # The shaft is counted anew then: the hand would pull to another place.
    one = EmulatedServo(Series.STS_SMS, 3, position=4090)
    grip = Hands([one]).take(HandOrder("3", 30.0, 0.5), 0.0)
    grip.step(0.45)
    assert one.motion.position > 4096
    one.power_cycle(0.45)
    assert grip.step(0.5) is not None
    assert 0 <= one.motion.position < 400


def test_joints_are_named_by_the_arm_in_any_case_and_by_servo() -> None:
    hands = Hands(make_hex7bot_servos(), HEX7BOT)
    assert finish(hands.take(HandOrder("j4", 5.0, 0.3), 0.0)).joint == "J4"
    assert finish(hands.take(HandOrder("3", 5.0, 0.3), 20.0), 20.0).joint == "J4"
    for word in ("J9", "9", "٣", "-1", ""):
        with pytest.raises(UsageError, match=r"J1, J2|0, 1, 2"):
            hands.take(HandOrder(word, 5.0, 0.3), 30.0)


def test_a_motor_that_moves_goes_on_to_its_goal_afterwards() -> None:
    one = servo()
    hold(one)
    address = one.series.registers["goal_position"].address
    one._write(address, (2500).to_bytes(2, "little"))
    one.step(0.05)
    finish(Hands([one]).take(HandOrder("3", -10.0, 0.3), 0.05), 0.05)
    one.step(20.0)
    assert (one.motion.position, one.motion.torque) == (2500.0, 0.0)


def test_it_works_for_a_motor_that_is_driven_by_torque_or_speed() -> None:
    for drive in (MotorDrive.TORQUE, MotorDrive.SPEED, MotorDrive.DAMPED):
        motion = Motion(Mechanics(5000.0), 1000.0)
        motion.command(drive, target=0.0, speed=0.0, acceleration=0.0, ceiling=0.3)
        hand = Hand(motion, 100.0, 0.3, 0.0, 0.6)
        for _ in range(600):
            motion.tick()
        assert hand.has_let_go
        assert hand.position == pytest.approx(1100.0, abs=40)


def test_a_hand_takes_a_pleasant_time() -> None:
    assert usual_seconds(-120.0) == 2.0
    assert usual_seconds(1.0) == 0.3
