from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path

import pytest
from tests.drivers.likely_boards import likely_boards

from hexwire.errors import LinkNotFoundError, UsageError
from hexwire.ros1.parameters import FOREIGN, OWN, PARAMETERS, Parameters, load_parameters

ALL = ("J1", "J2", "J3", "J4", "J5", "J6", "J7")


@pytest.fixture(autouse=True)
def boards(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    return likely_boards(monkeypatch)


def load(**params: object) -> Parameters:
    return load_parameters({"port": "/dev/ttyUSB0", **params})[0]


def faults(**params: object) -> list[str]:
    """What is wrong with parameters, one text each, in order."""
    with pytest.raises(UsageError) as told:
        load(**params)
    text = str(told.value)
    assert "\n" not in text
    head, _, rest = text.partition(": ")
    found = rest.split("; ~")
    assert head == (f"{len(found)} parameters are wrong" if len(found) > 1 else "1 parameter is wrong")
    return [found[0], *(f"~{part}" for part in found[1:])]


def test_rows_are_whole() -> None:
    names = [row.name for row in PARAMETERS]
    assert len(set(names)) == len(names) == 27
    for row in PARAMETERS:
        assert row.help, row.name
        assert "\n" not in row.help
        if isinstance(row.default, float):
            assert row.allows(row.default), row.name
            assert math.isfinite(row.high), f"{row.name}: a number without an end is a typing error away from harm"
        else:
            assert isinstance(row.default, str | bool | tuple | Mapping), row.name


def test_the_port_may_be_the_chapters_configuration_file(tmp_path: Path) -> None:
    file = tmp_path / "ipc_msg.conf"
    file.write_text("ARM_7BOT_SERIAL_TRX CLIENT_TRX ARM_7BOT_ARDUINO_TRX IPC_SERIAL_PORT /dev/none 500000\n")
    parameters, robot = load_parameters({"port": str(file)})
    assert parameters.settings.port == str(file)
    assert robot.url == "serial:///dev/none?baud=500000"
    file.write_text("JOY_STICK CLIENT_TRX ARM_7BOT_ARDUINO_TRX IPC_SERIAL_PORT /dev/none\n")
    (text,) = faults(port=str(file))
    assert text.startswith("~port: ")
    assert "there is no channel for ARM_7BOT_SERIAL_TRX; the file has JOY_STICK" in text


def test_defaults_as_a_parameter_file_has_them() -> None:
    texts = {row.name: row.default_text for row in PARAMETERS}
    assert texts["port"] == '""'
    assert texts["robot"] == "hex7bot"
    assert texts["publish_rate"] == "100.0"
    assert texts["check_table"] == "true"
    assert texts["joints"] == "[]"
    assert texts["poses"] == "{}"


def test_own_parameters() -> None:
    given = load()
    for row in OWN:
        assert getattr(given, row.name) == row.default
    given = load(frame_id="base_link", hardware_id="7-01", diagnostics_rate=2)
    assert (given.frame_id, given.hardware_id, given.diagnostics_rate) == ("base_link", "7-01", 2.0)


def test_the_only_likely_board(boards: list[str]) -> None:
    boards.append("/dev/ttyACM3")
    assert load(port="").settings.port == "/dev/ttyACM3"
    boards.append("/dev/ttyACM4")
    (text,) = faults(port="")
    assert text.startswith("~port: several likely boards: /dev/ttyACM3 (a board), /dev/ttyACM4")
    assert "--port" not in text


def test_a_missing_board_is_reported_only_if_all_else_is_right() -> None:
    assert faults(port="", pose_speed=2) == ["~pose_speed: 2 must be above 0 and at most 1"]
    assert faults(port="", poses={"up": {"J8": 0}}) == [f"~poses/up/J8: no joint 'J8', there are {', '.join(ALL)}"]
    with pytest.raises(LinkNotFoundError, match="no serial port on this machine") as told:
        load(port="")
    assert "~port" in str(told.value)
    assert "--port" not in str(told.value)


def test_parameters_of_ros_control_are_a_warning_that_names_ours() -> None:
    warned = load(
        joint_state_controller={"publish_rate": 50},
        controllers={
            "arm": {
                "type": "position_controllers/JointTrajectoryController",
                "joints": ["J1", "J2"],
                "gains": {"J1": {"p": 100}},
                "state_publish_rate": 25,
                "stop_trajectory_duration": 0.5,
            }
        },
    ).warnings
    assert warned == (
        "~joint_state_controller: a parameter of ros_control without effect here; use ~publish_rate",
        "~controllers/arm/type: a parameter of ros_control without effect here; this node is the controller",
        (
            "~controllers/arm/gains: a parameter of ros_control without effect here; the servos close the loop "
            "themselves; their gains are registers, see `hexwire bus table`"
        ),
        (
            "~controllers/arm/state_publish_rate: a parameter of ros_control without effect here; use "
            "~state_publish_rate, for the whole node"
        ),
        (
            "~controllers/arm/stop_trajectory_duration: a parameter of ros_control without effect here; "
            "the arm always slows down within its speed limits"
        ),
    )
    assert load().warnings == ()


def test_a_name_of_ros_control_elsewhere_is_a_fault() -> None:
    assert faults(constraints={"gains": 1}, safety={"type": 1}) != []
    for name, text in FOREIGN.items():
        assert name not in {row.name for row in PARAMETERS} - {"state_publish_rate", "action_monitor_rate"}, text
        for ours in re.findall(r"use ~(\w+)", text):
            assert ours in {row.name for row in PARAMETERS}


def test_all_faults_at_once() -> None:
    assert faults(
        port="my port",
        publish_rate=0,
        poses={"home": {"J9": 0.0}},
        wacthdog=1.0,
        qqq=1,
        frame_id=7,
        links="C",
        joints=["J1", "J8"],
        safety={"load": -1},
        constraints={"J1": {"goal": "0.1"}},
    ) == [
        '~frame_id: 7 must be text: in quotes, or with type="str" in a launch file',
        "~wacthdog: unknown, did you mean ~watchdog?",
        "~qqq: unknown, 'hexwire-ros1 --help' lists them",
        "~publish_rate: 0 must be above 0 and at most 1000 Hz",
        "~port: 'my port' is not a link address: it is empty or contains blanks",
        "~links: no link set 'C'; use A, B, V1, or a TOML file",
        f"~poses/home/J9: no joint 'J9', there are {', '.join(ALL)}",
        "~safety/load: -1 must be above 0",
        f"~joints: no joint 'J8', there are {', '.join(ALL)}",
        "~constraints/J1/goal: must be a number, not the text '0.1'",
    ]


def test_names_that_ros_does_not_take() -> None:
    assert faults(
        poses={"2nd": {"J1": 0.0}, "a-b": {"J1": 0.0}, "Up_2": {"J1": 0.0}},
        controllers={
            "no-name": {"joints": ["J3"]},
            "left/arm": {"joints": ["J4"]},
            "d": ["J5"],
            "e/f": {"joints": ["J6"]},
            "e": {"f": {"joints": ["J7"]}},
        },
    ) == [
        "~poses/2nd: not a service name: a letter first, then letters, digits and _ only",
        "~poses/a-b: not a service name: a letter first, then letters, digits and _ only",
        "~controllers/d: must be a table of names and values, not the list ['J5']",
        "~controllers/e/f: given twice",
        "~controllers/no-name: not a ROS name: a letter first, then letters, digits, _ and / only",
        "~controllers/d/joints: a controller needs at least one joint",
    ]


def test_a_name_with_a_slash_is_a_table_of_tables() -> None:
    # As the parameter server keeps left/hand.
    nested = load(controllers={"arm": {"joints": ["J1"]}, "left": {"hand": {"joints": ["J7"]}}})
    assert [row.name for row in nested.settings.controllers] == ["arm", "left/hand"]
    flat = load(controllers={"left/hand": {"joints": ["J7"]}})
    assert [row.name for row in flat.settings.controllers] == ["left/hand"]


def test_texts_name_other_parameters_as_ros_does() -> None:
    assert faults(robot="chain", table_height=0.1) == [
        "~table_height: chain has no geometry for this check; set ~check_table to false"
    ]
    (text,) = faults(watchdog=0.5, command_rate=2)
    assert text.startswith("~watchdog: 0.5 s is less than two periods of ~command_rate 2 Hz, 1 s")


def test_a_value_that_is_not_a_table_is_reported() -> None:
    assert faults(poses=1, controllers=2) == [
        "~poses: must be a table of names and values, not 1",
        "~controllers: must be a table of names and values, not 2",
    ]
