from __future__ import annotations

import math

import pytest

from hexwire.control.loop.outcomes import Ended, Outcome, Progress, Reason
from hexwire.motion.trajectory import Sample


def test_error_is_desired_less_measured_joint_by_joint() -> None:
    rest = (0.0, 0.0)
    progress = Progress(("J1", "J2"), Sample((0.5, -0.2), rest, rest), (0.4, -0.1), (math.nan, 0.0), 12.0)
    assert progress.error == pytest.approx((0.1, -0.1))


def test_a_measured_joint_too_few_is_no_error_of_zero() -> None:
    rest = (0.0, 0.0)
    with pytest.raises(ValueError, match="shorter"):
        _ = Progress(("J1", "J2"), Sample((0.5, -0.2), rest, rest), (0.4,), rest, 12.0).error


def test_an_end_has_words_only_where_there_is_something_to_say() -> None:
    ended = Ended(Outcome.SUCCEEDED, Reason.REACHED)
    assert (ended.text, ended.outcome.value) == ("", "succeeded")
    assert ended != Ended(Outcome.ABORTED, Reason.REACHED)
