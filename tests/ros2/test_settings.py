"""The node's parameters as ROS gives them: flat names, integers for numbers, names of ros2_control."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from hexwire.control.requests.setting import Setting
from hexwire.control.requests.settings import SETTINGS
from hexwire.drivers import registry
from hexwire.errors import LinkNotFoundError, UsageError
from hexwire.link import ports
from hexwire.ros2.settings import (
    DESCRIBES_TYPES,
    FOREIGN,
    OWN,
    PARAMETERS,
    NodeSettings,
    changed,
    descriptor_of,
    load_settings,
)
from zenoh_ros2 import type_descriptions
from zenoh_ros2.distributions import Distribution
from zenoh_ros2.parameters import Descriptor

PORT = {"port": "/dev/ttyUSB0"}
TWO = {"controllers.arm.joints": ["J1", "J2"], "controllers.hand.joints": ["J7"]}


@pytest.fixture(autouse=True)
def no_boards(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(registry.PORT_VARIABLE, raising=False)
    monkeypatch.setattr(ports, "list_ports", list)


def load(environ: dict[str, str] | None = None, **given: object) -> NodeSettings:
    values = {name.replace("__", "."): value for name, value in given.items()}
    return load_settings(PORT | values, environ or {})[0]


def fault(given: dict[str, Any]) -> str:
    with pytest.raises(UsageError) as caught:
        load_settings(PORT | given, {})
    return str(caught.value)


def test_the_port_may_be_the_chapters_configuration_file(tmp_path: Path) -> None:
    file = tmp_path / "ipc_msg.conf"
    file.write_text("12 CLIENT_TRX ARM_7BOT_ARDUINO_TRX IPC_SERIAL_PORT /dev/none 500000\n")
    robot = load_settings({"port": f"conf://{file}?module=12"}, {})[1]
    assert robot.url == "serial:///dev/none?baud=500000"
    assert "there is no channel for ARM_7BOT_SERIAL_TRX; the file has module 12" in fault({"port": str(file)})


# -- names ------------------------------------------------------------------------------------------------


def test_dots_separate_the_parts_of_a_name() -> None:
    settings = load(
        poses__home__J1=0.5,
        constraints__goal_time=2,
        constraints__J1__goal=0.1,
        safety__load_time=0.5,
        joints=["J1", "J2"],
    )
    assert settings.arm.poses == {"home": {"J1": 0.5}}
    (controller,) = settings.arm.controllers
    assert controller.joints == ("J1", "J2")
    assert (controller.tolerances.goal_time, controller.tolerances.goal["J1"].position) == (2.0, 0.1)
    assert settings.arm.safety == {"load_time": 0.5}


def test_a_fault_names_the_parameter_as_it_is_written() -> None:
    text = fault({"constraints.J1.gaol": 0.1, "watchdog": -1.0, "safety.load_tmie": 1.0})
    assert text.startswith("3 parameters are wrong: ")
    assert "constraints.J1.gaol: unknown, did you mean constraints.J1.goal?" in text
    assert "safety.load_tmie: unknown, did you mean safety.load_time?" in text
    assert "watchdog: -1 must be 0, or 0.05 to 60 s" in text


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"prot": "x"}, "prot: unknown, did you mean port?"),
        ({"whatever": 1}, "whatever: unknown, 'hexwire-ros2 --help' lists them"),
        ({"constraints": 1.0}, "constraints: must be a table of names and values, not"),
        ({"constraints": 1.0, "constraints.goal_time": 1.0}, "constraints.goal_time: a value, where another"),
        ({"constraints.goal_time": 1.0, "constraints": 1.0}, "constraints: a value, where another"),
        ({"port": 5}, "port: 5 must be text: in quotes, for example -p port:='\"5\"'"),
        ({"poses.my-pose.J1": 0.1}, "poses.my-pose: not a service name"),
        ({"poses.a__b.J1": 0.1}, "poses.a__b: not a service name"),
        ({"controllers.1st.joints": ["J1"]}, "controllers.1st: not a ROS name"),
        ({"controller_name": "my controller"}, "controller_name: not a ROS name"),
        ({"joint_states_topic": "a b"}, "joint_states_topic: not a topic"),
        ({"distribution": "noetic"}, "distribution: unknown: 'noetic'; there are humble, jazzy"),
        ({"publish_tf": 1}, "publish_tf: must be true or false, not"),
        ({"joints": "J1"}, "joints: must be a list of names, not the text 'J1'"),
        ({"use_sim_time": "yes"}, "use_sim_time: must be true or false, not"),
    ],
)
def test_wrong_parameters_are_named(given: dict[str, Any], text: str) -> None:
    assert text in fault(given)


def test_several_controllers_have_their_names_and_a_single_one_that_of_its_parameter() -> None:
    assert load().topic("") == "joint_trajectory_controller"
    assert load(controller_name="arm_controller").topic("") == "arm_controller"
    settings = load(**TWO)  # type: ignore[arg-type]  # values of every type
    assert [settings.topic(row.name) for row in settings.arm.controllers] == ["arm", "hand"]


def test_the_port_is_named_as_a_parameter() -> None:
    with pytest.raises(LinkNotFoundError, match="-p port:=PORT"):
        load_settings({}, {})


# -- what ROS and ros2_control have ---------------------------------------------------------------------------


def test_parameters_of_a_trajectory_controller_can_be_left_in_its_file() -> None:
    settings = load(
        type="joint_trajectory_controller/JointTrajectoryController",
        command_interfaces=["position"],
        gains__J1__p=1.0,
        **{"controllers.arm.joints": ["J1"], "controllers.arm.action_monitor_rate": 5.0},  # type: ignore[arg-type]
    )
    assert [line.partition(":")[0] for line in settings.warnings] == [
        "type",
        "command_interfaces",
        "gains",
        "controllers.arm.action_monitor_rate",
    ]
    assert settings.own["action_monitor_rate"] == 20.0


def test_what_every_node_of_ros_has_is_no_fault() -> None:
    settings = load(use_sim_time=True, **{"qos_overrides./tf.publisher.depth": 5})  # type: ignore[arg-type]
    assert settings.use_sim_time
    assert "qos_overrides" not in settings.tables


@pytest.mark.parametrize(
    ("given", "environ", "found"),
    [
        ("", {}, Distribution.JAZZY),
        ("", {"ROS_DISTRO": "humble"}, Distribution.HUMBLE),
        ("", {"ROS_DISTRO": "noetic"}, Distribution.JAZZY),
        ("", {"ROS_DISTRO": "lyrical"}, Distribution.LYRICAL),
        ("kilted", {"ROS_DISTRO": "humble"}, Distribution.KILTED),
    ],
)
def test_the_distribution(given: str, environ: dict[str, str], found: Distribution) -> None:
    assert load(environ, distribution=given).distribution is found


def test_an_unknown_distribution_of_the_environment_is_told(caplog: pytest.LogCaptureFixture) -> None:
    load({"ROS_DISTRO": "jazzy"})
    load({"ROS_DISTRO": "zulu"}, distribution="rolling")
    assert not caplog.messages
    load({"ROS_DISTRO": "zulu"})
    (text,) = caplog.messages
    assert "ROS_DISTRO is zulu, which is not known here: messages are those of jazzy" in text


def test_a_trajectory_must_end_at_rest_unless_it_is_allowed() -> None:
    (controller,) = load().arm.controllers
    assert controller.end_at_rest
    (controller,) = load(allow_nonzero_velocity_at_trajectory_end=True).arm.controllers
    assert not controller.end_at_rest


# -- all parameters, and those that change ----------------------------------------------------------------------


def test_every_parameter_has_its_value_and_one_type() -> None:
    settings = load(watchdog=2, poses__home__J1=1, joints=["J1", "J2"], constraints__J2__goal=0.3)
    flat = settings.flat()
    assert {row.name for row in PARAMETERS} - set(flat) == {"poses", "safety", "constraints", "controllers"}
    for row in PARAMETERS:
        if row.name in flat:
            wanted = list if isinstance(row.default, tuple) else type(row.default)
            assert type(flat[row.name]) is wanted, row.name
    assert flat["watchdog"] == 2.0
    assert flat["poses.home.J1"] == 1.0
    assert isinstance(flat["poses.home.J1"], float)
    assert flat["joints"] == ["J1", "J2"]
    assert (flat["constraints.J1.goal"], flat["constraints.J2.goal"]) == (0.0, 0.3)
    assert flat["distribution"] == "jazzy"
    assert list(flat) == sorted(flat)


def test_a_change_leaves_all_others_alone() -> None:
    settings = load(poses__home__J1=1.0, constraints__J2__goal=0.3)
    changes = {"constraints.J1.goal": 0.2, "diagnostics_rate": 5.0, "joint_commands_start_tolerance": 0.0}
    after = changed(settings, changes)
    assert after.flat() == settings.flat() | changes
    assert settings.near == 0.1
    assert after.near == math.inf
    (controller,) = after.arm.controllers
    assert (controller.tolerances.goal["J1"].position, controller.tolerances.goal["J2"].position) == (0.2, 0.3)
    assert controller.end_at_rest


def test_a_controller_of_several_changes_alone() -> None:
    settings = load(**TWO)  # type: ignore[arg-type]  # values of every type
    after = changed(settings, {"controllers.hand.constraints.J7.goal": 0.2})
    arm, hand = after.arm.controllers
    assert hand.tolerances.goal["J7"].position == 0.2
    assert arm == settings.arm.controllers[0]
    assert after.flat()["controllers.hand.constraints.J7.goal"] == 0.2


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"port": "/dev/ttyUSB1"}, "port: it is read at the start only"),
        ({"watchdog": 0.0}, "watchdog: it is read at the start only"),
        ({"joints": ["J1"]}, "joints: it is read at the start only"),
        ({"safety.load_time": 1.0}, "safety.load_time: it is read at the start only"),
        ({"diagnostics_rate": 0.0}, "diagnostics_rate: 0 must be above 0 and at most 100 Hz"),
        ({"pose_speed": 1.5}, "pose_speed: 1.5 must be above 0 and at most 1"),
        ({"constraints.goal_time": math.nan}, "constraints.goal_time: must be a finite number"),
        ({"constraints.J9.goal": 0.1}, "constraints.J9: no joint 'J9' here"),
        ({"pose_speed": 0.5, "frame_id": 3.0}, "frame_id: 3.0 must be text"),
    ],
)
def test_a_wrong_change_is_refused_and_changes_nothing(changes: dict[str, object], text: str) -> None:
    settings = load()
    before = settings.flat()
    with pytest.raises(UsageError) as caught:
        changed(settings, changes)
    assert text in str(caught.value)
    assert settings.flat() == before


def test_what_may_change() -> None:
    settings = load(**TWO)  # type: ignore[arg-type]  # values of every type
    may = {name for name in settings.flat() if settings.may_change(name)}
    assert {"pose_speed", "frame_id", "controllers.arm.constraints.goal_time"} <= may
    assert not may & {"port", "watchdog", "controllers.arm.joints", "distribution", "controller_name"}


def test_every_row_is_told_in_one_line() -> None:
    assert len({row.name for row in PARAMETERS}) == len(PARAMETERS)
    for row in OWN:
        assert isinstance(row, Setting)
        assert row.help
        assert "\n" not in row.help
    assert all(FOREIGN.values())


def test_the_service_that_describes_types_can_be_left_out() -> None:
    assert load().describes_types
    assert not load(start_type_description_service=False).describes_types


@pytest.mark.parametrize(
    ("row", "low", "high", "constraints"),
    [
        (Setting("a", 1.0, "what", "Hz", low=0.5, high=2.0), 0.5, 2.0, ""),
        (Setting("a", 1.0, "what", "Hz", low=0.5), 0.5, math.inf, "0.5 or more Hz"),
        (
            Setting("a", 1.0, "what", "Hz", low=0.0, high=2.0, above=True),
            -math.inf,
            math.inf,
            "above 0 and at most 2 Hz",
        ),
        (Setting("a", 1.0, "what", "Hz", low=0.5, high=2.0, zero=True), -math.inf, math.inf, "0, or 0.5 to 2 Hz"),
        (Setting("a", 1.0, "what", "Hz"), -math.inf, math.inf, ""),
    ],
)
def test_the_descriptor_of_a_setting_says_its_bounds(
    row: Setting, low: float, high: float, constraints: str
) -> None:
    assert descriptor_of(row, read_only=True) == Descriptor("what, Hz", constraints, True, low, high)


def test_a_descriptor_refuses_nothing_that_its_setting_allows() -> None:
    for row in SETTINGS:
        described = descriptor_of(row, read_only=False)
        if isinstance(row.default, float) and described.ranged:
            assert row.allows(described.low)
            assert row.allows(described.high)


def test_names_that_the_wire_has_too_are_the_same() -> None:
    assert type_descriptions.PARAMETER == DESCRIBES_TYPES
