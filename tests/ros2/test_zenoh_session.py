from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.fleet.lab import Lab
from tests.link.far_ends import free_port
from tests.ros2.tiny_types import Text, TinyTypes
from tests.ros2.world import Router
from tests.waits import eventually

from hexwire.errors import ConfigError, LinkClosedError, LinkNotFoundError, LinkPermissionError, UsageError
from hexwire.fleet.rights import Kind
from hexwire.ros2.rmw.keys import Role
from hexwire.ros2.rmw.node import Node, NodeOptions
from hexwire.ros2.rmw.qos import LATCHED
from hexwire.ros2.rmw.zenoh_session import ZenohSettings

STRING = "std_msgs/msg/String"
ECHO = "tiny_msgs/srv/Echo"


def test_the_settings_are_those_of_rmw_zenoh() -> None:
    rows = ZenohSettings().rows()
    assert rows["mode"] == "peer"
    assert rows["connect/endpoints"] == ["tcp/127.0.0.1:7447"]
    assert rows["listen/endpoints"] == ["tcp/localhost:0"]
    assert rows["scouting/multicast/enabled"] is False
    assert rows["scouting/gossip/enabled"] is True
    assert rows["timestamping/enabled"] == {"router": True, "peer": True, "client": True}


def test_a_connection_ends_by_silence_before_it_is_closed_for_taking_nothing() -> None:
    waits = ZenohSettings().rows()["transport/link/tx/queue/congestion_control/block/wait_before_close"]
    assert waits > 10e6  # microseconds, and Zenoh's time for silence


def test_all_passes_through_the_router_of_another_machine() -> None:
    rows = ZenohSettings(connect=("tcp/192.0.2.1:7447",), reachable_without_certificates=True).rows()
    assert (rows["mode"], rows["listen/endpoints"]) == ("client", [])


def test_another_machine_needs_certificates_or_the_flag() -> None:
    with pytest.raises(UsageError, match="anybody there could move the arm"):
        ZenohSettings(connect=("tcp/192.0.2.1:7447",))
    with pytest.raises(UsageError, match="needs certificates"):
        ZenohSettings(connect=("tls/lab-pc:7447",))
    with pytest.raises(UsageError, match="TLS needs all of ca, cert and key"):
        ZenohSettings(ca="ca.pem")


def test_the_environment_is_read_as_rmw_zenoh_does() -> None:
    rows = ('mode="client"', 'connect/endpoints=["tcp/a:1#b=c;d=e"]', "scouting.multicast.enabled=true")
    settings = ZenohSettings.from_environment(
        {
            "ZENOH_SESSION_CONFIG_URI": "/etc/zenoh.json5",
            "ZENOH_ROUTER_CHECK_ATTEMPTS": "-1",
            "ZENOH_CONFIG_OVERRIDE": ";".join(rows),
        }
    )
    assert (settings.config_file, settings.attempts) == ("/etc/zenoh.json5", -1)
    assert settings.overrides == (
        ("mode", '"client"'),
        ("connect/endpoints", '["tcp/a:1#b=c;d=e"]'),
        ("scouting/multicast/enabled", "true"),
    )
    assert ZenohSettings.from_environment({}) == ZenohSettings()


@pytest.mark.parametrize(
    "variables",
    [
        {"ZENOH_ROUTER_CHECK_ATTEMPTS": "many"},
        {"ZENOH_CONFIG_OVERRIDE": "mode"},
        {"ZENOH_CONFIG_OVERRIDE": "=5"},
        {"ZENOH_CONFIG_OVERRIDE": "mode="},
    ],
)
def test_a_variable_that_is_not_valid_is_named(variables: dict[str, str]) -> None:
    with pytest.raises(UsageError, match=next(iter(variables))):
        ZenohSettings.from_environment(variables)


@pytest.mark.parametrize(
    ("file", "overrides", "words"),
    [
        ("{mode: 'nobody'}", (), "zenoh.json5: Invalid configuration file"),
        ("{", (), "zenoh.json5: Invalid configuration file"),
        (None, (), "zenoh.json5"),
        ("{}", (("frobnicate", "5"),), "frobnicate is not a setting of Zenoh"),
        ("{}", (("mode", "["),), "mode is not a setting of Zenoh"),
    ],
)
def test_settings_that_zenoh_refuses_are_an_error_in_one_line(
    tmp_path: Path, file: str | None, overrides: Any, words: str
) -> None:
    path = tmp_path / "zenoh.json5"
    if file is not None:
        path.write_text(file)
    with pytest.raises((ConfigError, UsageError), match=words) as caught:
        ZenohSettings(config_file=str(path), overrides=overrides).open()
    assert "\n" not in str(caught.value)


@pytest.mark.system
def test_a_file_replaces_the_settings_and_overrides_change_it(
    tmp_path: Path, router: Router, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "zenoh.json5"
    path.write_text("{mode: 'peer', // a comment\n listen: {endpoints: ['tcp/0.0.0.0:0']},}")
    overrides = (("connect/endpoints", f'["{router.endpoint}"]'), ("scouting/multicast/enabled", "false"))
    session = ZenohSettings(config_file=str(path), overrides=overrides).open()
    try:
        eventually(lambda: session.routers == 1)
        assert session.endpoints == (router.endpoint,)
    finally:
        session.close()
    assert "listen to tcp/0.0.0.0:0, where anybody may move the arm" in caplog.text


@pytest.mark.system
def test_without_the_router_of_another_machine_it_waits_or_gives_up() -> None:
    overrides = (("mode", '"client"'),)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with pytest.raises(LinkNotFoundError, match=f"nobody answers at {endpoint}"):
        ZenohSettings(connect=(endpoint,), overrides=overrides, attempts=1).open()
    routers: list[Router] = []
    session = ZenohSettings(connect=(endpoint,), overrides=overrides).open(
        lambda why: routers.append(Router(endpoint))
    )
    assert session.routers == 1
    session.close()
    routers[0].stop()


@pytest.mark.system
def test_a_session_opens_without_a_router() -> None:
    session = ZenohSettings(connect=("tcp/127.0.0.1:1",)).open()
    assert session.routers == 0
    session.close()
    assert session.is_closed
    with pytest.raises(LinkClosedError, match="is closed"):
        session.declare_token("a/b")


@pytest.mark.system
def test_an_endpoint_that_is_taken_cannot_be_listened_on(router: Router) -> None:
    with pytest.raises(LinkPermissionError, match="cannot open a Zenoh session"):
        ZenohSettings(connect=(router.endpoint,), listen=(router.endpoint,)).open()


# -- with certificates, through the fleet's router -----------------------------------------------------------


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
            zenoh = ZenohSettings(connect=(lab.endpoint,), **lab.files(certificate))
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
    pc.subscribe("description", STRING, LATCHED, lambda message, stamp: found.append(message))
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
    arm.subscribe("command", STRING, LATCHED, lambda message, stamp: found.append(message))
    stranger.subscribe("state", STRING, LATCHED, lambda message, stamp: heard.append(message))
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
    zenoh = ZenohSettings(connect=(lab.endpoint,), **stranger.files("arm"), attempts=2)
    with pytest.raises(LinkNotFoundError, match="its certificate is not of the authority"):
        Node(NodeOptions("arm", zenoh=zenoh), TinyTypes()).open()
    assert "its certificate is not of the authority" in caplog.text
    assert "This node waits for a Zenoh router: start one with `hexwire fleet router`" in caplog.text
