"""The whole package: built by Debian's ament_cmake, its manifest read by catkin_pkg, its launch files run."""

from __future__ import annotations

import re
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.ros2.package.launch_stand_ins import Thing, described, holds, stand_ins, text

from hexwire.errors import UsageError
from hexwire.model.arms import arms_with_geometry
from hexwire.ros2.arguments import parse_arguments
from hexwire.ros2.package import RELEASES, make_package, package_name
from hexwire.ros2.package.releases import release
from hexwire.ros2.settings import load_settings

# Debian's ament and catkin_pkg are modules of this one.
SYSTEM_PYTHON = "/usr/bin/python3"
ARGUMENTS = {
    "port": "sim://x",
    "router": "false",
    "rviz": "true",
    "panel": "true",
    "ros2_control": "false",
    "servo": "false",
}


@pytest.fixture(params=arms_with_geometry())
def robot(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def written(folder: Path, robot: str, distribution: str = "jazzy") -> Path:
    for path, content in make_package(robot, distribution=distribution).items():
        target = folder / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(content, encoding="utf-8")
    return folder


def run(*words: str, cwd: Path) -> str:
    found = subprocess.run(words, cwd=cwd, capture_output=True, text=True, timeout=100, check=False)
    assert found.returncode == 0, found.stdout + found.stderr
    return found.stdout


@pytest.mark.parametrize("name", RELEASES)
def test_same_arm_same_text_and_nothing_left_to_fill_in(robot: str, name: str) -> None:
    files = make_package(robot, distribution=name)
    assert files == make_package(robot, distribution=name)
    assert list(files) == sorted(files)
    for path, content in files.items():
        assert content.endswith("\n"), path
        assert not re.search(r"@[A-Z_]+@", content), path
        assert content.isascii(), path


@pytest.mark.slow
def test_ament_cmake_installs_every_file(robot: str, tmp_path: Path) -> None:
    package = written(tmp_path / "src", robot)
    prefix = tmp_path / "install"
    options = [f"-DPython3_EXECUTABLE={SYSTEM_PYTHON}", f"-DCMAKE_INSTALL_PREFIX={prefix}"]
    run("cmake", "-S", str(package), "-B", "build", *options, cwd=tmp_path)
    run("cmake", "--install", "build", cwd=tmp_path)
    share = prefix / "share" / package_name(robot)
    for path, content in make_package(robot).items():
        if path not in {"CMakeLists.txt", "README.md"}:
            assert (share / path).read_text(encoding="utf-8") == content
    assert (prefix / "share/ament_index/resource_index/packages" / package_name(robot)).is_file()


def test_manifest_is_one(robot: str, tmp_path: Path) -> None:
    package = written(tmp_path, robot)
    program = "import sys; from catkin_pkg.package import parse_package; print(parse_package(sys.argv[1]).name)"
    named = run(SYSTEM_PYTHON, "-c", program, str(package / "package.xml"), cwd=tmp_path)
    assert named.strip() == package_name(robot)


def things(package: Path, robot: str, file: str) -> list[Thing]:
    with stand_ins(package, package_name(robot)):
        return described(package / "launch" / file)


def nodes(found: list[Thing], **values: str) -> dict[str, Thing]:
    """The nodes that would be started, by executable; those of several spawners with a number."""
    started: dict[str, Thing] = {}
    for thing in found:
        if thing.kind == "Node" and holds(thing.options.get("condition"), ARGUMENTS | values):
            name = thing["executable"]
            started[name if name not in started else f"{name} 2"] = thing
    return started


def command(found: list[Thing], **values: str) -> list[str]:
    (process,) = (thing for thing in found if thing.kind == "ExecuteProcess")
    return [text(word, ARGUMENTS | values) for word in process["cmd"]]


@pytest.mark.parametrize("name", RELEASES)
@pytest.mark.parametrize("file", ["arm.launch.py", "ros2_control.launch.py", "moveit.launch.py"])
def test_launch_files_start_only_what_the_manifest_names(robot: str, name: str, file: str, tmp_path: Path) -> None:
    package = written(tmp_path, robot, name)
    needed = {row.text for row in ET.parse(package / "package.xml").iter("exec_depend")}
    found = things(package, robot, file)
    used = {thing["package"] for thing in found if thing.kind == "Node"}
    assert used <= needed
    assert release(name).hardware_package in needed
    assert (release(name).gripper_package in needed) == (robot != "puma260")
    declared = {thing.args[0] for thing in found if thing.kind == "DeclareLaunchArgument"}
    assert declared <= set(ARGUMENTS)
    (variable,) = (thing for thing in found if thing.kind == "SetEnvironmentVariable")
    assert variable.args == ("RMW_IMPLEMENTATION", "rmw_zenoh_cpp")


def test_arm_alone(robot: str, tmp_path: Path) -> None:
    package = written(tmp_path, robot)
    found = things(package, robot, "arm.launch.py")
    words = command(found, port="sim://arm")
    assert words[:2] == ["hexwire-ros2", "--ros-args"]
    assert Path(words[words.index("--params-file") + 1]) == package / "config/hardware_interface.yaml"
    assert "port:=''" in command(found, port="")
    started = nodes(found)
    assert set(started) == {"robot_state_publisher", "rviz2"}
    (parameters,) = started["robot_state_publisher"]["parameters"]
    # Only one of the two publishes it.
    assert parameters["robot_description"] == (package / f"urdf/{robot}.urdf").read_text(encoding="utf-8")
    assert "publish_robot_description:=false" in words
    assert Path(started["rviz2"]["arguments"][1]).is_file()
    assert set(nodes(found, rviz="false", router="true")) == {"robot_state_publisher", "rmw_zenohd"}


@pytest.mark.parametrize("name", RELEASES)
def test_node_takes_the_words_of_its_command_line(robot: str, name: str, tmp_path: Path) -> None:
    package = written(tmp_path, robot, name)
    for file in ("arm.launch.py", "ros2_control.launch.py"):
        arguments = parse_arguments(command(things(package, robot, file), port="/dev/ttyUSB7")[1:])
        settings, _ = load_settings(arguments.parameters("/hardware_interface"), {})
        assert settings.warnings == ()
        assert settings.arm.port == "/dev/ttyUSB7"
        assert settings.arm.model.name == robot
        assert settings.distribution.value == name
        assert settings.own["publish_robot_description"] is False
        assert "home" in settings.arm.poses


@pytest.mark.parametrize("name", RELEASES)
def test_under_ros2_control(robot: str, name: str, tmp_path: Path) -> None:
    package = written(tmp_path, robot, name)
    found = things(package, robot, "ros2_control.launch.py")
    words = command(found)
    # The broadcaster and robot_state_publisher have these names.
    assert "joint_states:=~/joint_states" in words
    assert "publish_robot_description:=false" in words
    started = nodes(found)
    manager = started["ros2_control_node"]
    assert [Path(row) for row in manager["parameters"]] == [package / "config/ros2_controllers.yaml"]
    assert manager["remappings"] == [(release(name).description_topic, "/robot_description")]
    assert started["spawner"]["arguments"][0] == "joint_state_broadcaster"
    spawned = started["spawner 2"]["arguments"]
    known = yaml.safe_load((package / "config/ros2_controllers.yaml").read_text(encoding="utf-8"))
    assert spawned[spawned.index("--param-file") + 1] == str(package / "config/ros2_controllers.yaml")
    assert spawned[: spawned.index("--param-file")] == [
        name for name in ("arm_controller", "gripper_controller") if name in known
    ]
    (handler,) = (thing for thing in found if thing.kind == "RegisterEventHandler")
    assert handler.args[0]["target_action"] is started["spawner"]


def test_moveit_through_either(robot: str, tmp_path: Path) -> None:
    package = written(tmp_path, robot)
    with stand_ins(package, package_name(robot)) as built:
        found = described(package / "launch/moveit.launch.py")
    (moveit,) = built
    assert {name: path.name for name, path in moveit.files.items()} == {
        "robot_description": f"{robot}.urdf",
        "robot_description_semantic": f"{robot}.srdf",
        "robot_description_kinematics": "kinematics.yaml",
        "joint_limits": "joint_limits.yaml",
        "trajectory_execution": "moveit_controllers.yaml",
        "pilz_cartesian_limits": "pilz_cartesian_limits.yaml",
    }
    pipelines = moveit.options["planning_pipelines"]
    assert pipelines["default_planning_pipeline"] == "ompl"
    # MoveIt reads a file for each, or takes its own.
    for name in pipelines["pipelines"]:
        assert (package / f"config/{name}_planning.yaml").is_file(), name
    # MoveIt would ask a controller manager to switch, which the node is not.
    assert moveit.options["trajectory_execution"]["moveit_manage_controllers"] is False
    for switch, expected in (("false", "arm.launch.py"), ("true", "ros2_control.launch.py")):
        (included,) = (
            thing
            for thing in found
            if thing.kind == "IncludeLaunchDescription"
            and holds(thing["condition"], ARGUMENTS | {"ros2_control": switch})
        )
        path = Path(included.args[0].args[0])
        assert path.name == expected
        assert path.is_file()
        passed = dict(included["launch_arguments"])
        declared = {t.args[0] for t in things(package, robot, expected) if t.kind == "DeclareLaunchArgument"}
        assert set(passed) == declared
        assert passed["rviz"] == "false"
    started = nodes(found)
    assert set(started) == {"static_transform_publisher", "move_group", "rviz2"}
    (servo,) = nodes(found, servo="true").keys() - started.keys()
    assert servo == "servo_node"
    given = nodes(found, servo="true")[servo]["parameters"][0]["moveit_servo"]
    assert given == yaml.safe_load((package / "config/servo.yaml").read_text(encoding="utf-8"))
    srdf = ET.parse(package / f"config/{robot}.srdf").find("virtual_joint")
    assert srdf is not None
    words = started["static_transform_publisher"]["arguments"]
    assert words == ["--frame-id", srdf.get("parent_frame"), "--child-frame-id", srdf.get("child_link")]


def test_rviz_shows_frames_that_there_are(robot: str, tmp_path: Path) -> None:
    package = written(tmp_path, robot)
    links = {row.get("name") for row in ET.parse(package / f"urdf/{robot}.urdf").findall("link")}
    view: dict[str, Any] = yaml.safe_load((package / "rviz/arm.rviz").read_text(encoding="utf-8"))
    view = view["Visualization Manager"]
    assert view["Global Options"]["Fixed Frame"] in links
    displays = {display["Class"].split("/")[1]: display for display in view["Displays"]}
    assert set(displays) == {"Grid", "RobotModel", "TF"}
    assert displays["RobotModel"]["Description Topic"]["Durability Policy"] == "Transient Local"
    assert {name for name, row in displays["TF"]["Frames"].items() if isinstance(row, dict)} == links
    panel = yaml.safe_load((package / "rviz/moveit.rviz").read_text(encoding="utf-8"))["Visualization Manager"]
    assert panel["Global Options"]["Fixed Frame"] == "world"
    (planning,) = (row for row in panel["Displays"] if row["Class"] == "moveit_rviz_plugin/MotionPlanning")
    assert planning["Planning Request"]["Planning Group"] == "arm"


def test_page_says_how_to_start_and_what_was_not_tried(robot: str) -> None:
    page = make_package(robot)["README.md"]
    assert f"ros2 launch {package_name(robot)} moveit.launch.py" in page
    assert "not by a ROS 2 installation" in page


def test_unknown_names_are_refused() -> None:
    with pytest.raises(UsageError, match="no ROS 2 distribution 'noetic'"):
        make_package("so101", distribution="noetic")
    with pytest.raises(UsageError, match="no geometry is known"):
        make_package("chain")
