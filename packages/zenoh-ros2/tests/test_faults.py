"""The field of a message that cannot be sent."""

from __future__ import annotations

from zenoh_ros2.faults import find_fault
from zenoh_ros2.types import Types

TYPES = Types()


def _fault(name: str, **fields: object) -> str:
    type_ = TYPES.message(name)
    return find_fault(TYPES.lookup(name)[0], type_(**fields), TYPES.lookup)


def test_each_kind_of_fault_is_named() -> None:
    assert _fault("builtin_interfaces/msg/Duration", sec=2**31) == ".sec: 2147483648 is not a int32"
    assert _fault("std_msgs/msg/Bool", data="no") == ".data: 'no' is not a bool"
    assert _fault("std_msgs/msg/String", data="\ud800") == ".data: '\\ud800' is not valid Unicode"
    assert _fault("std_msgs/msg/String", data=b"x") == ".data: b'x' is not a string"
    assert _fault("unique_identifier_msgs/msg/UUID", uuid=b"x") == ".uuid: 1 values, but there must be 16"
    name = "type_description_interfaces/msg/FieldType"
    assert _fault(name, nested_type_name="é" * 128) == ".nested_type_name: longer than 255 bytes"
    assert not _fault(name, nested_type_name="é" * 127 + "e")
    ranges = [TYPES.message("rcl_interfaces/msg/IntegerRange")()] * 2
    assert "2 values, but there may be 1" in _fault("rcl_interfaces/msg/ParameterDescriptor", integer_range=ranges)


def test_a_suitable_message_has_none() -> None:
    assert not _fault("sensor_msgs/msg/JointState", position=(1, 2.5))
