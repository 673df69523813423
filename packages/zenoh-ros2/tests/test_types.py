"""Types by name, and their messages."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.few import few
from zenoh_ros2_tests.messages import NAMES, messages_of

from zenoh_ros2.distributions import Distribution
from zenoh_ros2.errors import UsageError
from zenoh_ros2.types import Types


@few("distribution", Distribution, *list(Distribution)[::4])
def test_every_type_has_default_messages(distribution: Distribution) -> None:
    types = Types(distribution)
    assert len(NAMES) > 100
    for name in NAMES:
        for type_ in messages_of(types, name):
            assert type_.parse(type_.serialize(type_())) == type_()


def test_default_values_are_those_of_ros() -> None:
    quaternion = Types().message("geometry_msgs/msg/Quaternion")()
    assert (quaternion.x, quaternion.w) == (0.0, 1.0)
    request = Types().service("type_description_interfaces/srv/GetTypeDescription").request()
    assert request.include_type_sources is True
    assert Types().message("unique_identifier_msgs/msg/UUID")().uuid == bytes(16)


def test_messages_share_no_default_value() -> None:
    type_ = Types().message("sensor_msgs/msg/JointState")
    first, second = type_(), type_()
    first.name.append("J1")
    first.header.frame_id = "x"
    assert second == type_()


def test_a_message_has_no_other_attributes() -> None:
    type_ = Types().message("std_msgs/msg/String")
    with pytest.raises(AttributeError):
        type_().datum = "x"
    with pytest.raises(TypeError):
        type_(datum="x")
    assert repr(type_(data="x")) == "String(data='x')"


def test_constants_are_attributes() -> None:
    result = Types().action("control_msgs/action/FollowJointTrajectory").result
    assert result.constants["GOAL_TOLERANCE_VIOLATED"] == -5
    assert result().INVALID_JOINTS == -2


def test_names_are_those_of_dds() -> None:
    types = Types()
    assert types.message("sensor_msgs/msg/JointState").dds_name == "sensor_msgs::msg::dds_::JointState_"
    assert types.service("std_srvs/srv/Trigger").dds_name == "std_srvs::srv::dds_::Trigger_"
    action = types.action("control_msgs/action/FollowJointTrajectory")
    assert action.send_goal.dds_name == "control_msgs::action::dds_::FollowJointTrajectory_SendGoal_"
    assert action.feedback.dds_name == "control_msgs::action::dds_::FollowJointTrajectory_FeedbackMessage_"


@pytest.mark.parametrize(
    "name", ["std_msgs/msg/Nothing", "std_msgs/String", "../msg/X", "std_srvs/srv/Trigger_Goal", ""]
)
def test_an_unknown_type_is_refused(name: str) -> None:
    with pytest.raises(UsageError):
        Types().message(name)


def test_a_service_is_no_message() -> None:
    with pytest.raises(UsageError, match="is not a message type"):
        Types().message("std_srvs/srv/Trigger")


def test_the_text_of_a_message_has_the_messages_in_it() -> None:
    text = Types().message("sensor_msgs/msg/JointState").text
    line = "=" * 80
    assert text == (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"
        f"\n{line}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
        f"\n{line}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    )


def test_a_description_names_fields_and_types_in_them() -> None:
    description = Types().message("geometry_msgs/msg/Pose").description
    assert description.type_description.type_name == "geometry_msgs/msg/Pose"
    point, quaternion = description.referenced_type_descriptions
    assert (point.type_name, quaternion.type_name) == ("geometry_msgs/msg/Point", "geometry_msgs/msg/Quaternion")
    w = quaternion.fields[3]
    assert (w.name, w.type.type_id, w.default_value) == ("w", 11, "1.0")


def test_sources_say_what_is_a_file_and_what_is_derived() -> None:
    sources = {each.type_name: each for each in Types().service("std_srvs/srv/Trigger").sources}
    assert sources["std_srvs/srv/Trigger"].encoding == "srv"
    assert "bool success" in sources["std_srvs/srv/Trigger"].raw_file_contents
    assert sources["std_srvs/srv/Trigger_Request"].encoding == "implicit"
    assert sources["service_msgs/msg/ServiceEventInfo"].encoding == "msg"


def test_interfaces_of_your_own_come_first_and_may_contain_those_of_ros(tmp_path: Path) -> None:
    folder = tmp_path / "my_msgs"
    for name, text in {
        "msg/Load": "std_msgs/Header header\nfloat64 torque 0.5",
        "srv/Tare": "---\nbool done",
    }.items():
        file = folder / f"{name}.{name.partition('/')[0]}"
        file.parent.mkdir(parents=True)
        file.write_text(text)
    types = Types(folders=[tmp_path])
    load = types.message("my_msgs/msg/Load")
    message = load(header=types.message("std_msgs/msg/Header")(frame_id="tool"))
    assert message.torque == 0.5
    assert load.parse(load.serialize(message)) == message
    assert types.service("my_msgs/srv/Tare").response(done=True).done
    with pytest.raises(UsageError, match="there is no ROS 2 type"):
        Types().message("my_msgs/msg/Load")
