"""Every reason has its code, and the codes are those of the message."""

from __future__ import annotations

from hexwire.control.loop.outcomes import Reason
from hexwire.control.motion.goal_fields import CODES, ErrorCode
from hexwire.ros1.messages import PACKAGES


def test_every_reason_has_a_code() -> None:
    assert list(CODES) == list(Reason)


def test_codes_are_those_of_the_message() -> None:
    _, fields = PACKAGES["control_msgs"]["FollowJointTrajectoryResult"]
    constants = [line.split() for line in fields.splitlines() if "=" in line]
    assert {name: int(value) for _, name, _, value in constants} == {code.name: int(code) for code in ErrorCode}


def test_the_code_tells_what_clients_act_on() -> None:
    assert {reason: code for reason, code in CODES.items() if code is not ErrorCode.INVALID_GOAL} == {
        Reason.REACHED: 0,
        Reason.REPLACED: 0,
        Reason.CANCELLED: 0,
        Reason.WRONG_JOINTS: -2,
        Reason.TOO_LATE: -3,
        Reason.PATH_TOLERANCE: -4,
        Reason.GOAL_TOLERANCE: -5,
    }
