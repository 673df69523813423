"""Every way in which a held motion ends, seen at the emulated servos: their goal position stops changing.

How long that may take is tested with a clock of its own in `tests/control/test_hold_to_run.py` and
`tests/control/test_jog.py`, and measured by `make bench`.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import pytest
from tests.studio.holder import JOG, Holder, set_silence
from tests.studio.running import PATIENCE, Visitor, press, until

from hexwire.studio.access import Right
from hexwire.studio.calls import CallLane

if TYPE_CHECKING:
    from playwright.sync_api import Page
    from tests.studio.running import RunningStudio

_STILL = 15
"""States of the arm without a new goal after which a servo counts as held: a jog has a new one for each."""


def _is_held(studio: RunningStudio, why: str) -> None:
    """Wait until the motion has ended and no goal changes any more."""
    arm = studio.studio.source.arm
    assert arm is not None
    studio.until(lambda: not arm.jog.busy, f"the end of the hold: {why}")
    goals, owner, stamps = studio.goals(), studio.arm.owner, set[float]()

    def still() -> bool:
        nonlocal goals
        if (now := studio.goals()) != goals:
            goals = now
            stamps.clear()
        stamps.add(owner.state.stamp)
        return len(stamps) > _STILL

    studio.until(still, f"the end of the motion: {why}")


@pytest.fixture
def moving(served: RunningStudio) -> Iterator[Callable[[], Holder]]:
    """Makes somebody who holds a jog that moves; all of them on one arm."""
    served.open()
    served.torque()
    made: list[Holder] = []

    def make() -> Holder:
        while made:
            made.pop().end()
        if served.arm.owner.group.reason is not None:
            served.stopped("the stop before")
            served.arm.owner.reset()
        # More silence than in earnest, so that a busy machine ends nothing by itself.
        set_silence(served, 5.0)
        made.append(Holder(served))
        made[-1].hold()
        return made[-1]

    try:
        yield make
    finally:
        while made:
            made.pop().end()
        served.studio.source.close()
        served.studio.access.end_all()


def _release(holder: Holder) -> None:
    holder.line.send(json.dumps({"do": "release", "id": holder.number}))


def _close(holder: Holder) -> None:
    holder.line.close()


def _stop(holder: Holder) -> None:
    holder.line.send(json.dumps({"do": "stop"}))
    holder.studio.stopped("the stop")


def _stop_by_request(holder: Holder) -> None:
    other = Visitor(holder.studio, holder.studio.studio.access.watch_token)
    assert other.ask("/stop", "POST", b"")[0] == 200
    holder.studio.stopped("the stop")


def _take_away(holder: Holder) -> None:
    studio = holder.studio.studio
    studio.take(studio.tabs.open("another", holder.tab.right), force=True)


def _leave(holder: Holder) -> None:
    holder.studio.studio.source.leave(holder.tab)


def _end_session(holder: Holder) -> None:
    holder.studio.studio.access.leave(holder.tab.session)


def _hang_loop(holder: Holder) -> None:
    """The loop of the server hangs, so that it hears of nothing: the owner of the arm ends the motion."""
    going_on = threading.Event()
    holder.studio.studio.soon(lambda: going_on.wait(PATIENCE))
    set_silence(holder.studio, 0.5)
    try:
        _is_held(holder.studio, "the server hangs")
    finally:
        going_on.set()


_WAYS: dict[str, Callable[[Holder], object]] = {
    "release": _release,
    "silence": Holder.fall_silent,
    "lost": Holder.abort,
    "closed": _close,
    "stop": _stop,
    "stop by HTTP": _stop_by_request,
    "taken": _take_away,
    "left": _leave,
    "session": _end_session,
    "server hangs": _hang_loop,
}


def test_a_motion_ends_in_every_way(moving: Callable[[], Holder]) -> None:
    for name, way in _WAYS.items():
        holder = moving()
        way(holder)
        _is_held(holder.studio, name)
        source = holder.studio.studio.source.arm
        assert source is not None
        holder.studio.until(lambda source=source: source.hold_to_run.entry is None, name)  # type: ignore[misc]  # bound now


def test_nothing_from_before_a_stop_continues_after_resume(moving: Callable[[], Holder]) -> None:
    holder = moving()
    studio, owner, source = holder.studio, holder.studio.arm.owner, holder.studio.studio.source.arm
    assert source is not None
    old = source.stops
    _stop(holder)
    studio.stopped("the stop")
    owner.reset()
    _is_held(studio, "its beats still arrive")
    # An order that was under way while the arm was stopped and resumed.
    holder.line.send(json.dumps({"do": "hold", "id": 99, "kind": "joint", "args": JOG, "stops": old}))
    holder.number = 99
    _is_held(studio, "the order is old")


def test_what_a_watcher_asks_for_leaves_the_motion_of_others_alone(moving: Callable[[], Holder]) -> None:
    holder = moving()
    source = holder.studio.studio.source.arm
    assert source is not None
    mine = source.hold_to_run.entry
    assert mine is not None
    watcher = Visitor(holder.studio, holder.studio.studio.access.watch_token)
    with watcher.socket(f"/live?tab={watcher.page()}") as line:
        order = {"do": "hold", "id": 7, "kind": "joint", "args": JOG, "stops": source.stops}
        line.send(json.dumps(order))
        until(lambda: '"ended", "id": 7' in str(line.recv(timeout=30)), "the refusal")
        assert mine.ended in ("", "whoever held it is heard no more")


@pytest.mark.slow
def test_a_resume_from_before_a_stop_does_not_end_it(studio: RunningStudio, operator: Page) -> None:
    owner, workers, free = studio.arm.owner, studio.studio._lanes[CallLane.WAITS, Right.OPERATE], threading.Event()
    operator.keyboard.press("Escape")
    operator.get_by_role("button", name="Resume").wait_for()
    number = owner.group.epochs.number
    try:
        # All are busy, as with previews of long motions: the order has to wait.
        for _ in range(workers._max_workers):
            workers.submit(free.wait)
        operator.get_by_role("button", name="Resume").click()
        studio.until(workers._work_queue.qsize, "the order to resume")
        operator.keyboard.press("Escape")
        studio.until(lambda: owner.group.epochs.number > number, "the second stop")
    finally:
        free.set()
    operator.get_by_text("a stop came after the call").wait_for()
    assert owner.group.reason is not None


def test_a_motion_ends_in_a_browser(studio: RunningStudio, operator: Page) -> None:
    studio.torque()
    operator.evaluate(
        """(jog) => {
            const button = Object.assign(document.createElement("button"), {id: "jog", textContent: "J1 +"});
            document.getElementById("hw-main").prepend(button);
            hexwire.holdButton(button, "joint", jog);
            window.jog = button;
            // Other browsers than this one do not tell what leaves a page that it loses the focus.
            const hide = (event) => event.target === button && event.stopImmediatePropagation();
            window.addEventListener("blur", hide, true);
        }""",
        JOG,
    )
    button = operator.locator("#jog")
    for way in ("mouse", "key", "gone", "disabled", "blur", "freeze", "close"):
        operator.mouse.up()
        first = studio.goals()[0]
        press(operator, button, lambda first=first: abs(studio.goals()[0] - first) > 5, key=way == "key")  # type: ignore[misc]  # bound now
        if way == "mouse":
            operator.mouse.up()
        elif way == "key":
            operator.keyboard.up("Space")
        elif way == "gone":
            operator.evaluate("jog.remove()")
        elif way == "disabled":
            operator.evaluate("jog.disabled = true; 1")
        elif way == "freeze":
            set_silence(studio, 0.25)
            operator.evaluate(
                "setTimeout(() => { const end = Date.now() + 1500; while (Date.now() < end); }, 0); 1"
            )
        elif way == "blur":
            operator.evaluate("window.dispatchEvent(new Event('blur'))")
        else:
            operator.close()
        _is_held(studio, way)
        if way == "freeze":
            set_silence(studio, 5.0)
        elif way == "gone":
            operator.evaluate("document.getElementById('hw-main').prepend(jog)")
        elif way == "disabled":
            operator.evaluate("jog.disabled = false; 1")


@pytest.mark.slow
def test_stop_reaches_the_arm_without_the_live_socket(studio: RunningStudio, operator: Page) -> None:
    operator.evaluate(
        """() => {
            // No new socket can be opened, and the present one closes.
            WebSocket = class { constructor() { this.readyState = 3; } };
            WebSocket.OPEN = 1;
        }"""
    )
    studio.cut(operator)
    operator.wait_for_function("!hexwire.connected")
    operator.keyboard.press("Escape")
    studio.until(lambda: studio.arm.owner.group.reason is not None, "the stop")
