"""The node with an arm that `hexwire serve` shares with other programs."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator

import pytest
from tests.ros1.ros_world import HEXWIRE, NODE, Arm, World, made, near, shared_board, still
from tests.waits import until

from hexwire.drivers import registry
from hexwire.fleet.remote import RemoteRobot
from hexwire.model.arms.hex7bot.joints import HEX7BOT

pytestmark = pytest.mark.slow
PORT = "zenoh:lab/arm1"


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    """A master of its own: its node has the name of that of the other tests."""
    with made(tmp_path_factory.mktemp("ros")) as world:
        yield world


@pytest.fixture(scope="module")
def shared(world: World) -> Iterator[Arm]:
    """A node without torque, and the arm behind it, whose server is this process."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(0.001)
    try:
        with shared_board(world) as board:
            node = world.node(f"_port:={PORT}", "_allow_partial_joints_goal:=true", "_publish_rate:=50")
            yield Arm(world, node, board=board)
            assert node.end() == 0
    finally:
        sys.setswitchinterval(interval)


def other(take: bool = False) -> RemoteRobot:
    robot = registry.connect(PORT + ("?take=1" if take else ""))
    assert isinstance(robot, RemoteRobot)
    return robot


@pytest.fixture
def arm(shared: Arm) -> Arm:
    """The arm with torque, commanded by its node."""
    shared.trigger("reset")
    shared.enable()
    return shared


def test_two_watch_one_records_one_moves_the_node_publishes_and_a_sixth_stops(shared: Arm) -> None:
    world, file = shared.world, shared.world.folder / "r.mcap"
    watch = (*HEXWIRE, "state", "--watch", "--port", PORT)
    readers = [
        world.start(*watch),
        world.start(*watch, "--json"),
        world.start(*HEXWIRE, "--record", str(file), *watch[len(HEXWIRE) :]),
    ]
    # The node may hold the lease, if it has commanded the arm in another test.
    move = world.start(*HEXWIRE, "move", "J1=60", "--duration", "20", "--wait", "--take", "--port", PORT)
    here = shared.board.positions["J1"]
    until(lambda: shared.board.positions["J1"] > here + 0.03, "it moves", move.report)
    # The node does not command it, so it only publishes, and hears who holds the lease.
    until(lambda: shared.position()["J1"] > here + 0.05, "the node says so", shared.node.report)
    success, text = shared.client.switch(service=shared.service("enable"), on=True)
    assert not success
    assert "holds the lease" in text
    stop = world.run(*HEXWIRE, "stop", "--port", PORT)
    servos = {servo.servo_id: servo.torque_on for servo in shared.board.board.wire.servos}
    holding = [joint.name for joint in HEX7BOT.joints if servos[joint.servo_id]]
    assert "J1" in holding  # The move gave it torque.
    assert stop.out.split(";")[0].strip() == f"stopped, holding: {' '.join(holding)}"
    assert move.wait() == 1
    assert "has stopped the arm" in move.err
    where = still(lambda: shared.board.positions)
    assert where["J1"] < 0.9
    for reader in readers:
        until(lambda reader=reader: "stopped" in reader.out, "it saw the stop", reader.report)
        assert reader.running
        assert reader.end() == 130
        assert reader.err == ""
    until(lambda: near(where, shared.position()), "the node went on", shared.node.report)
    shared.diagnosed("board", 2, "stopped")
    info = world.run(*HEXWIRE, "record", "info", str(file))
    assert "foxglove.JointStates" in info.out


def test_a_goal_ends_with_the_lease_and_only_a_reset_takes_it_again(arm: Arm) -> None:
    arm.send("long", {"J1": arm.position()["J1"] + 0.5}, 10.0)
    arm.client.wait_active(key="long")
    with other(take=True) as robot:
        robot.torque(True)
        result = arm.result("long")
        assert result["state"] == "ABORTED"
        where = still(lambda: arm.board.positions)
        # The node is back, but does not take the arm from anybody.
        arm.send("again", {"J1": where["J1"] + 0.1}, 1.0)
        assert arm.result("again")["state"] == "REJECTED"
        assert str(os.getpid()) in robot.holder
        # A lost lease is no stop.
        assert not robot.read().stopped
    assert near(where, still(lambda: arm.board.positions))
    until(lambda: arm.client.trigger(service=arm.service("reset"))[0] or None, "it is reset", arm.node.report)
    arm.moves("again", {"J1": where["J1"] + 0.1}, 1.0)


@pytest.mark.parametrize(
    ("port", "status", "text"),
    [
        ("zenoh:lab/nix", 1, "no arm lab/nix is served"),
        ("zenoh:", 2, "ROS rejects these arguments"),
        (f"{PORT} _robot:=puma260", 2, "is a hex7bot, not a puma260; its server names the robot"),
    ],
)
def test_a_wrong_address_is_one_line(shared: Arm, port: str, status: int, text: str) -> None:
    node = shared.world.start(*NODE, "__ns:=wrong", *f"_port:={port}".split())
    assert node.wait() == status
    (line,) = node.err.splitlines()
    assert line.startswith("error: ")
    assert text in line
