"""The timeline of the page Move, by keyboard: a recording is cut, slowed down, played in rounds and kept."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.studio.pages.test_arm import _no_arm_is_silent, open_page, prepare, rest, shaft
from tests.studio.running import expect

from hexwire.arm.recorded import read_taught, write_taught
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.motion.teach import Taught

if TYPE_CHECKING:
    from playwright.sync_api import Page
    from tests.studio.running import RunningStudio

__all__ = ["_no_arm_is_silent"]

MIDDLE = HEX7BOT.joint("J1").offset


def swing(folder: Path, name: str, seconds: float) -> Path:
    """A recording in which J1 turns by 60 degrees and back, at most 1.05 of its speed limit in a second."""
    times = [i / 50 * seconds for i in range(51)]
    rows = [(MIDDLE + math.radians(30) * (1 - math.cos(math.tau * t / seconds)),) for t in times]
    folder.mkdir(parents=True, exist_ok=True)
    write_taught(Taught(("J1",), tuple(times), tuple(rows)), folder / name, force=True)
    return folder / name


@pytest.mark.slow
def test_a_recording_is_cut_slowed_played_in_rounds_paused_and_kept(studio: RunningStudio, operator: Page) -> None:
    page, folder = operator, Path(studio.studio.recordings.library.folder)
    file = swing(folder, "swing.mcap", 0.5)
    was = file.read_bytes()
    open_page(page)
    prepare(page, speed=100)
    plan, time = page.locator("#arm-play-plan"), page.locator("#arm-time-value")
    page.get_by_role("tab", name="Teach and play").click()
    source = page.get_by_label("Motion", exact=True)
    source.select_option("swing.mcap")
    expect(time).to_have_text("0.0 of 0.5 s")
    expect(plan).to_contain_text("J1 would turn at")
    page.get_by_role("button", name="Play at 0.").press("Enter")
    expect(plan).to_have_text("Played.")
    assert 0.1 < float(page.get_by_label("Speed ×").input_value()) < 1.0
    assert rest(studio, "J1") == pytest.approx(MIDDLE, abs=0.03)

    # Only its first half, four times; the arm returns to the begin of each round.
    page.get_by_label("Speed ×").fill("0.1")
    end = page.get_by_role("slider", name="End", exact=True)
    for key in ("ArrowLeft", "ArrowLeft", "ArrowLeft", "ArrowRight"):
        end.press(key)
    expect(end).to_have_attribute("aria-valuetext", "0.3 seconds")
    expect(page.get_by_text("plays 0.0 to 0.3 s")).to_be_visible()
    page.get_by_label("Rounds").fill("4")
    page.get_by_role("button", name="Rewind").press("Enter")
    page.get_by_role("button", name="Play", exact=True).press("Enter")
    expect(plan).to_have_text("Round 2 of 4.")
    page.get_by_role("button", name="Pause").press("Enter")
    expect(plan).to_contain_text("Play goes on from here")
    held = rest(studio, "J1")
    page.get_by_role("button", name="Play", exact=True).press("Enter")
    # Those that were left: on a busy machine, another one had ended meanwhile.
    expect(plan).to_have_text(re.compile(r"Round 1 of [23]\."))
    # A stop voids the rounds that are left, although the arm is released again.
    page.keyboard.press("Escape")
    expect(plan).to_have_text("Stopped")
    page.get_by_role("button", name="Resume").click()
    expect(page.get_by_role("button", name="Resume")).to_be_hidden()
    stood = rest(studio, "J1")
    assert abs(stood - held) < math.radians(60)

    # What is seen is kept as a new recording; the other one is replaced only after a question.
    name = page.get_by_label("Name of the new recording")
    name.fill("half")
    name.press("Enter")
    expect(page.get_by_text("Saved half.mcap")).to_be_visible()
    kept = read_taught(str(folder / "half.mcap"))
    assert kept.duration == pytest.approx(3.0, abs=0.2)
    assert kept.rows[-1][0] == pytest.approx(MIDDLE + math.radians(58), abs=0.1)
    name.fill("swing")
    name.press("Enter")
    page.get_by_role("button", name="Cancel").press("Enter")
    assert file.read_bytes() == was
    assert shaft(studio, "J1") == pytest.approx(stood, abs=0.03)
    name.press("Enter")
    page.get_by_role("button", name="Replace it").press("Enter")
    # A sample that is as late as the handle may be just within it, or just outside.
    expect(time).to_have_text(f"0.0 of {kept.duration:.1f} s")
    assert read_taught(str(file)).duration == pytest.approx(kept.duration, abs=0.01)
    (folder / "half.mcap").unlink()
    source.select_option("half.mcap")
    expect(page.get_by_text("There is no recording 'half.mcap'")).to_be_visible()


def test_nothing_is_played_before_it_is_shown(studio: RunningStudio, operator: Page) -> None:
    page, folder = operator, Path(studio.studio.recordings.library.folder)
    swing(folder, "slow.mcap", 3.0)
    (folder / "broken.mcap").write_bytes(b"garbage")
    studio.torque()
    open_page(page)
    page.get_by_role("tab", name="Teach and play").click()
    source, play = page.get_by_label("Motion", exact=True), page.get_by_role("button", name="Play", exact=True)
    source.select_option("broken.mcap")
    said = page.get_by_text("broken.mcap is not a recording")
    expect(said).to_be_visible()
    source.select_option("slow.mcap")
    expect(said).to_be_hidden()
    expect(play).to_be_enabled()
    page.evaluate(
        """() => {
            const { call } = hexwire;
            hexwire.call = (name, ...rest) => name === "arm.timeline"
                ? new Promise((go) => { window.go = go; }).then(() => call(name, ...rest)) : call(name, ...rest);
        }"""
    )
    page.get_by_label("Smooth").select_option("0.5")
    expect(play).to_be_disabled()
    page.evaluate("go()")
    expect(play).to_be_enabled()


@pytest.mark.slow
def test_what_has_no_plan_is_not_played_until_it_has_one(studio: RunningStudio, operator: Page) -> None:
    page, folder = operator, Path(studio.studio.recordings.library.folder)
    swing(folder, "slow.mcap", 3.0)
    studio.torque()
    open_page(page)
    page.get_by_role("tab", name="Teach and play").press("Enter")
    play = page.get_by_role("button", name="Play", exact=True)
    page.evaluate(
        """() => {
            const { call } = hexwire;
            window.busy = true;
            hexwire.call = (name, ...rest) => name === "arm.preview" && busy
                ? Promise.reject(new Error("the studio has no time")) : call(name, ...rest);
        }"""
    )
    page.get_by_label("Motion", exact=True).select_option("slow.mcap")
    expect(page.get_by_text("the studio has no time")).to_be_visible()
    expect(play).to_be_disabled()
    # Nobody has to change anything: the page looks again.
    page.evaluate("() => { busy = false; }")
    expect(play).to_be_enabled()
