"""The 3D view in a real browser, on a page of its own."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.model.poses import random_angles

from hexwire.drivers.arm_file import load_profile
from hexwire.model.arm import ArmModel
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.geometry import kinematics_for
from hexwire.model.palette import DARK, LIGHT
from hexwire.model.pose import quaternion
from hexwire.studio import geometry

if TYPE_CHECKING:
    from PIL import Image
    from playwright.sync_api import Page, Route

STATIC = Path(geometry.__file__).parent / "static"
ADDRESS = "http://127.0.0.1:9/"
PAGE = """<!doctype html><meta charset="utf-8"><title>arm</title>
<style>html,body{margin:0} #view{width:260px;height:220px}</style>
<div id="view"></div><button>other</button>"""
SO101 = load_profile("so101").model
BENT = {"J1": 0.4, "J2": 1.1, "J3": 0.1, "J5": 0.3, "J7": -0.4}


def _serve(route: Route) -> None:
    path = route.request.url.removeprefix(ADDRESS)
    if path.startswith("static/"):
        file = STATIC / path.removeprefix("static/")
        route.fulfill(body=file.read_bytes(), content_type="text/javascript")
    elif path == "favicon.ico":
        route.fulfill(status=204)
    else:
        route.fulfill(body=PAGE, content_type="text/html")


@pytest.fixture
def blank(blank: Page) -> Page:
    """A page without a studio behind it."""
    blank.route("**/*", _serve)
    blank.goto(ADDRESS)
    return blank


def show(page: Page, arm: ArmModel = HEX7BOT, **options: Any) -> Page:
    """Put an arm into the page, as `view`."""
    page.evaluate(
        """async ([geometry, options]) => {
             const { Arm3D } = await import("/static/arm3d.js");
             window.view = new Arm3D(document.getElementById("view"), geometry, options);
           }""",
        [geometry.make_geometry(arm), {"theme": "light", **options}],
    )
    return page


def settle(page: Page) -> int:
    """Wait until nothing is left to draw; the number of pictures so far."""
    page.wait_for_function("!view.pending")
    return int(page.evaluate("view.drawn"))


def seen(page: Page) -> Image.Image:
    from PIL import Image

    settle(page)
    return Image.open(io.BytesIO(page.locator("#view").screenshot())).convert("RGB")


def hued(picture: Image.Image, colour: str) -> int:
    """How many pixels have the hue of a colour: light and shade change only the brightness."""
    import numpy as np

    want = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    length = math.hypot(*want)
    pixels = np.asarray(picture, float)
    size = np.linalg.norm(pixels, axis=2)
    return int(((size > 60) & (pixels @ np.array(want, float) > 0.995 * size * length)).sum())


@pytest.mark.parametrize("arm", [HEX7BOT, pytest.param(SO101, marks=pytest.mark.slow)], ids=lambda arm: arm.name)
def test_the_tip_is_that_of_the_kinematics(blank: Page, arm: ArmModel) -> None:
    show(blank, arm)
    model = kinematics_for(arm)
    assert model is not None
    poses = [angles[: len(model.ranges)] for angles in random_angles(61, 12)]
    rows = [[model.to_joints(angles).get(name, 0.2) for name in arm.names] for angles in poses]
    found = blank.evaluate(
        "(rows) => rows.map((row) => (view.setJoints(Float64Array.from(row)), view.tip()))", rows
    )
    for angles, tip in zip(poses, found, strict=True):
        pose = model.forward(angles)
        # A hundredth of a millimetre.
        assert math.dist(tip["position"], pose.position) < 1e-5
        turn = quaternion(pose.rotation)
        assert abs(sum(a * b for a, b in zip(tip["quaternion"], turn, strict=True))) == pytest.approx(1.0, abs=1e-6)
    # By name is the same, and what is not named stays.
    named = dict(zip(arm.names, rows[0], strict=True))
    again = blank.evaluate("(joints) => (view.setJoints(joints), view.setJoints({}), view.tip())", named)
    assert math.dist(again["position"], found[0]["position"]) < 1e-9


def test_a_silent_joint_freezes_nothing_and_what_it_moves_is_marked(blank: Page) -> None:
    show(blank)
    turned = """(values) => {
        view.setJoints(Float32Array.from(values.map((value) => value ?? NaN)));
        const grey = view.geometry.links.map((link, i) => view._arm.bodies[i]?.material === view._lostMaterial);
        view._arm.root.updateMatrixWorld();
        const place = view._arm.frames.map((frame) => frame.matrixWorld.elements[12]);
        return { grey, place, said: view._legend.hidden ? "" : view._legend.textContent };
    }"""
    joints = [0.0, 1.2, 0.3, 0.0, 0.2, 0.0, 0.0]
    links = geometry.make_geometry(HEX7BOT)["links"]  # type: ignore[index]  # it has a geometry
    whole = blank.evaluate(turned, joints)
    assert (any(whole["grey"]), whole["said"]) == (False, "")
    for silent, name in enumerate(HEX7BOT.names):
        values: list[float | None] = [0.5, *joints[1:]]
        values[silent] = None
        seen = blank.evaluate(turned, values)
        assert seen["said"] == f"Grey: what {name} moves may be elsewhere"
        for i, link in enumerate(links):
            at, moved = i, False
            while at >= 0 and not moved:
                moved, at = links[at].get("joint", -1) == silent and "axis" in links[at], links[at]["parent"]
            assert not link["shapes"] or seen["grey"][i] is moved, (name, link["name"])
        # What is known is drawn where it is: J1 has turned the arm, but where J1 itself is silent.
        assert (seen["place"] != whole["place"]) is (silent != 0), name
        whole = blank.evaluate(turned, joints)
        assert (any(whole["grey"]), whole["said"]) == (False, "")
    blank.evaluate("view.setJoints(new Float32Array(7), [])")
    assert blank.evaluate("view._legend.textContent") == "Grey: the arm may be elsewhere"
    assert blank.evaluate("view._tipAxes.visible") is False


@pytest.mark.slow
def test_it_draws_only_what_has_changed(blank: Page) -> None:
    show(blank)
    blank.evaluate("(joints) => view.setJoints(joints)", BENT)
    before = settle(blank)
    assert before >= 1
    # The same values draw nothing.
    blank.evaluate("(joints) => { for (let i = 0; i < 50; i++) view.setJoints(joints); }", BENT)
    blank.evaluate("view.setGhost(null);")
    assert settle(blank) == before
    blank.evaluate("for (let i = 0; i < 50; i++) view.setJoints({ J1: 0.001 * i });")
    # One, or two without a graphics chip, and one with smooth edges.
    assert before < settle(blank) <= before + 3


@pytest.mark.slow
def test_it_shows_joints_in_their_colours_in_both_themes(blank: Page) -> None:
    show(blank)
    blank.evaluate("(joints) => view.setJoints(joints)", BENT)
    light = seen(blank)
    # The first four are big enough to be counted.
    assert [hued(light, LIGHT[i]) > 15 for i in range(4)] == [True] * 4
    blank.evaluate("view.setTheme('dark')")
    dark = seen(blank)
    assert [hued(dark, DARK[i]) > 15 for i in range(4)] == [True] * 4
    assert sum(light.getpixel((5, 5))) > 3 * 200
    assert sum(dark.getpixel((5, 5))) < 3 * 60
    # "auto" follows the page.
    blank.evaluate("view.setTheme('auto'); document.documentElement.dataset.theme = 'light'")
    blank.wait_for_function("view.theme === 'light'")
    blank.evaluate("document.documentElement.dataset.theme = 'dark'")
    blank.wait_for_function("view.theme === 'dark'")


@pytest.mark.slow
def test_ghost_trace_table_and_tip_are_seen_and_go_again(blank: Page) -> None:
    show(blank)
    blank.evaluate("(joints) => view.setJoints(joints)", BENT)
    plain = last = seen(blank).tobytes()
    for order in (
        "view.setGhost({ J1: -0.6, J2: 0.5, J3: 0.4 })",
        "view.trace([[0, 0.2, 0.2], [0.1, 0.25, 0.1], [-0.1, 0.3, 0.1]])",
        "view.setTable(0.05)",
        "view.setTip({ position: [0, 0.25, 0.2], quaternion: [0, 0, 0, 1] })",
        "view.setTip('own'); view.trace(Float32Array.of(0, 0.2, 0.2, 0.1, 0.25, 0.1))",
    ):
        blank.evaluate(order)
        changed = seen(blank).tobytes()
        assert sum(a != b for a, b in zip(last, changed, strict=True)) > 150, order
        last = changed
    blank.evaluate("view.setGhost(null); view.trace(null); view.setTable(null); view.setTip(null)")
    assert seen(blank).tobytes() == plain


@pytest.mark.slow
def test_keys_and_wheel_move_the_camera_and_leave_the_rest_alone(blank: Page) -> None:
    show(blank)
    place = "view._camera.position.toArray()"
    home = blank.evaluate(place)
    # The wheel scrolls the page until the view has the focus.
    blank.mouse.move(120, 120)
    blank.mouse.wheel(0, 300)
    settle(blank)
    assert blank.evaluate(place) == pytest.approx(home)
    canvas = blank.locator("#view canvas")
    # Nor does it keep a finger from scrolling the page.
    assert canvas.evaluate("(own) => getComputedStyle(own).touchAction") == "pan-y"
    assert "Arrow keys" in (canvas.get_attribute("aria-label") or "")
    blank.keyboard.press("Tab")
    assert canvas.evaluate("(own) => document.activeElement === own")
    for key in ("ArrowRight", "ArrowUp", "Shift+ArrowLeft", "+", "-"):
        before = blank.evaluate(place)
        blank.keyboard.press(key)
        assert math.dist(blank.evaluate(place), before) > 0.005, key
    blank.keyboard.press("0")
    assert blank.evaluate(place) == pytest.approx(home)
    blank.mouse.wheel(0, 300)
    blank.wait_for_function(f"Math.hypot(...{place}) > {math.hypot(*home)} + 0.01")
    # STOP listens for Escape on the page.
    blank.evaluate("addEventListener('keydown', (event) => (window.heard = [event.key, event.defaultPrevented]))")
    blank.keyboard.press("Escape")
    assert blank.evaluate("window.heard") == ["Escape", False]
    blank.keyboard.press("Tab")
    assert blank.evaluate("document.activeElement.textContent") == "other"


@pytest.mark.slow
def test_the_camera_follows_an_arm_that_leaves_the_picture_until_somebody_turns_it(blank: Page) -> None:
    show(blank, SO101)
    furthest = """() => {
      const { frames } = view._arm, place = frames[0].position.clone();
      view._camera.updateMatrixWorld();
      return Math.max(...frames.flatMap((one) => {
        const { x, y } = one.getWorldPosition(place).project(view._camera);
        return [Math.abs(x), Math.abs(y)];
      }));
    }"""
    pose = "(joints) => view.setJoints(joints, view.geometry.joints.map(() => true))"
    folded = {"shoulder_lift": -1.65, "elbow_flex": 1.5, "wrist_flex": 0.85}
    stretched = {"shoulder_lift": 0.9, "elbow_flex": -1.4, "wrist_flex": 0.0}
    zeros = dict.fromkeys(SO101.names, 0.0)
    blank.evaluate(pose, zeros | folded)
    before = blank.evaluate("view._camera.position.toArray()")
    blank.evaluate(pose, zeros | {"shoulder_lift": -1.6, "elbow_flex": 1.5, "wrist_flex": 0.85})
    assert blank.evaluate("view._camera.position.toArray()") == before
    blank.evaluate(pose, zeros | stretched)
    assert blank.evaluate("view._camera.position.toArray()") != before
    assert blank.evaluate(furthest) <= 0.95
    blank.locator("#view canvas").press("ArrowLeft")
    for _ in range(9):
        blank.locator("#view canvas").press("+")
    mine = blank.evaluate("view._camera.position.toArray()")
    blank.evaluate(pose, zeros | folded)
    blank.evaluate(pose, zeros | stretched)
    assert blank.evaluate(furthest) > 1.0
    assert blank.evaluate("view._camera.position.toArray()") == mine


PLACES = """(() => {
  const box = document.querySelector("canvas").getBoundingClientRect();
  return view._arm.bodies.filter(Boolean).map((body) => {
    body.geometry.computeBoundingSphere();
    const at = body.localToWorld(body.geometry.boundingSphere.center.clone()).project(view._camera);
    return [box.left + (at.x + 1) / 2 * box.width, box.top + (1 - at.y) / 2 * box.height];
  });
})()"""
"""Where the parts of the arm are on the screen."""


@pytest.mark.slow
def test_dragging_turns_it_and_its_size_follows_the_page(blank: Page) -> None:
    show(blank)
    settle(blank)
    place = "view._camera.position.toArray()"
    home = blank.evaluate(place)
    blank.mouse.move(120, 120)
    blank.mouse.down()
    blank.mouse.move(180, 135, steps=4)
    blank.mouse.up()
    assert math.dist(blank.evaluate(place), home) > 0.05
    for name in ("front", "side", "top"):
        blank.evaluate("(name) => view.resetView(name)", name)
    x, y, z = blank.evaluate(place)
    assert z > 3 * math.hypot(x, y - 0.1)
    # Near the tip it is looked at; a double click looks at the joint that moves what is under the pointer.
    blank.evaluate("view.resetView('tip')")
    aim = "view._controls.target.toArray()"
    assert blank.evaluate(aim) == pytest.approx(blank.evaluate("view.tip().position"))
    blank.evaluate("view.resetView('side')")
    before = blank.evaluate(aim)
    blank.mouse.dblclick(2, 2)
    assert blank.evaluate(aim) == before
    frames = "view._arm.frames.map((frame) => frame.getWorldPosition(frame.position.clone()).toArray())"
    settle(blank)
    for shown in blank.evaluate(PLACES):
        blank.mouse.dblclick(*shown)
    assert any(math.dist(blank.evaluate(aim), frame) < 1e-6 for frame in blank.evaluate(frames))
    blank.evaluate("document.getElementById('view').style.width = '300px'")
    blank.wait_for_function("[300, 600].includes(document.querySelector('canvas').width)")
    drawn = settle(blank)
    # Out of sight it draws nothing, and is there again afterwards.
    blank.evaluate("document.getElementById('view').style.display = 'none'; view.setJoints({ J1: 1 })")
    assert settle(blank) == drawn
    blank.evaluate("document.getElementById('view').style.display = ''")
    blank.wait_for_function(f"view.drawn > {drawn}")
    blank.evaluate("view.dispose(); view.setJoints({ J1: 0 })")
    assert blank.locator("canvas").count() == 0


@pytest.mark.slow
def test_without_webgl_it_says_so_and_does_nothing(blank: Page) -> None:
    blank.evaluate("HTMLCanvasElement.prototype.getContext = () => null")
    show(blank)
    assert "WebGL is off" in blank.locator("#view").inner_text()
    calls = (
        "view.setJoints({J1: 1}); view.setGhost({}); view.setTip('own'); view.setTable(0); view.trace([[0, 0, 0]]);"
    )
    blank.evaluate(f"{calls} view.setTheme('dark'); view.resetView(); view.resize(); view.dispose();")
    assert blank.evaluate("[view.available, view.tip()]") == [False, None]


@pytest.mark.slow
def test_without_its_library_it_says_so(blank: Page) -> None:
    page = blank
    page.route("**/vendor/**", lambda route: route.fulfill(body="export {};", content_type="text/javascript"))
    page.goto(ADDRESS)
    show(page)
    assert "library was not found" in page.locator("#view").inner_text()
    assert json.loads(page.evaluate("JSON.stringify(view.available)")) is False
