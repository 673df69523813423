"""The live socket, from a real page: frames come, and a held button moves the servo only while it is held."""

from __future__ import annotations

import asyncio
import json
import threading
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from tests.studio.running import Visitor, hold, until
from websockets.exceptions import ConnectionClosed

from hexwire.errors import UsageError
from hexwire.studio.access import Right
from hexwire.studio.calls import CallLane, _calls
from hexwire.studio.live import Live, _Socket

if TYPE_CHECKING:
    from playwright.sync_api import Page
    from tests.studio.running import RunningStudio


@pytest.mark.slow
def test_frames_arrive_with_every_joint(page: Page) -> None:
    names = page.evaluate("hexwire.frame.joints")
    assert names == ["J1", "J2", "J3", "J4", "J5", "J6", "J7"]


def test_a_jog_moves_while_held_and_ends_with_its_release(studio: RunningStudio, operator: Page) -> None:
    operator.get_by_role("button", name="Torque on").click()
    studio.until(lambda: len(studio.arm.owner.state.torque_on) == 7, "torque")
    before = studio.arm.owner.state.positions["J1"]
    hold(operator, {"J1": 1}, lambda: abs(studio.arm.owner.state.positions["J1"] - before) > 0.05, speed=0.5)
    operator.evaluate("hexwire.release()")
    studio.until(lambda: not studio.studio.source.arm.jog.busy, "the end of the hold")
    assert operator.evaluate("window.over") == "released"


def test_a_page_that_is_back_before_its_first_socket_is_known_to_be_dead_goes_on(studio: RunningStudio) -> None:
    """After a change of network a browser is back at once; being told to load itself again costs it all forms."""
    owner = Visitor(studio, studio.studio.access.operate_token)
    path = f"/live?tab={owner.page()}"
    with owner.socket(path) as first, owner.socket(path) as second:
        assert json.loads(second.recv(timeout=30))["kind"] == "hello"
        with pytest.raises(ConnectionClosed) as closed:
            until(lambda: first.recv(timeout=30) is None, "the end of the first socket")
        # If there is anybody at the first one, it is a copy of the page.
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 4404
        second.send(json.dumps({"do": "stop"}))
        until(lambda: '"stopping"' in str(second.recv(timeout=30)), "the answer to the stop")


def test_a_page_whose_socket_failed_at_once_gets_another_one(
    studio: RunningStudio, monkeypatch: pytest.MonkeyPatch
) -> None:
    owner = Visitor(studio, studio.studio.access.operate_token)
    path = f"/live?tab={owner.page()}"
    with monkeypatch.context() as failing:
        failing.setattr(studio.studio, "model", lambda: 1 / 0)
        with owner.socket(path) as first, pytest.raises(ConnectionClosed):
            first.recv(timeout=30)
    with owner.socket(path) as second:
        assert json.loads(second.recv(timeout=30))["kind"] == "hello"


def test_a_stop_that_is_sent_again_is_no_second_one(studio: RunningStudio, monkeypatch: pytest.MonkeyPatch) -> None:
    """A page that hears of its stop late sends it again; that must not undo what was resumed meanwhile."""
    owner, stops = Visitor(studio, studio.studio.access.operate_token), list[str]()
    monkeypatch.setattr(studio.studio, "stop", stops.append)
    tab, other = owner.page(), owner.page()
    with owner.socket(f"/live?tab={tab}") as line:
        line.send(json.dumps({"do": "stop", "id": 2}))
        until(lambda: '"stopping"' in str(line.recv(timeout=30)), "the answer to the stop")
        assert len(stops) == 1
        # Who has no control is told why what was to be held has ended.
        present = studio.studio.source.present
        assert present is not None
        stops_seen = present.stops & 0xFFFFFFFF
        line.send(json.dumps({"do": "hold", "id": 3, "kind": "joint", "args": {}, "stops": stops_seen}))
        heard = [""]
        until(lambda: heard.append(str(line.recv(timeout=30))) or '"ended"' in heard[-1], "the refusal")
        assert json.loads(heard[-1])["id"] == 3
        assert "control" in json.loads(heard[-1])["why"]
        for _ in range(2):
            assert owner.ask(f"/stop?tab={tab}&id=2", "POST", b"")[0] == 200
        assert len(stops) == 1
        # Whatever else comes is a stop, also with a smaller number: that of a copy of the page.
        others = ["", f"tab={tab}", f"tab={tab}&id=1", f"tab={tab}&id=3", f"tab={other}&id=2", "tab=x&id=2"]
        others += [f"tab={tab}&id={number}" for number in ("0", "-1", "-2", "1111111111", "x", "")] + ["id=2"]
        for query in others:
            assert owner.ask(f"/stop?{query}", "POST", b"")[0] == 200
        assert len(stops) == 1 + len(others)


def test_a_page_is_kept_while_its_computer_sleeps_for_a_moment(studio: RunningStudio, page: Page) -> None:
    """A page that the server has forgotten loads itself again, and what was typed into it is lost."""
    page.get_by_label("Port or address").fill("/dev/ttyUSB7")
    # Noted by the page: a look from here may come after it is back.
    page.evaluate("window.same = true; window.links = []; hexwire.onLink((up) => links.push(up)); 0")
    studio.cut(page)
    page.wait_for_function("'false,true' === window.links?.join()")
    assert page.get_by_label("Port or address").input_value() == "/dev/ttyUSB7"
    assert page.evaluate("window.same")


class _Looked:
    """A source without an arm, which counts how often somebody looks for one."""

    present = None
    looks = 0

    @property
    def arm(self) -> None:
        self.looks += 1


def test_nothing_is_prepared_without_pages_and_the_first_one_hears_at_once() -> None:
    source = _Looked()
    live = Live(SimpleNamespace(source=source, facts=dict))

    async def watch() -> int:
        pump = asyncio.create_task(live.pump())
        await asyncio.sleep(0.2)
        looks = source.looks
        socket = _Socket(None, SimpleNamespace(grant=0, key=""), 30.0)  # type: ignore[arg-type]
        live._sockets.add(socket)
        live._opened.set()
        async with asyncio.timeout(30.0):
            await socket._wake.wait()
        pump.cancel()
        return looks

    assert asyncio.run(watch()) < 3, "with a page there are 60 looks a second"


def _answer(line: Any, order: dict[str, object]) -> dict[str, Any]:
    """What becomes of a call."""
    line.send(json.dumps({"do": "call", **order}))
    found: dict[str, Any] = {}

    def heard() -> bool:
        message = line.recv(timeout=30)
        if isinstance(message, str):
            found.update(json.loads(message))
        return found.get("kind") == "answer" and found["id"] == order["id"]

    until(heard, f"the answer to {order}")
    return found


def test_calls_are_answered_and_what_is_wrong_with_them_is_said(studio: RunningStudio) -> None:
    owner = Visitor(studio, studio.studio.access.operate_token)
    wrong: list[tuple[dict[str, object], str]] = [
        ({"name": "fly"}, "there is no call 'fly'"),
        ({"name": "open"}, "the call open cannot be read: Object missing required field `url`"),
        ({"name": "open", "args": {"url": 3}}, "open cannot be read: Expected `str`"),
        ({"name": "take", "args": {"force": True}}, "take cannot be read: Object contains unknown field `force`"),
        ({"name": "arm.teach", "args": {"on": True}}, "does not have control"),
        ({"name": "torque", "args": {"on": True}}, "does not have control"),
        ({"name": "servos.list"}, "no servo bus is open"),
        ({"name": "arm.poses", "opened": studio.studio.source.opened - 1}, "was closed; load the page again"),
    ]
    with owner.socket(f"/live?tab={owner.page()}") as line:
        for number, (order, words) in enumerate(wrong):
            told = _answer(line, {"id": number, **order})
            assert words in told["error"], order
            assert "value" not in told
            assert "\n" not in told["error"]
        assert _answer(line, {"id": 90, "name": "arm.poses", "opened": studio.studio.source.opened})["value"]
        assert _answer(line, {"id": 91, "name": "take"})["value"] is None
        assert studio.studio.source.need_arm().holder is not None


def test_a_watcher_is_refused_whatever_needs_the_right_to_operate(studio: RunningStudio) -> None:
    watcher = Visitor(studio, studio.studio.access.watch_token)
    names = [name for name, each in _calls.items() if each.right > Right.WATCH]
    assert {"open", "open_bus", "close", "take"} <= set(names)
    present = studio.studio.source.present
    with watcher.socket(f"/live?tab={watcher.page()}") as line:
        for number, name in enumerate(names):
            assert "watching only" in _answer(line, {"id": number, "name": name})["error"], name
        held = [name for name, each in _calls.items() if each.control]
        assert len(held) > 15
        for number, name in enumerate(held):
            assert "does not have control" in _answer(line, {"id": 100 + number, "name": name})["error"], name
    assert studio.studio.source.present is present


def test_a_call_from_before_a_stop_is_not_carried_out(
    studio: RunningStudio, monkeypatch: pytest.MonkeyPatch
) -> None:
    owner, done, free = Visitor(studio, studio.studio.access.operate_token), list[str](), threading.Event()
    arm = studio.studio.source.need_arm()
    monkeypatch.setattr(arm.motions.poses, "remove", done.append)
    workers = studio.studio._lanes[CallLane.WAITS, Right.OPERATE]
    with owner.socket(f"/live?tab={owner.page()}") as line:
        _answer(line, {"id": 1, "name": "take"})
        number = arm.stops
        try:
            # All are busy: the call has to wait.
            for _ in range(workers._max_workers):
                workers.submit(free.wait)
            line.send(json.dumps({"do": "call", "id": 2, "name": "arm.remove_pose", "args": {"name": "a"}}))
            until(workers._work_queue.qsize, "the call")
            line.send(json.dumps({"do": "stop"}))
            until(lambda: arm.stops != number, "the stop")
        finally:
            free.set()
        heard = [""]
        until(lambda: heard.append(str(line.recv(timeout=30))) or '"answer"' in heard[-1], "the answer")
    assert "a stop came after it" in heard[-1]
    assert not done


def test_a_session_that_asks_for_much_is_refused_and_stops_all_the_same(
    studio: RunningStudio, monkeypatch: pytest.MonkeyPatch
) -> None:
    owner, free = Visitor(studio, studio.studio.access.operate_token), threading.Event()
    monkeypatch.setattr(studio.studio.source.need_arm().motions, "pose_rows", lambda: free.wait(30) and [])
    with owner.socket(f"/live?tab={owner.page()}") as line:
        try:
            for number in range(20):
                line.send(json.dumps({"do": "call", "id": number, "name": "arm.poses"}))
            refused = _answer(line, {"id": 20, "name": "arm.poses"})["error"]
            assert "too much at a time" in refused
            line.send(json.dumps({"do": "stop"}))
            until(lambda: '"stopping"' in str(line.recv(timeout=30)), "the answer to the stop")
        finally:
            free.set()


def test_every_call_is_answered_whatever_it_was_about(studio: RunningStudio) -> None:
    """Half a letter has no bytes; whoever sends one must not wait for ever, and nobody else notices."""
    watcher = Visitor(studio, studio.studio.access.watch_token)
    motion = {"motion": {"what": "pose", "name": "\ud800"}}
    with watcher.socket(f"/live?tab={watcher.page()}") as line:
        for number, order in enumerate([{"name": "\ud800"}, {"name": "arm.preview", "args": motion}]):
            assert _answer(line, {"id": number, **order})["error"], order
        # Numbers that no script of a page counts to are no orders; what comes behind them is heard.
        for number in (-1, 1 << 53, 10**30):
            line.send(json.dumps({"do": "call", "id": number, "name": "arm.poses"}))
        assert _answer(line, {"id": 9, "name": "arm.poses"})["value"]
        assert _answer(line, {"id": (1 << 53) - 1, "name": "arm.poses"})["value"]


def test_an_answer_that_has_no_json_is_an_error_in_words(
    studio: RunningStudio, monkeypatch: pytest.MonkeyPatch
) -> None:
    watcher = Visitor(studio, studio.studio.access.watch_token)
    motions = studio.studio.source.need_arm().motions
    with watcher.socket(f"/live?tab={watcher.page()}") as line:
        for number, failing in enumerate(["\ud800", "a \udfff b"]):

            def refuse(words: str = failing) -> object:
                raise UsageError(words)

            monkeypatch.setattr(motions, "pose_rows", refuse)
            assert "cannot be sent" in _answer(line, {"id": number, "name": "arm.poses"})["error"]


def test_whoever_sends_without_end_keeps_nobody_else_waiting() -> None:
    """All that has come of one socket was taken at once: a STOP by another one waited for seconds."""
    clock, stops = [0.0], list[float]()
    loop = asyncio.SelectorEventLoop()
    plain = loop._selector.select  # type: ignore[attr-defined]

    def select(seconds: float | None) -> Any:
        clock[0] += seconds or 0.0
        return plain(0)

    loop.time = lambda: clock[0]  # type: ignore[method-assign]
    loop._selector.select = select  # type: ignore[attr-defined]
    short = [json.dumps({"do": "stop"}), *([json.dumps({"do": "x"})] * 2000), json.dumps({"do": "stop"})]
    long = [json.dumps({"do": "x", "args": "x" * 60_000})] * 50
    limits = SimpleNamespace(message=64 * 1024)
    studio: Any = SimpleNamespace(access=SimpleNamespace(limits=limits), stop=lambda who: stops.append(clock[0]))

    async def take(texts: list[str]) -> None:
        left = [{"type": "websocket.receive", "text": text} for text in texts]

        async def receive() -> dict[str, str]:
            return left.pop(0) if left else {"type": "websocket.disconnect"}

        line: Any = SimpleNamespace(
            socket=SimpleNamespace(receive=receive), tab=SimpleNamespace(name="tab 1"), put=lambda message: None
        )
        taking = asyncio.create_task(Live(studio)._receive(line))
        await asyncio.sleep(0)
        assert len(left) > len(texts) - 3, "others have their turn between two messages"
        await taking

    try:
        loop.run_until_complete(take(short))
        assert stops[0] == 0.0, "who sends little never waits"
        assert 5.0 < stops[1] < 9.0
        begun = clock[0]
        loop.run_until_complete(take(long))
        assert clock[0] - begun > 5.0, "long ones count more"
    finally:
        loop.close()


def test_a_page_that_reads_nothing_is_given_up_before_much_waits_for_it() -> None:
    large = _Socket(None, SimpleNamespace(grant=0, key=""), 30.0)  # type: ignore[arg-type]
    large.put("x" * (9 << 20))
    assert not large.too_slow, "one answer may be as long as it has to be"
    for size, most in ((1 << 20, 5), (1, 64)):
        socket, count = _Socket(None, SimpleNamespace(grant=0, key=""), 30.0), 0  # type: ignore[arg-type]
        while not socket.too_slow:
            socket.put("x" * size)
            count += 1
        assert most < count <= most + 1


def test_a_page_hears_of_a_studio_that_has_nothing_to_tell(served: RunningStudio) -> None:
    owner = Visitor(served, served.studio.access.operate_token)
    with owner.socket(f"/live?tab={owner.page()}") as line:
        for _ in range(3):
            until(lambda: line.recv(timeout=30) == b"\0", "a sign of life")
        # It must not take for held what nobody has begun.
        line.send(json.dumps({"do": "hold", "id": 1, "kind": "joint", "stops": 0}))
        until(lambda: b"no arm is open" in _bytes(line.recv(timeout=30)), "why it is not held")


def _bytes(message: str | bytes) -> bytes:
    return message.encode() if isinstance(message, str) else message
