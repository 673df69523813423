"""Positions of an arm from one sync read."""

from __future__ import annotations

import math

import pytest

from hexwire.bus.values import Readings
from hexwire.drivers.arm_file import load_profile
from hexwire.drivers.bus_arm import PositionReader, So101Arm
from hexwire.emulator.bus_arms import make_bus_arm
from hexwire.emulator.bus_device import BusDevice
from hexwire.emulator.serve import BoardLink, FakeClock
from hexwire.model.state import JointFlag
from hexwire.wire.registers import Series

MODEL = load_profile("so101").model
REGISTER = Series.STS_SMS.register("present_position")
ON = [True] * 6


def simulated() -> So101Arm:
    """An arm in simulated time: no answer is late because the computer is busy."""
    clock = FakeClock()
    servos = make_bus_arm("so101", start=clock()).servos
    return So101Arm(BoardLink(BusDevice(servos, host_baud=lambda: 1_000_000), clock))


def readings(raw: tuple[int | None, ...], stamp: float, **more: dict[int, int]) -> Readings:
    return Readings(REGISTER, tuple(range(1, 7)), raw, stamp, **more)


def test_all_joints() -> None:
    reader = PositionReader(MODEL)
    state = reader.state(
        readings((2048, 2058, 1000, 2048, 2048, 3000), 5.0), [True, False, None, True, True, True], False
    )
    assert state.position == tuple(
        j.counts_to_angle(c) for j, c in zip(MODEL.joints, (2048, 2058, 1000, 2048, 2048, 3000), strict=True)
    )
    assert (state.stamp, state.age, state.stopped) == (5.0, (0.0,) * 6, False)
    assert state.torque_on == ("shoulder_pan", "wrist_flex", "wrist_roll", "gripper")
    assert state["elbow_flex"].flags == JointFlag.TORQUE_UNKNOWN
    assert all(math.isnan(value) for value in (*state.velocity, *state.load, *state.voltage))


def test_a_silent_joint_keeps_its_last_position_with_its_age() -> None:
    reader = PositionReader(MODEL)
    first = reader.state(readings((None, *[2048] * 5), 1.0), ON, False)
    assert math.isnan(first.position[0])
    assert first.age[0] == math.inf
    known = reader.state(readings((2100, *[2048] * 5), 2.0), ON, False)
    later = reader.state(readings((None, *[2060] * 5), 2.5), ON, True)
    assert later.silent == ("shoulder_pan",)
    assert later.position[0] == known.position[0]
    assert later.age == (0.5, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert later.stopped


def test_a_fault_that_a_servo_reports() -> None:
    reader = PositionReader(MODEL)
    state = reader.state(readings((2048,) * 6, 1.0, statuses={3: 0x20}), ON, False)
    assert state["elbow_flex"].flags.faults == JointFlag.OVERLOAD
    assert state["gripper"].flags.faults == 0


def test_an_arm_reads_them_as_it_reads_whole_states() -> None:
    with simulated() as arm:
        whole, short = arm.read(), arm.read_positions()
        assert short.position == pytest.approx(whole.position, abs=0.01)
        assert short.flags == whole.flags
        assert arm.host_counters()["repeats"] == 0


def test_loads_are_read_in_two_thirds_of_the_time_of_a_whole_state() -> None:
    with simulated() as arm:
        whole, short = arm.read(), arm.read_loads()
        assert short.position == pytest.approx(whole.position, abs=0.01)
        assert short.load == pytest.approx(whole.load, abs=0.01)
        assert short.flags == whole.flags
        assert all(map(math.isfinite, (*short.velocity, *short.load)))
        assert all(map(math.isnan, (*short.current, *short.voltage, *short.temperature)))
        assert arm.host_counters()["repeats"] == 0
