from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from tests.fleet.eventually import eventually
from tests.ros2.tiny_types import HASH, Text, TinyTypes

from hexwire.errors import LinkClosedError
from hexwire.ros2.keys import Role
from hexwire.ros2.node import Node, NodeOptions

pytestmark = pytest.mark.system

STRING = "std_msgs/msg/String"
ECHO = "tiny_msgs/srv/Echo"
CHATTER = f"0/chatter/std_msgs::msg::dds_::String_/{HASH}"
ECHO_KEY = f"0/echo/tiny_msgs::srv::dds_::Echo_/{HASH}"


def test_tokens_have_numbers_in_order_and_vanish_with_their_endpoints(make_node: Callable[..., Node]) -> None:
    node, other = make_node("talker", namespace="/arm"), make_node("other")
    publisher = node.publisher("~/state", STRING)
    node.client("echo", ECHO)

    def seen() -> list[tuple[str, Role, str]]:
        return sorted((each.eid, each.role, each.name) for each in other.graph if each.node == "talker")

    eventually(
        lambda: (
            seen()
            == [("0", Role.NODE, ""), ("1", Role.PUBLISHER, "/arm/talker/state"), ("2", Role.CLIENT, "/arm/echo")]
        )
    )
    publisher.close()
    eventually(lambda: [eid for eid, _, _ in seen()] == ["0", "2"])
    node.close()
    eventually(lambda: seen() == [])


def test_everything_comes_back_when_the_router_restarts(
    make_node: Callable[..., Node], router: Any, raw: Any
) -> None:
    node = make_node()
    node.service("echo", ECHO, lambda request: request)
    eventually(lambda: node.routers == 1)
    router.stop()
    eventually(lambda: node.routers == 0)
    router.start()
    eventually(lambda: node.routers == 1)
    late = make_node("late").client("echo", ECHO)
    assert late.wait_for_service(20)
    assert late.call(Text("x"), 10) == Text("x")


def test_a_node_must_be_open_to_publish() -> None:
    with pytest.raises(LinkClosedError, match="/talker is not open"):
        Node(NodeOptions("talker"), TinyTypes()).publisher("chatter", STRING)
