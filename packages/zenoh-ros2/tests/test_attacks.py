"""Other nodes that hang, die or send nonsense; the node goes on for all others."""

from __future__ import annotations

import contextlib
import itertools
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh
from tests.waits import eventually
from zenoh_ros2_tests.router import Router
from zenoh_ros2_tests.tiny_types import HASH, Text, TextType

from zenoh_ros2 import node as node_module
from zenoh_ros2.attachment import Attachment
from zenoh_ros2.node import Deferred, Node

pytestmark = pytest.mark.system

STRING, ECHO = "std_msgs/msg/String", "tiny_msgs/srv/Echo"
ECHO_KEY = f"0/echo/tiny_msgs::srv::dds_::Echo_/{HASH}"
LARGE = Text("x" * 30_000)


@contextlib.contextmanager
def other_node(endpoint: str) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(
        [sys.executable, Path(__file__).parent / "zenoh_ros2_tests/other_process.py", endpoint],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            yield process
        finally:
            process.kill()


def _collect(process: subprocess.Popen[str], lines: list[str]) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        lines.append(line)  # noqa: PERF402  # each at once, not all at the end


def test_a_frozen_node_delays_neither_messages_nor_answers_to_others(
    make_node: Callable[..., Node], router: Router
) -> None:
    waiting: list[Deferred] = []

    def never(request: Text) -> Deferred:
        waiting.append(Deferred())
        return waiting[-1]

    node = make_node()
    node.service("never", ECHO, never)
    node.service("echo", ECHO, lambda request: request)
    publisher = node.publisher("chatter", STRING)
    client = make_node("client").client("echo", ECHO)
    assert client.wait_for_service(20)
    with other_node(router.endpoint) as other:
        eventually(lambda: publisher.subscriber_count() == 1 and waiting)
        other.send_signal(signal.SIGSTOP)
        # More than all buffers between the two hold.
        for _ in range(1000):
            publisher.publish(LARGE)
        waiting[0].answer(LARGE)
        # Less than the time after which the connection to the frozen node ends.
        assert client.call(Text("x"), 30) == Text("x")
        other.send_signal(signal.SIGCONT)
        lines: list[str] = []
        reader = threading.Thread(target=lambda: _collect(other, lines))
        reader.start()
        eventually(lambda: publisher.publish(Text("back")) or "4\n" in lines)
        other.kill()
        reader.join()


def test_an_urgent_service_does_not_wait_for_another_callback(make_node: Callable[..., Node]) -> None:
    server, client = make_node("server"), make_node("client")
    begun, go_on = threading.Event(), threading.Event()

    def slow(message: Text, sent: int) -> None:
        begun.set()
        go_on.wait(60.0)

    server.subscribe("chatter", STRING, slow)
    server.service("echo", ECHO, lambda request: request, urgent=True)
    publisher, asking = client.publisher("chatter", STRING), client.client("echo", ECHO)
    eventually(publisher.subscriber_count)
    assert asking.wait_for_service(30.0)
    publisher.publish(Text("x"))
    assert begun.wait(30.0)
    try:
        assert asking.call(Text("at once"), 30.0) == Text("at once")
        assert not go_on.is_set()
    finally:
        go_on.set()


def test_a_frozen_node_does_not_hold_up_what_follows_the_end_of_this_one(
    make_node: Callable[..., Node], router: Router, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(node_module, "_CLOSING", 0.5)
    node = make_node()
    node.service("never", ECHO, lambda request: Deferred())
    publisher = node.publisher("chatter", STRING)
    with other_node(router.endpoint) as other:
        eventually(lambda: publisher.subscriber_count() == 1)
        other.send_signal(signal.SIGSTOP)
        for _ in range(1000):
            publisher.publish(LARGE)
        # Where the buffers on the way hold it all, nothing is left to do; else a thread waits for the frozen node.
        node.close()
        closing = [thread for thread in threading.enumerate() if thread.name == "close the node"]
    for thread in closing:
        thread.join(30)
        assert not thread.is_alive()


def test_requests_of_a_client_that_is_killed_are_forgotten(make_node: Callable[..., Node], router: Router) -> None:
    service = make_node().service("never", ECHO, lambda request: Deferred())
    with other_node(router.endpoint) as other:
        eventually(lambda: service.pending == 1)
        other.kill()
        eventually(lambda: service.pending == 0)


ATTACHMENTS = [None, b"", bytes(33), b"\xff" * 33, b"x" * 100_000]
PAYLOADS = [None, b"", b"\x00\x01\x00\x00", b"\x00\x01\x00\x00\xff\xff\xff\x7f"]


def test_hostile_requests_get_no_answer_and_change_nothing(make_node: Callable[..., Node], raw: Any) -> None:
    service = make_node().service("echo", ECHO, lambda request: request)
    beside = Attachment(1, 1, bytes(16)).serialize()
    for attachment, payload in itertools.product(ATTACHMENTS, PAYLOADS):
        parts = {"payload": payload, "attachment": attachment}
        options = {key: value for key, value in parts.items() if value is not None}
        before = service.malformed

        def ask(options: dict[str, bytes] = options, before: int = before) -> bool:
            assert list(raw.get(ECHO_KEY, timeout=30, **options)) == [], f"answered: {str(options)[:200]}"
            return service.malformed > before

        eventually(ask)
        good = raw.get(ECHO_KEY, timeout=30, payload=TextType().serialize(Text("x")), attachment=beside)
        assert [reply.ok.payload.to_bytes() for reply in good] == [TextType().serialize(Text("x"))], options
        assert service.pending == 0


def test_a_number_that_is_used_twice_is_answered_once(make_node: Callable[..., Node], raw: Any) -> None:
    waiting: list[Deferred] = []

    def later(request: Text) -> Deferred:
        waiting.append(Deferred())
        return waiting[-1]

    service = make_node().service("echo", ECHO, later)
    options = {"payload": TextType().serialize(Text("x")), "attachment": Attachment(1, 1, bytes(16)).serialize()}
    replies: list[Any] = []
    eventually(lambda: raw.get(ECHO_KEY, replies.append, timeout=30, **options) or waiting)
    eventually(lambda: raw.get(ECHO_KEY, replies.append, timeout=30, **options) or service.malformed)
    waiting[0].answer(Text("once"))
    eventually(lambda: replies)
    assert [reply.ok is not None for reply in replies] == [True]


def test_a_huge_message_is_dropped_and_the_next_one_arrives(make_node: Callable[..., Node], raw: Any) -> None:
    node = make_node()
    found: list[int] = []
    subscription = node.subscribe("chatter", STRING, lambda message, _: found.append(len(message.data)))
    beside = Attachment(1, 1, bytes(16)).serialize()

    def put(size: int) -> None:
        payload = TextType().serialize(Text("x" * size))
        raw.put(
            subscription.endpoint.key, payload, attachment=beside, congestion_control=zenoh.CongestionControl.BLOCK
        )

    eventually(lambda: put(1) or found)
    put(20_000_000)
    eventually(lambda: put(2) or 2 in found)
    assert max(found) == 2
