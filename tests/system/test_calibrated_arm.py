"""An arm whose servos have stored a calibration has its angles and limits in every front, by its plain name.

Poses are kept by that name: in a front with other angles, a pose would be another place.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from click.testing import CliRunner, Result
from tests.bus.bus_bench import put_calibration
from tests.fleet.emulated import patience, served_bus

import hexwire
from hexwire.cli.main import cli
from hexwire.control.requests.controlled_arm import ControlledArm
from hexwire.control.requests.leader import Leader
from hexwire.control.requests.setting import Faults
from hexwire.control.requests.settings_reader import read_settings
from hexwire.drivers.registry import connect, load_bus_arm
from hexwire.emulator.bus_device import make_servos
from hexwire.emulator.servo import EmulatedServo
from hexwire.errors import DeviceError
from hexwire.fleet.service import Service
from hexwire.fleet.service_file import read_arms
from hexwire.model.calibration import Calibration, JointCalibration
from hexwire.ros1.parameters import load_parameters
from hexwire.ros2.settings import load_settings
from hexwire.studio.source import Source
from hexwire.wire.registers import Series

if TYPE_CHECKING:
    from hexwire.control.requests.settings import Settings
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.arm import ArmModel

USUAL = load_bus_arm("so101").described().model
ROWS = tuple(
    JointCalibration(joint.name, joint.servo_id, 2000.5 + 40 * i, 1400 + 20 * i, 2601 + 60 * i, servo_offset=9 * i)
    for i, joint in enumerate(USUAL.joints)
)
MODEL = Calibration("so101", "", ROWS).apply(USUAL)
COUNTS = [Series.STS_SMS.neutral + 3 * i - (row.servo_offset or 0) for i, row in enumerate(ROWS)]
"""What the servos report: each stands a little off its centre."""

Seen = tuple["ArmModel", Mapping[str, float]]
"""The model, and the angle of each joint in radians, that a front has."""


@pytest.fixture
def servos() -> list[EmulatedServo]:
    made = make_servos([Series.STS_SMS], range(1, 7), baud=[0], start=time.monotonic())
    for servo, row in zip(made, ROWS, strict=True):
        put_calibration(servo, row)
    return made


@pytest.fixture
def port(servos: list[EmulatedServo]) -> Iterator[str]:
    with patience(), served_bus(servos) as path:
        yield path


def by_connect(port: str) -> Seen:
    with connect(port, "so101") as robot:
        return robot.model, robot.read().positions


def by_arm(port: str) -> Seen:
    with hexwire.connect(port, "so101") as arm:
        return arm.model, arm.read().positions


def by_server(port: str) -> Seen:
    arms = read_arms({"arm": {"port": port, "robot": "so101"}})
    with Service(arms), connect("zenoh:arm") as robot:
        return robot.model, robot.read().positions


def by_studio(port: str) -> Seen:
    source = Source()
    try:
        arm = source.open(port, "so101")
        assert arm.uncalibrated == ""
        return arm.settings.model, arm.arm.owner.newest().positions
    finally:
        source.close()


def by_leader(port: str) -> Seen:
    follower, driver = read_settings({"port": "sim://so101?name=follower"}, Faults())
    arm = ControlledArm(driver, follower)
    arm.connect()
    arm.start()
    leader = Leader(read_settings({"port": port, "robot": "so101"}, Faults())[1], arm)
    try:
        leader.open()
        return leader.owner.model, leader.owner.newest().positions
    finally:
        leader.close()
        arm.shutdown()


def _of_node(settings: Settings, driver: RobotDriver) -> Seen:
    arm = ControlledArm(driver, settings)
    arm.connect()
    arm.start()
    try:
        return arm.settings.model, arm.owner.newest().positions
    finally:
        arm.shutdown()


def by_ros1(port: str) -> Seen:
    parameters, driver = load_parameters({"port": port, "robot": "so101"})
    return _of_node(parameters.settings, driver)


def by_ros2(port: str) -> Seen:
    settings, driver = load_settings({"port": port, "robot": "so101"}, {})
    return _of_node(settings.arm, driver)


FRONTS: tuple[Callable[[str], Seen], ...] = (
    by_connect,
    by_arm,
    by_server,
    by_studio,
    by_leader,
    by_ros1,
    by_ros2,
)


@pytest.mark.parametrize("front", FRONTS)
def test_every_front_has_the_angles_and_limits_that_the_servos_store(
    front: Callable[[str], Seen], port: str
) -> None:
    model, positions = front(port)
    assert model == MODEL
    assert [joint.angle_to_counts(positions[joint.name]) for joint in MODEL.joints] == COUNTS


def test_every_command_has_the_angles_and_limits_that_the_servos_store(port: str) -> None:
    def run(*words: str) -> Result:
        return CliRunner().invoke(cli, [*words, "--robot", "so101", "--port", port])

    result = run("state", "--json")
    assert result.stderr == ""
    shown = json.loads(result.stdout)["joints"]
    positions = {row["name"]: row["position_rad"] for row in shown}
    assert [joint.angle_to_counts(positions[joint.name]) for joint in MODEL.joints] == COUNTS
    first, usual = MODEL.joints[0], USUAL.joints[0]
    assert first.maximum < usual.maximum
    refused = run("move", f"{first.name}={math.degrees(first.maximum) + 1.0}")
    assert refused.exit_code == 2
    assert f"{math.degrees(first.maximum):.2f}" in refused.stderr


def test_an_arm_that_was_not_there_at_the_start_is_not_used_with_other_angles(port: str, tmp_path: Path) -> None:
    plugged_in = tmp_path / "port"
    settings, driver = load_settings({"port": str(plugged_in), "robot": "so101"}, {})
    assert settings.arm.model == USUAL
    plugged_in.symlink_to(port)
    arm = ControlledArm(driver, settings.arm)
    try:
        with pytest.raises(DeviceError, match=r"a calibration that was not known .* start it again"):
            arm.connect()
    finally:
        arm.shutdown()


def test_commands_and_servers_say_that_an_arm_is_not_calibrated(
    port: str, servos: list[EmulatedServo], caplog: pytest.LogCaptureFixture
) -> None:
    put_calibration(servos[0], replace(ROWS[0], low=0, high=4095))
    said = "not calibrated: shoulder_pan may be elsewhere than shown: `hexwire bus calibrate so101`"
    result = CliRunner().invoke(cli, ["state", "--robot", "so101", "--port", port])
    assert (result.exit_code, result.stderr) == (0, f"note: {said}\n")
    for front in (by_server, by_ros1, by_ros2):
        caplog.clear()
        front(port)
        assert said in caplog.text
