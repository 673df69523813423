"""Action goals with handles that are made up, and an emulated arm in simulated time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from tests.control.arm_bench import Bench
from tests.motion.arms import HOME
from tests.waits import eventually

from hexwire.control.requests.client_goals import ClientGoal
from hexwire.ros1.actions import ActionGoals


class Time(float):
    """As much of ROS's times and durations as goals take."""

    def is_zero(self) -> bool:
        return self == 0.0

    def to_sec(self) -> float:
        return float(self)


def message(where: dict[str, float], seconds: float) -> Any:
    point = SimpleNamespace(
        time_from_start=Time(seconds), positions=list(where.values()), velocities=[], accelerations=[], effort=[]
    )
    header = SimpleNamespace(stamp=Time(0.0))
    return SimpleNamespace(
        trajectory=SimpleNamespace(header=header, joint_names=list(where), points=[point]),
        path_tolerance=[],
        goal_tolerance=[],
        goal_time_tolerance=Time(0.0),
    )


class Handle:
    """A goal's handle: what was said of it, in its order."""

    def __init__(self, goal_id: str, where: dict[str, float], seconds: float = 1.0) -> None:
        self._id, self._message = goal_id, message(where, seconds)
        self.said: list[Any] = []

    def get_goal_id(self) -> Any:
        return SimpleNamespace(id=self._id)

    def get_goal(self) -> Any:
        return self._message

    def set_accepted(self) -> None:
        self.said.append("accepted")

    def __getattr__(self, name: str) -> Callable[[Any, str], None]:
        end = name.removeprefix("set_")
        return lambda result, text: self.said.append((end, result.error_code, text))

    @property
    def over(self) -> bool:
        return bool(self.said) and self.said[-1] != "accepted"


class Actions:
    """Goals of an emulated arm that has torque."""

    def __init__(self, **params: Any) -> None:
        self.bench = Bench(**({"check_table": False} | (params or {"allow_partial_joints_goal": True})))
        self.bench.ask(lambda: self.bench.arm.enable(True))
        self.goals = ActionGoals(self.bench.arm, SimpleNamespace, lambda: Time(0.0))

    def send(self, handle: Handle, controller: str = "") -> Handle:
        self.goals.on_goal(controller, handle)
        return handle


@pytest.fixture
def actions() -> Iterator[Actions]:
    made = Actions()
    yield made
    made.goals.close()


def test_a_goal_is_accepted_and_reached(actions: Actions) -> None:
    actions.goals.start()
    handle = actions.send(Handle("one", {"J1": HOME["J1"] + 0.2}))
    eventually(lambda: handle.said == ["accepted"])
    goal = actions.bench.controller.listener
    assert isinstance(goal, ClientGoal)
    eventually(lambda: goal.accepted)
    assert actions.goals.open
    actions.bench.until(lambda: handle.over)
    assert handle.said == ["accepted", ("succeeded", 0, "")]
    assert not actions.goals.open


def test_a_goal_that_is_cancelled_during_its_path_check_is_preempted(actions: Actions) -> None:
    actions.goals.start()
    handle = actions.send(Handle("one", {"J1": HOME["J1"] + 0.5}, 5.0))
    eventually(lambda: handle.said)
    actions.bench.turn(1.0)
    actions.goals.on_cancel("", Handle("one", {}))
    eventually(lambda: handle.over)
    assert handle.said == ["accepted", ("canceled", 0, "cancelled")]


def test_a_goal_that_is_recalled_never_begins(actions: Actions) -> None:
    handle = actions.send(Handle("one", {"J1": HOME["J1"] + 0.5}))
    actions.goals.on_cancel("", handle)
    actions.goals.start()
    eventually(lambda: handle.over)
    assert handle.said == [("canceled", 0, "cancelled")]
    assert not actions.bench.controller.busy
    assert not actions.goals.open


def test_a_goal_has_the_tolerances_that_its_message_asks_for(actions: Actions) -> None:
    handle = Handle("one", {"J1": HOME["J1"] + 0.2})
    sent = handle.get_goal()
    sent.goal_tolerance = [SimpleNamespace(name="elbow", position=0.1, velocity=0.0, acceleration=0.0)]
    actions.goals.start()
    actions.send(handle)
    eventually(lambda: handle.over)
    ((end, code, text),) = handle.said
    assert (end, code) == ("rejected", -2)
    assert text.startswith("goal_tolerance is for 'elbow'")


def test_a_refusal_has_its_code(actions: Actions) -> None:
    actions.goals.start()
    unknown = actions.send(Handle("one", {"elbow": 0.0}))
    eventually(lambda: unknown.over)
    ((end, code, text),) = unknown.said
    assert (end, code) == ("rejected", -2)
    assert "elbow" in text


def test_a_goal_that_another_one_replaces_is_preempted(actions: Actions) -> None:
    actions.goals.start()
    old = actions.send(Handle("old", {"J1": HOME["J1"] + 0.5}, 5.0))
    eventually(lambda: old.said)
    actions.bench.turn(1.0)
    new = actions.send(Handle("new", {"J1": HOME["J1"]}, 1.5))
    eventually(lambda: new.said)
    actions.bench.until(lambda: new.over)
    assert [said[:2] for said in old.said[1:]] == [("canceled", 0)]
    assert new.said == ["accepted", ("succeeded", 0, "")]


def test_a_goal_that_its_tolerances_end_has_their_code(actions: Actions) -> None:
    actions.goals.start()
    actions.bench.jam("J1")
    tolerance = SimpleNamespace(name="J1", position=0.02, velocity=0.0, acceleration=0.0)
    for kind, code in (("path", -4), ("goal", -5)):
        handle = Handle(kind, {"J1": HOME["J1"] + 0.1})
        sent = handle.get_goal()
        setattr(sent, f"{kind}_tolerance", [tolerance])
        sent.goal_time_tolerance = Time(0.5)
        actions.send(handle)
        eventually(lambda handle=handle: handle.said)  # type: ignore[misc]  # bound at once
        actions.bench.until(lambda handle=handle: handle.over)  # type: ignore[misc]
        assert handle.said[0] == "accepted", kind
        assert handle.said[1][:2] == ("aborted", code), kind
        assert "J1" in handle.said[1][2], kind


def test_a_stop_aborts_and_the_end_is_told_before_all_is_closed(actions: Actions) -> None:
    actions.goals.start()
    handle = actions.send(Handle("one", {"J1": HOME["J1"] + 0.5}, 5.0))
    eventually(lambda: handle.said)
    actions.bench.arm.shutdown()
    actions.goals.close()
    assert handle.said == ["accepted", ("aborted", -1, "stopped: the program ends")]


@pytest.mark.parametrize(
    ("wanted", "least"), [(HOME["J1"] + 0.2, 0.01), (math.nan, 0.09)], ids=["accepted", "rejected"]
)
def test_no_client_is_answered_before_it_can_know_its_goal(actions: Actions, wanted: float, least: float) -> None:
    said: list[float] = []

    class Timed(Handle):
        def set_accepted(self) -> None:
            said.append(time.monotonic())

        def set_rejected(self, result: Any, text: str) -> None:
            said.append(time.monotonic())

    actions.goals.start()
    sent = time.monotonic()
    actions.send(Timed("one", {"J1": wanted}))
    eventually(lambda: said)
    assert said[0] - sent >= least
