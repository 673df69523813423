"""The kinds of motion that may be held: known ones with control only."""

from __future__ import annotations

import pytest
from tests.studio.running import until

from hexwire.control.motion.hold_to_run import HoldToRun
from hexwire.errors import LeaseError, UsageError
from hexwire.studio.access import Right
from hexwire.studio.holds import Holds
from hexwire.studio.source import Source
from hexwire.studio.tabs import Tabs


def test_a_kind_of_a_page_is_begun_for_the_tab_with_control_only() -> None:
    source = Source()
    try:
        arm = source.open("sim://hex7bot?name=holds")
        tab = Tabs().open("s", Right.OPERATE)
        holds, begun = Holds(source), list[object]()
        holds.add("goto", lambda tab, entry, args, arrived: begun.append(args))
        entry = HoldToRun().begin(tab.key, 1)
        assert entry is not None
        mark = arm.driver.epochs.mark()
        with pytest.raises(LeaseError):
            holds.begin(tab, entry, "goto", {}, mark)
        source.take(tab)
        holds.begin(tab, entry, "goto", {"a": 1}, mark)
        assert begun == [{"a": 1}]
        with pytest.raises(UsageError, match="no motion"):
            holds.begin(tab, entry, "fly", {}, mark)
    finally:
        source.close()


def test_a_change_that_overtakes_its_jog_does_not_meet_the_one_before() -> None:
    source = Source()
    try:
        arm = source.open("sim://hex7bot?name=overtakes", watchdog=5.0)
        tab = Tabs().open("s", Right.OPERATE)
        holds = Holds(source)
        source.take(tab)
        arm.shared.torque(arm.order(tab), True, None)
        until(lambda: arm.facts()["torque"] == "on", "torque")
        here = arm.arm.owner.newest().positions
        entry = arm.hold_to_run.begin(tab.key, 1)
        assert entry is not None
        holds.begin(tab, entry, "drag", {"goals": {"J1": here["J1"]}}, arm.driver.epochs.mark())
        holds.update(tab, {"goals": {"J1": here["J1"]}})
        # The next one is on its way.
        holds.forget(tab)
        holds.update(tab, {"goals": {"J2": here["J2"]}})
    finally:
        source.close()
