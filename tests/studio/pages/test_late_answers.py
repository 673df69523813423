"""Answers that come after newer ones, or after their page was left, and what is told only once.

Which answer comes late is decided here: `HOLD` keeps the answers of a call until they are let go. `make test` has
what moves an arm or replaces a file, and one for each page.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.studio.pages.test_arm import _no_arm_is_silent, open_page, prepare
from tests.studio.pages.test_timeline import swing
from tests.studio.running import PICTURES, expect, until

from hexwire.control.requests.program import read_program
from hexwire.errors import UsageError
from hexwire.studio.access import Right

if TYPE_CHECKING:
    from playwright.sync_api import Page
    from tests.studio.running import RunningStudio

__all__ = ["_no_arm_is_silent"]

HOLD = """(held) => {
    const { call } = hexwire;
    window.late = [];
    hexwire.call = (name, ...rest) => {
        const answer = call(name, ...rest);
        const late = (value) => new Promise((go) => window.late.push(() => go(value)));
        return name === held ? answer.then(late) : answer;
    };
}"""
"""Keep all answers of a call in `late`."""

NEWER_FIRST = """(which) => {
    const { call } = hexwire;
    let asked = 0, answered;
    const second = new Promise((go) => (answered = go));
    hexwire.call = async (name, ...rest) => {
        if (name !== which) return call(name, ...rest);
        asked += 1;
        const mine = asked, value = await call(name, ...rest);
        // A page that asks one after the other never sends the second one before this.
        if (mine === 1) await Promise.race([second, new Promise((go) => setTimeout(go, 500))]);
        else answered();
        return value;
    };
}"""
"""The first answer of a call comes after the second one, if that is asked for before."""


def held(page: Page, count: int = 1) -> None:
    """Wait until so many answers are late."""
    page.wait_for_function(f"window.late.length >= {count}")


def leave(page: Page, name: str = "Signals") -> None:
    page.get_by_role("navigation", name="Pages").get_by_role("link", name=name, exact=True).click()
    page.get_by_role("heading", name=name, level=1).wait_for()


def _end_teaching(studio: RunningStudio) -> None:
    # For no joint has moved, or on a busy machine for no state has come.
    with pytest.raises(UsageError, match="nothing was recorded"):
        studio.arm.teach_stop()


# -- Move ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_an_older_answer_does_not_say_that_the_arm_is_taught(studio: RunningStudio, operator: Page) -> None:
    studio.torque()
    open_page(operator)
    operator.get_by_role("tab", name="Teach and play").click()
    start = operator.get_by_role("button", name="Start teaching")
    expect(start).to_be_visible()
    operator.evaluate(HOLD, "arm.taught")
    studio.arm.teach_start()
    held(operator)
    _end_teaching(studio)
    held(operator, 2)
    operator.evaluate("() => late.reverse().forEach((go) => go())")
    operator.evaluate(PICTURES)
    expect(start).to_be_visible()


@pytest.mark.slow
def test_poses_that_are_saved_quickly_are_all_in_the_list(studio: RunningStudio, operator: Page) -> None:
    open_page(operator)
    operator.locator("#arm-poses").get_by_text("home").wait_for()
    operator.evaluate(NEWER_FIRST, "arm.save_pose")
    name, save = operator.get_by_label("Name", exact=True), operator.get_by_role("button", name="Save present pose")
    studio.torque()
    expect(save).to_be_enabled()
    poses = studio.studio.source.arm.motions.poses  # type: ignore[union-attr]  # one is open
    try:
        for each in ("late one", "late two"):
            name.fill(each)
            save.click()
        until(lambda: len(poses.load()) >= 2, "two poses")
        operator.locator("#arm-pose-note", has_text="Saved late").wait_for()
        operator.evaluate("new Promise((go) => setTimeout(go, 700))")
        for each in ("late one", "late two"):
            expect(operator.locator("#arm-poses").get_by_text(each)).to_be_visible()
    finally:
        for each in ("late one", "late two"):
            if each in poses.load():
                poses.remove(each)


@pytest.mark.slow
def test_the_preview_of_the_pose_that_was_wanted_last_stays(studio: RunningStudio, operator: Page) -> None:
    poses = studio.studio.source.arm.motions.poses  # type: ignore[union-attr]  # one is open
    poses.save("later", dict(studio.arm.owner.state.positions), force=True)
    try:
        open_page(operator)
        operator.evaluate(HOLD, "arm.preview")
        for name in ("home", "later"):
            operator.get_by_role("button", name=f"Preview {name}").click()
        held(operator, 2)
        operator.evaluate("() => late.reverse().forEach((go) => go())")
        operator.evaluate(PICTURES)
        expect(operator.locator("#arm-pose-note")).to_contain_text("later: ")
    finally:
        poses.remove("later")


@pytest.mark.slow
def test_all_of_a_motion_is_played_although_it_is_smoothed_before_it_is_seen(
    studio: RunningStudio, operator: Page
) -> None:
    folder = Path(studio.studio.recordings.library.folder)
    for name, seconds in (("short", 0.5), ("long", 3.0)):
        swing(folder, f"{name}.mcap", seconds)
    open_page(operator)
    operator.get_by_role("tab", name="Teach and play").click()
    source, time = operator.get_by_label("Motion", exact=True), operator.locator("#arm-time-value")
    source.select_option("short.mcap")
    expect(time).to_have_text("0.0 of 0.5 s")
    operator.evaluate(HOLD, "arm.timeline")
    source.select_option("long.mcap")
    operator.get_by_label("Smooth").select_option("0.1")
    held(operator, 2)
    operator.evaluate("() => late.forEach((go) => go())")
    expect(time).to_have_text("0.0 of 3.0 s")
    end = operator.get_by_role("slider", name="End", exact=True)
    expect(end).to_have_attribute("aria-valuetext", "3.0 seconds")


@pytest.mark.slow
def test_why_teaching_did_not_end_stays_in_sight(studio: RunningStudio, operator: Page) -> None:
    studio.torque()
    open_page(operator)
    operator.get_by_role("tab", name="Teach and play").click()
    operator.get_by_role("checkbox", name="I hold the arm: it will sink").check()
    operator.get_by_role("button", name="Start teaching").click()
    note = operator.locator("#arm-teach-note")
    expect(note).to_contain_text("Teaching for")
    operator.evaluate(
        """() => {
            const { call } = hexwire, busy = () => Promise.reject(new Error("the arm is busy"));
            hexwire.call = (name, ...rest) => name === "arm.teach" ? busy() : call(name, ...rest);
        }"""
    )
    operator.get_by_role("button", name="End teaching").click()
    expect(note).to_have_text("The arm is busy")
    seen = operator.evaluate("hexwire.frame.time")
    operator.wait_for_function("(seen) => hexwire.frame.time > seen", arg=seen)
    operator.evaluate(PICTURES)
    expect(note).to_have_text("The arm is busy")
    _end_teaching(studio)


@pytest.mark.slow
def test_teaching_goes_on_while_its_page_was_left(studio: RunningStudio, operator: Page) -> None:
    studio.torque()
    open_page(operator)
    operator.get_by_role("tab", name="Teach and play").click()
    operator.get_by_role("checkbox", name="I hold the arm: it will sink").check()
    operator.get_by_role("button", name="Start teaching").click()
    note = operator.locator("#arm-teach-note")
    expect(note).to_contain_text("Teaching for")
    operator.evaluate("() => { const now = performance.now(); performance.now = () => now + 100_000; }")
    leave(operator)
    open_page(operator)
    expect(note).to_contain_text("Teaching for 10")
    expect(operator.get_by_role("button", name="End teaching")).to_be_visible()
    _end_teaching(studio)


def test_steps_that_wait_are_not_done_when_their_page_was_left(operator: Page) -> None:
    open_page(operator)
    prepare(operator, speed=30)
    operator.get_by_text("10", exact=True).click()
    operator.evaluate(
        """() => {
            window.held = [];
            hexwire.hold = (kind, args) => new Promise((go) => window.held.push([args, go]));
        }"""
    )
    more = operator.get_by_role("button", name="Jog J1 up")
    for _ in range(3):
        more.click()
    leave(operator)
    operator.evaluate("() => held[0][1]('arrived')")
    operator.evaluate(PICTURES)
    assert operator.evaluate("held.length") == 1


@pytest.mark.slow
def test_a_motion_that_goes_on_is_seen_by_whoever_comes_to_the_page(studio: RunningStudio, operator: Page) -> None:
    open_page(operator)
    prepare(operator, speed=30)
    text = operator.locator("#arm-run-text")
    operator.get_by_label("Joint angles").check()
    operator.locator('#arm-goto input[name="joint:J1"]').fill("60")
    operator.locator("#arm-speed").fill("1")
    operator.get_by_role("button", name="Go", exact=True).click()
    expect(text).to_contain_text("A motion to")
    # Somebody else looks, and whoever began it looks at something else meanwhile.
    other = operator.context.new_page()
    other.goto(studio.watch_url.replace("/?", "/move?"))
    expect(other.locator("#arm-run-text")).to_contain_text("A motion to")
    leave(operator)
    leave(operator, "Move")
    expect(text).to_contain_text("A motion to")
    other.close()


# -- Program ---------------------------------------------------------------------------------------------------


@pytest.fixture
def program(studio: RunningStudio, operator: Page) -> Page:
    """The part Program, with two files."""
    folder = Path(studio.studio.recordings.library.folder)
    folder.mkdir(parents=True, exist_ok=True)
    for name, seconds in (("first", 1), ("second", 2)):
        (folder / f"{name}.toml").write_text(f"[[steps]]\nwait = {seconds}\n")
    studio.torque()
    open_page(operator)
    operator.get_by_role("tab", name="Program").click()
    operator.get_by_label("Saved programs").select_option("first")
    return operator


@pytest.mark.slow
def test_a_program_keeps_the_name_of_its_file(program: Page) -> None:
    """What is chosen when it comes would be its name, and be replaced by it."""
    program.evaluate(HOLD, "arm.program")
    program.locator("#arm-program").get_by_role("button", name="Open").click()
    held(program)
    program.get_by_label("Saved programs").select_option("second")
    program.evaluate("late[0]()")
    expect(program.get_by_label("Seconds")).to_have_value("1")
    expect(program.get_by_label("Name of the program")).to_have_value("first")


def test_a_name_that_is_typed_while_a_program_is_saved_replaces_no_file(
    studio: RunningStudio, program: Page
) -> None:
    part = program.locator("#arm-program")
    part.get_by_role("button", name="Open").click()
    expect(program.get_by_label("Seconds")).to_have_value("1")
    name = program.get_by_label("Name of the program")
    program.evaluate(HOLD, "arm.save_program")
    part.get_by_role("button", name="Save").click()
    held(program)
    name.fill("second")
    program.evaluate("late[0]()")
    note = part.locator("[role=status]")
    expect(note).to_contain_text("Saved")
    part.get_by_role("button", name="Save").click()
    expect(note).to_contain_text("second")
    file = Path(studio.studio.recordings.library.folder) / "second.toml"
    assert read_program(file).rows()[0]["wait"] == 2


@pytest.mark.slow
def test_the_check_of_a_program_that_was_changed_meanwhile_says_nothing(program: Page) -> None:
    part = program.locator("#arm-program")
    part.get_by_role("button", name="Open").click()
    seconds = program.get_by_label("Seconds")
    expect(seconds).to_have_value("1")
    program.evaluate(HOLD, "arm.check_program")
    part.get_by_role("button", name="Check").click()
    held(program)
    seconds.fill("5")
    seconds.press("Tab")
    program.evaluate("late[0]()")
    program.evaluate(PICTURES)
    expect(part.locator("[role=status]")).not_to_contain_text("allowed")


# -- First run -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_an_older_look_does_not_take_the_first_run_back(served: RunningStudio, blank: Page) -> None:
    studio = served.studio
    blank.goto(served.operate_url.replace("/?", "/signals?"))
    blank.wait_for_function("window.hexwire?.connected")
    blank.evaluate(HOLD, "first.look")
    leave(blank, "Arms")
    blank.get_by_role("link", name="First run").click()
    held(blank)
    try:
        studio.first.begin(studio.tabs.open("somebody", Right.OPERATE), "sim://so101?name=late", "so101")
        title = blank.get_by_role("heading", name="What it is", level=2)
        title.wait_for()
        blank.evaluate("late[0]()")
        blank.evaluate(PICTURES)
        expect(title).to_be_visible()
    finally:
        studio.source.close()


def test_what_the_next_step_needs_is_not_wiped_out_by_the_answer_to_the_first(
    served: RunningStudio, blank: Page
) -> None:
    blank.goto(served.operate_url.replace("/?", "/first?"))
    begin = blank.get_by_role("button", name="Begin at sim://so101?any_horns=1")
    begin.wait_for()
    blank.evaluate("() => { hexwire.act = () => new Promise((go) => { window.go = go; }); }")
    begin.click()
    missing = blank.locator(".fr-missing")
    expect(missing).to_contain_text("Opening it")
    missing.evaluate("(element) => { element.textContent = 'Take control to go on.'; }")
    blank.evaluate("go(undefined)")
    blank.evaluate(PICTURES)
    expect(missing).to_have_text("Take control to go on.")


@pytest.mark.slow
def test_what_is_marked_while_a_picture_is_loaded_is_marked(page: Page) -> None:
    page.evaluate(HOLD, "first.shape")
    page.evaluate(
        """async () => {
            const { Picture } = await import("/static/arm_picture.js");
            const place = document.body.appendChild(document.createElement("div"));
            window.picture = new Picture(place, document.createElement("p"));
            picture.show("so101");
            window.marked = picture.show("so101").then(() => picture.mark("shoulder_pan"));
        }"""
    )
    held(page)
    page.evaluate("late[0]()")
    page.evaluate("marked")
    page.wait_for_function("picture.view")
    assert page.evaluate("picture.joint") == "shoulder_pan"


# -- Arms ------------------------------------------------------------------------------------------------------

_ARMS = """() => {
    const { call } = hexwire;
    const words = { why: "", faults: "", holder: "", torque: "on", robot: "", host: "" };
    const arm = (name) => ({ name, own: false, silent: false, known: true, stopped: false, age: 0, ...words });
    const found = { arms: [arm("lab/a"), arm("lab/b")], gone: [], error: "", looking: false, router: "", note: "" };
    hexwire.call = (name, ...rest) => name === "fleet.arms" ? Promise.resolve(found)
        : name === "fleet.open" ? new Promise((go) => { window.go = go; }) : call(name, ...rest);
}"""


def test_whoever_left_the_page_is_not_fetched_back_by_an_arm_that_is_open_at_last(page: Page) -> None:
    page.get_by_role("button", name="Open sim://so101", exact=True).wait_for()
    page.evaluate("() => { hexwire.act = () => new Promise((go) => { window.go = go; }); }")
    page.get_by_role("button", name="Open sim://so101", exact=True).click()
    leave(page)
    page.evaluate("go(null)")
    page.evaluate(PICTURES)
    assert page.evaluate("location.pathname") == "/signals"


@pytest.mark.slow
def test_nor_by_a_shared_arm(page: Page) -> None:
    page.evaluate(_ARMS)
    page.get_by_role("button", name="Open lab/a in this studio").click()
    leave(page)
    page.evaluate("go(null)")
    page.evaluate(PICTURES)
    assert page.evaluate("location.pathname") == "/signals"


def test_what_has_become_of_each_of_two_stops_is_seen(page: Page) -> None:
    page.evaluate(_ARMS)
    page.evaluate(
        """() => {
            const { fetch } = window;
            window.late = [];
            const answer = (line) => Response.json([{ line, confirmed: true }]);
            window.fetch = (address, ...rest) => {
                if (!String(address).startsWith("/fleet/stop")) return fetch(address, ...rest);
                if (String(address).includes("all=1")) return Promise.resolve(answer("lab/b: stopped"));
                return new Promise((go) => window.late.push(() => go(answer("lab/a: stopped"))));
            };
        }"""
    )
    page.get_by_role("button", name="Stop lab/a", exact=True).click()
    results = page.get_by_role("list", name="Results of the last stop")
    expect(results).to_contain_text("Stopping lab/a")
    page.get_by_role("button", name="Stop all arms").click()
    expect(results).to_contain_text("lab/b: stopped")
    page.evaluate("late[0]()")
    expect(results).to_contain_text("lab/a: stopped")
    expect(results).to_contain_text("lab/b: stopped")


# -- Servos ----------------------------------------------------------------------------------------------------


def test_servos_of_an_arm_that_is_closed_by_now_are_not_drawn(studio: RunningStudio, page: Page) -> None:
    page.evaluate(
        """() => {
            const { act } = hexwire;
            window.late = [];
            const late = (value) => new Promise((go) => window.late.push(() => go(value)));
            hexwire.act = (name, ...rest) => {
                const answer = act(name, ...rest);
                return name === "board.servos" ? answer.then(late) : answer;
            };
        }"""
    )
    leave(page, "Servos")
    held(page)
    studio.studio.source.close()
    page.get_by_text("Nothing is open. Open the").wait_for()
    page.evaluate("late[0]()")
    page.evaluate(PICTURES)
    assert page.locator(".sv-columns").count() == 0


_ROW = """(value) => ({
    name: "speed", value, unit: "", why_not: "no", raw: "0", range: "", factory: "", backup: "", kept: "",
    address: 1, differs: [], stored: false, note: "", words: "" })"""


@pytest.mark.parametrize(
    ("part", "again", "first", "second"),
    [
        ("registers", "Read again", "{ undo: '', rows: [row('old')] }", "{ undo: '', rows: [row('new')] }"),
        (
            "backup",
            "Load a backup",
            "[{ servo: 1, title: 'old', differences: [] }]",
            "[{ servo: 1, title: 'new', differences: [] }]",
        ),
    ],
    ids=["registers", "backup"],
)
def test_what_was_read_of_a_servo_before_is_not_shown_last(
    page: Page, part: str, again: str, first: str, second: str
) -> None:
    page.evaluate(
        f"""async () => {{
            const row = {_ROW};
            const parts = await import("/static/servos_settings.js");
            const place = document.body.appendChild(document.createElement("div"));
            place.id = "late-place";
            const answers = [new Promise((go) => {{ window.go = () => go({first}); }}), Promise.resolve({second})];
            const never = new Promise(() => {{}}), send = async () => ({{ servos: [1] }});
            const view = {{ joint: null, act: () => answers.shift() ?? never, send }};
            parts.{part}(view, place, 1);
        }}"""
    )
    place = page.locator("#late-place")
    if part == "registers":
        place.get_by_role("button", name=again).click()
    else:
        place.locator("input[type=file]").set_input_files(
            {"name": "a.json", "mimeType": "application/json", "buffer": b"[]"}
        )
    place.get_by_text("new", exact=True).wait_for()
    page.evaluate("go()")
    page.evaluate(PICTURES)
    expect(place.get_by_text("new", exact=True)).to_be_visible()


# -- Wire ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_frame_that_was_selected_last_stays_selected(page: Page) -> None:
    leave(page, "Wire")
    page.get_by_role("option", name="JOINT_STATE").first.wait_for()
    page.wait_for_function("document.querySelectorAll('.hw-wire-row:not([hidden])').length > 6")
    page.get_by_role("button", name="Pause").click()
    page.evaluate(PICTURES)
    page.evaluate(HOLD, "wire.frame")
    rows = page.locator(".hw-wire-row:not([hidden])")
    for i in (0, 3):
        rows.nth(i).click()
    held(page, 2)
    page.evaluate("() => late.reverse().forEach((go) => go())")
    page.evaluate(PICTURES)
    selected = page.locator('.hw-wire-row[aria-selected="true"]')
    number = page.locator(".hw-wire-head").inner_text().split()[1].rstrip(",")
    expect(selected).to_have_count(1)
    expect(selected).to_contain_text(number)


# -- Recordings ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_arm_of_the_recording_that_is_shown_stays(page: Page) -> None:
    seen = page.evaluate(
        """async () => {
            const { makeFigure } = await import("/static/recordings_arm.js");
            const { geometry } = { geometry: await hexwire.call("first.shape", { robot: "so101" }) };
            let fail;
            const { call } = hexwire;
            hexwire.call = (name, args, ...rest) => name !== "recordings.geometry" ? call(name, args, ...rest)
                : args.robot === "old" ? new Promise((_, no) => { fail = no; }) : Promise.resolve({ geometry });
            const place = document.body.appendChild(document.createElement("div"));
            const figure = makeFigure(place);
            const old = figure.choose("old"), now = figure.choose("so101");
            await now;
            fail(new Error("the connection was lost"));
            await old;
            const hidden = place.hidden;
            figure.destroy();
            return hidden;
        }"""
    )
    assert seen is False


@pytest.fixture
def played(studio: RunningStudio, operator: Page) -> Page:
    """The page Recordings; the preview of what is to be played comes late, and no motion really begins."""
    folder = Path(studio.studio.recordings.library.folder)
    for old in folder.glob("*.mcap"):
        old.unlink()
    swing(folder, "late.mcap", 3.0)
    studio.torque()
    leave(operator, "Recordings")
    operator.get_by_role("button", name="open late.mcap").click()
    play = operator.get_by_role("button", name="Play on the arm")
    expect(play).to_be_enabled()
    operator.evaluate(HOLD, "arm.preview")
    operator.evaluate(
        "() => { window.begun = 0; hexwire.hold = () => { window.begun += 1; return new Promise(() => {}); }; }"
    )
    return operator


def test_a_recording_that_is_checked_does_not_begin_when_it_is_not_wanted_any_more(
    studio: RunningStudio, played: Page
) -> None:
    def end() -> None:
        played.get_by_role("button", name="End", exact=True).click()

    def hide() -> None:
        played.evaluate(
            """() => {
                for (const so of [true, false]) {
                    Object.defineProperty(document, "hidden", { get: () => so, configurable: true });
                    document.dispatchEvent(new Event("visibilitychange"));
                }
            }"""
        )

    def stop() -> None:
        stops = played.evaluate("hexwire.frame.stops")
        played.keyboard.press("Escape")
        studio.stopped("the stop")
        studio.arm.owner.reset()
        played.wait_for_function("(stops) => hexwire.frame.stops !== stops", arg=stops)
        studio.torque()

    play = played.get_by_role("button", name="Play on the arm")
    for count, unwanted in enumerate((end, hide, stop, lambda: leave(played)), 1):
        expect(play).to_be_enabled()
        play.click()
        held(played, count)
        unwanted()
        played.evaluate("late.at(-1)()")
        played.evaluate(PICTURES)
        played.evaluate(PICTURES)
        assert played.evaluate("begun") == 0, unwanted


@pytest.mark.slow
def test_a_motion_is_not_drawn_into_another_recording(studio: RunningStudio, operator: Page) -> None:
    told: dict[str, Any] = {
        "kind": "run",
        "title": "a recording",
        "elapsed": 0.0,
        "duration": 60.0,
        "lead_in": 0.0,
        "outcome": None,
        "text": "",
        "holds": False,
        "off": "",
    }
    operator.evaluate(
        """async () => {
            const { makePlayer } = await import("/static/recordings_play.js");
            const entry = (name) => ({ name, twin: "", fits: true });
            const plan = { refusal: "", unready: "", lead_in: 0, duration: 60, fits: null };
            const page = { args: { operates: true }, outdate: () => {}, entry,
                state: { refusal: "", list: null }, act: async () => plan };
            hexwire.hold = () => new Promise(() => {});
            const place = document.body.appendChild(document.createElement("div"));
            place.id = "late-player";
            window.drawn = 0;
            const times = Float64Array.from({ length: 100 }, (_, i) => i / 10);
            window.data = { times, head: { names: ["J1"] }, columns: new Map() };
            const shown = () => { window.drawn += 1; };
            window.player = makePlayer(page, place, { topic: "", data: null }, shown, () => {});
            player.choose(entry("one"));
            player.loaded(data);
        }"""
    )
    operator.locator("#late-player").get_by_role("button", name="Play on the arm").click()
    operator.wait_for_function("document.querySelector('#late-player progress:not([hidden])')")
    studio.studio.live.tell(told)
    operator.wait_for_function("drawn > 0")
    operator.evaluate(
        "() => { player.choose({ name: 'two', twin: '', fits: true }); player.loaded(data); drawn = 0; }"
    )
    seen = operator.evaluate("hexwire.frame.time")
    # It draws 600 ms apart.
    operator.wait_for_function("(seen) => hexwire.frame.time > seen + 1.5", arg=seen)
    assert operator.evaluate("drawn") == 0
    assert math.isfinite(seen)
