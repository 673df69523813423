"""The studio: a stop from anybody, control for those who may, and the end of a tab."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from hexwire.errors import LeaseError
from hexwire.studio.access import Right

if TYPE_CHECKING:
    from tests.studio.running import RunningStudio


def test_a_watcher_cannot_take_control_but_stops_the_arm(studio: RunningStudio) -> None:
    tab = studio.studio.tabs.open("s", Right.WATCH)
    with pytest.raises(LeaseError, match="watching only"):
        studio.studio.take(tab)
    studio.studio.stop(tab.name)
    studio.until(lambda: studio.arm.owner.group.reason is not None, "the stop")


def test_only_the_arm_of_the_demo_is_told_apart(studio: RunningStudio) -> None:
    arm = studio.studio.source.arm
    assert arm is not None
    assert studio.studio.emulated(arm) == ""
    studio.studio.demo = (arm.driver.url.partition("?")[0], "no weight")
    assert studio.studio.emulated(arm) == "no weight"
    studio.studio.demo = ("/dev/pts/99", "no weight")
    assert studio.studio.emulated(arm) == ""
    studio.studio.demo = ("", "")


def test_a_tab_that_is_gone_gives_control_back(studio: RunningStudio) -> None:
    tab = studio.studio.tabs.open("s", Right.OPERATE)
    studio.studio.take(tab)
    studio.studio.gone(tab)
    assert studio.studio.source.arm is not None
    shared = studio.studio.source.arm.shared
    studio.until(lambda: shared.holder is None, "the end of control")
