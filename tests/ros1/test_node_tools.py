"""The node with ROS's own programs: what a person types in a second terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tests.model.poses import pose_error
from tests.ros1.ros_world import HEXWIRE, JOINTS, Arm, World, near, still
from tests.waits import until

import hexwire.ros1
from hexwire.model.geometry import make_kinematics, make_shapes
from hexwire.model.pose import Pose, apply, multiply

ROOT = Path(__file__).resolve().parent.parent.parent
SHARE = Path(hexwire.ros1.__file__).resolve().parent / "share"


@pytest.mark.slow
def test_programs_of_ros_find_the_node_read_it_and_stop_it(arm: Arm) -> None:
    head, row = arm.world.run("rostopic", "echo", "-n1", "-p", "/joint_states").out.splitlines()
    values = dict(zip(head.split(","), row.split(","), strict=True))
    angles = {name: float(values[f"field.position{i}"]) for i, name in enumerate(JOINTS)}
    assert [values[f"field.name{i}"] for i in range(len(JOINTS))] == list(JOINTS)
    assert near(angles, arm.board.positions)
    info = arm.world.run("rosnode", "info", "/hardware_interface").out
    assert f"Pid: {arm.node.process.pid}" in info
    assert "/joint_states [sensor_msgs/JointState]" in info
    names = ("stop", "reset", "enable", "go_to/home", "teach/start", "teach/stop", "teach/play")
    assert all(f"* {arm.service(name)}\n" in info for name in names)
    parameters = arm.world.run("rosparam", "get", "/hardware_interface").out
    assert "/ipc_msg.conf" in parameters
    assert "goal_time: 3.0" in parameters
    out = arm.world.run("rosservice", "call", arm.service("stop")).out
    assert "success: True" in out
    assert "all joints confirmed" in out
    out = arm.world.run("rosservice", "call", arm.service("enable"), "true").out
    assert "success: False" in out
    assert "reset" in out


def test_the_example_moves_the_arm(arm: Arm) -> None:
    before = arm.position()["J1"]
    out = arm.world.run("/usr/bin/python3", str(ROOT / "examples" / "ros1_client.py")).out
    first, last = (float(line.split()[3]) for line in out.splitlines())
    assert (first, last) == (pytest.approx(before, abs=0.02), pytest.approx(before + 0.2, abs=0.03))
    until(lambda: near({"J1": before + 0.2}, arm.board.positions), "it is there", arm.node.report)


@pytest.mark.slow
def test_robot_state_publisher_puts_the_tool_where_the_model_does(arm: Arm) -> None:
    urdf = arm.world.run(*HEXWIRE, "model", "urdf").out
    arm.client.set_param(name="robot_description", value=urdf)
    publisher = arm.world.start("/usr/lib/robot_state_publisher/robot_state_publisher")
    try:
        arm.moves("pose", {"J1": -0.3, "J2": 1.1, "J3": 0.2, "J5": 0.4, "J6": 0.3}, 2.0)
        stood = still(lambda: arm.board.positions)
        model = make_kinematics("hex7bot", "A")
        wanted = model.forward(model.from_joints(stood))
        fixed = arm.client.collect(topic="/tf_static", kind="tf2_msgs/TFMessage")
        moving = arm.client.collect(topic="/tf", kind="tf2_msgs/TFMessage", count=20)
        # The last of each link counts.
        links = {row["child_frame_id"]: row for message in fixed + moving for row in message["transforms"]}
        assert pose_error(_pose(links, "tool"), wanted) < 0.01
        # Those that only follow are published too.
        shown = make_shapes(model).poses(stood)
        assert [name for name in ("jaw_left", "jaw_right", "rod") if name not in links] == []
        assert all(pose_error(_pose(links, name), shown[name]) < 0.01 for name in ("jaw_left", "jaw_right", "rod"))
    finally:
        publisher.kill_all()
        arm.client.delete_param(name="robot_description")


def _pose(links: dict[str, Any], tip: str) -> Pose:
    """Of a link in the frame that has no parent."""
    if tip not in links:
        return Pose((0.0, 0.0, 0.0), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    row = links[tip]
    parent = _pose(links, row["header"]["frame_id"])
    x, y, z, w = (row["transform"]["rotation"][axis] for axis in "xyzw")
    turn = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    step = apply(parent.rotation, [row["transform"]["translation"][axis] for axis in "xyz"])
    at = (parent.position[0] + step[0], parent.position[1] + step[1], parent.position[2] + step[2])
    return Pose(at, multiply(parent.rotation, turn))


@pytest.mark.slow
def test_roslaunch_brings_up_an_emulated_arm(world: World) -> None:
    launch = world.start(
        *("roslaunch", "hexwire", "hardware.launch", "sim:=true", "sim_options:=--baud 0", "__ns:=launched"),
        ROS_PACKAGE_PATH=str(SHARE),
        ROS_NAMESPACE="launched",
        PYTHONUNBUFFERED="1",
    )
    launch.said("is ready at")
    arm = Arm(world, launch, "/launched/")
    arm.enable()
    # Which joint still settles depends on the machine; the answer says it.
    assert arm.trigger("go_to/ready").split(", ")[0] == "at ready"
    assert near({"J2": 0.904, "J3": 0.499, "J5": 1.029}, arm.position(), 0.05)
    transforms = world.client.collect(topic="/tf", kind="tf2_msgs/TFMessage")[0]["transforms"]
    assert "base" in {transform["header"]["frame_id"] for transform in transforms}
    launch.kill_all()
