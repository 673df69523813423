from __future__ import annotations

import contextlib
import io
import json
import threading
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from tests.analyzers.lines import readings_table
from tests.recorded import make_positions

from hexwire.errors import HexwireError, UsageError
from hexwire.link.tap import Direction, Passed
from hexwire.trace.capture import BYTES, FRAMES, Capture, CapturedMessage, read_messages, recover, traffic_of
from hexwire.trace.mcap_file import MAGIC
from hexwire.trace.recording import JOINT_STATES, read_joint_states
from hexwire.trace.sources import read_traffic

ROW = readings_table()[0]
TRAFFIC = [
    Passed(way, bytes.fromhex(data), 5.0 + i * 0.01, "serial:///dev/x")
    for i, (way, (_, data)) in enumerate(zip((Direction.SENT, Direction.RECEIVED), ROW["transfers"], strict=True))
]


def record(path: Path, *, states: int = 3) -> bytes:
    with Capture(path, offset=1000.0) as capture:
        for passed in TRAFFIC:
            capture.passed(passed)
        for i in range(states):
            capture.joint_state(make_positions(("a", "b"), (0.1 * i, -0.1)), 1006.0 + i)
    return path.read_bytes()


def messages(data: bytes) -> tuple[list[CapturedMessage], list[str]]:
    found = list(read_messages(io.BytesIO(data), "it"))
    return [m for m in found if isinstance(m, CapturedMessage)], [m for m in found if isinstance(m, str)]


def test_bytes_frames_and_states_stand_in_one_file(tmp_path: Path) -> None:
    data = record(tmp_path / "a.mcap")
    assert data.startswith(MAGIC)
    found, remarks = messages(data)
    assert remarks == []
    frames = [json.loads(m.data) for m in found if m.topic == FRAMES]
    assert [frame["message"] for frame in frames] == ROW["readings"]
    assert [(frame["name"], frame["level"]) for frame in frames] == [("sent", 2), ("received", 2)]
    assert frames[1]["timestamp"] == {"sec": 1005, "nsec": 10_000_000}
    assert {(m.topic, m.schema) for m in found} == {
        *((topic, "") for topic in BYTES.values()),
        (FRAMES, "foxglove.Log"),
        (JOINT_STATES, "foxglove.JointStates"),
    }
    assert [row.position for row in read_joint_states(tmp_path / "a.mcap")] == [(0.1 * i, -0.1) for i in range(3)]


def test_the_traffic_comes_back_as_it_went(tmp_path: Path) -> None:
    data = record(tmp_path / "a.mcap")
    wanted = [(p.direction, p.data, p.time + 1000.0) for p in TRAFFIC]
    found = [p for p in traffic_of(io.BytesIO(data), "it") if isinstance(p, Passed)]
    assert [(p.direction, p.data, pytest.approx(p.time)) for p in found] == wanted
    assert [(p.direction, p.data) for p in read_traffic(data) if isinstance(p, Passed)] == [w[:2] for w in wanted]


def test_what_is_doubtful_is_a_warning(tmp_path: Path) -> None:
    with Capture(tmp_path / "a.mcap", offset=0.0) as capture:
        capture.passed(Passed(Direction.SENT, b"noise", 1.0, "x"))
    found, _ = messages((tmp_path / "a.mcap").read_bytes())
    assert [json.loads(m.data)["level"] for m in found if m.topic == FRAMES] == [3]


def test_nothing_is_written_after_the_end_and_any_thread_may_tell(tmp_path: Path) -> None:
    capture = Capture(tmp_path / "a.mcap", offset=0.0)
    threads = [threading.Thread(target=lambda: [capture.passed(p) for p in TRAFFIC * 20]) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    capture.close()
    capture.close()
    capture.passed(TRAFFIC[0])
    capture.joint_state(make_positions(("a",), (0.0,)), 1.0)
    found, remarks = messages((tmp_path / "a.mcap").read_bytes())
    assert remarks == []
    assert sum(m.topic in BYTES.values() for m in found) == 160


def test_a_file_cut_off_is_recovered_up_to_its_last_whole_chunk(tmp_path: Path) -> None:
    data = record(tmp_path / "a.mcap", states=4000)
    whole, _ = messages(data)
    cut = data[: len(data) * 6 // 10]
    target = io.BytesIO()
    saved = recover(io.BytesIO(cut), "it", target)
    assert saved.problem
    assert len(whole) * 0.3 < saved.messages < len(whole)
    target.seek(0)
    with_index = list(make_reader(target, validate_crcs=True).iter_messages(log_time_order=False))
    found, remarks = messages(target.getvalue())
    assert remarks == []
    assert len(with_index) == saved.messages == len(found)
    assert found == whole[: saved.messages]


def test_a_whole_file_is_recovered_whole(tmp_path: Path) -> None:
    data = record(tmp_path / "a.mcap")
    target = io.BytesIO()
    saved = recover(io.BytesIO(data), "it", target)
    assert saved.problem == ""
    assert messages(target.getvalue()) == messages(data)


def test_what_is_none_is_refused() -> None:
    with pytest.raises(UsageError, match="it is not a recording"):
        list(read_messages(io.BytesIO(b"hello"), "it"))


@given(st.data())
def test_damage_anywhere_gives_messages_or_one_error(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = tmp_path_factory.getbasetemp() / "whole.mcap"
    good = path.read_bytes() if path.exists() else record(path)
    spoilt = bytearray(good[: data.draw(st.integers(0, len(good)))])
    for at, value in data.draw(st.lists(st.tuples(st.integers(0, len(good)), st.integers(0, 255)), max_size=4)):
        if at < len(spoilt):
            spoilt[at] = value
    for read in (
        lambda file: list(read_messages(file, "it")),
        lambda file: recover(file, "it", io.BytesIO()),
    ):
        with contextlib.suppress(UsageError):
            read(io.BytesIO(bytes(spoilt)))


def test_a_record_from_a_signal_handler_in_the_middle_is_refused_and_does_not_wait(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    capture = Capture(tmp_path / "a.mcap", offset=0.0)
    refused: list[str] = []
    usual = capture._writer.raw

    def raw(topic: str, stamp: float, data: bytes) -> None:
        try:
            capture.passed(TRAFFIC[1])
        except HexwireError as error:
            refused.append(str(error))
        usual(topic, stamp, data)

    monkeypatch.setattr(capture._writer, "raw", raw)
    capture.passed(TRAFFIC[0])
    capture.close()
    assert refused == ["a signal arrived while the recording was being written"]
    found, _ = messages((tmp_path / "a.mcap").read_bytes())
    assert [m.data for m in found if m.topic in BYTES.values()] == [TRAFFIC[0].data]
