from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from tests.motion.arms import HOME, NAMES, state
from tests.recorded import make_positions

from hexwire.errors import ConfigError, UsageError
from hexwire.model.state import JointFlag
from hexwire.trace import recording as module
from hexwire.trace.recording import JOINT_STATES, RecordingWriter, read_joint_states, wall_time


def write(path: Path, n: int = 5) -> None:
    with RecordingWriter(path) as recording:
        for i in range(n):
            recording.joint_state(state({"J1": 0.01 * i}, load={"J2": 0.25}), 1700000000.0 + 0.05 * i)
        assert recording.count == n


def test_what_was_written_is_read(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap")
    rows = list(read_joint_states(tmp_path / "a.mcap"))
    assert [row.position[0] for row in rows] == pytest.approx([0.0, 0.01, 0.02, 0.03, 0.04])
    assert [row.time for row in rows] == pytest.approx([1700000000.0 + 0.05 * i for i in range(5)])
    assert rows[0].names == NAMES
    assert rows[0].position[1] == HOME["J2"]
    assert rows[0].values[1]["load"] == 0.25
    assert rows[0].values[0]["flags"] == JointFlag.TORQUE_ON


def test_other_programs_read_it(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as file:
        found = list(make_reader(file, validate_crcs=True).iter_messages())
    schema, channel, message = found[-1]
    assert schema is not None
    assert (schema.name, schema.encoding) == ("foxglove.JointStates", "jsonschema")
    assert (channel.topic, channel.message_encoding) == (JOINT_STATES, "json")
    body = json.loads(message.data)
    assert body["timestamp"]["sec"] == 1700000000
    assert body["timestamp"]["nsec"] == pytest.approx(200_000_000, abs=500)
    assert body["joints"][0]["name"] == "J1"
    assert set(json.loads(schema.data)["properties"]) == {"timestamp", "joints"}


def test_a_state_has_the_time_of_day_at_which_it_was_read(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(time=lambda: 1000.0, monotonic=lambda: 50.0)
    monkeypatch.setattr(module, "time", clock)
    assert wall_time(state(stamp=48.5)) == 998.5


def test_positions_alone(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "a.mcap") as recording:
        recording.joint_state(make_positions(("a", "b"), (0.5, -0.5)), 3.0)
    row = next(read_joint_states(tmp_path / "a.mcap"))
    assert (row.time, row.names, row.position) == (3.0, ("a", "b"), (0.5, -0.5))
    assert set(row.values[0]) == {"position", "flags"}


def test_unknown_values_are_left_out(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "a.mcap") as recording:
        recording.joint_state(state({"J3": math.nan}, load={"J1": math.nan}), 1.0)
    row = next(read_joint_states(tmp_path / "a.mcap"))
    assert "J3" not in row.names
    assert "load" not in row.values[0]


def test_a_file_that_was_cut_off_gives_what_is_whole(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap", 4000)
    data = (tmp_path / "a.mcap").read_bytes()
    (tmp_path / "b.mcap").write_bytes(data[: len(data) // 2])
    rows = list(read_joint_states(tmp_path / "b.mcap"))
    assert 1000 < len(rows) < 4000


def test_a_file_that_is_not_a_recording_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"hello, world, this is not a recording")
    with pytest.raises(UsageError, match=r"a\.mcap is not a recording"):
        list(read_joint_states(tmp_path / "a.mcap"))
    (tmp_path / "b.mcap").write_bytes(b"")
    with pytest.raises(UsageError, match=r"b\.mcap is not a recording"):
        list(read_joint_states(tmp_path / "b.mcap"))


@settings(max_examples=200)
@given(data=st.data())
def test_damaged_files_give_one_error(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    path = tmp_path_factory.mktemp("r") / "a.mcap"
    write(path, 40)
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(bytes(content[: data.draw(st.integers(0, len(content)))]))
    try:
        rows = list(read_joint_states(path))
    except UsageError:
        return
    assert len(rows) <= 40


def test_an_invalid_joint_state_is_refused(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "a.mcap") as recording:
        recording.message(JOINT_STATES, "foxglove.JointStates", 1.0, {"joints": 7})
    with pytest.raises(UsageError, match=r"a\.mcap: joint state 1\.joints must be a list, not 7"):
        list(read_joint_states(tmp_path / "a.mcap"))
    with RecordingWriter(tmp_path / "b.mcap") as recording:
        twice = {"joints": [{"name": "J1", "position": 0.1}, {"name": "J1", "position": 0.2}]}
        recording.message(JOINT_STATES, "foxglove.JointStates", 1.0, twice)
    with pytest.raises(UsageError, match=r"b\.mcap: joint state 1\.joints name a joint twice"):
        list(read_joint_states(tmp_path / "b.mcap"))


def test_a_message_of_brackets_only_does_not_fill_the_memory(tmp_path: Path) -> None:
    # Two thousand bytes of file, thirty million of Python's lists.
    body = {"joints": [{"name": "a", "position": 0.1}], "more": [[]] * 400_000}
    with RecordingWriter(tmp_path / "a.mcap") as recording:
        recording.message(JOINT_STATES, "foxglove.JointStates", 1.0, body)
    with pytest.raises(ConfigError, match=r"a\.mcap: joint state 1 has [0-9]+ bytes; no message"):
        list(read_joint_states(tmp_path / "a.mcap"))


def test_without_the_package_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with pytest.raises(UsageError, match=r"pip install 'hexwire\[record\]'"):
        RecordingWriter(tmp_path / "a.mcap")
    assert not (tmp_path / "a.mcap").exists()


@pytest.mark.parametrize("stamp", [math.nan, math.inf, -1.0, 1e300])
def test_a_clock_that_makes_no_sense_is_refused(stamp: float, tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "a.mcap") as recording:
        with pytest.raises(UsageError, match="a recording cannot store the time"):
            recording.joint_state(state(), stamp)
        recording.joint_state(state(), 1.0)
    assert len(list(read_joint_states(tmp_path / "a.mcap"))) == 1


def test_a_disk_that_is_full_ends_the_recording_and_fills_no_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written: list[int] = []

    def add_message(**fields: Any) -> None:
        written.append(len(fields["data"]))
        if len(written) > 3:
            raise OSError(28, "No space left on device")

    recording = RecordingWriter(tmp_path / "a.mcap")
    monkeypatch.setattr(recording._writer, "add_message", add_message)
    for i in range(10):
        if i < 3:
            recording.joint_state(state(), 1.0 + i)
        else:
            with pytest.raises(OSError, match="No space left"):
                recording.joint_state(state(), 1.0 + i)
    recording.close()
    recording.close()
    assert len(written) == 4


@pytest.mark.slow
def test_a_whole_recording_can_be_asked_for(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap", 4000)
    assert len(list(read_joint_states(tmp_path / "a.mcap", whole=True))) == 4000
    data = (tmp_path / "a.mcap").read_bytes()
    (tmp_path / "b.mcap").write_bytes(data[: len(data) // 2])
    with pytest.raises(ConfigError, match=r"b\.mcap: the recording is truncated"):
        list(read_joint_states(tmp_path / "b.mcap", whole=True))


def _messages(path: Path, bodies: list[bytes]) -> Path:
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(name="foxglove.JointStates", encoding="jsonschema", data=b"{}")
        channel = writer.register_channel(topic="/joint_states", message_encoding="json", schema_id=schema)
        for i, body in enumerate(bodies):
            writer.add_message(channel, log_time=i + 1, publish_time=0, data=body)
        writer.finish()
    return path


_LIKE = b'{"timestamp":{"sec":5,"nsec":500000000},"joints":[{"name":"J1","position":0.5,"load":1}]}'


@pytest.mark.parametrize(
    ("other", "why"),
    [
        (_LIKE.replace(b"0.5,", b'"x",'), "position must be a number"),
        (_LIKE.replace(b"0.5,", b"NaN,"), "position must be a finite number"),
        (_LIKE.replace(b"0.5,", b"true,"), "position must be a number"),
        (_LIKE.replace(b"0.5,", b"20000.0,"), "position is 20000"),
        (_LIKE.replace(b"5,", b"-5,", 1), "sec is -5"),
        (_LIKE.replace(b"5,", b"5.0,", 1), "sec must be a whole number"),
        (_LIKE.replace(b"500000000", b"5000000000"), "nsec is 5000000000"),
        (_LIKE.replace(b'"name":"J1",', b""), "name is missing"),
        (_LIKE.replace(b'{"sec":5,"nsec":500000000}', b"5"), "timestamp must be a table"),
        (b"[]", "must be a table"),
    ],
)
def test_a_state_is_checked_as_much_as_the_one_before_it(tmp_path: Path, other: bytes, why: str) -> None:
    path = _messages(tmp_path / "a.mcap", [_LIKE, _LIKE, other])
    with pytest.raises(ConfigError, match=f"joint state 3.*{why}"):
        list(read_joint_states(path))


def test_states_that_are_alike_are_read_quickly_and_as_the_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import hexwire.trace.recording

    slow: list[object] = []
    checked = hexwire.trace.recording._checked
    monkeypatch.setattr(hexwire.trace.recording, "_checked", lambda item: slow.append(item) or checked(item))
    other = _LIKE.replace(b"J1", b"K1")
    states = list(read_joint_states(_messages(tmp_path / "a.mcap", [_LIKE] * 50 + [other] * 50)))
    assert len(slow) == 2
    assert states[0] == states[49]
    assert states[1].values == ({"position": 0.5, "load": 1.0},)
    assert (states[99].time, states[99].names) == (5.5, ("K1",))
