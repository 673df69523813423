"""The parameter server of a node that is made up, against the rules of rclcpp."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from zenoh_ros2_tests.fake_node import FakeNode

from zenoh_ros2.distributions import Distribution
from zenoh_ros2.errors import UsageError
from zenoh_ros2.parameters import Descriptor, ParameterServer, ParameterType, Value, type_of
from zenoh_ros2.qos import Qos
from zenoh_ros2.types import Types

NOW = 1_700_000_000_000_000_007
OF_ROS: dict[str, Value] = {"start_type_description_service": True}
OWN: dict[str, Value] = {
    "constraints.J1.goal": 0.1,
    "constraints.J1.trajectory": 0.2,
    "constraints.goal_time": 0.0,
    "enable_on_start": False,
    "joints": ["J1", "J2"],
    "limits": [1.5, 2.5],
    "port": "/dev/null",
    "rate": 100.0,
    "retries": 3,
}
_WRONG_TYPE = "Wrong parameter type, parameter"
ALL = OWN | OF_ROS


class World:
    """A server with parameters of every kind in use."""

    def __init__(self, distribution: Distribution = Distribution.JAZZY, *, tells_types: bool = True) -> None:
        self.node = FakeNode(Types(distribution), namespace="/lab")
        self.node.options = replace(self.node.options, type_descriptions=tells_types)
        self.asked: list[dict[str, Value]] = []
        self.fault = ""
        self.server = ParameterServer(
            self.node,  # type: ignore[arg-type]  # as much of it as needed
            self.node.types,
            on_set=self._on_set,
            ros_time=lambda: NOW,
        )
        for name, value in OWN.items():
            self.server.declare(name, value, self.descriptor(name))
        self.server.offer()

    @staticmethod
    def descriptor(name: str) -> Descriptor | None:
        return {
            "port": Descriptor("where the arm is", read_only=True),
            "rate": Descriptor("how often", "a rule", low=1.0, high=200.0),
            "retries": Descriptor(low=0.0, high=5.0),
        }.get(name)

    def _on_set(self, changes: Mapping[str, Value]) -> None:
        self.asked.append(dict(changes))
        if self.fault:
            raise UsageError(self.fault)

    def ask(self, service: str, **fields: Any) -> Any:
        return self.node.ask(f"/lab/arm/{service}", **fields)

    def row(self, name: str, value: Any, kind: int | None = None) -> Any:
        make = self.node.types.message
        kind = type_of(value) if kind is None else kind
        fields = {} if kind not in FIELDS else {FIELDS[kind]: value}
        held = make("rcl_interfaces/msg/ParameterValue")(type=kind, **fields)
        return make("rcl_interfaces/msg/Parameter")(name=name, value=held)

    def set(self, *rows: Any) -> list[tuple[bool, str]]:
        results = self.ask("set_parameters", parameters=list(rows)).results
        return [(row.successful, row.reason) for row in results]

    def set_all(self, *rows: Any) -> tuple[bool, str]:
        result = self.ask("set_parameters_atomically", parameters=list(rows)).result
        return result.successful, result.reason

    def names(self, *prefixes: str, depth: int = 0) -> list[str]:
        return list(self.ask("list_parameters", prefixes=list(prefixes), depth=depth).result.names)

    @property
    def events(self) -> list[tuple[list[str], list[tuple[str, Any]]]]:
        """Names of new parameters, and changed ones with their values."""
        found = []
        for event in self.node.publishers["/parameter_events"].sent:
            assert (event.node, event.deleted_parameters) == ("/lab/arm", [])
            assert (event.stamp.sec, event.stamp.nanosec) == (1_700_000_000, 7)
            changed = [(row.name, getattr(row.value, FIELDS[row.value.type])) for row in event.changed_parameters]
            found.append(([row.name for row in event.new_parameters], changed))
        return found


# Fields of rcl_interfaces/msg/ParameterValue, by type.
FIELDS = {
    1: "bool_value",
    2: "integer_value",
    3: "double_value",
    4: "string_value",
    5: "byte_array_value",
    6: "bool_array_value",
    7: "integer_array_value",
    8: "double_array_value",
    9: "string_array_value",
}


@pytest.fixture
def world() -> World:
    return World()


def test_names_types_and_quality_of_service_are_those_of_rclcpp(world: World) -> None:
    names = ("DescribeParameters", "GetParameters", "GetParameterTypes", "ListParameters", "SetParameters")
    expected = {kind: f"rcl_interfaces/srv/{kind}" for kind in (*names, "SetParametersAtomically")}
    services = {each.type.name: (name, each.qos) for name, each in world.node.services.items()}
    assert services == {
        full: ("/lab/arm/" + "".join(f"_{c.lower()}" if c.isupper() else c for c in kind)[1:], Qos(depth=1000))
        for kind, full in expected.items()
    }
    (events,) = world.node.publishers.values()
    assert (events.topic, events.type.name) == ("/parameter_events", "rcl_interfaces/msg/ParameterEvent")
    assert events.qos == Qos(depth=1000)
    assert world.events == [(sorted(ALL), [])], "all parameters are told once"


def test_the_numbers_of_types_are_those_of_the_message(world: World) -> None:
    constants = world.node.types.message("rcl_interfaces/msg/ParameterType").constants
    assert {f"PARAMETER_{kind.name}": kind.value for kind in ParameterType} == dict(constants)


@pytest.mark.parametrize(
    ("value", "kind"),
    [
        (True, 1),
        (1, 2),
        (1.0, 3),
        ("", 4),
        (b"\1", 5),
        ([True, False], 6),
        ((1, 2), 7),
        ([0.5], 8),
        (["a"], 9),
        ([], 9),
        ((), 9),
    ],
)
def test_the_type_of_a_value(value: Value, kind: int) -> None:
    assert type_of(value) == kind


@pytest.mark.parametrize("value", [None, {}, [1, 2.0], [True, 1], [["a"]], [b""], object()])
def test_other_values_are_no_parameters(value: Any) -> None:
    with pytest.raises(TypeError, match="is no value of a parameter"):
        type_of(value)


def test_nothing_is_declared_twice(world: World) -> None:
    with pytest.raises(ValueError, match="port is declared already"):
        world.server.declare("port", 1)


def test_values_and_types_are_told_in_the_order_asked_for(world: World) -> None:
    names = ["rate", "joints", "port", "enable_on_start", "retries", "limits", "rate"]
    values = world.ask("get_parameters", names=names).values
    assert [getattr(value, FIELDS[value.type]) for value in values] == [ALL[name] for name in names]
    assert list(world.ask("get_parameter_types", names=names).types) == [3, 9, 4, 1, 2, 8, 3]
    assert world.ask("get_parameters", names=[]).values == []


def test_one_unknown_name_spoils_the_answer_as_in_rclcpp(world: World) -> None:
    names = ["rate", "speed"]
    assert world.ask("get_parameters", names=names).values == []
    assert list(world.ask("get_parameter_types", names=names).types) == []
    assert world.ask("describe_parameters", names=names).descriptors == []


def test_descriptors(world: World) -> None:
    port, rate, retries, joints = world.ask(
        "describe_parameters", names=["port", "rate", "retries", "joints"]
    ).descriptors
    assert (port.name, port.type, port.description, port.read_only) == ("port", 4, "where the arm is", True)
    assert port.floating_point_range == port.integer_range == []
    assert (rate.type, rate.additional_constraints, rate.read_only, rate.dynamic_typing) == (
        3,
        "a rule",
        False,
        False,
    )
    assert [(row.from_value, row.to_value, row.step) for row in rate.floating_point_range] == [(1.0, 200.0, 0.0)]
    assert rate.integer_range == retries.floating_point_range == []
    assert [(row.from_value, row.to_value, row.step) for row in retries.integer_range] == [(0, 5, 1)]
    assert (joints.name, joints.type, joints.description) == ("joints", 9, "")


@pytest.mark.parametrize(
    ("prefixes", "depth", "names"),
    [
        ([], 0, sorted(ALL)),
        ([], 1, [name for name in sorted(ALL) if "." not in name]),
        ([], 2, [name for name in sorted(ALL) if name.count(".") < 2]),
        ([], 3, sorted(ALL)),
        (["constraints"], 0, ["constraints.J1.goal", "constraints.J1.trajectory", "constraints.goal_time"]),
        (["constraints"], 1, ["constraints.goal_time"]),
        (["constraints"], 2, ["constraints.J1.goal", "constraints.J1.trajectory", "constraints.goal_time"]),
        (["constraints.J1"], 1, ["constraints.J1.goal", "constraints.J1.trajectory"]),
        (["constraint"], 0, []),
        (["rate", "constraints.J1", "nothing"], 1, ["constraints.J1.goal", "constraints.J1.trajectory", "rate"]),
    ],
)
def test_lists_by_prefix_and_depth(world: World, prefixes: list[str], depth: int, names: list[str]) -> None:
    assert world.names(*prefixes, depth=depth) == names
    found = world.ask("list_parameters", prefixes=prefixes, depth=depth).result.prefixes
    assert found == list(dict.fromkeys(name.rpartition(".")[0] for name in names if "." in name))


@given(
    st.sets(st.text("ab.", min_size=1, max_size=6)),
    st.lists(st.text("ab.", max_size=4), max_size=3),
    st.integers(0, 4),
)
@example(names={"a..b"}, prefixes=["a"], depth=1)
def test_a_depth_counts_the_parts_after_the_prefix(names: set[str], prefixes: list[str], depth: int) -> None:
    """As rclcpp does; a part may be empty."""
    world = World(tells_types=False)
    for name in names:
        world.server.declare(name, 0)

    def parts(name: str, prefix: str) -> int:
        return len(name[len(prefix) + 1 :].split("."))

    wanted = {
        name
        for name in {*ALL, *names}
        if (not prefixes and (not depth or len(name.split(".")) <= depth))
        or any(
            name == prefix or (name.startswith(f"{prefix}.") and (not depth or parts(name, prefix) <= depth))
            for prefix in prefixes
        )
    }
    assert world.names(*prefixes, depth=depth) == sorted(wanted)


def test_a_value_is_set_and_told(world: World) -> None:
    assert world.set(world.row("rate", 50.0), world.row("joints", ["J1"])) == [(True, ""), (True, "")]
    assert world.asked == [{"rate": 50.0}, {"joints": ["J1"]}]
    assert world.events[1:] == [([], [("rate", 50.0)]), ([], [("joints", ["J1"])])]
    assert world.server.values()["rate"] == 50.0
    assert world.ask("get_parameters", names=["rate"]).values[0].double_value == 50.0
    assert world.server.values()["port"] == "/dev/null"


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("speed", 1.0, "parameter 'speed' cannot be set because it was not declared"),
        ("", 1.0, "parameter '' cannot be set because it was not declared"),
        ("port", "/dev/ttyUSB0", "parameter 'port' cannot be set because it is read-only"),
        (
            "rate",
            50,
            f"{_WRONG_TYPE} {{rate}} is of type {{double}}, setting it to {{integer}} is not allowed. Write 50.0",
        ),
        ("rate", "50", f"{_WRONG_TYPE} {{rate}} is of type {{double}}, setting it to {{string}} is not allowed."),
        ("rate", True, f"{_WRONG_TYPE} {{rate}} is of type {{double}}, setting it to {{bool}} is not allowed."),
        (
            "enable_on_start",
            1,
            f"{_WRONG_TYPE} {{enable_on_start}} is of type {{bool}}, setting it to {{integer}} is not allowed.",
        ),
        (
            "joints",
            [1, 2],
            f"{_WRONG_TYPE} {{joints}} is of type {{string_array}}, setting it to {{integer_array}} is not",
        ),
        ("rate", 0.5, "Parameter {rate} doesn't comply with floating point range. 0.5 must be 1 to 200"),
        ("rate", 201.0, "Parameter {rate} doesn't comply with floating point range. 201 must be 1 to 200"),
        ("rate", math.nan, "Parameter {rate} doesn't comply with floating point range. nan must be 1 to 200"),
        ("retries", 6, "Parameter {retries} doesn't comply with integer range. 6 must be 0 to 5"),
    ],
)
def test_a_wrong_value_is_refused_with_its_reason(world: World, name: str, value: Any, reason: str) -> None:
    for successful, said in (world.set(world.row(name, value))[0], world.set_all(world.row(name, value))):
        assert not successful
        assert said.startswith(reason)
    assert (world.asked, world.server.values(), len(world.events)) == ([], ALL, 1)


@pytest.mark.parametrize(
    ("kind", "reason"),
    [(0, "cannot undeclare a statically typed parameter: 'rate'"), (77, "'rate' has no type 77")],
)
def test_a_value_without_a_type_is_refused(world: World, kind: int, reason: str) -> None:
    ((successful, said),) = world.set(world.row("rate", None, kind))
    assert not successful
    assert said.startswith(reason)
    assert world.server.values() == ALL


@pytest.mark.parametrize("value", [1.0, 200.0, 1.0 - 1e-16, 200.0 + 1e-13])
def test_both_ends_of_a_range_are_allowed_and_so_is_their_rounding(world: World, value: float) -> None:
    assert world.set(world.row("rate", value)) == [(True, "")]


def test_an_empty_list_fits_every_list(world: World) -> None:
    assert world.set(world.row("limits", [], 9), world.row("joints", [], 9)) == [(True, "")] * 2
    assert world.ask("get_parameter_types", names=["limits", "joints"]).types == bytes([8, 9])
    assert not world.set(world.row("rate", [], 9))[0][0]


def test_who_declares_a_parameter_may_refuse_a_value(world: World) -> None:
    world.fault = "1 parameter is wrong: rate: the arm is slower"
    assert world.set(world.row("rate", 50.0)) == [(False, world.fault)]
    assert world.asked == [{"rate": 50.0}]
    assert (world.server.values(), len(world.events)) == (ALL, 1)


def test_one_by_one_keeps_what_is_right(world: World) -> None:
    results = world.set(world.row("rate", 50.0), world.row("rate", 500.0), world.row("retries", 1))
    assert [successful for successful, _ in results] == [True, False, True]
    assert (world.server.values()["rate"], world.server.values()["retries"]) == (50.0, 1)


def test_atomically_is_all_or_nothing(world: World) -> None:
    good, bad = world.row("retries", 1), world.row("rate", 500.0)
    assert world.set_all(good, bad) == (
        False,
        "Parameter {rate} doesn't comply with floating point range. 500 must be 1 to 200",
    )
    assert (world.asked, world.server.values(), len(world.events)) == ([], ALL, 1)
    assert world.set_all(good, world.row("rate", 50.0)) == (True, "")
    assert world.asked == [{"retries": 1, "rate": 50.0}]
    assert world.events[1:] == [([], [("retries", 1), ("rate", 50.0)])]


def test_nothing_to_set_is_refused_but_by_humble(world: World) -> None:
    assert world.set_all() == (False, "parameter list cannot be empty: there is no parameter to set")
    assert World(Distribution.HUMBLE).set_all() == (True, "")
    assert world.set() == []
    assert (world.asked, len(world.events)) == ([], 1)


def test_every_node_has_the_parameter_that_ros_gives_it(world: World) -> None:
    assert world.set(world.row("start_type_description_service", False))[0][1].startswith(
        "parameter 'start_type_description_service' cannot be set because it is read-only"
    )
    assert "start_type_description_service" not in World(Distribution.HUMBLE).server.values()


def test_the_parameter_for_type_descriptions_says_what_the_node_does(world: World) -> None:
    assert world.server.values()["start_type_description_service"] is True
    assert World(tells_types=False).server.values()["start_type_description_service"] is False


def test_the_program_sets_by_the_same_rules(world: World) -> None:
    with pytest.raises(UsageError, match="must be 1 to 200"):
        world.server.set({"rate": 500.0})
    world.server.set({"rate": 20.0})
    assert world.events[1:] == [([], [("rate", 20.0)])]
