from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

import pytest
from tests.link.far_ends import free_port
from tests.waits import eventually
from zenoh_ros2_tests.router import Router
from zenoh_ros2_tests.tiny_types import HASH, Text, TinyTypes

from zenoh_ros2.distributions import Distribution
from zenoh_ros2.errors import SessionClosedError, UsageError
from zenoh_ros2.keys import Role
from zenoh_ros2.node import Node, NodeOptions
from zenoh_ros2.qos import LATCHED, ROSOUT
from zenoh_ros2.types import Types
from zenoh_ros2.zenoh_session import ZenohSettings

pytestmark = pytest.mark.system

STRING = "std_msgs/msg/String"
FEEDBACK = "control_msgs/action/FollowJointTrajectory_FeedbackMessage"
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
    assert late.call(Text("x"), 30) == Text("x")


def test_a_node_must_be_open_to_publish() -> None:
    with pytest.raises(SessionClosedError, match="/talker is not open"):
        Node(NodeOptions("talker"), TinyTypes()).publisher("chatter", STRING)


def test_the_log_of_the_program_is_on_rosout(make_node: Callable[..., Node]) -> None:
    types = Types()
    before = len(logging.getLogger().handlers)
    node = make_node("driver", namespace="/arm", types=types)
    node.log.getChild("goals").warning("before the subscription")
    found: list[Any] = []

    def read(number: int) -> bool:
        """Join late; whether the log of before came. Zenoh may lose the first question of a fresh session."""
        reader = make_node(f"reader{number}", types=types, rosout=False)
        reader.subscribe("/rosout", "rcl_interfaces/msg/Log", lambda message, _: found.append(message), ROSOUT)
        deadline = time.monotonic() + 5.0
        while not found and time.monotonic() < deadline:
            time.sleep(0.02)
        return bool(found)

    assert any(read(number) for number in range(6))
    logging.getLogger("program.part").error("elsewhere")

    def seen(text: str) -> list[tuple[int, str]]:
        return [(each.level, each.name) for each in found if each.msg == text]

    # A message may come twice: from the publisher's cache, and as it is published.
    eventually(lambda: set(seen("before the subscription")) == {(30, "arm.driver.goals")})
    eventually(lambda: set(seen("elsewhere")) == {(40, "arm.driver")})
    node.close()
    handlers = len(logging.getLogger().handlers)
    logging.getLogger("program.part").error("after the end")
    assert not seen("after the end")
    assert handlers == before


def test_last_words_are_published(make_node: Callable[..., Node]) -> None:
    types = Types()
    node = make_node("driver", types=types)
    found: list[str] = []
    reader = make_node("reader", types=types, rosout=False)
    reader.subscribe("/rosout", "rcl_interfaces/msg/Log", lambda each, _: found.append(each.msg), ROSOUT)
    eventually(lambda: len(reader.graph.find(Role.PUBLISHER, "/rosout")) == 1)
    # Who does not know of a reader yet sends it nothing, and what is kept for later ones ends with the node.
    eventually(lambda: len(node.graph.find(Role.SUBSCRIPTION, "/rosout")) == 1)
    node.log.error("the arm is stopped")
    node.close()
    eventually(lambda: "the arm is stopped" in found)


def test_types_in_use_are_described(make_node: Callable[..., Node]) -> None:
    types = Types()
    node = make_node("driver", types=types)
    node.publisher("joint_states", "sensor_msgs/msg/JointState")
    client = make_node("asking", types=types).client(
        "/driver/get_type_description", "type_description_interfaces/srv/GetTypeDescription"
    )
    assert client.wait_for_service(20)
    state = types.message("sensor_msgs/msg/JointState")
    action = types.action("control_msgs/action/FollowJointTrajectory")
    asked = client.type.request(type_name=state.name, type_hash=state.hash, include_type_sources=True)
    assert client.call(asked, 30).type_description.type_description.type_name == state.name
    asked = client.type.request(type_name=action.name, type_hash=action.hash)
    assert client.call(asked, 30).failure_reason == "Type not currently in use by this node"
    node.tell_type(action)
    assert client.call(asked, 30).successful


def test_humble_has_no_descriptions(make_node: Callable[..., Node]) -> None:
    node = make_node("driver", types=Types(Distribution.HUMBLE))
    assert node.graph.find(Role.SERVICE) == []
    assert node.graph.find(Role.PUBLISHER, "/rosout")[0].type_hash == "TypeHashNotSupported"


@pytest.mark.parametrize("late", [False, True])
def test_incompatible_quality_of_service_is_logged(
    make_node: Callable[..., Node], caplog: pytest.LogCaptureFixture, late: bool
) -> None:
    node, other = make_node("talker"), make_node("listener")

    def publish() -> None:
        node.publisher("chatter", STRING)

    def subscribe() -> None:
        other.subscribe("chatter", STRING, lambda *_: None, LATCHED)

    first, second = (subscribe, publish) if late else (publish, subscribe)
    first()
    eventually(lambda: any(each.name == "/chatter" for each in (node if late else other).graph))
    second()
    words = "requesting incompatible QoS. No messages will be sent to it"
    eventually(lambda: words in caplog.text and "DURABILITY_QOS_POLICY" in caplog.text)


def test_another_node_of_the_same_name_is_mentioned(
    make_node: Callable[..., Node], caplog: pytest.LogCaptureFixture
) -> None:
    make_node("driver"), make_node("driver", namespace="/left")
    assert "share an exact name" not in caplog.text
    make_node("driver")
    eventually(lambda: "Another node has the name '/driver'" in caplog.text)
    assert "/left" not in caplog.text


def test_a_node_opens_without_a_router_and_says_so(caplog: pytest.LogCaptureFixture) -> None:
    types = Types()
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with Node(NodeOptions("driver", zenoh=ZenohSettings(connect=(endpoint,))), types) as node:
        assert f"Unable to connect to a Zenoh router at {endpoint}" in caplog.text
        router = Router(endpoint)
        try:
            eventually(lambda: node.routers == 1)
            with Node(NodeOptions("late", zenoh=ZenohSettings(connect=(endpoint,))), types) as late:
                eventually(lambda: "driver" in {each.node for each in late.graph.find(Role.NODE)})
        finally:
            router.stop()


def test_hostile_tokens_are_counted_and_change_nothing(make_node: Callable[..., Node], raw: Any) -> None:
    node = make_node()
    declared = [
        raw.liveliness().declare_token(key)
        for key in (
            "@ros2_lv/0/x",
            "@ros2_lv/0/ab/0/1/MP/%/%/n/%chatter/T_/H/9::,x:,:,:,,",
            "@ros2_lv/0/" + "n" * 3000,
        )
    ]
    eventually(lambda: node.graph.malformed == 3)
    assert [each.node for each in node.graph] == ["talker"]
    assert len(declared) == 3


def test_made_up_nodes_do_not_fill_the_log(
    make_node: Callable[..., Node], raw: Any, caplog: pytest.LogCaptureFixture
) -> None:
    node = make_node("driver")
    tokens = [
        raw.liveliness().declare_token(f"@ros2_lv/0/ab/{number}/{number}/NN/%/%/driver") for number in range(1, 200)
    ]
    eventually(lambda: len(node.graph.find(Role.NODE)) == 200)
    eventually(lambda: caplog.text.count("Another node has the name") >= 50)
    end = make_node("end").client("echo", ECHO)
    eventually(lambda: any(each.node == "end" for each in node.graph.find(Role.CLIENT)))
    assert caplog.text.count("Another node has the name") == 50
    assert (len(tokens), end.name) == (199, "/echo")


def test_a_node_takes_domain_router_and_distribution_from_the_environment() -> None:
    variables = {"ROS_DOMAIN_ID": "7", "ROS_DISTRO": "kilted", "ZENOH_ROUTER_CHECK_ATTEMPTS": "3"}
    node = Node.from_environment("talker", environment=variables)
    assert (node.full_name, node.options.domain, node.options.zenoh.attempts) == ("/talker", 7, 3)
    assert Types(Distribution.KILTED).message(FEEDBACK).hash == node.types.message(FEEDBACK).hash
    assert Types().message(FEEDBACK).hash != node.types.message(FEEDBACK).hash
    assert Distribution.from_environment({}) is Distribution.JAZZY
    with pytest.raises(UsageError, match="ROS_DISTRO is 'foxy'; this package knows humble, jazzy"):
        Node.from_environment("talker", environment={"ROS_DISTRO": "foxy"})
