"""One router, one node and one strict participant for the tests of a module; a test that breaks more has its own.

They end with the module: a node that publishes takes a part of a processor from all tests after it.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.ros2.strict_client.wire import Participant
from tests.ros2.strict_client.world import Arm, running

POSES = ("poses.home.J1:=-0.087", "poses.home.J2:=0.96", "poses.home.J3:=-0.044", "poses.home.J4:=0.0")


@pytest.fixture(scope="module")
def shared_arm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Arm]:
    folder = tmp_path_factory.mktemp("ros2")
    with (
        running(folder, "enable_on_start:=true", "allow_partial_joints_goal:=true", *POSES) as (port, node),
        Participant(port) as me,
    ):
        yield Arm(me, port, node)


@pytest.fixture
def arm(shared_arm: Arm) -> Iterator[Arm]:
    """The arm of all tests, holding with torque, and nothing wrong with it."""
    shared_arm.rest()
    before = len(shared_arm.me.ends)
    yield shared_arm
    # Zenoh has a thread for each subscription, and for each result that is waited for.
    shared_arm.action.cancel()
    shared_arm.me.drop_later_than(before)
