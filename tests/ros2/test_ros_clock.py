"""The time of ROS, from the system or from `/clock`, in simulated time."""

from __future__ import annotations

import pytest

from hexwire.emulator.serve import FakeClock
from hexwire.ros2.ros_clock import RosClock

WALL = 1_700_000_000_000_000_000


def made(*, simulated: bool) -> tuple[RosClock, FakeClock]:
    clock = FakeClock(100.0)
    return RosClock(lambda: WALL + round(clock() * 1e9), clock, simulated=simulated), clock


def test_without_a_simulation_it_is_the_time_of_the_system() -> None:
    ros, clock = made(simulated=False)
    ros.take(5)
    assert ros.now() == WALL + 100_000_000_000
    assert ros.stamp(99.5) == pytest.approx(WALL / 1e9 + 99.5, abs=1e-6)
    clock.advance(1.0)
    assert ros.now() == WALL + 101_000_000_000


def test_time_is_simulated_only_if_it_is_said_to_be() -> None:
    assert not RosClock(lambda: WALL, FakeClock(100.0)).simulated


def test_simulated_time_is_zero_before_the_first_message_and_stands_between_two() -> None:
    ros, clock = made(simulated=True)
    assert (ros.now(), ros.stamp(100.0)) == (0, 0.0)
    ros.take(7_000_000_000)
    clock.advance(5.0)
    assert (ros.now(), ros.stamp(105.0)) == (7_000_000_000, 7.0)


def test_a_sample_has_the_time_that_was_simulated_when_it_was_taken() -> None:
    ros, clock = made(simulated=True)
    for told in range(1, 6):
        ros.take(told * 1_000_000_000)
        clock.advance(0.1)
    assert [ros.stamp(100.0 + 0.1 * i + 0.05) for i in range(5)] == [1.0, 2.0, 3.0, 4.0, 5.0]
    assert ros.stamp(99.0) == 1.0


def test_a_simulation_that_begins_again_begins_the_time_again() -> None:
    ros, clock = made(simulated=True)
    ros.take(90_000_000_000)
    clock.advance(0.1)
    ros.take(1_000_000_000)
    assert (ros.now(), ros.stamp(100.05)) == (1_000_000_000, 1.0)


def test_old_times_are_forgotten() -> None:
    ros, clock = made(simulated=True)
    for told in range(1, 1001):
        ros.take(told)
        clock.advance(0.01)
    assert len(ros._taken) <= 102
    assert ros.now() == 1000
