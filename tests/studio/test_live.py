"""The live socket, from a real page: frames come, and a held button moves the servo only while it is held."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import Page
    from tests.studio.running import RunningStudio


def test_frames_arrive_with_every_joint(page: Page) -> None:
    names = page.evaluate("hexwire.frame.joints")
    assert names == ["J1", "J2", "J3", "J4", "J5", "J6", "J7"]


def test_a_jog_moves_while_held_and_ends_with_its_release(studio: RunningStudio, operator: Page) -> None:
    operator.get_by_role("button", name="Torque on").click()
    studio.until(lambda: len(studio.arm.owner.state.torque_on) == 7, "torque")
    before = studio.arm.owner.state.positions["J1"]
    operator.evaluate("void (window.over = hexwire.hold('joint', {directions: {J1: 1}, speed: 0.5}))")
    studio.until(lambda: abs(studio.arm.owner.state.positions["J1"] - before) > 0.05, "motion")
    operator.evaluate("hexwire.release()")
    studio.until(lambda: not studio.studio.source.arm.jog.busy, "the end of the hold")
    assert operator.evaluate("window.over") == "released"
