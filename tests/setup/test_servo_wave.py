from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise, product
from typing import Any

import pytest
from tests.bus.bus_bench import lose_reads, make_bus
from tests.few import few

from hexwire.bus.servo_bus import ServoBus
from hexwire.drivers.bus_arm import BusArm
from hexwire.emulator.faults import FaultPlan
from hexwire.errors import ServoError, StoppedError, UsageError
from hexwire.model.state import JointReading
from hexwire.motion.step_response import step_figures
from hexwire.motion.waves import Wave
from hexwire.setup.servo_wave import WaveEnd, WaveSample, and_back, bring_back, one_servo, run_wave, standing
from hexwire.wire.registers import Series

TEN = math.radians(10)


class Bench:
    """Servo 2 of three on an open bus, in simulated time."""

    def __init__(self, *faults: str, series: Series = Series.STS_SMS) -> None:
        self.bus, self.device = make_bus((1, 2, 3), (series,), faults=FaultPlan(faults) if faults else None)
        self.servo = self.device.wire[2]
        self.clock: Any = self.bus.link.clock  # type: ignore[attr-defined]
        self.end = WaveEnd()
        self.seen: list[WaveSample] = []
        self.asked = 0

    @contextmanager
    def arm(self, amplitude: float = TEN) -> Iterator[tuple[BusArm, JointReading]]:
        with one_servo(self.bus, 2, amplitude) as arm:
            joint = standing(arm)
            assert arm.torque(True)
            yield arm, joint

    def run(self, wave: Wave, arm: BusArm, joint: JointReading, goals: int = 10_000) -> None:
        def go_on() -> bool:
            self.asked += 1
            return self.asked <= goals

        run_wave(
            arm,
            joint,
            wave.angle,
            wave.seconds,
            self.end,
            go_on=go_on,
            clock=self.clock,
            sleep=self.clock.advance,
            on_sample=self.seen.append,
        )


@few(
    "series, shape",
    product((Series.STS_SMS, Series.HLS, Series.SCS), ("sine", "step", "triangle", "sweep")),
    (Series.STS_SMS, "sine"),
    (Series.HLS, "step"),
    (Series.SCS, "sweep"),
)
def test_the_servo_follows_and_the_bus_stays_open(series: Series, shape: str) -> None:
    bench = Bench(series=series)
    before = bench.servo.motion.position
    with bench.arm() as (arm, joint):
        bench.run(Wave(shape, TEN, 2.0, 4.0, 0.5), arm, joint)
        assert bring_back(arm, joint, keep_torque=False, sleep=bench.clock.advance)
    assert bench.end.complete
    assert bench.end.samples == bench.seen
    assert 120 < len(bench.seen) <= 201
    positions = [row.position for row in bench.seen]
    assert max(positions) > 0.7 * TEN
    assert min(positions) < -0.7 * TEN
    assert bench.end.farthest_off == max(abs(row.goal - row.position) for row in bench.seen)
    assert bench.servo.motion.position == pytest.approx(before, abs=4)
    assert bench.bus.read(2, "torque_enable").raw == 0
    assert bench.bus.read(1, "present_position").ok, "the bus is open, and still knows the other servos"


def test_a_wave_ends_with_the_word_of_the_caller_and_the_servo_holds_there() -> None:
    bench = Bench()
    with bench.arm() as (arm, joint):
        bench.run(Wave("triangle", TEN, 8.0, 60.0), arm, joint, goals=50)
    assert not bench.end.complete
    last = bench.seen[-1]
    bench.clock.advance(3.0)
    assert 0.5 < last.t <= 1.05
    # A goal lasts 20 ms: a triangle of 5 deg/s goes a tenth of a degree further.
    now = (bench.servo.motion.position - 2051) * 2 * math.pi / 4096
    assert now == pytest.approx(last.goal, abs=math.radians(0.3))
    assert bench.bus.read(2, "torque_enable").raw == 1


def test_the_way_back_belongs_to_a_wave_that_asks_for_it() -> None:
    wave = Wave("step", TEN, 2.0, 1.5)
    longer, seconds = and_back(wave.angle, wave.seconds)
    assert [longer(t) for t in (0.0, 1.4)] == [TEN, -TEN]
    assert longer(1.75) == pytest.approx(-TEN / 2)
    assert longer(seconds) == 0.0
    assert 2.0 < seconds < 2.1


@pytest.mark.parametrize("stall", [0.0, 0.1, 0.3, 2.0])
@pytest.mark.parametrize("at", [1.6, 1.8, 1.99])
def test_the_servo_is_back_at_its_start_however_long_the_program_stalls_on_the_way(at: float, stall: float) -> None:
    bench = Bench()
    before = bench.servo.motion.position
    wave = Wave("step", TEN, 2.0, 1.5)
    angle, seconds = and_back(wave.angle, wave.seconds)
    stalls = [stall]
    with bench.arm() as (arm, joint):

        def go_on() -> bool:
            if bench.seen and bench.seen[-1].t > at and stalls:
                bench.clock.advance(stalls.pop())
            return True

        run_wave(
            arm,
            joint,
            angle,
            seconds,
            bench.end,
            go_on=go_on,
            clock=bench.clock,
            sleep=bench.clock.advance,
            on_sample=bench.seen.append,
        )
    assert bench.end.complete
    assert bench.servo.motion.position == pytest.approx(before, abs=4)
    back = [row.goal for row in bench.seen if row.t > wave.seconds]
    assert all(abs(b - a) <= 0.09 * TEN for a, b in pairwise(back)), "it goes back at one speed"


def test_a_stop_of_the_bus_ends_the_wave_and_refuses_the_next() -> None:
    bench = Bench()
    with bench.arm() as (arm, joint):
        run = iter(range(1000))

        def go_on() -> bool:
            if next(run) == 20:
                with bench.bus.epochs.stopping():
                    pass
            return True

        with pytest.raises((ServoError, StoppedError), match="stopped"):
            run_wave(
                arm,
                joint,
                lambda t: 0.01 * t,
                9.0,
                bench.end,
                go_on=go_on,
                clock=bench.clock,
                sleep=bench.clock.advance,
            )
        assert len(bench.end.samples) < 22
    with one_servo(bench.bus, 2, TEN) as arm:
        assert arm.epochs is bench.bus.epochs
        with pytest.raises(StoppedError):
            arm.torque(True)
        arm.resume()
        assert arm.torque(True)


def test_a_wave_that_would_leave_the_limits_is_refused_and_so_is_a_turning_servo() -> None:
    bench = Bench()
    bench.servo.registers.put("min_position_limit", 2040)
    with pytest.raises(UsageError, match="is too much"):
        one_servo(bench.bus, 2, TEN)
    bench.servo.registers.put("min_position_limit", 0)
    bench.servo.registers.put("mode", 1)
    with pytest.raises(UsageError, match="not in position mode"):
        one_servo(bench.bus, 2, TEN)


@pytest.mark.parametrize("name", ["mode", "min_position_limit", "max_position_limit"])
def test_a_servo_whose_mode_or_limits_were_not_read_is_not_moved(name: str) -> None:
    bench = Bench()
    lose_reads(bench.servo, name)
    with pytest.raises(ServoError, match="servo 2 does not answer"):
        one_servo(bench.bus, 2, TEN)


def test_a_fault_or_silence_ends_it() -> None:
    hot = Bench("hot:2")
    hot.clock.advance(1.0)
    hot.bus.pause(0.1)
    with pytest.raises(ServoError, match="temperature"), hot.arm() as (arm, joint):
        hot.run(Wave("sine", TEN, 2.0, 4.0), arm, joint)
    gone = Bench()
    with gone.arm() as (arm, joint):
        gone.device.wire.servos = []
        with pytest.raises(ServoError, match="fell silent"):
            gone.run(Wave("sine", TEN, 2.0, 4.0), arm, joint)
        assert gone.end.missed == 25
    assert not gone.end.samples
    with pytest.raises(ServoError):
        one_servo(gone.bus, 2, TEN)


def test_the_steps_of_an_emulated_servo_have_figures() -> None:
    bench = Bench()
    with bench.arm() as (arm, joint):
        bench.run(Wave("step", TEN, 2.0, 4.0), arm, joint)
    rows = [(0.0, 0.0, 0.0), *((row.t, row.goal, row.position) for row in bench.seen)]
    steps = step_figures(rows)
    assert [round(math.degrees(step.size)) for step in steps] == [10, -20, 20, -20]
    for step in steps:
        assert 0.0 < step.rise < 0.5
        assert step.settled < 1.0
        assert abs(step.steady_error) < math.radians(1.0)


def test_the_bus_of_an_arm_may_be_borrowed() -> None:
    bus, _ = make_bus((1, 2))
    arm = one_servo(bus, 1, TEN)
    assert isinstance(arm.bus, ServoBus)
    assert arm.bus is bus
    assert not arm.is_attached
    with arm:
        assert arm.is_attached
    assert bus.link.is_open
    assert not arm.is_attached
