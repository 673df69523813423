"""Fixtures around one node for the tests of a module; a test that breaks more has its own.

They end with the module: a node that publishes takes a tenth of a processor from all tests after it.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.ros2.node_world import Arm, PtyBoard, World, made

_NUMBERS = itertools.count()
SETTINGS = (
    *("-p", "enable_on_start:=true"),
    *("-p", "allow_partial_joints_goal:=true"),
    # An emulator and a node of 100 states a second get behind on a busy machine, and what is late looks lost.
    *("-p", "publish_rate:=25.0"),
    # A busy machine stalls longer than the usual 1 s.
    *("-p", "watchdog:=4.0"),
    # Nor is a program that it lets wait for the usual 0.5 s one that has ended.
    *("-p", "command_timeout:=1.5"),
    *("-p", "constraints.goal_time:=3.0"),
    *("-p", "constraints.stopped_velocity_tolerance:=0.2"),
)


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    with made(tmp_path_factory.mktemp("ros2")) as world:
        yield world


@pytest.fixture(scope="module")
def shared_arm(world: World) -> Iterator[Arm]:
    board = PtyBoard(world.folder / "shared")
    try:
        node = world.node("-p", f"port:={board.port}", *SETTINGS)
        arm = Arm(world, node, board)
        yield arm
        assert node.end() == 0
        arm.peer.close()
    finally:
        board.close()


@pytest.fixture
def arm(shared_arm: Arm) -> Iterator[Arm]:
    """The arm of all tests, holding with torque, and nothing wrong with it."""
    before = len(shared_arm.node.err)
    yield shared_arm
    print("the node said:", shared_arm.node.err[before:])
    shared_arm.board.faults()
    shared_arm.trigger("stop")
    shared_arm.trigger("reset")
    shared_arm.enable()


@pytest.fixture
def own_arm(world: World, tmp_path: Path) -> Iterator[Arm]:
    """An arm and a node that a test may break."""
    # A name of its own: others forget a node that was killed only after a while.
    at = f"own{next(_NUMBERS)}"
    board = PtyBoard(world.folder / at)
    try:
        with world.apart():
            node = world.node("-r", f"__ns:=/{at}", "-p", f"port:={board.port}", *SETTINGS)
            yield Arm(world, node, board, at=f"/{at}/")
            print(world.report())
    finally:
        board.close()
