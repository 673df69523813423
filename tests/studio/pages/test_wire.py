"""The page Wire, as a person uses it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.frames import frame_bytes
from tests.studio.running import PATIENCE, PICTURES

from hexwire.link.tap import Direction, Passed
from hexwire.trace.sources import read_traffic
from hexwire.wire.command_frame import Command, Status

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator, Page, ViewportSize
    from tests.studio.running import RunningStudio

CAPTURES = Path(__file__).parents[3] / "vectors" / "captures"
PHONE: ViewportSize = {"width": 390, "height": 844}
FINGER = 44
"""Pixels that a finger hits."""
_SMALL = """(least) => {
    const pressed = "main :is(button, select, input, summary, [role=option], [role=treeitem], .hw-wire-open)";
    return [...document.querySelectorAll(pressed)].flatMap((one) => {
        const box = ["checkbox", "file"].includes(one.type) && one.closest("label") || one;
        if (!box.checkVisibility({ visibilityProperty: true })) return [];
        const { width, height } = box.getBoundingClientRect();
        return Math.min(width, height) < least - 0.5 ? [`${one.className} ${width} ${height}`] : [];
    });
}"""
_IN_SIGHT = """() => {
    const box = document.querySelector(".hw-wire-list").getBoundingClientRect();
    return [...document.querySelectorAll(".hw-wire-row:not([hidden])")]
        .map((row) => [row.getBoundingClientRect(), row])
        .filter(([row]) => row.top >= box.top - 1 && row.bottom <= box.bottom + 1)
        .sort(([one], [other]) => one.top - other.top)
        .map(([, row]) => Number(row.dataset.number));
}"""
"""Numbers of the frames that are whole in sight, from above."""


@pytest.fixture
def wire(page: Page) -> Page:
    page.get_by_role("navigation", name="Pages").get_by_role("link", name="Wire", exact=True).click()
    page.get_by_role("heading", name="Wire", level=1).wait_for()
    # At first the many reports of the board are hidden.
    page.get_by_role("option", name="JOINT_STATE reply").first.wait_for()
    assert not page.get_by_role("option", name="JOINT_STATE report").count()
    page.get_by_role("group", name="Show").get_by_label("reports").check()
    page.get_by_role("option", name="JOINT_STATE report").first.wait_for()
    return page


def press(row: Locator) -> None:
    """Press a row; Playwright's own click would scroll to one that is out of sight."""
    row.evaluate("(row) => row.dispatchEvent(new PointerEvent('pointerdown', { bubbles: true })) && row.click()")


def reports(studio: RunningStudio, count: int) -> Passed:
    """What a board says, received just now. What the line brings may end within a frame."""
    report = frame_bytes(Command.STATS, bytes(60), proto=2, seq=1, src=8, dst=7, cmd_ext=0x40)
    (_, newest) = studio.studio.wire._ring.since(0)[-1]
    return newest._replace(direction=Direction.RECEIVED, data=report * count)


def open_file(page: Page, name: str) -> None:
    page.get_by_label("Open a recording, capture or log").set_input_files(CAPTURES / name)
    page.get_by_text(name).wait_for()


@pytest.mark.slow
def test_live_frames_are_saved_filtered_and_paused(wire: Page, tmp_path: Path) -> None:
    with wire.expect_download() as download:
        wire.get_by_role("button", name="Save pcapng").click()
    path = tmp_path / "x.pcapng"
    download.value.save_as(path)
    found = [each for each in read_traffic(path.read_bytes()) if isinstance(each, Passed)]
    assert len(found) > 10
    assert {each.direction for each in found} == set(Direction)
    wire.get_by_label("Filter", exact=True).fill("joint_state answer")
    frames = wire.get_by_role("listbox", name="Frames")
    wire.wait_for_function(
        """() => {
          const texts = [...document.querySelectorAll(".hw-wire-row:not([hidden]) .hw-wire-text")];
          return texts.length > 3 && texts.every((each) => each.textContent.includes("JOINT_STATE reply ok"));
        }"""
    )
    wire.get_by_role("button", name="Pause").click()
    wire.get_by_role("button", name="Go on").wait_for()
    # What has come before is drawn with the next picture.
    wire.evaluate(PICTURES)
    shown = frames.inner_text()
    wire.wait_for_timeout(300)
    assert frames.inner_text() == shown
    # Another filter is one for the frames that are shown, and not for what has come since.
    newest = max(wire.evaluate(_IN_SIGHT))
    wire.wait_for_timeout(300)
    wire.get_by_label("Filter", exact=True).fill("joint_state")
    wire.wait_for_function(
        """() => [...document.querySelectorAll(".hw-wire-row:not([hidden]) .hw-wire-text")]
            .some((each) => !each.textContent.includes("reply"))"""
    )
    wire.wait_for_timeout(300)
    assert newest - 50 < max(wire.evaluate(_IN_SIGHT)) <= newest + 50
    wire.get_by_label("Filter", exact=True).fill("servo")
    wire.get_by_text("servo needs a number").wait_for()
    # Nothing is said of frames while there is no filter.
    wire.wait_for_function("document.querySelector('.hw-wire-status').textContent === ''")
    assert not wire.locator(".hw-wire-nothing").is_visible()
    wire.get_by_label("Filter", exact=True).fill("")
    wire.get_by_role("button", name="Go on").click()
    wire.wait_for_function(f"Math.max(...({_IN_SIGHT})()) > {newest + 100}")


@pytest.mark.slow
def test_one_click_hides_and_shows_frames_of_a_kind(wire: Page) -> None:
    def texts(true: str) -> None:
        wire.wait_for_function(
            f"""() => {{
              const rows = [...document.querySelectorAll(".hw-wire-row:not([hidden]) .hw-wire-text")];
              const texts = rows.map((one) => one.textContent);
              return texts.length > 3 && {true};
            }}"""
        )

    shown = wire.get_by_role("group", name="Show")
    texts("texts.some((one) => one.includes(' report '))")
    shown.get_by_label("reports").click()
    texts("texts.every((one) => !one.includes(' report ')) && texts.some((one) => one.includes(' request '))")
    shown.get_by_label("requests").click()
    texts("texts.every((one) => one.includes(' reply '))")
    # It stays so while another page is looked at, and goes with what is typed.
    wire.get_by_role("navigation", name="Pages").get_by_role("link", name="Signals", exact=True).click()
    wire.get_by_role("navigation", name="Pages").get_by_role("link", name="Wire", exact=True).click()
    assert not shown.get_by_label("requests").is_checked()
    shown.get_by_label("reports").click()
    wire.get_by_label("Filter", exact=True).fill("received")
    texts("texts.some((one) => one.includes(' report ')) && texts.every((one) => !one.includes(' request '))")


@pytest.mark.slow
def test_in_a_file_a_byte_shows_its_field_and_a_field_its_bytes(wire: Page) -> None:
    open_file(wire, "cut-frame.pcapng")
    detail = wire.get_by_role("region", name="The selected frame")
    detail.get_by_text("Answered by 2").wait_for()
    # A byte by mouse: the field in the tree is chosen.
    detail.locator("#hw-wire-byte-45").click()
    chosen = detail.locator('[role="treeitem"][aria-selected="true"]')
    assert chosen.locator(".hw-wire-name").inner_text() == "address"
    assert "0x38 present_position" in detail.locator(".hw-wire-info").inner_text()
    # A field by keyboard: its bytes are marked.
    wire.get_by_role("tree").press("ArrowUp")
    assert chosen.locator(".hw-wire-name").inner_text() == "instruction"
    assert detail.locator(".hw-wire-byte.hw-wire-on").all_inner_texts() == ["02"]
    wire.get_by_role("listbox", name="Bytes of the frame").press("Home")
    assert chosen.locator(".hw-wire-name").inner_text() == "sync"
    assert detail.locator(".hw-wire-byte.hw-wire-on").all_inner_texts() == ["5A", "FA", "FA", "5A"]
    # The pair, and the list by keyboard.
    detail.get_by_role("button", name="Answered by 2").click()
    detail.get_by_text("Answers 1").wait_for()
    wire.get_by_role("listbox", name="Frames").press("ArrowDown")
    detail.get_by_text("Frame 3, sent").wait_for()
    assert "a board of the chapter cuts the frame there" in detail.inner_text()
    wire.get_by_label("Open a recording, capture or log").set_input_files(
        {"name": "x.txt", "mimeType": "text/plain", "buffer": b"hello"}
    )
    wire.get_by_text("x.txt has no traffic").wait_for()
    open_file(wire, "wrong-id.txt")
    wire.get_by_role("option", name="status 1 legacy").wait_for()
    wire.get_by_role("button", name="Back to the line").click()
    wire.get_by_role("option", name="JOINT_STATE").first.wait_for()


@pytest.mark.slow
def test_a_thousand_frames_a_second_are_few_elements(wire: Page, studio: RunningStudio) -> None:
    for _ in range(400):
        studio.studio.wire._ring.feed(reports(studio, 10))
    wire.wait_for_function(
        "Number(document.querySelector('.hw-wire-status').textContent.match(/of (\\d+)/)[1]) > 4000"
    )
    assert wire.locator(".hw-wire-row").count() < 100


def test_frames_have_the_room_until_one_is_selected(wire: Page) -> None:
    share = """() => document.querySelector(".hw-wire-left").clientWidth
        / document.querySelector(".hw-wire-panes").clientWidth"""
    wire.wait_for_function(
        f"document.querySelectorAll('.hw-wire-row:not([hidden])').length > 5 && ({share})() > 0.7"
    )
    press(wire.locator(".hw-wire-row:not([hidden])").first)
    wire.wait_for_function(f"({share})() < 0.6")


def test_the_list_stays_at_a_frame_that_is_read_until_it_is_closed(wire: Page) -> None:
    wire.wait_for_function("document.querySelector('.hw-wire-inner').clientHeight > 1200")
    top, status = "document.querySelector('.hw-wire-list').scrollTop", wire.locator(".hw-wire-status")
    for ends in ("Close", "Follow"):
        press(wire.locator(".hw-wire-row:not([hidden])").last)
        status.get_by_text("stays at frame").wait_for()
        # Beside the frame the list is narrower, and shows the rows around it.
        wire.locator(".hw-wire-head").get_by_text("Frame ").wait_for()
        wire.evaluate(PICTURES)
        before = wire.evaluate(top)
        height = wire.evaluate("document.querySelector('.hw-wire-inner').clientHeight")
        wire.wait_for_function(f"document.querySelector('.hw-wire-inner').clientHeight > {height + 440}")
        assert wire.evaluate(top) == before
        assert wire.get_by_label("Follow").is_checked()
        if ends == "Close":
            wire.get_by_role("button", name="Close", exact=True).click()
        else:
            wire.get_by_label("Follow").uncheck()
            wire.get_by_label("Follow").check()
        wire.wait_for_function(f"{top} > {before + 300}")


def test_a_filter_that_no_frame_passes_says_so_and_is_removed_by_a_click(wire: Page) -> None:
    box, nothing = wire.get_by_label("Filter", exact=True), wire.locator(".hw-wire-nothing")
    box.fill("servo_torque")
    nothing.get_by_text('No frame of these is "servo_torque"').wait_for()
    # It stays so while another page is looked at, and when the page is loaded again.
    wire.get_by_role("navigation", name="Pages").get_by_role("link", name="Signals", exact=True).click()
    wire.get_by_role("navigation", name="Pages").get_by_role("link", name="Wire", exact=True).click()
    nothing.wait_for()
    wire.reload()
    nothing.wait_for()
    assert box.input_value() == "servo_torque"
    wire.get_by_label("Problems").check()
    nothing.get_by_text('is "servo_torque" and a problem').wait_for()
    wire.get_by_role("button", name="Show all").click()
    wire.get_by_role("option", name="JOINT_STATE").first.wait_for()
    nothing.wait_for(state="hidden")
    assert (box.input_value(), wire.get_by_label("Problems").is_checked()) == ("", False)


def test_problems_are_what_is_damaged_has_a_remark_or_reports_an_error(wire: Page, studio: RunningStudio) -> None:
    wire.get_by_label("Problems").check()
    wire.locator(".hw-wire-nothing").get_by_text("is a problem").wait_for()
    passed = reports(studio, 1)
    refused = frame_bytes(Command.TORQUE, b"", proto=2, seq=1, src=8, dst=7, cmd_ext=0x80 | Status.STOPPED)
    damaged = passed.data[:-4] + b"??\r\n"
    studio.studio.wire._ring.feed(passed._replace(data=damaged + refused))
    wire.get_by_role("option", name="bad frame").wait_for()
    wire.get_by_role("option", name="TORQUE reply stopped").wait_for()
    assert not wire.get_by_role("option", name="STATS").count()


def test_what_the_studio_has_no_more_is_neither_counted_nor_selected(wire: Page, studio: RunningStudio) -> None:
    before = studio.studio.wire._live.traffic.newest
    for _ in range(110):
        studio.studio.wire._ring.feed(reports(studio, 100))
    wire.wait_for_function(
        """() => {
            const found = document.querySelector(".hw-wire-status").textContent.match(/(\\d+) of (\\d+) frames/);
            return found && found[1] === "10000" && found[2] === "10000";
        }"""
    )
    wire.get_by_label("Follow").uncheck()
    wire.get_by_role("listbox", name="Frames").press("End")
    wire.get_by_role("listbox", name="Frames").press("Home")
    selected = "document.querySelector('.hw-wire-selected')"
    wire.wait_for_function(f"{selected} && document.querySelector('.hw-wire-list').scrollTop < 22 * 1000")
    assert int(wire.evaluate(f"{selected}.dataset.number")) > before + 1000


def test_an_answer_that_the_filter_hides_is_known_to_its_request(wire: Page) -> None:
    wire.get_by_label("Filter", exact=True).fill("request joint_state")
    wire.wait_for_function(
        "/^▸\\d+$/.test(document.querySelector('.hw-wire-row:not([hidden]) .hw-wire-took')?.textContent)"
    )


def test_rows_bytes_and_fields_are_copied(wire: Page) -> None:
    open_file(wire, "cut-frame.pcapng")
    detail = wire.get_by_role("region", name="The selected frame")
    detail.get_by_text("Answered by 2").wait_for()
    wire.evaluate(
        """window.addEventListener("copy", (event) => {
            window.copied = event.clipboardData.getData("text/plain");
        })"""
    )
    found = {}
    for role, name in (("listbox", "Frames"), ("listbox", "Bytes of the frame"), ("tree", "Layers and fields")):
        wire.get_by_role(role, name=name).focus()  # type: ignore[arg-type]
        wire.keyboard.press("Control+c")
        found[name] = wire.evaluate("window.copied")
    detail.get_by_role("button", name="Copy").click()
    whole = wire.evaluate("window.copied")
    row, hexed, field = found.values()
    assert row.startswith("1  ")
    assert "  sent  1 READ" in row
    assert hexed.startswith("5A FA FA 5A ")
    assert field.startswith("cmd  ")
    assert whole == f"{row}\n{hexed}"


def test_the_words_of_the_filter_are_closed_by_a_press_elsewhere_or_escape(wire: Page) -> None:
    words, meaning = wire.get_by_text("Words", exact=True), wire.get_by_text("names servo 3")
    for close in (lambda: wire.get_by_label("Filter", exact=True).click(), lambda: wire.keyboard.press("Escape")):
        words.click()
        meaning.wait_for()
        close()
        meaning.wait_for(state="hidden")


@pytest.mark.slow
def test_without_a_connection_nothing_is_live(studio: RunningStudio, browser: Browser) -> None:
    context = browser.new_context(bypass_csp=True)
    context.set_default_timeout(1000 * PATIENCE)
    try:
        page = context.new_page()
        page.goto(studio.operate_url.replace("/?", "/wire?"))
        page.locator(".hw-wire-status").get_by_text("live: ").wait_for()
        # As a studio that was started again: it does not know the sessions of the one before.
        for key in list(studio.studio.access._sessions):
            studio.studio.access.leave(key)
        page.locator(".hw-wire-status").get_by_text("no connection to the studio").wait_for()
        page.locator("#hw-banner").get_by_text("does not know this page any more").wait_for()
        assert page.get_by_label("Filter", exact=True).get_attribute("aria-invalid") != "true"
    finally:
        context.close()


def test_a_press_on_a_frame_selects_it_although_the_list_moves_on(wire: Page) -> None:
    rows = ".hw-wire-row:not([hidden])"
    wire.wait_for_function(f"document.querySelectorAll('{rows}').length > 20")
    box = wire.get_by_role("listbox", name="Frames").bounding_box()
    assert box is not None
    x, y = box["x"] + 100, box["y"] + 150
    wire.evaluate(
        """() => {
            window.at = (target) => target.closest(".hw-wire-row")?.dataset.number;
            const note = (event) => (window.aimed = at(event.target));
            document.addEventListener("pointerdown", note, { capture: true, once: true });
        }"""
    )
    wire.mouse.move(x, y)
    wire.mouse.down()
    wire.wait_for_function("([x, y]) => Number(at(document.elementFromPoint(x, y))) > Number(aimed)", arg=[x, y])
    wire.mouse.up()
    wire.get_by_role("region", name="The selected frame").get_by_text(
        f"Frame {wire.evaluate('aimed')}, "
    ).wait_for()


def test_the_list_stays_while_a_mouse_aims_at_it(wire: Page) -> None:
    wire.wait_for_function("document.querySelector('.hw-wire-inner').clientHeight > 1200")
    wire.evaluate(
        """() => {
            const list = document.querySelector(".hw-wire-list"), inner = document.querySelector(".hw-wire-inner");
            const aim = () => list.dispatchEvent(new PointerEvent("pointermove", { pointerType: "mouse" }));
            window.aiming = setInterval(aim, 20);
            aim();
            requestAnimationFrame(() => (window.before = [list.scrollTop, inner.clientHeight]));
            window.moved = () => [list.scrollTop - before[0], inner.clientHeight - before[1]];
        }"""
    )
    wire.wait_for_function("window.before && moved()[1] > 440")
    assert wire.evaluate("moved()[0]") < 100
    wire.evaluate("clearInterval(aiming)")
    wire.wait_for_function("moved()[0] > 440")


@pytest.mark.slow
def test_follow_keeps_its_state_until_somebody_ticks_it_or_scrolls_back(wire: Page) -> None:
    follow = wire.get_by_label("Follow")
    frames = wire.get_by_role("listbox", name="Frames")

    def next_pictures() -> None:
        wire.evaluate(
            "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done))))"
        )

    def grown() -> None:
        number = wire.evaluate("document.querySelector('.hw-wire-inner').style.height")
        wire.wait_for_function(f"document.querySelector('.hw-wire-inner').style.height !== '{number}'")
        next_pictures()

    for ticked in (False, True):
        follow.set_checked(ticked)
        grown()
        wire.get_by_label("Filter", exact=True).fill("joint_state" if ticked else "received")
        grown()
        wire.get_by_role("button", name="Clear").click()
        grown()
        press(frames.locator(".hw-wire-row:not([hidden])").last)
        grown()
        wire.set_viewport_size({"width": 1024, "height": 700 + 50 * ticked})
        grown()
        open_file(wire, "cut-frame.pcapng")
        wire.get_by_role("button", name="Back to the line").click()
        grown()
        wire.get_by_role("navigation", name="Pages").get_by_role("link", name="Move", exact=True).click()
        wire.get_by_role("heading", name="Move", level=1).wait_for()
        wire.get_by_role("navigation", name="Pages").get_by_role("link", name="Wire", exact=True).click()
        wire.get_by_role("option", name="JOINT_STATE").first.wait_for()
        grown()
        assert follow.is_checked() is ticked
    wire.wait_for_function("(({ scrollTop }) => scrollTop > 200)(document.querySelector('.hw-wire-list'))")
    frames.hover()
    wire.mouse.wheel(0, -150)
    wire.wait_for_function("!document.querySelector('.hw-wire-label input').checked")


def test_a_phone_shows_the_frames_or_one_with_those_around_it(wire: Page) -> None:
    wire.set_viewport_size(PHONE)

    def fits() -> None:
        # Once it is drawn: the panes have what the lines above them leave, which grow with what they say.
        wire.wait_for_function(
            """({ width, height }) => {
                const { scrollWidth, scrollHeight } = document.documentElement;
                return scrollWidth === width && scrollHeight === height;
            }""",
            arg=PHONE,
        )
        assert not wire.evaluate(_SMALL, FINGER)

    more, close = (wire.get_by_role("button", name=name, exact=True) for name in ("More", "Close"))
    wire.wait_for_function(f"({_IN_SIGHT})().length > 8")
    fits()
    # What is needed now and then is in a sheet, which leaves STOP in sight.
    clear = wire.get_by_role("button", name="Clear", exact=True)
    assert not clear.is_visible()
    more.click()
    wire.get_by_text("Words", exact=True).click()
    wire.get_by_text("names servo 3").wait_for()
    fits()
    assert wire.get_by_role("button", name="STOP", exact=True).evaluate(
        """(stop) => {
            const { left, top, width, height } = stop.getBoundingClientRect();
            return document.elementFromPoint(left + width / 2, top + height / 2) === stop;
        }"""
    )
    clear.click()
    clear.wait_for(state="hidden")
    # The list stays at a frame that is read, although others come.
    wire.wait_for_function(f"({_IN_SIGHT})().length > 8")
    number = wire.evaluate(
        f"""() => {{
            const number = ({_IN_SIGHT})()[4], row = document.getElementById(`hw-wire-${{number}}`);
            row.dispatchEvent(new PointerEvent("pointerdown", {{ bubbles: true }}));
            row.click();
            return number;
        }}"""
    )
    detail = wire.get_by_role("region", name="The selected frame")
    detail.get_by_text(f"Frame {number}, ").wait_for()
    around = [number - 1, number, number + 1]
    wire.wait_for_function(f"(around) => String(({_IN_SIGHT})()) === String(around)", arg=around)
    wire.wait_for_timeout(500)
    assert wire.evaluate(_IN_SIGHT) == around
    fits()
    # The chosen field is in sight among the fields, and so are its bytes.
    for part in ('[role="treeitem"][aria-selected="true"]', ".hw-wire-byte.hw-wire-cursor"):
        assert detail.locator(part).evaluate(
            """(one) => {
                const [inner, outer] = [one, one.parentElement].map((each) => each.getBoundingClientRect());
                return inner.top >= outer.top && inner.bottom <= outer.bottom;
            }"""
        ), part
    cursor = detail.locator(".hw-wire-byte.hw-wire-cursor")
    at = int(cursor.get_attribute("data-at") or "")
    wire.get_by_role("listbox", name="Bytes of the frame").press("ArrowUp")
    assert cursor.get_attribute("data-at") == str(at - 8)
    close.click()
    wire.wait_for_function(f"({_IN_SIGHT})().length > 8 && ({_IN_SIGHT})()[0] > {number}")
    # A file has nothing to pause or to follow, and its frames are seen first.
    open_file(wire, "cut-frame.pcapng")
    wire.get_by_role("button", name="Back to the line").wait_for()
    wire.wait_for_function(f"({_IN_SIGHT})().length === 6")
    assert not close.is_visible()
    assert not wire.get_by_role("button", name="Pause").is_visible()
    assert not wire.get_by_label("Follow").is_visible()


@pytest.mark.slow
def test_a_list_that_follows_does_not_move_under_a_finger(studio: RunningStudio, browser: Browser) -> None:
    context = browser.new_context(viewport=PHONE, has_touch=True, is_mobile=True, bypass_csp=True)
    context.set_default_timeout(1000 * PATIENCE)
    try:
        page = context.new_page()
        page.goto(studio.operate_url.replace("/?", "/wire?"))
        page.get_by_role("option", name="JOINT_STATE").first.wait_for()
        page.get_by_role("group", name="Show").get_by_label("reports").check()
        page.wait_for_function("document.querySelector('.hw-wire-inner').clientHeight > 2000")
        follow, top = page.get_by_label("Follow"), "document.querySelector('.hw-wire-list').scrollTop"
        touch = context.new_cdp_session(page)

        def send(kind: str, *y: float) -> None:
            touch.send(
                "Input.dispatchTouchEvent",
                {"type": f"touch{kind}", "touchPoints": [{"x": 200, "y": each} for each in y]},
            )

        # So slowly that no step alone is a way back.
        send("Start", 500)
        for i in range(60):
            send("Move", 500 + 2 * i)
        page.wait_for_function("!document.querySelector('.hw-wire-label input').checked")
        page.evaluate(PICTURES)
        before = page.evaluate(top)
        height = page.evaluate("document.querySelector('.hw-wire-inner').clientHeight")
        page.wait_for_function(f"document.querySelector('.hw-wire-inner').clientHeight > {height + 440}")
        assert page.evaluate(top) == before
        # Lifted while it rests, the finger does not throw the list.
        send("End")
        follow.check()
        page.wait_for_function(f"{top} > {before + 440}")
    finally:
        context.close()
