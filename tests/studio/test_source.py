"""What is open: an emulated arm, its facts, and that a jog needs control."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.studio.running import until

from hexwire.control.motion.hold_to_run import HeldMotion
from hexwire.errors import GoalError, HexwireError, LeaseError, LinkLostError
from hexwire.fleet.service import Service
from hexwire.fleet.service_file import read_arms
from hexwire.studio.access import Right
from hexwire.studio.source import Source
from hexwire.studio.tabs import Tabs
from hexwire.studio.wire_feed import WireFeed


@pytest.fixture
def source() -> Iterator[Source]:
    made = Source()
    try:
        yield made
    finally:
        made.close()


def test_nothing_is_open_at_first(source: Source) -> None:
    assert source.mode == "none"
    with pytest.raises(LinkLostError, match="page Arms"):
        source.need_arm()


def test_an_arm_is_opened_with_its_facts(source: Source) -> None:
    arm = source.open("sim://hex7bot?name=facts")
    facts = arm.facts()
    assert (source.mode, facts["robot"], facts["connected"], facts["dialect"]) == ("arm", "hex7bot", True, 2)
    assert facts["torque"] == "off"


def test_the_traffic_of_what_is_open_is_kept_once() -> None:
    wire = WireFeed()
    source = Source(wire=wire)
    try:
        source.open("sim://so101?name=traffic")
        until(lambda: wire.rows(0, "sync_read")["rows"], "traffic of the arm")
        first = wire.rows(0)
        assert (first["name"], first["series"]) == ("sim://so101?name=traffic", "sts_sms")
        bus = source.open_bus()
        assert wire.rows(0)["id"] != first["id"]
        assert wire.rows(0)["series"] == "sts_sms"
        bus.bus.ping(1)
        found = wire.rows(0, "ping servo 1")["rows"]
        assert len(found) == 1
        source.close()
        assert "Nothing is open" in wire.rows(0)["note"]
    finally:
        source.close()


def test_what_cannot_be_opened_says_why(source: Source) -> None:
    with pytest.raises(HexwireError):
        source.open("/dev/not-there")
    assert source.mode == "none"
    assert "/dev/not-there" in source.error
    assert source.refused == "/dev/not-there"


def test_one_tab_has_control_at_a_time(source: Source) -> None:
    source.open("sim://hex7bot?name=control")
    tabs = Tabs()
    first, second = tabs.open("s", Right.OPERATE), tabs.open("s", Right.OPERATE)
    source.take(first)
    with pytest.raises(LeaseError):
        source.take(second)
    source.take(second, force=True)
    assert source.has_control(second)
    with pytest.raises(LeaseError):
        source.need_control(first)
    source.leave(second)
    assert not source.has_control(second)


def test_a_motion_to_a_goal_ends_with_its_entry(source: Source) -> None:
    source.silence = 20.0
    arm = source.open("sim://hex7bot?name=runs", watchdog=5.0)
    tab = Tabs().open("s", Right.OPERATE)
    source.take(tab)
    arm.shared.torque(arm.order(tab), True, None)
    until(lambda: arm.facts()["torque"] == "on", "torque")
    over: list[str] = []

    def begin(number: int, by: float) -> HeldMotion:
        entry = arm.hold_to_run.begin(tab.key, number)
        assert entry is not None
        goal = arm.arm.owner.newest().positions["J1"] + by
        args = {"what": "joints", "goals": {"J1": goal}, "speed": 1.0}
        arm.begin_run(tab, entry, args, arm.driver.epochs.mark(), lambda: over.append(entry.ended))
        return entry

    arm.hold_to_run.on_end = lambda entry: None
    began = begin(1, 0.05)
    until(lambda: over, "the arrival")
    assert (over, began.ended) == (["arrived"], "arrived")
    entry = begin(2, 0.6)
    arm.hold_to_run.end(tab.key, "released")
    until(lambda: len(over) == 2, "the end")
    progress = arm.motions.progress
    assert progress is not None
    assert (progress.outcome, progress.text, entry.ended) == ("preempted", "released", "released")
    assert not arm.arm.owner.group.moving


def test_a_motion_that_is_refused_does_not_begin(source: Source) -> None:
    arm = source.open("sim://hex7bot?name=refused")
    tab = Tabs().open("s", Right.OPERATE)
    source.take(tab)
    entry = arm.hold_to_run.begin(tab.key, 1)
    assert entry is not None
    with pytest.raises(GoalError, match="no torque"):
        arm.begin_run(tab, entry, {"what": "joints", "goals": {"J1": 0.1}}, arm.driver.epochs.mark())
    assert arm.motions.progress is None


def test_the_last_minutes_are_kept_and_listeners_hear_every_state(source: Source) -> None:
    arm = source.open("sim://hex7bot?name=kept")
    heard: list[float] = []
    arm.listeners = (lambda state, goals: heard.append(state.stamp),)
    until(lambda: len(set(heard) & set(arm.history.rows().times)) >= 3, "states")
    assert arm.history.names == arm.settings.model.names
    # Minutes of states go with their arm, although others still refer to that.
    source.close()
    assert len(arm.history.rows()) == 0


def test_control_of_an_arm_that_is_served_elsewhere_is_its_lease() -> None:
    with Service(read_arms({"lab/studio": {"robot": "sim", "watchdog": 15.0}}, lease=15.0)):
        first, second, tabs = Source(), Source(), Tabs()
        try:
            arm = first.open("zenoh:lab/studio")
            second.open("zenoh:lab/studio")
            ann, bob = tabs.open("s", Right.OPERATE), tabs.open("s", Right.OPERATE)
            first.take(ann)
            with pytest.raises(LeaseError):
                second.take(bob)
            assert not second.has_control(bob)
            assert arm.shared.torque(arm.order(ann), True, ("J1",)) == ("J1",)
            first.leave(ann)
            second.take(bob)
            until(lambda: arm.facts()["holder"] not in ("", "tab 1"), "the holder at the server")
        finally:
            first.close()
            second.close()
