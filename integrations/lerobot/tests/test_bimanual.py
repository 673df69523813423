"""Two arms as one, beside LeRobot's own class: its names, its files, and no side that stays open alone."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from dataclasses import dataclass

import draccus
import pytest
from emulated import bus, calibrated
from lerobot.robots import RobotConfig, make_robot_from_config
from lerobot.robots.bi_so_follower import BiSOFollower, BiSOFollowerConfig
from lerobot.robots.so_follower import SOFollowerConfig
from lerobot.teleoperators import TeleoperatorConfig, make_teleoperator_from_config
from lerobot.teleoperators.bi_so_leader import BiSOLeader, BiSOLeaderConfig
from lerobot.teleoperators.so_leader import SOLeaderConfig
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from lerobot_robot_hexwire import BiHexwireSO101, BiHexwireSO101Leader

from hexwire.bus.servo_bus import ServoBus

SIDES = ("left", "right")


@dataclass
class Robots:
    robot: RobotConfig


@dataclass
class Teleops:
    teleop: TeleoperatorConfig


def follower(left: str, right: str) -> BiHexwireSO101:
    """As `lerobot-teleoperate --robot.type=bi_hexwire_so101 ...` makes it."""
    words = ["--robot.type=bi_hexwire_so101", "--robot.id=two"]
    words += [f"--robot.left_arm_config.port={left}", f"--robot.right_arm_config.port={right}"]
    words.append("--robot.left_arm_config.max_relative_target=5.0")
    robot = make_robot_from_config(draccus.parse(Robots, args=words).robot)
    assert isinstance(robot, BiHexwireSO101)
    return robot


def leader(left: str, right: str) -> BiHexwireSO101Leader:
    words = ["--teleop.type=bi_hexwire_so101_leader", "--teleop.id=two"]
    words += [f"--teleop.left_arm_config.port={left}", f"--teleop.right_arm_config.port={right}"]
    teleop = make_teleoperator_from_config(draccus.parse(Teleops, args=words).teleop)
    assert isinstance(teleop, BiHexwireSO101Leader)
    return teleop


@pytest.fixture
def ports() -> Iterator[list[str]]:
    with bus("--baud", "0") as left, bus("--baud", "0") as right:
        for port, side in zip((left, right), SIDES, strict=True):
            calibrated(port, f"two_{side}")
        yield [left, right]


@pytest.fixture
def leader_ports() -> Iterator[list[str]]:
    with bus("--leader", "--baud", "0") as left, bus("--leader", "--baud", "0") as right:
        for port, side in zip((left, right), SIDES, strict=True):
            calibrated(port, f"two_{side}", leader=True)
        yield [left, right]


def test_names_and_files_are_those_of_lerobots_own_arms() -> None:
    ours = follower("/dev/none1", "/dev/none2")
    arms = [SOFollowerConfig(port=f"/dev/none{i}") for i in (1, 2)]
    own = BiSOFollower(BiSOFollowerConfig(id="two", left_arm_config=arms[0], right_arm_config=arms[1]))
    assert ours.action_features == own.action_features
    assert ours.observation_features == own.observation_features
    assert (ours.name, ours.robot_type) == (own.name, own.robot_type)
    assert ours.left_arm.calibration_fpath == own.left_arm.calibration_fpath
    assert ours.right_arm.calibration_fpath == own.right_arm.calibration_fpath
    assert ours.left_arm.config.max_relative_target == 5.0
    assert ours.right_arm.config.max_relative_target is None
    leads = leader("/dev/none1", "/dev/none2")
    rows = [SOLeaderConfig(port=f"/dev/none{i}") for i in (1, 2)]
    own_leads = BiSOLeader(BiSOLeaderConfig(id="two", left_arm_config=rows[0], right_arm_config=rows[1]))
    assert leads.action_features == own_leads.action_features == ours.action_features
    assert leads.right_arm.calibration_fpath == own_leads.right_arm.calibration_fpath
    for device in (ours, leads):
        with pytest.raises(DeviceNotConnectedError):
            device.disconnect()


def test_both_arms_are_observed_and_moved(ports: list[str], leader_ports: list[str]) -> None:
    robot, leads = follower(*ports), leader(*leader_ports)
    robot.connect()
    leads.connect()
    assert robot.is_connected
    assert robot.is_calibrated
    assert leads.is_calibrated
    with pytest.raises(DeviceAlreadyConnectedError):
        robot.connect()
    action = leads.get_action()
    assert action.keys() == robot.action_features.keys()
    seen = robot.get_observation()
    assert seen.keys() == robot.observation_features.keys()
    sent = robot.send_action(seen | {"right_gripper.pos": seen["right_gripper.pos"] + 1.0})
    assert sent.keys() == robot.action_features.keys()
    robot.disconnect()
    leads.disconnect()
    assert not robot.left_arm.is_connected
    assert not robot.right_arm.is_connected


def test_an_arm_that_is_missing_leaves_the_other_one_closed(ports: list[str]) -> None:
    robot = follower(ports[0], "/dev/none2")
    with pytest.raises(ConnectionError, match="none2"):
        robot.connect()
    assert not robot.left_arm.is_connected
    # One that was lost later does not keep the other one open.
    robot = follower(*ports)
    robot.connect()
    robot.left_arm.disconnect()
    assert not robot.is_connected
    robot.disconnect()
    assert not robot.right_arm.is_connected


def test_an_arm_whose_neighbour_is_missing_goes_nowhere(ports: list[str]) -> None:
    words = ["--robot.type=bi_hexwire_so101", "--robot.id=two", "--robot.left_arm_config.home_at_disconnect=home"]
    words += [f"--robot.left_arm_config.port={ports[0]}", "--robot.right_arm_config.port=/dev/none2"]
    robot = make_robot_from_config(draccus.parse(Robots, args=words).robot)
    ids = [1, 2, 3, 4, 5, 6]
    with ServoBus.from_url(ports[0]) as bus:
        before = [one.raw for one in bus.sync_read("present_position", ids)]
    with pytest.raises(ConnectionError, match="none2"):
        robot.connect()
    with ServoBus.from_url(ports[0]) as bus:
        assert [one.raw for one in bus.sync_read("torque_enable", ids)] == [0] * 6
        after = [one.raw for one in bus.sync_read("present_position", ids)]
    assert after == pytest.approx(before, abs=3)


def test_what_is_wrong_says_which_arm(ports: list[str], caplog: pytest.LogCaptureFixture) -> None:
    robot = follower(*ports)
    robot.connect()
    seen = robot.get_observation()
    with pytest.raises(ValueError, match="right arm: the action of gripper is nan"):
        robot.send_action({"right_gripper.pos": math.nan})
    caplog.set_level(logging.WARNING)
    away = seen["left_shoulder_pan.pos"] + 4.0
    with pytest.raises(ValueError, match="right arm: the action of gripper is nan"):
        robot.send_action({"left_shoulder_pan.pos": away, "right_gripper.pos": math.nan})
    assert caplog.records == [], "nor is the other one sent anywhere"
    robot.send_action(seen | {"left_shoulder_pan.pos": away})
    said = "left arm: shoulder_pan goes slowly to where it is led, at first"
    assert [row.message for row in caplog.records] == [said]
    robot.disconnect()
    with pytest.raises(ConnectionError, match=r"right arm: .*none2"):
        follower(ports[0], "/dev/none2").connect()
