from __future__ import annotations

import math
from typing import Any

import pytest
from tests.model.states import make_state

from hexwire.model.state import JointFlag, JointReading, JointState
from hexwire.motion.safety import StopReason
from hexwire.setup.servo_wave import WaveController

SILENT, HOT = (int(JointFlag.SILENT),), (int(JointFlag.TEMPERATURE),)


class Bench:
    """A wave of a second that rises by a radian, in eight periods."""

    def __init__(self, most_silent: int = 3) -> None:
        self.samples: list[tuple[float, float, float]] = []
        self.wave = WaveController(
            make_state(0.5)["J1"], lambda t: t, 1.0, period=0.125, most_silent=most_silent, on_sample=self.sample
        )
        self.now = 10.0

    def sample(self, t: float, target: float, joint: JointReading) -> None:
        self.samples.append((t, target, joint.position))

    def turn(self, position: float = 0.0, **known: Any) -> float | None:
        """The target that is sent after this state."""
        state: JointState = make_state(position, **known)
        self.wave.judge(state, [math.nan], self.now)
        target = self.wave.cycle(state, self.now, 0.15)
        self.now += 0.125
        if target is None:
            return None
        assert target.duration == 0.125
        return dict(target.positions)["J1"]


def test_a_wave_goes_from_the_start_and_each_answer_is_recorded_with_the_target_before_it() -> None:
    bench = Bench()
    assert (bench.wave.moving, bench.wave.busy, bench.wave.joints) == (False, True, ("J1",))
    targets = [0.5 + 0.125 * i for i in range(8)]
    assert [bench.turn(float(i)) for i in range(10)] == [*targets, None, None]
    assert bench.samples == [(0.125 * (i + 1), target, i + 1.0) for i, target in enumerate(targets)]
    assert (bench.wave.over, bench.wave.fault, bench.wave.moving, bench.wave.missed) == (True, "", False, 0)


def test_it_waits_while_its_program_does_not_run_and_goes_as_far_as_it_was_to() -> None:
    bench = Bench()
    targets = []
    for stall in (0.0, 0.125, 3.0, 0.0, 0.0, 0.0, 7.0, 0.0):
        bench.now += stall
        targets.append(bench.turn())
    # By two periods after a stall, however long it was.
    assert targets == [0.5 + 0.125 * i for i in (0, 2, 4, 5, 6, 7)] + [None, None]
    assert [sample[:2] for sample in bench.samples] == [
        (0.125 * i, 0.5 + 0.125 * before) for before, i in ((0, 2), (2, 4), (4, 5), (5, 6), (6, 7), (7, 9))
    ]


def test_answers_may_be_missing_now_and_then_but_not_for_long() -> None:
    bench = Bench()
    for flags in ((0,), SILENT, SILENT, (0,), SILENT, SILENT):
        assert bench.turn(flags=flags) is not None
    assert (len(bench.samples), bench.wave.missed) == (1, 4)
    assert bench.turn(flags=SILENT) is None
    assert bench.wave.over
    assert bench.wave.fault == "fell silent: 3 samples in a row are missing; check cable and power"


def test_a_fault_ends_it() -> None:
    bench = Bench()
    bench.turn()
    assert bench.turn(flags=HOT) is None
    assert (bench.wave.over, bench.wave.fault, bench.samples) == (True, "stopped: temperature", [])
    bench.wave.stop(StopReason("asked", "the program ends"))
    assert bench.wave.reason is None, "it had ended before"


@pytest.mark.parametrize("end", ["stop", "release"])
def test_a_stop_ends_it_for_good(end: str) -> None:
    bench, reason = Bench(), StopReason("board", "enough")
    bench.turn()
    bench.wave.stop(reason) if end == "stop" else bench.wave.release("torque off")
    bench.wave.reset()
    assert bench.turn() is None
    assert bench.wave.reason == (reason if end == "stop" else None)
    assert (bench.wave.over, bench.wave.busy, bench.wave.take_ended()) == (True, False, [])
