from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import pytest
from tests.waits import eventually
from zenoh_ros2_tests.tiny_types import HASH, Text, TextType

from zenoh_ros2.attachment import Attachment
from zenoh_ros2.errors import ServiceTimeoutError
from zenoh_ros2.node import Deferred, Node

pytestmark = pytest.mark.system

STRING = "std_msgs/msg/String"
ECHO = "tiny_msgs/srv/Echo"
CHATTER = f"0/chatter/std_msgs::msg::dds_::String_/{HASH}"
ECHO_KEY = f"0/echo/tiny_msgs::srv::dds_::Echo_/{HASH}"


def test_a_service_answers_the_client_that_asked(make_node: Callable[..., Node]) -> None:
    make_node("server").service("echo", ECHO, lambda request: Text(request.data.upper()))
    client = make_node("client").client("echo", ECHO)
    assert client.wait_for_service(30)
    assert client.call(Text("hello"), 30) == Text("HELLO")


def test_a_reply_has_number_and_id_of_its_request(make_node: Callable[..., Node], raw: Any) -> None:
    node = make_node()
    node.service("echo", ECHO, lambda request: request)
    gid = bytes(range(16))
    beside = Attachment(7, 5, gid).serialize()
    replies: list[Any] = []

    def asked() -> bool:
        replies[:] = raw.get(ECHO_KEY, payload=TextType().serialize(Text("x")), attachment=beside, timeout=30)
        return bool(replies)

    eventually(asked)
    attachment = Attachment.parse(replies[0].ok.attachment.to_bytes())
    assert (attachment.sequence, attachment.gid) == (7, gid)
    assert attachment.stamp > 5
    assert str(replies[0].ok.key_expr) == ECHO_KEY


def test_answers_of_twenty_clients_are_never_crossed(make_node: Callable[..., Node]) -> None:
    waiting: list[tuple[Deferred, str]] = []

    def later(request: Text) -> Deferred:
        deferred = Deferred()
        waiting.append((deferred, request.data))
        if len(waiting) == 20:
            for each, data in reversed(waiting):
                each.answer(Text(data))
        return deferred

    make_node("server").service("echo", ECHO, later)
    node = make_node("client")
    clients = [node.client("echo", ECHO) for _ in range(20)]
    assert all(client.wait_for_service(30) for client in clients)
    answers: dict[int, Text] = {}

    def ask(number: int) -> None:
        answers[number] = clients[number].call(Text(f"of {number}"), 30)

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(20)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert answers == {number: Text(f"of {number}") for number in range(20)}


def test_a_burst_of_requests_waits_for_a_slow_callback(make_node: Callable[..., Node]) -> None:
    go_on = threading.Event()

    def slow(request: Text) -> Text:
        assert go_on.wait(30)
        return request

    service = make_node("server").service("echo", ECHO, slow)
    client = make_node("client").client("echo", ECHO)
    assert client.wait_for_service(30)
    answers: set[str] = set()
    threads = [
        threading.Thread(target=lambda i=i: answers.add(client.call(Text(str(i)), 30).data))  # type: ignore[misc]
        for i in range(60)
    ]
    for thread in threads:
        thread.start()
    eventually(lambda: len(service._inbox._items) == 59)
    go_on.set()
    for thread in threads:
        thread.join()
    assert answers == {str(i) for i in range(60)}


def test_a_service_that_fails_gives_no_answer_and_goes_on(make_node: Callable[..., Node]) -> None:
    def answer(request: Text) -> Text:
        if request.data == "bad":
            raise RuntimeError("a fault in the program")
        return request

    make_node("server").service("echo", ECHO, answer)
    client = make_node("client").client("echo", ECHO)
    assert client.wait_for_service(30)
    with pytest.raises(ServiceTimeoutError, match="/echo"):
        client.call(Text("bad"), 30)
    assert client.call(Text("good"), 30) == Text("good")


def test_requests_of_a_client_that_has_ended_are_forgotten(make_node: Callable[..., Node]) -> None:
    service = make_node("server").service("echo", ECHO, lambda request: Deferred())
    client = make_node("client").client("echo", ECHO)
    assert client.wait_for_service(30)
    with pytest.raises(ServiceTimeoutError):
        client.call(Text("x"), 1)
    eventually(lambda: service.pending == 1)
    client.close()
    eventually(lambda: service.pending == 0)
