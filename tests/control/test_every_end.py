"""However a motion ends, the joints brake within their limits: every way, where targets are sent one by one."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise, product
from typing import Any

import pytest
from tests.control.arm_bench import Told, order
from tests.control.shared_bench import SharedBench
from tests.control.so_bench import SoBench
from tests.drivers.arms import Arm
from tests.few import few
from tests.motion.arms import EXCESS, HOME, NAMES, PERIOD, rest_to_rest

from hexwire.control.loop.controller import TrajectoryController
from hexwire.control.loop.target import SteppedWay
from hexwire.control.motion.motions import MotionOptions, run_motion
from hexwire.drivers.bus_arm import So101Arm
from hexwire.model.arm import JointModel
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.state import JointTarget

WAY, SECONDS = 1.0, 2.0


class Ending(SharedBench):
    """An arm on its way with a lease, and what it is told, at 1 kHz."""

    def __init__(self) -> None:
        super().__init__(host_timed=True)
        self.told, self.key = Told(), self.take(rank=2)
        self.generator = self.bench.controller.generator
        self.rows: list[tuple[float, ...]] = []
        self._sampled = self.clock.time
        goal = order((SECONDS, {"J1": HOME["J1"] - WAY, "J3": HOME["J3"] + 0.4}), still=True)
        self.shared.follow(self.order(self.key), "", goal, self.told)

    def run(self, seconds: float, *, held: bool) -> None:
        end = self.clock.time + seconds
        while self.clock.time < end:
            if held:
                self.shared.beat(self.key, 0.0)
            self.bench._step()
            while self._sampled + PERIOD < self.generator.due:
                self._sampled += PERIOD
                self.rows.append(self.generator.desired(NAMES, self._sampled).position)


def sample_steps(monkeypatch: pytest.MonkeyPatch) -> list[tuple[float, ...]]:
    """Where the ways of targets lead that are sent in steps from now on, every `PERIOD`."""
    step, rows, sampled = SteppedWay.next, list[tuple[float, ...]](), -math.inf

    def noted(way: SteppedWay, now: float) -> JointTarget:
        nonlocal sampled
        found, sampled = step(way, now), sampled if rows else now
        while sampled + PERIOD < way.told:
            sampled += PERIOD
            rows.append(way.at(sampled).position)
        return found

    monkeypatch.setattr(SteppedWay, "next", noted)
    return rows


def worst(rows: list[tuple[float, ...]], joints: Sequence[JointModel]) -> float:
    """Greatest acceleration or jerk of what was told, as a share of its limit."""
    most = 0.0
    for i, joint in enumerate(joints):
        values = [row[i] for row in rows]
        for limit in (math.inf, joint.max_acceleration, joint.max_jerk):
            values = [(b - a) / PERIOD for a, b in pairwise(values)]
            most = max(most, *(abs(value) / limit for value in values))
    return most


ENDS: dict[str, Callable[[Ending], object]] = {
    "cancelled": lambda bench: bench.bench.owner.group.cancel(bench.told),
    "held": lambda bench: bench.bench.arm.hold("", "a test"),
    "an empty trajectory": lambda bench: bench.bench.arm.command("", order(), listener=None),
    "its program is silent": lambda bench: None,
    "the lease is taken": lambda bench: bench.take("Bob", rank=2, force=True),
    "the lease is given back": lambda bench: bench.shared.leave(bench.key, finish=False),
}


@few("how, after", product(ENDS, (0.3, 0.7, 1.0)), *((how, 0.7) for how in ENDS))
def test_a_motion_ends_within_all_limits_however_it_ends(how: str, after: float) -> None:
    bench = Ending()
    # A lease is lost after half a second.
    bench.run(after - 0.5 * (how == "its program is silent"), held=True)
    ENDS[how](bench)
    bench.run(2.0, held=False)
    speeds = [abs(b[0] - a[0]) / PERIOD for a, b in pairwise(bench.rows)]
    assert max(speeds) > 0.1
    assert speeds[-1] == 0.0
    assert 0.02 < abs(bench.rows[-1][0] - HOME["J1"]) < WAY - 0.02
    assert bench.where("J1") == pytest.approx(bench.rows[-1][0], abs=0.01)
    assert worst(bench.rows, HEX7BOT.joints) <= EXCESS
    assert not bench.board.state.stopped
    assert bench.told.ends


@pytest.mark.parametrize("after", [0.3, 0.7, 1.0])
def test_a_motion_of_a_program_ends_so_when_the_program_has_seen_enough(
    after: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm, rows, sampled = Arm(2, 115200), list[tuple[float, ...]](), -math.inf
    cycle, joint, (here,) = TrajectoryController.cycle, HEX7BOT.joint("J4"), [arm.driver.read()["J4"].position]

    def noted(controller: TrajectoryController, *given: Any) -> Any:
        nonlocal sampled
        order, generator = cycle(controller, *given), controller.generator
        sampled = max(sampled, begin)
        while sampled + PERIOD < generator.due:
            sampled += PERIOD
            rows.append(generator.desired(("J4",), sampled).position)
        return order

    monkeypatch.setattr(TrajectoryController, "cycle", noted)
    begin = arm.clock.time
    result = run_motion(
        arm.driver,
        rest_to_rest(("J4",), (here,), (here + 0.8,), 1.6),
        MotionOptions(clock=arm.clock, sleep=arm.wait, host_timed=True),
        until=lambda state: arm.clock.time > begin + after,
    )
    assert result.cut
    assert result.stopped is None
    assert worst(rows, [joint]) <= EXCESS
    assert rows[-1] == rows[-2]
    assert 0.01 < rows[-1][0] - here < 0.79
    arm.wait(1.0)
    assert arm.driver.read()["J4"].position == pytest.approx(rows[-1][0], abs=0.01)


@pytest.mark.parametrize("after", [0.3, 0.7])
def test_so_ends_a_target_that_is_sent_in_steps(after: float, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = SoBench(pose=3, any_horns=False)
    clock, joint = bench.link.clock, bench.described.model.joint("elbow_flex")
    with So101Arm(bench.link) as driver:
        here = driver.read()[joint.name].position
        way = math.copysign(0.8, joint.minimum + joint.maximum - 2.0 * here)
        rows, begin = sample_steps(monkeypatch), clock.time
        result = run_motion(
            driver,
            JointTarget.of({joint.name: here + way}, 1.6),
            MotionOptions(clock=clock, sleep=clock.sleep),
            until=lambda state: clock.time > begin + after,
        )
        assert result.cut
        assert result.stopped is None
        assert worst(rows, [joint]) <= EXCESS
        assert rows[-1][0] == pytest.approx(rows[-2][0], abs=1e-6)
        assert 0.005 < abs(rows[-1][0] - here) < 0.79
        clock.sleep(1.0)
        assert driver.read()[joint.name].position == pytest.approx(rows[-1][0], abs=0.01)
