from __future__ import annotations

import pytest

from hexwire.control.loop.outcomes import Reason
from hexwire.control.motion.goal_fields import ErrorCode
from hexwire.ros2.actions import CODES, in_log
from zenoh_ros2.types import Types


def test_the_codes_are_those_of_the_action() -> None:
    constants = Types().action("control_msgs/action/FollowJointTrajectory").result.constants
    assert {code.name: code.value for code in ErrorCode} == dict(constants)


@pytest.mark.parametrize("reason", list(Reason))
def test_every_reason_has_its_code(reason: Reason) -> None:
    expected = {
        Reason.REACHED: 0,
        Reason.CANCELLED: 0,
        Reason.WRONG_JOINTS: -2,
        Reason.TOO_LATE: -3,
        Reason.PATH_TOLERANCE: -4,
        Reason.GOAL_TOLERANCE: -5,
    }
    assert CODES[reason] == expected.get(reason, -1)
    assert in_log(reason, "why") == f"{CODES[reason].name}: why"
