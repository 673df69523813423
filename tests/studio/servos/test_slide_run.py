"""One servo moved on the page Servos: on an adapter, and as a joint behind a board."""

from __future__ import annotations

import asyncio
import math
from typing import TYPE_CHECKING

import pytest
from tests.studio.running import until

from hexwire.errors import HexwireError, LeaseError, UsageError
from hexwire.studio.access import Access, Right
from hexwire.studio.app import Studio
from hexwire.studio.servos.slide_run import read_slide

if TYPE_CHECKING:
    from playwright.sync_api import Page
    from tests.studio.running import RunningStudio
    from tests.studio.servos.conftest import Bench


def test_every_value_is_checked() -> None:
    assert read_slide({"servo": 3, "goal": 0.5, "speed": 1}).goal == 0.5
    wrong: list[dict[str, object]] = [
        {"servo": 3},
        {"servo": 3, "goal": 0.5, "by": 0.1},
        {"servo": 3, "goal": math.nan},
        {"servo": 3, "by": 1e6},
        {"servo": 3, "turn": 2},
        {"servo": 3, "turn": True},
        {"servo": 254, "turn": 1},
        {"servo": 3, "turn": 1, "speed": 0},
        {"servo": 3, "turn": 1, "more": 1},
    ]
    for args in wrong:
        with pytest.raises(UsageError):
            read_slide(args)


def test_only_who_has_control_moves_a_servo_that_was_found() -> None:
    studio = Studio(Access(frozenset()))
    try:
        studio.source.silence = 60.0
        bus = studio.source.open_bus("sim://so101?name=slides")
        bus.search((), range(1, 3))
        tab, watcher = studio.tabs.open("m", Right.OPERATE), studio.tabs.open("w", Right.WATCH)
        with pytest.raises(LeaseError):
            asyncio.run(studio.call(watcher, "slide.range", {"servo": 1}))
        entry = bus.hold_to_run.begin(tab.key, 1)
        assert entry is not None
        with pytest.raises(LeaseError):
            studio.holds.begin(tab, entry, "servo", {"servo": 1, "turn": 1}, bus.mark())
        studio.take(tab)
        with pytest.raises(HexwireError, match="not found"):
            studio.holds.begin(tab, entry, "servo", {"servo": 9, "turn": 1}, bus.mark())
        bus.switch_torque(True, (1,))
        goal = bus.live[1].position if 1 in bus.live else bus.bus.read(1, "present_position").value
        studio.holds.begin(tab, entry, "servo", {"servo": 1, "goal": goal, "speed": 1.0}, bus.mark())
        # It may be changed while it is held, but to no other servo.
        studio.holds.update(tab, {"servo": 1, "goal": goal + 0.1, "speed": 1.0})
        with pytest.raises(UsageError, match="release first"):
            studio.holds.update(tab, {"servo": 2, "goal": goal})
        until(lambda: bus.bus.read(1, "goal_position").value > goal + 0.09, "it comes")
        bus.hold_to_run.end(tab.key, "released")
        until(lambda: bus.job is None, "the end")
        assert entry.ended == "released"
    finally:
        studio.close()


@pytest.mark.slow
def test_a_bare_servo_moves_by_steps_and_while_its_button_is_held(bench: Bench) -> None:
    bench.button("Torque of servo 1 on").click()
    servo, jog = (
        bench.servo(1),
        bench.page.get_by_label("Move servo 1").get_by_role("button", name="Jog servo 1 up"),
    )
    until(lambda: servo.torque_on, "torque")
    before = servo.registers.get("goal_position")
    bench.page.locator(".sv-move").get_by_text("10", exact=True).click()
    jog.click()
    until(lambda: abs(servo.registers.get("goal_position") - before - 114) <= 1, "a step of ten degrees")
    bench.page.locator(".sv-move").get_by_text("while held").click()
    until(lambda: bench.bus.job is None, "the end of the step")
    before = servo.registers.get("goal_position")
    jog.hover()
    bench.page.mouse.down()
    until(lambda: servo.registers.get("goal_position") > before + 40, "it moves")
    bench.page.mouse.up()
    until(lambda: bench.bus.job is None, "the end")


@pytest.mark.slow
def test_a_servo_behind_a_board_moves_as_its_joint(studio: RunningStudio, operator: Page) -> None:
    studio.torque()
    operator.get_by_role("link", name="Servos", exact=True).click()
    operator.get_by_role("button", name="J2, servo 1").click()
    before = studio.arm.owner.newest().positions["J2"]
    operator.get_by_label("steps of 1 degrees or millimetres", exact=True).check()
    operator.get_by_role("button", name="Jog J2 up").click()
    ahead = before + math.radians(1.0)
    studio.until(lambda: abs(studio.arm.owner.newest().positions["J2"] - ahead) < 0.005, "a step of one degree")
