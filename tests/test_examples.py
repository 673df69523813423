"""Every program in examples/ runs as its first lines say, on an emulated arm.

Those that only move an arm are run in this process, in simulated time.
"""

from __future__ import annotations

import os
import re
import runpy
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.cli.conftest import Bench, bench, make_bench  # noqa: F401  # fixtures
from tests.link.far_ends import free_port

# ruff: noqa: F811  # fixtures that are imported

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = ROOT / "examples"
ELSEWHERE = {"ros1_client": "tests/ros1/test_node_tools.py", "ros2_client": "tests/ros2/test_node_process.py"}
"""Examples that need more than an emulated arm, and where they run."""

pytestmark = pytest.mark.system


def environment(folder: Path) -> dict[str, str]:
    """That of a person who types, not that of a test."""
    kept = {key: value for key, value in os.environ.items() if not key.startswith(("HEXWIRE", "PYTEST"))}
    return kept | {"HOME": str(folder), "XDG_RUNTIME_DIR": str(folder)}


def run(name: str, folder: Path, warning: str = "") -> str:
    """What an example prints; it must end without an error, and without any other warning."""
    command = [sys.executable, str(EXAMPLES / f"{name}.py")]
    env = environment(folder)
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, timeout=100, check=False)
    assert (done.returncode, done.stderr) == (0, warning)
    return done.stdout


@pytest.fixture
def said_here(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[[str], str]:
    """Runs an example on the bench's arm; returns what it prints."""

    def run_here(name: str) -> str:
        program = EXAMPLES / f"{name}.py"
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", [str(program), "/dev/ttyTEST"])
        runpy.run_path(str(program), run_name="__main__")
        said, errors = capsys.readouterr()
        assert (errors, bench.torque()) == ("", [])
        return said

    return run_here


def fetch(url: str) -> str:
    """A page of a server that is starting."""
    for _ in range(300):
        try:
            with urllib.request.urlopen(url, timeout=60) as answer:
                return str(answer.read().decode())
        except urllib.error.URLError:
            time.sleep(0.1)
    raise AssertionError(f"nothing answers at {url}")


def test_read(tmp_path: Path) -> None:
    head, *rows = run("read", tmp_path).splitlines()
    assert head.split() == [f"J{i}" for i in range(1, 8)]
    assert 1 <= len(rows) <= 21
    assert all(re.fullmatch(r"( *-?\d+\.\d){7} degrees", row) for row in rows)


def test_move(said_here: Callable[[str], str]) -> None:
    assert said_here("move") == "J1 is at 5.5 degrees\nJ1 is at -4.5 degrees\n"


def test_wave(said_here: Callable[[str], str]) -> None:
    assert said_here("wave") == "waved\n"


@pytest.mark.slow
def test_pick_and_place(said_here: Callable[[str], str]) -> None:
    first, second = said_here("pick_and_place").splitlines()
    assert re.fullmatch(r"tip at -(79|80|81) (199|200|201) (139|140|141) mm, gripper 20% open", first)
    assert re.fullmatch(r"tip at (79|80|81) (199|200|201) (139|140|141) mm, gripper 80% open", second)


@pytest.mark.slow
def test_record_and_plot(bench: Bench, tmp_path: Path) -> None:
    assert re.fullmatch(r"\d+ states in motion.mcap and motion.svg\n", run("record_and_plot", tmp_path))
    assert (tmp_path / "motion.svg").read_text().count("<svg") == 1
    # Where the machine stalled, two states come close together, and the arm seems to jump.
    bench.ok("play", str(tmp_path / "motion.mcap"), "--dry-run", "--smooth", "0.2")


@pytest.mark.slow
def test_leader_follower(tmp_path: Path) -> None:
    env = environment(tmp_path)
    command = [sys.executable, "-u", str(EXAMPLES / "leader_follower.py")]
    with subprocess.Popen(command, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:
        try:
            assert program.stdout is not None
            assert program.stdout.readline() == "move the leader\n"
            address = "sim://so101?name=leader"
            hand = [sys.executable, "-m", "hexwire", "sim", "hand", "shoulder_pan", "+30", "--port", address]
            subprocess.run(
                [*hand, "--duration", "0.5", "--hold", "0.5"], env=env, check=True, capture_output=True, timeout=100
            )
            program.send_signal(signal.SIGINT)
            said, errors = program.communicate(timeout=60)
        finally:
            program.kill()
    assert errors == ""
    found = re.search(r"the follower holds, (\d\.\d{3}) rad from the leader at most\n", said)
    assert found is not None, said
    # Without torque the joints of the leader sag; the follower was where they were a moment before.
    assert float(found[1]) < 0.25


def test_own_driver(tmp_path: Path) -> None:
    unwatched = (
        "pantilt has no watchdog on this port: if this program dies, the arm moves on to its last target, "
        "for up to 0.075 s\n"
    )
    there, refused = run("own_driver", tmp_path, unwatched).splitlines()
    assert there == "there {'pan': 0.5, 'tilt': -0.2}"
    assert re.fullmatch(r"refused: .*pan=[\d.]+ deg is outside its limits -68\.75 to 68\.75 deg.*", refused)


def test_own_driver_can_be_read_aloud() -> None:
    lines = (EXAMPLES / "own_driver.py").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 60, len(lines)
    assert [line for line in lines if re.match(r"\s*(import|from)\b", line)] == ["import hexwire"]


@pytest.mark.slow
def test_own_page(tmp_path: Path) -> None:
    port = free_port()
    env = environment(tmp_path) | {"PAGE_PORT": str(port)}
    command = [sys.executable, "-u", str(EXAMPLES / "own_page.py")]
    pipes = subprocess.PIPE
    with subprocess.Popen(command, cwd=tmp_path, env=env, stdout=pipes, stderr=pipes, text=True) as program:
        try:
            page = fetch(f"http://127.0.0.1:{port}/")
            program.terminate()
            _, errors = program.communicate(timeout=60)
        finally:
            program.kill()
    assert errors == ""
    assert all(word in page for word in ("my arm", "STOP", "J7"))


def test_each_example_runs_in_a_test_and_is_listed() -> None:
    names = {path.stem for path in EXAMPLES.glob("*.py")}
    here = Path(__file__).read_text(encoding="utf-8")
    assert len(names) >= 10
    assert {name for name in names if f"def test_{name}(" not in here} == set(ELSEWHERE)
    for name, file in ELSEWHERE.items():
        assert f'"examples" / "{name}.py"' in (ROOT / file).read_text(encoding="utf-8")
    listed = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    assert {name for name in names if f"({name}.py)" in listed} == names
    for name in names:
        assert f"python examples/{name}.py" in (EXAMPLES / f"{name}.py").read_text(encoding="utf-8")
