from __future__ import annotations

import io
import math
import os
import sys
from pathlib import Path

import pytest
from tests.recorded import make_positions

from hexwire.errors import ConfigError, UsageError
from hexwire.trace.library import Library, recordings_folder
from hexwire.trace.recording import RecordingWriter


def _record(path: Path, states: int = 100, robot: str = "") -> bytes:
    path.parent.mkdir(parents=True, exist_ok=True)
    with RecordingWriter(path) as out:
        for i in range(states):
            state = make_positions(("J1", "J2"), (math.sin(i / 10), 0.1))
            out.joint_state(state, 1000.0 + i / 100, extra={"robot": robot} if robot else None)
    return path.read_bytes()


@pytest.fixture
def library(tmp_path: Path) -> Library:
    return Library(tmp_path / "recordings")


def test_the_default_folder_is_this_users(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert recordings_folder() == tmp_path / "hexwire" / "recordings"
    monkeypatch.setenv("XDG_DATA_HOME", "relative")
    assert recordings_folder() == Path.home() / ".local" / "share" / "hexwire" / "recordings"


def test_a_folder_that_is_missing_is_empty(library: Library) -> None:
    assert library.entries() == []
    assert not library.folder.exists()


def test_it_lists_what_a_recording_holds_newest_first(library: Library) -> None:
    _record(library.folder / "old.mcap", 50)
    _record(library.folder / "new.mcap", 100, "so101")
    os.utime(library.folder / "old.mcap", (1, 1))
    (library.folder / "notes.txt").write_text("x")
    new, old = library.entries()
    assert (new.name, old.name) == ("new.mcap", "old.mcap")
    assert (new.states, new.joints, new.robot, new.topics) == (100, ("J1", "J2"), "so101", ("/joint_states",))
    assert new.begin == 1000.0
    assert new.duration == pytest.approx(0.99)
    assert new.size == (library.folder / "new.mcap").stat().st_size
    assert (new.problem, old.robot) == ("", "")


def test_a_file_is_read_again_only_when_it_has_changed(library: Library, monkeypatch: pytest.MonkeyPatch) -> None:
    import hexwire.trace.library

    _record(library.folder / "a.mcap", 10)
    library.entries()
    read: list[str] = []
    survey = hexwire.trace.library.survey
    monkeypatch.setattr(
        hexwire.trace.library, "survey", lambda file, empty: read.append(empty.name) or survey(file, empty)
    )
    assert library.entries()[0].states == 10
    assert read == []
    (library.folder / "a.mcap").unlink()
    _record(library.folder / "a.mcap", 20)
    assert library.entries()[0].states == 20
    assert read == ["a.mcap"]


def test_a_damaged_recording_is_listed_with_its_intact_part_and_can_be_recovered(library: Library) -> None:
    content = _record(library.folder / "a.mcap", 5000)
    (library.folder / "a.mcap").write_bytes(content[: len(content) // 2])
    (one,) = library.entries()
    assert "truncated" in one.problem
    assert one.recoverable
    assert 100 < one.states < 4900
    saved = library.recover("a.mcap")
    assert saved.name == "a recovered.mcap"
    assert (saved.states, saved.problem) == (one.states, "")
    # The damaged one stays.
    assert len(library.entries()) == 2


@pytest.mark.parametrize(
    "content", [b"", b"not a recording", b"\x89MCAP0\r\n" + bytes(2000), b"\x89MCAP0\r\n" + b"\x05" * 99]
)
def test_what_is_no_recording_says_so(library: Library, content: bytes) -> None:
    library.make_folder()
    (library.folder / "a.mcap").write_bytes(content)
    (one,) = library.entries()
    assert one.problem
    assert not one.recoverable


def test_neither_links_nor_pipes_are_read(library: Library, tmp_path: Path) -> None:
    library.make_folder()
    _record(tmp_path / "secret.mcap", 5)
    (library.folder / "link.mcap").symlink_to(tmp_path / "secret.mcap")
    os.mkfifo(library.folder / "pipe.mcap")
    assert library.entries() == []
    with pytest.raises(UsageError, match="symbolic links"), library.open("link.mcap"):
        pass
    with pytest.raises(UsageError, match="a pipe or a device, not a file"), library.open("pipe.mcap"):
        pass


@pytest.mark.parametrize(
    "name", ["../a.mcap", "/etc/passwd", "a.mcap/../b.mcap", ".a.mcap", "a.txt", "a\n.mcap", "", "é.mcap"]
)
def test_a_name_cannot_lead_out_of_the_folder(library: Library, name: str) -> None:
    with pytest.raises(UsageError, match="cannot be the name of a recording"):
        library.path(name)
    with pytest.raises(UsageError):
        library.remove(name)


def test_a_file_is_added_under_a_safe_name(library: Library, tmp_path: Path) -> None:
    content = _record(tmp_path / "x.mcap")
    one = library.add("../../My arm <1>.mcap", io.BytesIO(content))
    assert one.name == "My arm -1.mcap"
    assert one.states == 100
    assert oct((library.folder / one.name).stat().st_mode & 0o777) == "0o600"
    # A second one of that name replaces nothing.
    again = library.add("My arm -1.mcap", io.BytesIO(content))
    assert again.name != one.name
    assert {entry.name for entry in library.entries()} == {one.name, again.name}


def test_a_truncated_recording_may_be_added(library: Library, tmp_path: Path) -> None:
    content = _record(tmp_path / "x.mcap", 5000)
    assert library.add("x.mcap", io.BytesIO(content[: len(content) // 2])).recoverable


def test_what_is_too_large_or_no_recording_is_not_kept(tmp_path: Path) -> None:
    library = Library(tmp_path / "recordings", largest=2 << 20)
    with pytest.raises(UsageError, match="is larger than 2 MiB; nothing was kept"):
        library.add("a.mcap", io.BytesIO(bytes((2 << 20) + 1)))
    with pytest.raises(UsageError, match=r"is not a recording .*nothing was kept"):
        library.add("a.mcap", io.BytesIO(b"PK\x03\x04"))
    assert list(library.folder.iterdir()) == []


def test_a_decompression_bomb_is_not_kept(library: Library, tmp_path: Path) -> None:
    content = bytearray(_record(tmp_path / "x.mcap"))
    # The first chunk claims 8 GiB: its record begins with opcode 6, length, two times, then the size.
    at = content.index(6, 8)
    content[at + 25 : at + 33] = (8 << 30).to_bytes(8, "little")
    with pytest.raises(UsageError, match="nothing was kept"):
        library.add("bomb.mcap", io.BytesIO(bytes(content)))
    assert library.entries() == []


def test_columns_of_a_recording(library: Library) -> None:
    _record(library.folder / "a.mcap", 30)
    series = library.series("a.mcap")
    assert len(series.times) == 30
    with pytest.raises(UsageError, match=r"there is no recording 'b\.mcap'"):
        library.series("b.mcap")


def test_new_names_are_free(library: Library) -> None:
    name = library.new_name("so101 / a b", 0.0)
    assert name.endswith(" so101-a-b.mcap")
    _record(library.path(name), 1)
    assert library.new_name("so101 / a b", 0.0) == name.replace(".mcap", " (2).mcap")


def test_a_recording_can_be_removed(library: Library) -> None:
    _record(library.folder / "a.mcap", 1)
    library.remove("a.mcap")
    assert library.entries() == []
    with pytest.raises(UsageError, match="there is no recording"):
        library.remove("a.mcap")


def test_without_the_package_for_recordings_its_name_is_told(
    library: Library, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = _record(tmp_path / "x.mcap")
    _record(library.folder / "a.mcap")
    monkeypatch.setitem(sys.modules, "mcap.records", None)
    assert "pip install 'hexwire[record]'" in library.entries()[0].problem
    with pytest.raises(UsageError, match=r"pip install 'hexwire\[record\]'; nothing was kept"):
        library.add("b.mcap", io.BytesIO(content))


def test_a_file_that_grows_is_not_read_again_at_every_look(
    library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    import hexwire.trace.library

    read: list[str] = []
    survey = hexwire.trace.library.survey
    monkeypatch.setattr(
        hexwire.trace.library, "survey", lambda file, empty: read.append(empty.name) or survey(file, empty)
    )
    now = [100.0]
    monkeypatch.setattr(hexwire.trace.library.time, "monotonic", lambda: now[0])
    # Reading takes half a second.
    ticks = iter(0.5 * i for i in range(100))
    monkeypatch.setattr(hexwire.trace.library, "_timed", lambda file, name: file)
    monkeypatch.setattr(hexwire.trace.library.time, "thread_time", lambda: next(ticks))
    content = _record(library.folder / "a.mcap", 5000)
    path = library.folder / "a.mcap"
    for size in (20000, 30000, 40000):
        path.write_bytes(content[:size])
        (one,) = library.entries()
        assert library.find("a.mcap") == one
    assert read == ["a.mcap"]
    now[0] += 10.1
    (later,) = library.entries()
    assert later.size == 40000
    # What is shorter is another file.
    path.write_bytes(content[:25000])
    assert library.entries()[0].size == 25000
    assert library.entries(without="a.mcap") == []


def test_the_computing_for_a_file_is_limited_and_not_the_time(
    library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    import hexwire.trace.library

    _record(library.folder / "a.mcap", 10)
    days, computed = iter(range(0, 10**9, 86400)), [0.0]
    monkeypatch.setattr(hexwire.trace.library.time, "monotonic", lambda: float(next(days)))
    monkeypatch.setattr(hexwire.trace.library.time, "thread_time", lambda: computed[0])
    assert len(library.series("a.mcap").times) == 10

    def hour() -> float:
        computed[0] += 3600.0
        return computed[0]

    monkeypatch.setattr(hexwire.trace.library.time, "thread_time", hour)
    with pytest.raises(ConfigError, match="takes more than 30 s"):
        library.series("a.mcap")


def test_it_says_which_files_are_not_listed(library: Library, tmp_path: Path) -> None:
    _record(library.folder / "a.mcap", 1)
    library.entries()
    assert library.remark == ""
    _record(library.folder / "Übung 1.mcap", 1)
    (library.folder / "link.mcap").symlink_to(library.folder / "a.mcap")
    assert [one.name for one in library.entries()] == ["a.mcap"]
    assert library.remark.startswith("2 files are not listed: give recordings names of letters")


def test_a_folder_that_cannot_be_read_says_why(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(UsageError, match=r"file cannot be read: Not a directory"):
        Library(tmp_path / "file").entries()
