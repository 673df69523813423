"""`make try-wheel` fails where the wheel does not do what it promises."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tests.release.scripts import script

try_wheel: Any = script("try_wheel")


@pytest.fixture
def trial(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setenv("HEXWIRE_PORT", "/dev/ttyUSB0")
    monkeypatch.setenv("PYTHONPATH", "/src")
    return try_wheel.Trial(tmp_path)


def test_a_command_that_fails_or_says_something_else_ends_it(
    trial: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    assert trial.run("sh", "-c", "echo one >&2; exit 2", status=2, says="one") == "one\n"
    assert capsys.readouterr().out == "ok  sh -c echo one >&2; exit 2\n"
    with pytest.raises(AssertionError, match="status 3"):
        trial.run("sh", "-c", "exit 3")
    with pytest.raises(AssertionError, match="does not say 'two'"):
        trial.run("sh", "-c", "echo one", says="two")


def test_a_program_that_stays_is_waited_for_and_ended(trial: Any, tmp_path: Path) -> None:
    with trial.running("sh", "-c", "echo $$ >pid; echo at port 5; exec sleep 600", says=r"port \d") as found:
        assert found == "port 5"
        pid = int((tmp_path / "pid").read_text(encoding="utf-8"))
        assert Path(f"/proc/{pid}").exists()
    assert not Path(f"/proc/{pid}").exists()


def test_a_program_that_ends_before_it_says_so_ends_it(trial: Any) -> None:
    with (
        pytest.raises(AssertionError, match=r"does not say 'ready':\nno robot"),
        trial.running("sh", "-c", "echo no robot", says="ready"),
    ):
        pytest.fail("the block began")


def test_nothing_of_the_users_settings_or_of_the_sources_helps_it(trial: Any, tmp_path: Path) -> None:
    told = trial.run("sh", "-c", 'echo "$HOME:$HEXWIRE_PORT:$PYTHONPATH:"; pwd')
    assert told.split() == [f"{tmp_path}:::", str(tmp_path)]


def test_without_a_wheel_it_says_what_makes_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(try_wheel, "ROOT", tmp_path)
    assert try_wheel.main([]) == 2
    assert "run make dist first" in capsys.readouterr().err
