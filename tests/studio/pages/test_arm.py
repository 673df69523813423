"""The page Move, as a person uses it: drags, a preview and its refusal, poses, teach and play."""

from __future__ import annotations

import json
import math
import re
import time
from typing import TYPE_CHECKING

import pytest
from tests.studio.conftest import always_known, ask_for_long, shrink_views
from tests.studio.fake_camera import FakeCamera
from tests.studio.running import expect, press

from hexwire.control.requests.pose_file import check_pose_name
from hexwire.control.requests.program import read_program
from hexwire.model.aim import Tip
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.motion.teach import Taught
from hexwire.studio.access import Right
from hexwire.studio.arm_calls import arm_values
from hexwire.studio.cameras import CameraPicture

if TYPE_CHECKING:
    from playwright.sync_api import Page
    from tests.studio.running import RunningStudio


@pytest.fixture(autouse=True)
def _no_arm_is_silent(never_silent: None) -> None:
    """For all tests here: see `never_silent`."""


def open_page(page: Page) -> None:
    """Go to the page Move, which does not take a busy machine for a silent studio either."""
    always_known(page)
    shrink_views(page)
    page.get_by_role("navigation", name="Pages").get_by_role("link", name="Move", exact=True).click()


def shaft(studio: RunningStudio, joint: str) -> float:
    """Where a servo really is, radians."""
    model = HEX7BOT.joint(joint)
    return model.counts_to_angle(studio.servos[model.servo_id].motion.position)


def rest(studio: RunningStudio, joint: str) -> float:
    """Where a joint stays; fails if it does not come to rest."""
    source = studio.studio.source.arm
    arm = source.arm.owner
    studio.until(lambda: not source.jog.busy and not arm.group.moving, "the end of the motion")
    seen = [(arm.state.stamp, shaft(studio, joint))]

    def still() -> bool:
        # By states of the arm: a machine that stalls shows the same position twice while it moves.
        stamp = arm.state.stamp
        if stamp - seen[-1][0] < 0.1:
            return False
        seen.append((stamp, shaft(studio, joint)))
        return abs(seen[-1][1] - seen[-2][1]) < 1e-3

    studio.until(still, f"the rest of {joint}")
    return seen[-1][1]


def prepare(page: Page, *, speed: int) -> None:
    """Torque on, at so many percent of the speed limits."""
    page.get_by_role("button", name="Torque on").click()
    expect(page.locator("#hw-fact-torque")).to_have_text("on")
    page.locator("#arm-speed").fill(str(speed))
    expect(page.locator('[data-tip="x"]')).not_to_have_text("–")


def type_goal(page: Page, **values: float) -> None:
    for name, value in values.items():
        field = f"joint:{name}" if name.startswith("J") else name
        page.locator(f'#arm-goto input[name="{field}"]').fill(str(value))


@pytest.mark.slow
def test_what_is_pressed_without_a_connection_is_not_done_later(studio: RunningStudio, operator: Page) -> None:
    """Torque would go off when nobody holds the arm any more."""
    open_page(operator)
    operator.get_by_role("tab", name="Teach and play").click()
    operator.get_by_role("checkbox", name="I hold the arm: it will sink").check()
    start = operator.get_by_role("button", name="Start teaching")
    expect(start).to_be_enabled()
    # No new socket can be opened for now, and the present one closes.
    operator.evaluate("() => { window.Plain = WebSocket; WebSocket = class { static OPEN = 1; readyState = 3; }; }")
    studio.cut(operator)
    operator.wait_for_function("!hexwire.connected")
    expect(operator.locator("#hw-torque-on")).to_be_hidden()
    start.dispatch_event("click")
    expect(operator.locator("#arm-teach-note")).to_contain_text("No connection")
    operator.evaluate("() => { WebSocket = window.Plain; }")
    operator.reload()
    # What had been kept would be done before what comes now.
    operator.get_by_role("button", name="Take control").click()
    operator.get_by_role("button", name="Torque on").click()
    expect(operator.locator("#hw-fact-torque")).to_have_text("on")
    assert not studio.studio.source.need_arm().motions.teaching


@pytest.mark.slow
def test_clicks_are_steps_that_add_up_and_keys_do_what_buttons_do(studio: RunningStudio, operator: Page) -> None:
    open_page(operator)
    prepare(operator, speed=100)
    ten, held = (operator.locator(".hw-segments label", has_text=words) for words in ("10", "while held"))
    expect(operator.locator('input[name="step"][value="10"]')).to_be_enabled()
    ten.click()
    start = shaft(studio, "J1")

    def is_at(degrees: float) -> bool:
        return abs(math.degrees(shaft(studio, "J1") - start) - degrees) < 0.5

    # The second and the third click come before the first step has ended.
    for _ in range(3):
        operator.get_by_role("button", name="Jog J1 up").click()
    studio.until(lambda: is_at(30.0), "three steps")
    # Keys move nothing before they are switched on.
    operator.keyboard.press("Shift+Digit1")
    operator.locator("#arm-keys").check()
    operator.keyboard.press("Shift+Digit1")
    studio.until(lambda: is_at(20.0), "a step by a key")
    assert is_at(20.0)
    held.click()
    operator.keyboard.down("1")
    studio.until(lambda: shaft(studio, "J1") - start > math.radians(22.0), "a jog by a key")
    operator.keyboard.up("1")
    end = rest(studio, "J1")
    # What is typed into a field is no order.
    operator.locator('#arm-goto input[name="x"]').press("1")
    operator.locator("h1").click(force=True)
    operator.keyboard.press("?")
    expect(operator.get_by_role("dialog", name="Keys")).to_contain_text("Shift 1")
    operator.keyboard.press("?")
    expect(operator.get_by_role("dialog", name="Keys")).to_be_hidden()
    assert rest(studio, "J1") == pytest.approx(end, abs=1e-3)
    # Whoever has lost control says again that keys move the arm; the page says that it has lost it.
    studio.studio.take(studio.studio.tabs.open("another", Right.OPERATE), force=True)
    expect(operator.locator("#hw-banner")).to_contain_text("This page has lost control: page")
    expect(operator.locator("#arm-keys")).not_to_be_checked()


@pytest.mark.slow
def test_cameras_of_the_browser_are_tiles_and_are_off_when_nobody_sees_them(
    studio: RunningStudio, operator: Page
) -> None:
    open_page(operator)
    # Whoever only watches sees cameras, too: the picture stays in the browser.
    for _ in range(2):
        operator.get_by_role("button", name="Camera", exact=True).click()
    tiles = operator.locator(".arm-camera-tile")
    expect(tiles).to_have_count(2)
    operator.wait_for_function(
        "[...document.querySelectorAll('.arm-camera-tile video')].every((video) => video.videoWidth > 0)"
    )
    # Another one each.
    devices = tiles.evaluate_all("(all) => all.map((one) => one.dataset.device)")
    assert len(set(devices)) == 2
    # What is shared is a camera of the studio.
    rows = studio.studio.cameras.rows
    tiles.last.get_by_label("share").check()
    studio.until(lambda: rows, "the shared camera")
    pictures: list[CameraPicture | None] = []
    (shared,) = rows.values()
    end = shared.look(lambda picture, why: pictures.append(picture))
    studio.until(lambda: any(pictures), "a picture")
    end()
    tiles.last.get_by_label("share").uncheck()
    studio.until(lambda: not rows, "its end")
    operator.evaluate(
        "window.tracks = [...document.querySelectorAll('video')].map((v) => v.srcObject.getTracks()[0])"
    )
    tiles.first.get_by_role("button", name="Close this camera").click()
    expect(tiles).to_have_count(1)
    operator.wait_for_function("tracks.map((track) => track.readyState).join() === 'ended,live'")
    operator.get_by_role("navigation", name="Pages").get_by_role("link", name="Wire", exact=True).click()
    operator.wait_for_function("tracks.every((track) => track.readyState === 'ended')")
    # A tile that is closed while the browser still opens another camera for it leaves neither of them on.
    operator.get_by_role("navigation", name="Pages").get_by_role("link", name="Move", exact=True).click()
    operator.get_by_role("button", name="Camera", exact=True).click()
    expect(tiles).to_have_count(1)
    operator.evaluate(
        """() => {
            tracks = [...document.querySelectorAll("video")].map((v) => v.srcObject.getTracks()[0]);
            const open = navigator.mediaDevices.getUserMedia.bind(navigator.mediaDevices);
            navigator.mediaDevices.getUserMedia = (wanted) => new Promise((resolve) => {
                window.late = async () => {
                    const made = await open(wanted);
                    tracks.push(...made.getTracks());
                    resolve(made);
                };
            });
        }"""
    )
    shown = tiles.first.get_attribute("data-device")
    tiles.first.locator("select").select_option(next(device for device in devices if device != shown))
    expect(tiles.first.get_by_label("share")).to_be_hidden()
    tiles.first.get_by_role("button", name="Close this camera").click()
    operator.evaluate("late()")
    operator.wait_for_function("tracks.map((track) => track.readyState).join() === 'ended,ended'")
    # A page without TLS on another computer has no cameras, and says what helps.
    operator.evaluate("Object.defineProperty(navigator, 'mediaDevices', { value: undefined, configurable: true })")
    operator.get_by_role("button", name="Camera", exact=True).click()
    expect(operator.locator("#hw-banner")).to_contain_text("TLS")
    expect(tiles).to_have_count(0)
    operator.evaluate("delete navigator.mediaDevices")
    # However long the person takes to allow a camera, its tile shows it. Last: to the page, the studio is
    # silent for these seconds.
    operator.clock.install()
    operator.evaluate("window.late = null")
    operator.get_by_role("button", name="Camera", exact=True).click()
    operator.wait_for_function("late !== null")
    operator.clock.run_for(5000)
    operator.evaluate("late()")
    expect(tiles).to_have_count(1)
    expect(tiles.locator("video")).to_have_count(1)
    operator.clock.resume()


def test_a_camera_of_the_studios_computer_is_a_tile_and_is_off_when_its_page_is_gone(
    studio: RunningStudio, operator: Page
) -> None:
    fake = FakeCamera(streams=True)
    studio.studio.cameras.rows["video0"] = fake.camera
    try:
        open_page(operator)
        operator.get_by_role("button", name="Camera", exact=True).click()
        tile = operator.locator(".arm-camera-tile")
        expect(tile.get_by_role("img", name="Camera video0")).to_be_visible()
        # What the camera sends is what is seen.
        operator.wait_for_function(
            """() => {
              const canvas = document.querySelector(".arm-camera-tile canvas");
              const [red, green] = canvas.getContext("2d").getImageData(8, 6, 1, 1).data;
              return canvas.width === 16 && red > 150 && green < 90;
            }"""
        )
        # However long the page needs for a picture, it does not wipe out what is said after it.
        operator.evaluate(
            """() => {
              const make = window.createImageBitmap;
              window.making = 0;
              window.createImageBitmap = async (blob) => {
                window.making += 1;
                await new Promise((done) => setTimeout(done, 500));
                try {
                  return await make(blob);
                } finally {
                  window.making -= 1;
                }
              };
            }"""
        )
        operator.wait_for_function("window.making > 0")
        fake.unplug()
        expect(tile.locator(".arm-camera-said")).to_have_text("no camera is connected at /dev/video0")
        operator.wait_for_function("!window.making")
        expect(tile.locator(".arm-camera-said")).to_have_text("no camera is connected at /dev/video0")
        fake.missing = ""
        expect(tile.locator(".arm-camera-said")).to_be_empty()
        # The next tile is of the browser's computer; this one may be, too.
        operator.get_by_role("button", name="Camera", exact=True).click()
        expect(operator.locator(".arm-camera-tile video")).to_have_count(1)
        tile.first.locator("select").select_option(index=2)
        expect(operator.locator(".arm-camera-tile video")).to_have_count(2)
        studio.until(lambda: not fake.is_open, "the end of the camera")
        tile.first.locator("select").select_option("video0")
        studio.until(lambda: fake.is_open, "the camera")
        operator.get_by_role("navigation", name="Pages").get_by_role("link", name="Wire", exact=True).click()
        studio.until(lambda: not fake.is_open, "the end of the camera")
    finally:
        fake.camera.close()
        studio.studio.cameras.rows.clear()


def test_a_program_is_edited_checked_run_and_ended_by_a_stop(studio: RunningStudio, operator: Page) -> None:
    open_page(operator)
    prepare(operator, speed=100)
    operator.get_by_role("tab", name="Program").click()
    part = operator.locator("#arm-program")
    note = part.locator("[role=status]")

    def add(kind: str) -> None:
        part.get_by_label("Kind of step").select_option(kind)
        part.get_by_role("button", name="Add step").click()

    for kind in ("go to these joint angles", "wait for me", "go to these joint angles", "repeat"):
        add(kind)
    angle = part.get_by_label("J1, degrees")
    for place, by in ((0, 10.0), (1, 0.0)):
        angle.nth(place).fill(str(by))
        angle.nth(place).press("Tab")
    # By keys: who moves a step stays at it, and what was done can be undone.
    part.get_by_role("button", name="Move step 1 down").press("Enter")
    expect(part.get_by_role("button", name="Move step 2 down")).to_be_focused()
    part.get_by_role("button", name="Remove step 1").press("Enter")
    expect(part.get_by_role("button", name="Remove step 1")).to_be_focused()
    for _ in range(2):
        part.get_by_role("button", name="Undo").press("Enter")
    expect(angle.nth(0)).to_have_value("10")
    # By drag, into a repetition.
    part.locator('[data-step="3"] .arm-step-number').drag_to(part.get_by_label("Steps of 4"))
    expect(part.locator('[data-step="3.1"]').get_by_label("J1, degrees")).to_have_value("0")
    part.get_by_label("Name of the program").fill("both")
    part.get_by_role("button", name="Save").click()
    expect(note).to_contain_text("Saved")
    file = studio.studio.recordings.library.folder / "both.toml"
    rows = read_program(file).rows()
    assert [next(iter(row)) for row in rows] == ["joints", "ask", "repeat"]
    assert [next(iter(row)) for row in rows[2]["steps"]] == ["joints"]

    part.get_by_role("button", name="Run", exact=True).click()
    expect(note).to_contain_text("Continue?")
    studio.until(lambda: abs(math.degrees(shaft(studio, "J1")) - 10.0) < 1.0, "the first step")
    # A stop while it waits for somebody voids what is left, although the arm is released again.
    operator.keyboard.press("Escape")
    expect(note).to_contain_text("Ended: stopped")
    operator.get_by_role("button", name="Resume").click()
    expect(operator.get_by_role("button", name="Resume")).to_be_hidden()
    assert math.degrees(rest(studio, "J1")) == pytest.approx(10.0, abs=1.0)

    part.locator('[data-step="2"]').get_by_role("button", name="Run from here").click()
    part.get_by_role("button", name="Continue").click()
    expect(note).to_have_text("The program has ended.")
    assert abs(math.degrees(shaft(studio, "J1"))) < 1.0
    # One step that is not allowed, and none begins.
    angle.nth(1).fill("400")
    angle.nth(1).press("Tab")
    part.get_by_role("button", name="Run", exact=True).click()
    expect(note).to_contain_text("Step 3.1: ")
    assert abs(math.degrees(rest(studio, "J1"))) < 1.0
    file.unlink()


def test_a_gamepad_moves_the_arm_only_while_its_dead_man_button_is_pressed(
    studio: RunningStudio, operator: Page
) -> None:
    operator.evaluate(
        """() => {
          const button = () => ({ pressed: false, value: 0 });
          const buttons = Array.from({ length: 17 }, button);
          window.pad = { connected: true, id: 'Pad', axes: [0, 0, 0, 0], buttons };
          navigator.getGamepads = () => [null, window.pad];
        }"""
    )

    def pad(*, deadman: bool, x: float = 0.0) -> None:
        operator.evaluate("([on, x]) => { pad.buttons[5].pressed = on; pad.axes[0] = x; }", [deadman, x])

    open_page(operator)
    prepare(operator, speed=100)
    hint = operator.locator("#hw-banner")
    operator.locator("#arm-pad").check()
    expect(hint).to_contain_text("hold L1 and move a stick")
    operator.get_by_role("button", name="Mapping of the gamepad").click()
    box = operator.get_by_role("dialog", name="Gamepad")
    box.get_by_label("Dead-man button").select_option("R1")
    box.get_by_label("Moves", exact=True).select_option("the joints")
    box.get_by_label("Direction of J1").select_option("reversed")
    box.get_by_role("button", name="Close").click()
    expect(hint).to_contain_text("hold R1 and move a stick")
    start = shaft(studio, "J1")

    def moved() -> float:
        return shaft(studio, "J1") - start

    # A stick alone moves nothing; nor do fingers that only rest on it.
    pad(deadman=False, x=1.0)
    operator.wait_for_timeout(100)
    pad(deadman=True, x=0.1)
    operator.wait_for_timeout(100)
    assert not studio.studio.source.arm.jog.busy
    pad(deadman=True, x=-1.0)
    studio.until(lambda: moved() > math.radians(2.0), "a jog by the stick, reversed")
    pad(deadman=True, x=1.0)
    studio.until(lambda: moved() < math.radians(1.0), "a jog the other way")
    pad(deadman=False, x=1.0)
    end = rest(studio, "J1")
    # After a stop, a thumb that stays on the button moves nothing when the stop has ended.
    pad(deadman=True, x=1.0)
    studio.until(lambda: shaft(studio, "J1") < end - math.radians(1.0), "a jog")
    operator.keyboard.press("Escape")
    operator.get_by_role("button", name="Resume").click()
    expect(operator.get_by_role("button", name="Resume")).to_be_hidden()
    end = rest(studio, "J1")
    operator.wait_for_timeout(200)
    assert shaft(studio, "J1") == pytest.approx(end, abs=1e-3)
    # A pad that is gone lets go, and the mapping is that of the browser.
    pad(deadman=False)
    expect(hint).to_contain_text("hold R1")
    pad(deadman=True, x=-1.0)
    studio.until(lambda: shaft(studio, "J1") > end + math.radians(1.0), "a jog")
    operator.evaluate("() => { pad.connected = false; }")
    rest(studio, "J1")
    expect(hint).to_contain_text("No gamepad")
    assert json.loads(operator.evaluate("localStorage.getItem('hexwire-gamepad')"))["deadman"] == 5


@pytest.mark.slow
def test_joints_move_only_while_somebody_holds_them(studio: RunningStudio, page: Page) -> None:
    open_page(page)
    expect(page.locator("#hw-banner")).to_contain_text("take control first")
    expect(page.get_by_role("button", name="Jog J1 up")).to_be_disabled()
    expect(page.get_by_role("button", name="Go", exact=True)).to_be_disabled()
    page.get_by_role("button", name="Take control").click()
    prepare(page, speed=20)

    start = shaft(studio, "J1")
    slider = page.get_by_role("slider", name="J1", exact=True)
    thumb = page.locator('tr[data-joint="J1"] .arm-thumb').bounding_box()
    assert thumb is not None
    x, y = thumb["x"] + thumb["width"] / 2, thumb["y"] + 8
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 90, y, steps=3)
    studio.until(lambda: shaft(studio, "J1") > start + 0.1, "the motion")
    page.mouse.up()
    stood = rest(studio, "J1")
    # A hold is where the joint was when it was asked for: a little less far than it came.
    assert start + 0.05 < stood < start + 0.7

    # End, and a press beside the marker, move nothing.
    slider.press("End")
    slider.click(position={"x": 2, "y": 10})
    assert rest(studio, "J1") == pytest.approx(stood, abs=0.02)
    slider.focus()
    page.keyboard.down("ArrowLeft")
    studio.until(lambda: shaft(studio, "J1") < stood - 0.1, "the jog by key")
    page.keyboard.up("ArrowLeft")
    assert rest(studio, "J1") > start - 0.7
    expect(slider).to_have_attribute("aria-valuetext", re.compile("degrees"))

    # The press of a second button takes the focus from the first, which must not end the second's hold.
    for name in ("J4", "J5"):
        begun = shaft(studio, name)
        up = page.get_by_role("button", name=f"Jog {name} up")
        press(page, up, lambda name=name, begun=begun: shaft(studio, name) > begun + 0.1)  # type: ignore[misc]  # bound now
        page.mouse.up()
        rest(studio, name)

    # A motion to a goal goes on by itself, but only while the page is there.
    page.locator("#arm-speed").fill("3")
    page.get_by_role("radio", name="Joint angles").check()
    for end in (page.get_by_role("button", name="End motion").click, page.close):
        start, goal = shaft(studio, "J1"), -60 if shaft(studio, "J1") > 0 else 60
        type_goal(page, J1=goal)
        page.get_by_role("button", name="Go", exact=True).click()
        studio.until(lambda start=start: abs(shaft(studio, "J1") - start) > 0.1, "the motion")  # type: ignore[misc]  # bound now
        end()
        assert abs(rest(studio, "J1") - math.radians(goal)) > 0.1


@pytest.mark.slow
def test_an_arm_that_is_opened_between_a_frame_and_its_picture_breaks_nothing(page: Page) -> None:
    page.get_by_role("navigation", name="Pages").get_by_role("link", name="Move", exact=True).click()
    page.wait_for_function("document.querySelector('[data-tip=x]')?.textContent.length > 1")
    # As where the studio says that it has another arm; what fails in a picture is an error of the page.
    page.evaluate(
        """() => new Promise((done) => {
            const end = hexwire.onFrame(() => {
                end();
                hexwire.frame = null;
                requestAnimationFrame(() => requestAnimationFrame(done));
            });
        })"""
    )
    page.wait_for_function("hexwire.frame")


@pytest.mark.slow
def test_a_goal_is_previewed_and_reached_a_pose_recalled_a_motion_taught(
    studio: RunningStudio, operator: Page
) -> None:
    page = operator
    open_page(page)
    prepare(page, speed=100)
    plan, go = page.locator("#arm-plan"), page.get_by_role("button", name="Go", exact=True)
    before = rest(studio, "J2")
    type_goal(page, y=900)
    expect(plan).to_contain_text("Out of reach")
    expect(go).to_be_disabled()
    page.locator("#arm-goto").evaluate("(form) => form.requestSubmit()")
    # A preview that was not made is no refusal.
    page.evaluate(
        """() => {
            const { call } = hexwire;
            hexwire.call = () => { hexwire.call = call; return Promise.reject(new Error("try again")); };
        }"""
    )
    type_goal(page, x=60)
    expect(plan).to_have_text("try again")
    expect(go).to_be_enabled()
    type_goal(page, y=200, z=180)
    expect(plan).to_contain_text("Takes")
    expect(plan).to_contain_text("front, elbow up")
    expect(page.get_by_role("button", name="Hide preview")).to_be_visible()
    # What a stop had refused is looked at again when the stop has ended.
    page.get_by_role("button", name="STOP", exact=True).click()
    studio.stopped("the stop by the button")
    type_goal(page, z=190)
    expect(plan).to_contain_text("stopped")
    type_goal(page, z=180)
    page.get_by_role("button", name="Resume").click()
    expect(plan).to_contain_text("Takes")
    expect(go).to_be_enabled()
    assert rest(studio, "J2") == pytest.approx(before, abs=0.01)
    go.click()
    expect(plan).to_have_text("Arrived.")
    for axis, value in (("x", 60.0), ("y", 200.0), ("z", 180.0)):
        # The frame that shows it may come after the word.
        page.wait_for_function(
            "([axis, value]) => Math.abs(document.querySelector(`[data-tip=${axis}]`).textContent - value) < 1",
            arg=[axis, value],
        )

    there = rest(studio, "J1")
    page.locator('#arm-pose-form input[name="name"]').fill("over there")
    page.get_by_role("button", name="Save present pose").click()
    page.get_by_role("radio", name="Joint angles").check()
    type_goal(page, J1=0)
    expect(plan).to_contain_text("Takes")
    go.click()
    expect(plan).to_have_text("Arrived.")
    assert rest(studio, "J1") == pytest.approx(0.0, abs=0.02)
    page.get_by_role("button", name="Go to over there").click()
    expect(page.locator("#arm-pose-note")).to_have_text("At over there.")
    assert rest(studio, "J1") == pytest.approx(there, abs=0.02)
    ask_for_long(page)
    for _ in range(2):
        page.get_by_role("button", name="Remove over there").click()
    expect(page.get_by_role("button", name="Go to over there")).to_have_count(0)
    # What is refused from here is allowed from home: Go is on again after the arm has moved.
    page.get_by_role("radio", name="Place of the tip").check()
    page.get_by_role("checkbox", name="from the present tip").check()
    type_goal(page, y=-150)
    expect(go).to_be_disabled()
    # Where the chapter's board drives its arm: a home button, on every arm.
    page.get_by_role("button", name="Go to home").click()
    expect(page.locator("#arm-pose-note")).to_have_text("At home.")
    expect(plan).to_contain_text("Takes")
    expect(go).to_be_enabled()
    assert rest(studio, "J4") == pytest.approx(HEX7BOT.joint("J4").offset, abs=0.02)

    page.get_by_role("tab", name="Teach and play").click()
    expect(page.get_by_role("button", name="Start teaching")).to_be_disabled()
    page.get_by_role("checkbox", name="I hold the arm: it will sink").check()
    page.get_by_role("button", name="Start teaching").click()
    expect(page.locator("#arm-teach-note")).to_contain_text("move the arm by hand")
    model, start = HEX7BOT.joint("J1"), shaft(studio, "J1")
    for _ in range(20):
        studio.servos[model.servo_id].motion.position += math.radians(1) / model.scale * model.sign
        time.sleep(0.02)
    page.get_by_role("button", name="End teaching: hold here").click()
    studio.until(lambda: studio.arm.teach_mode.taught is not None, "the taught motion")
    end, taught = rest(studio, "J1"), studio.arm.teach_mode.taught
    assert end > start + 0.3
    assert taught.rows[-1][0] == pytest.approx(end, abs=0.03)
    # On a busy machine the times of its samples may be anything; the same motion, evenly.
    steps = [i / 20 for i in range(21)]
    rows = tuple((start + (end - start) * (3 * u * u - 2 * u**3),) for u in steps)
    studio.arm.teach_mode.taught = Taught(("J1",), tuple(steps), rows)
    expect(page.locator("#arm-time-value")).to_have_text("0.0 of 1.0 s")
    expect(page.locator("#arm-play-plan")).to_contain_text("Takes")
    page.get_by_role("slider", name="Time in the taught motion").press("End")
    assert rest(studio, "J1") == pytest.approx(end, abs=0.02)
    began = studio.arm.owner.newest().stamp
    page.get_by_role("button", name="Play", exact=True).click()
    expect(page.locator("#arm-play-plan")).to_have_text("Played.")
    way = [values[0] for _, values in studio.studio.source.arm.history.rows(began)]
    assert min(way) < start + 0.1, "it begins at the start"
    # It has arrived as closely as a goal asks for; a machine that stalls shows it there for a while.
    studio.until(lambda: abs(shaft(studio, "J1") - end) < 0.03, "the end of the motion")

    _tips_agree(studio, page)
    studio.open("so101")
    expect(page.get_by_role("slider", name="elbow_flex", exact=True)).to_be_visible()
    _tips_agree(studio, page)
    studio.studio.source.close()
    expect(page.get_by_text("No arm is open.")).to_be_visible()


@pytest.mark.slow
@pytest.mark.parametrize("end", ["arrived", "out of reach"])
def test_the_next_goal_stays_when_the_motion_to_the_last_one_ends(
    studio: RunningStudio, operator: Page, end: str
) -> None:
    page, plan = operator, operator.locator("#arm-plan")
    open_page(page)
    expect(page.locator('[data-tip="x"]')).not_to_have_text("–")
    page.evaluate("() => { hexwire.hold = () => new Promise((resolve) => (window.end = resolve)); }")
    type_goal(page, x=60, y=200, z=180)
    expect(plan).to_contain_text("Takes")
    page.get_by_role("button", name="Go", exact=True).click()
    type_goal(page, y=900)
    expect(plan).to_contain_text("Out of reach")
    type_goal(page, y=190)
    expect(plan).to_contain_text("Takes")
    page.evaluate("(why) => { document.activeElement.blur(); window.end(why); }", end)
    # What the end of the motion shows, and what the next looks at the arm show.
    for _ in range(2):
        taken = page.evaluate("hexwire.frame.time")
        page.wait_for_function("(taken) => hexwire.frame.time > taken + 0.5", arg=taken)
        expect(plan).to_contain_text("Takes")
    expect(page.locator('#arm-goto input[name="y"]')).to_have_value("190")


def _tips_agree(studio: RunningStudio, page: Page) -> None:
    """The browser computes the same tip as the kinematics."""
    source = studio.studio.source.arm
    assert source is not None
    kinematics = source.settings.kinematics
    posture = {j.name: j.minimum + 0.37 * (j.maximum - j.minimum) for j in source.settings.model.joints}
    shown = page.evaluate(
        "([args, row]) => import('/static/arm.js').then((m) => m.tipValues(args, row))",
        [json.loads(json.dumps(arm_values(source))), list(posture.values())],
    )
    tip = Tip.of(kinematics, kinematics.from_joints(posture))
    assert [shown[axis] for axis in "xyz"] == pytest.approx(tip.position, abs=1e-6)
    assert [shown[name] for name in ("roll", "pitch", "yaw")] == pytest.approx(tip.rpy, abs=1e-5)
    if tip.pitch_roll is not None:
        assert (shown["toolpitch"], shown["toolroll"]) == pytest.approx(tip.pitch_roll)


def test_an_arm_is_drawn_as_its_joints_allow_and_names_are_text(page: Page) -> None:
    drawn = page.evaluate(
        """async () => {
            const [arm, motion, timeline] = await Promise.all(
                ["arm", "arm_motion", "arm_timeline"].map((name) => import(`/static/${name}.js`)));
            const joints = [{ name: '<b onclick="x">', min: Math.PI * -0.0002, max: Math.PI / 4 }];
            return [arm.jointsMarkup(joints), arm.tipMarkup(6), arm.tipMarkup(5), motion.gotoMarkup(joints, 6),
                motion.gotoMarkup(joints, 5), motion.gotoMarkup(joints, null), motion.posesMarkup(null),
                motion.posesMarkup({}), timeline.teachMarkup()].map((markup) => markup.text);
        }"""
    )
    joints, six_tip, five_tip, six, five, unknown, no_gripper, gripper, teach = drawn
    assert "<b onclick" not in joints + six
    assert "&#60;b onclick=&#34;x&#34;&#62;" in joints
    assert 'aria-valuemin="0" aria-valuemax="45"' in joints
    assert (six_tip.count("data-tip"), "yaw" in five_tip, 'data-tip="toolpitch"' in five_tip) == (6, False, True)
    assert ('value="rpy"' in six, 'value="pitch"' in six) == (True, False)
    assert ('value="rpy"' in five, 'value="pitch"' in five) == (False, True)
    assert (unknown.count('type="radio"'), 'name="x"' in unknown, unknown.count('name="joint:')) == (1, False, 1)
    assert ('name="gripper"' in no_gripper, 'name="gripper"' in gripper) == (False, True)
    assert 'maxlength="40"' in gripper
    assert check_pose_name(40 * "x") == 40 * "x"
    start = re.search(r'<button[^>]*id="arm-teach-start"[^>]*>', teach)
    assert start is not None
    assert "disabled" in start.group()
