"""A hostile host against the boards: whatever it sends, the rules of `hostile` hold."""

from __future__ import annotations

import random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.conformance_board.adapter import BoardUnderTest
from tests.conformance_board.hostile import KINDS_OF_SEQUENCE, Kind, Step, Watch, play, run_seed, sequence

from hexwire.wire.command_frame import Command

# The first one builds.

COUNTS = {"emulator": 16, "core": 8}
FIRST = 4


@pytest.mark.parametrize("kind", list(COUNTS))
def test_sequences_by_number(kind: str) -> None:
    broken = {seed: found for seed in range(FIRST) if (found := run_seed(kind, seed))}
    assert broken == {}


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(COUNTS))
def test_more_sequences_by_number(kind: str) -> None:
    broken = {seed: found for seed in range(FIRST, COUNTS[kind]) if (found := run_seed(kind, seed))}
    assert broken == {}


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS_OF_SEQUENCE, ids=str)
@settings(max_examples=3, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(draw=st.randoms(use_true_random=False), length=st.integers(5, 60))
def test_any_sequence(kind: Kind, draw: random.Random, length: int) -> None:
    board = BoardUnderTest("emulator")
    assert play(board, sequence(draw, kind, length), kind, 1020) == []


def watched() -> tuple[BoardUnderTest, Watch]:
    board = BoardUnderTest("emulator")
    return board, Watch(board, Kind(), 4096)


def test_the_eyes_see_what_breaks_a_rule() -> None:
    board, watch = watched()
    servo = board.machine.wire[4]
    servo.registers.put("torque_enable", 1)
    watch.run(0.01)
    assert "servo 4 has torque that it was never given" in watch.violations[0]
    board, watch = watched()
    watch.sent(Step(Command.TORQUE, b"\1\x7f\0"), 0.0)
    watch.sent(Step(Command.STOP, b"\0"), board.machine.now)
    watch.run(0.05)
    watch.held_at -= 1.0
    board.machine.wire[0].registers.put("target_position", 2900)
    board.machine.wire[4].registers.put_stored("mode", 1)
    watch.run(0.01)
    assert any("servo 0 is sent to 2900 after a stop" in line for line in watch.violations)
    assert any("servo 4 has another setting" in line for line in watch.violations)
