"""What differs between distributions."""

from __future__ import annotations

from zenoh_ros2.distributions import Distribution
from zenoh_ros2.types import Types

STATE = "control_msgs/msg/JointTrajectoryControllerState"
FEEDBACK = "control_msgs/action/FollowJointTrajectory_Feedback"


def test_distributions_are_found_by_their_names() -> None:
    assert Distribution("humble") is Distribution.HUMBLE
    assert [each.value for each in Distribution] == ["humble", "jazzy", "kilted", "lyrical", "rolling"]


def test_humble_has_the_old_names_of_a_controller_state_beside_the_new_ones() -> None:
    fields = Types(Distribution.HUMBLE).message(STATE).fields
    assert fields[2:8] == ("reference", "feedback", "error", "output", "desired", "actual")
    assert "speed_scaling_factor" not in fields


def test_later_distributions_have_a_speed_scaling_factor_and_no_old_names() -> None:
    for each in set(Distribution) - {Distribution.HUMBLE}:
        fields = Types(each).message(STATE).fields
        assert fields[2:6] == ("reference", "feedback", "error", "output")
        assert fields[-1] == "speed_scaling_factor"
        assert "desired" not in fields


def test_distributions_since_kilted_have_the_index_in_the_feedback() -> None:
    for each in Distribution:
        fields = Types(each).message(FEEDBACK).fields
        has_index = "index" in fields, "multi_dof_index" in fields
        assert has_index == (each not in (Distribution.HUMBLE, Distribution.JAZZY),) * 2
        assert fields[2:5] == ("desired", "actual", "error")


def test_transition_events_of_lyrical_and_rolling_have_a_stamp() -> None:
    for each in Distribution:
        message = Types(each).message("lifecycle_msgs/msg/TransitionEvent")
        assert message.fields[0] == (
            "stamp" if each in (Distribution.LYRICAL, Distribution.ROLLING) else "timestamp"
        )


def test_humble_has_no_type_hashes() -> None:
    types = Types(Distribution.HUMBLE)
    assert types.message("std_msgs/msg/String").hash == "TypeHashNotSupported"
    assert types.service("std_srvs/srv/Trigger").hash == "TypeHashNotSupported"
