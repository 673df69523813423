"""Faults of servos and of the line, in simulated time: what connects, what is told, what is held."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any

import pytest
from lerobot_robot_hexwire import HexwireSO101, HexwireSO101Config
from lerobot_robot_hexwire.config_hexwire import GRIPPER_FORCE
from simulated import PERIOD, Sim, go

from hexwire.arm.verbs import Arm
from hexwire.emulator.servo import EmulatedServo
from hexwire.errors import LinkLostError
from hexwire.model.gripper import jaws_of
from hexwire.model.state import JointFlag

GRIPPER = 5
LEADING = [False, True]


# --- when it is connected ----------------------------------------------------------------------------------------


def _supply(volts: float) -> Callable[[EmulatedServo], None]:
    return lambda servo: setattr(servo, "supply", volts)


def _forced(flag: JointFlag) -> Callable[[EmulatedServo], None]:
    def force(servo: EmulatedServo) -> None:
        servo.protection.forced |= int(flag)

    return force


def _hot(servo: EmulatedServo) -> None:
    servo.protection.ambient = servo.protection.temperature = 80.0


FAULTS = {
    "overload": (_forced(JointFlag.OVERLOAD), "reports overload; .*free the joint"),
    "current": (_forced(JointFlag.CURRENT), "reports current; .*free the joint"),
    "encoder": (_forced(JointFlag.ENCODER), "reports encoder; .*replace the servo"),
    "voltage": (_supply(3.8), "supply 3.8 V, too low .*; use a stronger supply"),
    "another class": (_supply(15.0), "supply 15.0 V, too high .*; switch the supply off"),
    "hot": (_hot, "80 deg C.*; let it cool"),
}


@pytest.mark.parametrize("leader", LEADING)
@pytest.mark.parametrize("fault", FAULTS)
def test_an_arm_with_a_fault_is_refused_by_name_with_its_cure(
    monkeypatch: pytest.MonkeyPatch, leader: bool, fault: str
) -> None:
    sim = Sim(monkeypatch, leader=leader)
    afflict, text = FAULTS[fault]
    afflict(sim.servos[2])
    # A servo looks for faults from time to time.
    sim.clock.advance(0.1)
    device = sim.device()
    with pytest.raises(RuntimeError, match=rf"elbow_flex \(servo 3\): {text}"):
        device.connect()
    assert not device.is_connected
    assert not sim.link.is_open
    assert not any(servo.registers.get("torque_enable") for servo in sim.servos)


@pytest.mark.parametrize("leader", LEADING)
def test_a_servo_that_does_not_answer_is_a_connection_error(monkeypatch: pytest.MonkeyPatch, leader: bool) -> None:
    sim = Sim(monkeypatch, leader=leader)
    sim.mute(4)
    with pytest.raises(ConnectionError, match=r"wrist_flex \(servo 4\) does not answer"):
        sim.device().connect()


@pytest.mark.parametrize("leader", LEADING)
def test_two_servos_of_one_id(monkeypatch: pytest.MonkeyPatch, leader: bool) -> None:
    sim = Sim(monkeypatch, leader=leader)
    sim.servos[GRIPPER].registers.put_stored("id", 5)
    with pytest.raises(ConnectionError, match=r"several servos seem to share an id.*one at a time"):
        sim.device().connect()


# --- in a session ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("leader", LEADING)
def test_a_fault_that_comes_is_logged_once_and_counted(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, leader: bool
) -> None:
    sim = Sim(monkeypatch, leader=leader)
    device = sim.device()
    device.connect()
    caplog.set_level(logging.WARNING)
    protection = sim.servos[GRIPPER].protection
    for _ in range(3):
        protection.forced = int(JointFlag.OVERLOAD)
        for _ in range(5):
            sim.clock.advance(0.1)
            sim.read(device)
        protection.forced, protection.status = 0, 0
        sim.clock.advance(0.1)
        sim.read(device)
    assert [row.message.split(";")[0] for row in caplog.records] == ["gripper (servo 6): reports overload"]
    assert device._arm.faults.counts == {"gripper overload": 3}
    protection.forced = int(JointFlag.TEMPERATURE)
    sim.clock.advance(0.1)
    sim.read(device)
    assert "gripper (servo 6): reports temperature" in caplog.records[-1].message
    device.disconnect()


@pytest.mark.parametrize("way", ["raise", "torque_off"])
def test_a_fault_may_be_an_error(monkeypatch: pytest.MonkeyPatch, way: str) -> None:
    sim = Sim(monkeypatch)
    robot = sim.device(on_fault=way)
    robot.connect()
    here = robot.get_observation()
    sim.servos[1].protection.forced = int(JointFlag.OVERLOAD)
    sim.clock.advance(0.1)
    with pytest.raises(RuntimeError, match=r"shoulder_lift \(servo 2\): reports overload"):
        robot.get_observation()
    off = way == "torque_off"
    assert [servo.registers.get("torque_enable") for servo in sim.servos] == [int(not off)] * 6
    # Also one who only sends hears of it.
    sim.clock.advance(1.0)
    with pytest.raises(RuntimeError, match="has no torque" if off else "reports overload"):
        robot.send_action(here)


@pytest.mark.parametrize("silent", [False, True])
@pytest.mark.parametrize("way", ["warn", "raise", "torque_off"])
def test_a_joint_that_loses_its_torque_is_told_and_gets_none_with_the_next_action(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, way: str, silent: bool
) -> None:
    sim = Sim(monkeypatch)
    robot = sim.device(on_fault=way)
    robot.connect()
    here = robot.get_observation()
    go(sim, robot, here, 0.1)
    caplog.set_level(logging.WARNING)
    sim.servos[2].registers.put("torque_enable", 0)
    if silent:
        # It restarts: then it is asked at once, else every two seconds.
        sim.mute(3)
        sim.on_sleep = sim.mute
    else:
        sim.clock.advance(2.1)
    error = pytest.raises(RuntimeError, match=r"elbow_flex \(servo 3\): has no torque any more; .* connect again")
    with nullcontext() if way == "warn" else error:
        robot.get_observation()
    with pytest.raises(RuntimeError, match="has no torque"):
        robot.send_action(here)
    off = way == "torque_off"
    assert [servo.registers.get("torque_enable") for servo in sim.servos] == [
        int(not off and i != 2) for i in range(6)
    ]
    assert [row.message.split(";")[0] for row in caplog.records] == ["elbow_flex (servo 3): has no torque any more"]
    assert robot._arm.faults.counts == {"elbow_flex torque off": 1}


def test_an_arm_of_which_no_fault_ends_the_session_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    sim = Sim(monkeypatch)
    robot = sim.device()
    robot.connect()
    sim.servos[1].protection.forced = int(JointFlag.VOLTAGE)
    assert go(sim, robot, robot.get_observation(), 1.0)
    robot.disconnect()


# --- silence -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("leader", LEADING)
@pytest.mark.parametrize("patience", [0.0, 0.5, 2.0])
def test_a_servo_may_be_silent_for_as_long_as_the_patience(
    monkeypatch: pytest.MonkeyPatch, leader: bool, patience: float
) -> None:
    sim = Sim(monkeypatch, leader=leader)
    device = sim.device(patience=patience)
    device.connect()
    before = sim.read(device)
    sim.mute(4)
    began = sim.clock()
    with pytest.raises(ConnectionError, match="wrist_flex does not answer"):
        sim.read(device)
    assert patience <= sim.clock() - began <= patience + 0.5
    sim.mute()
    assert sim.read(device) == pytest.approx(before, abs=1.0)
    device.disconnect()


@pytest.mark.parametrize("leader", LEADING)
def test_a_line_that_is_plugged_in_again_goes_on(monkeypatch: pytest.MonkeyPatch, leader: bool) -> None:
    sim = Sim(monkeypatch, leader=leader)
    device = sim.device(patience=3.0)
    device.connect()
    before = sim.read(device)
    sim.link.lost = True
    tries = itertools.count()
    sim.on_sleep = lambda: setattr(sim.link, "lost", next(tries) < 50)
    assert sim.read(device) == pytest.approx(before, abs=1.0)
    sim.link.lost, sim.on_sleep = True, lambda: None
    began = sim.clock()
    with pytest.raises(ConnectionError):
        sim.read(device)
    assert sim.clock() - began == pytest.approx(3.0, abs=0.5)


@pytest.mark.parametrize("keeps", [False, True])
def test_the_end_of_a_line_that_is_lost_says_that_the_joints_keep_their_torque(
    monkeypatch: pytest.MonkeyPatch, keeps: bool
) -> None:
    sim = Sim(monkeypatch)
    robot = sim.device(disable_torque_on_disconnect=not keeps)
    robot.connect()
    action = robot.get_observation()
    sim.link.lost = True
    with pytest.raises(ConnectionError, match="unplugged"):
        robot.send_action(action)
    with (
        nullcontext() if keeps else pytest.raises(ConnectionError, match="keep their torque: switch its supply off")
    ):
        robot.disconnect()
    assert not robot.was_connected
    assert all(servo.torque_on for servo in sim.servos)


@pytest.mark.parametrize("leader", LEADING)
def test_a_line_that_is_lost_again_and_again_ends_with_the_patience(
    monkeypatch: pytest.MonkeyPatch, leader: bool
) -> None:
    sim = Sim(monkeypatch, leader=leader)
    device = sim.device(patience=3.0)
    device.connect()
    began = sim.clock()

    def lost() -> None:
        assert sim.clock() - began < 60.0, "it does not end"
        raise LinkLostError("unplugged")

    monkeypatch.setattr(device._arm.driver, "read_positions", lost)
    with pytest.raises(ConnectionError, match="unplugged"):
        sim.read(device)
    assert device._arm.lost > 1
    assert sim.clock() - began == pytest.approx(3.0, abs=0.5)


@pytest.mark.parametrize("sending", [False, True])
def test_after_the_line_was_lost_the_arm_meets_the_next_action_slowly(
    monkeypatch: pytest.MonkeyPatch, sending: bool
) -> None:
    sim = Sim(monkeypatch)
    robot = sim.device(patience=3.0, table_mm=None)
    robot.connect()
    action = robot.get_observation()
    go(sim, robot, action, 0.5)
    action["shoulder_pan.pos"] += 40.0
    before = robot.get_observation()["shoulder_pan.pos"]
    sim.link.lost = True
    sim.on_sleep = lambda: setattr(sim.link, "lost", False)
    if sending:
        assert robot.send_action(action) == {}
    else:
        robot.get_observation()
    moved = go(sim, robot, action, 0.5)["shoulder_pan.pos"] - before
    # A fifth of 180 degrees a second.
    assert 10.0 < moved < 36.0 * 0.5 + 1.0
    assert go(sim, robot, action, 3.0)["shoulder_pan.pos"] == pytest.approx(action["shoulder_pan.pos"])
    robot.disconnect()


@pytest.mark.parametrize("away", ["robot", "leader"])
def test_after_a_replug_nothing_jumps_to_where_the_leader_was_moved_meanwhile(
    monkeypatch: pytest.MonkeyPatch, away: str
) -> None:
    """Also if the first action was made before."""
    other = Sim(monkeypatch, leader=True)
    leader = other.device(patience=0.5)
    leader.connect()
    sim = Sim(monkeypatch)
    robot = sim.device(patience=0.5, table_mm=None)
    robot.connect()
    action = robot.get_observation()
    before = go(sim, robot, action, 0.5)["shoulder_pan.pos"]
    link = sim.link if away == "robot" else other.link
    link.lost, tries = True, itertools.count()
    sim.on_sleep = lambda: setattr(link, "lost", next(tries) < 15)
    sim.read(robot) if away == "robot" else other.read(leader)
    assert not link.lost
    if away == "robot":
        robot.send_action(action)
    action["shoulder_pan.pos"] += 40.0
    moved = go(sim, robot, action, 0.5)["shoulder_pan.pos"] - before
    # A fifth of 180 degrees a second.
    assert 10.0 < moved < 36.0 * 0.5 + 1.0
    assert go(sim, robot, action, 3.0)["shoulder_pan.pos"] == pytest.approx(action["shoulder_pan.pos"])
    robot.disconnect()


def test_ctrl_c_on_the_way_home_says_that_the_arm_keeps_its_torque(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def interrupted(arm: Arm, pose: str) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Arm, "move", interrupted)
    sim = Sim(monkeypatch)
    robot = sim.device(home_at_disconnect="home")
    robot.connect()
    with pytest.raises(KeyboardInterrupt):
        robot.disconnect()
    assert "has not come to its pose home, and keeps its torque: hold it" in caplog.text
    assert not robot.is_connected
    assert [servo.registers.get("torque_enable") for servo in sim.servos] == [1] * 6


# --- the gripper -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("observing", [True, False])
def test_a_gripper_that_is_commanded_shut_on_something_does_not_press_itself_into_overload(
    monkeypatch: pytest.MonkeyPatch, observing: bool
) -> None:
    sim = Sim(monkeypatch)
    robot = sim.device(table_mm=None)
    robot.connect()
    action = robot.get_observation() | {"gripper.pos": 70.0}
    go(sim, robot, action, 4.0)
    servo = sim.servos[GRIPPER]
    jaws = jaws_of(robot._arm.driver.model)
    assert jaws is not None
    servo.motion.obstacle = (servo.motion.position - 200.0, None)
    action["gripper.pos"] = 0.0
    loads = []
    for _ in range(round(10.0 / PERIOD)):
        if observing:
            robot.get_observation()
        robot.send_action(action)
        sim.clock.advance(PERIOD)
        loads.append(abs(servo.registers.get("present_load")) / 1000)
    assert max(loads) > GRIPPER_FORCE, "it never pressed"
    assert max(loads[-300:]) <= 1.1 * GRIPPER_FORCE
    assert loads[-1] > 0.0
    assert robot.clipped["gripper grip"] > 400
    assert not robot._arm.faults.counts
    # What it holds is taken away: it closes, and opens when it is told to.
    servo.motion.obstacle = None, None
    go(sim, robot, action, 4.0)
    assert robot.get_observation()["gripper.pos"] == pytest.approx(0.0, abs=3.0)
    action["gripper.pos"] = 70.0
    go(sim, robot, action, 2.0)
    assert robot.get_observation()["gripper.pos"] == pytest.approx(70.0, abs=3.0)
    robot.disconnect()


def test_without_a_limit_the_servo_protects_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    sim = Sim(monkeypatch)
    robot = sim.device(table_mm=None, gripper_force=1.0)
    robot.connect()
    action = robot.get_observation() | {"gripper.pos": 70.0}
    go(sim, robot, action, 4.0)
    sim.servos[GRIPPER].motion.obstacle = (sim.servos[GRIPPER].motion.position - 200.0, None)
    go(sim, robot, action | {"gripper.pos": 0.0}, 10.0)
    assert robot._arm.faults.counts["gripper overload"] == 1
    robot.disconnect()


# --- what cannot be ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"max_relative_target": -5.0}, "max_relative_target must be above 0, not -5"),
        ({"max_relative_target": 0.0}, "max_relative_target must be above 0"),
        ({"max_relative_target": float("nan")}, "max_relative_target must be above 0"),
        (
            {"max_relative_target": {"gripper": 5.0}},
            "max_relative_target names gripper; the joints are shoulder_pan",
        ),
        ({"on_fault": "ignore"}, "on_fault is one of warn, raise, torque_off, not 'ignore'"),
        ({"patience": -1.0}, "patience must be a number of seconds from 0"),
        ({"patience": float("inf")}, "patience must be a number of seconds from 0"),
        ({"gripper_force": 0.0}, "gripper_force must be above 0 and at most 1"),
        ({"table_mm": float("nan")}, "table_mm must be a height in millimetres or null, not nan"),
        ({"table_mm": float("inf")}, "table_mm must be a height in millimetres or null, not inf"),
    ],
)
def test_a_configuration_that_cannot_be(options: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        HexwireSO101(HexwireSO101Config(port="/dev/none", id="simulated", **options))
