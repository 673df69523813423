from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest
from tests.strangers import STRANGER, BelongsTo

from hexwire.errors import UsageError
from hexwire.folders import make_folder, make_private_folder, open_folder, runtime_folder
from hexwire.system import lock_file


def test_folders_are_made_where_they_are_missing(tmp_path: Path, belongs_to: BelongsTo) -> None:
    make_folder(tmp_path / "a" / "b")
    make_folder(tmp_path / "a" / "b")
    assert stat.S_IMODE((tmp_path / "a" / "b").stat().st_mode) & 0o022 == 0
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(UsageError, match="Not a directory"):
        make_folder(tmp_path / "file" / "x")
    (tmp_path / "a").chmod(0o1777)
    (tmp_path / "a" / "planted").symlink_to(tmp_path)
    belongs_to(tmp_path / "a" / "planted", STRANGER)
    with pytest.raises(UsageError, match="symbolic link that belongs to"):
        make_folder(tmp_path / "a" / "planted" / "x")
    assert not (tmp_path / "x").exists()


@pytest.fixture(params=["by descriptor", "by name"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """How the system keeps a folder open; all but Linux only have its name."""
    if request.param == "by name":
        monkeypatch.setattr("hexwire.folders.HAS_FOLDER_DESCRIPTORS", False)
    return str(request.param)


def test_a_folder_is_opened(tmp_path: Path, way: str) -> None:
    with open_folder(tmp_path) as folder:
        assert os.path.samestat(folder.status(), tmp_path.stat())
        assert (folder.descriptor >= 0) is (way == "by descriptor")
        os.close(folder.make("a", 0o600))
        assert stat.S_IMODE(folder.status_of("a").st_mode) == 0o600
        with pytest.raises(FileExistsError):
            folder.make("a", 0o600)
        folder.rename("a", "b")
        assert [path.name for path in tmp_path.iterdir()] == ["b"]
        folder.remove("b")
        assert not list(tmp_path.iterdir())
        first, second = folder.open_lock(), folder.open_lock()
        assert lock_file(first)
        assert not lock_file(second)
        os.close(first)
        assert lock_file(second, wait=True)
        os.close(second)


def test_a_folder_that_is_missing_or_a_file(tmp_path: Path, way: str) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="there is no such folder"):
        open_folder(tmp_path / "no")
    with pytest.raises(UsageError, match="choose another place"):
        open_folder(tmp_path / "file" / "x")
    make_folder(tmp_path / "a" / "b")
    assert (tmp_path / "a" / "b").is_dir()
    with pytest.raises(UsageError, match="choose another place"):
        make_folder(tmp_path / "file" / "x")


def test_others_may_look_into_a_folder_that_is_made_and_not_change_it(tmp_path: Path, way: str) -> None:
    before = os.umask(0)
    try:
        make_folder(tmp_path / "a")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o755


def test_a_private_folder_is_closed_to_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "a" / "b"
    for _ in range(2):
        make_private_folder(folder, "try another")
        assert folder.stat().st_mode & 0o777 == 0o700
        folder.chmod(0o755)
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="try another"):
        make_private_folder(tmp_path / "file" / "x", "try another")
    monkeypatch.setattr(os, "geteuid", lambda: 12345)
    with pytest.raises(UsageError, match=r"belongs to .*; try another"):
        make_private_folder(folder, "try another")


def test_a_private_folder_is_in_one_that_nobody_else_can_change(tmp_path: Path, belongs_to: BelongsTo) -> None:
    above = tmp_path / "hexwire"
    above.mkdir()
    above.chmod(0o777)
    make_private_folder(above / "arms", "try another")
    assert above.stat().st_mode & 0o777 == 0o755
    belongs_to(above, STRANGER)
    with pytest.raises(UsageError, match=r"hexwire belongs to .*; try another"):
        make_private_folder(above / "arms", "try another")


@pytest.mark.parametrize(
    ("runtime", "state", "place"),
    [
        ("/run/user/7", "/s", "/run/user/7/hexwire"),
        ("relative", "/s", "/s/hexwire"),
        ("", "relative", "/h/.local/state/hexwire"),
    ],
)
def test_programs_of_a_user_share_a_folder(
    runtime: str, state: str, place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in (("XDG_RUNTIME_DIR", runtime), ("XDG_STATE_HOME", state), ("HOME", "/h")):
        monkeypatch.setenv(name, value)
    assert str(runtime_folder()) == place
