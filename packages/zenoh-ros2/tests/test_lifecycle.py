"""The life cycle of a node that is made up, against the tables of rcl_lifecycle written down once more."""

from __future__ import annotations

import logging
import threading
from types import SimpleNamespace

import pytest
from tests.waits import eventually
from zenoh_ros2_tests.fake_node import Call, FakeNode

from zenoh_ros2.distributions import Distribution
from zenoh_ros2.errors import UsageError
from zenoh_ros2.lifecycle import TRANSITIONS, Change, Lifecycle, State
from zenoh_ros2.qos import Qos
from zenoh_ros2.types import Types

# Id, label, start, goal, in the order of rcl_lifecycle/default_state_machine.c.
GRAPH = """
 1 configure          unconfigured    configuring
10 transition_success configuring     inactive
11 transition_failure configuring     unconfigured
12 transition_error   configuring     errorprocessing
 2 cleanup            inactive        cleaningup
20 transition_success cleaningup      unconfigured
21 transition_failure cleaningup      inactive
22 transition_error   cleaningup      errorprocessing
 3 activate           inactive        activating
30 transition_success activating      active
31 transition_failure activating      inactive
32 transition_error   activating      errorprocessing
 4 deactivate         active          deactivating
40 transition_success deactivating    inactive
41 transition_failure deactivating    active
42 transition_error   deactivating    errorprocessing
 5 shutdown           unconfigured    shuttingdown
 6 shutdown           inactive        shuttingdown
 7 shutdown           active          shuttingdown
50 transition_success shuttingdown    finalized
51 transition_failure shuttingdown    finalized
52 transition_error   shuttingdown    errorprocessing
60 transition_success errorprocessing unconfigured
61 transition_failure errorprocessing finalized
62 transition_error   errorprocessing finalized
"""
ROWS = [(int(row[0]), *row[1:]) for row in (line.split() for line in GRAPH.strip().splitlines())]


class World:
    """A life cycle, and what it was asked to do."""

    def __init__(self) -> None:
        self.node = FakeNode()
        self.asked: list[Change] = []
        self.fault: Exception | None = None
        self.go_on = threading.Event()
        self.go_on.set()
        self.lifecycle = Lifecycle(self.node, self.node.types, self._carry_out)  # type: ignore[arg-type]

    def _carry_out(self, change: Change) -> None:
        self.asked.append(change)
        assert self.go_on.wait(30.0)
        if self.fault is not None:
            raise self.fault

    def begin(self, number: int = 0, label: str = "") -> Call:
        transition = self.node.types.message("lifecycle_msgs/msg/Transition")(id=number, label=label)
        return self.node.call("/arm/change_state", transition=transition)

    def change(self, number: int = 0, label: str = "") -> bool:
        call = self.begin(number, label)
        eventually(lambda: call.response is not None)
        return bool(call.response.success)

    def state(self) -> tuple[int, str]:
        state = self.node.ask("/arm/get_state").current_state
        return state.id, state.label

    def transitions(self, service: str = "get_available_transitions") -> list[tuple[int, str, str, str]]:
        return [
            (row.transition.id, row.transition.label, row.start_state.label, row.goal_state.label)
            for row in self.node.ask(f"/arm/{service}").available_transitions
        ]

    @property
    def events(self) -> list[tuple[str, str]]:
        sent = self.node.publishers["/arm/transition_event"].sent
        return [(event.start_state.label, event.goal_state.label) for event in sent]


@pytest.fixture
def world() -> World:
    return World()


def test_names_types_and_quality_of_service_are_those_of_a_managed_node(world: World) -> None:
    assert {name: (each.type.name, each.qos) for name, each in world.node.services.items()} == {
        f"/arm/{name}": (f"lifecycle_msgs/srv/{kind}", Qos(depth=10))
        for name, kind in (
            ("change_state", "ChangeState"),
            ("get_state", "GetState"),
            ("get_available_states", "GetAvailableStates"),
            ("get_available_transitions", "GetAvailableTransitions"),
            ("get_transition_graph", "GetAvailableTransitions"),
        )
    }
    (publisher,) = world.node.publishers.values()
    assert (publisher.topic, publisher.type.name) == (
        "/arm/transition_event",
        "lifecycle_msgs/msg/TransitionEvent",
    )
    assert publisher.qos == Qos(depth=10)


@pytest.mark.parametrize("distribution", Distribution)
def test_from_lyrical_on_an_event_has_its_transition_and_time(
    distribution: Distribution, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("zenoh_ros2.lifecycle.time", SimpleNamespace(time_ns=lambda: 1_795_000_000_000_000_007))
    node = FakeNode(Types(distribution))
    Lifecycle(node, node.types, lambda _: None).mirror(State.INACTIVE)  # type: ignore[arg-type]
    sent = node.publishers["/arm/transition_event"].sent
    assert [event.goal_state.label for event in sent] == ["configuring", "inactive"]
    told = [(event.transition.id, event.transition.label) for event in sent]
    if distribution in (Distribution.LYRICAL, Distribution.ROLLING):
        assert told == [(1, "configure"), (10, "transition_success")]
        assert [(event.stamp.sec, event.stamp.nanosec) for event in sent] == [(1_795_000_000, 7)] * 2
    else:
        assert told == [(0, ""), (0, "")]
        assert [event.timestamp for event in sent] == [0, 0]


def test_whoever_asks_sees_the_present_state() -> None:
    node, present = FakeNode(), State.UNCONFIGURED
    lifecycle = Lifecycle(node, node.types, lambda _: None, lambda: present)  # type: ignore[arg-type]
    present = State.ACTIVE
    assert node.ask("/arm/get_state").current_state.label == "active"
    present = State.INACTIVE
    rows = node.ask("/arm/get_available_transitions").available_transitions
    assert [row.transition.label for row in rows] == ["cleanup", "activate", "shutdown"]
    present = State.ACTIVE
    deactivate = node.types.message("lifecycle_msgs/msg/Transition")(label="deactivate")
    call = node.call("/arm/change_state", transition=deactivate)
    eventually(lambda: call.response is not None)
    assert call.response.success
    lifecycle.mirror(State.FINALIZED)
    assert node.ask("/arm/get_state").current_state.label == "finalized", "for good"


def test_states_and_transitions_are_those_of_rcl_lifecycle(world: World) -> None:
    types = world.node.types
    constants = {**types.message("lifecycle_msgs/msg/State").constants}
    states = world.node.ask("/arm/get_available_states").available_states
    assert {state.id: state.label for state in states} == {
        number: name.rpartition("_STATE_")[2].lower() for name, number in constants.items()
    }
    assert world.transitions("get_transition_graph") == ROWS
    names = {
        name.removeprefix("TRANSITION_"): number
        for name, number in types.message("lifecycle_msgs/msg/Transition").constants.items()
    }
    assert {change.name: change.value for change in Change} == {
        change.name: names[change.name] for change in Change
    }
    assert [row.id for row in TRANSITIONS] == [number for number, *_ in ROWS]


@pytest.mark.parametrize("state", [State.UNCONFIGURED, State.INACTIVE, State.ACTIVE])
def test_the_present_state_and_its_transitions_are_told(world: World, state: State) -> None:
    world.lifecycle.mirror(state)
    assert world.state() == (state.value, state.name.lower())
    assert world.transitions() == [row for row in ROWS if row[2] == state.label]
    assert world.transitions()


@pytest.mark.parametrize(
    ("before", "after", "way"),
    [
        (State.UNCONFIGURED, State.INACTIVE, ["configuring", "inactive"]),
        (State.UNCONFIGURED, State.ACTIVE, ["configuring", "inactive", "activating", "active"]),
        (State.INACTIVE, State.ACTIVE, ["activating", "active"]),
        (State.INACTIVE, State.UNCONFIGURED, ["cleaningup", "unconfigured"]),
        (State.ACTIVE, State.INACTIVE, ["deactivating", "inactive"]),
        (State.ACTIVE, State.UNCONFIGURED, ["deactivating", "errorprocessing", "unconfigured"]),
        (State.UNCONFIGURED, State.FINALIZED, ["shuttingdown", "finalized"]),
        (State.INACTIVE, State.FINALIZED, ["shuttingdown", "finalized"]),
        (State.ACTIVE, State.FINALIZED, ["shuttingdown", "finalized"]),
        (State.ACTIVE, State.ACTIVE, []),
    ],
)
def test_a_mirrored_state_is_reached_through_its_transitions(
    world: World, before: State, after: State, way: list[str]
) -> None:
    world.lifecycle.mirror(before)
    begun = len(world.events)
    world.lifecycle.mirror(after)
    assert world.lifecycle.state is after
    assert world.events[begun:] == list(zip([before.label, *way], way, strict=False))
    assert all((start, goal) in {(row[2], row[3]) for row in ROWS} for start, goal in world.events)
    assert world.asked == [], "what happens to the arm is not asked for again"


def test_nothing_follows_the_end(world: World) -> None:
    world.lifecycle.mirror(State.FINALIZED)
    for state in State:
        world.lifecycle.mirror(state)
    assert world.lifecycle.state is State.FINALIZED
    assert world.transitions() == []
    assert not world.change(label="configure")


@pytest.mark.parametrize(("number", "label"), [(3, ""), (0, "activate"), (4, "activate")])
def test_a_request_is_carried_out_by_its_id_or_label(world: World, number: int, label: str) -> None:
    world.lifecycle.mirror(State.INACTIVE)
    world.go_on.clear()
    call = world.begin(number, label)
    eventually(lambda: world.asked)
    assert world.state()[1] == "activating"
    assert call.response is None
    world.go_on.set()
    eventually(lambda: call.response is not None)
    assert call.response.success
    assert world.asked == [Change.ACTIVATE]
    assert world.state()[1] == "active"
    assert world.events[-2:] == [("inactive", "activating"), ("activating", "active")]


@pytest.mark.parametrize("fault", [UsageError("because"), ZeroDivisionError("because")])
def test_a_refused_request_changes_nothing_and_the_log_says_why(
    world: World, caplog: pytest.LogCaptureFixture, fault: Exception
) -> None:
    world.lifecycle.mirror(State.ACTIVE)
    world.fault = fault
    assert not world.change(label="deactivate")
    assert world.state()[1] == "active"
    assert world.events[-2:] == [("active", "deactivating"), ("deactivating", "active")]
    assert caplog.records[-1].levelno >= logging.WARNING
    assert "because" in caplog.text
    assert "/arm: deactivate" in caplog.text


def test_a_refused_shutdown_does_not_begin(world: World) -> None:
    world.lifecycle.mirror(State.ACTIVE)
    world.fault = UsageError("end the node instead")
    before = world.events
    assert not world.change(label="shutdown")
    assert (world.asked, world.events, world.state()[1]) == ([Change.ACTIVE_SHUTDOWN], before, "active")
    world.fault = None
    assert world.change(7)
    assert world.state()[1] == "finalized"


@pytest.mark.parametrize(
    ("number", "label"), [(1, ""), (4, ""), (5, ""), (30, ""), (97, ""), (0, ""), (3, "deactivate"), (3, "x" * 500)]
)
def test_a_transition_that_the_state_does_not_have_is_refused(
    world: World, caplog: pytest.LogCaptureFixture, number: int, label: str
) -> None:
    world.lifecycle.mirror(State.INACTIVE)
    before = world.events
    assert not world.change(number, label)
    assert (world.asked, world.events) == ([], before)
    assert "from the state inactive" in caplog.text
    assert len(caplog.records[-1].getMessage()) < 200


def test_nothing_begins_while_a_request_is_carried_out(world: World) -> None:
    world.lifecycle.mirror(State.INACTIVE)
    world.go_on.clear()
    call = world.begin(label="activate")
    eventually(lambda: world.asked)
    for label in ("activate", "cleanup", "shutdown", "transition_success"):
        assert not world.change(label=label)
    world.lifecycle.mirror(State.INACTIVE)
    world.go_on.set()
    eventually(lambda: call.response is not None)
    assert world.asked == [Change.ACTIVATE]
    assert world.state()[1] == "active", "what was mirrored meanwhile is older than the end of the request"


def test_the_end_of_the_node_is_shown_after_a_request_that_was_carried_out(world: World) -> None:
    world.lifecycle.mirror(State.INACTIVE)
    world.go_on.clear()
    call = world.begin(label="activate")
    eventually(lambda: world.asked)
    world.lifecycle.mirror(State.FINALIZED)
    world.go_on.set()
    eventually(lambda: call.response is not None)
    assert world.state()[1] == "finalized"
