"""The node with every kind of robot, every distribution, several controllers, other names, and a shared arm."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.drivers.puma_server import served_puma
from tests.ros1.ros_world import HEXWIRE, serving_patiently
from tests.ros2.node_fixtures import SETTINGS, world
from tests.ros2.node_world import JOINTS, SUCCEEDED, Arm, Goal, PtyBoard, World, near, until

from hexwire.drivers import registry
from hexwire.wire.robot_bodies import JointCommands
from zenoh_ros2.distributions import Distribution
from zenoh_ros2.qos import LATCHED

__all__ = ["world"]

pytestmark = pytest.mark.system
STATE, STRING = "sensor_msgs/msg/JointState", "std_msgs/msg/String"


@pytest.mark.slow
@pytest.mark.parametrize("distribution", list(Distribution), ids=lambda each: each.value)
def test_clients_of_every_distribution_move_the_controllers_of_the_package(
    world: World, distribution: Distribution
) -> None:
    """The parameters are those of `hexwire model ros2-package`, which MoveIt's configuration goes with."""
    folder, at = world.folder / distribution.value, f"/{distribution.value}/"
    made = world.start(
        *HEXWIRE, "model", "ros2-package", str(folder), "--robot", "hex7bot", "--distribution", distribution.value
    )
    assert made.wait() == 0, made.report()
    (file,) = folder.glob("**/hardware_interface.yaml")
    board = PtyBoard(world.folder / f"{distribution.value}-arm")
    try:
        node = world.node(
            *("-r", f"__ns:={at.rstrip('/')}", "--params-file", str(file), "-p", f"port:={board.port}"),
            # A busy machine stalls longer than the usual 1 s.
            *("-p", "enable_on_start:=true", "-p", "watchdog:=4.0"),
        )
        arm = Arm(world, node, board, world.peer("client", distribution), at)
        here = arm.position()
        six = {name: here[name] for name in JOINTS[:6]} | {"J1": here["J1"] + 0.2}
        goal = Goal(arm, (1.0, six), controller="arm_controller")
        gripper = Goal(arm, (1.0, {"J7": here["J7"] + 0.2}), controller="gripper_controller")
        state = "control_msgs/msg/JointTrajectoryControllerState"
        (message,) = arm.peer.collect(f"{at}arm_controller/controller_state", state)
        assert tuple(message.joint_names) == JOINTS[:6]
        assert hasattr(message, "desired") == (distribution is Distribution.HUMBLE)
        assert goal.result()[0] == SUCCEEDED
        assert gripper.result()[0] == SUCCEEDED
        assert near({"J1": here["J1"] + 0.2, "J7": here["J7"] + 0.2}, board.positions)
        # Neither takes the other's joints.
        assert not Goal(arm, (1.0, {"J1": 0.0}), controller="gripper_controller").accepted
        arm.peer.close()
        assert node.end() == 0
    finally:
        board.close()


SEVEN = "seven_bot,seven_bot,seven_bot,seven_bot,hls,hls,hls"
EMULATED = {
    "puma260": ("puma260", "--tcp", "127.0.0.1:0"),
    "so100": ("bus", "--arm", "so100"),
    "so101": ("bus", "--arm", "so101"),
    "sevenbot": ("bus", "--series", SEVEN, "--ids", "0-6", "--baud", "115200"),
}


def emulated(world: World, robot: str) -> str:
    """An emulated arm in a process of its own; returns its address."""
    link = world.folder / f"{robot}-arm"
    options = EMULATED[robot] if robot == "puma260" else (*EMULATED[robot], "--link", str(link))
    program = world.start(*HEXWIRE, "sim", *options)
    until(lambda: program.out.endswith("\n") or not program.running, "it is served", program.report)
    assert program.running, program.report()
    return program.out.split()[0] if robot == "puma260" else str(link)


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["puma260", "so100", "so101"])
def test_every_robot_with_a_geometry_moves_and_has_a_description(world: World, robot: str) -> None:
    at, port = f"/{robot}/", emulated(world, robot)
    node = world.node("-r", f"__ns:=/{robot}", "-p", f"robot:={robot}", "-p", f"port:={port}", *SETTINGS)
    arm = Arm(world, node, at=at)
    here = arm.position()
    joint = next(iter(here))
    # The text may say how far off a joint came to rest.
    # Sent again while the arm has no recent states: a busy machine lets its program wait.
    until(
        lambda: Goal(arm, (1.5, {joint: here[joint] + 0.1})).result()[:2] == (SUCCEEDED, 0),
        "the arm takes the goal",
    )
    assert near({joint: here[joint] + 0.1}, arm.position())
    (message,) = arm.peer.collect(f"{at}robot_description", STRING, qos=LATCHED)
    assert all(f'<joint name="{name}"' in message.data for name in here)
    arm.peer.close()
    assert node.end() == 0


@pytest.mark.slow
def test_gains_go_to_a_controller_that_obeys_them(world: World) -> None:
    with served_puma() as served:
        on = ("-p", "enable_on_start:=true")
        node = world.node("-r", "__ns:=/gains", "-p", "robot:=puma260", "-p", f"port:={served.tcp}", *on)
        arm = Arm(world, node, at="/gains/")
        here = arm.position()
        served.robot.executed.clear()
        what = {"name": ["J1", "J5"], "position": [here["J1"] + 0.1, here["J5"] + 0.1]}
        gains = {"kp_position": [8.0, 8.0], "kd_position": [1.5, 1.5]}

        def publish(**fields: Any) -> None:
            arm.peer.publish("/gains/joint_commands", "osrf_msgs/msg/JointCommands", **what, **fields)

        for _ in range(101):
            publish(**gains)
            time.sleep(0.02)
        sent = [each for each in served.robot.executed if isinstance(each, JointCommands)]
        assert sent
        assert {(each.name, each.kp_position, each.kd_position) for each in sent} == {
            (("J1", "J5"), (8.0, 8.0), (1.5, 1.5))
        }
        assert "ignored" not in node.err
        # They end with the messages.
        until(lambda: not any(served.robot._gains), "the controller's own loop holds", node.report)
        publish(velocity=[0.1, 0.1])
        until(lambda: "gain; ignored: velocity" in node.err, "it is logged", node.report)
        publish(kp_position=[1.0])
        until(lambda: "kp_position has 1 values for 2 names" in node.err, "it is logged", node.report)
        arm.peer.close()
        assert node.end() == 0


@pytest.mark.slow
def test_a_robot_without_a_geometry_has_no_description(world: World) -> None:
    port = emulated(world, "sevenbot")
    node = world.node("-r", "__ns:=/seven", "-p", "robot:=sevenbot", "-p", f"port:={port}")
    arm = Arm(world, node, at="/seven/")
    assert set(arm.position()) <= set(JOINTS)
    assert not any(each.name == "/seven/robot_description" for each in arm.peer.node.graph)
    assert node.end() == 0
    arm.peer.close()


@pytest.mark.slow
def test_names_follow_namespace_and_remappings(world: World, tmp_path: Path) -> None:
    board = PtyBoard(tmp_path / "left")
    try:
        node = world.node(
            *("-r", "__ns:=/left", "-r", "__node:=arm", "-r", "joint_states:=js", "-p", f"port:={board.port}"),
            *("-r", "joint_trajectory_controller/follow_joint_trajectory/_action/send_goal:=go/_action/send_goal"),
            *("-p", "frame_id:=left_base", "-p", "robot_description:=<robot name='mine'/>"),
        )
        peer = world.peer()
        (message,) = peer.collect("/left/js", STATE)
        assert message.header.frame_id == "left_base"
        (description,) = peer.collect("/left/robot_description", STRING, qos=LATCHED)
        assert description.data == "<robot name='mine'/>"
        answer = peer.call("/left/arm/stop", "std_srvs/srv/Trigger")
        assert answer.success
        names = {each.name for each in peer.node.graph if each.namespace == "/left"}
        assert {"/left/arm/taught", "/left/go/_action/send_goal", "/diagnostics"} <= names
        assert "/left/joint_states" not in names
        rows = peer.collect("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", 3)
        assert any(row.name == "arm: board" for message in rows for row in message.status)
        peer.close()
        assert node.end() == 0
    finally:
        board.close()


@pytest.mark.slow
def test_topics_that_are_not_wanted_are_not_there(world: World, tmp_path: Path) -> None:
    file = tmp_path / "quiet.yaml"
    file.write_text(
        "/**:\n  ros__parameters:\n    joint_states_topic: ''\n    joint_commands_topic: ''\n"
        "    publish_robot_description: false\n"
    )
    board = PtyBoard(tmp_path / "quiet")
    try:
        node = world.node("-r", "__ns:=/quiet", "--params-file", str(file), "-p", f"port:={board.port}")
        peer = world.peer()
        peer.collect("/quiet/joint_states", STATE)
        names = {each.name for each in peer.node.graph if each.namespace == "/quiet"}
        assert not names & {
            "/quiet/robot_joint_states",
            "/quiet/robot_joint_commands",
            "/quiet/robot_description",
            "/tf",
        }
        peer.close()
        assert node.end() == 0
    finally:
        board.close()


# -- an arm that other programs share ---------------------------------------------------------------------------


@pytest.fixture
def shared(world: World) -> Iterator[Arm]:
    """A node, and the arm behind it, whose server is this process."""
    folder = world.folder / "run"
    folder.mkdir(mode=0o700, exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        for name in ("XDG_RUNTIME_DIR", "XDG_STATE_HOME"):
            patch.setenv(name, str(folder))
            world.env[name] = str(folder)
        board = PtyBoard(world.folder / "shared-arm")
        try:
            with serving_patiently(board, patch):
                node = world.node(
                    *("-r", "__ns:=/shared", "-p", "port:=zenoh:lab/arm1", "-p", "publish_rate:=50.0"),
                    *("-p", "allow_partial_joints_goal:=true"),
                )
                arm = Arm(world, node, board, at="/shared/")
                yield arm
                arm.peer.close()
                assert node.end() == 0
        finally:
            board.close()


def test_a_shared_arm_is_commanded_by_who_holds_it(shared: Arm) -> None:
    shared.trigger("reset")
    shared.enable()
    here = shared.position()
    status, _, text = Goal(shared, (1.5, {"J1": here["J1"] + 0.2})).result()
    assert status == SUCCEEDED, text
    with registry.connect("zenoh:lab/arm1?take=1") as other:
        other.stop()
        until(lambda: shared.board.board.state.stopped, "another program stops it", shared.node.report)
        shared.diagnosed("board", 2, "stopped")
    assert not Goal(shared, (1.5, here)).accepted
