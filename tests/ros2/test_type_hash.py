"""Type hashes, compared with those that ROS publishes."""

from __future__ import annotations

import pytest

from hexwire.ros2.distributions import Distribution
from hexwire.ros2.types import Types

PUBLISHED = {
    "std_msgs/msg/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_a_hash_is_the_published_one(name: str) -> None:
    types = Types()
    make = types.message if "/msg/" in name else types.service
    assert make(name).hash == f"RIHS01_{PUBLISHED[name]}"


def test_the_feedback_of_a_trajectory_has_two_hashes() -> None:
    name = "control_msgs/action/FollowJointTrajectory"
    before, after = (Types(each).action(name) for each in (Distribution.JAZZY, Distribution.KILTED))
    assert before.feedback.hash == "RIHS01_80398fcb9674a79081a9906e2ccf0c804dd7cb15e22e362e606ee87186beab71"
    assert after.feedback.hash == "RIHS01_95618cc73912d99b9acaa17d2da5e832cb0bfdeede7534fa8ec600feca2a6c4b"
    assert before.send_goal.hash == after.send_goal.hash
