from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from hexwire.motion.step_response import BAND, StepFigures, step_figures


def sampled(
    answer: Callable[[float], float],
    *,
    size: float = 1.0,
    start: float = 0.0,
    rate: float = 1000.0,
    seconds: float = 4.0,
    at: float = 0.5,
) -> list[tuple[float, float, float]]:
    """Half a second at rest, then a step of the goal at `at`; `answer` gives the way as a fraction."""
    rows = []
    for i in range(round((at + seconds) * rate)):
        t = i / rate
        # The last sample of the old goal is at the time of the step.
        since = t - at
        goal = start + (size if since > 1e-12 else 0.0)
        rows.append((t, goal, start + (size * answer(since) if since > 0 else 0.0)))
    return rows


def one(*args: object, **options: object) -> StepFigures:
    (figures,) = step_figures(sampled(*args, **options))  # type: ignore[arg-type]
    return figures


def second_order(damping: float, natural: float) -> Callable[[float], float]:
    damped = natural * math.sqrt(1 - damping**2)

    def answer(t: float) -> float:
        sine = damping * natural / damped * math.sin(damped * t)
        return 1 - math.exp(-damping * natural * t) * (math.cos(damped * t) + sine)

    return answer


@pytest.mark.parametrize("damping", [0.2, 0.4, 0.6, 0.7])
@pytest.mark.parametrize(("size", "start"), [(0.3, 0.1), (-0.5, 0.2)])
def test_a_second_order_system_has_the_figures_of_its_closed_form(
    damping: float, size: float, start: float
) -> None:
    natural = 12.0
    answer = second_order(damping, natural)
    found = one(answer, size=size, start=start)
    damped = natural * math.sqrt(1 - damping**2)
    assert found.at == pytest.approx(0.5)
    assert found.size == pytest.approx(size)
    assert found.overshoot == pytest.approx(math.exp(-math.pi * damping / math.sqrt(1 - damping**2)), abs=2e-4)
    assert found.peak == pytest.approx(math.pi / damped, abs=1e-3)
    # The closed form has no inverse: the figures must be times at which it has these values.
    assert answer(found.delay) == pytest.approx(0.1, abs=1e-3)
    assert answer(found.delay + found.rise) == pytest.approx(0.9, abs=1e-3)
    assert abs(answer(found.settled) - 1) == pytest.approx(BAND, abs=1e-3)
    assert max(abs(answer(found.settled + i / 500) - 1) for i in range(1, 1500)) <= BAND + 1e-4
    envelope = -math.log(BAND * math.sqrt(1 - damping**2)) / (damping * natural)
    assert found.settled <= envelope + 1e-3
    assert found.steady_error == pytest.approx(0.0, abs=1e-4)


def test_a_first_order_system_rises_and_settles_in_multiples_of_its_time_constant() -> None:
    constant = 0.1
    found = one(lambda t: 1 - math.exp(-t / constant))
    assert found.delay == pytest.approx(constant * math.log(1 / 0.9), abs=2e-4)
    assert found.rise == pytest.approx(constant * math.log(9), abs=2e-4)
    assert found.settled == pytest.approx(constant * math.log(1 / BAND), abs=2e-3)
    assert found.overshoot == pytest.approx(0.0, abs=1e-6)


def test_the_error_that_stays_is_measured_and_does_not_distort_the_others() -> None:
    whole, short = one(lambda t: 1 - math.exp(-t / 0.1)), one(lambda t: 0.9 * (1 - math.exp(-t / 0.1)), size=-0.4)
    assert short.steady_error == pytest.approx(-0.04, abs=1e-6)
    assert short.rise == pytest.approx(whole.rise, abs=1e-4)
    assert short.settled == pytest.approx(whole.settled, abs=1e-4)


def test_a_dead_time_is_part_of_the_delay_only() -> None:
    late = one(lambda t: 1 - math.exp(-(t - 0.05) / 0.1) if t > 0.05 else 0.0)
    at_once = one(lambda t: 1 - math.exp(-t / 0.1))
    assert late.delay == pytest.approx(at_once.delay + 0.05, abs=1e-3)
    assert late.rise == pytest.approx(at_once.rise, abs=1e-3)
    assert late.settled == pytest.approx(at_once.settled + 0.05, abs=1e-3)


def test_fifty_samples_a_second_are_enough_for_useful_figures() -> None:
    damping, natural = 0.4, 12.0
    found = one(second_order(damping, natural), rate=50.0)
    assert found.overshoot == pytest.approx(math.exp(-math.pi * damping / math.sqrt(1 - damping**2)), abs=0.01)
    assert found.peak == pytest.approx(math.pi / (natural * math.sqrt(1 - damping**2)), abs=0.01)
    exact = one(second_order(damping, natural))
    assert found.rise == pytest.approx(exact.rise, abs=0.01)
    assert found.settled == pytest.approx(exact.settled, abs=0.02)


def test_every_step_is_found_and_each_is_judged_alone() -> None:
    first = sampled(lambda t: 1 - math.exp(-t / 0.05), seconds=1.0)
    later = [(t + 1.5, 1.0 - goal, 1.0 - position) for t, goal, position in first]
    found = step_figures([*first, *later])
    assert [round(row.size, 9) for row in found] == [1.0, -1.0]
    assert found[1].rise == pytest.approx(found[0].rise, abs=1e-6)
    assert [round(row.at, 3) for row in found] == [0.5, 2.0]


def test_what_does_not_exist_is_not_a_number() -> None:
    swings = one(lambda t: 1 + 0.3 * math.sin(20 * t))
    assert math.isnan(swings.settled)
    stuck = one(lambda t: 0.0, size=0.2)
    assert stuck.steady_error == pytest.approx(0.2)
    assert math.isnan(stuck.rise)
    assert math.isnan(stuck.settled)
    assert step_figures([]) == []
    assert step_figures([(0.0, 0.0, 0.0), (0.1, 1.0, 0.5)]) == [], "too few samples"
    assert step_figures([(i / 10, 0.0, 0.0) for i in range(50)]) == [], "no step"
