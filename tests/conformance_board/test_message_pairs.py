"""The firmware's core and the emulator, written apart from each other, say the same to any fragments and tables."""

from __future__ import annotations

import pytest
from tests.conformance_board.message_pairs import differences, play, sequence

from hexwire.wire.command_frame import Command

# The first one builds.

SEEDS = (2, 8)
MORE_SEEDS = (0, 1, 3, 5)


@pytest.mark.parametrize("seeds", [SEEDS, pytest.param(MORE_SEEDS, marks=pytest.mark.slow)], ids=["few", "more"])
def test_emulator_and_core_say_the_same(seeds: tuple[int, ...]) -> None:
    heard: list[str] = []
    for seed in seeds:
        steps = sequence(seed)
        emulator = play("emulator", steps)
        assert differences(emulator, play("core", steps)) == [], f"sequence {seed}"
        heard += [line for _, said in emulator for line in said]
    # The sequences reach both ends of a message.
    done = f"{Command.TRAJECTORY_POINTS:02x} to 7"
    assert any(line.startswith(done) and " 80 " in line for line in heard), "a whole path came"
    assert any(line.startswith("FRAGMENT to") for line in heard), "a table was sent in fragments"
    assert any(line.startswith("FRAGMENT_MISSING") for line in heard)


def test_another_answer_is_seen() -> None:
    steps = sequence(1)
    one = play("emulator", steps)
    assert differences(one, one) == []
    at = next(i for i, (_, said) in enumerate(one) if said)
    other = [*one[:at], (one[at][0], [one[at][1][0] + " 00"]), *one[at + 1 :]]
    assert differences(one, other)
    assert differences(one, [*one[:at], (one[at][0], []), *one[at + 1 :]])
