"""The files of a bag, read by rosbags; what is in them is tested with `zenoh_ros2`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from hexwire.errors import LocalProtocolError, UsageError
from hexwire.ros2.bag import BagWriter
from zenoh_ros2.qos import LATCHED
from zenoh_ros2.types import Types

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


def test_an_empty_bag_is_complete(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "b", TYPES):
        pass
    with Reader(tmp_path / "b") as reader:
        assert reader.message_count == 0


def test_an_existing_bag_is_overwritten_by_force_only(bag: Path) -> None:
    before = (bag / "arm_0.mcap").read_bytes()
    with pytest.raises(UsageError, match="already exists; --force"):
        BagWriter(bag, TYPES)
    assert (bag / "arm_0.mcap").read_bytes() == before
    with BagWriter(bag, TYPES, force=True) as writer:
        writer.write("/text", STRING, _string("x"), STAMP)
    with Reader(bag) as reader:
        assert reader.message_count == 1


def test_a_folder_with_other_files_is_never_overwritten(bag: Path) -> None:
    (bag / "thesis.txt").write_text("x")
    with pytest.raises(UsageError, match=r"it also has thesis\.txt"):
        BagWriter(bag, TYPES, force=True)


def test_what_cannot_be_a_bag_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(UsageError, match="is not a folder"):
        BagWriter(tmp_path / "file", TYPES, force=True)
    with pytest.raises(UsageError, match="cannot be created"):
        BagWriter(tmp_path / "none" / "b", TYPES)
    with pytest.raises(UsageError, match="has no name"):
        BagWriter("..", TYPES)


def test_an_error_before_the_first_message_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(LocalProtocolError), BagWriter(tmp_path / "b", TYPES) as writer:
        writer.write("/text", STRING, TYPES.message(STRING)(data=5), STAMP)
    assert not (tmp_path / "b").exists()


def test_an_error_later_keeps_what_was_written(tmp_path: Path) -> None:
    def broken_off() -> None:
        with BagWriter(tmp_path / "b", TYPES) as writer:
            writer.write("/text", STRING, _string("x"), STAMP)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        broken_off()
    with Reader(tmp_path / "b") as reader:
        assert reader.message_count == 1


def test_after_a_full_disk_nothing_more_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = BagWriter(tmp_path / "b", TYPES)
    writer.write("/text", STRING, _string("x"), STAMP)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(writer._writer, "add_message", full)
    for _ in range(2):
        with pytest.raises(OSError, match="No space left"):
            writer.write("/text", STRING, _string("y"), STAMP)
        monkeypatch.undo()
    writer.close()
    assert not (tmp_path / "b" / "metadata.yaml").exists()
