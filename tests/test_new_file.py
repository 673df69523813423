from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest
from tests.strangers import STRANGER, BelongsTo

from hexwire.errors import UsageError
from hexwire.new_file import OutputFile
from hexwire.testing.link import descriptors


def write(path: Path | str, data: bytes = b"new", *, force: bool = False) -> None:
    with OutputFile(path, force=force) as out:
        out.file.write(data)


def test_a_file_is_its_makers_alone(tmp_path: Path) -> None:
    path = tmp_path / "a"
    before = os.umask(0)
    try:
        write(path)
    finally:
        os.umask(before)
    assert path.read_bytes() == b"new"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_a_file_that_is_there_stays(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"old")
    with pytest.raises(UsageError, match="already exists; --force overwrites it"):
        OutputFile(path)
    assert path.read_bytes() == b"old"


def test_with_force_the_old_file_stays_until_the_new_one_is_whole(tmp_path: Path) -> None:
    path, other_name = tmp_path / "a", tmp_path / "b"
    path.write_bytes(b"old")
    path.chmod(0o644)
    os.link(path, other_name)
    with OutputFile(path, force=True) as out:
        out.file.write(b"new")
        out.file.flush()
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert other_name.read_bytes() == b"old"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "b"]


@pytest.mark.parametrize("force", [False, True])
def test_an_error_takes_the_new_file_away(tmp_path: Path, force: bool) -> None:
    path = tmp_path / "a"
    if force:
        path.write_bytes(b"old")
    with pytest.raises(ValueError, match="boom"), OutputFile(path, force=force):
        raise ValueError("boom")
    assert [p.read_bytes() for p in tmp_path.iterdir()] == ([b"old"] if force else [])


@pytest.mark.parametrize("force", [False, True])
def test_a_file_kept_before_the_error_stays(tmp_path: Path, force: bool) -> None:
    path = tmp_path / "a"
    if force:
        path.write_bytes(b"old")
    out = OutputFile(path, force=force)
    out.file.write(b"new")
    out.keep()
    with pytest.raises(ValueError, match="boom"), out:
        raise ValueError("boom")
    assert [p.read_bytes() for p in tmp_path.iterdir()] == [b"new"]


@pytest.mark.parametrize("force", [False, True])
def test_no_link_is_followed(tmp_path: Path, force: bool) -> None:
    victim, link, dangling = tmp_path / "victim", tmp_path / "link", tmp_path / "dangling"
    victim.write_bytes(b"precious")
    link.symlink_to(victim)
    dangling.symlink_to(tmp_path / "made")
    for path in (link, dangling):
        with pytest.raises(UsageError, match="is a symbolic link, which is not followed"):
            write(path, force=force)
        assert path.is_symlink()
    assert victim.read_bytes() == b"precious"
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize("force", [False, True])
def test_names_that_are_not_overwritten(tmp_path: Path, force: bool) -> None:
    os.mkfifo(tmp_path / "pipe")
    before = descriptors()
    for path, words in (
        (tmp_path, "is a folder"),
        (f"{tmp_path}/new/", "is a folder"),
        ("", "is a folder"),
        ("..", "is a folder"),
        ("/dev/null", "is not a regular file"),
        (tmp_path / "pipe", "is not a regular file"),
        (tmp_path / "no" / "a", "there is no such folder"),
        (tmp_path / "pipe" / "a", "Not a directory"),
        (tmp_path / ("x" * 300), "File name too long"),
    ):
        with pytest.raises(UsageError, match=words) as caught:
            write(path, force=force)
        assert "\n" not in str(caught.value)
    assert descriptors() <= before
    assert [p.name for p in tmp_path.iterdir()] == ["pipe"]


@pytest.mark.parametrize("force", [False, True])
def test_a_file_of_another_user_in_a_shared_folder_is_not_overwritten(
    tmp_path: Path, belongs_to: BelongsTo, force: bool
) -> None:
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o1777)
    planted = shared / "run.csv"
    planted.write_bytes(b"planted")
    belongs_to(planted, STRANGER)
    with pytest.raises(UsageError, match=rf"belongs to user {STRANGER}, and everybody may write"):
        write(planted, force=force)
    assert planted.read_bytes() == b"planted"


def test_a_file_of_another_user_in_ones_own_folder_is_overwritten(tmp_path: Path, belongs_to: BelongsTo) -> None:
    path = tmp_path / "run.csv"
    path.write_bytes(b"old")
    belongs_to(path, STRANGER)
    with pytest.raises(UsageError, match="already exists"):
        write(path)
    write(path, force=True)
    assert path.read_bytes() == b"new"


def test_a_folder_of_a_stranger_where_all_may_write(tmp_path: Path, belongs_to: BelongsTo) -> None:
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o1777)
    write(shared / "mine")
    belongs_to(shared, STRANGER)
    with pytest.raises(UsageError, match=rf"belongs to user {STRANGER}, and everybody may write to it"):
        write(shared / "a")
    assert [p.name for p in shared.iterdir()] == ["mine"]


def test_a_folder_of_a_stranger_where_only_he_may_write(tmp_path: Path, belongs_to: BelongsTo) -> None:
    """As root in somebody's home."""
    belongs_to(tmp_path, STRANGER)
    write(tmp_path / "a")
    assert (tmp_path / "a").read_bytes() == b"new"


def test_a_link_on_the_way_is_followed_unless_it_was_planted(tmp_path: Path, belongs_to: BelongsTo) -> None:
    home, shared = tmp_path / "home", tmp_path / "shared"
    home.mkdir()
    shared.mkdir()
    shared.chmod(0o1777)
    for link, target in ((shared / "way", home), (home / "again", Path("../shared/way"))):
        link.symlink_to(target)
    write(shared / "way" / "a")
    write(home / "again" / "b")
    belongs_to(shared / "way", STRANGER)
    for path in (shared / "way" / "c", home / "again" / "c"):
        with pytest.raises(UsageError, match=f"leads through a symbolic link that belongs to user {STRANGER}"):
            write(path)
    assert sorted(p.name for p in home.iterdir()) == ["a", "again", "b"]


def test_links_in_a_circle(tmp_path: Path) -> None:
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    before = descriptors()
    with pytest.raises(UsageError, match="Too many levels of symbolic links"):
        write(tmp_path / "a" / "x")
    assert descriptors() <= before


def test_a_folder_that_is_exchanged_meanwhile_changes_nothing(tmp_path: Path) -> None:
    folder, victim = tmp_path / "folder", tmp_path / "victim"
    folder.mkdir()
    victim.mkdir()
    (folder / "a").write_bytes(b"old")
    with OutputFile(folder / "a", force=True) as out:
        out.file.write(b"new")
        folder.rename(tmp_path / "moved")
        folder.symlink_to(victim)
    assert list(victim.iterdir()) == []
    assert (tmp_path / "moved" / "a").read_bytes() == b"new"


def test_a_new_file_that_is_exchanged_meanwhile_is_not_put_in_place(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"old")
    out = OutputFile(path, force=True)
    (part,) = (p for p in tmp_path.iterdir() if p != path)
    part.unlink()
    part.write_bytes(b"a stranger's")
    with pytest.raises(UsageError, match="another program has replaced"):
        out.keep()
    assert path.read_bytes() == b"old"
    assert part.read_bytes() == b"a stranger's"


@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize("partial", [False, True])
def test_a_full_disk_keeps_what_is_worth_keeping(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, force: bool, partial: bool
) -> None:
    path = tmp_path / "a"
    if force:
        path.write_bytes(b"old")

    def no_space(fd: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", no_space)
    out = OutputFile(path, force=force, partial=partial)
    out.file.write(b"begun")
    with pytest.raises(OSError, match="No space left"):
        out.keep()
    out.keep()
    assert [p.read_bytes() for p in tmp_path.iterdir()] == ([b"begun"] if partial else [b"old"] if force else [])


def test_relative_paths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sub").mkdir()
    write("a")
    write("sub/../b")
    write("./sub/c")
    assert sorted(str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*")) == ["a", "b", "sub", "sub/c"]
