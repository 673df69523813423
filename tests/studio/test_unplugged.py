"""A board that is unplugged: the page says so, and it comes back by itself when the device returns, stopped."""

from __future__ import annotations

import contextlib
import time
from typing import TYPE_CHECKING

import pytest
from tests.emulator.terminals import serving
from tests.studio.conftest import ready
from tests.studio.holder import Holder
from tests.studio.running import hold
from tests.studio.test_every_page import faults

from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.serve_pty import PtyServer
from hexwire.studio import live
from hexwire.studio.server import PAGES

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from playwright.sync_api import Page
    from tests.studio.running import RunningStudio

    from hexwire.emulator.board import EmulatedBoard


_COLOURED = """[...document.querySelectorAll(
  ".hw-fact dd:not(#hw-fact-connection), [data-value], [data-tip], [data-frame], [data-live], " +
  ".hw-fleet-table td[data-label], .hx-plot-legend td:nth-child(3)"
)].filter((cell) => {
  for (let at = cell; at; at = at.parentElement) if (getComputedStyle(at).filter === "grayscale(1)") return false;
  return true;
}).map((cell) => cell.outerHTML)"""
"""The fields that are not grey."""
_PRESSABLE = """[...document.querySelectorAll(".arm-need, .arm-jog, #arm-here, #hw-resume, #hw-torque-on")].filter(
  (each) => each.checkVisibility({ visibilityProperty: true }) && !each.disabled
).map((each) => each.outerHTML)"""
"""What moves the arm, or says where it is."""
_SHOWN = {
    "/move": '[data-value="position"]',
    "/servos": "[data-frame]",
    "/signals": ".hx-plot-legend td",
    "/wire": "",
    "/recordings": "",
    "/": ".hw-fleet-table td[data-label]",
}
"""What each page shows of the arm."""


@contextlib.contextmanager
def _plugged(board: EmulatedBoard, port: Path) -> Iterator[None]:
    with serving(PtyServer(board, link=str(port))):
        yield


def _rest(served: RunningStudio) -> float:
    """Where J1 comes to rest."""
    seen = [served.arm.owner.state]

    def still() -> bool:
        now = served.arm.owner.state
        if now.stamp - seen[-1].stamp < 0.1:
            return False
        seen.append(now)
        return abs(now.positions["J1"] - seen[-2].positions["J1"]) < 1e-3

    served.until(still, "rest")
    place: float = seen[-1].positions["J1"]
    return place


def test_each_page_is_there() -> None:
    assert list(_SHOWN) == list(PAGES)


def _stays(served: RunningStudio, place: float) -> None:
    """Fails if J1 leaves its place within the next states."""
    stamps = {served.arm.owner.state.stamp}

    def seen() -> bool:
        state = served.arm.owner.state
        assert abs(state.positions["J1"] - place) < 0.01
        stamps.add(state.stamp)
        return len(stamps) > 15

    served.until(seen, "fifteen states")


def test_a_held_motion_of_a_board_that_was_unplugged_does_not_go_on(served: RunningStudio, tmp_path: Path) -> None:
    board, port = make_hex7bot_board(baud=0, start=time.monotonic()), tmp_path / "ttyUSB0"
    with contextlib.ExitStack() as stack:
        stack.callback(served.studio.access.end_all)
        stack.callback(served.studio.source.close)
        with _plugged(board, port):
            served.studio.source.silence = 5.0
            served.studio.source.open(str(port))
            served.until(lambda: served.arm.owner.state is not None, "a state")
            served.torque()
            served.until(lambda: len(served.arm.owner.state.torque_on) == 7, "torque")
            holder = Holder(served)
            stack.callback(holder.end)
            holder.hold()
        served.until(lambda: not served.arm.owner.connected, "the end of the connection")
        with _plugged(board, port):
            # Whoever still holds the button does not move it, neither stopped nor resumed.
            served.until(lambda: served.arm.owner.connected, "the connection")
            served.stopped("the stop")
            place = _rest(served)
            served.arm.owner.reset()
            served.until(lambda: served.arm.owner.group.reason is None, "the end of the stop")
            _stays(served, place)
            served.studio.source.close()


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["arm", "bus"])
def test_nothing_is_shown_as_the_present_while_the_studio_hangs(
    mode: str, served: RunningStudio, blank: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its connection is there all the same, and nothing comes over it."""
    page = blank
    try:
        if mode == "arm":
            served.open()
        else:
            served.studio.source.open_bus("sim://so101?name=hangs")
        page.goto(served.operate_url)
        page.wait_for_function(
            f"window.hexwire?.facts?.mode === '{mode}' && hexwire.known && ({_COLOURED}).length > 0"
        )
        monkeypatch.setattr(live._Socket, "put_frame", lambda *_: None)
        monkeypatch.setattr(live._Socket, "put", lambda *_: None)
        page.wait_for_function(f"!({_COLOURED}).length")
        assert page.evaluate(_PRESSABLE) == []
        page.locator("#hw-banner", has_text="What is grey is from ").wait_for()
        page.locator("#hw-banner", has_text="The studio does not answer").wait_for()
        assert page.evaluate("hexwire.connected")
        monkeypatch.undo()
        page.wait_for_function(f"hexwire.known && ({_COLOURED}).length > 0")
    finally:
        served.studio.source.close()
        served.studio.access.end_all()


@pytest.mark.slow
def test_a_board_that_returns_is_there_again_and_stopped(
    served: RunningStudio, blank: Page, tmp_path: Path
) -> None:
    board, port = make_hex7bot_board(baud=0, start=time.monotonic()), tmp_path / "ttyUSB0"
    page = blank
    try:
        with _plugged(board, port):
            served.studio.source.silence = 5.0
            served.studio.source.open(str(port))
            page.goto(served.operate_url)
            ready(page)
            page.get_by_role("button", name="Take control").click()
            page.get_by_role("button", name="Torque on").click()
            served.until(lambda: len(served.arm.owner.state.torque_on) == 7, "torque")
            before = served.arm.owner.state.positions["J1"]
            hold(page, {"J1": 1}, lambda: abs(served.arm.owner.state.positions["J1"] - before) > 0.02)
        page.locator("#hw-banner", has_text="The arm is not connected").wait_for()
        page.locator("#hw-fact-connection", has_text="lost").wait_for(state="attached")
        page.locator("#hw-banner", has_text="What is grey is from ").wait_for()
        # All that a page shows of the arm is grey, and nothing can be pressed that needs to know how it is.
        assert page.evaluate(_COLOURED) == []
        for path, shown in _SHOWN.items():
            page.locator(f'.hw-nav-link[data-path="{path}"]').click()
            if shown:
                page.locator(shown).first.wait_for()
            page.wait_for_function(f"!({_COLOURED}).length")
            assert page.evaluate(_PRESSABLE) == [], path
            assert not faults(page, "color-contrast", whole=True), f"{path}: what is grey can still be read"
            assert page.locator("#hw-stop").is_enabled()
            if path == "/move":
                page.wait_for_function("document.querySelectorAll('.arm-silent').length === 7")
                page.get_by_text("Grey: the arm may be elsewhere").wait_for()
        with _plugged(board, port):
            page.locator("#hw-banner", has_text="Stopped").wait_for()
            assert served.arm.owner.connected
            # What it was commanded before it went away is only now behind it.
            place = _rest(served)
            page.get_by_role("button", name="Resume").click()
            served.until(lambda: served.arm.owner.group.reason is None, "the end of the stop")
            _stays(served, place)
            served.studio.source.close()
    finally:
        served.studio.source.close()
        served.studio.fleet.rest()
        served.studio.access.end_all()
