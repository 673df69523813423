"""Set-points as other programs send them, good, careless and hostile."""

from __future__ import annotations

import math

import pytest

from hexwire.errors import UsageError
from hexwire.ros2.values import ARRAY, of_array, of_joint_state
from zenoh_ros2.types import Types

TYPES = Types()
STATE = TYPES.message("sensor_msgs/msg/JointState")
JOINTS = ("J1", "J2")


def test_an_array_has_a_value_for_each_joint_in_order() -> None:
    assert of_array(TYPES.message(ARRAY)(data=[0.5, -0.5]), JOINTS) == {"J1": 0.5, "J2": -0.5}


@pytest.mark.parametrize(
    ("data", "text"),
    [
        ([], "data has 0 values for the 2 joints J1, J2"),
        ([0.1], "data has 1 values for the 2 joints"),
        ([0.1, 0.2, 0.3], "data has 3 values"),
        ([0.1, math.nan], "the value of J2 is nan, not a number"),
        ([math.inf, 0.1], "the value of J1 is inf, not a number"),
    ],
)
def test_a_wrong_array_is_refused(data: list[float], text: str) -> None:
    with pytest.raises(UsageError, match=text):
        of_array(TYPES.message(ARRAY)(data=data), JOINTS)


@pytest.mark.parametrize(
    ("names", "positions", "found"),
    [
        (["J1", "J2"], [0.5, -0.5], {"J1": 0.5, "J2": -0.5}),
        (["J2"], [0.5], {"J2": 0.5}),
        (["J1", "J2"], [math.nan, 0.5], {"J2": 0.5}),
        (["J1", "J2"], [math.nan, math.nan], {}),
        ([], [], {}),
    ],
)
def test_nan_means_no_command(names: list[str], positions: list[float], found: dict[str, float]) -> None:
    message = STATE(name=names, position=positions, velocity=[1.0] * len(names), effort=[math.nan])
    assert of_joint_state(message) == found


@pytest.mark.parametrize(
    ("names", "positions", "text"),
    [
        (["J1", "J2"], [0.5], "position has 1 values for 2 names"),
        (["J1"], [], "position has 0 values for 1 names"),
        ([], [0.5], "position has 1 values for 0 names"),
        (["J1", "J1"], [0.5, 0.5], "a joint is named twice: J1, J1"),
        (["J1"], [-math.inf], "the position of J1 is -inf"),
    ],
)
def test_a_wrong_joint_state_is_refused(names: list[str], positions: list[float], text: str) -> None:
    with pytest.raises(UsageError, match=text):
        of_joint_state(STATE(name=names, position=positions))
