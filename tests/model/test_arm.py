"""Joints and arms: counts to angles and back, limits, names."""

from __future__ import annotations

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import LimitError, UsageError
from hexwire.model.arm import ArmModel, JointModel

JOINTS = st.builds(
    JointModel,
    name=st.just("J1"),
    servo_id=st.just(0),
    series=st.just("hls"),
    neutral=st.integers(0, 4095),
    sign=st.sampled_from((1, -1)),
    offset=st.floats(-3, 3),
    scale=st.floats(0.0005, 0.01),
    minimum=st.floats(-3, 0),
    maximum=st.floats(0.01, 3),
    max_speed=st.just(1.0),
)


def joint(name: str = "J1", servo_id: int = 0, *, sign: int = 1, offset: float = 0.0) -> JointModel:
    return JointModel(name, servo_id, "hls", 2047, sign, offset, 0.001534, -1.0 + offset, 1.0 + offset, 2.0)


@given(JOINTS, st.integers(-32768, 32767))
def test_counts_to_angle_and_back(model: JointModel, counts: int) -> None:
    assert model.angle_to_counts(model.counts_to_angle(counts)) == counts


@given(JOINTS, st.floats(-10, 10))
def test_an_angle_is_off_by_half_a_count_at_most(model: JointModel, angle: float) -> None:
    near = model.counts_to_angle(model.angle_to_counts(angle))
    assert abs(near - angle) <= 0.5 * model.scale * (1 + 1e-9) + 1e-12


@given(JOINTS)
def test_every_count_inside_the_limits_is_allowed(model: JointModel) -> None:
    low, high = model.count_limits
    for counts in {low, high, (low + high) // 2} if low <= high else ():
        model.check(model.counts_to_angle(counts))
    for counts in (low - 2, high + 2):
        with pytest.raises(LimitError):
            model.check(model.counts_to_angle(counts))


@given(JOINTS, st.floats(-4, 4))
def test_a_target_that_passes_the_check_is_at_most_one_count_beyond_the_limit(
    model: JointModel, angle: float
) -> None:
    low, high = model.count_limits
    try:
        model.check(angle)
    except LimitError:
        return
    assert low - 1 <= model.angle_to_counts(angle) <= high + 1


def test_sign_turns_position_and_speed() -> None:
    plus, minus = joint(), joint(sign=-1)
    assert plus.counts_to_angle(2147) == pytest.approx(0.1534)
    assert minus.counts_to_angle(2147) == pytest.approx(-0.1534)
    assert minus.angle_to_counts(-0.1534) == 2147
    assert plus.speed_to_angle(1000) == pytest.approx(1.534)
    assert minus.speed_to_angle(1000) == pytest.approx(-1.534)
    assert joint(offset=0.5).speed_to_angle(0) == 0


def test_a_limit_itself_may_be_named_and_no_more() -> None:
    model = joint()
    for angle in (1.0, -1.0, 1.0007):
        model.check(angle)
    for angle in (1.0008, -1.0008, math.inf, -math.inf, math.nan):
        with pytest.raises(LimitError) as caught:
            model.check(angle)
        assert "nothing was sent" in str(caught.value)
    with pytest.raises(LimitError, match=r"J1=90 deg is outside its limits -57.3 to 57.3 deg"):
        model.check(math.radians(90))


ARM = ArmModel("arm", (joint("J1", 0), joint("J2", 3), joint("Grip", 9)))


def test_joints_by_name_in_any_case_and_by_servo() -> None:
    assert ARM.names == ("J1", "J2", "Grip")
    assert ARM.joint("J2") is ARM.joint("j2") is ARM.joints[1]
    assert ARM.index("GRIP") == 2
    assert ARM.by_servo(9) is ARM.joints[2]
    assert ARM.by_servo(1) is None
    with pytest.raises(UsageError, match="no joint 'J3'; arm has J1, J2, Grip"):
        ARM.joint("J3")


def test_masks() -> None:
    assert ARM.mask() == 0b111
    assert ARM.mask([]) == 0
    assert ARM.mask(["grip", "J1", "J1"]) == 0b101


@pytest.mark.parametrize(
    "joints", [(joint("J1", 0), joint("J1", 1)), (joint("J1", 0), joint("J2", 0))], ids=["name", "servo id"]
)
def test_two_joints_that_share_something_are_refused(joints: tuple[JointModel, ...]) -> None:
    with pytest.raises(UsageError, match="two joints share a name or a servo id"):
        ArmModel("arm", joints)


def test_models_are_values() -> None:
    assert ArmModel("arm", ARM.joints) == ARM
    with pytest.raises(dataclasses.FrozenInstanceError):
        ARM.name = "other"  # type: ignore[misc]
    with pytest.raises(dataclasses.FrozenInstanceError):
        ARM.joints[0].sign = -1  # type: ignore[misc]


def test_an_arm_of_limits_alone() -> None:
    arm = ArmModel.of("swing", {"a": (-1.0, 1.0), "b": (0.0, 2.0)}, max_speed=0.5)
    assert (arm.name, arm.names, [joint.servo_id for joint in arm.joints]) == ("swing", ("a", "b"), [1, 2])
    assert (arm.joint("b").minimum, arm.joint("b").maximum, arm.joint("b").max_speed) == (0.0, 2.0, 0.5)
    with pytest.raises(LimitError):
        arm.joint("a").check(1.001)
    with pytest.raises(UsageError, match="limits of a are 1 to -1 rad"):
        ArmModel.of("swing", {"a": (1.0, -1.0)}, max_speed=0.5)
