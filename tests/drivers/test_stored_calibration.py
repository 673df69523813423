"""An arm known by name takes the calibration that its servos have stored: at its first attach, and only then."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest
from tests.bus.bus_bench import make_bus, put_calibration

from hexwire.drivers.arm_file import BusArmFile, load_profile
from hexwire.drivers.bus_arm import BusArm, ChainArm, So100Arm, So101Arm
from hexwire.emulator.bus_device import BusDevice
from hexwire.errors import DeviceError
from hexwire.link.base import Link
from hexwire.model.arm import ArmModel
from hexwire.model.arms.so_arm.kinematics import SoArmModel
from hexwire.model.calibration import Calibration, JointCalibration
from hexwire.wire.registers import Series

Made = tuple[Link, BusDevice]


@pytest.fixture(params=[So101Arm, So100Arm])
def kind(request: pytest.FixtureRequest) -> type[BusArm]:
    found: type[BusArm] = request.param
    return found


@pytest.fixture
def made() -> Iterator[Made]:
    """The link to six new servos, and these."""
    bus, device = make_bus(tuple(range(1, 7)), (Series.STS_SMS,) * 6, baud=1_000_000)
    bus.close()
    yield bus.link, device
    bus.close()


def rows_of(model: ArmModel) -> tuple[JointCalibration, ...]:
    return tuple(
        JointCalibration(joint.name, joint.servo_id, 2001.5, 1402, 2601, servo_offset=3 * i)
        for i, joint in enumerate(model.joints)
    )


def store(device: BusDevice, row: JointCalibration) -> None:
    put_calibration(device.wire[row.servo_id], row)


def test_all_joints_have_what_their_servos_store(kind: type[BusArm], made: Made) -> None:
    link, device = made
    usual = kind.described().model
    for row in rows_of(usual):
        store(device, row)
    arm = kind(link)
    assert (arm.may_change_model, arm.model) == (True, usual)
    assert isinstance(arm.kinematics, SoArmModel)
    usual_reach = arm.kinematics.ranges[0].maximum
    with arm:
        assert arm.model == Calibration(usual.name, "", rows_of(usual)).apply(usual)
        assert isinstance(arm.kinematics, SoArmModel)
        assert arm.kinematics.ranges[0].maximum == arm.model.joints[0].maximum != usual_reach
        assert not arm.may_change_model
        assert (arm.uncalibrated, arm.doubt) == ({}, "")
        assert [joint.note for joint in arm.probe().joints] == [""] * 6


@pytest.mark.parametrize("lost", range(6))
def test_a_joint_without_a_range_keeps_the_usual_one_and_is_named(
    kind: type[BusArm], made: Made, lost: int
) -> None:
    link, device = made
    usual = kind.described().model
    rows, joint = rows_of(usual), usual.joints[lost]
    for row in rows:
        if row.name != joint.name:
            store(device, row)
    with kind(link) as arm:
        for now, before, row in zip(arm.model.joints, usual.joints, rows, strict=True):
            if row.name in arm.uncalibrated:
                assert now == before
                assert row.name in arm.doubt
            elif row.name != "wrist_roll":
                assert (now.angle_to_counts(now.minimum), now.angle_to_counts(now.maximum)) == (1402, 2601)
        # The whole turn of a joint without stops may be its range.
        assert list(arm.uncalibrated) == ([] if joint.name == "wrist_roll" else [joint.name])
        assert any(joint.name in finding.text for finding in arm.examine()) == bool(arm.uncalibrated)


def test_a_new_arm_keeps_its_usual_angles(kind: type[BusArm], made: Made) -> None:
    with kind(made[0]) as arm:
        assert arm.model == kind.described().model
        assert set(arm.uncalibrated) == set(arm.model.names) - {"wrist_roll"}
        assert arm.doubt == "not calibrated: 5 joints may be elsewhere than shown"


def test_a_servo_that_is_silent_at_first_changes_nothing_when_it_comes_back(kind: type[BusArm], made: Made) -> None:
    link, device = made
    usual = kind.described().model
    rows = rows_of(usual)
    for row in rows:
        store(device, row)
    arm, gone = kind(link), device.wire.servos.pop(0)
    with arm:
        assert list(arm.uncalibrated) == [usual.names[0]]
        assert arm.model.joints[0] == usual.joints[0]
        assert arm.model.joints[1] != usual.joints[1]
        model = arm.model
        device.wire.servos.insert(0, gone)
        assert arm.read().silent == ()
    with arm:
        assert arm.model == model
        assert list(arm.uncalibrated) == [usual.names[0]]


def _moved(row: JointCalibration) -> JointCalibration:
    return replace(row, low=row.low + 10, middle=row.middle + 5.0)


def _offset(row: JointCalibration) -> JointCalibration:
    return replace(row, servo_offset=(row.servo_offset or 0) + 40)


def _lost(row: JointCalibration) -> JointCalibration:
    return replace(row, low=0, high=4095)


@pytest.mark.parametrize("change", [_moved, _offset, _lost])
def test_another_calibration_at_a_later_attach_is_refused(
    kind: type[BusArm], made: Made, change: Callable[[JointCalibration], JointCalibration]
) -> None:
    link, device = made
    rows = rows_of(kind.described().model)
    for row in rows:
        store(device, row)
    arm = kind(link)
    with arm:
        model = arm.model
    for row in rows:
        store(device, change(row))
        with pytest.raises(DeviceError, match=f"the servos of {row.name} have stored another calibration"):
            arm.attach()
        assert not arm.is_attached
        assert not link.is_open
        store(device, row)
    with arm:
        assert arm.model == model


def test_an_arm_of_which_a_file_says_more_is_what_the_file_says(made: Made) -> None:
    link, device = made
    chain, profile = ChainArm.described().model, load_profile("so101")
    for row in rows_of(profile.model):
        store(device, row)
    own = Calibration("so101", "", tuple(replace(row, low=1300) for row in rows_of(profile.model)))
    renamed = BusArmFile(replace(profile.model, name="own"), profile.baud)
    for arm, model in (
        (ChainArm(link), chain),
        (So101Arm(link, calibration=own), own.apply(profile.model)),
        (So101Arm(link, arm=profile), profile.model),
        (So101Arm(link, arm=renamed), renamed.model),
    ):
        with arm:
            assert arm.model == model
            assert not arm.may_change_model
            assert not arm.doubt


def test_the_angle_is_zero_in_the_middle_of_the_range(kind: type[BusArm], made: Made) -> None:
    link, device = made
    for row in rows_of(kind.described().model):
        store(device, row)
    with kind(link) as arm:
        for name, angle in arm.read().positions.items():
            joint = arm.model.joint(name)
            assert joint.minimum == pytest.approx(-joint.maximum)
            # The neutral position 2048, less the offset, and a little for each joint.
            assert abs(angle) < math.radians(8.0)
