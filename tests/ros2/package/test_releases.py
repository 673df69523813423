from __future__ import annotations

import pytest

from hexwire.errors import UsageError
from hexwire.ros2.package.releases import DEFAULT_RELEASE, RELEASES, release, usual_release
from zenoh_ros2.distributions import Distribution


def test_releases_are_the_nodes_distributions() -> None:
    assert list(RELEASES) == [distribution.value for distribution in Distribution]
    assert DEFAULT_RELEASE in RELEASES


@pytest.mark.parametrize(
    ("environment", "name"),
    [({}, "jazzy"), ({"ROS_DISTRO": "kilted"}, "kilted"), ({"ROS_DISTRO": "noetic"}, "jazzy")],
)
def test_the_usual_one_is_that_of_the_shell(environment: dict[str, str], name: str) -> None:
    assert usual_release(environment) == name


def test_name_in_any_case() -> None:
    assert release("Humble").name == "humble"


def test_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(
        UsageError, match="no ROS 2 distribution 'foxy'; choose one of humble, jazzy, kilted, lyrical, rolling"
    ):
        release("foxy")


def test_humble_has_the_plug_ins_by_their_old_names() -> None:
    humble, jazzy = release("humble"), release("jazzy")
    assert humble.hardware == "topic_based_ros2_control/TopicBasedSystem"
    assert jazzy.hardware == "joint_state_topic_hardware_interface/JointStateTopicSystem"
    # The controller manager of Humble looks below its own name.
    assert (humble.description_topic, jazzy.description_topic) == ("~/robot_description", "robot_description")


@pytest.mark.parametrize("name", RELEASES)
def test_plug_ins_come_from_the_packages_that_are_needed(name: str) -> None:
    found = release(name)
    assert found.hardware.split("/")[0] == found.hardware_package
    assert found.gripper.endswith("/GripperActionController")
    # Without it, the topic plug-in of Humble would start from 0 and command the arm to go there.
    assert (found.unknown_state == "nan") == (found.hardware_package == "topic_based_ros2_control")
