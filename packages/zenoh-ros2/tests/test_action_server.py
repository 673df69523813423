"""An action server on a node that is made up: names, quality of service, messages, and their order."""

from __future__ import annotations

import logging
from typing import Any

import pytest
from zenoh_ros2_tests.fake_node import Call, FakeNode

from zenoh_ros2.action_server import ActionServer, GoalHandle, default_result_timeout
from zenoh_ros2.distributions import Distribution
from zenoh_ros2.goals import CancelCode, GoalStatus
from zenoh_ros2.names import parse_remap
from zenoh_ros2.node import Deferred, NodeOptions
from zenoh_ros2.qos import Durability, Qos, Reliability
from zenoh_ros2.types import Types

ACTION = "control_msgs/action/FollowJointTrajectory"
BASE = "/lab/arm_controller/follow_joint_trajectory/_action"
PARTS = ("send_goal", "cancel_goal", "get_result")
NOW = 1_700_000_000_000_000_007


class World:
    """A server, its clock, and what it was asked."""

    def __init__(
        self, distribution: Distribution = Distribution.JAZZY, rules: tuple[str, ...] = (), **options: Any
    ) -> None:
        self.types = Types(distribution)
        self.node = FakeNode(self.types, options=NodeOptions("arm", "/lab", remaps=tuple(map(parse_remap, rules))))
        self.now, self.stamp = 50.0, NOW
        self.handles: list[GoalHandle] = []
        self.cancelled: list[GoalHandle] = []
        self.server = ActionServer(
            self.node,  # type: ignore[arg-type]  # as much of it as needed
            self.types,
            "arm_controller/follow_joint_trajectory",
            ACTION,
            on_goal=self.handles.append,
            on_cancel=lambda handle: self.cancelled.append(handle),
            clock=lambda: self.now,
            ros_time=lambda: self.stamp,
            **options,
        )

    def uuid(self, number: int) -> Any:
        return self.types.message("unique_identifier_msgs/msg/UUID")(uuid=bytes([number] * 16))

    def send(self, number: int) -> Call:
        return self.node.call(f"{BASE}/send_goal", goal_id=self.uuid(number))

    def accept(self, number: int) -> GoalHandle:
        call = self.send(number)
        self.handles[-1].accept()
        assert call.response.accepted
        return self.handles[-1]

    def get_result(self, number: int) -> Call:
        return self.node.call(f"{BASE}/get_result", goal_id=self.uuid(number))

    def cancel(self, number: int = 0, stamp: int = 0) -> tuple[int, list[int]]:
        info = self.types.message("action_msgs/msg/GoalInfo")
        time = self.types.message("builtin_interfaces/msg/Time")(sec=stamp // 10**9, nanosec=stamp % 10**9)
        response = self.node.ask(f"{BASE}/cancel_goal", goal_info=info(goal_id=self.uuid(number), stamp=time))
        return response.return_code, [row.goal_id.uuid[0] for row in response.goals_canceling]

    def result(self, code: int = 0, text: str = "") -> Any:
        return self.server.type.result(error_code=code, error_string=text)

    def feedback(self, *names: str) -> Any:
        return self.server.type.feedback_content(joint_names=list(names))

    @property
    def statuses(self) -> list[list[tuple[int, int]]]:
        sent = self.node.publishers[f"{BASE}/status"].sent
        return [[(row.goal_info.goal_id.uuid[0], row.status) for row in m.status_list] for m in sent]


@pytest.fixture
def world() -> World:
    return World()


def test_a_rule_for_the_action_moves_all_that_belongs_to_it() -> None:
    world = World(rules=("arm_controller/follow_joint_trajectory:=/left/follow",))
    assert world.server.name == "/left/follow"
    assert set(world.node.services) == {f"/left/follow/_action/{each}" for each in PARTS}
    assert set(world.node.publishers) == {"/left/follow/_action/feedback", "/left/follow/_action/status"}


def test_a_rule_may_move_one_of_them() -> None:
    world = World(rules=("arm_controller/follow_joint_trajectory/_action/status:=status",))
    assert set(world.node.publishers) == {f"{BASE}/feedback", "/lab/status"}
    assert set(world.node.services) == {f"{BASE}/{each}" for each in PARTS}


def test_names_types_and_quality_of_service_are_those_of_ros(world: World) -> None:
    services = {name: (each.type.name, each.qos) for name, each in world.node.services.items()}
    usual = Qos(depth=10)
    assert services == {
        f"{BASE}/send_goal": (f"{ACTION}_SendGoal", usual),
        f"{BASE}/cancel_goal": ("action_msgs/srv/CancelGoal", usual),
        f"{BASE}/get_result": (f"{ACTION}_GetResult", usual),
    }
    topics = {name: (each.type.name, each.qos) for name, each in world.node.publishers.items()}
    latched = Qos(reliability=Reliability.RELIABLE, durability=Durability.TRANSIENT_LOCAL, depth=1)
    assert topics == {
        f"{BASE}/feedback": (f"{ACTION}_FeedbackMessage", usual),
        f"{BASE}/status": ("action_msgs/msg/GoalStatusArray", latched),
    }
    assert world.server.name == "/lab/arm_controller/follow_joint_trajectory"
    assert world.statuses == [], "a server that never had a goal says nothing"


def test_a_goal_is_answered_when_it_is_accepted_and_then_seen_by_all(world: World) -> None:
    call = world.send(1)
    assert call.response is None
    assert world.statuses == []
    world.handles[0].accept()
    assert (call.response.accepted, call.response.stamp.sec, call.response.stamp.nanosec) == (
        True,
        1_700_000_000,
        7,
    )
    assert world.statuses == [[(1, 2)]]
    info = world.node.publishers[f"{BASE}/status"].sent[0].status_list[0].goal_info
    assert (info.stamp.sec, info.stamp.nanosec) == (1_700_000_000, 7)
    assert [name for name, _ in world.node.said] == [f"{BASE}/send_goal", f"{BASE}/status"]


def test_a_refused_goal_is_seen_by_nobody(world: World) -> None:
    call, waits = world.send(1), world.get_result(1)
    world.handles[0].refuse()
    assert not call.response.accepted
    assert waits.response.status == GoalStatus.UNKNOWN
    assert world.get_result(1).response.status == GoalStatus.UNKNOWN
    assert world.cancel(1) == (CancelCode.UNKNOWN_GOAL_ID, [])
    assert world.statuses == []


def test_a_second_goal_of_the_same_id_is_refused_and_the_first_one_goes_on(
    world: World, caplog: pytest.LogCaptureFixture
) -> None:
    first = world.accept(1)
    assert not world.send(1).response.accepted
    assert world.handles == [first]
    assert "goal refused: the goal id 0101" in caplog.text
    assert caplog.records[-1].levelno == logging.WARNING
    waits = world.get_result(1)
    first.succeed(world.result())
    assert waits.response.status == GoalStatus.SUCCEEDED


@pytest.mark.parametrize(
    ("end", "status"),
    [("succeed", GoalStatus.SUCCEEDED), ("abort", GoalStatus.ABORTED), ("canceled", GoalStatus.CANCELED)],
)
def test_all_who_ask_get_the_result_first_and_the_state_follows(world: World, end: str, status: GoalStatus) -> None:
    handle = world.accept(1)
    waits = [world.get_result(1), world.get_result(1)]
    assert world.cancel(1) == (CancelCode.NONE, [1])
    del world.node.said[:]
    getattr(handle, end)(world.result(-5, "too far"))
    late = world.get_result(1)
    for call in (*waits, late):
        assert call.response.status == status
        assert (call.response.result.error_code, call.response.result.error_string) == (-5, "too far")
    names = [name.removeprefix(f"{BASE}/") for name, _ in world.node.said]
    assert names == ["get_result", "get_result", "status", "get_result"]
    assert world.statuses[-1] == [(1, status)]


def test_a_client_that_cannot_be_answered_hinders_nobody(world: World, caplog: pytest.LogCaptureFixture) -> None:
    handle = world.accept(1)
    lost, waits = Deferred(), world.get_result(1)
    lost.bind(lambda _: 1 / 0)
    world.server._goals._goals[handle.id].waiting.insert(0, lost)
    with caplog.at_level(logging.CRITICAL, logger="zenoh_ros2"):
        handle.succeed(world.result())
    assert waits.response.status == GoalStatus.SUCCEEDED
    assert world.statuses[-1] == [(1, GoalStatus.SUCCEEDED)]


def test_each_client_gets_the_result_of_its_own_goal(world: World) -> None:
    handles = {number: world.accept(number) for number in range(1, 30)}
    calls = {number: [world.get_result(number) for _ in range(3)] for number in handles}
    for number in (*range(15, 30), *range(1, 15)):
        handles[number].abort(world.result(-number, str(number)))
    for number, several in calls.items():
        assert [(each.response.result.error_code, each.response.status) for each in several] == [(-number, 6)] * 3


def test_cancel_is_shown_then_passed_on_and_then_answered(world: World) -> None:
    handle = world.accept(1)
    del world.node.said[:]
    assert world.cancel(1) == (CancelCode.NONE, [1])
    assert world.cancelled == [handle]
    assert [name.removeprefix(f"{BASE}/") for name, _ in world.node.said] == ["status", "cancel_goal"]
    assert world.statuses[-1] == [(1, 3)]
    assert handle.status is GoalStatus.CANCELING
    assert world.cancel(1) == (CancelCode.GOAL_TERMINATED, [])
    assert world.cancel(2) == (CancelCode.UNKNOWN_GOAL_ID, [])
    assert world.cancelled == [handle]


def test_cancel_of_all_and_until_a_time(world: World) -> None:
    for number in (1, 2, 3):
        world.stamp = NOW + number
        world.accept(number)
    assert world.cancel(stamp=NOW + 2) == (CancelCode.NONE, [1, 2])
    assert world.cancel() == (CancelCode.NONE, [3])
    assert [handle.id[0] for handle in world.cancelled] == [1, 2, 3]


def test_a_cancel_that_fails_for_one_goal_reaches_the_others(
    world: World, caplog: pytest.LogCaptureFixture
) -> None:
    first, second = world.accept(1), world.accept(2)
    seen: list[GoalHandle] = []

    def cancel(handle: GoalHandle) -> None:
        seen.append(handle)
        raise ZeroDivisionError

    world.server._on_cancel = cancel
    with caplog.at_level(logging.CRITICAL, logger="zenoh_ros2"):
        assert world.cancel() == (CancelCode.NONE, [1, 2])
    assert seen == [first, second]


def test_a_goal_that_is_cancelled_while_it_is_checked_is_accepted_and_cancelled(world: World) -> None:
    call = world.send(1)
    assert world.cancel() == (CancelCode.NONE, [1])
    assert world.statuses == [], "nobody knows the goal yet"
    handle = world.handles[0]
    assert world.cancelled == [handle]
    handle.accept()
    handle.canceled(world.result())
    assert call.response.accepted
    assert world.statuses == [[(1, 3)], [(1, 5)]]


def test_feedback_has_the_id_of_its_goal_and_ends_with_it(world: World) -> None:
    feedback = world.node.publishers[f"{BASE}/feedback"].sent
    world.send(1)
    handle = world.handles[0]
    handle.publish_feedback(world.feedback("early"))
    handle.accept()
    handle.publish_feedback(world.feedback("J1", "J2"))
    world.cancel(1)
    handle.publish_feedback(world.feedback("still moving"))
    handle.canceled(world.result())
    handle.publish_feedback(world.feedback("late"))
    assert [(m.goal_id.uuid, m.feedback.joint_names) for m in feedback] == [
        (bytes([1] * 16), ["J1", "J2"]),
        (bytes([1] * 16), ["still moving"]),
    ]


def test_a_result_is_kept_as_long_as_rcl_keeps_it() -> None:
    assert default_result_timeout(Distribution.HUMBLE) == 900.0
    assert {default_result_timeout(each) for each in Distribution if each is not Distribution.HUMBLE} == {10.0}
    for distribution, keep in ((Distribution.HUMBLE, 900.0), (Distribution.ROLLING, 10.0)):
        world = World(distribution)
        world.accept(1).succeed(world.result())
        world.now += keep
        assert world.get_result(1).response.status == GoalStatus.SUCCEEDED
        world.now += 0.1
        assert world.get_result(1).response.status == GoalStatus.UNKNOWN
        world.accept(2)
        assert world.statuses[-1] == [(2, 2)]


def test_a_goal_whose_place_another_one_takes_is_canceled_though_nobody_asked_for_that(world: World) -> None:
    handle, asked = world.accept(1), world.accept(2)
    handle.preempt(world.result(-1, "replaced"))
    assert [status for rows in world.statuses for number, status in rows if number == 1] == [2, 2, 3, 5]
    assert world.get_result(1).response.result.error_string == "replaced"
    world.cancel(2)
    asked.preempt(world.result())
    assert world.statuses[-1] == [(1, 5), (2, 5)]
    with pytest.raises(ValueError, match="CANCELED cannot follow CANCELED"):
        asked.preempt(world.result())


def test_nobody_ends_a_goal_twice(world: World) -> None:
    handle = world.accept(1)
    handle.succeed(world.result())
    with pytest.raises(ValueError, match="ABORTED cannot follow SUCCEEDED"):
        handle.abort(world.result())
    assert world.get_result(1).response.status == GoalStatus.SUCCEEDED


def test_close_ends_every_endpoint(world: World) -> None:
    world.server.close()
    assert not any(each.open for each in (*world.node.services.values(), *world.node.publishers.values()))
