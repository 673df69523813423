"""The firmware's core and the emulator, written apart from each other, do the same with any trajectory commands."""

from __future__ import annotations

import dataclasses

import pytest
from tests.conformance_board.trajectory_pairs import Comparison, Outcome, compare, play, run_seed, sequence

from hexwire.wire.command_frame import Command, Status

# The first one builds.

SEEDS = (4, 0)
MORE_SEEDS = (1, 8, 10, 12, 15, 16)


@pytest.mark.parametrize("seeds", [SEEDS, pytest.param(MORE_SEEDS, marks=pytest.mark.slow)], ids=["few", "more"])
def test_emulator_and_core_do_the_same(seeds: tuple[int, ...]) -> None:
    total = Comparison()
    for seed in seeds:
        result = run_seed(seed)
        assert result.differences == [], f"sequence {seed}"
        total.compared += result.compared
        total.done += result.done
    assert total.compared >= 30 * len(seeds), "most sequences are compared to their end"
    assert total.done, "some trajectories were followed to their end"


@pytest.fixture(scope="module")
def outcome() -> Outcome:
    return play("emulator", sequence(4))


def test_a_board_differs_in_nothing_from_itself(outcome: Outcome) -> None:
    assert compare(outcome, outcome).differences == []


def test_another_status_is_seen(outcome: Outcome) -> None:
    answers = list(outcome.answers)
    at = next(i for i, each in enumerate(answers) if each.step.cmd == Command.TRAJECTORY_BEGIN)
    answers[at] = dataclasses.replace(answers[at], status=Status.BUSY)
    assert compare(outcome, Outcome(answers, outcome.targets)).differences


def test_another_count_of_points_is_seen(outcome: Outcome) -> None:
    answers = list(outcome.answers)
    answers[-1] = dataclasses.replace(answers[-1], after=answers[-1].after._replace(next=77))
    assert compare(outcome, Outcome(answers, outcome.targets)).differences


def test_another_path_is_seen(outcome: Outcome) -> None:
    moved = {joint: [(time, place + 40) for time, place in line] for joint, line in outcome.targets.items()}
    assert compare(outcome, Outcome(outcome.answers, moved)).differences
    late = {joint: [(time + 0.5, place) for time, place in line] for joint, line in outcome.targets.items()}
    assert compare(outcome, Outcome(outcome.answers, late)).differences
