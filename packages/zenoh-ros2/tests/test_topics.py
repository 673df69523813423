from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import pytest
from tests.waits import eventually
from zenoh_ros2_tests.tiny_types import HASH, Text, TextType

from zenoh_ros2.attachment import Attachment
from zenoh_ros2.keys import gid_of
from zenoh_ros2.node import Node
from zenoh_ros2.qos import DEFAULT, LATCHED

pytestmark = pytest.mark.system

STRING = "std_msgs/msg/String"
ECHO = "tiny_msgs/srv/Echo"
CHATTER = f"0/chatter/std_msgs::msg::dds_::String_/{HASH}"
ECHO_KEY = f"0/echo/tiny_msgs::srv::dds_::Echo_/{HASH}"


def collected(node: Node, topic: str, qos: Any = DEFAULT) -> list[Text]:
    found: list[Text] = []
    node.subscribe(topic, STRING, lambda message, stamp: found.append(message), qos)
    return found


def test_messages_reach_a_subscription_of_another_node(make_node: Callable[..., Node]) -> None:
    talker, listener = make_node("talker"), make_node("listener")
    found: list[tuple[str, int]] = []
    listener.subscribe("chatter", STRING, lambda message, stamp: found.append((message.data, stamp)))
    publisher = talker.publisher("chatter", STRING)
    # A subscription may be in the graph before Zenoh knows the way to it.
    eventually(lambda: publisher.subscriber_count() == 1 and publisher.has_readers)
    before = time.time_ns()
    for number in range(20):
        publisher.publish(Text(str(number)))
        time.sleep(0.005)
    eventually(lambda: len(found) == 20)
    assert [data for data, _ in found] == [str(number) for number in range(20)]
    assert all(before <= stamp <= time.time_ns() for _, stamp in found)


def test_each_message_has_number_time_and_id_beside_it(make_node: Callable[..., Node], raw: Any) -> None:
    samples: list[Any] = []
    raw.declare_subscriber(CHATTER, samples.append)
    publisher = make_node().publisher("chatter", STRING)
    eventually(lambda: publisher.publish(Text("x")) or len(samples) >= 3)
    attachments = [Attachment.parse(sample.attachment.to_bytes()) for sample in samples]
    numbers = [each.sequence for each in attachments]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert {each.gid for each in attachments} == {gid_of(publisher.endpoint.token)}


def test_bytes_that_were_made_before_count_as_messages(make_node: Callable[..., Node], raw: Any) -> None:
    samples: list[Any] = []
    raw.declare_subscriber(CHATTER, samples.append)
    publisher = make_node().publisher("chatter", STRING)
    payload = publisher.type.serialize(Text("made"))
    eventually(lambda: publisher.publish_serialized(payload) or len(samples) >= 2)
    publisher.publish(Text("made"))
    eventually(lambda: len(samples) >= 3)
    assert {sample.payload.to_bytes() for sample in samples} == {payload}
    numbers = [Attachment.parse(sample.attachment.to_bytes()).sequence for sample in samples]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def test_a_publisher_knows_whether_anybody_reads(make_node: Callable[..., Node], raw: Any) -> None:
    publisher = make_node().publisher("chatter", STRING)
    assert not publisher.has_readers
    # A program without a token reads, too.
    subscriber = raw.declare_subscriber(CHATTER, lambda sample: None)
    eventually(lambda: publisher.has_readers)
    subscriber.undeclare()
    eventually(lambda: not publisher.has_readers)
    assert make_node("other").publisher("kept", STRING, LATCHED).has_readers


def test_a_late_subscription_gets_the_last_latched_message(make_node: Callable[..., Node]) -> None:
    publisher = make_node().publisher("description", STRING, LATCHED)
    publisher.publish(Text("old"))
    publisher.publish(Text("new"))
    found = collected(make_node("late"), "description", LATCHED)
    eventually(lambda: found == [Text("new")])


def test_a_late_subscription_gets_no_volatile_message(make_node: Callable[..., Node]) -> None:
    talker = make_node()
    publisher = talker.publisher("chatter", STRING)
    publisher.publish(Text("before"))
    found = collected(make_node("late"), "chatter")
    eventually(lambda: publisher.subscriber_count() == 1)
    eventually(lambda: publisher.publish(Text("after")) or Text("after") in found)
    assert Text("before") not in found


@pytest.mark.parametrize("attachment", [None, b"", b"short", bytes(33), b"\xff" * 33])
def test_a_message_without_a_right_attachment_is_dropped(
    make_node: Callable[..., Node], raw: Any, attachment: bytes | None
) -> None:
    node = make_node()
    found: list[Text] = []
    subscription = node.subscribe("chatter", STRING, lambda message, stamp: found.append(message))
    payload = TextType().serialize(Text("x"))
    eventually(lambda: raw.put(CHATTER, payload, attachment=attachment) or subscription.malformed)
    assert found == []


def test_a_malformed_message_is_dropped_and_the_next_one_arrives(make_node: Callable[..., Node], raw: Any) -> None:
    node = make_node()
    found: list[Text] = []
    subscription = node.subscribe("chatter", STRING, lambda message, stamp: found.append(message))
    beside = Attachment(1, 1, bytes(16)).serialize()
    eventually(lambda: raw.put(CHATTER, b"\x00\x01\x00\x00\xff", attachment=beside) or subscription.malformed)
    raw.put(CHATTER, TextType().serialize(Text("x")), attachment=beside)
    eventually(lambda: found == [Text("x")])


def test_a_callback_that_raises_does_not_end_the_subscription(make_node: Callable[..., Node]) -> None:
    node = make_node()
    seen = []

    def fail(message: Text, stamp: int) -> None:
        seen.append(message.data)
        raise RuntimeError("a fault in the program")

    node.subscribe("chatter", STRING, fail)
    publisher = node.publisher("chatter", STRING)
    eventually(lambda: publisher.publish(Text("x")) or len(seen) >= 2)
