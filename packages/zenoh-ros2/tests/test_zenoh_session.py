from __future__ import annotations

import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from tests.link.far_ends import free_port
from tests.waits import eventually
from zenoh_ros2_tests.router import Router

from zenoh_ros2 import zenoh_session
from zenoh_ros2.errors import RouterNotFoundError, SessionClosedError, SessionError, UsageError
from zenoh_ros2.qos import Durability, History, Qos, Reliability
from zenoh_ros2.zenoh_session import Request, Session, ZenohSettings, load_zenoh

STRING = "std_msgs/msg/String"
ECHO = "tiny_msgs/srv/Echo"


def test_a_request_is_told_why_it_has_no_answer_and_ends_even_if_nobody_hears_it() -> None:
    told: list[bytes] = []
    query: Any = SimpleNamespace(reply_err=told.append, drop=lambda: told.append(b"dropped"))
    Request("key", query).fail("it takes too long")
    query.reply_err = None
    Request("key", query).fail("nobody hears this")
    assert told == [b"it takes too long", b"dropped", b"dropped"]


def test_the_settings_are_those_of_rmw_zenoh() -> None:
    rows = ZenohSettings().rows()
    assert rows["mode"] == "peer"
    assert rows["connect/endpoints"] == ["tcp/localhost:7447"]
    assert rows["listen/endpoints"] == ["tcp/localhost:0"]
    assert rows["scouting/multicast/enabled"] is False
    assert rows["scouting/gossip/enabled"] is True
    assert rows["timestamping/enabled"] == {"router": True, "peer": True, "client": True}


def test_a_connection_ends_by_silence_before_it_is_closed_for_taking_nothing() -> None:
    waits = ZenohSettings().rows()["transport/link/tx/queue/congestion_control/block/wait_before_close"]
    assert waits > 10e6  # microseconds, and Zenoh's time for silence


def test_all_passes_through_the_router_of_another_machine() -> None:
    rows = ZenohSettings(connect=("tcp/192.0.2.1:7447",)).rows()
    assert (rows["mode"], rows["listen/endpoints"]) == ("client", [])


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
    "endpoint",
    [
        "tcp/localhost:7447",
        "tcp/127.0.0.1:7447",
        "udp/[::1]:7447",
        "unixsock-stream//run/arm",
        "tcp/127.evil.com:7447",
    ],
)
def test_nodes_of_a_machine_connect_to_each_other_if_the_router_is_on_it(endpoint: str) -> None:
    settings = ZenohSettings(connect=(endpoint,))
    assert settings.is_local == ("evil" not in endpoint)
    assert settings.rows()["mode"] == ("peer" if settings.is_local else "client")


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
        ("{mode: 'nobody'}", (), "zenoh.json5: Invalid configuration file: .*nobody"),
        ("{", (), "zenoh.json5: Invalid configuration file: .*1:2"),
        (None, (), "zenoh.json5"),
        ("{}", (("frobnicate", "5"),), "frobnicate is not a setting of Zenoh: .*unknown"),
        ("{}", (("mode", "["),), "mode is not a setting of Zenoh: its value is not JSON5"),
    ],
)
def test_settings_that_zenoh_refuses_are_an_error_in_one_line(
    tmp_path: Path, file: str | None, overrides: Any, words: str
) -> None:
    path = tmp_path / "zenoh.json5"
    if file is not None:
        path.write_text(file)
    with pytest.raises(UsageError, match=words) as caught:
        ZenohSettings(config_file=str(path), overrides=overrides).open()
    assert "\n" not in str(caught.value)
    assert ".rs" not in str(caught.value), "a place in the source of Zenoh"


@pytest.mark.parametrize("durability", list(Durability))
@pytest.mark.parametrize("history", list(History))
@pytest.mark.parametrize("reliability", list(Reliability))
def test_a_publisher_is_declared_as_rmw_zenoh_does(
    monkeypatch: pytest.MonkeyPatch, reliability: Reliability, history: History, durability: Durability
) -> None:
    zenoh = load_zenoh()
    declared: list[dict[str, Any]] = []

    def declare(*where: Any, **options: Any) -> Any:
        declared.append(options | {"key": where[-1], "advanced": len(where) == 2})
        return SimpleNamespace(undeclare=lambda: None)

    monkeypatch.setattr(zenoh.ext, "declare_advanced_publisher", declare)
    session = Session(SimpleNamespace(declare_publisher=declare, close=lambda: None))
    session.publisher("key", Qos(reliability, durability, history, depth=7))
    (options,) = declared
    reliable, latched = reliability is not Reliability.BEST_EFFORT, durability is Durability.TRANSIENT_LOCAL
    assert options["key"] == "key"
    assert options["reliability"] == (zenoh.Reliability.RELIABLE if reliable else zenoh.Reliability.BEST_EFFORT)
    waits = reliable and history is History.KEEP_ALL
    assert options["congestion_control"] == (
        zenoh.CongestionControl.BLOCK if waits else zenoh.CongestionControl.DROP
    )
    assert options["advanced"] is latched
    assert ("cache" in options, "publisher_detection" in options) == (latched, latched)
    assert ("sample_miss_detection" in options) == (latched and reliable)


@pytest.mark.system
def test_a_file_replaces_the_settings_and_overrides_change_it(tmp_path: Path, router: Router) -> None:
    path = tmp_path / "zenoh.json5"
    path.write_text("{mode: 'peer', // a comment\n listen: {endpoints: ['tcp/0.0.0.0:0']},}")
    overrides = (("connect/endpoints", f'["{router.endpoint}"]'), ("scouting/multicast/enabled", "false"))
    session = ZenohSettings(config_file=str(path), overrides=overrides).open()
    try:
        eventually(lambda: session.routers == 1)
        assert session.endpoints == (router.endpoint,)
    finally:
        session.close()


@pytest.mark.system
def test_without_the_router_of_another_machine_it_waits_or_gives_up() -> None:
    overrides = (("mode", '"client"'),)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with pytest.raises(RouterNotFoundError, match=f"nobody answers at {endpoint}"):
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
    with pytest.raises(SessionClosedError, match="is closed"):
        session.declare_token("a/b")


@pytest.mark.system
def test_an_endpoint_that_is_taken_cannot_be_listened_on(router: Router) -> None:
    with pytest.raises(SessionError, match="cannot open a Zenoh session"):
        ZenohSettings(connect=(router.endpoint,), listen=(router.endpoint,)).open()


def test_the_end_of_a_session_waits_for_its_threads() -> None:
    """One that came back from Zenoh into an interpreter that has ended would abort the program."""
    closed = threading.Event()
    thread = threading.Thread(target=closed.wait, args=(30.0,))
    thread.start()
    zenoh_session._close(SimpleNamespace(close=closed.set), RuntimeError, (thread,))
    assert not thread.is_alive()
