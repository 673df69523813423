from __future__ import annotations

import math
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
from tests.drivers.likely_boards import likely_boards

from hexwire.control.motion.arrival import Tolerance
from hexwire.control.requests.setting import Faults
from hexwire.control.requests.settings import SETTINGS, Settings
from hexwire.control.requests.settings_reader import read_settings, reread
from hexwire.drivers import registry
from hexwire.drivers.base import RobotDriver
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.drivers.puma260 import Puma260Driver
from hexwire.errors import LinkNotFoundError, UsageError
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.motion.safety import SafetyLimits

ALL = ("J1", "J2", "J3", "J4", "J5", "J6", "J7")


@pytest.fixture(autouse=True)
def boards(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    return likely_boards(monkeypatch)


def load(**given: object) -> Settings:
    return read_settings({"port": "/dev/ttyUSB0", **given}, Faults())[0]


def faults(**given: object) -> list[str]:
    """What is wrong with settings, one text each, in order."""
    found = Faults()
    with pytest.raises(UsageError) as told:
        read_settings({"port": "/dev/ttyUSB0", **given}, found)
    assert "\n" not in str(told.value)
    assert all(text in str(told.value) for text in found.texts)
    return found.texts


_GO_INTO_OTHERS = {
    # The driver and the table.
    *("robot", "table_height", "check_table"),
    # The controllers.
    *("joints", "allow_partial_joints_goal", "constraints"),
}


# -- what holds without settings ------------------------------------------------------------------------


def test_every_setting_has_a_default() -> None:
    settings, driver = read_settings({"port": "/dev/ttyUSB0"}, Faults())
    assert isinstance(driver, Hex7BotDriver)
    assert not driver.session.is_open
    assert settings.model is driver.model
    for row in SETTINGS:
        if row.name not in {"port", "safety", "controllers", *_GO_INTO_OTHERS}:
            assert getattr(settings, row.name) == row.default, row.name
    assert settings.safety_at(20.0) == SafetyLimits()
    assert settings.table == 0.0
    (only,) = settings.controllers
    assert (only.name, only.joints, only.allow_partial) == ("", ALL, False)
    assert only.tolerances.goal_time == 0.0
    assert only.tolerances.path == dict.fromkeys(ALL, Tolerance())
    assert only.tolerances.goal == dict.fromkeys(ALL, Tolerance(velocity=0.05))


def test_each_setting_is_a_field_or_goes_into_another() -> None:
    names = {field.name for field in fields(Settings)}
    assert {row.name for row in SETTINGS} - names == _GO_INTO_OTHERS


def test_plain_values_come_through() -> None:
    settings = load(publish_rate=50, watchdog=0, check_table=False, table_height=-0.02)
    assert (settings.publish_rate, settings.watchdog, settings.table) == (50.0, 0.0, None)
    assert isinstance(settings.publish_rate, float)
    assert load(table_height=-0.02).table == -0.02


# -- faults ---------------------------------------------------------------------------------------------


def test_all_faults_at_once() -> None:
    assert faults(
        port="my port",
        publish_rate=0,
        poses={"home": {"J9": 0.0}},
        wacthdog=1.0,
        links="C",
        joints=["J1", "J8"],
        safety={"load": -1},
        constraints={"J1": {"goal": "0.1"}},
    ) == [
        "publish_rate: 0 must be above 0 and at most 1000 Hz",
        "wacthdog: unknown, did you mean watchdog?",
        "port: 'my port' is not a link address: it is empty or contains blanks",
        "links: no link set 'C'; use A, B, V1, or a TOML file",
        f"poses/home/J9: no joint 'J9', there are {', '.join(ALL)}",
        "safety/load: -1 must be above 0",
        f"joints: no joint 'J8', there are {', '.join(ALL)}",
        "constraints/J1/goal: must be a number, not the text '0.1'",
    ]


@pytest.mark.parametrize("row", SETTINGS, ids=lambda row: str(row.name))
def test_every_setting_refuses_another_type(row: Any) -> None:
    other = 3 if isinstance(row.default, str | bool | tuple) else "text"
    found = [text for text in faults(**{row.name: other}) if text.startswith(f"{row.name}: ")]
    assert len(found) == 1
    assert "must be" in found[0]


@pytest.mark.parametrize("row", [row for row in SETTINGS if isinstance(row.default, float)], ids=lambda r: r.name)
def test_every_number_has_bounds(row: Any) -> None:
    for value in (math.nan, math.inf, -1e9, 1e9, True):
        assert [text.partition(":")[0] for text in faults(**{row.name: value})] == [f"{row.name}"]


# -- robot and port -------------------------------------------------------------------------------------


def test_an_unknown_robot_is_one_fault_whatever_needs_its_joints() -> None:
    (text,) = faults(robot="r2d2", poses={"home": {"K1": 0.0}}, constraints={"K1": {"goal": 0.1}}, links="C")
    assert text.startswith("robot: no robot 'r2d2'; installed are")


def test_a_robot_that_is_a_file(tmp_path: Path) -> None:
    file = tmp_path / "arm.toml"
    assert faults(robot=str(file)) == [f"robot: {file}: cannot be read: No such file or directory"]
    file.write_text('name = "mine"\nbase = "so101"\n', encoding="utf-8")
    settings = load(robot=str(file))
    assert settings.model.name == "mine"
    assert settings.kinematics is not None
    assert settings.kinematics.name == "so101"
    assert settings.controllers[0].joints == settings.model.names


def test_the_port_of_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(registry.PORT_VARIABLE, "tcp://10.0.0.7:15030")
    assert load(port="").port == "tcp://10.0.0.7:15030"
    assert load(port="/dev/ttyS9").port == "/dev/ttyS9"
    monkeypatch.setenv(registry.PORT_VARIABLE, "tcp://10.0.0.7")
    (text,) = faults(port="")
    assert text.startswith("port: ")
    assert text.endswith("(from HEXWIRE_PORT)")


def test_the_port_is_looked_for_only_if_all_else_is_right() -> None:
    settings, driver = read_settings({}, Faults(), find_port=lambda: "/dev/ttyACM3")
    assert settings.port == "/dev/ttyACM3"
    assert settings.model is driver.model
    assert faults(port="", pose_speed=2) == ["pose_speed: 2 must be above 0 and at most 1"]
    assert faults(port="", poses={"up": {"J8": 0}}) == [f"poses/up/J8: no joint 'J8', there are {', '.join(ALL)}"]
    with pytest.raises(LinkNotFoundError, match="no serial port on this machine"):
        load(port="")


class _OwnScheme(Hex7BotDriver):
    @classmethod
    def from_url(cls, url: str, **options: Any) -> _OwnScheme:
        if not url.startswith("tcp:"):
            raise UsageError("only tcp:// will do")
        return super().from_url(url, **options)


def test_a_robot_that_no_serial_port_can_be(monkeypatch: pytest.MonkeyPatch) -> None:
    def own(name: str) -> type[RobotDriver]:
        return _OwnScheme

    monkeypatch.setattr("hexwire.control.requests.settings_reader.load_driver", own)
    assert load(robot="own", port="tcp://h:1").model.names == ALL
    assert faults(robot="own", port="") == ["port: own needs a port (only tcp:// will do)"]
    assert faults(robot="own", port="udp://h:1") == ["port: only tcp:// will do"]


def test_a_plugin_that_cannot_be_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(name: str) -> type[RobotDriver]:
        raise ImportError("No module named 'their_arm'")

    monkeypatch.setattr("hexwire.control.requests.settings_reader.load_driver", gone)
    assert faults(robot="theirs") == ["robot: No module named 'their_arm'"]


# -- geometry -------------------------------------------------------------------------------------------


def test_kinematics_are_those_for_motion() -> None:
    kinematics = load(links="V1").kinematics
    assert isinstance(kinematics, Hex7BotModel)
    assert kinematics.links.name == "V1"
    assert math.degrees(load().kinematics.ranges[5].maximum) == pytest.approx(269.0)  # type: ignore[union-attr]


def test_the_puma() -> None:
    settings, driver = read_settings({"robot": "puma260", "port": "tcp://127.0.0.1:15030", "links": "A"}, Faults())
    assert isinstance(driver, Puma260Driver)
    assert settings.kinematics is not None
    assert settings.kinematics.name == "puma260"


def test_robots_without_link_sets_or_geometry() -> None:
    assert faults(robot="puma260", links="B") == ["links: only the hex7bot has link sets; omit it for puma260"]
    assert faults(robot="chain", links="V1", table_height=0.1) == [
        "links: only the hex7bot has link sets; omit it for chain",
        "table_height: chain has no geometry for this check; set check_table to false",
    ]
    settings = load(robot="chain", table_height=0.1, check_table=False)
    assert (settings.kinematics, settings.table) == (None, None)
    assert load(robot="chain").table is None
    assert load(robot="so101", table_height=0.1).table == 0.1


def test_a_file_of_links(tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    assert faults(links=str(file)) == [f"links: {file}: cannot be read: No such file or directory"]
    file.write_text("a=120\nz=1\n", encoding="utf-8")
    (text,) = faults(links=str(file))
    assert text.startswith(f"links: {file}:2:3: z is an unknown key; known: a, b, c")


# -- poses ----------------------------------------------------------------------------------------------


def test_poses() -> None:
    settings = load(poses={"home": {"J1": 0, "J7": 0.1}, "Up_2": {"J2": 0.5}})
    assert settings.poses == {"home": {"J1": 0.0, "J7": 0.1}, "Up_2": {"J2": 0.5}}


def test_poses_that_cannot_be() -> None:
    assert faults(
        poses={
            "none": {},
            "flat": 0.5,
            "far": {"J1": 1.4, "J2": 90, "J3": "0.5", "J4": math.nan, "j5": 0.0},
        }
    ) == [
        "poses/none: names no joint",
        "poses/flat: must be a table of names and values, not 0.5",
        "poses/far/J1: 1.4 rad is outside its limits -1.484 to 1.309 rad",
        "poses/far/J2: 90 rad is outside its limits -0.4363 to 2.531 rad; angles are radians",
        "poses/far/J3: must be a number, not the text '0.5'",
        "poses/far/J4: must be a finite number",
        f"poses/far/j5: no joint 'j5', there are {', '.join(ALL)}",
    ]


def test_a_whole_pose_that_the_elbow_forbids() -> None:
    folded = {"J1": 0.0, "J2": -0.2, "J3": -1.3, "J4": 0.0, "J5": 0.0, "J6": 0.0}
    (text,) = faults(poses={"folded": folded})
    assert text.startswith("poses/folded: elbow open 63.4 deg too far")
    # With one joint less, it is the arm's place at that time that tells.
    del folded["J6"]
    assert load(poses={"folded": folded}).poses == {"folded": folded}


# -- safety ---------------------------------------------------------------------------------------------


def test_thresholds_that_were_chosen_stay_and_others_follow_the_rate() -> None:
    settings = load(safety={"max_age": 0.7, "load": 1}, command_rate=1, watchdog=3)
    assert settings.safety_at(1.0) == SafetyLimits(max_age=0.7, load=1.0, lag=2.5)
    assert settings.safety == {"max_age": 0.7, "load": 1.0}
    assert settings.safety_at(20.0) == SafetyLimits(max_age=0.7, load=1.0)
    assert load().safety_at(1.5) == SafetyLimits.at_period(1 / 1.5)


def test_invalid_thresholds_are_refused() -> None:
    thresholds = [field.name for field in fields(SafetyLimits) if field.name != "faults"]
    assert faults(safety={"lod": 1, "load": 0, "faults": 3, "lag": False}) == [
        "safety/lod: unknown, did you mean safety/load?",
        f"safety/faults: unknown, there are {', '.join(thresholds)}",
        "safety/load: 0 must be above 0",
        "safety/lag: must be a number, not false",
    ]


def test_a_watchdog_that_the_rate_cannot_feed() -> None:
    (text,) = faults(watchdog=0.5, command_rate=2)
    assert text.startswith("watchdog: 0.5 s is less than two periods of command_rate 2 Hz, 1 s")
    assert load(watchdog=1, command_rate=2).watchdog == 1.0
    assert load(watchdog=0, command_rate=1).watchdog == 0.0


def test_times_of_which_zero_is_never() -> None:
    settings = load(watchdog=0, command_timeout=0)
    assert (settings.watchdog, settings.command_timeout) == (0.0, 0.0)
    assert faults(watchdog=0.01, command_timeout=-1) == [
        "watchdog: 0.01 must be 0, or 0.05 to 60 s",
        "command_timeout: -1 must be 0, or 0.05 to 60 s",
    ]


# -- controllers ----------------------------------------------------------------------------------------


def test_the_only_controller() -> None:
    (only,) = load(
        joints=["J2", "J1"],
        allow_partial_joints_goal=True,
        constraints={
            "goal_time": 2,
            "stopped_velocity_tolerance": 0.05,
            "J1": {"trajectory": 0.2, "goal": 0.1},
            "J2": {"goal": 0.3},
        },
    ).controllers
    assert (only.name, only.joints, only.allow_partial) == ("", ("J2", "J1"), True)
    assert only.tolerances.goal_time == 2.0
    assert only.tolerances.path == {"J1": Tolerance(0.2), "J2": Tolerance()}
    assert only.tolerances.goal == {"J1": Tolerance(0.1, 0.05), "J2": Tolerance(0.3, 0.05)}


def test_invalid_constraints_are_refused() -> None:
    assert faults(
        joints=["J1", "J2"],
        constraints={
            "goal_time": -1,
            "stopped_velocity": 0.1,
            "J1": {"goul": 0.1, "goal": -1},
            "J2": 0.1,
            "J3": {"goal": 0.1},
        },
    ) == [
        "constraints/goal_time: -1 must be 0 to 3600 s",
        "constraints/stopped_velocity: unknown, did you mean constraints/stopped_velocity_tolerance?",
        "constraints/J1/goul: unknown, did you mean constraints/J1/goal?",
        "constraints/J1/goal: -1 must be 0 or more rad",
        "constraints/J2: must be a table of names and values, not 0.1",
        "constraints/J3: no joint 'J3' here, there are J1, J2",
    ]


def test_several_controllers() -> None:
    arm, hand = load(
        controllers={
            "arm_controller": {"joints": ["J1", "J2"], "constraints": {"goal_time": 1, "J2": {"goal": 0.1}}},
            "left/hand": {"joints": ["J7"], "allow_partial_joints_goal": True},
        }
    ).controllers
    assert (arm.name, arm.joints, arm.allow_partial) == ("arm_controller", ("J1", "J2"), False)
    assert arm.tolerances.goal["J2"] == Tolerance(0.1, 0.05)
    assert (hand.name, hand.joints, hand.allow_partial) == ("left/hand", ("J7",), True)
    assert hand.tolerances.goal == {"J7": Tolerance(velocity=0.05)}


def test_invalid_controllers_are_refused() -> None:
    assert faults(
        joints=["J1"],
        allow_partial_joints_goal=True,
        controllers={
            "a": {"joints": ["J1", "J2", "J1"]},
            "b": {"joints": ["J2", "J9"], "constraints": {"J9": {"goal": 1}, "goal_time": "1"}},
            "c": {"jonts": ["J4"]},
            "d": ["J5"],
        },
    ) == [
        "controllers: replaces joints, allow_partial_joints_goal: give those inside each controller",
        "controllers/a/joints: J1 is given twice",
        f"controllers/b/joints: no joint 'J9', there are {', '.join(ALL)}",
        "controllers/b/constraints/goal_time: must be a number, not the text '1'",
        "controllers/b/joints: J2 already belongs to the controller a",
        "controllers/c/jonts: unknown, did you mean controllers/c/joints?",
        "controllers/c/joints: a controller needs at least one joint",
        "controllers/d: must be a table of names and values, not the list ['J5']",
        "controllers/d/joints: a controller needs at least one joint",
    ]


def test_defaults_beside_several_controllers_are_no_contradiction() -> None:
    settings = load(
        joints=[], constraints={}, allow_partial_joints_goal=False, controllers={"a": {"joints": ["J1"]}}
    )
    assert [controller.name for controller in settings.controllers] == ["a"]


def test_an_emulated_arm_needs_no_robot_named() -> None:
    settings, driver = read_settings({"port": "sim://so101"}, Faults())
    assert (settings.model.name, driver.model.name, driver.url) == ("so101", "so101", "sim://so101")
    assert read_settings({"port": "sim://so101", "robot": "so100"}, Faults())[1].model.name == "so100"


# -- settings of an arm in use ----------------------------------------------------------------------------


def test_only_what_may_change_is_read_again() -> None:
    settings = load(poses={"home": {"J1": 0.0}}, pose_speed=0.5)
    faults = Faults()
    again = reread(settings, {"pose_speed": 0.7, "port": "/dev/other", "watchdog": -1.0}, faults)
    assert faults.texts == []
    assert again.pose_speed == 0.7
    changed = [
        field.name for field in fields(Settings) if getattr(again, field.name) != getattr(settings, field.name)
    ]
    assert changed == ["pose_speed"]


@pytest.mark.parametrize(
    ("given", "fault"),
    [
        ({"pose_speed": 2.0}, "pose_speed: 2 must be above 0 and at most 1"),
        ({"constraints": {"goal_time": -1.0}}, "constraints/goal_time: -1 must be 0 to 3600 s"),
        ({"constraints": {"J9": {"goal": 0.1}}}, "constraints/J9: no joint 'J9' here, there are J1, J2"),
        ({"joints": ["J1"]}, "controllers: the joints of a controller cannot change while the arm is in use"),
        ({"controllers": {"arm": {"joints": ["J1", "J2"]}}}, "controllers: replaces joints: give those inside"),
    ],
)
def test_a_wrong_change_is_a_fault_and_changes_nothing(given: dict[str, object], fault: str) -> None:
    settings = load(joints=["J1", "J2"])
    faults = Faults()
    assert reread(settings, {"joints": ["J1", "J2"], **given}, faults) == settings
    assert fault in faults.texts[0]
