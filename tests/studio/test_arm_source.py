"""An open arm: how soon a hold ends on its line, and what it counts as a stop."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from hexwire.errors import UsageError
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


def test_on_a_slow_line_less_silence_ends_a_motion_to_a_goal_too(
    source: Source, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm = source.open("sim://hex7bot?name=slower&dialect=1")
    given: dict[str, Any] = {}

    def begin(orders: Any, args: Any, **more: Any) -> None:
        given.update(more)
        raise UsageError("that is enough")

    monkeypatch.setattr(arm.desk, "begin", begin)
    entry = arm.attended.begin("somebody", 1)
    assert entry is not None
    tab: Any = None
    with pytest.raises(UsageError, match="enough"):
        arm.begin_run(tab, entry, {}, arm.mark())
    assert given["silence"] == 0.15


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
