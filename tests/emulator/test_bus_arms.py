"""The servos of SO-100 and SO-101 arms."""

from __future__ import annotations

import math

import pytest

from hexwire.drivers.arm_file import load_profile
from hexwire.emulator.bus_arms import EmulatedArm, make_bus_arm
from hexwire.emulator.hand import HandOrder, Hands
from hexwire.model.arms import arm_names, arm_record

DEGREE = 4096 / 360
ASSEMBLED = [name for name in arm_names() if arm_record(name).assembly is not None]


def angle(arm: EmulatedArm, name: str) -> float:
    index = arm.model.index(name)
    return math.degrees(arm.model.joints[index].counts_to_angle(arm.servos[index].motion.position))


def pull(arm: EmulatedArm, name: str, degrees: float) -> None:
    hands = Hands(arm.servos, arm.model)
    grip = hands.take(HandOrder(name, degrees, 10.0, force=1.0), 0.0)
    assert grip.step(20.0) is not None


@pytest.mark.parametrize("name", ASSEMBLED)
def test_it_has_the_joints_of_the_profile_and_factory_settings(name: str) -> None:
    arm, profile = make_bus_arm(name), load_profile(name).model
    assert arm.model.names == profile.names
    for servo, joint in zip(arm.servos, profile.joints, strict=True):
        get = servo.registers.get
        assert (servo.servo_id, servo.series.value) == (joint.servo_id, joint.series)
        assert (get("model_major"), get("model_minor"), servo.baud) == (9, 3, 1_000_000)
        assert (get("position_offset"), get("min_position_limit"), get("max_position_limit")) == (0, 0, 4095)
        assert not servo.torque_on


@pytest.mark.parametrize("name", ASSEMBLED)
@pytest.mark.parametrize("seed", [0, 1, 7])
def test_its_horns_are_mounted_at_the_nearest_tooth(name: str, seed: int) -> None:
    arm = make_bus_arm(name, seed=seed)
    off = [joint.neutral - 2048 for joint in arm.model.joints]
    assert all(abs(counts) <= 82 for counts in off)
    assert len(set(off)) == 6
    assert [joint.neutral - 2048 for joint in make_bus_arm(name, seed=seed + 1).model.joints] != off


def test_horns_anywhere_make_ranges_that_pass_the_end_of_the_turn() -> None:
    wrapped = 0
    for seed in range(10):
        for servo in make_bus_arm("so101", any_horns=True, seed=seed).servos:
            assert 0 <= servo.motion.position < 4096
            stops = servo.motion.stops
            wrapped += stops is not None and (stops[0] < 0 or stops[1] >= 4096)
    assert wrapped > 10


@pytest.mark.parametrize("leader", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_joints_end_at_stops_beyond_the_limits_of_the_profile(leader: bool) -> None:
    profile = load_profile("so101").model
    for joint in profile.joints:
        if joint.name == "wrist_roll":
            continue
        for sign, limit in ((1, joint.maximum), (-1, joint.minimum)):
            arm = make_bus_arm("so101", leader=leader)
            pull(arm, joint.name, sign * 300.0)
            assert angle(arm, joint.name) == pytest.approx(math.degrees(limit) + 5 * sign, abs=0.1)


def test_the_wrist_turns_without_end() -> None:
    arm = make_bus_arm("so101")
    pull(arm, "wrist_roll", 500.0)
    assert angle(arm, "wrist_roll") == pytest.approx(500.0, abs=2.0)
    assert 0 <= arm.servos[4].present_position < 4096


def test_a_driven_joint_ends_at_the_stop_too() -> None:
    arm = make_bus_arm("so101")
    servo = arm.servos[2]
    servo._write(servo.series.registers["goal_position"].address, (4000).to_bytes(2, "little"))
    servo.step(5.0)
    assert servo.motion.blocked
    assert angle(arm, "elbow_flex") == pytest.approx(101.8, abs=0.1)


def test_stops_stay_where_they_are_when_the_servo_restarts() -> None:
    servos = [servo for seed in range(10) for servo in make_bus_arm("so101", any_horns=True, seed=seed).servos]
    wrapped = next(servo for servo in servos if servo.motion.stops is not None and servo.motion.stops[1] > 4096)
    assert wrapped.motion.stops is not None
    width = wrapped.motion.stops[1] - wrapped.motion.stops[0]
    grip = Hands([wrapped]).take(HandOrder(str(wrapped.servo_id), 400.0, 10.0, force=1.0), 0.0)
    assert grip.step(20.0) is not None
    assert wrapped.motion.position == wrapped.motion.stops[1] > 4096
    wrapped.power_cycle(20.0)
    assert 0 <= wrapped.motion.position < 4096
    assert wrapped.motion.stops == (wrapped.motion.position - width, wrapped.motion.position)


def test_gears_hold_the_arm_and_those_of_a_leader_yield_to_less() -> None:
    arm = make_bus_arm("so101")
    before = [servo.motion.position for servo in arm.servos]
    for servo in arm.servos:
        servo.step(5.0)
    assert [servo.motion.position for servo in arm.servos] == before
    for leader, goes in ((False, False), (True, True)):
        arm = make_bus_arm("so101", leader=leader)
        result = Hands(arm.servos, arm.model).take(HandOrder("gripper", 20.0, 1.0, force=0.1), 0.0).step(5.0)
        assert result is not None
        assert (abs(result.moved) > 15.0) is goes
