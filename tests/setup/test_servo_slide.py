"""One servo moved by a person, in simulated time: its limits, exact steps, and what ends it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from tests.bus.bus_bench import make_bus

from hexwire.control.motion.jog import JogRequest
from hexwire.errors import GoalError, LimitError, ServoError, StoppedError
from hexwire.setup.servo_slide import SlideServo, sliding_servo
from hexwire.wire.registers import Series

ONE = math.radians(1.0)


class Bench:
    """Servo 2 of three, which somebody holds as long as `held` says so."""

    def __init__(self) -> None:
        self.bus, device = make_bus((1, 2, 3), (Series.STS_SMS,))
        self.servo = device.wire[2]
        self.servo.registers.put_stored("min_position_limit", 1000)
        self.servo.registers.put_stored("max_position_limit", 3000)
        self.clock: Any = self.bus.link.clock  # type: ignore[attr-defined]
        self.since, self.last = math.inf, math.nan

    @property
    def goal(self) -> int:
        return int(self.servo.registers.get("goal_position"))

    def slide(
        self, seconds: float, *, by: float | None = None, then: Callable[[], object] = str, **jog: Any
    ) -> None:
        """Hold a jog, a drag or a step for some seconds; after half of them something happens."""
        begun, done = self.clock(), False
        with sliding_servo(self.bus, 2) as arm:

            def age() -> float:
                nonlocal done
                now = self.clock() - begun
                if now > seconds / 2 and not done:
                    done = True
                    then()
                return 0.0 if now < seconds else math.inf

            slide = SlideServo(arm, JogRequest(**jog), age, 0.25, clock=self.clock, sleep=self.clock.advance)
            if by is not None:
                slide.by(by, self.last, 1.0)
            slide.run(lambda: True, once=by is not None)
            self.last = slide.sent


def test_a_servo_is_jogged_and_dragged_within_its_limits_and_stays_when_it_is_let_go() -> None:
    bench = Bench()
    with pytest.raises(GoalError, match="no torque"):
        bench.slide(0.5, directions={"servo 2": 1.0})
    bench.bus.write(2, "torque_enable", 1)
    before = bench.goal
    bench.slide(0.5, directions={"servo 2": 1.0}, speed=0.5)
    assert before + 200 < bench.goal < before + 700
    bench.slide(5.0, directions={"servo 2": 1.0}, speed=1.0)
    assert bench.goal <= 3000
    assert bench.goal > 2990
    there = 1500 * math.tau / 4096
    bench.slide(5.0, goals={"servo 2": there}, speed=1.0)
    assert bench.goal == pytest.approx(1500, abs=2)


def test_steps_add_up_exactly_and_none_leads_beyond_the_limits() -> None:
    bench = Bench()
    bench.bus.write(2, "torque_enable", 1)
    bench.slide(9.0, by=ONE)
    first = bench.last
    for _ in range(5):
        bench.slide(9.0, by=-ONE)
    assert bench.last == pytest.approx(first - 5 * ONE, abs=1e-9)
    assert bench.goal == round(bench.last * 4096 / math.tau)
    with pytest.raises(LimitError):
        bench.slide(9.0, by=3.0)
    # A hand has moved it meanwhile: a step begins where it is.
    bench.last += 1.0
    bench.slide(9.0, by=ONE)
    assert bench.last == pytest.approx(first - 4 * ONE, abs=0.01)


def test_a_stop_or_a_fault_ends_it_and_the_servo_holds() -> None:
    bench = Bench()
    bench.bus.write(2, "torque_enable", 1)

    def stop() -> None:
        with bench.bus.epochs.stopping():
            pass

    with pytest.raises((ServoError, StoppedError), match="stop"):
        bench.slide(4.0, directions={"servo 2": 0.2}, then=stop)
    goal = bench.goal
    with pytest.raises((ServoError, StoppedError)):
        bench.slide(4.0, directions={"servo 2": 0.2})
    assert bench.goal == goal
