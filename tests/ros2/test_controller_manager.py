"""A controller manager elsewhere drives the arm: what it may do, and what happens when it falls silent."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator

import pytest
from tests.ros2.node_fixtures import COMMAND_TIMEOUT, arm, shared_arm, world
from tests.ros2.node_world import ABORTED, JOINTS, Arm, Goal, near, still, until
from tests.ros2.topic_based_system import STATE, TopicBasedSystem

__all__ = ["arm", "shared_arm", "world"]

pytestmark = pytest.mark.system


@pytest.fixture
def manager(arm: Arm) -> Iterator[TopicBasedSystem]:
    peer = arm.world.peer("controller_manager")
    yield TopicBasedSystem(peer, JOINTS)
    peer.close()


def aside(arm: Arm, angle: float) -> dict[str, float]:
    here = arm.position()["J1"]
    return {"J1": here - math.copysign(angle, here)}


def test_a_controller_moves_the_arm_through_the_manager(arm: Arm, manager: TopicBasedSystem) -> None:
    target = aside(arm, 0.4)
    manager.activate()
    # It commands where the arm is, as a controller does, until that is accepted, even if the machine stalls.
    manager.run(0.5)
    manager.move(target, 2.0)
    manager.run(0.5)
    assert near(target, arm.board.positions)
    assert manager.written > 100


def test_before_a_controller_is_active_nothing_moves(arm: Arm, manager: TopicBasedSystem) -> None:
    before, said = arm.board.positions, len(arm.node.err)
    manager.run(1.0)
    assert manager.written > 50, "NaN is sent"
    assert near(before, arm.board.positions, 0.002)
    assert "refused" not in arm.node.err[said:]


def test_zeros_of_a_plug_in_without_an_active_controller_move_nothing(arm: Arm) -> None:
    """The plug-in's first versions send 0 for all joints as soon as it is active."""
    peer = arm.world.peer("controller_manager")
    try:
        manager = TopicBasedSystem(peer, JOINTS, unclaimed=0.0)
        before, said = arm.board.positions, len(arm.node.err)
        refused = "refused: the first set-point is away from the arm: "
        begun = time.monotonic()
        manager.run(1.5)
        until(lambda: refused in arm.node.err[said:], "it is logged", arm.node.report)
        most = time.monotonic() - begun + 2.0
        refusals = arm.node.err[said:].count(refused)
        assert refusals <= most, "a warning a second, although the arm's angles are other numbers each time"
        assert near(before, arm.board.positions, 0.002)
    finally:
        peer.close()


def test_silence_because_nothing_changes_is_no_fault(arm: Arm) -> None:
    peer = arm.world.peer("controller_manager")
    try:
        manager = TopicBasedSystem(peer, JOINTS, threshold=0.05)
        target = aside(arm, 0.3)
        manager.activate()
        manager.move(target, 1.5)

        def silent() -> bool:
            written = manager.written
            manager.run(0.3)
            return manager.written == written

        until(silent, "it has nothing to change", arm.node.report)
        stood, written = still(lambda: arm.board.positions), manager.written
        assert near(target, stood, 0.06), "as near as the threshold has it"
        manager.run(COMMAND_TIMEOUT + 0.5)
        assert manager.written - written < 5, "it is silent, as it has nothing to change"
        assert near(stood, arm.board.positions, 0.01)
        assert arm.diagnosed("board", 0, "ok")
        manager.move(aside(arm, 0.3), 1.5)
        until(lambda: not near(stood, arm.board.positions, 0.2), "it moves on", arm.node.report)
    finally:
        peer.close()


def _lost(arm: Arm) -> int:
    """How often set-points did not come any more."""
    values = {pair.key: pair.value for pair in arm.diagnosed("board", 0).values}
    return int(values["set points lost"])


def test_a_manager_that_dies_in_the_middle_leaves_an_arm_that_holds(arm: Arm, manager: TopicBasedSystem) -> None:
    target, lost = aside(arm, 0.8), _lost(arm)
    manager.activate()
    manager.move({"J1": (manager.commands["J1"] + target["J1"]) / 2}, 2.0)
    # From here on it is silent; the last command was on the way.
    until(lambda: _lost(arm) > lost, "its silence is noticed", arm.node.report)
    stood = still(lambda: arm.board.positions)
    assert not near(target, stood, 0.2)
    assert all(servo.torque_on for servo in arm.board.board.wire.servos)
    # Its trajectory went on meanwhile: the arm does not dash after it.
    said = len(arm.node.err)
    manager.commands.update(target)
    manager.run(0.8)
    text = "refused: the first set-point is away from the arm: J1 by "
    until(lambda: text in arm.node.err[said:], "it is logged", arm.node.report)
    assert near(stood, arm.board.positions, 0.01)
    # A controller that begins again does so where the arm is.
    manager.activate()
    manager.move(target, 2.0)
    until(lambda: near(target, arm.board.positions), "it is there", arm.node.report)


def test_a_stop_voids_the_stream_also_after_the_reset(arm: Arm, manager: TopicBasedSystem) -> None:
    target = aside(arm, 0.8)
    manager.activate()
    manager.move({"J1": (manager.commands["J1"] + target["J1"]) / 2}, 1.0)
    arm.trigger("stop")
    stood = still(lambda: arm.board.positions)
    manager.commands.update(target)
    manager.run(0.3)
    arm.trigger("reset")
    manager.run(0.8)
    assert near(stood, arm.board.positions, 0.01)


def test_the_newest_command_wins_over_a_goal(arm: Arm, manager: TopicBasedSystem) -> None:
    goal = Goal(arm, (6.0, aside(arm, 0.6)))
    assert goal.accepted
    results: list[tuple[int, int, str]] = []
    waiting = threading.Thread(target=lambda: results.append(goal.result()))
    waiting.start()
    while not results:
        # The arm moves on: if the manager is slow, its first command is away from the arm, and refused.
        manager.activate()
        manager.run(0.1)
    waiting.join()
    ((status, code, text),) = results
    assert (status, code) == (ABORTED, -1)
    assert "replaced by set-points" in text


@pytest.mark.parametrize(
    ("names", "positions", "text"),
    [
        (("J1", "elbow"), (0.0, 0.0), "no joint 'elbow'"),
        (("J1", "J2"), (0.0,), "position has 1 values for 2 names"),
        (("J1", "J2"), (0.0, math.inf), "the position of J2 is inf"),
        (("J1", "J1"), (0.0, 0.0), "named twice"),
    ],
)
def test_wrong_commands_are_logged_and_move_nothing(
    arm: Arm, names: tuple[str, ...], positions: tuple[float, ...], text: str
) -> None:
    before, said = arm.board.positions, len(arm.node.err)
    arm.peer.publish("/robot_joint_commands", STATE, name=names, position=positions)
    until(lambda: "robot_joint_commands refused: " in arm.node.err[said:], "it is logged", arm.node.report)
    assert text in arm.node.err[said:]
    assert near(before, arm.board.positions, 0.002)


def test_without_torque_or_in_teach_mode_nothing_is_followed(arm: Arm, manager: TopicBasedSystem) -> None:
    manager.activate()
    arm.enable(False)
    said = len(arm.node.err)
    manager.commands["J1"] += 0.05
    manager.run(0.2)
    until(lambda: "refused: no torque on J1" in arm.node.err[said:], "it is logged", arm.node.report)
    arm.trigger("teach/start")
    manager.run(0.2)
    until(lambda: "refused: the arm is in teach mode" in arm.node.err[said:], "it is logged", arm.node.report)
    arm.refused("teach/stop")


def test_a_part_of_the_joints_may_be_commanded(arm: Arm) -> None:
    peer = arm.world.peer("controller_manager")
    try:
        manager = TopicBasedSystem(peer, ("J1",))
        target = aside(arm, 0.2)
        manager.activate()
        manager.commands = {"J1": manager.commands["J1"]}
        manager.move(target, 1.0)
        manager.run(0.4)
        assert near(target, arm.board.positions)
    finally:
        peer.close()
