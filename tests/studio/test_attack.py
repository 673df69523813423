"""What an attacker tries without a browser: nothing of it moves the arm, stops the service, or keeps STOP away."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import socket
import threading
from typing import TYPE_CHECKING, Any

import pytest
from tests.studio.running import Visitor, until
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.protocol import State

from hexwire.studio.access import Right

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.studio.running import RunningStudio

_SOCKET = "/live?tab={tab}"
_THOUSAND = 1000


@pytest.fixture
def owner(studio: RunningStudio) -> Visitor:
    """The rightful visitor."""
    return Visitor(studio, studio.studio.access.operate_token)


def _is_refused(visitor: Visitor, path: str) -> bool:
    try:
        with visitor.socket(path):
            return False
    except InvalidStatus as refused:
        return refused.response.status_code == 403


def _read_on(line: Any) -> None:
    while True:
        line.recv(timeout=30)


@pytest.mark.parametrize("fault", ["no session", "guessed session", "foreign origin", "no origin", "null", "host"])
def test_a_socket_needs_session_origin_and_host(served: RunningStudio, fault: str) -> None:
    owner = Visitor(served, served.studio.access.operate_token)
    foreign = {"foreign origin": "http://evil.example", "no origin": "", "null": "null"}
    visitor = Visitor(served, origin=foreign.get(fault), host="evil.example" if fault == "host" else None)
    if fault == "guessed session":
        visitor.cookie = owner.cookie[:-4] + "AAAA"
    elif fault != "no session":
        visitor.cookie = owner.cookie
    try:
        path = _SOCKET.format(tab=owner.page())
        assert _is_refused(visitor, path)
        assert not _is_refused(owner, path)
    finally:
        served.studio.access.end_all()


def test_a_request_needs_session_origin_and_host(studio: RunningStudio, owner: Visitor) -> None:
    assert owner.ask("/stop", "POST", b"", Origin="http://evil.example")[0] == 403
    assert owner.ask("/stop", "POST", b"", Origin="")[0] == 403
    assert owner.ask("/", Host="evil.example")[0] == 421
    assert Visitor(studio).ask("/stop", "POST", b"")[0] == 401
    assert studio.arm.owner.group.reason is None
    assert owner.ask("/stop", "POST", b"")[0] == 200
    studio.until(lambda: studio.arm.owner.group.reason is not None, "the stop")


def test_a_session_that_has_ended_cannot_be_replayed(studio: RunningStudio, owner: Visitor) -> None:
    key, path = owner.cookie.partition("=")[2], _SOCKET.format(tab=owner.page())
    studio.studio.access.leave(key)
    assert owner.ask("/", Origin="")[0] == 401
    assert _is_refused(owner, path)


def test_a_page_whose_session_has_ended_stops_the_arm_and_does_nothing_else(
    studio: RunningStudio, owner: Visitor
) -> None:
    tab = owner.page()
    studio.studio.access.leave(owner.cookie.partition("=")[2])
    assert owner.ask("/fleet/stop?all=1", "POST", b"")[0] == 401
    assert owner.ask("/data/recording?name=a.mcap", "POST", b"a")[0] == 401
    assert _is_refused(owner, f"/live?tab={tab}")
    assert owner.ask("/stop", "POST", b"", Origin="http://evil.example")[0] == 403
    assert owner.ask("/stop", "POST", b"", Cookie=owner.cookie[:-4] + "AAAA")[0] == 401
    assert studio.arm.owner.group.reason is None
    assert owner.ask("/stop", "POST", b"")[0] == 200
    studio.until(lambda: studio.arm.owner.group.reason is not None, "the stop")


def test_an_open_socket_ends_with_its_session(studio: RunningStudio, owner: Visitor) -> None:
    with owner.socket(f"/live?tab={owner.page()}") as line:
        line.recv(timeout=30)
        studio.studio.access.leave(owner.cookie.partition("=")[2])
        line.send(json.dumps({"do": "seen", "frames": 1}))
        with pytest.raises(ConnectionClosed):
            _read_on(line)


def test_a_tab_belongs_to_its_session(studio: RunningStudio, owner: Visitor) -> None:
    other = Visitor(studio, studio.studio.access.watch_token)
    with other.socket(f"/live?tab={owner.page()}") as line, pytest.raises(ConnectionClosed):
        line.recv(timeout=30)


_MALFORMED: dict[str, str | bytes] = {
    "text": "no json",
    "list": "[1, 2]",
    "braces": "{" * 10_000,
    "deep": "[" * 60_000,
    "bytes": b"\x00\x01",
    "long": "x" * 70_000,
    "huge": "x" * 3_000_000,
}


def test_a_malformed_or_oversized_message_ends_its_socket_only(owner: Visitor) -> None:
    tab = owner.page()
    with owner.socket(f"/live?tab={tab}") as other:
        assert json.loads(other.recv(timeout=30))["kind"] == "hello"
        for name, message in _MALFORMED.items():
            with owner.socket(f"/live?tab={owner.page()}") as line:
                line.recv(timeout=30)
                with contextlib.suppress(ConnectionClosed):
                    line.send(message)
                try:
                    with pytest.raises(ConnectionClosed):
                        _read_on(line)
                except TimeoutError:
                    pytest.fail(f"{name}: its socket goes on")
        # The other one goes on.
        other.send(json.dumps({"do": "stop"}))
        until(lambda: '"stopping"' in str(other.recv(timeout=30)), "the answer to the stop")


_SENSELESS: list[dict[str, object]] = [
    {"do": "hold", "id": "one", "kind": "joint"},
    {"do": "hold", "id": 1, "kind": "joint", "args": {"directions": {"J1": 1}}, "stops": "0"},
    {"do": "hold", "id": 1, "kind": ["joint"], "args": [], "stops": 0},
    {"do": "hold", "id": 1, "kind": "joint", "args": {"directions": {"J1": 1}}, "stops": 0},
    {"do": "hold", "id": True, "kind": "joint", "args": {"directions": {"J1": 1e400}}, "stops": 0},
    {"do": "beat", "id": 1, "args": {"directions": {"J1": 1}}},
    {"do": "seen", "frames": 10**30},
    {"do": ["stop"]},
    {"do": {"a": 1}},
]


def test_an_order_without_control_or_sense_moves_nothing(studio: RunningStudio) -> None:
    watcher = Visitor(studio, studio.studio.access.watch_token)
    studio.torque()
    for order in _SENSELESS:
        goals = studio.goals()
        with watcher.socket(f"/live?tab={watcher.page()}") as line:
            line.send(json.dumps(order))
            line.send(json.dumps({"do": "stop"}))
            until(lambda line=line: '"stopping"' in str(line.recv(timeout=30)), f"the stop after {order}")  # type: ignore[misc]  # bound now
        studio.stopped(f"the stop after {order}")
        # A stop writes the present position again.
        assert all(abs(goal - goals[number]) <= 3 for number, goal in studio.goals().items()), order
        studio.arm.owner.reset()


_OUTSIDE = [
    "/static/../access.py",
    "/static/%2e%2e/access.py",
    "/static/..%2faccess.py",
    "/static/%2e%2e%2f%2e%2e%2f%2e%2e%2f%2e%2e%2f%2e%2e%2f%2e%2e%2fetc/passwd",
    "/static//etc/passwd",
    "/static/vendor/../../../../../etc/passwd",
    "/static/live.js/../../app.py",
]


def test_no_file_outside_is_served(owner: Visitor) -> None:
    for path in _OUTSIDE:
        _, _, body = owner.ask(path, Origin="")
        assert not [words for words in (b"root:", b"hmac", b"asyncio") if words in body], path


def test_a_body_is_bounded(owner: Visitor) -> None:
    assert owner.ask("/stop", "POST", None, **{"Content-Length": str(10**12)})[0] == 413


@pytest.fixture
def crowd() -> Iterator[list[socket.socket]]:
    """A place for connections, all closed at the end."""
    made: list[socket.socket] = []
    yield made
    for each in made:
        each.close()


def test_a_thousand_sockets_of_nobody_do_not_keep_a_stop_away(
    studio: RunningStudio, owner: Visitor, crowd: list[socket.socket]
) -> None:
    most = studio.studio.access.limits.connections
    for number in range(_THOUSAND):
        crowd.append(socket.create_connection(("127.0.0.1", owner.port), timeout=30))
        if number >= 2 * most:
            # The server has closed it: this test has not as many descriptors as an attacker.
            crowd.pop(0).close()
    assert owner.ask("/stop", "POST", b"")[0] == 200
    studio.until(lambda: studio.arm.owner.group.reason is not None, "the stop")


def test_a_thousand_calls_of_a_watcher_are_refused_and_keep_nobody_waiting(
    studio: RunningStudio, owner: Visitor, monkeypatch: pytest.MonkeyPatch
) -> None:
    watcher, free = Visitor(studio, studio.studio.access.watch_token), threading.Event()
    monkeypatch.setattr(studio.studio.files[Right.WATCH], "ask", lambda *_: free.wait(30) and b"{}")
    call = {"do": "call", "id": 1, "name": "recordings"}
    try:
        with (
            watcher.socket(f"/live?tab={watcher.page()}") as line,
            watcher.socket(f"/live?tab={watcher.page()}") as second,
            owner.socket(f"/live?tab={owner.page()}") as mine,
        ):
            for _ in range(_THOUSAND):
                line.send(json.dumps(call))
            until(lambda: "too much at a time" in str(line.recv(timeout=30)), "a refusal")
            # They count for its whole session.
            second.send(json.dumps(call))
            until(lambda: "too much at a time" in str(second.recv(timeout=30)), "the other refusal")
            assert studio.studio._calls.total() == 8
            mine.send(json.dumps(call))
            until(lambda: '"entries":[' in str(mine.recv(timeout=30)), "the answer to an operator")
            mine.send(json.dumps({"do": "stop"}))
            until(lambda: '"stopping"' in str(mine.recv(timeout=30)), "the answer to the stop")
    finally:
        free.set()
    studio.until(lambda: not studio.studio._calls, "the end of the calls")


def test_a_session_has_a_bounded_number_of_sockets(
    studio: RunningStudio, owner: Visitor, monkeypatch: pytest.MonkeyPatch
) -> None:
    most, access = 6, studio.studio.access
    # The server goes on with other tests.
    monkeypatch.setattr(access, "limits", dataclasses.replace(access.limits, session_sockets=most))
    with contextlib.ExitStack() as stack:
        lines: list[Any] = []
        refused = False
        while not refused:
            assert len(lines) < 4 * most
            try:
                lines.append(stack.enter_context(owner.socket(_SOCKET.format(tab=owner.page()))))
            except InvalidStatus:
                refused = True
        # On a busy machine the server gives up one that has not answered its pings: there is room for another.
        ended = sum(line.state is not State.OPEN for line in lines)
        assert len(lines) - ended <= most <= len(lines), f"{len(lines)} opened, {ended} ended"
    studio.until(lambda: not _is_refused(owner, _SOCKET.format(tab=owner.page())), "room for sockets again")


def test_a_slow_reader_gets_no_more_frames_and_others_do(owner: Visitor) -> None:
    with owner.socket(f"/live?tab={owner.page()}") as slow, owner.socket(f"/live?tab={owner.page()}") as quick:
        seen = 0

        def read_on(frames: int) -> None:
            nonlocal seen
            end = seen + frames
            while seen < end:
                if isinstance(quick.recv(timeout=30), bytes):
                    seen += 1
                    quick.send(json.dumps({"do": "seen", "frames": seen}))

        read_on(60)
        frames = 0
        while frames < 40:
            frames += isinstance(slow.recv(timeout=30), bytes)
        read_on(40)
        with contextlib.suppress(TimeoutError):
            while True:
                assert not isinstance(slow.recv(timeout=0.15), bytes)


def test_a_watcher_has_no_control_to_press(studio: RunningStudio) -> None:
    watcher = Visitor(studio, studio.studio.access.watch_token)
    _, _, body = watcher.ask("/", Origin="")
    assert b"hw-stop" in body
    assert b'<meta name="hexwire-right" content="1">' in body
    tab: Any = studio.studio.tabs.find(watcher.page(), watcher.cookie.partition("=")[2])
    assert tab.right is Right.WATCH
