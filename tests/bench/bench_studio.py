"""The studio beside the owner alone: processor, bytes, latency, memory, and whether the owner's cycles are late.

Everything is real: an emulated board in a process of its own, `hexwire studio` in another one, and Chromium with
pages that are drawn. The bare reference is the same arm, opened by the same code, without server and pages; blocks
of both take turns. Frames are counted where they are drawn.
"""

from __future__ import annotations

import http.client
import json
import os
import re
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, TYPE_CHECKING

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench.board import board, cpu, memory, servo_bus
from tests.studio.chromium import PROGRAM, chromium
from tests.studio.first_picture import first_picture

from hexwire.control.requests.history import History
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.state import JointState

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Page

_PROGRAM = Path(__file__).with_name("studio_process.py")
_BLOCK = 5.0
"""Seconds of a block."""
_ROUNDS = 3
_DRAGS = 40
_PAGES = 7
_VIEWERS = 4
_CYCLES, _CYCLE_BLOCK = 12, 2.5
_LEAST = 1_000_000
"""Bytes of ten minutes in any format."""
_HOUR, _RATE = 3600, 50.0

_WINDOW = {"viewport": {"width": 1440, "height": 900}, "bypass_csp": True}
"""Playwright evaluates what is waited for as a text, which the policy of pages forbids."""
_COUNT = """() => {
  window.bench = { frames: 0 };
  window.hexwire.onFrame(() => { window.bench.frames += 1; });
}"""
_JOG = """() => {
  const button = document.body.appendChild(document.createElement("button"));
  button.textContent = "bench";
  button.style = "position: fixed; left: 0; bottom: 0; z-index: 9999";
  let way = 1;
  window.hexwire.holdButton(button, "joint", () => ({ directions: { J1: (way = -way) } }));
  window.pressed = [];
  document.addEventListener("pointerdown",
    (event) => window.pressed.push(performance.timeOrigin + event.timeStamp), { capture: true });
}"""


def run() -> Iterator[str]:
    """Figures of the studio, each beside its aim."""
    if not Path(PROGRAM).exists():
        yield "left out: Chromium is not installed (`make test` installs it)"
        return
    with ExitStack() as stack:
        bare = stack.enter_context(_process("owner", *_arm(stack)))
        studio = stack.enter_context(_process("studio", *_arm(stack)))
        browser = stack.enter_context(chromium())
        yield f"from the start of `hexwire studio` to its address: {studio.started:.2f} s (aim 3 s)"
        usual, worst = _usable(browser, studio)
        yield f"a usable page, empty cache: median {usual:.2f} s, worst {worst:.2f} of {_PAGES} (aim 0.5 s)"
        yield from _processor(browser, bare, studio)
        yield _drag(browser, studio)
        yield _picture(browser, studio)
        yield _memory(studio)
    with ExitStack() as stack:
        camera = stack.enter_context(_process("camera", *_arm(stack)))
        yield _camera(stack.enter_context(chromium()), camera)
    with ExitStack() as stack:
        yield from _cycles(stack)


class _Process:
    """A process under measurement, and what it says."""

    def __init__(self, process: subprocess.Popen[str], moves: Connection | None) -> None:
        self.process, self.moves = process, moves
        assert process.stdin is not None
        assert process.stdout is not None
        self._in: IO[str] = process.stdin
        self._out: IO[str] = process.stdout
        begin = time.monotonic()
        self.operate = self._out.readline().partition(": ")[2].strip()
        self.started = time.monotonic() - begin
        self.at_first = memory(process.pid)
        self.watch = self._out.readline().partition(": ")[2].strip() if self.operate != "none" else ""

    def share(self, meanwhile: Callable[[], object]) -> float:
        """Share of a core that it takes while something is called."""
        before, begin = cpu(self.process.pid), time.monotonic()
        meanwhile()
        return (cpu(self.process.pid) - before) / (time.monotonic() - begin)

    @property
    def memory(self) -> float:
        """Resident memory, MB."""
        return memory(self.process.pid)

    def delays(self) -> list[float]:
        """How late the owner's cycles began since the last call, seconds."""
        self._in.write("\n")
        self._in.flush()
        rows: list[float] = json.loads(self._out.readline())
        return rows


def _arm(stack: ExitStack) -> tuple[str, Connection]:
    return stack.enter_context(board())


@contextmanager
def _process(kind: str, port: str, moves: Connection | None = None, *words: str) -> Iterator[_Process]:
    command = [sys.executable, str(_PROGRAM), kind, "--port", port, *words]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield _Process(process, moves)
        finally:
            process.terminate()


@contextmanager
def _page(browser: Browser, url: str, path: str = "/move") -> Iterator[Page]:
    """A page of a new browser, drawn and counting its frames."""
    context = browser.new_context(**_WINDOW)
    try:
        yield _open(context, url, path)
    finally:
        context.close()


def _open(context: BrowserContext, url: str, path: str) -> Page:
    page = context.new_page()
    page.goto(url.replace("/?", f"{path}?"))
    page.wait_for_function("window.hexwire && window.hexwire.frame")
    page.evaluate(_COUNT)
    return page


# -- figures ------------------------------------------------------------------------------------------------


def _usable(browser: Browser, studio: _Process) -> tuple[float, float]:
    """Median and worst seconds from the request to a page with facts and its first frame; its cache is empty."""
    found = []
    for _ in range(_PAGES):
        context = browser.new_context(**_WINDOW)
        page = context.new_page()
        page.goto(studio.operate.replace("/?", "/move?"))
        page.wait_for_function(
            "window.hexwire && window.hexwire.frame && document.querySelector('#hw-take')?.checkVisibility()"
        )
        found.append(page.evaluate("performance.now()") / 1000)
        context.close()
    return statistics.median(found), max(found)


def _picture(browser: Browser, studio: _Process) -> str:
    """What a browser that was never here asks for, until it asks for nothing more."""
    context = browser.new_context(**_WINDOW)
    try:
        picture = first_picture(context.new_page(), studio.operate)
    finally:
        context.close()
    return (
        f"first picture: {picture.requests} requests (aim 12), {picture.sent / 1000:.0f} kB on the wire "
        f"(aim 250 kB), {picture.raw / 1000:.0f} kB raw (aim 1000 kB)"
    )


def _processor(browser: Browser, bare: _Process, studio: _Process) -> list[str]:
    """What the studio takes with no page, with one, with four; each beside the owner alone."""
    alone: list[float] = []
    shares: dict[int, list[float]] = {0: [], 1: [], _VIEWERS: []}
    frames: dict[int, list[float]] = {1: [], _VIEWERS: []}
    volume: list[float] = []
    for _ in range(_ROUNDS):
        alone.append(bare.share(lambda: time.sleep(_BLOCK)))
        for viewers, found in shares.items():
            with ExitStack() as stack:
                pages = [stack.enter_context(_page(browser, studio.operate)) for _ in range(viewers)]
                before = [page.evaluate("window.bench.frames") for page in pages]
                if pages:
                    # What a page does at first is not what it does.
                    pages[0].wait_for_timeout(1000.0)
                    before = [page.evaluate("window.bench.frames") for page in pages]
                begin = time.monotonic()
                found.append(studio.share(partial(_wait, pages)))
                lasted = time.monotonic() - begin
                if pages:
                    after = [page.evaluate("window.bench.frames") for page in pages]
                    frames[viewers] += [(b - a) / lasted for a, b in zip(before, after, strict=True)]
        volume.append(_volume(browser, studio))
    usual = statistics.median(alone)
    lines = [f"processor: the owner alone {usual:.1%} of a core"]
    for viewers, found in shares.items():
        share = statistics.median(found)
        what = f"{viewers} page{'s' if viewers != 1 else ''}"
        rate = f", {statistics.median(frames[viewers]):.0f} frames/s in each" if viewers else ""
        aim = " (aim 3 %)" if viewers else ""
        lines.append(f"  the studio with {what} {share:.1%}{rate}: {share - usual:.1%} beyond the owner's{aim}")
    lines.append(f"to each page: {statistics.median(volume) / 1000:.1f} kB/s (aim 15 kB/s)")
    return lines


def _wait(pages: list[Page]) -> None:
    if pages:
        pages[0].wait_for_timeout(1000 * _BLOCK)
    else:
        time.sleep(_BLOCK)


def _volume(browser: Browser, studio: _Process) -> float:
    """Bytes a second that one page gets by its sockets, with their heads."""
    context = browser.new_context(**_WINDOW)
    try:
        page = context.new_page()
        got: list[int] = []

        def note(payload: str | bytes) -> None:
            size = len(payload.encode() if isinstance(payload, str) else payload)
            got.append(size + (2 if size < 126 else 4))

        page.on("websocket", lambda socket: socket.on("framereceived", note))
        page.goto(studio.operate.replace("/?", "/move?"))
        page.wait_for_function("window.hexwire && window.hexwire.frame")
        page.wait_for_timeout(1000.0)
        got.clear()
        begin = time.monotonic()
        page.wait_for_timeout(1000 * _BLOCK)
        return sum(got) / (time.monotonic() - begin)
    finally:
        context.close()


def _drag(browser: Browser, studio: _Process) -> str:
    """From the press of a button that jogs to the first byte on the servo line."""
    with _page(browser, studio.operate) as page:
        page.get_by_role("button", name="Take control").click()
        torque, resume = (page.get_by_role("button", name=name) for name in ("Torque on", "Resume"))
        resume.or_(torque).first.wait_for()
        if resume.is_visible():
            # A machine that stalled has tripped the watchdog.
            resume.click()
        torque.click()
        page.get_by_role("button", name="Torque off").wait_for()
        page.evaluate(_JOG)
        page.get_by_role("button", name="bench").hover()
        for i in range(_DRAGS):
            page.mouse.down()
            page.wait_for_timeout(120.0)
            page.mouse.up()
            page.wait_for_timeout(250.0 + 7 * (i % 5))
        pressed = [when / 1000 for when in page.evaluate("window.pressed")]
    assert studio.moves is not None
    studio.moves.send(None)
    offset = time.time() - time.monotonic()
    moved = [when + offset for when in studio.moves.recv()]
    late = [next((m for m in moved if m > begin), begin + 1.0) - begin for begin in pressed]
    late.sort()
    return (
        f"press of a jog button to the first servo byte: p50 {1000 * statistics.median(late):.1f} ms, "
        f"p95 {1000 * late[int(0.95 * len(late))]:.1f} ms of {len(late)} (aim for p50 25 ms)"
    )


def _camera(browser: Browser, studio: _Process) -> str:
    """What the studio takes for a camera that one page shows, beyond the same page without it."""
    without, shown = [], []
    with _page(browser, studio.operate) as page:
        for _ in range(_ROUNDS):
            without.append(studio.share(partial(_wait, [page])))
            page.get_by_role("button", name="Camera", exact=True).click()
            page.get_by_role("img", name="Camera video0").wait_for()
            shown.append(studio.share(partial(_wait, [page])))
            page.get_by_role("button", name="Close this camera").click()
    more = statistics.median(b - a for a, b in zip(without, shown, strict=True))
    return f"a camera of 640 x 480 at 15 pictures a second on one page: {more:.1%} of a core (aim 5 %)"


def _memory(studio: _Process) -> str:
    """Of a program that keeps ten minutes while an hour of samples comes; and of the studio, after all this."""
    history = History(HEX7BOT.names, rate=_RATE)
    n = len(HEX7BOT.names)
    kept = []
    for minute in range(_HOUR // 60):
        for i in range(round(60 * _RATE)):
            values = (0.1,) * n
            state = JointState(
                names=HEX7BOT.names,
                stamp=60.0 * minute + i / _RATE,
                position=values,
                velocity=values,
                load=values,
                current=values,
                voltage=values,
                temperature=values,
                flags=(0,) * n,
                age=values,
            )
            history.append(state, {})
        kept.append(memory(os.getpid()))
    return (
        f"memory after 10, 20, 60 minutes of samples at {_RATE:g} Hz: "
        f"{kept[9]:.1f}, {kept[19]:.1f}, {kept[-1]:.1f} MB; "
        f"of the process at the end {studio.memory:.0f} MB (aim 70 MB), at its start {studio.at_first:.0f} MB"
    )


def _cycles(stack: ExitStack) -> Iterator[str]:
    """How late the owner's cycles begin on a servo bus, where the owner itself keeps the time."""
    bare = stack.enter_context(_process("owner", stack.enter_context(servo_bus()), None, "--robot", "so101"))
    studio = stack.enter_context(_process("full", stack.enter_context(servo_bus()), None, "--robot", "so101"))
    browser = stack.enter_context(chromium())
    with _page(browser, studio.operate) as page:
        yield f"lateness of the owner's cycle at 100 Hz, p50 / p99, median of {_CYCLES} blocks:"
        yield f"  with the studio and a page: {_lateness(page, bare, studio)}"
        with _downloads(studio.watch) as done:
            line = _lateness(page, bare, studio)
        yield f"  while a viewer downloads ten minutes of everything, {done[0]} times in all: {line}"


def _lateness(page: Page, bare: _Process, studio: _Process) -> str:
    late: dict[str, list[tuple[float, float]]] = {"bare": [], "studio": []}
    for _ in range(_CYCLES):
        # What else is at work is so in both kinds of blocks: it takes the same processors.
        for kind, process in (("bare", bare), ("studio", studio)):
            process.delays()
            page.wait_for_timeout(1000 * _CYCLE_BLOCK)
            rows = sorted(process.delays())
            late[kind].append((1000 * rows[len(rows) // 2], 1000 * rows[int(0.99 * (len(rows) - 1))]))
    # Of each kind the block in the middle: one stall of the machine is not the studio's.
    (b50, b99), (s50, s99) = (
        tuple(statistics.median(column) for column in zip(*rows, strict=True)) for rows in late.values()
    )
    ratio = f"ratio of p99 {s99 / b99:.2f} (aim 1.1)"
    return f"{s50:.2f} / {s99:.2f} ms, the owner alone {b50:.2f} / {b99:.2f} ms; {ratio}"


@contextmanager
def _downloads(url: str) -> Iterator[list[int]]:
    """Somebody who downloads all that the studio keeps, again and again; how often."""
    done, over = [0], threading.Event()
    host, token = re.fullmatch(r"http://([^/]+)/\S*\?token=(\S+)", url.strip()).groups()  # type: ignore[union-attr]  # as printed

    def download() -> None:
        line = http.client.HTTPConnection(host, timeout=60.0)
        line.request("GET", f"/?token={token}")
        answer = line.getresponse()
        answer.read()
        cookie = (answer.getheader("set-cookie") or "").partition(";")[0]
        while not over.is_set():
            for name in ("history", "history.csv", "history.mcap"):
                line.request("GET", f"/data/{name}", headers={"Cookie": cookie})
                answer = line.getresponse()
                size = len(answer.read())
                if answer.status != 200 or size < _LEAST:
                    raise RuntimeError(f"/data/{name}: status {answer.status}, {size} bytes")
            done[0] += 1
        line.close()

    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(download)
        try:
            yield done
        finally:
            over.set()
            waiting.result()
