"""A leader arm of the studio: who may choose and follow one, and what ends that; see also `tests/control`."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest
from tests.studio.pages.test_arm import open_page
from tests.studio.running import expect, until

from hexwire.drivers.abilities import BareServos
from hexwire.errors import GoalError, HexwireError, LeaseError, LinkLostError, StoppedError, UsageError
from hexwire.studio.access import Access, Right
from hexwire.studio.app import Studio
from hexwire.studio.source import ArmSource
from hexwire.studio.tabs import Tab

if TYPE_CHECKING:
    from playwright.sync_api import Page
    from tests.studio.running import RunningStudio

_names = itertools.count(1)


class Desk:
    """A studio without a server, an SO-101 with torque in it, and a tab that has control."""

    def __init__(self, studio: Studio) -> None:
        self.studio = studio
        studio.source.silence = 60.0
        self.tab = studio.tabs.open("mine", Right.OPERATE)
        self._number = 0
        self.open()

    def open(self) -> None:
        """A fresh arm, with torque and control."""
        self.arm: ArmSource = self.studio.source.open(f"sim://so101?name=led{next(_names)}", watchdog=0.0)
        self.arm.arm.enable(True)
        self.studio.take(self.tab)

    def call(self, name: str, tab: Tab | None = None, **args: object) -> Any:
        return asyncio.run(self.studio.call(tab or self.tab, name, args))

    def lead(self) -> None:
        self.call("arm.lead", url=f"sim://so101?leader=1&name=leads{next(_names)}")

    def follow(self, tab: Tab | None = None, **args: object) -> Any:
        """Begin to follow; returns its entry."""
        tab = tab or self.tab
        self._number += 1
        entry = self.arm.hold_to_run.begin(tab.key, self._number)
        assert entry is not None
        try:
            self.studio.holds.begin(tab, entry, "follow", args, self.arm.mark())
        except BaseException:
            self.arm.hold_to_run.end(tab.key, "refused", self._number)
            raise
        return entry


@pytest.fixture
def desk() -> Iterator[Desk]:
    studio = Studio(Access(frozenset()))
    try:
        yield Desk(studio)
    finally:
        studio.close()


def test_only_who_has_control_chooses_and_follows_a_leader_that_fits(desk: Desk) -> None:
    watcher, other = desk.studio.tabs.open("w", Right.WATCH), desk.studio.tabs.open("o", Right.OPERATE)
    for tab in (watcher, other):
        for name, args in (("arm.lead", {"url": "sim://so101?leader=1"}), ("arm.unlead", {})):
            with pytest.raises(LeaseError):
                desk.call(name, tab, **args)
        with pytest.raises(LeaseError):
            desk.follow(tab)
    with pytest.raises(LeaseError, match="watch"):
        desk.call("arm.leaders", watcher)
    assert desk.call("arm.leaders")["emulated"] == "sim://so101?name=leader&leader=1"
    with pytest.raises(UsageError, match="cannot lead"):
        desk.call("arm.lead", url="sim://hex7bot")
    with pytest.raises(HexwireError, match="no leader is connected"):
        desk.follow()
    for args in ({"speed": 2.0}, {"force": "much"}, {"torque": 1}):
        with pytest.raises(UsageError):
            desk.follow(**args)
    board = desk.studio.source.open("sim://hex7bot?name=slow_leader", watchdog=0.0)
    desk.studio.take(desk.tab)
    with pytest.raises(UsageError, match="too rarely"):
        desk.call("arm.lead", url="sim://hex7bot?dialect=1")
    assert board.leader is None
    desk.open()
    desk.lead()
    leader = desk.arm.leader
    assert leader is not None
    leader.owner.torque(True, leader.owner.model.names)
    desk.arm.stop("a test")
    with pytest.raises(HexwireError, match="stopped"):
        desk.follow()
    desk.arm.arm.owner.reset()
    desk.arm.arm.enable(False)
    with pytest.raises(GoalError, match="no torque"):
        desk.follow()
    desk.arm.arm.enable(True)
    # It was let go of while it waited for its turn.
    desk._number += 1
    entry = desk.arm.hold_to_run.begin(desk.tab.key, desk._number)
    assert entry is not None
    desk.arm.hold_to_run.end(desk.tab.key, "released", desk._number)
    with pytest.raises(StoppedError, match="meanwhile"):
        desk.studio.holds.begin(desk.tab, entry, "follow", {}, desk.arm.mark())
    assert desk.arm._following is None
    # It is refused before the leader loses its torque, and falls.
    until(lambda: leader.row()["torque"] == "on", "a state of the leader")
    leader.close()
    with pytest.raises(LinkLostError, match="the leader is not connected"):
        desk.follow()


def test_following_ends_with_control_a_stop_its_leader_or_another_motion(desk: Desk) -> None:
    arm, other = desk.arm, desk.studio.tabs.open("o", Right.OPERATE)

    def go() -> None:
        entry = arm.hold_to_run.begin(desk.tab.key, 100)
        assert entry is not None
        here = arm.arm.owner.newest().positions["wrist_roll"]
        arm.begin_run(desk.tab, entry, {"what": "joints", "goals": {"wrist_roll": here}}, arm.mark())

    def take() -> None:
        desk.studio.take(other, force=True)
        desk.studio.take(desk.tab, force=True)

    def stop() -> None:
        arm.stop("a test")
        arm.arm.owner.reset()

    ways = {
        "page 2 took": take,
        "its leader was disconnected": lambda: desk.call("arm.unlead"),
        "torque was switched off": lambda: desk.call("torque", on=False),
        "a test": stop,
        "another motion was begun": go,
    }
    members = arm.arm.owner.group.members
    for why, end in ways.items():
        if arm.leader is None:
            desk.lead()
        desk.call("torque", on=True)
        entry = desk.follow(speed=0.5, force=0.5)
        until(lambda: "follower" in arm.facts()["note"], f"it follows, {why}")
        leader = arm.leader
        assert leader is not None
        until(lambda leader=leader: leader.row()["torque"] == "off", "a leader without torque")  # type: ignore[misc]
        end()
        until(lambda: arm._following is None, f"the end: {why}")
        assert why in entry.ended
        assert arm.arm.owner.group.members == members, why


@pytest.mark.slow
def test_a_page_lets_the_arm_follow_its_leader_until_it_is_hidden(studio: RunningStudio, operator: Page) -> None:
    studio.open("so101")
    operator.get_by_role("button", name="Take control").click()
    studio.torque()
    open_page(operator)
    operator.get_by_role("tab", name="Leader arm").click()
    part = operator.locator("#arm-leader")
    part.get_by_label("Port of the leader").select_option(label="emulated, on this computer")
    part.get_by_role("button", name="Connect").click()
    part.get_by_role("button", name="Follow", exact=True).press("Enter")
    expect(part.get_by_role("button", name="End following")).to_be_focused()
    source = studio.studio.source.arm
    assert source is not None
    studio.until(lambda: source._following is not None, "it follows")
    # Another page of the studio in between ends nothing, and who comes back can end it.
    operator.get_by_role("navigation", name="Pages").get_by_role("link", name="Wire", exact=True).click()
    operator.get_by_role("heading", name="Wire", level=1).wait_for()
    open_page(operator)
    expect(part.get_by_role("button", name="End following")).to_be_visible()
    expect(part.get_by_role("button", name="Follow", exact=True)).to_be_hidden()
    assert source._following is not None
    assert source.leader is not None
    link: Any = BareServos.of(source.leader.owner.robot).servo_link
    before = studio.goals()[1]
    link.device.wire.servos[0].motion.position += 200
    studio.until(lambda: abs(studio.goals()[1] - before) > 150, "the arm comes, too")
    expect(part.get_by_role("row", name="shoulder_pan")).to_contain_text("0.0")
    ends = operator.get_by_role("button", name="End motion")
    ends.click()
    expect(part.get_by_text("The arm holds; the leader still has no torque.")).to_be_visible()
    expect(ends).to_be_disabled()
    studio.until(lambda: source._following is None, "the end by a person")
    part.get_by_role("button", name="Follow", exact=True).click()
    studio.until(lambda: source._following is not None, "it follows again")
    operator.evaluate(
        """() => {
            Object.defineProperty(document, "hidden", {value: true, configurable: true});
            document.dispatchEvent(new Event("visibilitychange"));
        }"""
    )
    studio.until(lambda: source._following is None, "the end")
    expect(part.get_by_text("The page is hidden. The arm holds.")).to_be_visible()
    operator.evaluate("delete document.hidden")
    part.get_by_role("button", name="Disconnect").click()
    expect(part.get_by_role("button", name="Connect")).to_be_visible()
