from __future__ import annotations

import math
import os
import threading
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.control.requests.pose_file import MOST_POSES, PoseFile, check_pose_name, pose_folder
from hexwire.errors import ConfigError, LimitError, UsageError
from hexwire.model.arms.hex7bot.joints import HEX7BOT

UP = {"J1": 0.25, "J2": 1.0 / 3.0}


@pytest.fixture
def file(tmp_path: Path) -> PoseFile:
    return PoseFile(HEX7BOT, tmp_path / "poses")


def test_a_saved_pose_is_there_for_the_next_program(file: PoseFile, tmp_path: Path) -> None:
    assert file.load() == {}
    assert file.save("  over the table ", UP) == "over the table"
    file.save("b", {"J7": 0.0})
    again = PoseFile(HEX7BOT, tmp_path / "poses").load()
    assert list(again) == ["over the table", "b"]
    assert again["over the table"] == pytest.approx(UP, abs=1e-7)


def test_the_file_is_for_people(file: PoseFile) -> None:
    file.save("home", {"J1": math.radians(-12.5)})
    assert file.path.read_text() == "# Poses saved with hexwire; angles in degrees.\n\n[poses.home]\nJ1 = -12.5\n"
    assert file.path.stat().st_mode & 0o077 == 0


def test_a_pose_is_replaced_only_when_that_is_asked_for(file: PoseFile) -> None:
    file.save("a", {"J1": 0.1})
    with pytest.raises(UsageError, match="already"):
        file.save("a", {"J1": 0.2})
    assert file.load()["a"] == pytest.approx({"J1": 0.1})
    file.save("a", {"J1": 0.2}, force=True)
    assert file.load()["a"] == pytest.approx({"J1": 0.2})


def test_remove_and_rename(file: PoseFile) -> None:
    for name in ("a", "b", "c"):
        file.save(name, UP)
    assert file.rename("b", " B ") == "B"
    assert list(file.load()) == ["a", "B", "c"]
    assert file.rename("B", "B") == "B"
    file.remove("a")
    assert list(file.load()) == ["B", "c"]
    for call in (lambda: file.remove("a"), lambda: file.rename("a", "d")):
        with pytest.raises(UsageError, match="no pose 'a'"):
            call()
    with pytest.raises(UsageError, match="already"):
        file.rename("B", "c")
    assert list(file.load()) == ["B", "c"]


@pytest.mark.parametrize("name", ["", "  ", "x" * 41, "a\nb", 'say "x"', "back\\slash", "\x7f", "a" + 9 * "."])
def test_a_name_that_is_none_is_refused(file: PoseFile, name: str) -> None:
    with pytest.raises(UsageError, match="name"):
        file.save(name, UP)
    assert not file.path.exists()


@given(st.text(max_size=50))
def test_every_name_that_is_accepted_comes_back(tmp_path_factory: pytest.TempPathFactory, name: str) -> None:
    try:
        wanted = check_pose_name(name)
    except UsageError:
        return
    file = PoseFile(HEX7BOT, tmp_path_factory.mktemp("poses"))
    file.save(name, UP)
    file.save("and another", UP, force=True)
    assert set(file.load()) == {wanted, "and another"}


def test_only_a_pose_to_which_the_arm_may_return_is_saved(file: PoseFile) -> None:
    with pytest.raises(LimitError, match="outside its limits"):
        file.save("far", {"J1": 1.4})
    with pytest.raises(UsageError, match="the position of J1 is unknown"):
        file.save("nowhere", {"J1": math.nan})
    with pytest.raises(UsageError, match="no joint 'J9'"):
        file.save("other", {"J9": 0.0})
    with pytest.raises(UsageError, match="at least one joint"):
        file.save("none", {})
    assert file.load() == {}


def test_the_number_of_poses_is_bounded(file: PoseFile) -> None:
    rows = "".join(f'[poses."p{i}"]\nJ1 = 0\n' for i in range(MOST_POSES))
    file.path.parent.mkdir()
    file.path.write_text(rows)
    with pytest.raises(UsageError, match="remove one first"):
        file.save("one more", UP)
    file.save("p3", UP, force=True)
    file.path.write_text(rows + '[poses."x"]\nJ1 = 0\n')
    with pytest.raises(ConfigError, match="more than 200 poses"):
        file.load()


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("poses = 1", "table"),
        ("pose = {}", "pose"),
        ("[poses.a]\nJ9 = 1", "no joint 'J9'"),
        ("[poses.a]\nJ1 = 'x'", "number"),
        ("[poses.a]\nJ1 = inf", "finite"),
        ("[poses.a]\n", "names no joint"),
        ('[poses."a\\nb"]\nJ1 = 1', "a name cannot have"),
        ("[poses.a", "poses"),
    ],
)
def test_a_damaged_file_is_named_and_not_overwritten(file: PoseFile, text: str, error: str) -> None:
    file.path.parent.mkdir()
    file.path.write_text(text)
    for call in (file.load, lambda: file.save("a", UP, force=True)):
        with pytest.raises(ConfigError, match=error) as caught:
            call()
        assert str(file.path) in str(caught.value)
    assert file.path.read_text() == text


def test_an_arm_of_any_name_has_a_file_in_the_folder(tmp_path: Path) -> None:
    file = PoseFile(replace(HEX7BOT, name="../../mine, left"), tmp_path)
    assert file.path == tmp_path / "______mine__left.toml"
    assert PoseFile(replace(HEX7BOT, name=""), tmp_path).path.name == "arm.toml"


def test_programs_that_save_at_once_lose_nothing(file: PoseFile) -> None:
    threads = [threading.Thread(target=file.save, args=(f"pose {i}", UP)) for i in range(12)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(file.load()) == 12


def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match="file"):
        PoseFile(HEX7BOT, tmp_path / "file" / "poses").save("a", UP)


def test_the_folder_is_that_of_this_users_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", "/somewhere")
    assert pose_folder() == Path("/somewhere/hexwire/poses")
    monkeypatch.setenv("XDG_CONFIG_HOME", "relative")
    assert pose_folder() == Path(os.path.expanduser("~")) / ".config" / "hexwire" / "poses"  # noqa: PTH111
