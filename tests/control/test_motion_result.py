"""How a motion ended, in words; the motions are in tests/control/test_motions.py."""

from __future__ import annotations

import math

import pytest

from hexwire.control.motion.arrival import Deviation
from hexwire.control.motion.motion_result import MotionResult
from hexwire.errors import ServoError
from hexwire.motion.safety import StopReason

OFF = (Deviation("J4", math.radians(20.0), 0.01),)


def test_who_has_arrived_has_nothing_to_tell() -> None:
    result = MotionResult(True)
    assert result.why == ""
    assert result.require() is result
    assert MotionResult(None).why == ""
    assert MotionResult(False, cut=True).why == ""


@pytest.mark.parametrize(
    ("result", "why"),
    [
        (MotionResult(False, StopReason("board", "somebody stopped it")), "stopped: somebody stopped it"),
        (MotionResult(False, without_torque=("J1", "J2")), "J1, J2 lost torque before the arrival"),
        (MotionResult(False, off=OFF), "did not arrive: J4 is 20.0 deg off"),
        (
            MotionResult(False, off=OFF, ended="the board was reset"),
            "did not arrive: J4 is 20.0 deg off; the board was reset",
        ),
        (
            MotionResult(False, off=(Deviation("J4", math.inf, 0.01),)),
            "did not arrive: the position of J4 is unknown",
        ),
        (MotionResult(False), "did not arrive: some joints have not reported since the end"),
    ],
)
def test_why_it_has_not_arrived(result: MotionResult, why: str) -> None:
    assert result.why == why
    with pytest.raises(ServoError) as caught:
        result.require()
    assert str(caught.value) == why
