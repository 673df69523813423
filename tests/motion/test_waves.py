from __future__ import annotations

import itertools
import math

import pytest

from hexwire.errors import UsageError
from hexwire.motion.waves import MOST_AMPLITUDE, SHAPES, Wave


def test_a_sine() -> None:
    wave = Wave("sine", 0.2, 4.0, 8.0)
    assert [wave.angle(t) for t in (0.0, 1.0, 3.0)] == pytest.approx([0.0, 0.2, -0.2])
    assert wave.angle(6.0) == pytest.approx(0.0, abs=1e-12)
    assert wave.fastest == pytest.approx(0.2 * 2 * math.pi / 4)


def test_steps_go_to_one_side_and_then_to_the_other() -> None:
    wave = Wave("step", 0.1, 2.0, 6.0)
    assert [wave.angle(t) for t in (0.0, 0.9, 1.1, 2.1)] == [0.1, 0.1, -0.1, 0.1]
    assert wave.fastest == math.inf


def test_a_triangle_has_one_speed() -> None:
    wave = Wave("triangle", 0.4, 4.0, 4.0)
    assert [wave.angle(t) for t in (0.0, 0.5, 1.0, 2.0, 3.0, 3.5)] == pytest.approx(
        [0.0, 0.2, 0.4, 0.0, -0.4, -0.2]
    )
    speeds = {round(abs(wave.angle(t + 0.01) - wave.angle(t)) / 0.01, 9) for t in (0.2, 0.7, 1.3, 2.6, 3.3)}
    assert speeds == {round(wave.fastest, 9)} == {0.4}


@pytest.mark.parametrize(("period", "last"), [(2.0, 0.25), (0.25, 2.0), (1.0, 1.0)])
def test_the_phase_of_a_sweep_is_the_integral_of_its_frequency(period: float, last: float) -> None:
    wave = Wave("sweep", 0.1, period, 5.0, last)
    assert wave.frequency(0.0) == pytest.approx(1 / period)
    assert wave.frequency(2.5) == pytest.approx(1 / math.sqrt(period * last)), "as many seconds to each octave"
    assert wave.frequency(5.0) == pytest.approx(1 / last)
    steps = 20_000
    cycles = sum(wave.frequency((i + 0.5) * 5.0 / steps) for i in range(steps)) * 5.0 / steps
    assert wave.angle(5.0) == pytest.approx(0.1 * math.sin(2 * math.pi * cycles), abs=1e-6)
    assert wave.fastest == pytest.approx(0.1 * 2 * math.pi / min(period, last))


@pytest.mark.parametrize("shape", SHAPES)
def test_no_wave_leaves_its_amplitude_or_its_speed(shape: str) -> None:
    wave = Wave(shape, 0.3, 1.0, 3.0, 0.5)
    angles = [wave.angle(i / 1000) for i in range(3001)]
    assert max(map(abs, angles)) <= 0.3 + 1e-12
    assert max(angles) > 0.29
    assert min(angles) < -0.29
    assert max(abs(b - a) for a, b in itertools.pairwise(angles)) <= wave.fastest / 1000 + 1e-9


@pytest.mark.parametrize(
    "values",
    [
        ("square", 0.1, 1.0, 1.0, 0.25),
        ("sine", 0.0, 1.0, 1.0, 0.25),
        ("sine", -0.1, 1.0, 1.0, 0.25),
        ("sine", MOST_AMPLITUDE + 0.001, 1.0, 1.0, 0.25),
        ("sine", math.nan, 1.0, 1.0, 0.25),
        ("sine", 0.1, 0.1, 1.0, 0.25),
        ("sine", 0.1, math.inf, 1.0, 0.25),
        ("sine", 0.1, 1.0, 0.0, 0.25),
        ("sine", 0.1, 1.0, math.nan, 0.25),
        ("sine", 0.1, 1.0, 1e6, 0.25),
        ("sweep", 0.1, 1.0, 1.0, 0.1),
    ],
)
def test_values_out_of_bounds_are_refused(values: tuple[str, float, float, float, float]) -> None:
    with pytest.raises(UsageError):
        Wave(*values)


def test_only_a_sweep_has_a_last_period() -> None:
    assert Wave("sine", 0.1, 1.0, 1.0, 0.0).angle(0.25) == pytest.approx(0.1)
