"""The follower beside LeRobot's own, on the same emulated arm."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from itertools import pairwise

import pytest
from emulated import LOSS, bus, calibrated, patiently, reach
from lerobot.cameras.opencv import OpenCVCameraConfig
from lerobot.robots import make_robot_from_config
from lerobot.robots.so_follower import SO101Follower, SO101FollowerConfig
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from lerobot_robot_hexwire import (
    HexwireHex7bot,
    HexwireHex7botConfig,
    HexwireRemote,
    HexwireRemoteConfig,
    HexwireSO100,
    HexwireSO100Config,
    HexwireSO101,
    HexwireSO101Config,
)

from hexwire.control.requests.pose_file import PoseFile
from hexwire.drivers.arm_file import load_calibration
from hexwire.drivers.base import StopMode
from hexwire.drivers.bus_arm import So101Arm
from hexwire.emulator.hand import HandOrder
from hexwire.emulator.serve_hand import move_by_hand

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
PERIOD = 1 / 60


def make(port: str, **options: object) -> HexwireSO101:
    return HexwireSO101(HexwireSO101Config(port=port, id="black", **options))


def registers(port: str, name: str) -> list[int | None]:
    with So101Arm.from_url(port) as arm:
        return [arm.bus.read(servo, name).raw for servo in range(1, 7)]


@pytest.fixture
def arm(follower: str) -> Iterator[HexwireSO101]:
    robot = make(follower)
    robot.connect()
    yield robot
    if robot.is_connected:
        robot.disconnect()


def go(robot: HexwireSO101, action: dict[str, float], seconds: float) -> list[dict[str, float]]:
    """Send an action at 60 a second, as LeRobot's loops do; returns the observations."""
    seen = []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        seen.append(robot.get_observation())
        robot.send_action(action)
        time.sleep(PERIOD)
    return seen


@pytest.mark.parametrize(
    ("config", "kind", "joints"),
    [
        (HexwireSO101Config(port="/dev/none"), HexwireSO101, JOINTS),
        (HexwireSO100Config(port="/dev/none"), HexwireSO100, JOINTS),
        (HexwireRemoteConfig(port="zenoh:lab/arm1"), HexwireRemote, JOINTS),
        (HexwireHex7botConfig(port="/dev/none"), HexwireHex7bot, tuple(f"J{i}" for i in range(1, 8))),
    ],
)
def test_lerobot_makes_each_robot_and_knows_its_joints_before_connecting(
    config: object, kind: type, joints: tuple[str, ...]
) -> None:
    robot = make_robot_from_config(config)
    assert type(robot) is kind
    assert robot.action_features == {f"{name}.pos": float for name in joints}
    assert robot.observation_features == robot.action_features
    assert list(robot.bus.motors) == list(joints)
    assert not robot.is_connected
    for call in (robot.get_observation, lambda: robot.send_action({}), robot.disconnect):
        with pytest.raises(DeviceNotConnectedError):
            call()


def test_an_action_below_the_table_is_not_followed(arm: HexwireSO101) -> None:
    assert arm.config.table_mm == 0.0
    go(arm, {"shoulder_lift.pos": 36.0, "elbow_flex.pos": 23.0, "wrist_flex.pos": 5.0}, 5.0)
    driver = arm._arm.driver
    geometry = driver.kinematics
    heights = [place[2] for place in geometry.points(geometry.from_joints(driver.read().positions)).values()]
    assert min(heights) > -0.005


@pytest.mark.parametrize("degrees", [True, False])
def test_values_and_files_are_those_of_lerobots_own_arm(follower: str, degrees: bool) -> None:
    own = SO101Follower(SO101FollowerConfig(port=follower, id="black", use_degrees=degrees))
    ours = make(follower, use_degrees=degrees, disable_torque_on_disconnect=False)
    assert ours.calibration_fpath == own.calibration_fpath
    assert (ours.name, ours.robot_type) == (own.name, own.robot_type)
    assert ours.observation_features == own.observation_features
    assert ours.action_features == own.action_features
    assert ours.calibration == own.calibration
    ours.connect()
    assert ours.is_calibrated
    action = dict(zip((f"{name}.pos" for name in JOINTS), (12.0, -70.0, 60.0, 30.0, -25.0, 40.0), strict=True))
    if not degrees:
        action |= {"shoulder_lift.pos": -66.0, "elbow_flex.pos": 60.0}
    go(ours, action, 3.0)
    seen = ours.get_observation()
    ours.disconnect()
    reach(own.bus)
    beside = patiently(own.get_observation)
    own.bus.disconnect(disable_torque=False)
    assert seen == pytest.approx(beside, abs=0.2)
    # LeRobot does not notice that hexwire was here: the same settings in the servos.
    reach(own.bus)
    assert patiently(lambda: own.bus.is_calibrated)
    own.bus.disconnect(disable_torque=False)
    assert registers(follower, "position_p") == [16] * 6


def test_an_action_of_lerobots_own_arm_leads_to_the_same_place(arm: HexwireSO101, follower: str) -> None:
    action = dict(zip((f"{name}.pos" for name in JOINTS), (-20.0, -80.0, 70.0, 40.0, 15.0, 50.0), strict=True))
    go(arm, action, 2.5)
    sent = arm.send_action(action)
    assert sent == pytest.approx(action, abs=0.1)
    assert arm.get_observation() == pytest.approx(action, abs=3.0)
    arm.disconnect()
    goals = registers(follower, "goal_position")
    own = SO101Follower(SO101FollowerConfig(port=follower, id="black"))
    wanted = own.bus._unnormalize({i: action[f"{name}.pos"] for i, name in enumerate(JOINTS, 1)})
    # LeRobot cuts off the fraction of a count, hexwire rounds it.
    assert goals == pytest.approx(list(wanted.values()), abs=1)


def test_the_first_action_is_approached_slowly_and_nothing_jumps(arm: HexwireSO101) -> None:
    start = arm.get_observation()["shoulder_pan.pos"]
    sent = arm.send_action({"shoulder_pan.pos": start + 60.0})
    assert abs(sent["shoulder_pan.pos"] - start) < 4.0
    seen = [one["shoulder_pan.pos"] for one in go(arm, {"shoulder_pan.pos": start + 60.0}, 0.5)]
    # A fifth of 180 degrees per second.
    assert seen[-1] - start < 30.0
    assert max(b - a for a, b in pairwise(seen)) < 6.0


def test_actions_end_at_the_limits(arm: HexwireSO101, follower: str) -> None:
    go(arm, {"shoulder_pan.pos": 500.0, "gripper.pos": 300.0}, 4.5)
    sent = arm.send_action({"shoulder_pan.pos": 500.0, "gripper.pos": 300.0})
    row = arm.calibration["shoulder_pan"]
    assert sent["shoulder_pan.pos"] == pytest.approx((row.range_max - row.range_min) / 2 * 360 / 4095, abs=0.1)
    assert sent["gripper.pos"] == pytest.approx(100.0, abs=0.1)


def test_max_relative_target(follower: str) -> None:
    robot = make(follower, max_relative_target=2.0)
    robot.connect()
    here = robot.get_observation()["shoulder_pan.pos"]
    for _ in range(10):
        sent = robot.send_action({"shoulder_pan.pos": here + 50.0})
        assert sent["shoulder_pan.pos"] - robot.get_observation()["shoulder_pan.pos"] < 2.2
    robot.disconnect()


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_what_is_no_action_is_refused(arm: HexwireSO101, value: float) -> None:
    with pytest.raises(ValueError, match="nothing was sent"):
        arm.send_action({"shoulder_pan.pos": value})
    with pytest.raises(ValueError, match="no joint 'elbow'"):
        arm.send_action({"elbow.pos": 0.0})
    assert arm.send_action({}) == {}


def test_connecting_twice_and_torque_at_the_end(arm: HexwireSO101, follower: str) -> None:
    with pytest.raises(DeviceAlreadyConnectedError):
        arm.connect()
    arm.disconnect()
    assert registers(follower, "torque_enable") == [0] * 6
    robot = make(follower, disable_torque_on_disconnect=False)
    robot.connect()
    robot.disconnect()
    assert registers(follower, "torque_enable") == [1] * 6
    # LeRobot's own arm gives its goals no speed, and would crawl at that of the last one.
    assert registers(follower, "goal_speed") == [0] * 6


def test_at_the_end_it_goes_to_a_saved_pose_before_its_torque_is_off(follower: str) -> None:
    robot = make(follower, home_at_disconnect="folded", meet_speed=0.4)
    with pytest.raises(ValueError, match="no pose 'folded' of so101; known are: home"):
        robot.connect()
    assert not robot.is_connected
    assert registers(follower, "torque_enable") == [0] * 6
    with So101Arm.from_url(follower) as arm:
        model = load_calibration(robot.calibration_fpath).apply(arm.model)
    folded = {"shoulder_pan": 0.2, "shoulder_lift": -1.4, "elbow_flex": 1.3, "wrist_flex": 0.6}
    PoseFile(model).save("folded", folded)
    try:
        robot.connect()
        go(robot, {"shoulder_lift.pos": -60.0}, 1.0)
        robot.disconnect()
        assert registers(follower, "torque_enable") == [0] * 6
        robot.connect()
        seen = robot.get_observation()
        wanted = {f"{name}.pos": math.degrees(angle) for name, angle in folded.items()}
        assert {name: seen[name] for name in wanted} == pytest.approx(wanted, abs=4.0)
        # A stopped arm goes nowhere, and does not fall.
        robot._arm.driver.stop(StopMode.HOLD)
        robot.disconnect()
        assert registers(follower, "torque_enable") == [1] * 6
    finally:
        PoseFile(model).remove("folded")


def test_a_stop_that_was_latched_elsewhere_is_respected(follower: str) -> None:
    # A pseudo-terminal has no stop memory across programs, so the stop comes through the driver.
    robot = make(follower)
    robot.connect()
    robot._arm.driver.stop(StopMode.HOLD)
    with pytest.raises(RuntimeError, match="stopped"):
        robot.send_action({"shoulder_pan.pos": 5.0})
    assert len(robot.get_observation()) == 6
    robot._arm.driver.resume()
    robot.send_action({"shoulder_pan.pos": 5.0})
    robot.disconnect()


def test_an_arm_that_is_not_calibrated_gets_no_torque(follower: str) -> None:
    robot = HexwireSO101(HexwireSO101Config(port=follower, id="nobody"))
    robot.connect(calibrate=False)
    assert not robot.is_calibrated
    for call in (robot.get_observation, lambda: robot.send_action({"shoulder_pan.pos": 0.0})):
        with pytest.raises(RuntimeError, match="lerobot-calibrate"):
            call()
    robot.disconnect()
    assert registers(follower, "torque_enable") == [0] * 6


def test_servos_with_another_calibration_than_the_file(follower: str) -> None:
    with So101Arm.from_url(follower) as arm:
        from hexwire.bus.setup import write_setting

        write_setting(arm.bus, 3, "position_offset", 17)
    robot = make(follower)
    robot.connect(calibrate=False)
    assert not robot.is_calibrated
    robot.disconnect()


def test_an_arm_that_is_gone() -> None:
    with bus("--baud", "0") as port:
        calibrated(port, "black")
        robot = make(port)
        robot.connect()
    with pytest.raises(ConnectionError):
        robot.get_observation()
    if robot.is_connected:
        with pytest.raises(ConnectionError):
            robot.disconnect()
    assert not robot.is_connected
    with pytest.raises(ConnectionError):
        robot.connect()


def test_lost_answers_raise_nothing_and_give_no_wrong_value() -> None:
    with bus("--baud", "0", *LOSS) as port:
        calibrated(port, "black")
        for _ in range(3):
            robot = make(port, disable_torque_on_disconnect=False)
            robot.connect()
            robot.disconnect()
        robot = make(port)
        robot.connect()
        here = robot.get_observation()
        for _ in range(600):
            robot.send_action(here)
            assert robot.get_observation() == pytest.approx(here, abs=3.0)
        assert robot._arm.driver.host_counters()["repeats"] > 0
        robot.disconnect()


def test_an_arm_that_hexwire_moves_by_hand_meanwhile(follower: str) -> None:
    robot = make(follower, disable_torque_on_disconnect=True)
    robot.connect()
    robot._arm.driver.torque(False)
    before = robot.get_observation()["shoulder_pan.pos"]
    move_by_hand(follower, HandOrder("shoulder_pan", 15.0, 0.3))
    assert robot.get_observation()["shoulder_pan.pos"] - before == pytest.approx(15.0, abs=2.0)
    robot.disconnect()


class Eye:
    """A camera of LeRobot, as far as a robot uses one."""

    is_connected = False
    use_depth = False

    def connect(self) -> None:
        self.is_connected = True

    def disconnect(self) -> None:
        self.is_connected = False

    def read_latest(self) -> str:
        return "picture"

    def read_latest_depth(self) -> str:
        return "depth"


@pytest.mark.parametrize("depth", [False, True])
def test_pictures(follower: str, monkeypatch: pytest.MonkeyPatch, depth: bool) -> None:
    eye = Eye()
    eye.use_depth = depth
    monkeypatch.setattr("lerobot_robot_hexwire.robots.make_cameras_from_configs", lambda configs: {"front": eye})
    camera = OpenCVCameraConfig(index_or_path=0, width=64, height=48, fps=30)
    robot = make(follower, cameras={"front": camera})
    wanted = {"front": "picture", **({"front_depth": "depth"} if depth else {})}
    sizes = {key: size for key, size in robot.observation_features.items() if size is not float}
    assert sizes == {"front": (48, 64, 3), **({"front_depth": (48, 64, 1)} if depth else {})}
    robot.connect()
    seen = robot.get_observation()
    assert {key: seen[key] for key in wanted} == wanted
    assert seen.keys() == robot.observation_features.keys()
    robot.disconnect()
    assert not eye.is_connected


def test_hex7bot() -> None:
    robot = HexwireHex7bot(HexwireHex7botConfig(port="sim://hex7bot"))
    robot.connect()
    assert robot.is_calibrated
    here = robot.get_observation()
    assert list(here) == [f"J{i}.pos" for i in range(1, 8)]
    goal = {**here, "J1.pos": here["J1.pos"] + 5.0}
    go(robot, goal, 2.0)
    assert robot.get_observation()["J1.pos"] == pytest.approx(goal["J1.pos"], abs=1.5)
    robot.disconnect()
    assert not robot.is_connected
