"""What a bag holds of a recording, read by rosbags."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader

from hexwire.errors import UsageError
from hexwire.model.state import JointState
from hexwire.ros2.bag import BagRecording, convert, ros_topic
from hexwire.trace.recording import RecordingWriter
from zenoh_ros2.types import Types

NOW = 1_700_000_000.0


def _state(position: float, stamp: float, age: float = 0.0) -> JointState:
    nan = math.nan
    return JointState(
        names=("J1", "J2"),
        position=(position, nan),
        velocity=(0.25, nan),
        load=(0.5, nan),
        current=(nan, nan),
        voltage=(12.0, nan),
        temperature=(nan, nan),
        flags=(64, 128),
        age=(age, math.inf),
        stamp=stamp,
    )


def _read(folder: Path) -> dict[str, list[tuple[int, Any]]]:
    found: dict[str, list[tuple[int, Any]]] = {}
    with AnyReader([folder]) as reader:
        for each, stamp, data in reader.messages():
            found.setdefault(each.topic, []).append((stamp, reader.deserialize(data, each.msgtype)))
    return found


def _check_states(found: dict[str, list[tuple[int, Any]]], prefix: str = "") -> None:
    (_, first), (log_time, second) = found[f"{prefix}/joint_states"]
    # J2 has never been sampled.
    assert (first.name, first.position.tolist(), first.velocity.tolist()) == (["J1"], [0.5], [0.25])
    assert first.effort.tolist() == []
    assert log_time == 1_700_000_001_000_000_000
    # The stamp is the time of the sample, 20 ms before the state.
    assert (second.header.stamp.sec, second.header.stamp.nanosec) == (
        1_700_000_000,
        pytest.approx(980_000_000, abs=1e3),
    )
    _, all_known = found[f"{prefix}/dynamic_joint_states"][0]
    assert all_known.joint_names == ["J1", "J2"]
    one, two = all_known.interface_values
    assert dict(zip(one.interface_names, one.values.tolist(), strict=True)) == {
        "position": 0.5,
        "velocity": 0.25,
        "load": 0.5,
        "voltage": 12.0,
        "goal": 0.75,
        "flags": 64.0,
    }
    assert two.interface_names == ["flags"]


def test_states_are_recorded_as_they_are_read(tmp_path: Path) -> None:
    recording = BagRecording(tmp_path / "b", Types())
    recording.joint_state(_state(0.5, 10.0), NOW, goals={"J1": 0.75})
    recording.joint_state(_state(0.6, 11.0, age=0.02), NOW + 1.0)
    assert recording.count == 4
    recording.close()
    _check_states(_read(tmp_path / "b"))


def test_an_earlier_bag_is_replaced_by_force_only(tmp_path: Path) -> None:
    for force in (False, True):
        recording = BagRecording(tmp_path / "b", Types(), force=force)
        recording.joint_state(_state(0.5, 10.0), NOW)
        recording.close()
    with pytest.raises(UsageError, match="already exists; --force"):
        BagRecording(tmp_path / "b", Types())


def test_the_description_is_written_once(tmp_path: Path) -> None:
    recording = BagRecording(tmp_path / "b", Types())
    recording.urdf = "<robot/>"
    for stamp in (10.0, 11.0):
        recording.joint_state(_state(0.5, stamp), NOW + stamp)
        recording.joint_state(_state(0.5, stamp), NOW + stamp, topic="/lab/arm-1/joint_states")
    recording.close()
    found = _read(tmp_path / "b")
    for prefix in ("", "/lab/arm_1"):
        ((stamp, message),) = found[f"{prefix}/robot_description"]
        assert (stamp, message.data) == (1_700_000_010_000_000_000, "<robot/>")


def test_a_state_after_2038_keeps_the_time_of_its_message(tmp_path: Path) -> None:
    recording = BagRecording(tmp_path / "b", Types())
    recording.joint_state(_state(0.5, 10.0), 3e9)
    recording.close()
    ((stamp, message),) = _read(tmp_path / "b")["/joint_states"]
    assert (stamp, message.header.stamp.sec) == (3_000_000_000_000_000_000, 2**31 - 1)


def test_a_recording_that_is_discarded_leaves_nothing(tmp_path: Path) -> None:
    BagRecording(tmp_path / "b", Types()).discard()
    assert not (tmp_path / "b").exists()


def test_a_recording_becomes_a_bag(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with RecordingWriter(path) as writer:
        for topic in ("/joint_states", "/lab/arm-1/joint_states"):
            writer.joint_state(_state(0.5, 10.0), NOW, topic=topic, goals={"J1": 0.75})
            writer.joint_state(_state(0.6, 11.0, age=0.02), NOW + 1.0, topic=topic)
        body = {"level": 3, "name": "sent", "message": "a servo is silent ä", "file": "", "line": 0}
        writer.message("/frames", "foxglove.Log", NOW, {"timestamp": {"sec": 1, "nsec": 0}, **body})
        writer.raw("/bytes/sent", NOW, b"\x5a\xfa")
        writer.message("/clock", "hexwire.Clock", NOW, {"offset": 0.5})
    notes: list[str] = []
    recording = BagRecording(tmp_path / "b", Types())
    with path.open("rb") as file:
        recording.urdf = "<robot/>"
        left_out = convert(file, str(path), recording, note=notes.append)
    recording.close()
    assert left_out == {"hexwire.Clock": 1}
    assert notes == []
    found = _read(tmp_path / "b")
    _check_states(found)
    _check_states(found, "/lab/arm_1")
    ((_, log),) = found["/frames"]
    assert (log.level, log.name, log.msg, log.stamp.sec) == (30, "sent", "a servo is silent ä", 1_700_000_000)
    ((_, raw),) = found["/bytes/sent"]
    assert bytes(raw.data) == b"\x5a\xfa"
    assert {topic for topic in found if topic.endswith("robot_description")} == {
        "/robot_description",
        "/lab/arm_1/robot_description",
    }


def test_a_truncated_recording_is_converted_up_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with RecordingWriter(path) as writer:
        for i in range(3000):
            writer.joint_state(_state(0.001 * i, 10.0 + i), NOW + i)
    whole = path.read_bytes()
    notes: list[str] = []
    recording = BagRecording(tmp_path / "b", Types())
    convert(io.BytesIO(whole[: len(whole) // 2]), "a.mcap", recording, note=notes.append)
    recording.close()
    assert len(notes) == 1
    assert "truncated" in notes[0]
    assert 0 < len(_read(tmp_path / "b")["/joint_states"]) < 3000


def test_two_topics_never_become_one(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with RecordingWriter(path) as writer:
        writer.raw("/a-b", NOW, b"x")
        writer.raw("/a_b", NOW, b"x")
    recording = BagRecording(tmp_path / "b", Types())
    with path.open("rb") as file, pytest.raises(UsageError, match="/a-b and /a_b have the same name in ROS"):
        convert(file, str(path), recording, note=print)
    recording.discard()


def test_a_schema_without_a_place_is_refused(tmp_path: Path) -> None:
    recording = BagRecording(tmp_path / "b", Types())
    with pytest.raises(UsageError, match="no place for hexwire"):
        recording.message("/x", "hexwire.Clock", NOW, {})
    recording.discard()


@pytest.mark.parametrize(
    ("topic", "name"),
    [("/joint_states", "/joint_states"), ("/lab/arm-1/x", "/lab/arm_1/x"), ("/1st//é.x", "/_1st/__x"), ("x", "/x")],
)
def test_a_topic_gets_a_name_that_ros_allows(topic: str, name: str) -> None:
    assert ros_topic(topic) == name
