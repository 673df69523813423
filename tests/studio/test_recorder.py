from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.studio.fake_camera import JPEG, FakeCamera
from tests.studio.running import PATIENCE, until

from hexwire.errors import UsageError
from hexwire.studio.recorder import LiveRecorder
from hexwire.studio.source import ArmSource, Source
from hexwire.trace.capture import CapturedMessage, read_messages
from hexwire.trace.foxglove import nanoseconds
from hexwire.trace.library import Library
from hexwire.trace.pictures import RecordedPictures


@pytest.fixture
def arm() -> Iterator[ArmSource]:
    source = Source()
    try:
        yield source.open("sim://hex7bot?name=recorded")
    finally:
        source.close()


def test_states_and_goals_of_the_open_arm_are_recorded(arm: ArmSource, tmp_path: Path) -> None:
    library = Library(tmp_path / "r")
    recorder = LiveRecorder(library)
    arm.goals["J1"] = 0.25
    name = recorder.start(arm)
    with pytest.raises(UsageError, match="is being recorded; end it first"):
        recorder.start(arm)
    until(lambda: recorder.state.states > 5, "states")
    assert recorder.state.name == name
    said = recorder.stop()
    assert said.startswith(f"{name}: ")
    assert arm.listeners == ()
    (one,) = library.entries()
    assert one.robot == "hex7bot"
    assert one.states > 5
    assert one.problem == ""
    assert one.joints == arm.settings.model.names
    assert set(library.series(name).columns["J1", "goal"]) == {0.25}
    assert recorder.state.name == ""
    assert recorder.state.ended == said


def test_pictures_are_recorded_with_the_time_of_the_states_and_a_camera_that_is_unplugged_ends_nothing(
    arm: ArmSource, tmp_path: Path
) -> None:
    library, fakes = Library(tmp_path / "r"), [FakeCamera(), FakeCamera("video2")]
    recorder = LiveRecorder(library)
    name = recorder.start(arm, [fake.camera for fake in fakes])
    before = time.monotonic()
    fakes[0].put(stamp=before - 7.0)
    fakes[0].put(stamp=before - 5.0)
    fakes[1].put(stamp=before - 6.0)
    until(lambda: recorder.state.pictures == 3, "pictures")
    fakes[0].unplug()
    until(lambda: "no camera is connected at /dev/video0" in recorder.state.problems.values(), "the words")
    states = recorder.state.states
    until(lambda: recorder.state.states > states, "states")
    assert ", 3 pictures" in recorder.stop()
    until(lambda: not fakes[1].is_open, "the end of the camera")
    for fake in fakes:
        fake.camera.close()
    (one,) = library.entries()
    assert one.problem == ""
    assert one.cameras == ("/camera/video0", "/camera/video2")
    # Of this clock: between the first picture and now.
    wall = time.time() - time.monotonic()
    with library.open(name) as file:
        pictures = RecordedPictures(file, name)
        assert pictures.at(file, "/camera/video0", nanoseconds(wall + before)) == JPEG
        with pytest.raises(UsageError, match="no picture on /camera/video1"):
            pictures.at(file, "/camera/video1", 0)
    stamps = [message.time - wall - before for message in messages(library.path(name)) if "camera" in message.topic]
    assert sorted(stamps) == pytest.approx([-7.0, -6.0, -5.0], abs=0.5)


def messages(path: Path) -> list[CapturedMessage]:
    with path.open("rb") as file:
        return [message for message in read_messages(file, path.name) if isinstance(message, CapturedMessage)]


def test_a_recording_ends_before_the_disk_is_full_and_pictures_that_wait_are_bounded(
    arm: ArmSource, tmp_path: Path
) -> None:
    fake = FakeCamera()
    for bounds, why in (
        ({"largest": 100}, "no recording is larger"),
        ({"free": 1 << 62}, "the disk has less than"),
    ):
        recorder = LiveRecorder(Library(tmp_path / "r"), **bounds)
        recorder.start(arm, [fake.camera])
        until(lambda: why in recorder.state.ended, why)  # noqa: B023  # it is waited for here
        recorder.stop()
    recorder = LiveRecorder(Library(tmp_path / "r"))
    recorder.start(arm, [fake.camera])
    present = recorder._present
    assert present is not None
    written = threading.Event()
    write = present._writer.picture

    def slow(*args: object) -> None:
        assert written.wait(PATIENCE)
        write(*args)  # type: ignore[arg-type]

    present._writer.picture = slow  # type: ignore[method-assign]
    for stamp in range(40):
        fake.put(stamp=stamp)
    # The disk takes the first one, and 31 others wait at least.
    until(lambda: recorder.state.lost >= 40 - 1 - 32, "lost pictures")
    assert recorder.state.pictures == 0
    written.set()
    assert "lost" in recorder.stop()
    fake.camera.close()


def test_an_end_without_a_recording_says_nothing(tmp_path: Path) -> None:
    recorder = LiveRecorder(Library(tmp_path))
    assert recorder.stop() == ""
    assert recorder.state.name == ""


def test_a_disk_that_fails_ends_the_recording_and_is_told(
    arm: ArmSource, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = LiveRecorder(Library(tmp_path / "r"))
    recorder.start(arm)
    present = recorder._present
    assert present is not None

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(present._writer, "joint_state", full)
    until(lambda: not present.active, "the end")
    assert "No space left on device" in recorder.state.ended
    assert recorder.state.name == ""
    assert arm.listeners == ()
    recorder.stop()


def test_a_slow_disk_loses_states_and_does_not_grow(
    arm: ArmSource, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # As many as may wait.
    monkeypatch.setattr("hexwire.studio.recorder._WAITING", 0)
    recorder = LiveRecorder(Library(tmp_path / "r"))
    recorder.start(arm)
    until(lambda: recorder.state.lost >= 3, "lost states")
    assert recorder.state.states == 0
    recorder.stop()
