"""The page Recordings, as a person uses it."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.studio.conftest import ask_for_long, shrink_views
from tests.studio.fake_camera import FakeCamera
from tests.studio.test_recordings import record

if TYPE_CHECKING:
    from playwright.sync_api import Page
    from tests.studio.running import RunningStudio


@pytest.fixture
def folder(studio: RunningStudio) -> Path:
    """The folder of recordings, empty."""
    folder = Path(studio.studio.recordings.library.folder)
    shutil.rmtree(folder, ignore_errors=True)
    return folder


def _open(page: Page) -> None:
    shrink_views(page)
    page.get_by_role("navigation", name="Pages").get_by_role("link", name="Recordings", exact=True).click()
    page.get_by_role("heading", name="Recordings", level=1).wait_for()


@pytest.mark.slow
def test_the_session_is_recorded_and_plays_on_the_arm(operator: Page, folder: Path, studio: RunningStudio) -> None:
    operator.get_by_role("button", name="Torque on").click()
    operator.get_by_role("button", name="Torque off").wait_for()
    _open(operator)
    operator.get_by_text("No recordings yet").wait_for()
    operator.get_by_role("button", name="Record the arm").click()
    operator.locator(".rc-recording", has_text="states").wait_for()
    studio.until(lambda: studio.studio.recordings.recorder.state.states > 100, "states")
    operator.get_by_role("button", name="End the recording").click()
    operator.get_by_role("button", name="open 2").click()
    operator.locator(".uplot").first.wait_for()
    operator.get_by_role("button", name="Play on the arm").click()
    operator.locator(".rc-said", has_text="arrived").wait_for()
    # The lag of the servos is small, since the recording is of a still arm.
    assert "off the recording by" in operator.locator(".rc-said").inner_text()


@pytest.mark.slow
def test_what_a_camera_saw_is_recorded_and_shown_again(operator: Page, folder: Path, studio: RunningStudio) -> None:
    fake = FakeCamera(streams=True)
    studio.studio.cameras.rows["video0"] = fake.camera
    try:
        _open(operator)
        operator.get_by_label("with cameras").check()
        operator.get_by_role("button", name="Record the arm").click()
        # How fast the disk fills.
        operator.locator(".rc-recording", has_text=re.compile(r"\d+ pictures, .*iB/s")).wait_for()
        fake.unplug()
        operator.locator(".rc-recording", has_text="no camera is connected at /dev/video0").wait_for()
        operator.get_by_role("button", name="End the recording").click()
        operator.get_by_role("button", name="open 2").click()
        operator.get_by_role("img", name="Camera video0").wait_for()
        operator.wait_for_function("document.querySelector('.rc-cameras img').naturalWidth === 16")
    finally:
        fake.camera.close()
        studio.studio.cameras.rows.clear()


@pytest.mark.slow
def test_playing_without_control_is_refused_in_words(page: Page, folder: Path) -> None:
    record(folder, "swing.mcap")
    _open(page)
    page.get_by_role("button", name="open swing.mcap").click()
    page.get_by_role("button", name="Play on the arm").click()
    page.locator(".rc-said[data-level=error]").wait_for()
    page.get_by_role("button", name="Play on the twin").wait_for()


@pytest.mark.slow
def test_a_file_is_added_compared_and_deleted(page: Page, folder: Path, tmp_path: Path) -> None:
    record(folder, "first.mcap")
    record(tmp_path, "second.mcap", 0.5)
    (tmp_path / "letter.mcap").write_bytes(b"Dear arm")
    _open(page)
    page.get_by_label("Add a file").set_input_files(tmp_path / "letter.mcap")
    page.get_by_text("is not a recording").wait_for()
    page.get_by_label("Add a file").set_input_files(tmp_path / "second.mcap")
    page.get_by_role("heading", name="second.mcap").wait_for()
    page.get_by_role("button", name="open first.mcap").click()
    page.get_by_label("Compare with").select_option("second.mcap")
    page.get_by_label("aligned").select_option("best")
    page.get_by_text("the second one was 0.5").wait_for()
    figures = page.locator(".rc-table tbody tr", has_text="J1").locator("td").all_text_contents()
    assert float(figures[0]) < 0.5
    ask_for_long(page)
    page.get_by_role("button", name="delete first.mcap").click()
    page.get_by_role("button", name="delete first.mcap").click()
    page.get_by_text("first.mcap was deleted").wait_for()
    assert [path.name for path in folder.iterdir()] == ["second.mcap"]


@pytest.mark.slow
def test_a_damaged_recording_says_so_and_is_recovered(page: Page, folder: Path) -> None:
    record(folder, "a.mcap")
    _open(page)
    page.get_by_role("button", name="open a.mcap").click()
    page.get_by_label("Compare with").get_by_text("there is no other").wait_for(state="attached")
    page.get_by_role("navigation", name="Pages").get_by_role("link", name="Signals", exact=True).click()
    page.get_by_role("heading", name="Signals", level=1).wait_for()
    content = (folder / "a.mcap").read_bytes()
    (folder / "a.mcap").write_bytes(content[:-40])
    _open(page)
    page.get_by_text("truncated").wait_for()
    page.get_by_role("button", name="recover a.mcap").click()
    page.get_by_role("heading", name="a recovered.mcap").wait_for()
    page.get_by_role("row", name="a recovered.mcap").get_by_text("whole").wait_for()


@pytest.mark.slow
def test_closing_the_page_ends_a_recording_that_plays_on_the_arm(
    operator: Page, folder: Path, studio: RunningStudio
) -> None:
    record(folder, "swing.mcap")
    operator.get_by_role("button", name="Torque on").click()
    operator.get_by_role("button", name="Torque off").wait_for()
    _open(operator)
    operator.get_by_role("button", name="open swing.mcap").click()
    operator.locator(".uplot").first.wait_for()
    operator.get_by_label("speed").fill("0.2")
    operator.get_by_role("button", name="Play on the arm").click()
    operator.locator(".rc-said", has_text="left").wait_for()
    studio.until(lambda: studio.arm.owner.group.moving, "motion")
    operator.close()
    studio.until(lambda: not studio.arm.owner.group.moving, "the end of the motion")
    progress = studio.studio.source.arm.motions.progress
    assert (progress.title, progress.outcome) == ("a recording", "preempted")


@pytest.mark.slow
def test_a_recording_of_other_joints_shows_all_of_them_and_a_refused_motion_says_why(
    page: Page, folder: Path
) -> None:
    record(folder, "one.mcap", joints=("K1",))
    record(folder, "two.mcap", joints=("J1", "K1"))
    record(folder, "four.mcap", joints=("J4",))
    record(folder, "three.mcap")
    _open(page)
    page.get_by_role("button", name="open one.mcap").click()
    page.get_by_role("checkbox", name="K1", exact=True).wait_for()
    page.get_by_role("button", name="open two.mcap").click()
    page.get_by_role("checkbox", name="J1", exact=True).wait_for()
    assert page.get_by_role("checkbox", name="J1", exact=True).is_checked()
    # Its colour is that of the joint of this name on every page, although it is the first one here.
    page.get_by_role("button", name="open four.mcap").click()
    chip = page.locator(".pl-chip", has=page.get_by_role("checkbox", name="J4", exact=True))
    chip.wait_for()
    assert chip.evaluate("(one) => one.style.getPropertyValue('--chip')") == "var(--joint-4)"
    page.get_by_role("button", name="open three.mcap").click()
    page.locator(".uplot").first.wait_for()
    page.evaluate("""() => {
        const draw = CanvasRenderingContext2D.prototype.fillText;
        window.drawn = [];
        CanvasRenderingContext2D.prototype.fillText = function (text, ...place) {
            window.drawn.push(text);
            return draw.call(this, text, ...place);
        };
    }""")
    with page.expect_download() as saved:
        page.get_by_role("button", name="Save as PNG").click()
    assert saved.value.suggested_filename == "three.mcap.png"
    assert "three.mcap" in page.evaluate("window.drawn")
    # While the twin is prepared, it counts as busy; somebody looks at this moment, and gets the answer late.
    page.evaluate("""() => {
        const plain = hexwire.call, late = new Promise((resolve) => (window.release = resolve));
        window.held = 0;
        hexwire.call = async (name, ...rest) => {
            const found = await plain(name, ...rest);
            if (name !== "recordings" || window.held) return found;
            window.held = 1;
            found.twin.busy = true;
            await late;
            return found;
        };
    }""")
    page.wait_for_function("window.held")
    page.get_by_label("from, s").fill("900")
    page.get_by_role("button", name="Play on the twin").click()
    # Beside the buttons: the top of the page may be out of sight.
    refusal = page.locator(".rc-said[data-level=error]", has_text="nothing is left")
    refusal.wait_for()
    page.evaluate("window.release()")
    page.wait_for_timeout(500)
    assert refusal.is_visible()


@pytest.mark.slow
def test_a_recording_that_comes_leaves_the_rows_of_others_alone(page: Page, folder: Path) -> None:
    """A row that is made again loses the press that has begun on it, and the question there."""
    record(folder, "first.mcap")
    _open(page)
    delete = page.get_by_role("button", name="delete first.mcap")
    ask_for_long(page)
    delete.click()
    width = delete.evaluate("(button) => (button.marked = true) && button.offsetWidth")
    record(folder, "second.mcap")
    page.get_by_role("button", name="open second.mcap").wait_for()
    assert delete.evaluate("(button) => button.marked && button.offsetWidth") == width
    assert page.locator(".rc-list tbody tr").count() == 2
