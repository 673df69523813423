"""The ROS package folder: what ROS's own programs make of it, and that its numbers fit the arms."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from tests.ros1.launcher import ROS_PYTHON, Launcher

import hexwire.ros1
from hexwire.drivers.registry import load_driver
from hexwire.model.geometry import kinematics_or_none, make_kinematics
from hexwire.model.urdf import make_urdf
from hexwire.motion.checks import check_trajectory
from hexwire.motion.optimal import time_optimal
from hexwire.ros1.parameters import PARAMETERS, load_parameters

ROOT = Path(__file__).resolve().parents[2]
SHARE = Path(hexwire.ros1.__file__).resolve().parent / "share"
PACKAGE = SHARE / "hexwire"
SCRIPTS = sorted(path.name for path in (PACKAGE / "scripts").iterdir())
LAUNCH = sorted(path.name for path in (PACKAGE / "launch").glob("*.launch"))
NODE_FILES = sorted(path.name for path in (PACKAGE / "config").glob("*.yaml") if path.stem != "moveit_controllers")
PROGRAMS = str(Path(sys.executable).parent)


@dataclass
class Ros:
    """An environment in which ROS finds the package, and no master; and its `roslaunch`."""

    env: dict[str, str]
    folder: Path
    launcher: Launcher

    def launch(self, *args: str) -> str:
        """What `roslaunch` prints."""
        return self.launcher.call(self.env, self.folder, *args)


def _environment(folder: Path) -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if not name.startswith("ROS_")}
    return {
        **kept,
        "PATH": f"{PROGRAMS}:{os.environ['PATH']}",
        "ROS_PACKAGE_PATH": str(SHARE),
        "ROS_HOME": str(folder / "ros"),
        "ROS_IP": "127.0.0.1",
        "ROS_MASTER_URI": "http://127.0.0.1:9",
        "TMPDIR": str(folder),
    }


@pytest.fixture(scope="module")
def launcher(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Launcher]:
    with Launcher(_environment(tmp_path_factory.mktemp("launcher"))) as launcher:
        yield launcher


@pytest.fixture
def ros(tmp_path: Path, launcher: Launcher) -> Ros:
    return Ros(_environment(tmp_path), tmp_path, launcher)


def _run(env: dict[str, str], *command: str) -> str:
    result = subprocess.run(command, env=env, capture_output=True, text=True, timeout=100, check=False)
    assert result.returncode == 0, result.stderr
    return result.stdout


def _yaml(text: str) -> Any:
    """What ROS's own YAML reader makes of a text."""
    program = "import json, sys, yaml; print(json.dumps(yaml.safe_load(sys.stdin)))"
    result = subprocess.run(
        [ROS_PYTHON, "-c", program], input=text, capture_output=True, text=True, timeout=60, check=True
    )
    return json.loads(result.stdout)


def _config(name: str) -> Any:
    return _yaml((PACKAGE / "config" / name).read_text(encoding="utf-8"))


def _params(ros: Ros, file: str, *args: str) -> dict[str, Any]:
    dumped: dict[str, Any] = _yaml(ros.launch("--dump-params", "hexwire", file, *args))
    return dumped


# -- the manifest -----------------------------------------------------------------------------------------


def test_manifest_is_one_that_ros_reads() -> None:
    program = (
        "import json, sys; from catkin_pkg.package import parse_package; "
        "p = parse_package(sys.argv[1]); p.validate(); "
        "print(json.dumps([p.name, p.version, p.licenses, [d.name for d in p.exec_depends]]))"
    )
    result = subprocess.run(
        [ROS_PYTHON, "-c", program, str(PACKAGE)], capture_output=True, text=True, timeout=60, check=True
    )
    name, version, licences, needed = json.loads(result.stdout)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert (name, version, licences) == ("hexwire", project["version"], [project["license"].split(" AND ")[0]])
    assert {"rospy", "actionlib", "robot_state_publisher"} <= set(needed)


def test_rospack_finds_the_package(ros: Ros) -> None:
    program = "import rospkg; print(rospkg.RosPack().get_path('hexwire'))"
    assert _run(ros.env, ROS_PYTHON, "-c", program).strip() == str(PACKAGE)


def test_cmake_installs_everything() -> None:
    text = (PACKAGE / "CMakeLists.txt").read_text(encoding="utf-8")
    assert sorted(re.findall(r"scripts/(\w+)", text)) == SCRIPTS
    folders = re.search(r"install\(DIRECTORY ([\w ]+) DESTINATION", text)
    assert folders is not None
    assert {*folders[1].split(), "scripts"} == {path.name for path in PACKAGE.iterdir() if path.is_dir()}


def test_every_node_of_the_launch_files_is_there() -> None:
    types = {
        node.attrib["type"]
        for file in LAUNCH
        for node in ET.parse(PACKAGE / "launch" / file).iter("node")
        if node.attrib["pkg"] == "hexwire"
    }
    assert types == {"hardware_interface", "emulated_board"}
    assert types <= set(SCRIPTS)


# -- scripts ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("script", SCRIPTS)
def test_script_is_executable_and_plain_sh(script: str) -> None:
    path = PACKAGE / "scripts" / script
    assert os.access(path, os.X_OK)
    assert path.read_text(encoding="utf-8").startswith("#!/bin/sh\n")
    subprocess.run(["/bin/sh", "-n", str(path)], check=True, timeout=60)


def _stub(folder: Path, *names: str) -> dict[str, str]:
    """A PATH on which the programs are ones that print how they were called."""
    folder.mkdir()
    for name in names:
        program = folder / name
        program.write_text('#!/bin/sh\necho "$0" "$@"\n')
        program.chmod(0o755)
    return {"PATH": f"{folder}:/usr/bin:/bin"}


@pytest.mark.parametrize("script", SCRIPTS)
def test_script_without_hexwire_says_what_to_do(script: str, tmp_path: Path) -> None:
    result = subprocess.run(
        [str(PACKAGE / "scripts" / script), "hex7bot", "A"],
        env=_stub(tmp_path / "empty"),
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert "hexwire-ros1 --env" in result.stderr


def test_node_gets_the_arguments_of_ros_untouched(tmp_path: Path) -> None:
    env = _stub(tmp_path / "bin", "hexwire-ros1")
    args = ["_port:=/dev/tty USB0", "__name:=x", "command:=foo"]
    out = _run(env, str(PACKAGE / "scripts" / "hardware_interface"), *args)
    assert out == f"{tmp_path}/bin/hexwire-ros1 {' '.join(args)}\n"


@pytest.mark.parametrize(
    ("robot", "port", "called"),
    [
        ("hex7bot", "/tmp/a b", "sim board --link /tmp/a b --physics"),
        ("puma260", "tcp://127.0.0.1:15030", "sim puma260 --tcp 127.0.0.1:15030 --physics"),
        ("so101", "/tmp/a", "sim bus --arm so101 --link /tmp/a --physics"),
        ("chain", "/tmp/a", "sim bus --ids 1-6 --link /tmp/a --physics"),
    ],
)
def test_emulated_board_takes_out_what_is_meant_for_nodes(
    robot: str, port: str, called: str, tmp_path: Path
) -> None:
    env = _stub(tmp_path / "bin", "hexwire")
    script = str(PACKAGE / "scripts" / "emulated_board")
    out = _run(env, script, robot, port, "--physics", "__name:=emulated_board", "__log:=/a b")
    assert out == f"{tmp_path}/bin/hexwire {called}\n"


def test_hexwire_is_found_beside_the_node(tmp_path: Path) -> None:
    """A link to hexwire-ros1 alone may be on PATH."""
    env = _stub(tmp_path / "bin", "hexwire-ros1", "hexwire")
    out = _run(env, str(PACKAGE / "scripts" / "robot_description"), "hex7bot", "B")
    assert out == f"{tmp_path}/bin/hexwire model urdf --robot hex7bot --links B\n"


def test_emulated_board_of_an_unknown_robot_says_so(ros: Ros) -> None:
    script = str(PACKAGE / "scripts" / "emulated_board")
    result = subprocess.run(
        [script, "mine.toml", "/tmp/x"], env=ros.env, capture_output=True, text=True, timeout=60
    )
    assert result.returncode == 2
    assert result.stderr == (
        "error: there is no emulated mine.toml; start one yourself (hexwire sim --help) and give its port\n"
    )


# -- launch files -----------------------------------------------------------------------------------------


def _nodes(ros: Ros, file: str, *args: str) -> set[str]:
    return set(ros.launch("--nodes", "hexwire", file, *args).split())


HARDWARE = "/hardware_interface"
FRAMES = "/robot_state_publisher"
BOARD = "/emulated_board"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "args", "nodes"),
    [
        ("hardware.launch", [], {HARDWARE, FRAMES}),
        ("hardware.launch", ["sim:=true"], {HARDWARE, FRAMES, BOARD}),
        ("hardware.launch", ["robot:=puma260", "sim:=1"], {HARDWARE, FRAMES, BOARD}),
        ("hardware.launch", ["robot:=so101"], {HARDWARE, FRAMES}),
        ("hardware.launch", ["robot:=sevenbot"], {HARDWARE}),
        ("hardware.launch", ["robot_state_publisher:=false"], {HARDWARE}),
        ("hardware.launch", ["load_robot_description:=false"], {HARDWARE}),
        ("display.launch", ["sim:=true"], {HARDWARE, FRAMES, BOARD, "/rviz"}),
        ("moveit_hardware.launch", [], {HARDWARE}),
        ("moveit_hardware.launch", ["robot_description:=true", "sim:=true"], {HARDWARE, FRAMES, BOARD}),
    ],
)
def test_launch_file_starts(file: str, args: list[str], nodes: set[str], ros: Ros) -> None:
    assert _nodes(ros, file, *args) == nodes


def test_every_launch_file_is_among_the_tested_ones() -> None:
    assert LAUNCH == ["display.launch", "hardware.launch", "moveit_hardware.launch"]


@pytest.mark.slow
def test_emulated_board_and_node_have_the_same_port(ros: Ros) -> None:
    command = ros.launch("--args", BOARD, "hexwire", "hardware.launch", "sim:=true", "port:=/tmp/a b")
    assert "scripts/emulated_board hex7bot /tmp/a b " in command
    params = _params(ros, "hardware.launch", "sim:=true", "port:=/tmp/a b")
    assert params["/hardware_interface/port"] == "/tmp/a b"


@pytest.mark.slow
def test_emulated_board_has_a_port_of_its_own(ros: Ros) -> None:
    first, second = (_params(ros, "hardware.launch", "sim:=true")["/hardware_interface/port"] for _ in range(2))
    assert first != second
    assert {str(Path(first).parent), str(Path(second).parent)} == {ros.env["TMPDIR"]}


@pytest.mark.slow
def test_display_passes_everything_on(ros: Ros) -> None:
    args = ["port:=/dev/ttyX", "links:=B", f"params:={PACKAGE}/config/hex7bot_moveit.yaml"]
    assert _params(ros, "display.launch", *args) == _params(ros, "hardware.launch", *args)


@pytest.mark.slow
def test_description_is_the_urdf_of_the_links_that_the_node_has(ros: Ros) -> None:
    params = _params(ros, "hardware.launch", "links:=B")
    assert params["/hardware_interface/links"] == "B"
    assert params["/robot_description"] == make_urdf(make_kinematics("hex7bot", "B"))


@pytest.mark.slow
def test_a_namespace_takes_everything_with_it(ros: Ros, tmp_path: Path) -> None:
    file = tmp_path / "two.launch"
    hardware = PACKAGE / "launch" / "hardware.launch"
    include = '<include ns="{0}" file="{1}"><arg name="port" value="/dev/{0}"/></include>'
    both = "".join(include.format(ns, hardware) for ns in ("left", "right"))
    file.write_text(f"<launch>{both}</launch>")
    assert set(ros.launch("--nodes", str(file)).split()) == {
        f"/{ns}/{node}" for ns in ("left", "right") for node in ("hardware_interface", "robot_state_publisher")
    }
    names = _yaml(ros.launch("--dump-params", str(file)))
    assert {name.split("/")[1] for name in names} == {"left", "right"}


@pytest.mark.slow
def test_frames_of_two_arms_can_be_told_apart(ros: Ros) -> None:
    prefix = "/robot_state_publisher/tf_prefix"
    assert _params(ros, "hardware.launch", "sim:=true", "tf_prefix:=left")[prefix] == "left"
    assert prefix not in _params(ros, "hardware.launch", "sim:=true")


def test_a_node_that_ends_is_not_restarted_unasked() -> None:
    for node in ET.parse(PACKAGE / "launch" / "hardware.launch").getroot().iter("node"):
        assert node.get("respawn", "false") in ("false", "$(arg respawn)"), node.get("name")


@pytest.mark.slow
def test_moveit_is_told_of_the_controllers_that_the_node_has(ros: Ros) -> None:
    node = _config("hex7bot_moveit.yaml")["controllers"]
    params = _params(ros, "simple_moveit_controller_manager.launch.xml")
    assert params["/moveit_controller_manager"].startswith("moveit_simple_controller_manager/")
    told = params["/controller_list"]
    assert {row["name"]: row["joints"] for row in told} == {name: c["joints"] for name, c in node.items()}
    assert {(row["action_ns"], row["type"]) for row in told} == {
        ("follow_joint_trajectory", "FollowJointTrajectory")
    }


# -- parameter files --------------------------------------------------------------------------------------


def test_every_robot_that_is_offered_has_its_parameters() -> None:
    text = (PACKAGE / "launch" / "hardware.launch").read_text(encoding="utf-8")
    offered = re.search(r'name="robot" default="hex7bot" doc="([\w, ]+), or an arm', text)
    assert offered is not None
    assert {f"{name}.yaml" for name in offered[1].split(", ")} == {*NODE_FILES} - {"hex7bot_moveit.yaml"}


@pytest.mark.parametrize("file", NODE_FILES)
def test_parameters_are_ones_that_the_node_takes(file: str) -> None:
    params = _config(file)
    parameters, driver = load_parameters({**params, "port": "/dev/ttyUSB0"})
    settings = parameters.settings
    assert settings.model.name == params["robot"] == file.removesuffix(".yaml").removesuffix("_moveit")
    assert set(settings.poses) == set(params["poses"])
    assert driver.model is settings.model


@pytest.mark.slow
@pytest.mark.parametrize("args", [["hex7bot"], ["puma260"], ["so100"], ["so101"], ["sevenbot"]])
def test_parameters_of_a_launch_are_ones_that_the_node_takes(args: list[str], ros: Ros) -> None:
    """With what the launch file adds, and in the types that roslaunch makes of it."""
    params = _params(ros, "hardware.launch", f"robot:={args[0]}", "sim:=true")
    own: dict[str, Any] = {}
    for name, value in params.items():
        *folders, last = name.removeprefix("/").split("/")
        if folders[:1] == ["hardware_interface"]:
            place = own
            for folder in folders[1:]:
                place = place.setdefault(folder, {})
            place[last] = value
    settings = load_parameters(own)[0].settings
    assert settings.model.name == args[0]
    assert set(own) <= {row.name for row in PARAMETERS}


@pytest.mark.parametrize("file", NODE_FILES)
def test_arm_may_go_from_every_pose_to_every_other(file: str) -> None:
    settings = load_parameters({**_config(file), "port": "/dev/ttyUSB0"})[0].settings
    arm = settings.model
    # The sevenbot has the hex7bot's joints, whose geometry it may be judged by.
    kinematics = settings.kinematics or kinematics_or_none(
        "hex7bot" if arm.name == "sevenbot" else arm.name, for_motion=True
    )
    others = {joint.name: joint.offset for joint in arm.joints}
    for name, start in settings.poses.items():
        for other, goal in settings.poses.items():
            joints = list(goal)
            assert joints == list(start), "each pose says it of the same joints"
            speeds = [settings.pose_speed * arm.joint(joint).max_speed for joint in joints]
            way = time_optimal(joints, list(start.values()), list(goal.values()), speeds, [6.0] * len(joints))
            report = check_trajectory(way, arm, kinematics, others=others)
            assert not report.findings, f"{name} to {other}: {report.findings[0]}"


@pytest.mark.parametrize("robot", ["hex7bot", "puma260"])
def test_arm_with_a_geometry_may_be_told_to_rest_near_the_table_but_not_on_it(robot: str) -> None:
    settings = load_parameters({**_config(f"{robot}.yaml"), "port": "/dev/ttyUSB0"})[0].settings
    assert settings.kinematics is not None
    for name, pose in settings.poses.items():
        points = settings.kinematics.points(settings.kinematics.from_joints(pose))
        assert min(place[2] for place in points.values()) >= 0.08, name


# -- rviz -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", ["hex7bot", "puma260", "so100", "so101"])
def test_rviz_shows_frames_that_the_urdf_has(robot: str) -> None:
    view = _yaml((PACKAGE / "rviz" / "hexwire.rviz").read_text(encoding="utf-8"))["Visualization Manager"]
    root = ET.fromstring(make_urdf(make_kinematics(robot)))
    links = {link.attrib["name"] for link in root.iter("link")}
    roots = links - {child.attrib["link"] for child in root.iter("child")}
    assert {view["Global Options"]["Fixed Frame"]} == roots
    displays = {display["Class"]: display for display in view["Displays"]}
    assert set(displays) == {"rviz/Grid", "rviz/RobotModel", "rviz/TF"}
    assert displays["rviz/RobotModel"]["Robot Description"] == "robot_description"
    shown = {name for name, row in displays["rviz/TF"]["Frames"].items() if isinstance(row, dict) and row["Value"]}
    assert shown <= links
    assert links <= set(displays["rviz/TF"]["Frames"]), "a frame that is not named is shown"


@pytest.mark.slow
def test_robots_of_the_files_are_ones_that_are_installed() -> None:
    for file in NODE_FILES:
        load_driver(_config(file)["robot"])
    assert shutil.which("roslaunch")
