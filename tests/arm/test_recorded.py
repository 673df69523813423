"""Which states of a recording are the motion that an arm plays."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pytest
from tests.recorded import make_positions

from hexwire.arm import recorded
from hexwire.arm.handle import told
from hexwire.arm.recorded import read_taught
from hexwire.errors import UsageError
from hexwire.trace.recording import RecordingWriter, topic_of


def write(file: Path, rows: Iterable[tuple[tuple[str, ...], str]]) -> str:
    """A recording with a state each 0.1 s: its joints, and the arm."""
    with RecordingWriter(file) as writer:
        for i, (names, arm) in enumerate(rows):
            state = make_positions(names, (0.1 * i,) * len(names))
            writer.joint_state(state, 1.7e9 + 0.1 * i, topic=topic_of(arm))
    return str(file)


def test_the_joints_of_most_states_are_played_at_their_times(tmp_path: Path) -> None:
    full, short = ("J1", "J2"), ("J1",)
    taught = read_taught(write(tmp_path / "a.mcap", [(short, ""), (full, ""), (full, ""), (short, ""), (full, "")]))
    assert taught.names == full
    assert taught.times == pytest.approx((0.0, 0.1, 0.3), abs=1e-6)
    assert taught.rows == tuple(pytest.approx(row) for row in ((0.1, 0.1), (0.2, 0.2), (0.4, 0.4)))


def test_of_several_arms_one_is_named(tmp_path: Path) -> None:
    file = write(tmp_path / "a.mcap", [(("J1",), "lab/a"), (("J2",), "lab/b"), (("J2",), "lab/b")])
    assert read_taught(file, "lab/a").names == ("J1",)
    assert read_taught(file, "lab/b").names == ("J2",)
    with pytest.raises(UsageError, match="no joint states of lab/c"):
        read_taught(file, "lab/c")
    with pytest.raises(UsageError, match=r"several arms \(lab/a, lab/b, .*hexwire play --arm NAME"), told():
        read_taught(file)


def test_a_recording_without_joint_states_is_no_motion(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"has no joint states$"):
        read_taught(write(tmp_path / "a.mcap", []))


@pytest.mark.parametrize(
    ("bound", "there", "words"),
    [
        ("_MOST_STATES", 10, "more than 9 joint states"),
        ("_MOST_ANGLES", 30, "more than 29 angles"),
        ("_MOST_SETS", 5, "joint states of more than 4 different sets of joints"),
    ],
)
def test_a_recording_without_end_is_not_read_to_its_end(
    bound: str, there: int, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = write(tmp_path / "a.mcap", [(("J1", "J2", f"J{3 + i // 2}"), "") for i in range(10)])
    monkeypatch.setattr(recorded, bound, there)
    assert read_taught(file).times
    monkeypatch.setattr(recorded, bound, there - 1)
    with pytest.raises(UsageError, match=f"has {words}"):
        read_taught(file)
