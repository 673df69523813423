"""One master, one emulated arm and one node for the tests of this folder; a test that breaks more has its own."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.of_folder import of_folder
from tests.ros1.ros_world import Arm, PtyBoard, World, made

POSES = {"home": {"J1": -0.087, "J2": 0.96, "J3": -0.044, "J4": 0.0, "J5": 0.0, "J6": 0.0}}
WATCHDOG = 10.0
"""Seconds: a busy machine stalls longer than the usual 1 s."""
COMMAND_TIMEOUT = 1.5
"""Seconds: nor is a program that a busy machine lets wait for the usual 0.5 s one that has ended."""
CONSTRAINTS = {"goal_time": 3.0, "stopped_velocity_tolerance": 0.2}


@pytest.fixture(scope="module")
def world(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> World:
    return of_folder(request, "world", lambda: made(tmp_path_factory.mktemp("ros")))


@pytest.fixture
def own_world(tmp_path: Path) -> Iterator[World]:
    """A master that a test may end."""
    folder = tmp_path / "ros"
    folder.mkdir()
    with made(folder) as world:
        try:
            yield world
        finally:
            print(world.report())


@pytest.fixture(scope="module")
def shared_arm(request: pytest.FixtureRequest, world: World) -> Arm:
    return of_folder(request, "arm", lambda: _with_arm(world))


@contextmanager
def _with_arm(world: World) -> Iterator[Arm]:
    board = PtyBoard(world.folder / "shared")
    try:
        # As the chapter's node gets its port; other tests give the device.
        conf = world.folder / "ipc_msg.conf"
        conf.write_text(f"ARM_7BOT_SERIAL_TRX CLIENT_TRX ARM_7BOT_ARDUINO_TRX IPC_SERIAL_PORT {board.port}\n")
        node = world.node(
            f"_port:={conf}",
            "_log_positions:=true",
            "_publish_rate:=100",
            f"_watchdog:={WATCHDOG}",
            f"_command_timeout:={COMMAND_TIMEOUT}",
            f"_poses:={json.dumps(POSES)}",
            f"_constraints:={json.dumps(CONSTRAINTS)}",
            "_allow_partial_joints_goal:=true",
            "_pose_speed:=1.0",
            "_hardware_id:=arm-7",
            f"_teach_directory:={world.folder / 'taught'}",
            "_enable_on_start:=true",
        )
        yield Arm(world, node, board=board)
        node.end()
    finally:
        board.close()


@pytest.fixture
def arm(shared_arm: Arm) -> Iterator[Arm]:
    """The arm of all tests, holding with torque, and nothing wrong with it, whatever the one before has left."""
    shared_arm.board.faults()
    shared_arm.client.trigger(service=shared_arm.service("stop"))
    shared_arm.trigger("reset")
    shared_arm.enable()
    before = len(shared_arm.node.err)
    yield shared_arm
    print("the node said:", shared_arm.node.err[before:])
