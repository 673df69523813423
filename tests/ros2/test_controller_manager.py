"""A controller manager elsewhere drives the arm: what it may do, and what happens when it falls silent.

In simulated time; `package/test_with_the_node.py` has the same over Zenoh.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator

import pytest
from tests.motion.arms import NAMES
from tests.ros2.front_bench import Front, Goal, running
from tests.ros2.topic_based_system import COMMANDS, STATES, InProcess, TopicBasedSystem

REFUSED = "robot_joint_commands refused: "


@pytest.fixture
def front() -> Iterator[Front]:
    with running(allow_partial_joints_goal=True) as front:
        front.enable()
        yield front


@pytest.fixture
def manager(front: Front) -> TopicBasedSystem:
    return TopicBasedSystem(InProcess(front), NAMES)


def aside(front: Front, angle: float) -> dict[str, float]:
    return {"J1": front.where("J1") + angle}


def refusals(caplog: pytest.LogCaptureFixture) -> list[str]:
    said = [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]
    return [text.removeprefix(REFUSED) for text in said if text.startswith(REFUSED)]


def test_a_controller_moves_the_arm_through_the_manager(
    front: Front, manager: TopicBasedSystem, caplog: pytest.LogCaptureFixture
) -> None:
    target = aside(front, 0.4)
    manager.activate()
    manager.move(target, 2.0)
    manager.run(0.5)
    assert front.near(target)
    assert manager.written > 100
    assert refusals(caplog) == []


def test_before_a_controller_is_active_nothing_moves(
    front: Front, manager: TopicBasedSystem, caplog: pytest.LogCaptureFixture
) -> None:
    before = front.positions
    manager.run(1.0)
    assert manager.written > 50, "NaN is sent"
    assert front.near(before, 0.002)
    assert refusals(caplog) == []


def test_zeros_of_a_plug_in_without_an_active_controller_move_nothing(
    front: Front, caplog: pytest.LogCaptureFixture
) -> None:
    """The plug-in's first versions send 0 for all joints as soon as it is active."""
    manager, before = TopicBasedSystem(InProcess(front), NAMES, unclaimed=0.0), front.positions
    manager.run(2.5)
    first, *others = refusals(caplog)
    assert first.startswith("the first set-point is away from the arm: ")
    assert len(others) == 2, "a warning a second, although the arm's angles are other numbers each time"
    assert front.near(before, 0.002)


def test_silence_because_nothing_changes_is_no_fault(front: Front) -> None:
    manager = TopicBasedSystem(InProcess(front), NAMES, threshold=0.05)
    target = aside(front, 0.3)
    manager.activate()
    manager.move(target, 1.5)
    manager.run(1.0)
    stood, written = front.positions, manager.written
    assert front.near(target, 0.06), "as near as the threshold has it"
    # Four times command_timeout.
    manager.run(2.0)
    assert manager.written == written, "it has nothing to change"
    assert front.near(stood, 0.002)
    assert front.diagnosed("board").level == 0
    manager.move(aside(front, 0.3), 1.5)
    assert not front.near(stood, 0.2), "it moves on"


def _lost(front: Front) -> int:
    """How often set-points did not come any more."""
    values = {pair.key: pair.value for pair in front.diagnosed("board").values}
    return int(values["set points lost"])


@pytest.mark.slow
def test_a_manager_that_dies_in_the_middle_leaves_an_arm_that_holds(
    front: Front, manager: TopicBasedSystem, caplog: pytest.LogCaptureFixture
) -> None:
    target, lost = aside(front, 0.8), _lost(front)
    manager.activate()
    manager.move({"J1": (manager.commands["J1"] + target["J1"]) / 2}, 2.0)
    # From here on it is silent; the last command was on the way.
    stood = front.still()
    assert _lost(front) == lost + 1, "its silence is noticed"
    assert not front.near(target, 0.2)
    assert all(front.torques())
    # Its trajectory went on meanwhile: the arm does not dash after it.
    manager.commands.update(target)
    manager.run(0.8)
    assert refusals(caplog)[0].startswith("the first set-point is away from the arm: J1 by ")
    assert front.near(stood, 0.002)
    # A controller that begins again does so where the arm is.
    manager.activate()
    manager.move(target, 2.0)
    manager.run(0.5)
    assert front.near(target)


def test_a_stop_voids_the_stream_also_after_the_reset(front: Front, manager: TopicBasedSystem) -> None:
    target = aside(front, 0.8)
    manager.activate()
    manager.move({"J1": (manager.commands["J1"] + target["J1"]) / 2}, 1.0)
    front.trigger("stop")
    stood = front.still(0.5)
    manager.commands.update(target)
    manager.run(0.3)
    front.trigger("reset")
    manager.run(0.8)
    assert front.near(stood, 0.002)


def test_the_newest_command_wins_over_a_goal(front: Front, manager: TopicBasedSystem) -> None:
    goal = Goal(front, (6.0, aside(front, 0.6)))
    assert goal.accepted
    front.turn(1.0)
    manager.activate()
    manager.run(0.1)
    status, code, text = goal.result()
    assert (status, code) == (5, -1)
    assert "replaced by set-points" in text


def test_wrong_commands_are_logged_and_move_nothing(front: Front, caplog: pytest.LogCaptureFixture) -> None:
    before = front.positions
    for names, positions, text in (
        (("J1", "elbow"), (0.0, 0.0), "no joint 'elbow'"),
        (("J1", "J2"), (0.0,), "position has 1 values for 2 names"),
        (("J1", "J2"), (0.0, math.inf), "the position of J2 is inf"),
        (("J1", "J1"), (0.0, 0.0), "named twice"),
    ):
        caplog.clear()
        front.send(COMMANDS, name=names, position=positions)
        (said,) = refusals(caplog)
        assert text in said
    front.turn(1.0)
    assert front.near(before, 0.002)


def test_without_torque_or_in_teach_mode_nothing_is_followed(
    front: Front, manager: TopicBasedSystem, caplog: pytest.LogCaptureFixture
) -> None:
    manager.activate()
    front.enable(False)
    manager.commands["J1"] += 0.05
    manager.run(0.05)
    assert refusals(caplog)[0].startswith("no torque on J1")
    front.trigger("teach/start")
    caplog.clear()
    manager.run(0.05)
    assert refusals(caplog)[0].startswith("the arm is in teach mode")
    front.refused("teach/stop")


@pytest.mark.slow
def test_a_part_of_the_joints_may_be_commanded(front: Front) -> None:
    manager, target = TopicBasedSystem(InProcess(front), ("J1",)), aside(front, 0.2)
    manager.activate()
    manager.commands = {"J1": manager.commands["J1"]}
    manager.move(target, 1.0)
    manager.run(0.4)
    assert front.near(target)


def test_the_distance_of_a_first_command_is_a_parameter() -> None:
    with running(joint_commands_start_tolerance=0.0, allow_partial_joints_goal=True) as front:
        front.enable()
        target = aside(front, 0.4)
        front.send(COMMANDS, name=list(target), position=list(target.values()))
        front.turn(0.2)
        assert not front.near({"J1": target["J1"] - 0.4}, 0.005), "0 means any"


def test_topics_that_are_not_wanted_are_not_there() -> None:
    with running(joint_states_topic="", joint_commands_topic="", publish_robot_description=False) as front:
        assert not {STATES, "/robot_description", "/tf", "/tf_static"} & set(front.node.publishers)
        assert COMMANDS not in front.node.subscriptions
        assert front.newest("/joint_states").name
