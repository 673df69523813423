"""How a node of an arm reaches its router: certificates, and what is refused without them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from tests.fleet.lab import Lab
from tests.link.far_ends import free_port
from tests.waits import eventually
from zenoh_ros2_tests.router import Router
from zenoh_ros2_tests.tiny_types import Text, TinyTypes

from hexwire.errors import UsageError
from hexwire.fleet.rights import Kind
from hexwire.ros2.secure_settings import SecureSettings
from zenoh_ros2 import RouterNotFoundError
from zenoh_ros2.keys import Role
from zenoh_ros2.node import Node, NodeOptions
from zenoh_ros2.qos import LATCHED

STRING = "std_msgs/msg/String"
ECHO = "tiny_msgs/srv/Echo"


def test_a_router_of_this_machine_is_reached_by_address_so_that_no_resolver_decides() -> None:
    rows = SecureSettings().rows()
    assert rows["mode"] == "peer"
    assert rows["connect/endpoints"] == ["tcp/127.0.0.1:7447"]
    assert rows["listen/endpoints"] == ["tcp/localhost:0"]


def test_all_passes_through_the_router_of_another_machine() -> None:
    rows = SecureSettings(connect=("tcp/192.0.2.1:7447",), reachable_without_certificates=True).rows()
    assert (rows["mode"], rows["listen/endpoints"]) == ("client", [])


def test_another_machine_needs_certificates_or_the_flag() -> None:
    with pytest.raises(UsageError, match="anybody there could move the arm"):
        SecureSettings(connect=("tcp/192.0.2.1:7447",))
    with pytest.raises(UsageError, match="needs certificates"):
        SecureSettings(connect=("tls/lab-pc:7447",))
    with pytest.raises(UsageError, match="TLS needs all of ca, cert and key"):
        SecureSettings(ca="ca.pem")


@pytest.mark.system
def test_settings_that_let_anybody_move_the_arm_are_warned_of(
    tmp_path: Path, router: Router, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "zenoh.json5"
    path.write_text("{mode: 'peer', // a comment\n listen: {endpoints: ['tcp/0.0.0.0:0']},}")
    overrides = (("connect/endpoints", f'["{router.endpoint}"]'), ("scouting/multicast/enabled", "false"))
    session = SecureSettings(config_file=str(path), overrides=overrides).open()
    try:
        eventually(lambda: session.routers == 1)
        assert session.endpoints == (router.endpoint,)
    finally:
        session.close()
    assert "listen to tcp/0.0.0.0:0, where anybody may move the arm" in caplog.text


@pytest.mark.system
def test_without_a_router_it_gives_up_and_says_why() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    settings = SecureSettings(connect=(endpoint,), overrides=(("mode", '"client"'),), attempts=1)
    with pytest.raises(RouterNotFoundError, match=rf"nobody answers at {endpoint} \(Connection refused\)"):
        settings.open()


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    lab = Lab(tmp_path_factory.mktemp("lab"))
    lab.issue("arm", Kind.ROS, "0")
    lab.issue("pc", Kind.ROS, "0", "5")
    lab.issue("other", Kind.ROS, "7")
    lab.issue("anna", Kind.OPERATOR, "**")
    with lab.routing():
        yield lab


@pytest.fixture
def node(lab: Lab) -> Iterator[Callable[..., Node]]:
    with contextlib.ExitStack() as stack:

        def make(name: str, certificate: str, domain: int = 0) -> Node:
            zenoh = SecureSettings(connect=(lab.endpoint,), **lab.files(certificate))
            options = NodeOptions(name, domain=domain, zenoh=zenoh, rosout=False, type_descriptions=False)
            return stack.enter_context(Node(options, TinyTypes()))

        yield make


@pytest.mark.system
def test_ros_passes_through_the_router_of_the_fleet_with_certificates(node: Callable[..., Node]) -> None:
    arm, pc = node("arm", "arm"), node("pc", "pc")
    arm.service("echo", ECHO, lambda request: request)
    publisher = arm.publisher("description", STRING, LATCHED)
    publisher.publish(Text("urdf"))
    found: list[Text] = []
    pc.subscribe("description", STRING, lambda message, stamp: found.append(message), LATCHED)
    eventually(lambda: found == [Text("urdf")])
    publisher.publish(Text("newer"))
    eventually(lambda: found == [Text("urdf"), Text("newer")])
    client = pc.client("echo", ECHO)
    assert client.wait_for_service(20)
    assert client.call(Text("x"), 10) == Text("x")


@pytest.mark.system
@pytest.mark.parametrize("certificate", ["other", "anna"])
def test_a_certificate_for_something_else_gets_nothing_of_a_domain(
    node: Callable[..., Node], certificate: str
) -> None:
    arm, stranger, pc = node("arm", "arm"), node("stranger", certificate), node("pc", "pc")
    found: list[Text] = []
    heard: list[Text] = []
    arm.subscribe("command", STRING, lambda message, stamp: found.append(message), LATCHED)
    stranger.subscribe("state", STRING, lambda message, stamp: heard.append(message), LATCHED)
    arm.publisher("state", STRING, LATCHED).publish(Text("secret"))
    stranger.publisher("command", STRING, LATCHED).publish(Text("evil"))
    good = pc.publisher("command", STRING, LATCHED)
    good.publish(Text("good"))
    eventually(lambda: Text("good") in found)
    assert found == [Text("good")]
    assert heard == []
    assert {each.node for each in arm.graph.find(Role.NODE)} == {"arm", "pc"}
    assert {each.node for each in stranger.graph.find(Role.NODE)} == {"stranger"}


@pytest.mark.system
def test_a_certificate_of_one_domain_is_none_of_another(node: Callable[..., Node]) -> None:
    arm, pc = node("arm", "arm", domain=5), node("pc", "pc", domain=5)
    other = node("other", "pc", domain=5)
    eventually(lambda: {each.node for each in pc.graph.find(Role.NODE)} == {"pc", "other"})
    assert {each.node for each in arm.graph.find(Role.NODE)} == {"arm"}
    assert other.routers == 1


@pytest.mark.system
def test_what_keeps_a_node_from_its_router_is_said(
    lab: Lab, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    stranger = Lab(tmp_path)
    stranger.issue("arm", Kind.ROS, "0")
    zenoh = SecureSettings(connect=(lab.endpoint,), **stranger.files("arm"), attempts=2)
    with pytest.raises(RouterNotFoundError, match="its certificate is not of the authority"):
        Node(NodeOptions("arm", zenoh=zenoh), TinyTypes()).open()
    assert "its certificate is not of the authority" in caplog.text
    assert "This node waits for a Zenoh router: start one with `hexwire fleet router`" in caplog.text
