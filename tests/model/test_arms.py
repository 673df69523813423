"""What every arm's record promises, asked of all that are installed."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from tests.packages import install

from hexwire.drivers.registry import load_driver
from hexwire.errors import UsageError
from hexwire.link.open import make_link
from hexwire.model.arms import ArmRecord, arm_names, arm_record, arms_with_geometry, record_of, simulated_arms
from hexwire.model.geometry import kinematics_for, make_kinematics, make_shapes
from hexwire.model.gripper import jaws_of


@pytest.fixture(params=arm_names())
def record(request: pytest.FixtureRequest) -> ArmRecord:
    return arm_record(request.param)


def test_its_driver_has_its_joints(record: ArmRecord) -> None:
    model = load_driver(record.name).from_url(record.port).model
    assert model.kind == record.name
    assert not record.gripper or record.gripper in model.names
    assert (jaws_of(model) is not None) == bool(record.gripper)
    if record.assembly is not None:
        assert tuple(joint.name for joint in record.assembly.joints) == model.names


def test_its_geometry_is_that_of_its_driver(record: ArmRecord) -> None:
    model = load_driver(record.name).from_url(record.port).model
    assert (kinematics_for(model) is not None) == (record.kinematics is not None)
    assert (record.name in arms_with_geometry()) == (record.kinematics is not None)


@pytest.mark.parametrize("name", arms_with_geometry())
def test_its_poses_are_within_its_limits_and_its_shapes_have_its_name(name: str) -> None:
    record, model = arm_record(name), make_kinematics(name)
    shapes = make_shapes(model)
    assert model.name == shapes.name == name
    joints = load_driver(name).from_url(record.port).model.joints
    moving = [joint for joint in joints if joint.name != record.gripper]
    for pose, angles in record.poses.items():
        assert len(angles) == len(moving), pose
        for joint, angle in zip(moving, angles, strict=True):
            joint.check(angle)
    assert set(record.rods) <= {link.name for link in shapes.links}


def test_what_is_emulated_in_this_program_has_its_address() -> None:
    assert {"hex7bot", "so100", "so101"} <= set(simulated_arms())
    for name in simulated_arms():
        driver = load_driver(name).from_url(arm_record(name).emulated)
        driver.attach()
        try:
            assert driver.read().positions.keys() == set(driver.model.names)
        finally:
            driver.detach()


def test_an_arm_that_is_not_there() -> None:
    assert record_of("r2d2") is None
    with pytest.raises(UsageError, match=r"nothing is known of an arm 'r2d2'; there are hex7bot, "):
        arm_record("r2d2")


@pytest.mark.parametrize("code", ["ARM = 1", "from hexwire.model.arms.puma260 import ARM"])
def test_an_entry_point_that_names_no_record_or_another_one(
    code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "odd_arm", raising=False)
    install(tmp_path, "odd", {"hexwire.arms": {"odd": "odd_arm:ARM"}}, {"odd_arm.py": code})
    with pytest.raises(UsageError, match="'odd_arm:ARM' of arm 'odd' is not an ArmRecord of this name"):
        record_of("odd")
    # It takes no other arm from a list, nor from its address.
    assert {"hex7bot", "so101"} <= set(simulated_arms()) & set(arms_with_geometry())
    make_link("sim://hex7bot")
