"""An open arm: how soon a hold ends on its line, and what it counts as a stop."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from hexwire.studio.source import Source


@pytest.fixture
def source() -> Iterator[Source]:
    made = Source()
    try:
        yield made
    finally:
        made.close()


def test_on_a_slow_line_less_silence_ends_a_hold(source: Source) -> None:
    arm = source.open("sim://hex7bot?name=slow&dialect=1")
    assert arm.attended.silence == arm.jog.silence == 0.15


def test_every_stop_counts_whoever_makes_it(source: Source) -> None:
    arm = source.open("sim://hex7bot?name=stops")
    before = arm.stops
    arm.stop("a test")
    by_page = arm.stops
    assert by_page > before
    arm.arm.owner.reset()
    assert arm.stops == by_page
    arm.driver.stop()
    assert arm.stops > by_page
