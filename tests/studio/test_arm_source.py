"""An open arm: how soon a hold ends on its line, and what it counts as a stop."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import pytest

from hexwire.control import motion_run
from hexwire.errors import UsageError
from hexwire.studio.access import Right
from hexwire.studio.source import Source
from hexwire.studio.tabs import Tab


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


def test_a_motion_ends_because_its_page_was_closed_not_for_its_lease(
    source: Source, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(motion_run, "_FAREWELL", 60.0)
    source.silence = 60.0
    arm = source.open("sim://hex7bot?name=leaves", watchdog=5.0)
    arm.arm.enable(True)
    tab = Tab("tab 1", "key", "session", Right.OPERATE)
    source.take(tab)
    entry = arm.attended.begin(tab.key, 1)
    assert entry is not None
    arm.begin_run(tab, entry, {"what": "joints", "goals": {"J1": 1.0}, "speed": 0.05}, arm.mark())
    # The thread that ends motions is late; the one that gives control back is not.
    late = threading.Event()
    arm._ender.submit(late.wait, 10.0)
    arm.attended.end(tab.key, "its page was closed")
    leaving = threading.Thread(target=source.leave, args=(tab,))
    leaving.start()
    leaving.join(0.2)
    late.set()
    leaving.join()
    progress = arm.desk.progress
    assert progress is not None
    assert (progress.outcome, progress.text) == ("preempted", "its page was closed")
    assert arm.holder is None
