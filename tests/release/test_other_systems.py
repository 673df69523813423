"""`make test-on` as far as it can be tried without a download: what it refuses, and what it would run where."""

from __future__ import annotations

import fcntl
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "release" / "test-on"
LISTS = sorted((ROOT / "release" / "systems").glob("*.txt"))
Run = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A folder with nothing but the script: its roots would be in it, too."""
    script = tmp_path / "repository" / "release" / "test-on"
    script.parent.mkdir(parents=True)
    shutil.copy2(SCRIPT, script)
    return script


@pytest.fixture
def run(copy: Path, tmp_path: Path) -> Run:
    """Run it with no program of the machine but the shell's own, and the stand-ins that are named."""
    programs = tmp_path / "bin"
    programs.mkdir()
    for name in ("bash", "cat", "dirname", "flock", "mkdir", "rm"):
        (programs / name).symlink_to(shutil.which(name) or name)

    def run(*words: str, **stand_ins: str) -> subprocess.CompletedProcess[str]:
        for name, body in stand_ins.items():
            path = programs / name.replace("_", "-")
            path.write_text(f"#!{programs}/bash\n{body}\n", encoding="utf-8")
            path.chmod(0o755)
        return subprocess.run(
            [str(programs / "bash"), str(copy), *words],
            env={"PATH": str(programs)},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
            timeout=60,
        )

    return run


@pytest.mark.parametrize("words", [(), ("",), ("debian12",), ("Debian13", "make", "demo"), ("--help",)])
def test_another_system_is_refused_before_anything_is_made(run: Run, copy: Path, words: tuple[str, ...]) -> None:
    done = run(*words)
    assert done.returncode == 2
    assert "SYSTEM is debian13 or arm64, not " + repr(words[0] if words else "") in done.stderr
    assert not (copy.parents[1] / "build").exists()


@pytest.mark.parametrize("system", ["debian13", "arm64"])
def test_it_starts_from_a_debian(run: Run, copy: Path, system: str) -> None:
    done = run(system)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == "test-on: this starts from a Debian, or a Linux with dpkg\n"
    assert not (copy.parents[1] / "build").exists()


def test_tools_are_downloaded_and_unpacked_but_never_installed(run: Run, copy: Path, tmp_path: Path) -> None:
    log = tmp_path / "log"
    done = run(
        "arm64",
        unshare="exit 9",
        git="exit 9",
        dpkg_deb=f'echo "dpkg-deb $*" >>{log}',
        apt_get=f'echo "apt-get $*" >>{log}; [ "${{!#}}" = mmdebstrap ]',
    )
    assert done.returncode == 1
    assert done.stderr == (
        "test-on: cannot download qemu-user-static; are the lists of packages there? sudo apt-get update\n"
    )
    first, unpacked, second = log.read_text(encoding="utf-8").splitlines()
    # The host's dpkg cannot be called by mistake either.
    for asked, name in ((first, "mmdebstrap"), (second, "qemu-user-static")):
        assert re.fullmatch(rf"apt-get .*-o Dir::Bin::dpkg=/bin/false .*download {name}", asked)
    assert unpacked.startswith("dpkg-deb --extract ")
    # What is not whole is not taken for ready the next time.
    assert not (copy.parents[1] / "build" / "systems" / "arm64" / "tools" / "ready").exists()


def test_two_at_a_time_in_one_root_are_refused(run: Run, copy: Path) -> None:
    place = copy.parents[1] / "build" / "systems" / "debian13"
    place.mkdir(parents=True)
    with (place / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        done = run("debian13", unshare="exit 9", dpkg_deb="exit 9", apt_get="exit 9")
    assert done.returncode == 1
    assert done.stderr == f"test-on: another one is at work in {place / 'root'}\n"


def test_make_hands_on_system_and_command() -> None:
    words = ["make", "-n", "test-on", "SYSTEM=debian13", "COMMAND=make test SELECT=tests/wire"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip() == "release/test-on 'debian13' make test SELECT=tests/wire"


def test_make_without_a_system_is_refused() -> None:
    done = subprocess.run(["make", "test-on"], cwd=ROOT, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 2
    assert "SYSTEM is debian13 or arm64, not ''" in done.stderr


def test_nothing_of_what_the_continuous_integration_runs_needs_another_system() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert not re.search(r"^(?!test-on:|\.PHONY).*test-on", makefile.replace("@release/test-on", ""), re.MULTILINE)


def test_there_is_a_list_for_each_system() -> None:
    assert [file.stem for file in LISTS] == ["arm64", "debian13"]


@pytest.mark.parametrize("file", LISTS, ids=lambda file: file.stem)
def test_each_test_that_is_left_out_is_there_and_has_a_reason(file: Path) -> None:
    for line in file.read_text(encoding="utf-8").splitlines():
        if not line or line.startswith("#"):
            continue
        name, _, reason = line.partition(" ")
        path, _, function = name.partition("::")
        assert (ROOT / path).exists(), line
        assert path.startswith(("tests/", "docs/", "README.md")), line
        assert len(reason.split()) >= 3, line
        if function:
            assert f"def {function.partition('[')[0]}" in (ROOT / path).read_text(encoding="utf-8"), line
