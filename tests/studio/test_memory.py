"""Full passes of the garbage collector are made while nothing moves, and only then."""

from __future__ import annotations

import gc
import subprocess
import sys

from hexwire.studio.memory import FullPasses


def test_a_pass_waits_for_a_pause_of_the_arm() -> None:
    passes = FullPasses(100.0)
    assert not passes.due(129.0, moving=False)
    assert not passes.due(131.0, moving=True)
    assert not passes.due(699.0, moving=True)
    assert passes.due(699.5, moving=False)
    assert not passes.due(700.0, moving=False), "the last one was just now"


def test_a_pass_is_made_in_the_end_although_the_arm_goes_on_moving() -> None:
    passes = FullPasses(0.0)
    assert not passes.due(599.9, moving=True)
    assert passes.due(600.0, moving=True)
    assert not passes.due(630.0, moving=True)


_PROGRAM = """
import gc
from hexwire.studio.memory import pass_by_hand

pass_by_hand()
full = []
gc.callbacks.append(lambda phase, info: full.append(info["generation"]) if info["generation"] == 2 else None)
kept = [[i] for i in range(300_000)]
rings = []
for i in range(100_000):
    ring = []
    ring.append(ring)
print(len(full), gc.get_count()[0] < 10_000)
"""


def test_what_pages_compute_brings_no_full_pass_about_and_young_rings_are_freed() -> None:
    # By default Python makes several full passes here; in a process of its own, since thresholds are for all of it.
    assert gc.get_threshold()[2] < 1000, "the tests keep Python's own"
    done = subprocess.run([sys.executable, "-c", _PROGRAM], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.split() == ["0", "True"]
