"""The garbage collector keeps no moving arm waiting, and memory is freed all the same."""

from __future__ import annotations

import subprocess
import sys

import pytest

from hexwire.studio import memory
from hexwire.studio.memory import FullPasses

_BEGIN = """
import gc, sys
from hexwire.studio.memory import FullPasses, pass_by_hand

pass_by_hand()
seen = []
gc.callbacks.append(lambda phase, info: seen.append(info["generation"]) if phase == "stop" else None)
"""
_STAYS = """
kept = [[i] for i in range(300_000)]
rings = []
for i in range(100_000):
    ring = []
    ring.append(ring)
left = len(gc.get_objects())
print(seen.count(2), seen.count(1) > 10, gc.get_count()[0] < 10_000, left < 20_000)
"""
_FREED = """
passes = FullPasses()
print(passes.look(moving=False))
rings = [[] for _ in range(600_000)]
for ring in rings:
    ring.append(ring)
rings = ring = None
print(passes.look(moving=True), passes.look(moving=False), passes.look(moving=False), seen.count(2))
before = sys.getallocatedblocks()
rings = [[] for _ in range(3_000_000)]
for ring in rings:
    ring.append(ring)
rings = ring = None
print(passes.look(moving=True), sys.getallocatedblocks() < before + 100_000)
"""


def _run(program: str) -> list[str]:
    # In a process of its own, since what it sets is for all of it.
    done = subprocess.run(
        [sys.executable, "-c", _BEGIN + program], capture_output=True, text=True, check=True, timeout=60
    )
    return done.stdout.split()


def test_what_stays_is_not_looked_through_again() -> None:
    # By default Python makes several full passes here, of ever more objects.
    assert _run(_STAYS) == ["0", "True", "True", "True"]


def test_rings_that_have_lived_for_long_are_freed_while_nothing_moves_or_when_they_are_too_many() -> None:
    assert _run(_FREED) == ["False", "False", "True", "False", "1", "True", "True"]


def test_memory_that_was_freed_meanwhile_counts_from_there(monkeypatch: pytest.MonkeyPatch) -> None:
    blocks, looked = 1_000_000, list[int]()
    monkeypatch.setattr(memory, "sys", type("sys", (), {"getallocatedblocks": lambda: blocks}))
    monkeypatch.setattr(memory, "_look_through", lambda: looked.append(blocks))
    passes = FullPasses()
    for blocks in (1_400_000, 800_000, 1_200_000, 1_300_000, 1_700_000, 1_900_000):  # noqa: B007
        passes.look(moving=False)
    assert looked == [1_300_000, 1_900_000]
