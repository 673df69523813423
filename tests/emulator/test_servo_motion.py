from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.emulator.servo_motion import TICK, Mechanics, Motion, MotorDrive, speed_for_duration

FAST = Mechanics(max_speed=5000.0)


def move_to(
    motion: Motion, target: float, *, speed: float = 2000.0, acceleration: float = 0.0, ceiling: float = 1.0
) -> None:
    motion.command(MotorDrive.POSITION, target=target, speed=speed, acceleration=acceleration, ceiling=ceiling)


def run(motion: Motion, seconds: float) -> list[tuple[float, float]]:
    """Position and velocity after each tick."""
    rows = []
    for _ in range(round(seconds / TICK)):
        motion.tick()
        rows.append((motion.position, motion.velocity))
    return rows


def ticks_to_settle(motion: Motion, limit: int = 60_000) -> int:
    for count in range(limit):
        if motion.settled:
            return count
        motion.tick()
    raise AssertionError("never settles")


@given(
    st.floats(0, 4095),
    st.floats(0, 4095),
    st.floats(50, 8000),
    st.floats(500, 50_000),
)
def test_a_move_ends_exactly_there_within_its_limits(
    start: float, target: float, speed: float, acceleration: float
) -> None:
    motion = Motion(FAST, start)
    move_to(motion, target, speed=speed, acceleration=acceleration)
    ramp = min(acceleration, FAST.max_acceleration) * TICK
    before = 0.0
    for _ in range(200_000):
        motion.tick()
        assert abs(motion.velocity) <= speed + 1e-6
        # The last snap onto the target may take four ramps at once.
        assert abs(motion.velocity - before) <= 4 * ramp + 1e-6
        assert min(start, target) - 1 <= motion.position <= max(start, target) + 1
        before = motion.velocity
        if motion.settled:
            break
    assert motion.settled
    assert (motion.position, motion.velocity) == (target, 0.0)


def test_move_time_is_that_of_a_trapezoid() -> None:
    motion = Motion(FAST, 0.0)
    move_to(motion, 2000.0, speed=1000.0, acceleration=5000.0)
    assert ticks_to_settle(motion) == pytest.approx(2000 + 200, abs=10)


@given(st.floats(1, 4000), st.floats(0.2, 5.0))
def test_speed_for_duration_takes_that_long(distance: float, seconds: float) -> None:
    speed = speed_for_duration(distance, seconds, 40_000.0)
    if math.isinf(speed):
        assert seconds < 2 * math.sqrt(distance / 40_000.0)
    else:
        assert distance / speed + speed / 40_000.0 == pytest.approx(seconds, rel=1e-6)


def test_nothing_moves_without_torque_to_move_it() -> None:
    motion = Motion(FAST, 100.0)
    move_to(motion, 2000.0, ceiling=0.0)
    run(motion, 1.0)
    assert motion.position == 100.0
    assert motion.torque == 0.0


def test_a_weak_ceiling_is_slower_off_the_mark_but_arrives() -> None:
    strong, weak = Motion(FAST, 0.0), Motion(FAST, 0.0)
    move_to(strong, 1000.0)
    move_to(weak, 1000.0, ceiling=0.1)
    assert run(weak, 0.1)[-1][0] < run(strong, 0.1)[-1][0] / 2
    run(weak, 3.0)
    assert weak.position == pytest.approx(1000.0, abs=1)


def test_holding_takes_the_torque_of_gravity() -> None:
    motion = Motion(FAST, 500.0)
    motion.gravity = lambda shaft: -0.3
    move_to(motion, 500.0)
    ticks_to_settle(motion)
    assert motion.position == 500.0
    assert motion.torque == pytest.approx(0.3)


def test_a_load_above_the_torque_ceiling_sags() -> None:
    motion = Motion(FAST, 500.0)
    motion.gravity = lambda shaft: -0.3
    move_to(motion, 500.0, ceiling=0.2)
    run(motion, 0.5)
    assert motion.position < 450
    assert motion.torque == pytest.approx(0.2)


def test_without_power_the_gears_hold_a_little_and_no_more() -> None:
    motion = Motion(FAST, 500.0)
    motion.gravity = lambda shaft: -0.1
    assert run(motion, 1.0)[-1] == (500.0, 0.0)
    motion.external_torque = -0.1
    assert run(motion, 0.5)[-1][0] < 450


def test_damping_falls_slower_than_free() -> None:
    ends = []
    for drive in (MotorDrive.FREE, MotorDrive.DAMPED):
        motion = Motion(FAST, 2000.0)
        motion.gravity = lambda shaft: -0.4
        motion.command(drive, target=0.0, speed=0.0, acceleration=0.0, ceiling=0.0)
        ends.append(run(motion, 0.3)[-1][0])
    assert ends[0] < ends[1] < 2000.0


def test_an_obstacle_stops_the_shaft_and_raises_the_torque_to_the_ceiling() -> None:
    motion = Motion(FAST, 0.0)
    motion.obstacle = (None, 300.0)
    move_to(motion, 1000.0, ceiling=0.7)
    ticks_to_settle(motion)
    assert motion.position == 300.0
    assert motion.blocked
    assert motion.torque == pytest.approx(0.7)
    motion.obstacle = (None, None)
    run(motion, 2.0)
    assert motion.position == 1000.0
    assert not motion.blocked


def test_a_shaft_that_is_held_up_near_its_target_presses_only_a_little() -> None:
    for away in (16.0, 32.0):
        motion = Motion(FAST, 0.0)
        motion.obstacle = (None, 300.0)
        move_to(motion, 300.0 + away, ceiling=0.9)
        while not motion.blocked:
            motion.tick()
        assert motion.torque == pytest.approx(away / 64, abs=0.05)


def test_an_obstacle_works_downward_too() -> None:
    motion = Motion(FAST, 1000.0)
    motion.obstacle = (700.0, None)
    move_to(motion, 0.0, ceiling=0.5)
    ticks_to_settle(motion)
    assert (motion.position, motion.torque) == (700.0, -0.5)


def test_end_stops_hold_against_a_turning_motor() -> None:
    motion = Motion(Mechanics(5000.0, stops=(0.0, 1023.0)), 500.0)
    motion.command(MotorDrive.SPEED, target=0.0, speed=2000.0, acceleration=0.0, ceiling=1.0)
    run(motion, 1.0)
    assert motion.position == 1023.0
    assert motion.torque == 1.0


def test_constant_speed() -> None:
    motion = Motion(FAST, 0.0)
    motion.command(MotorDrive.SPEED, target=0.0, speed=-1000.0, acceleration=0.0, ceiling=1.0)
    rows = run(motion, 1.0)
    assert rows[-1][1] == -1000.0
    assert rows[-1][0] == pytest.approx(-1000.0, abs=30)
    motion.command(MotorDrive.SPEED, target=0.0, speed=0.0, acceleration=0.0, ceiling=1.0)
    run(motion, 0.1)
    assert motion.velocity == 0.0


def test_constant_torque_accelerates_up_to_the_top_speed() -> None:
    motion = Motion(FAST, 0.0)
    motion.command(MotorDrive.TORQUE, target=-0.3, speed=0.0, acceleration=0.0, ceiling=0.3)
    rows = run(motion, 1.0)
    assert 0 > rows[10][1] > rows[50][1] > -5000.0
    assert rows[-1][1] == -5000.0


def test_speed_zero_goes_nowhere() -> None:
    motion = Motion(FAST, 10.0)
    move_to(motion, 500.0, speed=0.0)
    run(motion, 0.5)
    assert motion.position == 10.0
    assert motion.settled


@given(
    st.sampled_from(list(MotorDrive)), st.floats(-2, 2), st.floats(-1, 1), st.floats(0, 1), st.floats(-3000, 3000)
)
def test_a_settled_shaft_stays_as_it_is(
    drive: MotorDrive, target: float, push: float, ceiling: float, speed: float
) -> None:
    motion = Motion(Mechanics(5000.0, stops=(0.0, 4095.0)), 2000.0)
    motion.external_torque = push
    goal = target if drive is MotorDrive.TORQUE else 2000 + target * 100
    motion.command(drive, target=goal, speed=speed, acceleration=0.0, ceiling=ceiling)
    for _ in range(5000):
        motion.tick()
        if motion.settled:
            break
    else:
        return
    state = (motion.position, motion.velocity, motion.torque)
    run(motion, 0.02)
    assert (motion.position, motion.velocity, motion.torque) == state
