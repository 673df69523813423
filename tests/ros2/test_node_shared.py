"""The node with an arm that `hexwire serve` shares with other programs.

What that changes is decided in `control` and `fleet`: a shared arm is one more `RobotDriver`.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.ros1.ros_world import shared_board
from tests.ros2.node_fixtures import world
from tests.ros2.node_world import SUCCEEDED, Arm, Goal, World
from tests.waits import until

from hexwire.drivers import registry

__all__ = ["world"]

pytestmark = pytest.mark.system


@pytest.fixture
def shared(world: World) -> Iterator[Arm]:
    """A node, and the arm behind it, whose server is this process."""
    with shared_board(world) as board:
        node = world.node(
            *("-r", "__ns:=/shared", "-p", "port:=zenoh:lab/arm1", "-p", "publish_rate:=50.0"),
            *("-p", "allow_partial_joints_goal:=true"),
        )
        arm = Arm(world, node, board, at="/shared/")
        yield arm
        arm.peer.close()
        assert node.end() == 0


def test_a_shared_arm_is_commanded_by_who_holds_it(shared: Arm) -> None:
    shared.trigger("reset")
    shared.enable()
    here = shared.position()
    status, _, text = Goal(shared, (1.5, {"J1": here["J1"] + 0.2})).result()
    assert status == SUCCEEDED, text
    with registry.connect("zenoh:lab/arm1?take=1") as other:
        other.stop()
        until(lambda: shared.board.board.state.stopped, "another program stops it", shared.node.report)
        shared.diagnosed("board", 2, "stopped")
    assert not Goal(shared, (1.5, here)).accepted
