"""The strict client sees what is wrong: a server and a publisher of its own, each with one fault."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import zenoh
from tests.link.far_ends import free_port
from tests.ros2.strict_client.cdr import WrongBytesError
from tests.ros2.strict_client.wire import SERVICES, Attachment, Participant, ServiceClient, router
from tests.waits import until

pytestmark = pytest.mark.system

TRIGGER = "std_srvs/srv/Trigger"
STRING = "std_msgs/msg/String"
Answer = Callable[[zenoh.Query, str, bytes, Attachment], None]


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    made = free_port()
    with router(made):
        yield made


@pytest.fixture
def ends(port: int) -> Iterator[tuple[Participant, Participant]]:
    with Participant(port, "server") as server, Participant(port, "client") as client:
        yield server, client


def serve(server: Participant, answer: Answer) -> None:
    token = server._token("SS", "/asked", TRIGGER, SERVICES)

    def asked(query: zenoh.Query) -> None:
        sent = Attachment.of(query.attachment)
        payload = server.cdr.serialize(f"{TRIGGER}_Response", {"success": True, "message": "done"})
        answer(query, token.key, payload, Attachment(sent.sequence, time.time_ns(), sent.gid))
        query.drop()

    server._declared.append(server.session.declare_queryable(token.key, asked, complete=True))
    server._declare(token)


def client_of(ends: tuple[Participant, Participant], answer: Answer) -> ServiceClient:
    serve(ends[0], answer)
    client = ends[1].client("/asked", TRIGGER)
    client.wait()
    return client


def test_a_right_answer_is_taken(ends: tuple[Participant, Participant]) -> None:
    client = client_of(ends, lambda query, key, payload, a: query.reply(key, payload, attachment=a.serialize()))
    assert vars(client.send().message()) == {"success": True, "message": "done"}


def twice(query: zenoh.Query, key: str, payload: bytes, a: Attachment) -> None:
    query.reply(key, payload, attachment=a.serialize())
    query.reply(key, payload, attachment=a.serialize())


WRONG: dict[str, Answer] = {
    "no answer": lambda query, key, payload, a: None,
    "two answers": twice,
    "an error": lambda query, key, payload, a: query.reply_err(b"no"),
    "no attachment": lambda query, key, payload, a: query.reply(key, payload),
    "another sequence": lambda query, key, payload, a: query.reply(
        key, payload, attachment=Attachment(a.sequence + 1, a.stamp, a.gid).serialize()
    ),
    "another gid": lambda query, key, payload, a: query.reply(
        key, payload, attachment=Attachment(a.sequence, a.stamp, bytes(16)).serialize()
    ),
    "a byte too many": lambda query, key, payload, a: query.reply(key, payload + b"\0", attachment=a.serialize()),
    "a byte too few": lambda query, key, payload, a: query.reply(key, payload[:-1], attachment=a.serialize()),
    "no header": lambda query, key, payload, a: query.reply(key, payload[4:], attachment=a.serialize()),
}


@pytest.mark.parametrize("answer", WRONG.values(), ids=WRONG)
def test_a_wrong_answer_is_seen(ends: tuple[Participant, Participant], answer: Answer) -> None:
    client = client_of(ends, answer)
    with pytest.raises((AssertionError, WrongBytesError)):
        client.send().message()


@pytest.mark.parametrize(
    "put",
    [
        {"payload": b""},
        {"payload": b"\0\1\0\0\2\0\0\0a"},
        {"payload": b"\0\1\0\0\2\0\0\0a\0", "attach": False},
        {"payload": b"\0\1\0\0\2\0\0\0a\0", "attachment": bytes(33)},
    ],
)
def test_a_wrong_message_is_seen(ends: tuple[Participant, Participant], put: dict[str, Any]) -> None:
    server, client = ends
    subscription = client.subscribe("/said", STRING)
    publisher = server.publisher("/said", STRING)
    publisher.wait_for_subscriber()
    publisher.put(**put)
    with pytest.raises((AssertionError, WrongBytesError)):
        subscription.take()


def test_silence_is_seen(ends: tuple[Participant, Participant]) -> None:
    with pytest.raises(AssertionError, match="nothing came on /said"):
        ends[1].subscribe("/said", STRING).take(0.2)


def test_a_token_that_is_there_twice_is_seen(ends: tuple[Participant, Participant]) -> None:
    server, client = ends
    for _ in range(2):
        server.publisher("/said", STRING)
    until(lambda: len(client.graph.tokens(kind="MP")) == 2, "both are there")
    with pytest.raises(AssertionError, match="twice"):
        client.graph.one(kind="MP", topic="/said")
