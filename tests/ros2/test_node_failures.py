"""What the node does when something fails: itself, its router, the board, a servo, whoever started it."""

from __future__ import annotations

import json
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.ros1.ros_world import HEXWIRE, Program
from tests.ros2.node_fixtures import SETTINGS, own_arm, world
from tests.ros2.node_world import ABORTED, NODE, SUCCEEDED, Arm, Goal, PtyBoard, World, near, still
from tests.waits import until

from zenoh_ros2.qos import LATCHED

__all__ = ["own_arm", "world"]

pytestmark = pytest.mark.system
TARGET = {"J1": 0.6}


def _moving(arm: Arm) -> Goal:
    """Begin a motion that takes long."""
    start = arm.board.positions
    goal = Goal(arm, (6.0, TARGET))
    assert goal.accepted
    until(lambda: not near(start, arm.board.positions, 0.02), "it moves", arm.node.report)
    return goal


def _held(arm: Arm) -> dict[str, float]:
    """The arm stands somewhere on its way, and its servos hold it."""
    stood = still(lambda: arm.board.positions)
    assert not near(TARGET, stood, 0.1)
    assert all(servo.torque_on for servo in arm.board.board.wire.servos)
    return stood


def _again(arm: Arm) -> Arm:
    """A new node for the same arm."""
    at = arm.at.strip("/")
    node = arm.world.node("-r", f"__ns:=/{at}", "-p", f"port:={arm.board.port}", *SETTINGS)
    return Arm(arm.world, node, arm.board, at=arm.at)


# -- the node ends ---------------------------------------------------------------------------------------------


def test_killed_during_a_move_the_arm_is_held_by_its_board(own_arm: Arm) -> None:
    _moving(own_arm)
    own_arm.node.end(signal.SIGKILL)
    board = own_arm.board.board
    until(lambda: board.state.stopped, "the board's watchdog stops the arm")
    stood = _held(own_arm)
    program = own_arm.world.start(*HEXWIRE, "state", "--json", "--port", own_arm.board.port)
    assert program.wait() == 0
    state = json.loads(program.out)
    assert state["stopped"]
    assert state["watchdog_tripped"]
    # Whoever comes next must say that he has seen it; "enable on start" is none of that.
    arm = _again(own_arm)
    arm.diagnosed("board", 2, "stopped")
    assert not Goal(arm, (3.0, TARGET)).accepted
    assert near(stood, arm.board.positions, 0.01)
    arm.trigger("reset")
    assert near(stood, still(lambda: arm.board.positions), 0.01)
    arm.enable()
    assert Goal(arm, (2.0, TARGET)).result()[0] == SUCCEEDED
    assert arm.node.end() == 0


@pytest.mark.slow
def test_suspended_during_a_move_the_arm_is_held_by_its_board(own_arm: Arm) -> None:
    goal = _moving(own_arm)
    own_arm.node.process.send_signal(signal.SIGSTOP)
    try:
        until(lambda: own_arm.board.board.state.stopped, "the board's watchdog stops the arm")
        stood = _held(own_arm)
    finally:
        own_arm.node.process.send_signal(signal.SIGCONT)
    assert goal.result()[0] == ABORTED
    assert near(stood, still(lambda: own_arm.board.positions), 0.02)


@pytest.mark.slow
def test_ended_during_a_move_the_arm_is_held(own_arm: Arm) -> None:
    goal = _moving(own_arm)
    client = own_arm.peer.node
    ended: list[tuple[int, int, str]] = []
    waiting = threading.Thread(target=lambda: ended.append(goal.result()))
    waiting.start()
    until(lambda: own_arm.peer.asks("get_result"), "the result is asked for")
    # Answered after the request before it has come.
    own_arm.peer.call(f"{own_arm.at}hardware_interface/get_state", "lifecycle_msgs/srv/GetState")
    assert own_arm.node.end(signal.SIGHUP) == 0
    assert "Traceback" not in own_arm.node.err
    _held(own_arm)
    waiting.join()
    # Its client hears of it.
    ((status, _, text),) = ended
    assert status == ABORTED
    assert "the program ends" in text
    until(lambda: not any(each.namespace == own_arm.at.rstrip("/") for each in client.graph), "its tokens are gone")


# -- the router fails ------------------------------------------------------------------------------------------

_ROUTER = """
import sys, time
import zenoh
config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("listen/endpoints", f'["{sys.argv[1]}"]')
config.insert_json5("scouting/multicast/enabled", "false")
session = zenoh.open(config)
print("ready", flush=True)
time.sleep(3600)
"""


@pytest.fixture
def routed(tmp_path: Path) -> Iterator[tuple[World, Program]]:
    """A world whose router is a process of its own."""
    world = World(tmp_path, routed=False)
    try:
        yield world, _router(world)
        print(world.report())
    finally:
        world.close()


def _router(world: World) -> Program:
    program = world.start(sys.executable, "-c", _ROUTER, world.endpoint)
    program.said("ready")
    return program


def test_a_motion_goes_on_without_the_router_and_all_is_back_with_it(routed: tuple[World, Program]) -> None:
    world, router = routed
    board = PtyBoard(world.folder / "arm")
    try:
        arm = Arm(world, world.node("-p", f"port:={board.port}", *SETTINGS), board)
        goal = Goal(arm, (4.0, TARGET))
        assert goal.accepted
        arm.peer.close()
        router.end(signal.SIGKILL)
        until(lambda: "lost" in arm.node.err, "it is reported", arm.node.report)
        until(lambda: near(TARGET, board.positions), "it is there", arm.node.report)
        _router(world)
        # A client that comes now sees everything, and gets what it missed.
        arm.peer = world.peer("later")
        assert near(arm.position(), board.positions)
        assert arm.peer.collect("/robot_description", "std_msgs/msg/String", qos=LATCHED)
        assert goal.result()[0] == SUCCEEDED
        assert Goal(arm, (1.0, {"J1": 0.3})).result()[0] == SUCCEEDED
        arm.peer.close()
        assert arm.node.end() == 0
    finally:
        board.close()


@pytest.mark.slow
def test_the_arm_does_not_wait_for_a_router_that_hangs(routed: tuple[World, Program]) -> None:
    world, router = routed
    board = PtyBoard(world.folder / "arm")
    try:
        arm = Arm(world, world.node("-p", f"port:={board.port}", *SETTINGS), board)
        _moving(arm)
        arm.peer.close()
        router.process.send_signal(signal.SIGSTOP)
        try:
            board.faults("silent:0")
            until(lambda: board.board.state.stopped, "the arm is stopped", arm.node.report)
            assert not near(TARGET, still(lambda: board.positions), 0.1)
            assert arm.node.end() == 0
        finally:
            router.process.send_signal(signal.SIGCONT)
    finally:
        board.close()


# -- the start fails --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_second_node_of_the_same_name_does_not_start(own_arm: Arm) -> None:
    other = PtyBoard(own_arm.world.folder / "other")
    try:
        second = own_arm.world.start(
            *NODE, "--ros-args", "-r", f"__ns:={own_arm.at.rstrip('/')}", "-p", f"port:={other.port}"
        )
        assert second.wait() == 1, second.report()
        *others, line = second.err.splitlines()
        assert not any(each.startswith(("error: ", "Traceback")) for each in others)
        assert line.startswith("error: ")
        assert f"{own_arm.at}hardware_interface" in line
        assert "__ns:=" in line
        assert other.board.state.watchdog_timeout == 0.0, "its arm was not touched"
        assert own_arm.trigger("stop")
    finally:
        other.close()
