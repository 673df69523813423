"""Parameters, by the rules of rclcpp (parameter_service.cpp, node_parameters.cpp)."""

from __future__ import annotations

import pytest
from tests.ros2.strict_client import parameters as p
from tests.ros2.strict_client.wire import PARAMETERS
from tests.ros2.strict_client.world import NODE, Arm

pytestmark = pytest.mark.system

EVENT = "rcl_interfaces/msg/ParameterEvent"


# --- list ---


def test_every_name_is_listed_once(arm: Arm) -> None:
    names = arm.parameters.list().names
    assert len(set(names)) == len(names)
    assert {"port", "robot", "publish_rate", "use_sim_time", "constraints.goal_time"} <= set(names)


def test_depth_one_lists_names_without_a_point(arm: Arm) -> None:
    everything = arm.parameters.list().names
    assert sorted(arm.parameters.list(depth=1).names) == sorted(name for name in everything if "." not in name)


def test_depth_two_lists_one_point(arm: Arm) -> None:
    everything = arm.parameters.list().names
    assert sorted(arm.parameters.list(depth=2).names) == sorted(name for name in everything if name.count(".") <= 1)


def test_a_prefix_lists_what_is_below_it(arm: Arm) -> None:
    everything = arm.parameters.list().names
    wanted = sorted(name for name in everything if name.startswith("constraints."))
    assert sorted(arm.parameters.list(["constraints"]).names) == wanted
    assert len(wanted) >= 2


def test_a_prefix_with_a_depth_counts_from_the_prefix(arm: Arm) -> None:
    everything = arm.parameters.list().names
    wanted = sorted(name for name in everything if name.startswith("constraints.") and name.count(".") == 1)
    assert sorted(arm.parameters.list(["constraints"], 1).names) == wanted


def test_a_prefix_may_be_a_whole_name(arm: Arm) -> None:
    assert arm.parameters.list(["publish_rate"]).names == ["publish_rate"]


def test_a_prefix_ends_at_a_point(arm: Arm) -> None:
    assert arm.parameters.list(["constr"]).names == []


def test_several_prefixes(arm: Arm) -> None:
    names = arm.parameters.list(["publish_rate", "constraints"]).names
    assert "publish_rate" in names
    assert "constraints.goal_time" in names


def test_an_unknown_prefix_lists_nothing(arm: Arm) -> None:
    listed = arm.parameters.list(["nobody"])
    assert (listed.names, listed.prefixes) == ([], [])


def test_the_prefixes_of_the_names_are_listed(arm: Arm) -> None:
    listed = arm.parameters.list()
    wanted = {name.rpartition(".")[0] for name in listed.names if "." in name}
    assert set(listed.prefixes) == wanted
    assert len(listed.prefixes) == len(wanted)


# --- get ---


def test_a_value_of_the_command_line(arm: Arm) -> None:
    assert arm.parameters.get("port") == "sim://hex7bot"
    assert arm.parameters.get("constraints.goal_time") == 20.0


@pytest.mark.parametrize(
    ("name", "made"),
    [("robot", "hex7bot"), ("check_table", True), ("publish_rate", 100.0), ("use_sim_time", False)],
)
def test_a_default(arm: Arm, name: str, made: object) -> None:
    value = arm.parameters.get(name)
    assert value == made
    assert type(value) is type(made)


def test_values_come_in_the_order_of_the_names(arm: Arm) -> None:
    assert arm.parameters.get_all(["robot", "port", "robot"]) == ["hex7bot", "sim://hex7bot", "hex7bot"]


def test_an_unknown_name_has_no_value(arm: Arm) -> None:
    """rclcpp answers no values at all, rclpy one that is not set."""
    assert arm.parameters.get_all(["nobody"]) in ([], [None])


def test_an_unknown_name_among_known_ones(arm: Arm) -> None:
    assert arm.parameters.get_all(["robot", "nobody"]) in ([], ["hex7bot", None])


def test_no_names_have_no_values(arm: Arm) -> None:
    assert arm.parameters.get_all([]) == []


def test_every_listed_parameter_has_a_value(arm: Arm) -> None:
    names = arm.parameters.list().names
    assert len(arm.parameters.get_all(names)) == len(names)


# --- types, describe ---


def test_types_are_those_of_the_values(arm: Arm) -> None:
    assert arm.parameters.types(["port", "publish_rate", "check_table"]) == [p.STRING, p.DOUBLE, p.BOOL]


def test_an_unknown_name_has_no_type(arm: Arm) -> None:
    assert arm.parameters.types(["nobody"]) in ([], [p.NOT_SET])


def test_a_description(arm: Arm) -> None:
    (described,) = arm.parameters.describe(["publish_rate"])
    assert (described.name, described.type, described.dynamic_typing) == ("publish_rate", p.DOUBLE, False)
    assert described.description
    assert described.integer_range == []
    # A bound that is not in the range cannot be said as a range.
    assert described.floating_point_range or described.additional_constraints


def test_bounds_are_a_range(arm: Arm) -> None:
    (described,) = arm.parameters.describe(["connect_timeout"])
    (bounds,) = described.floating_point_range
    assert (bounds.from_value, bounds.to_value, bounds.step) == (0.0, 3600.0, 0.0)


def test_what_cannot_be_set_is_read_only(arm: Arm) -> None:
    (described,) = arm.parameters.describe(["port"])
    assert described.read_only


def test_all_can_be_described(arm: Arm) -> None:
    names = arm.parameters.list().names
    described = arm.parameters.describe(names)
    assert [each.name for each in described] == names
    assert [each.type for each in described] == arm.parameters.types(names)
    assert all(
        each.description for each in described if each.name not in ("use_sim_time",) and "qos" not in each.name
    )


def test_an_unknown_name_has_no_description(arm: Arm) -> None:
    described = arm.parameters.describe(["nobody"])
    assert described == [] or (described[0].name, described[0].type) == ("nobody", p.NOT_SET)


# --- set ---


def test_a_value_is_set(arm: Arm) -> None:
    result = arm.parameters.set("constraints.goal_time", 19.0)
    assert (result.successful, result.reason) == (True, "")
    assert arm.parameters.get("constraints.goal_time") == 19.0
    assert arm.parameters.set("constraints.goal_time", 20.0).successful


@pytest.mark.parametrize(
    ("name", "made"),
    [
        ("diagnostics_rate", 0.0),
        ("diagnostics_rate", 1e9),
        ("diagnostics_rate", float("nan")),
        ("diagnostics_rate", "fast"),
        ("diagnostics_rate", True),
        ("pose_speed", 2.0),
        ("joint_commands_start_tolerance", 8.0),
        ("publish_rate", 50.0),
        ("constraints.goal_time", -1.0),
        ("nobody", 1),
        ("port", "sim://so101"),
        ("check_table", 1),
    ],
)
def test_a_wrong_value_is_refused_with_a_reason(arm: Arm, name: str, made: object) -> None:
    before = arm.parameters.get_all([name])
    result = arm.parameters.set(name, made)
    assert not result.successful
    assert result.reason
    assert arm.parameters.get_all([name]) == before


@pytest.mark.parametrize(
    ("name", "made", "words"),
    [
        ("nobody", 1, "parameter 'nobody' cannot be set because it was not declared"),
        ("port", "sim://so101", "parameter 'port' cannot be set because it is read-only"),
        (
            "constraints.goal_time",
            5,
            "Wrong parameter type, parameter {constraints.goal_time} is of type {double}, setting it to {integer}",
        ),
        (
            "joint_commands_start_tolerance",
            8.0,
            "Parameter {joint_commands_start_tolerance} doesn't comply with floating point range.",
        ),
    ],
)
def test_a_refusal_has_the_words_of_rclcpp(arm: Arm, name: str, made: object, words: str) -> None:
    assert arm.parameters.set(name, made).reason.startswith(words)


def test_a_parameter_cannot_be_removed(arm: Arm) -> None:
    """A statically typed parameter may not become NOT_SET."""
    assert not arm.parameters.set("diagnostics_rate", None).successful


def test_each_parameter_has_its_own_result(arm: Arm) -> None:
    results = arm.parameters.set_all(
        {"constraints.goal_time": 18.0, "nobody": 1, "constraints.stopped_velocity_tolerance": 0.3}
    )
    assert [result.successful for result in results] == [True, False, True]
    assert arm.parameters.get("constraints.goal_time") == 18.0
    arm.parameters.set_all({"constraints.goal_time": 20.0, "constraints.stopped_velocity_tolerance": 0.2})


def test_all_or_nothing(arm: Arm) -> None:
    result = arm.parameters.set_atomically({"constraints.goal_time": 17.0, "diagnostics_rate": -5.0})
    assert not result.successful
    assert result.reason
    assert arm.parameters.get("constraints.goal_time") == 20.0


def test_all_at_once(arm: Arm) -> None:
    made = {"constraints.goal_time": 21.0, "constraints.stopped_velocity_tolerance": 0.25}
    assert arm.parameters.set_atomically(made).successful
    assert arm.parameters.get_all(list(made)) == [21.0, 0.25]
    assert arm.parameters.set_atomically(
        {"constraints.goal_time": 20.0, "constraints.stopped_velocity_tolerance": 0.2}
    ).successful


def test_an_unknown_name_refuses_all(arm: Arm) -> None:
    result = arm.parameters.set_atomically({"constraints.goal_time": 17.0, "nobody": 1})
    assert not result.successful
    assert arm.parameters.get("constraints.goal_time") == 20.0


# --- events ---


def test_a_change_is_an_event(arm: Arm) -> None:
    events = arm.me.subscribe("/parameter_events", EVENT, PARAMETERS)
    arm.parameters.set("constraints.goal_time", 22.0)
    event = events.wait(lambda message: message.node == NODE).message
    assert (event.new_parameters, event.deleted_parameters) == ([], [])
    (changed,) = event.changed_parameters
    assert (changed.name, p.plain(changed.value)) == ("constraints.goal_time", 22.0)
    assert event.stamp.sec > 1.6e9
    arm.parameters.set("constraints.goal_time", 20.0)


def test_a_refused_value_is_no_event(arm: Arm) -> None:
    events = arm.me.subscribe("/parameter_events", EVENT, PARAMETERS)
    arm.parameters.set("diagnostics_rate", -1.0)
    arm.parameters.set("constraints.goal_time", 20.0)
    event = events.take().message
    assert [changed.name for changed in event.changed_parameters] == ["constraints.goal_time"]


def test_an_atomic_change_is_one_event(arm: Arm) -> None:
    events = arm.me.subscribe("/parameter_events", EVENT, PARAMETERS)
    arm.parameters.set_atomically({"constraints.goal_time": 20.0, "constraints.stopped_velocity_tolerance": 0.2})
    event = events.take().message
    assert {changed.name for changed in event.changed_parameters} == {
        "constraints.goal_time",
        "constraints.stopped_velocity_tolerance",
    }


def test_setting_nothing(arm: Arm) -> None:
    """rclcpp refuses an empty list since Iron (node_parameters.cpp)."""
    assert arm.parameters.set_all({}) == []
    result = arm.parameters.set_atomically({})
    assert not result.successful
    assert result.reason
