"""The node, as its users meet it: a real master, real clients in other processes, an emulated arm."""

from __future__ import annotations

import json
import math
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from tests.ros1.ros_world import JOINTS, Arm, near, still
from tests.waits import until


def _aside(arm: Arm, angle: float = 0.2) -> float:
    """A place for J1 so far away, towards its middle."""
    here = arm.position()["J1"]
    return here - math.copysign(angle, here)


# -- joint_states and controller state ---------------------------------------------------------------------


@pytest.mark.slow
def test_joint_states_have_the_stamps_of_their_samples(arm: Arm) -> None:
    messages = arm.client.collect(topic="/joint_states", kind="sensor_msgs/JointState", count=150)
    assert all(tuple(message["name"]) == JOINTS for message in messages)
    assert all(len(m["position"]) == len(m["velocity"]) == len(JOINTS) and not m["effort"] for m in messages)
    stamps = [message["header"]["stamp"] for message in messages]
    assert stamps == sorted(set(stamps))
    assert -0.01 < time.time() - stamps[-1] < 30.0, "of now, and never of the future"
    # A busy machine makes gaps, never a shorter period: those that it leaves alone are the short ones.
    steps = sorted(later - earlier for earlier, later in pairwise(stamps))
    assert 1 / 140 < steps[len(steps) // 4] < 1 / 60
    assert near(arm.position(), arm.board.positions)


def test_controller_state_says_what_is_desired_and_what_is(arm: Arm) -> None:
    (message,) = arm.client.collect(topic="/state", kind="control_msgs/JointTrajectoryControllerState")
    assert tuple(message["joint_names"]) == JOINTS
    actual = dict(zip(JOINTS, message["actual"]["positions"], strict=True))
    assert near(actual, arm.board.positions)
    assert near(dict(zip(JOINTS, message["desired"]["positions"], strict=True)), actual)


# -- commands ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_query_state_says_where_the_arm_is_meant_to_be_then(arm: Arm) -> None:
    service, here = f"{arm.namespace}query_state", arm.position()
    at_rest = arm.client.query(service=service, delay=0.0)
    assert tuple(at_rest["name"]) == JOINTS
    assert near(dict(zip(JOINTS, at_rest["position"], strict=True)), here)
    assert set(at_rest["velocity"]) == {0.0}
    target = here["J1"] - math.copysign(0.6, here["J1"])
    arm.send("one", {"J1": target}, 6.0)
    arm.client.wait_active(key="one")
    end = arm.client.query(service=service, delay=10.0)
    middle = arm.client.query(service=service, delay=1.0)
    assert end["position"][0] == pytest.approx(target)
    assert min(here["J1"], target) < middle["position"][0] < max(here["J1"], target)
    assert middle["velocity"][0] * (target - here["J1"]) > 0.0
    assert "is not available" in arm.client.query(service=service, delay=-30.0)["error"]
    arm.trigger("stop")
    assert "stopped" in arm.client.query(service=service, delay=0.0)["error"]


def test_command_moves_the_arm_and_an_empty_one_holds_it(arm: Arm) -> None:
    target = {"J1": _aside(arm, 0.6)}
    start = arm.board.positions
    arm.client.command(topic="/command", names=["J1"], points=[{"t": 4.0, "positions": [target["J1"]]}])
    until(lambda: not near(start, arm.board.positions), "it moves", arm.node.report)
    arm.client.command(topic="/command", names=[], points=[])
    stood = still(lambda: arm.board.positions)
    assert not near(target, stood)
    arm.client.command(topic="/command", names=["J1"], points=[{"t": 1.0, "positions": [start["J1"]]}])
    until(lambda: near({"J1": start["J1"]}, arm.board.positions), "it is back", arm.node.report)


WRONG_COMMANDS: dict[str, tuple[dict[str, Any], str]] = {
    "unknown joint": ({"names": ["elbow"], "points": [{"t": 1.0, "positions": [0.0]}]}, "elbow"),
    "not a number": ({"names": ["J1"], "points": [{"t": 1.0, "positions": [math.nan]}]}, "nan"),
    "past": ({"names": ["J1"], "points": [{"t": 1.0, "positions": [0.0]}], "delay": -100.0}, "ago"),
}


def test_positions_are_logged_as_the_chapters_node_does(arm: Arm) -> None:
    until(lambda: "hex7bot:: HW read (degree):\nJ1=" in arm.node.out, "positions are logged", arm.node.report)


def test_wrong_command_is_logged_and_moves_nothing(arm: Arm) -> None:
    before = arm.board.positions
    for case, (wrong, text) in WRONG_COMMANDS.items():
        said = len(arm.node.err)
        arm.client.command(topic="/command", **wrong)
        until(
            lambda said=said: "command refused" in arm.node.err[said:],  # type: ignore[misc]  # bound at once
            f"{case} is logged",
            arm.node.report,
        )
        assert text in arm.node.err[said:].lower(), case
        assert near(before, arm.board.positions, 0.002), case


# -- services ------------------------------------------------------------------------------------------------


def test_stop_and_reset_can_be_repeated(arm: Arm) -> None:
    for _ in range(2):
        assert arm.trigger("stop").startswith("stopped, ")
    assert "reset" in arm.refused("go_to/home")
    success, text = arm.client.switch(service=arm.service("enable"), on=True)
    assert not success
    assert "reset" in text
    for _ in range(2):
        assert arm.trigger("reset") == "reset; nothing moves until the next command"


@pytest.mark.slow
def test_a_burst_of_stops_is_few_stops_and_the_reset_after_it_stays(arm: Arm) -> None:
    callers, each = 32, 4
    counter = arm.board.board.stops
    begun, add = list[object](), counter.add

    def counted(*args: Any) -> Any:
        begun.append(args)
        return add(*args)

    counter.add = counted  # type: ignore[method-assign]
    try:
        assert arm.client.burst(service=arm.service("stop"), callers=callers, each=each) == callers * each
    finally:
        del counter.add
    # How many depends on how fast the calls come on a busy machine; if each is a stop, it is all of them.
    assert 1 <= len(begun) <= callers * each * 3 / 4
    assert arm.trigger("reset") == "reset; nothing moves until the next command"
    time.sleep(0.5)
    arm.enable()


def test_enable_gives_and_takes_torque(arm: Arm) -> None:
    servos = arm.board.board.wire.servos
    for on in (False, True):
        arm.enable(on)
        assert [servo.torque_on for servo in servos] == [on] * len(servos)


def test_pose_is_gone_to_and_stop_ends_that(arm: Arm) -> None:
    # Which joint still settles depends on the machine; the answer says it.
    assert arm.trigger("go_to/home").startswith("at home")
    assert near({"J1": -0.087, "J2": 0.96, "J3": -0.044}, arm.board.positions)
    arm.moves("away", {"J1": 0.3}, 1.5)


@pytest.mark.slow
def test_taught_motion_is_latched_saved_and_played(arm: Arm) -> None:
    arm.trigger("go_to/home")
    assert "the arm is not in teach mode" in arm.refused("teach/stop")
    assert "no torque" in arm.trigger("teach/start")
    assert not any(servo.torque_on for servo in arm.board.board.wire.servos)
    arm.send("one", {"J1": 0.0}, 1.0)
    assert "in teach mode" in arm.result("one")["text"]
    arm.board.lead("J1", 0.3, seconds=1.0)
    words = arm.trigger("teach/stop")
    assert words.startswith("taught ")
    assert all(servo.torque_on for servo in arm.board.board.wire.servos)
    led_to = arm.board.positions
    # Latched: this subscriber comes after it was published.
    (message,) = arm.client.collect(topic="/hardware_interface/taught", kind="trajectory_msgs/JointTrajectory")
    assert tuple(message["joint_names"]) == JOINTS
    assert near(dict(zip(JOINTS, message["points"][-1]["positions"], strict=True)), led_to)
    saved = json.loads(Path(words.rpartition(" saved as ")[2]).read_text())
    assert saved["joint_names"] == list(JOINTS)
    arm.trigger("go_to/home")
    assert "played" in arm.trigger("teach/play")
    assert near(led_to, arm.board.positions)


# -- diagnostics ---------------------------------------------------------------------------------------------


def test_diagnostics_come_with_every_servo_and_tell_a_stop(arm: Arm) -> None:
    messages = arm.client.collect(topic="/diagnostics", kind="diagnostic_msgs/DiagnosticArray", count=3)
    for message in messages:
        parts = ["link", "board", *(f"{name} (servo {i})" for i, name in enumerate(JOINTS))]
        assert [row["name"] for row in message["status"]] == [f"hardware_interface: {part}" for part in parts]
        assert {row["hardware_id"] for row in message["status"]} == {"arm-7"}
    values = {pair["key"]: pair["value"] for pair in messages[-1]["status"][2]["values"]}
    assert math.isclose(float(values["position (deg)"]), math.degrees(arm.board.positions["J1"]), abs_tol=1.0)
    stamps = [message["header"]["stamp"] for message in messages]
    assert stamps == sorted(set(stamps))
    arm.diagnosed("board", 0, "ok")
    arm.trigger("stop")
    row = arm.diagnosed("board", 1, "stopped: requested by service")
    assert {"key": "stopped", "value": "requested by service"} in row["values"]


def test_everything_is_where_it_was_promised(arm: Arm) -> None:
    kinds = dict(arm.client.topics())
    assert kinds["/joint_states"] == "sensor_msgs/JointState"
    assert kinds["/diagnostics"] == "diagnostic_msgs/DiagnosticArray"
    assert kinds["/state"] == "control_msgs/JointTrajectoryControllerState"
    assert kinds["/hardware_interface/taught"] == "trajectory_msgs/JointTrajectory"
    assert kinds["/follow_joint_trajectory/result"] == "control_msgs/FollowJointTrajectoryActionResult"
