"""`make resolvable` asks for every extra, and an extra without wheels fails it."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest
from tests.release.scripts import ROOT, script

resolve: Any = script("resolve")


def fake_uv(folder: Path, body: str) -> str:
    path = folder / "uv"
    path.write_text(f"#!/bin/sh\n{body}\n")
    path.chmod(0o755)
    return str(path)


def test_every_extra_python_and_machine_is_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    uv = fake_uv(tmp_path, f'echo "$*" >> {tmp_path}/asked')
    assert resolve.main(["--uv", uv]) == 0
    asked = (tmp_path / "asked").read_text().splitlines()
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert len(asked) == 3 * 2 * (1 + len(extras))
    assert all("--only-binary :all:" in line for line in asked)
    for words in ("--extra studio", "--python-version 3.13", "--python-platform aarch64-manylinux"):
        assert any(words in line for line in asked), words
    assert f"{len(asked)} combinations" in capsys.readouterr().out


def test_what_has_no_wheel_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    case = 'case "$*" in *3.12*aarch64*"--extra mq"*) echo no wheels >&2; exit 1;; esac'
    assert resolve.main(["--uv", fake_uv(tmp_path, case)]) == 1
    assert capsys.readouterr().err == "Python 3.12, aarch64-manylinux_2_28, mq: no wheels\n"
