"""The frame of every page: facts in sight, and STOP by button and by Escape."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.studio.conftest import ready, shrink_views

from hexwire.model.state import JointFlag

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Page
    from tests.studio.running import RunningStudio


def test_stop_is_always_there(studio: RunningStudio, page: Page) -> None:
    page.locator("#hw-fact-dialect", has_text="2").wait_for(state="attached")
    for how in ("button", "Escape"):
        if how == "button":
            page.get_by_role("button", name="STOP", exact=True).click()
        else:
            page.keyboard.press("Escape")
        studio.stopped(f"the stop by {how}")
        page.locator("#hw-banner", has_text="Stopped").wait_for()
        studio.arm.owner.reset()
        page.locator("body:not(.hw-stopped)").wait_for()


def test_pages_read_the_bits_of_a_joint_as_the_server_means_them(page: Page) -> None:
    bits = [int(flag) for flag in JointFlag]
    said = page.evaluate("(bits) => import('/static/live.js').then((live) => bits.map(live.faultsOf))", bits)
    assert said == [[str(flag)] if flag.faults else [] for flag in JointFlag]
    named = page.evaluate("import('/static/live.js').then((live) => live.FLAG)")
    assert sorted(named.values()) == bits
    assert (named["torque"], named["unknown"]) == (JointFlag.TORQUE_ON, JointFlag.TORQUE_UNKNOWN)


@pytest.mark.slow
def test_the_theme_is_chosen_and_kept(page: Page) -> None:
    page.locator("#hw-status summary").click()
    button = page.locator("#hw-theme")
    button.filter(has_text="auto").click()
    button.filter(has_text="light").click()
    page.wait_for_function("document.body.classList.contains('body--dark')")
    page.reload()
    page.wait_for_function("document.body.classList.contains('body--dark')")


def test_stop_works_while_a_dialog_is_open(studio: RunningStudio, page: Page) -> None:
    page.evaluate("() => void import('/static/forms.js').then((m) => m.question('Sure?', 'A question.', 'Yes'))")
    page.get_by_text("A question.").wait_for()
    page.get_by_role("button", name="STOP", exact=True).click()
    studio.stopped("the stop by the button")
    studio.arm.owner.reset()
    page.get_by_text("A question.").click()
    page.keyboard.press("Escape")
    studio.until(lambda: studio.arm.owner.group.reason is not None, "the stop by Escape")


@pytest.mark.slow
def test_a_script_in_a_text_from_elsewhere_does_not_run(studio: RunningStudio, browser: Browser) -> None:
    # A context of its own: the browser reports what it refuses as an error.
    context = browser.new_context()
    try:
        page = context.new_page()
        page.goto(studio.operate_url)
        page.locator("#hw-fact-rate", has_text="Hz").wait_for(state="attached")
        page.evaluate(
            """() => {
                const main = document.getElementById("hw-main");
                main.insertAdjacentHTML("beforeend", "<img src='data:x' onerror='window.ran = 1'>");
                const script = document.createElement("script");
                script.textContent = "window.ran = 2";
                main.append(script);
            }"""
        )
        page.wait_for_timeout(300)
        assert page.evaluate("window.ran === undefined")
    finally:
        context.close()


_CHANGE_THE_FACTS = """() => {
    const places = () => JSON.stringify([...document.querySelectorAll(
        "#hw-main, .hw-fact, .hw-nav-link, .hw-status summary span, .hw-actions button"
    )].filter((element) => !element.hidden).map((element) => {
        const box = element.getBoundingClientRect();
        return [element.id, box.x, box.y, element.id === "hw-main" || box.width];
    }));
    const facts = [...document.querySelectorAll(".hw-fact dd, #hw-name, #hw-brief")];
    document.getElementById("hw-status").open = true;
    const all = [...document.querySelectorAll(".hw-actions .hw-button")];
    all.forEach((button) => (button.hidden = false));
    const shown = (text, banner) => {
        facts.forEach((fact) => (fact.textContent = text));
        document.getElementById("hw-banner").textContent = banner;
        return places();
    };
    const long = "a long text ".repeat(30);
    const found = [shown("", ""), shown("–", "Stopped"), shown(long, "Stopped"), shown(long, long)];
    const stop = () => JSON.stringify(document.getElementById("hw-stop").getBoundingClientRect());
    const before = stop();
    all.forEach((button) => (button.hidden = true));
    const height = document.querySelector(".hw-header").getBoundingClientRect().height;
    return { same: new Set(found).size === 1, stop: before === stop(), found, height, at: JSON.parse(before) };
}"""


def test_nothing_moves_when_the_facts_change(page: Page) -> None:
    """A page that moves under the pointer makes a person press another button than the one aimed at."""
    for width, rows in ((1920, 1), (1440, 1), (1200, 1), (1024, 1), (820, 2), (390, 2)):
        page.set_viewport_size({"width": width, "height": 900})
        places = page.evaluate(_CHANGE_THE_FACTS)
        assert places["same"], (width, places["found"])
        assert places["stop"], f"STOP moves with the buttons beside it, {width} wide"
        # A row has at most 56 pixels; STOP is whole, at the right end of the first one.
        height, stop = places["height"], places["at"]
        assert 56 * (rows - 1) < height <= 56 * rows, f"{height} pixels of header, {width} wide"
        assert 0 <= stop["top"] < stop["bottom"] <= 56, (width, stop)
        assert width - 16 <= stop["right"] <= width, (width, stop)


def test_nothing_moves_when_control_is_taken(studio: RunningStudio, page: Page) -> None:
    """The torque buttons come at the left of what is pressed, and Give back comes in the place of Take control."""
    boxes = """() => JSON.stringify([...document.querySelectorAll(".hw-nav-link, #hw-stop")].map(
        (each) => each.getBoundingClientRect()
    ))"""
    take, leave = page.locator("#hw-take"), page.locator("#hw-leave")
    for width in (1440, 1024, 390):
        page.set_viewport_size({"width": width, "height": 900})
        take.wait_for()
        before, pressed = page.evaluate(boxes), take.bounding_box()
        take.click()
        leave.wait_for()
        assert page.evaluate(boxes) == before, width
        assert leave.bounding_box() == pressed, width
        leave.click()
    # A second tap on Torque on meets nothing on a phone.
    page.locator("#hw-take").click()
    page.locator("#hw-torque-on").click()
    studio.until(lambda: len(studio.arm.owner.state.torque_on) == 7, "torque")
    page.locator("#hw-torque-on").wait_for(state="hidden")
    assert not page.locator("#hw-torque-off").is_visible()
    page.locator("#hw-status summary").click()
    page.locator("#hw-limp").click()
    studio.until(lambda: not studio.arm.owner.state.torque_on, "no torque")


@pytest.mark.slow
def test_the_bar_below_the_header_is_in_sight_wherever_the_page_is_scrolled(
    studio: RunningStudio, blank: Page
) -> None:
    blank.goto(studio.operate_url.replace("/?", "/move?"))
    ready(blank)
    shrink_views(blank)
    for width in (1440, 390):
        blank.set_viewport_size({"width": width, "height": 700})
        blank.evaluate("scrollTo(0, 500)")
        blank.keyboard.press("Escape")
        blank.locator("#hw-banner", has_text="Stopped").wait_for()
        found = "document.elementFromPoint(30, document.querySelector('.hw-header').offsetHeight + 10).id"
        assert blank.evaluate(found) == "hw-banner", width
        studio.arm.owner.reset()
        blank.locator("body:not(.hw-stopped)").wait_for()


_TELL_OF_THE_ARM = """() => [
    "", "Torque is off: the arm does not move until it is on.", "J2 leaves its limits. ".repeat(6)
].map((text) => {
        for (const id of ["hw-banner", "arm-plan", "arm-run-text"]) {
            document.getElementById(id).textContent = text;
        }
        document.getElementById("arm-pose-note").textContent = text && "At home.";
        document.querySelector('[data-value="state"]').textContent = text || "holds";
        document.querySelector('[data-value="load"]').textContent = text ? "−100" : "0";
        document.getElementById("arm-branch-field").hidden = !text;
        const buttons = [...document.querySelectorAll(".hw-main button")];
        return JSON.stringify(buttons.map((button) => button.getBoundingClientRect()));
    })"""


@pytest.mark.slow
def test_no_button_of_the_arm_moves_when_something_is_told(studio: RunningStudio, blank: Page) -> None:
    blank.goto(studio.operate_url.replace("/?", "/move?"))
    ready(blank)
    shrink_views(blank)
    blank.locator("#hw-banner", has_text="take control").wait_for()
    blank.locator("#arm-pose-note").wait_for(state="attached")
    for width in (1440, 820, 390):
        blank.set_viewport_size({"width": width, "height": 900})
        assert len(set(blank.evaluate(_TELL_OF_THE_ARM))) == 1, width


@pytest.mark.slow
@pytest.mark.parametrize(
    ("path", "texts"),
    [
        ("recordings", ".rc-note"),
        ("", ".hw-present"),
    ],
)
def test_what_is_below_stays_when_something_is_told(
    studio: RunningStudio, blank: Page, path: str, texts: str
) -> None:
    page = blank
    page.goto(studio.operate_url.replace("/?", f"/{path}?"))
    page.locator(texts).first.wait_for(state="attached")
    places = page.evaluate(
        """(texts) => ["", "a.mcap was deleted"].map((text) => {
            const all = [...document.querySelectorAll(texts)];
            all.forEach((one) => {
                const told = one.classList.contains("hw-present") ? document.createElement("p") : one;
                told.textContent = text;
                if (told !== one) one.replaceChildren(...(text ? [told, told.cloneNode(true)] : []));
                one.hidden = !text && !one.classList.contains("hw-present");
            });
            const follows = (one) => all[0].compareDocumentPosition(one) & Node.DOCUMENT_POSITION_FOLLOWING;
            const below = [...document.querySelectorAll("table, .hw-row, .rc-play")].filter(follows);
            return JSON.stringify([below.length > 0, ...below.map((one) => one.getBoundingClientRect().y)]);
        })""",
        texts,
    )
    assert places[0].startswith("[true")
    assert len(set(places)) == 1, places


@pytest.mark.slow
@pytest.mark.parametrize("width", [1440, 390])
def test_nothing_moves_while_servos_are_searched(
    served: RunningStudio, context: BrowserContext, width: int
) -> None:
    served.studio.source.silence = 5.0
    served.studio.source.open_bus("sim://so101?name=moves")
    try:
        page = context.new_page()
        page.set_viewport_size({"width": width, "height": 900})
        page.goto(served.operate_url.replace("/?", "/servos?"))
        page.get_by_role("button", name="Take control").click()
        page.get_by_role("button", name="Give back").wait_for()
        page.locator(".sv-list .sv-hint").wait_for()
        page.evaluate(
            """() => {
                const place = () => document.querySelector(".sv-list").getBoundingClientRect().y + window.scrollY;
                window.places = new Set([place()]);
                const look = () => {
                    window.places.add(place());
                    requestAnimationFrame(look);
                };
                look();
            }"""
        )
        page.get_by_label("Ids").fill("1-7")
        page.get_by_role("button", name="Search", exact=True).click()
        page.get_by_text("6 servos found").wait_for()
        page.get_by_role("tab", name="Id and rate").click()
        page.get_by_label("New id").wait_for()
        assert page.evaluate("[...window.places].length") == 1
    finally:
        served.studio.source.close()


@pytest.mark.slow
def test_the_facts_have_room(served: RunningStudio, context: BrowserContext) -> None:
    served.studio.source.silence = 5.0
    served.studio.source.open_bus("sim://so101?name=facts")
    try:
        page = context.new_page()
        page.goto(served.operate_url.replace("/?", "/servos?"))
        page.get_by_role("button", name="Take control").click()
        page.get_by_role("button", name="Torque off", exact=True).wait_for()
        page.locator("#hw-status summary").click()
        for width in (1440, 820):
            page.set_viewport_size({"width": width, "height": 900})
            boxes = [fact.bounding_box() for fact in page.locator(".hw-fact").all()]
            assert all(box is not None and box["width"] > 50 for box in boxes), boxes
            cut = "(facts) => facts.filter((fact) => fact.scrollWidth > fact.clientWidth + 1).length"
            assert page.locator(".hw-fact dd").evaluate_all(cut) <= (1 if width < 1000 else 0)
    finally:
        served.studio.source.close()


@pytest.mark.slow
def test_a_message_is_in_sight_long_enough_to_be_read(studio: RunningStudio, operator: Page) -> None:
    """The header is drawn again four times a second, which must not take away what has just been told."""
    banner = operator.locator("#hw-banner")
    studio.studio.live.tell({"kind": "news", "level": "error", "text": "the stop was not confirmed: no answer"})
    banner.filter(has_text="not confirmed").wait_for()
    operator.wait_for_timeout(300)
    assert "not confirmed" in banner.inner_text()
    operator.keyboard.press("Escape")
    # What lasts comes beside it.
    banner.filter(has_text="not confirmed").filter(has_text="Stopped").wait_for()


_KEEP_THE_NUMBER = """
    WebSocket.prototype.send = (text) => { if (/^{"do":"stop"/.test(text)) window.number = JSON.parse(text).id; }
"""


@pytest.mark.slow
def test_a_stop_is_sent_again_with_its_number(page: Page) -> None:
    page.evaluate(_KEEP_THE_NUMBER)
    page.evaluate(
        """() => {
            window.fetch = (url) => Promise.resolve({ ok: true, url: (window.asked = url) });
            // A clock that goes back: no answer counts as one to this stop.
            let now = 1e6;
            performance.now = () => (now -= 1);
            hexwire.stop();
        }"""
    )
    page.wait_for_function("window.asked")
    tab = page.evaluate("""document.querySelector('meta[name="hexwire-tab"]').content""")
    assert page.evaluate("window.asked") == f"/stop?tab={tab}&id={page.evaluate('window.number')}"


@pytest.mark.slow
def test_a_copy_of_a_page_has_other_numbers_of_stops(page: Page) -> None:
    """A stop of the copy, by HTTP, would be taken for one that the page has sent before, and be dropped."""
    numbers = set()
    for _ in range(2):
        page.reload()
        page.wait_for_function("window.hexwire?.connected")
        page.evaluate(_KEEP_THE_NUMBER)
        page.evaluate("hexwire.stop()")
        numbers.add(page.evaluate("window.number"))
    assert len(numbers) == 2


@pytest.mark.slow
def test_what_ended_as_it_was_asked_for_is_no_alarm(studio: RunningStudio, operator: Page) -> None:
    operator.evaluate(
        """() => {
            const button = document.body.appendChild(document.createElement("button"));
            hexwire.holdButton(button, "joint", {});
            window.press = () => button.dispatchEvent(new KeyboardEvent("keydown", { key: " " }));
            window.up = () => !button.classList.contains("hw-held");
        }"""
    )
    studio.studio.holds.begin = lambda *_: None  # type: ignore[method-assign]  # it moves nothing
    try:
        for why, told in (("complete", False), ("arrived", False), ("the servo is hot", True)):
            operator.evaluate("press()")
            held = studio.studio.source.arm.hold_to_run  # type: ignore[union-attr]  # one is open
            studio.until(lambda held=held: held.entry is not None, "the hold")
            held.end_all(why)
            operator.wait_for_function("up()")
            assert (why in operator.locator("#hw-banner").inner_text().lower()) is told, why
    finally:
        del studio.studio.holds.begin


def test_a_button_that_is_pressed_without_a_connection_does_nothing_later(
    studio: RunningStudio, page: Page
) -> None:
    present = studio.studio.source.present
    close = page.get_by_role("button", name="Close")
    close.wait_for()
    # No new socket can be opened for now, and the present one closes.
    page.evaluate("() => { window.Plain = WebSocket; WebSocket = class { static OPEN = 1; readyState = 3; }; }")
    studio.cut(page)
    page.wait_for_function("!hexwire.connected")
    close.click()
    page.get_by_text("No connection to the studio: nothing was done").wait_for()
    assert not page.locator("#hw-take").is_visible()
    page.reload()
    # What had been kept would be done before what comes now.
    page.get_by_role("button", name="Take control").click()
    page.get_by_role("button", name="Give back").wait_for()
    assert studio.studio.source.present is present


@pytest.mark.slow
def test_a_watcher_is_offered_no_control_and_given_none(studio: RunningStudio, blank: Page) -> None:
    blank.goto(studio.watch_url)
    ready(blank)
    assert not blank.locator("#hw-take").is_visible()
    blank.locator('.hw-nav-link[data-path="/move"]').click()
    blank.locator("#hw-banner", has_text="This page only watches").wait_for()
    refused = blank.evaluate("hexwire.call('take').catch((error) => error.message)")
    assert "watching only" in refused
    assert studio.studio.source.present is not None
    assert studio.studio.source.present.holder is None
