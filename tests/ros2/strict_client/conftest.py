"""One router, one node and one strict participant for this folder; a test that breaks more has its own."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.of_folder import of_folder
from tests.ros2.strict_client.wire import Participant
from tests.ros2.strict_client.world import Arm, running

POSES = ("poses.home.J1:=-0.087", "poses.home.J2:=0.96", "poses.home.J3:=-0.044", "poses.home.J4:=0.0")


@contextmanager
def _running(folder: Path) -> Iterator[Arm]:
    with (
        running(folder, "enable_on_start:=true", "allow_partial_joints_goal:=true", *POSES) as (port, node),
        Participant(port) as me,
    ):
        yield Arm(me, port, node)


@pytest.fixture(scope="module")
def shared_arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Arm:
    return of_folder(request, "arm", lambda: _running(tmp_path_factory.mktemp("ros2")))


@pytest.fixture
def arm(shared_arm: Arm) -> Iterator[Arm]:
    """The arm of all tests, holding with torque, and nothing wrong with it."""
    shared_arm.rest()
    before = len(shared_arm.me.ends)
    yield shared_arm
    # Zenoh has a thread for each subscription, and for each result that is waited for.
    shared_arm.action.cancel()
    shared_arm.me.drop_later_than(before)
