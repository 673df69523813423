"""Parameters, by the rules of rclcpp (parameter_service.cpp, node_parameters.cpp)."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.ros2.strict_client import parameters as p
from tests.ros2.strict_client.wire import PARAMETERS
from tests.ros2.strict_client.world import NODE, Arm

pytestmark = pytest.mark.system

EVENT = "rcl_interfaces/msg/ParameterEvent"
GOAL_TIME, STANDS = "constraints.goal_time", "constraints.stopped_velocity_tolerance"
GIVEN = {GOAL_TIME: 20.0, STANDS: 0.2}


@pytest.fixture
def arm(arm: Arm) -> Iterator[Arm]:
    """The arm with the values of its command line, and again afterwards."""
    yield arm
    assert arm.parameters.set_atomically(GIVEN).successful


# --- list ---


def test_names_are_listed_by_prefix_and_depth(arm: Arm) -> None:
    listed = arm.parameters.list()
    names = listed.names
    assert len(set(names)) == len(names)
    assert {"port", "robot", "publish_rate", "use_sim_time", GOAL_TIME} <= set(names)
    assert sorted(listed.prefixes) == sorted({name.rpartition(".")[0] for name in names if "." in name})
    below = [name for name in names if name.startswith("constraints.")]
    assert len(below) >= 2
    for prefixes, depth, wanted in (
        ([], 1, [name for name in names if "." not in name]),
        ([], 2, [name for name in names if name.count(".") <= 1]),
        (["constraints"], 0, below),
        # A depth counts from the prefix.
        (["constraints"], 1, [name for name in below if name.count(".") == 1]),
        (["publish_rate"], 0, ["publish_rate"]),
        (["publish_rate", "constraints"], 0, ["publish_rate", *below]),
        # A prefix ends at a point.
        (["constr"], 0, []),
        (["nobody"], 0, []),
    ):
        found = arm.parameters.list(prefixes, depth).names
        assert sorted(found) == sorted(wanted), f"{prefixes} to depth {depth}"


# --- get, types, describe ---


def test_values_have_their_types_and_the_order_of_the_names(arm: Arm) -> None:
    wanted = {
        "port": "sim://hex7bot",
        GOAL_TIME: 20.0,
        "robot": "hex7bot",
        "check_table": True,
        "publish_rate": 100.0,
        "use_sim_time": False,
    }
    found = arm.parameters.get_all([*wanted, "port"])
    assert found == [*wanted.values(), "sim://hex7bot"]
    assert [type(value) for value in found[:-1]] == [type(value) for value in wanted.values()]
    kinds = [p.STRING, p.DOUBLE, p.STRING, p.BOOL, p.DOUBLE, p.BOOL]
    assert arm.parameters.types(list(wanted)) == kinds
    assert arm.parameters.get_all([]) == []


def test_an_unknown_name_has_no_value_type_or_description(arm: Arm) -> None:
    """rclcpp answers no values at all, rclpy one that is not set."""
    assert arm.parameters.get_all(["nobody"]) in ([], [None])
    assert arm.parameters.get_all(["robot", "nobody"]) in ([], ["hex7bot", None])
    assert arm.parameters.types(["nobody"]) in ([], [p.NOT_SET])
    described = arm.parameters.describe(["nobody"])
    assert described == [] or (described[0].name, described[0].type) == ("nobody", p.NOT_SET)


def test_every_listed_parameter_has_a_value_and_a_description(arm: Arm) -> None:
    names = arm.parameters.list().names
    assert len(arm.parameters.get_all(names)) == len(names)
    described = arm.parameters.describe(names)
    assert [each.name for each in described] == names
    assert [each.type for each in described] == arm.parameters.types(names)
    assert all(
        each.description for each in described if each.name not in ("use_sim_time",) and "qos" not in each.name
    )
    rows = {each.name: each for each in described}
    rate = rows["publish_rate"]
    assert (rate.type, rate.dynamic_typing, rate.integer_range) == (p.DOUBLE, False, [])
    # A bound that is not in the range cannot be said as a range.
    assert rate.floating_point_range or rate.additional_constraints
    (bounds,) = rows["connect_timeout"].floating_point_range
    assert (bounds.from_value, bounds.to_value, bounds.step) == (0.0, 3600.0, 0.0)
    assert rows["port"].read_only


# --- set ---


def test_a_value_is_set_and_each_parameter_has_its_own_result(arm: Arm) -> None:
    result = arm.parameters.set(GOAL_TIME, 19.0)
    assert (result.successful, result.reason) == (True, "")
    assert arm.parameters.get(GOAL_TIME) == 19.0
    results = arm.parameters.set_all({GOAL_TIME: 18.0, "nobody": 1, STANDS: 0.3})
    assert [result.successful for result in results] == [True, False, True]
    assert arm.parameters.get_all([GOAL_TIME, STANDS]) == [18.0, 0.3]


def test_a_wrong_value_is_refused_with_a_reason(arm: Arm) -> None:
    """Those of rclcpp begin with its words; a statically typed parameter may not become NOT_SET."""
    for name, made, words in (
        ("diagnostics_rate", 0.0, ""),
        ("diagnostics_rate", 1e9, ""),
        ("diagnostics_rate", float("nan"), ""),
        ("diagnostics_rate", "fast", ""),
        ("diagnostics_rate", True, ""),
        ("diagnostics_rate", None, ""),
        ("pose_speed", 2.0, ""),
        ("publish_rate", 50.0, ""),
        ("check_table", 1, ""),
        (GOAL_TIME, -1.0, ""),
        ("nobody", 1, "parameter 'nobody' cannot be set because it was not declared"),
        ("port", "sim://so101", "parameter 'port' cannot be set because it is read-only"),
        (
            GOAL_TIME,
            5,
            f"Wrong parameter type, parameter {{{GOAL_TIME}}} is of type {{double}}, setting it to ",
        ),
        (
            "joint_commands_start_tolerance",
            8.0,
            "Parameter {joint_commands_start_tolerance} doesn't comply with floating point range.",
        ),
    ):
        before = arm.parameters.get_all([name])
        result = arm.parameters.set(name, made)
        assert not result.successful, f"{name} is {made}"
        assert result.reason, f"{name} is {made}"
        assert result.reason.startswith(words)
        assert arm.parameters.get_all([name]) == before, f"{name} is {made}"


def test_all_or_nothing(arm: Arm) -> None:
    for other in ({"diagnostics_rate": -5.0}, {"nobody": 1}):
        result = arm.parameters.set_atomically({GOAL_TIME: 17.0, **other})
        assert not result.successful, other
        assert result.reason
        assert arm.parameters.get(GOAL_TIME) == 20.0, other
    made = {GOAL_TIME: 21.0, STANDS: 0.25}
    assert arm.parameters.set_atomically(made).successful
    assert arm.parameters.get_all(list(made)) == [21.0, 0.25]


def test_setting_nothing(arm: Arm) -> None:
    """rclcpp refuses an empty list since Iron (node_parameters.cpp)."""
    assert arm.parameters.set_all({}) == []
    result = arm.parameters.set_atomically({})
    assert not result.successful
    assert result.reason


# --- events ---


def test_changes_are_events_and_refusals_are_none(arm: Arm) -> None:
    events = arm.me.subscribe("/parameter_events", EVENT, PARAMETERS)
    arm.parameters.set("diagnostics_rate", -1.0)
    arm.parameters.set(GOAL_TIME, 22.0)
    event = events.take().message
    assert (event.node, event.new_parameters, event.deleted_parameters) == (NODE, [], [])
    (changed,) = event.changed_parameters
    assert (changed.name, p.plain(changed.value)) == (GOAL_TIME, 22.0)
    assert event.stamp.sec > 1.6e9
    arm.parameters.set_atomically(GIVEN)
    assert {changed.name for changed in events.take().message.changed_parameters} == set(GIVEN), "in one event"
