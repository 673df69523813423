"""The node with several controllers, a robot that obeys gains, other names and simulated time.

How each kind of robot moves is tested in `drivers` and `control`.
"""

from __future__ import annotations

import json

import pytest
from tests.drivers.puma_server import served_puma
from tests.ros1.ros_world import Arm, World, near
from tests.waits import until

from hexwire.wire.robot_bodies import JointCommands

pytestmark = pytest.mark.slow
# A busy machine stalls longer than the usual 1 s.
PATIENT = "_watchdog:=10.0"
MOVEIT = {
    "arm_controller": {"joints": ["J1", "J2", "J3", "J4", "J5", "J6"], "constraints": {"goal_time": 3.0}},
    "gripper_controller": {"joints": ["J7"]},
}


def _columns(message: dict[str, list[float]]) -> dict[str, float]:
    return dict(zip(message["name"], message["position"], strict=True))


def test_two_controllers_move_at_once(world: World) -> None:
    port = world.folder / "two"
    world.board(port)
    node = world.node(
        "__ns:=two",
        *(f"_port:={port}", f"_controllers:={json.dumps(MOVEIT)}", "_enable_on_start:=true", PATIENT),
    )
    arm = Arm(world, node, "/two/")
    here = arm.position()
    target = {**here, "J1": here["J1"] + 0.3, "J7": here["J7"] + 0.3}
    six = {name: angle for name, angle in target.items() if name != "J7"}
    arm.send("arm", six, 1.5, "arm_controller/")
    arm.moves("gripper", {"J7": target["J7"]}, 1.0, "gripper_controller/")
    arm.succeeded("arm")
    assert near(target, arm.position())
    # Neither takes the other's joints.
    arm.send("wrong", {"J1": 0.0}, 1.0, "gripper_controller/")
    assert arm.result("wrong")["code"] == -2
    arm.send("partly", {"J1": 0.0}, 1.0, "arm_controller/")
    assert arm.result("partly")["code"] == -2
    # A stop is everybody's.
    arm.send("arm", {name: here[name] for name in six}, 5.0, "arm_controller/")
    arm.send("gripper", {"J7": here["J7"]}, 5.0, "gripper_controller/")
    arm.client.wait_active(key="arm")
    arm.client.wait_active(key="gripper")
    arm.trigger("stop")
    assert arm.result("arm")["state"] == arm.result("gripper")["state"] == "ABORTED"
    assert node.end() == 0


def test_gains_go_to_a_controller_that_obeys_them(world: World) -> None:
    with served_puma() as served:
        node = world.node("__ns:=gains", "_robot:=puma260", f"_port:={served.tcp}", "_enable_on_start:=true")
        arm = Arm(world, node, "/gains/")
        here = arm.position()
        served.robot.executed.clear()
        what = {"name": ["J1", "J5"], "position": [here["J1"] + 0.1, here["J5"] + 0.1]}
        gains = {"kp_position": [8.0, 8.0], "kd_position": [1.5, 1.5]}
        arm.client.joint_commands(topic="/gains/joint_commands", times=101, **what, **gains)

        def commands() -> list[JointCommands]:
            return [each for each in list(served.robot.executed) if isinstance(each, JointCommands)]

        sent = until(lambda: commands() or None, "they come", node.report)
        assert {(each.name, each.kp_position, each.kd_position) for each in sent} == {
            (("J1", "J5"), (8.0, 8.0), (1.5, 1.5))
        }
        assert "ignored" not in node.err
        # They end with the messages.
        until(lambda: not any(served.robot._gains), "the controller's own loop holds", node.report)
        arm.client.joint_commands(topic="/gains/joint_commands", velocity=[0.1, 0.1], **what)
        until(lambda: "gain; ignored: velocity" in node.err, "it is logged", node.report)
        arm.client.joint_commands(topic="/gains/joint_commands", kp_position=[1.0], **what)
        refused = "joint_commands refused: kp_position has 1 values for 2 names"
        until(lambda: refused in node.err, "it is logged", node.report)
        assert node.end() == 0


def test_names_follow_namespace_and_remappings(world: World) -> None:
    port = world.folder / "left"
    world.board(port)
    node = world.node(
        "__ns:=left",
        *("joint_states:=js", "__name:=arm", f"_port:={port}", "_frame_id:=left_base", "_diagnostics_rate:=0.001"),
    )
    (message,) = world.client.collect(topic="/left/js", kind="sensor_msgs/JointState")
    assert message["header"]["frame_id"] == "left_base"
    kinds = dict(world.client.topics())
    assert {"/left/state", "/left/follow_joint_trajectory/status", "/left/arm/taught"} <= set(kinds)
    assert "/left/joint_states" not in kinds
    # At this rate the next diagnostics that are no change come when nobody waits for them any more.
    world.client.watch(topic="/diagnostics", kind="diagnostic_msgs/DiagnosticArray")
    assert "all joints confirmed" in Arm(world, node, "/left/", name="arm").trigger("stop")

    def told() -> bool:
        rows = [row for message in world.client.seen(topic="/diagnostics") for row in message["status"]]
        return any(row["name"] == "left/arm: board" and "stopped" in row["message"] for row in rows)

    until(told, "the stop is told", node.report)
    assert node.end() == 0


def test_simulated_time_without_a_clock_holds_nothing_up(world: World) -> None:
    port = world.folder / "simulated"
    world.board(port)
    world.client.set_param(name="/use_sim_time", value=True)
    try:
        node = world.node(
            "__ns:=simulated",
            *(f"_port:={port}", "_enable_on_start:=true", "_allow_partial_joints_goal:=true", PATIENT),
        )
    finally:
        world.client.delete_param(name="/use_sim_time")
    arm = Arm(world, node, "/simulated/")
    arm.logged("use_sim_time")
    # There is no time yet, but an arm.
    (message,) = arm.client.collect(topic="/simulated/joint_states", kind="sensor_msgs/JointState")
    assert message["header"]["stamp"] == 0
    target = {"J1": _columns(message)["J1"] + 0.2}
    arm.client.command(topic="/simulated/command", names=["J1"], points=[{"t": 1.0, "positions": [target["J1"]]}])
    until(lambda: near(target, arm.position()), "it is there", node.report)
    arm.trigger("stop")
    assert node.end() == 0
