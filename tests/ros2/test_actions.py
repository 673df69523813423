"""Goals of FollowJointTrajectory by ROS 2's rules: an action server on a made-up node, and an emulated arm."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import pytest
from tests.control.arm_bench import SPLIT, Bench
from tests.motion.arms import HOME, NAMES
from tests.waits import eventually, until
from zenoh_ros2_tests.fake_node import Call, FakeNode

from hexwire.control.motion.goal_fields import ErrorCode
from hexwire.control.requests.client_goals import ClientGoal
from hexwire.ros2.actions import FOLLOW_JOINT_TRAJECTORY, ActionGoals
from zenoh_ros2.action_server import ActionServer
from zenoh_ros2.goals import CancelCode, GoalStatus

J1 = HOME["J1"]


class World:
    """Actions for every controller of an emulated arm that has torque."""

    def __init__(self, **settings: Any) -> None:
        self.node = FakeNode()
        self.types = self.node.types
        self.bench = Bench(**({"check_table": False} | (settings or {"allow_partial_joints_goal": True})))
        for controller in self.bench.arm.controllers.values():
            controller.settings = replace(controller.settings, end_at_rest=True)
        self.bench.ask(lambda: self.bench.arm.enable(True))
        self.goals = ActionGoals(self.bench.arm, self.types.action(FOLLOW_JOINT_TRAJECTORY).result)
        self.servers = {
            name: ActionServer(
                self.node,  # type: ignore[arg-type]  # as much of it as needed
                self.types,
                f"{name}/follow_joint_trajectory" if name else "follow_joint_trajectory",
                FOLLOW_JOINT_TRAJECTORY,
                on_goal=partial(self.goals.on_goal, name),
                on_cancel=partial(self.goals.on_cancel, name),
            )
            for name in self.bench.arm.controllers
        }
        self._next = 0

    def send(self, where: dict[str, float], seconds: float = 1.0, *, controller: str = "", **goal: Any) -> Sent:
        self._next += 1
        make = self.types.message
        duration = make("builtin_interfaces/msg/Duration")(sec=int(seconds), nanosec=round(seconds % 1 * 1e9))
        point = make("trajectory_msgs/msg/JointTrajectoryPoint")(
            positions=list(where.values()), velocities=goal.pop("velocities", []), time_from_start=duration
        )
        trajectory = make("trajectory_msgs/msg/JointTrajectory")(
            joint_names=list(where), points=goal.pop("points", [point])
        )
        return Sent(self, controller, self._next, trajectory, goal)


class Sent:
    """A goal that was sent, and a request for its result."""

    def __init__(self, world: World, controller: str, number: int, trajectory: Any, goal: dict[str, Any]) -> None:
        self.world = world
        self.base = f"{world.servers[controller].name}/_action"
        self.id = world.types.message("unique_identifier_msgs/msg/UUID")(uuid=bytes([number] * 16))
        content = world.types.action(FOLLOW_JOINT_TRAJECTORY).goal(trajectory=trajectory, **goal)
        self.call = world.node.call(f"{self.base}/send_goal", goal_id=self.id, goal=content)
        self.wait = self.get_result()

    def get_result(self) -> Call:
        return self.world.node.call(f"{self.base}/get_result", goal_id=self.id)

    def cancel(self) -> int:
        info = self.world.types.message("action_msgs/msg/GoalInfo")(goal_id=self.id)
        return int(self.world.node.ask(f"{self.base}/cancel_goal", goal_info=info).return_code)

    def accepted(self) -> bool:
        eventually(lambda: self.call.response is not None)
        return bool(self.call.response.accepted)

    def over(self) -> bool:
        return self.wait.response is not None

    @property
    def end(self) -> tuple[GoalStatus, ErrorCode, str]:
        eventually(self.over)
        response = self.wait.response
        return GoalStatus(response.status), ErrorCode(response.result.error_code), response.result.error_string

    def said(self, *states: int) -> None:
        """Wait until the status topic has said these of it, in this order; it does so after the result."""
        until(lambda: self.states == list(states), f"the states are {states}", lambda: str(self.states))

    @property
    def states(self) -> list[int]:
        """What the status topic has said of it until now."""
        sent = self.world.node.publishers[f"{self.base}/status"].sent
        said = [row.status for m in sent for row in m.status_list if row.goal_info.goal_id.uuid == self.id.uuid]
        return [state for i, state in enumerate(said) if i == 0 or said[i - 1] != state]


@pytest.fixture
def world() -> Iterator[World]:
    made = World()
    made.goals.start()
    yield made
    made.goals.close()


def refusals(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [r.getMessage() for r in caplog.records if r.levelno >= logging.WARNING and "goal" in r.getMessage()]


def test_a_goal_is_accepted_executed_and_reached(world: World) -> None:
    sent = world.send({"J1": J1 + 0.2})
    assert sent.accepted()
    goal = world.bench.controller.listener
    assert isinstance(goal, ClientGoal)
    assert goal.client.handle.id == sent.id.uuid
    world.bench.until(sent.over)
    assert sent.end == (GoalStatus.SUCCEEDED, ErrorCode.SUCCESSFUL, "")
    sent.said(2, 4)
    assert world.bench.arm.owner.newest()["J1"].position == pytest.approx(J1 + 0.2, abs=0.05)


def test_a_new_goal_preempts_the_old_one(world: World) -> None:
    first = world.send({"J1": J1 + 0.5}, 5.0)
    assert first.accepted()
    second = world.send({"J1": J1 - 0.1})
    assert second.accepted()
    assert first.end == (GoalStatus.CANCELED, ErrorCode.INVALID_GOAL, "replaced by a new goal")
    first.said(2, 3, 5)
    world.bench.until(second.over)
    assert second.end[0] is GoalStatus.SUCCEEDED


@pytest.mark.slow
def test_a_refused_goal_leaves_the_old_one_alone(world: World) -> None:
    first = world.send({"J1": J1 + 0.3}, 3.0)
    assert first.accepted()
    assert not world.send({"elbow": 0.0}).accepted()
    world.bench.until(first.over)
    assert first.end[0] is GoalStatus.SUCCEEDED


def test_a_cancelled_goal_holds_and_is_told_so(world: World) -> None:
    sent = world.send({"J1": J1 + 0.5}, 5.0)
    assert sent.accepted()
    world.bench.turn(1.0)
    assert sent.cancel() == CancelCode.NONE
    assert sent.end == (GoalStatus.CANCELED, ErrorCode.SUCCESSFUL, "cancelled")
    sent.said(2, 3, 5)
    assert sent.cancel() == CancelCode.GOAL_TERMINATED
    world.bench.turn(1.0)
    stood = world.bench.arm.owner.newest()["J1"].position
    world.bench.turn(2.0)
    assert world.bench.arm.owner.newest()["J1"].position == pytest.approx(stood, abs=1e-3)
    assert J1 < stood < J1 + 0.4


def test_a_goal_that_is_cancelled_before_it_begins_never_does() -> None:
    world = World()
    sent = world.send({"J1": J1 + 0.5})
    assert sent.cancel() == CancelCode.NONE
    world.goals.start()
    assert sent.accepted()
    assert sent.end == (GoalStatus.CANCELED, ErrorCode.SUCCESSFUL, "cancelled")
    assert not world.bench.controller.busy
    world.goals.close()


def test_a_goal_goes_on_when_nobody_asks_for_it_any_more(world: World) -> None:
    sent = world.send({"J1": J1 + 0.2}, 2.0)
    assert sent.accepted()
    # The client is gone: its requests are dropped, and nothing comes from it.
    sent.wait = None  # type: ignore[assignment]
    world.bench.until(lambda: not world.bench.controller.busy)
    late = sent.get_result()
    eventually(lambda: late.response is not None)
    assert late.response.status == GoalStatus.SUCCEEDED
    assert world.bench.arm.owner.newest()["J1"].position == pytest.approx(J1 + 0.2, abs=0.05)


@pytest.mark.parametrize(
    ("where", "goal", "log"),
    [
        ({"elbow": 0.0}, {}, "INVALID_JOINTS: joint_names: 'elbow' unknown"),
        ({"J1": J1}, {"points": []}, "INVALID_GOAL: the trajectory has no points"),
        ({"J1": J1 + 0.1}, {"velocities": [0.2]}, "INVALID_GOAL: points[0].velocities: J1 is 0.2; the last point"),
        ({"J1": 99.0}, {}, "INVALID_GOAL: "),
    ],
    ids=["joints", "empty", "moving end", "limits"],
)
def test_a_refusal_is_in_the_log_with_its_code(
    world: World, caplog: pytest.LogCaptureFixture, where: dict[str, float], goal: dict[str, Any], log: str
) -> None:
    sent = world.send(where, **goal)
    assert not sent.accepted()
    assert sent.end[0] is GoalStatus.UNKNOWN
    assert sent.states == []
    (line,) = refusals(caplog)
    assert line.startswith(f"goal refused: {log}")


def test_what_the_arm_cannot_have_is_refused(world: World, caplog: pytest.LogCaptureFixture) -> None:
    make = world.types.message
    points = [make("trajectory_msgs/msg/MultiDOFJointTrajectoryPoint")()]
    multi = make("trajectory_msgs/msg/MultiDOFJointTrajectory")(joint_names=["base"], points=points)
    assert not world.send({"J1": J1 + 0.1}, multi_dof_trajectory=multi).accepted()
    sideways = [make("control_msgs/msg/JointComponentTolerance")(joint_name="J1", component=1, position=0.1)]
    assert not world.send({"J1": J1 + 0.1}, component_path_tolerance=sideways).accepted()
    doubtful = [make("control_msgs/msg/JointTolerance")(name="J1", position=-0.1)]
    assert not world.send({"J1": J1 + 0.1}, path_tolerance=doubtful).accepted()
    late = world.send({"J1": J1 + 0.1})
    assert late.accepted(), "the same goal without them"
    first, second, third = refusals(caplog)
    assert third.startswith("goal refused: INVALID_GOAL: path_tolerance for the position of J1 is -0.1")
    assert first.startswith("goal refused: INVALID_GOAL: multi_dof_trajectory is for 'base'")
    assert second.startswith("goal refused: INVALID_GOAL: component_path_tolerance of 'J1' is for X_AXIS")


def test_a_trajectory_of_the_past_is_refused(world: World, caplog: pytest.LogCaptureFixture) -> None:
    make = world.types.message
    duration = make("builtin_interfaces/msg/Duration")(sec=1)
    point = make("trajectory_msgs/msg/JointTrajectoryPoint")(positions=[J1 + 0.1], time_from_start=duration)
    header = make("std_msgs/msg/Header")(stamp=make("builtin_interfaces/msg/Time")(sec=1_000))
    trajectory = make("trajectory_msgs/msg/JointTrajectory")(header=header, joint_names=["J1"], points=[point])
    sent = Sent(world, "", 99, trajectory, {})
    assert not sent.accepted()
    (line,) = refusals(caplog)
    assert line.startswith("goal refused: OLD_HEADER_TIMESTAMP: the trajectory ended")


@pytest.mark.parametrize(
    ("fields", "code"),
    [
        ({"path_tolerance": 0.02}, ErrorCode.PATH_TOLERANCE_VIOLATED),
        ({"component_path_tolerance": 0.02}, ErrorCode.PATH_TOLERANCE_VIOLATED),
        ({"goal_tolerance": 0.02}, ErrorCode.GOAL_TOLERANCE_VIOLATED),
        ({"component_goal_tolerance": 0.02}, ErrorCode.GOAL_TOLERANCE_VIOLATED),
        ({"path_tolerance": -1.0, "goal_tolerance": -1.0}, ErrorCode.SUCCESSFUL),
    ],
)
def test_the_tolerances_of_a_goal_decide_its_end(world: World, fields: dict[str, float], code: ErrorCode) -> None:
    make = world.types.message
    goal: dict[str, Any] = {"goal_time_tolerance": make("builtin_interfaces/msg/Duration")(nanosec=500_000_000)}
    for field, value in fields.items():
        if field.startswith("component"):
            row = make("control_msgs/msg/JointComponentTolerance")(joint_name="J1", component=5, position=value)
        else:
            row = make("control_msgs/msg/JointTolerance")(name="J1", position=value)
        goal[field] = [row]
    world.bench.jam("J1")
    sent = world.send({"J1": J1 + 0.1}, **goal)
    assert sent.accepted()
    world.bench.until(sent.over)
    status, got, text = sent.end
    assert got is code
    assert status is (GoalStatus.SUCCEEDED if code is ErrorCode.SUCCESSFUL else GoalStatus.ABORTED)
    assert ("J1 is" in text) == (code is not ErrorCode.SUCCESSFUL)


def test_a_stop_aborts_and_the_end_is_told_before_all_is_closed(world: World) -> None:
    sent = world.send({"J1": J1 + 0.5}, 5.0)
    assert sent.accepted()
    world.bench.arm.shutdown()
    world.goals.close()
    assert sent.end == (GoalStatus.ABORTED, ErrorCode.INVALID_GOAL, "stopped: the program ends")


@pytest.mark.slow
def test_two_controllers_have_goals_of_their_own() -> None:
    world = World(controllers=SPLIT)
    world.goals.start()
    arm = world.send({name: HOME[name] + 0.2 * (name == "J1") for name in NAMES[:6]}, 3.0, controller="arm")
    hand = world.send({"J7": HOME["J7"] + 0.1}, 3.0, controller="hand")
    assert arm.accepted()
    assert hand.accepted()
    assert arm.cancel() == CancelCode.NONE
    assert arm.end[0] is GoalStatus.CANCELED
    world.bench.until(hand.over)
    assert hand.end[0] is GoalStatus.SUCCEEDED
    world.goals.close()
