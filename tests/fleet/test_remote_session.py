"""The session of a shared arm as a driver: one for all requests, closed with the driver; and missing states."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tests.waits import eventually

from hexwire.drivers import registry
from hexwire.errors import LinkNotFoundError, UsageError
from hexwire.fleet.network import Network
from hexwire.fleet.node import Node
from hexwire.fleet.remote import RemoteRobot

from .conftest import Serve


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[Node]:
    """The sessions that were opened."""
    nodes: list[Node] = []
    plain = Network.open

    def counted(network: Network, **options: Any) -> Node:
        nodes.append(plain(network, **options))
        return nodes[-1]

    monkeypatch.setattr(Network, "open", counted)
    return nodes


def test_one_session_serves_what_is_asked_before_and_what_follows(serve: Serve, opened: list[Node]) -> None:
    serve("lab/arm1", robot="sim")
    del opened[:]
    with registry.connect("zenoh:lab/arm1") as robot:
        assert robot.read().names == robot.model.names
        (node,) = opened
        robot.detach()
        assert node.is_closed
        robot.attach()
        assert len(opened) == 2


def test_a_session_whose_connection_has_ended_meanwhile_is_not_used(serve: Serve, opened: list[Node]) -> None:
    service = serve("lab/arm1", robot="sim")
    del opened[:]
    robot = RemoteRobot.from_url("zenoh:lab/arm1")
    (node,) = opened
    service.close()
    eventually(lambda: not node.connections)
    # The attempt to open another one reports the reason.
    with pytest.raises(LinkNotFoundError, match="no arm lab/arm1 is served"):
        robot.attach()
    assert node.is_closed
    serve("lab/arm1", robot="sim")
    robot.attach()
    try:
        assert robot.read().names
    finally:
        robot.abort()


def test_a_robot_that_was_never_attached_keeps_no_session(serve: Serve, opened: list[Node]) -> None:
    serve("lab/arm1", robot="sim")
    del opened[:]
    with pytest.raises(UsageError, match="its server names the robot"):
        RemoteRobot.from_url("zenoh:lab/arm1", robot="so101")
    for end in (RemoteRobot.detach, RemoteRobot.abort):
        end(RemoteRobot.from_url("zenoh:lab/arm1"))
    assert [node.is_closed for node in opened] == [True] * 3
    del opened[:]


def test_an_arm_of_ones_own_is_of_the_kind_that_its_file_is_based_on(serve: Serve, tmp_path: Path) -> None:
    file = tmp_path / "left.toml"
    file.write_text('name = "left"\nbase = "so101"\n')
    serve("lab/left", robot=str(file), port="sim://so101")
    for kind in ("so101", "left"):
        with RemoteRobot.from_url("zenoh:lab/left", robot=kind) as robot:
            assert robot.model.name == "left"
    with pytest.raises(UsageError, match="is a left, not a so100"):
        RemoteRobot.from_url("zenoh:lab/left", robot="so100")


@pytest.mark.slow
def test_states_that_stop_arriving_are_reported(serve: Serve, caplog: pytest.LogCaptureFixture) -> None:
    service = serve("lab/arm1", robot="sim")
    with registry.connect("zenoh:lab/arm1") as robot:
        robot.read()
        assert caplog.messages == []
        # As if the network was cut.
        (served,) = service._arms
        assert served.server is not None
        served.server._publish = lambda payload: None
        eventually(lambda: any("states have stopped arriving" in text for text in caplog.messages))
