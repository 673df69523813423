from __future__ import annotations

from hexwire.control.loop.outcomes import Reason
from hexwire.control.motion.goal_fields import CODES as USUAL_CODES
from hexwire.control.motion.goal_fields import ErrorCode
from hexwire.ros2.actions import CODES, in_log
from zenoh_ros2.types import Types


def test_the_codes_are_those_of_the_action() -> None:
    constants = Types().action("control_msgs/action/FollowJointTrajectory").result.constants
    assert {code.name: code.value for code in ErrorCode} == dict(constants)


def test_a_goal_that_another_one_replaces_has_the_code_of_ros2_controllers() -> None:
    assert {reason: code for reason, code in CODES.items() if code is not USUAL_CODES[reason]} == {
        Reason.REPLACED: ErrorCode.INVALID_GOAL
    }
    assert in_log(Reason.WRONG_JOINTS, "why") == "INVALID_JOINTS: why"
