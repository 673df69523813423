from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.studio.running import until

from hexwire.errors import UsageError
from hexwire.studio.recorder import LiveRecorder
from hexwire.studio.source import ArmSource, Source
from hexwire.trace.library import Library


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


def test_a_slow_disk_loses_states_and_does_not_grow(arm: ArmSource, tmp_path: Path) -> None:
    recorder = LiveRecorder(Library(tmp_path / "r"))
    recorder.start(arm)
    present = recorder._present
    assert present is not None

    class Full:
        def qsize(self) -> int:
            return 1_000_000

    queue, present._queue = present._queue, Full()  # type: ignore[assignment]
    present._see(arm.arm.owner.newest(), {})
    assert recorder.state.lost >= 1
    present._queue = queue
    recorder.stop()
