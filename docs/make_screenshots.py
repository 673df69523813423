"""Takes the pictures of the studio, from emulated arms and Debian's Chromium.

``pictures/studio-PAGE-THEME.png`` is a page; ``pictures/studio-moving.webp`` is the page Move while the arm moves.

    python docs/make_screenshots.py                 all pages, light and dark, and the one that moves
    python docs/make_screenshots.py move wire        these pages only
    python docs/make_screenshots.py moving          that one only

Seeds, poses and sizes are the same each time; times and rates on the pages are those of the run.
"""

from __future__ import annotations

import io
import math
import os
import re
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

from PIL import Image  # noqa: E402  # comes with matplotlib
from tests.studio.chromium import chromium  # noqa: E402  # found by the line above

from hexwire.fleet.service import Service  # noqa: E402
from hexwire.fleet.service_file import read_arms  # noqa: E402
from hexwire.studio.access import Access  # noqa: E402
from hexwire.studio.app import Studio  # noqa: E402
from hexwire.studio.server import Server, make_app  # noqa: E402

if TYPE_CHECKING:
    from playwright.sync_api import Page

WIDTH, HEIGHT = 1280, 800
HEX7BOT = "sim://hex7bot?seed=1"
SO101 = "sim://so101?seed=1"

MOVING = "moving"
FILM = (1024, 900)
"""Pixels of the picture that moves; its page is as high as what is pressed on it."""
_FILMED = 11.0
"""Seconds of it."""

_WAVE = """async (seconds) => {
  const goals = (t) => ({ J1: 0.6 * Math.sin(t), J2: 1.1 + 0.3 * Math.cos(t), J3: 0.3 * Math.sin(2 * t), J5: 0.5 });
  hexwire.hold("drag", { goals: goals(0), speed: 0.6 });
  const begin = performance.now();
  for (;;) {
    const t = (performance.now() - begin) / 1000;
    if (t > seconds) break;
    hexwire.update({ goals: goals(t), speed: 0.6 });
    await new Promise((next) => setTimeout(next, 50));
  }
  hexwire.release();
}"""
"""Joints that follow a wave, as somebody drags them."""


@contextmanager
def served() -> Iterator[tuple[Studio, str]]:
    """A studio in this process; gives it and its address."""
    studio = Studio(Access(frozenset()))
    # A machine that is busy with pictures is no browser that hangs.
    studio.source.silence = 5.0
    server = Server(partial(make_app, studio), studio.access)
    port = server.bind()
    studio.access.hosts = frozenset({f"127.0.0.1:{port}"})
    ready = threading.Event()
    thread = threading.Thread(target=server.run, args=(ready.set,))
    thread.start()
    ready.wait(20)
    try:
        yield studio, f"http://127.0.0.1:{port}/?token={studio.access.operate_token}"
    finally:
        studio.source.close()
        server.end()
        thread.join()
        studio.close()


def operate(page: Page) -> None:
    """Take control, and switch torque on."""
    take = page.get_by_role("button", name="Take control")
    give = page.get_by_role("button", name="Give back")
    take.or_(give).first.wait_for()
    if take.is_visible():
        take.click()
    on, off, resume = (page.get_by_role("button", name=name) for name in ("Torque on", "Torque off", "Resume"))
    on.or_(off).or_(resume).first.wait_for()
    if resume.is_visible():
        # A machine that stalled has tripped the watchdog.
        resume.click()
        on.or_(off).first.wait_for()
    if on.is_visible():
        on.click()
    off.wait_for()


def go(page: Page, name: str) -> None:
    """Go to a page by its link."""
    page.get_by_role("navigation").get_by_role("link", name=name, exact=True).click()
    page.get_by_role("heading", name=name, level=1).wait_for()


def show_arm(page: Page) -> None:
    """The arm, half way, with the preview of a goal."""
    operate(page)
    page.evaluate(_WAVE, 4.0)
    show_goal(page)


def show_goal(page: Page) -> None:
    """The preview of a goal."""
    operate(page)
    for axis, value in (("x", "-100"), ("y", "200"), ("z", "220")):
        page.locator(f'#arm-goto input[name="{axis}"]').fill(value)
    page.get_by_text("Takes").first.wait_for()


def show_plots(page: Page) -> None:
    """Positions and goals of a few joints that moved."""
    operate(page)
    page.evaluate(_WAVE, 14.0)
    page.get_by_role("button", name="Pause").click()


def show_wire(page: Page) -> None:
    """A frame, its layers, and a byte of it."""
    operate(page)
    page.evaluate(_WAVE, 2.0)
    page.get_by_role("textbox", name="Filter").fill("JOINT_MOVE")
    page.get_by_role("option", name="JOINT_STATE").first.wait_for(state="hidden")
    page.get_by_text("JOINT_MOVE request").last.click()


def show_servos(page: Page) -> None:
    """The registers of a servo on a bare bus."""
    page.get_by_role("button", name="Take control").click()
    page.get_by_role("button", name="Search", exact=True).click()
    page.get_by_text("6 servos found").wait_for()
    page.get_by_role("tab", name="Registers").click()
    page.get_by_text("max_position_limit").wait_for()


def show_recordings(page: Page) -> None:
    """A recording and its plot."""
    operate(page)
    page.get_by_role("button", name="Record the arm").click()
    page.evaluate(_WAVE, 6.0)
    page.get_by_role("button", name="End the recording").click()
    page.get_by_role("button", name=re.compile("^open ")).first.click()
    page.locator(".u-over").first.wait_for()


def show_arms(page: Page) -> None:
    """What is plugged in, and three shared arms."""
    page.get_by_text("lab/arm3").first.wait_for()


PAGES: dict[str, tuple[str, str, Callable[[Page], None]]] = {
    "move": ("Move", HEX7BOT, show_arm),
    "servos": ("Servos", SO101, show_servos),
    "signals": ("Signals", HEX7BOT, show_plots),
    "wire": ("Wire", HEX7BOT, show_wire),
    "recordings": ("Recordings", HEX7BOT, show_recordings),
    "arms": ("Arms", HEX7BOT, show_arms),
}
"""By name of the picture: name of the page, what is open, and what somebody does there first."""


def film(page: Page) -> None:
    """The arm as it is dragged about and goes to a place: each frame is shown for as long as it was there."""
    page.set_viewport_size({"width": FILM[0], "height": FILM[1]})
    show_goal(page)
    frames, times = list[Image.Image](), list[float]()
    page.evaluate(f"(seconds) => {{ window.wave = ({_WAVE})(seconds); }}", 2.0 * math.pi)
    begin = time.monotonic()
    went = False
    while time.monotonic() - begin < _FILMED:
        if not went and time.monotonic() - begin > 2.0 * math.pi + 0.5:
            page.locator("#arm-goto").get_by_role("button", name="Go", exact=True).click()
            went = True
        times.append(time.monotonic())
        picture = page.screenshot(animations="disabled", caret="hide")
        frames.append(Image.open(io.BytesIO(picture)).convert("RGB"))
    times.append(time.monotonic())
    first, *others = frames
    first.save(
        HERE / "pictures" / f"studio-{MOVING}.webp",
        save_all=True,
        append_images=others,
        duration=[round(1000 * (after - before)) for before, after in pairwise(times)],
        loop=0,
        quality=60,
        method=6,
    )


def main() -> int:
    """Take the pictures; returns the exit status."""
    wanted = sys.argv[1:] or [*PAGES, MOVING]
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        os.environ.update(XDG_RUNTIME_DIR=folder, XDG_STATE_HOME=folder, XDG_DATA_HOME=folder)
        studio, url = stack.enter_context(served())
        browser = stack.enter_context(chromium())
        arms: list[Service] = []
        for theme in ("light", "dark"):
            context = browser.new_context(
                viewport={"width": WIDTH, "height": HEIGHT}, color_scheme=theme, reduced_motion="reduce"
            )
            page = context.new_page()
            page.goto(url)
            if MOVING in wanted and theme == "light":
                studio.source.close()
                studio.source.open(HEX7BOT)
                go(page, "Move")
                film(page)
                page.set_viewport_size({"width": WIDTH, "height": HEIGHT})
            for picture in wanted:
                if picture == MOVING:
                    continue
                name, port, prepare = PAGES[picture]
                studio.source.close()
                if picture == "servos":
                    studio.source.open_bus(port)
                elif port:
                    studio.source.open(port)
                if picture == "arms" and not arms:
                    rows = {f"lab/arm{i}": {"robot": "sim"} for i in (1, 2, 3)}
                    arms.append(stack.enter_context(Service(read_arms(rows))))
                go(page, name)
                prepare(page)
                page.mouse.move(WIDTH - 1, HEIGHT - 1)
                page.evaluate("scrollTo(0, 0)")
                page.wait_for_timeout(1000)
                page.screenshot(
                    path=HERE / "pictures" / f"studio-{picture}-{theme}.png", animations="disabled", caret="hide"
                )
            context.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
