"""Bags of ROS 2, read by rosbags."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from zenoh_ros2 import LATCHED, Distribution, LocalProtocolError, Types
from zenoh_ros2.bag import BagWriter

TYPES = Types()
STAMP = 1_700_000_000_123_456_789
STRING = "std_msgs/msg/String"


def _string(text: str) -> Any:
    return TYPES.message(STRING)(data=text)


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """A bag with a latched text and three joint states."""
    folder = tmp_path / "arm"
    with BagWriter(folder, TYPES) as writer:
        writer.write("/robot_description", STRING, _string("<robot/>"), STAMP, LATCHED)
        joint_state = TYPES.message("sensor_msgs/msg/JointState")
        for i in range(3):
            message = joint_state(name=["J1", "J2"], position=[0.5 * i, -1.0])
            writer.write("/joint_states", joint_state.name, message, STAMP + i * 10_000_000)
        assert writer.count == 4
    return folder


def test_rosbags_reads_the_bag(bag: Path) -> None:
    with Reader(bag) as reader:
        assert reader.message_count == 4
        assert reader.start_time == STAMP
        assert reader.duration == 20_000_001  # rosbags counts the last nanosecond.
        assert {each.topic: (each.msgtype, each.msgcount) for each in reader.connections} == {
            "/robot_description": (STRING, 1),
            "/joint_states": ("sensor_msgs/msg/JointState", 3),
        }
        store = get_typestore(Stores.ROS2_JAZZY)
        found = [
            (stamp, store.deserialize_cdr(data, each.msgtype))
            for each, stamp, data in reader.messages()
            if each.topic == "/joint_states"
        ]
    assert [stamp for stamp, _ in found] == [STAMP, STAMP + 10_000_000, STAMP + 20_000_000]
    assert [message.position.tolist() for _, message in found] == [[0.0, -1.0], [0.5, -1.0], [1.0, -1.0]]
    assert found[0][1].name == ["J1", "J2"]


def test_rosbags_knows_the_types_from_the_bag_alone(bag: Path) -> None:
    with AnyReader([bag], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        texts = [
            reader.deserialize(data, each.msgtype).data
            for each, _, data in reader.messages()
            if each.topic == "/robot_description"
        ]
    assert texts == ["<robot/>"]


def test_the_latched_topic_is_offered_as_such(bag: Path) -> None:
    information = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["version"] == 8
    assert information["ros_distro"] == "jazzy"
    rows = {
        row["topic_metadata"]["name"]: row["topic_metadata"] for row in information["topics_with_message_count"]
    }
    (latched,), (usual,) = (
        yaml.safe_load(rows[topic]["offered_qos_profiles"]) for topic in ("/robot_description", "/joint_states")
    )
    assert (latched["durability"], latched["depth"]) == (1, 1)
    assert (usual["durability"], usual["reliability"], usual["history"], usual["depth"]) == (2, 1, 1, 10)
    assert usual["lifespan"] == {"sec": 9223372036, "nsec": 854775807}
    assert rows["/joint_states"]["type_description_hash"] == TYPES.message("sensor_msgs/msg/JointState").hash


def test_the_mcap_file_has_the_profile_of_ros_2(bag: Path) -> None:
    with (bag / "arm_0.mcap").open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
    assert summary is not None
    assert {(each.name, each.encoding) for each in summary.schemas.values()} == {
        (STRING, "ros2msg"),
        ("sensor_msgs/msg/JointState", "ros2msg"),
    }
    assert {each.message_encoding for each in summary.channels.values()} == {"cdr"}
    joint_states = next(each for each in summary.channels.values() if each.topic == "/joint_states")
    assert joint_states.metadata["topic_type_hash"].startswith("RIHS01_a13ee3a3")
    assert "durability: 2" in joint_states.metadata["offered_qos_profiles"]


def test_a_distribution_without_hashes_writes_none(tmp_path: Path) -> None:
    types = Types(Distribution.HUMBLE)
    with BagWriter(tmp_path / "b", types) as writer:
        writer.write("/text", STRING, types.message(STRING)(data="x"), STAMP)
    text = (tmp_path / "b" / "metadata.yaml").read_text()
    assert 'type_description_hash: ""' in text
    assert "ros_distro: humble" in text


def test_an_empty_bag_is_complete(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "b", TYPES):
        pass
    with Reader(tmp_path / "b") as reader:
        assert reader.message_count == 0


def test_a_folder_that_exists_is_left_alone(bag: Path) -> None:
    before = {path.name: path.read_bytes() for path in bag.iterdir()}
    with pytest.raises(FileExistsError):
        BagWriter(bag, TYPES)
    assert {path.name: path.read_bytes() for path in bag.iterdir()} == before


def test_after_an_error_the_bag_has_what_was_written_before(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "b", TYPES) as writer:
        writer.write("/text", STRING, _string("x"), STAMP)
        with pytest.raises(LocalProtocolError):
            writer.write("/text", STRING, TYPES.message(STRING)(data=5), STAMP)
    writer.close()
    with Reader(tmp_path / "b") as reader:
        assert reader.message_count == 1
