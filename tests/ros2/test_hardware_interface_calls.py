"""Services of the node that wait for the arm: in threads of their own, never in the way of a stop."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from tests.motion.arms import state
from tests.waits import eventually

from hexwire.errors import UsageError
from hexwire.model.state import JointState
from hexwire.ros2.hardware_interface import NAME, HardwareInterface
from hexwire.ros2.settings import load_settings
from zenoh_ros2.node import Deferred, NodeOptions


class Resting:
    """The owner of an arm that does not move."""

    now = staticmethod(time.monotonic)

    @property
    def state(self) -> JointState:
        return state(stamp=self.now())


class SlowArm:
    """Its calls wait until they are let go."""

    def __init__(self) -> None:
        self.owner: Any = Resting()
        self.go, self.stopping, self.line = threading.Event(), threading.Event(), threading.Event()
        self.line.set()
        self.stops = 0
        self.asked: list[int] = []

    def mark(self) -> int:
        return self.stops

    def reset(self, asked: int) -> str:
        self.go.wait(30.0)
        self.asked.append(asked)
        return "reset"

    def enable(self, on: bool, asked: int) -> str:
        return self.reset(asked)

    def fail(self, asked: int) -> str:
        raise UsageError("it cannot")

    def break_down(self, asked: int) -> str:
        raise ZeroDivisionError("by the test")

    def stop(self, why: str) -> str:
        self.stops += 1
        self.stopping.set()
        self.line.wait(30.0)
        return "stopped"


@pytest.fixture
def arm() -> Iterator[SlowArm]:
    arm = SlowArm()
    yield arm
    arm.go.set()


@pytest.fixture
def node(arm: SlowArm) -> Iterator[HardwareInterface]:
    settings, robot = load_settings({"port": "/dev/null"}, {})
    node = HardwareInterface(NodeOptions(NAME), settings, robot)
    node._arm = arm  # type: ignore[assignment]  # it has what services need
    yield node
    node._trajectories.close(5.0)
    node._stops.close(5.0)


def answered(answer: Any) -> Any:
    """The response, once it is there."""
    if not isinstance(answer, Deferred):
        return answer
    found: list[Any] = []
    answer.bind(found.append)
    eventually(lambda: found)
    return found[0]


def test_a_service_is_asked_for_when_its_request_is_taken_not_when_it_is_carried_out(
    node: HardwareInterface, arm: SlowArm
) -> None:
    answer = node._on_trigger(arm.reset, None)
    switched = node._on_enable(SimpleNamespace(data=True))
    assert answered(node._on_stop(None)).message == "stopped; at rest"
    arm.go.set()
    assert answered(answer).success
    assert answered(switched).success
    assert arm.asked == [0, 0]
    assert arm.mark() == 1


def test_a_stop_is_carried_out_however_many_services_are_at_work(node: HardwareInterface, arm: SlowArm) -> None:
    waiting = [node._on_trigger(arm.reset, None) for _ in range(16)]
    refused = answered(node._on_trigger(arm.reset, None))
    assert not refused.success
    assert "busy" in refused.message
    assert answered(node._on_stop(None)).success
    arm.go.set()
    assert all(answered(answer).success for answer in waiting)
    assert answered(node._on_trigger(arm.reset, None)).success


def test_a_burst_of_stops_is_two_stops(node: HardwareInterface, arm: SlowArm) -> None:
    arm.line.clear()
    answers = [node._on_stop(None)]
    assert arm.stopping.wait(30.0)
    before = threading.active_count()
    answers += [node._on_stop(None) for _ in range(2356)]
    assert threading.active_count() < before + 16
    arm.line.set()
    found = [answered(answer) for answer in answers]
    assert arm.stops == 2
    assert found[0].success
    assert {each.message for each in found if not each.success} == {
        "so many stop the arm that this is not answered; it is being stopped"
    }


def test_a_service_that_fails_says_why(
    node: HardwareInterface, arm: SlowArm, caplog: pytest.LogCaptureFixture
) -> None:
    for call, text in (
        (arm.fail, "it cannot"),
        (arm.break_down, "the node failed: ZeroDivisionError('by the test')"),
    ):
        answer = answered(node._on_trigger(call, None))
        assert (answer.success, answer.message) == (False, text)
    assert "it cannot" in caplog.text


def test_trajectories_that_wait_are_bounded(
    node: HardwareInterface, arm: SlowArm, caplog: pytest.LogCaptureFixture
) -> None:
    arm.owner = SimpleNamespace(now=lambda: 5.0)
    marks = []

    def command(name: str, goal: Any, *, received: float, asked: int) -> None:
        marks.append((received, asked))
        arm.go.wait(30.0)

    arm.command = command  # type: ignore[attr-defined]  # of the real one
    message = node._types.message("trajectory_msgs/msg/JointTrajectory")()
    for _ in range(12):
        node._on_trajectory("", message, 0)
    assert "joint_trajectory refused: too many trajectories wait" in caplog.text
    arm.stops += 1
    arm.go.set()
    eventually(lambda: len(marks) >= 10)
    assert set(marks) == {(5.0, 0)}
