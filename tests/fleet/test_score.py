"""Motions in files, and the arms that play them."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from tests.recorded import make_positions

from hexwire.errors import UsageError
from hexwire.fleet import player
from hexwire.fleet.player import assign, read_motions
from hexwire.inputs import LARGEST_TEXT
from hexwire.trace.recording import RecordingWriter, topic_of

BEGIN = 1.7e9


def record(path: Path, arms: dict[str, tuple[float, float]], rate: float = 100.0, seconds: float = 2.0) -> Path:
    """Arms that turn J1 at 0.5 rad/s: name -> when it appears, and the age of its samples."""
    with RecordingWriter(path) as writer:
        for i in range(round(rate * seconds)):
            for name, (late, age) in arms.items():
                t = i / rate
                if t >= late:
                    state = replace(make_positions(("J1", "J2"), (0.5 * (t - age), 0.0)), age=(age, 0.0))
                    writer.joint_state(state, BEGIN + t, topic=topic_of(name) if name else "/joint_states")
    return path


def test_motions_recorded_together_keep_their_times(tmp_path: Path) -> None:
    motions = read_motions(str(record(tmp_path / "a.mcap", {"lab/a": (0.0, 0.0), "lab/b": (1.0, 0.0)})))
    assert sorted(motions) == ["lab/a", "lab/b"]
    assert motions["lab/a"].sample(1.5).position[0] == pytest.approx(0.75, abs=0.01)
    # The one that was there later waits.
    assert motions["lab/b"].sample(0.5).position[0] == pytest.approx(0.5, abs=0.01)
    assert motions["lab/b"].sample(1.5).position[0] == pytest.approx(0.75, abs=0.01)


def test_each_joint_counts_from_its_own_sample(tmp_path: Path) -> None:
    motion = read_motions(str(record(tmp_path / "a.mcap", {"": (0.0, 0.04)})))[""]
    # It was at 0.5 rad at 1 s, though that was reported 40 ms later; the motion begins with the first sample.
    assert motion.sample(1.0 + 0.04).position[0] == pytest.approx(0.5, abs=0.01)


def test_speed_and_noise(tmp_path: Path) -> None:
    motion = read_motions(str(record(tmp_path / "a.mcap", {"": (0.0, 0.0)})), 2.0)[""]
    assert motion.duration == pytest.approx(1.0, abs=0.02)
    assert motion.sample(0.5).velocity[0] == pytest.approx(1.0, abs=0.05)
    assert len(motion.waypoints) < 30


def test_a_recording_that_is_too_long_is_refused(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        for t in (0.0, 1000.0):
            writer.joint_state(make_positions(("J1",), (t / 1e4,)), BEGIN + t)
    with pytest.raises(UsageError, match=r"1000 s, and 900 s of one can be played"):
        read_motions(str(tmp_path / "a.mcap"))


def test_a_recording_with_too_many_angles_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = str(record(tmp_path / "a.mcap", {"": (0.0, 0.0)}, seconds=1.0))
    monkeypatch.setattr(player, "_MOST_ANGLES", 200)
    assert read_motions(file)
    monkeypatch.setattr(player, "_MOST_ANGLES", 199)
    with pytest.raises(UsageError, match="more than 199 angles: too many for one motion"):
        read_motions(file)


def test_a_joint_rests_before_its_first_sample_and_after_its_last() -> None:
    column = [(11.0, 0.5), (12.0, 1.5)]
    assert player._at(column, 10.0, [0.0, 1.0, 1.5, 2.0, 3.0]) == pytest.approx([0.5, 0.5, 1.0, 1.5, 1.5])


def test_waypoints_are_for_any_arm(tmp_path: Path) -> None:
    file = tmp_path / "a.json"
    points = [
        {"time_from_start": 0, "positions": [0.0], "velocities": [0.0], "accelerations": [0.0]},
        {"time_from_start": 2, "positions": [1.0], "velocities": [0.5], "accelerations": [0.1]},
    ]
    file.write_text(json.dumps({"joint_names": ["J1"], "points": points}))
    (last,) = read_motions(str(file), 2.0)[""].waypoints[1:]
    assert (last.time, last.velocity, last.acceleration) == (1.0, (1.0,), (0.4,))
    with file.open("a") as more:
        more.write(" " * LARGEST_TEXT)
    assert read_motions(str(file)), "a program writes long ones"


def test_arms_get_the_motion_of_their_name_or_of_another_one(tmp_path: Path) -> None:
    motions = read_motions(str(record(tmp_path / "a.mcap", {"lab/a": (0.0, 0.0), "lab/b": (0.0, 0.0)})))
    given = assign(motions, "a.mcap", ["lab/a", "hall/c"], {"hall/c": "lab/b"})
    assert given == {"lab/a": motions["lab/a"], "hall/c": motions["lab/b"]}
    with pytest.raises(UsageError, match=r"no motion for lab/d, but for lab/a, lab/b; .* --map lab/a=lab/d"):
        assign(motions, "a.mcap", ["lab/a", "lab/d"])
    with pytest.raises(UsageError, match=r"no motion for lab/a \(as lab/x\)"):
        assign(motions, "a.mcap", ["lab/a"], {"lab/a": "lab/x"})


def test_a_recording_without_a_name_is_for_any_arm(tmp_path: Path) -> None:
    motions = read_motions(str(record(tmp_path / "a.mcap", {"": (0.0, 0.0)})))
    assert set(assign(motions, "a.mcap", ["lab/a", "lab/b"])) == {"lab/a", "lab/b"}


def test_a_file_without_joint_states_is_refused(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        writer.raw("/bytes", BEGIN, b"x")
    with pytest.raises(UsageError, match="no joint states"):
        read_motions(str(tmp_path / "a.mcap"))
    with RecordingWriter(tmp_path / "b.mcap") as writer:
        writer.joint_state(make_positions(("J1",), (math.nan,)), BEGIN)
    with pytest.raises(UsageError, match="no joint states"):
        read_motions(str(tmp_path / "b.mcap"))
