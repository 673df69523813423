"""`hexwire sim hand`."""

from __future__ import annotations

import json
import queue
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from hexwire.bus.servo_bus import ServoBus
from hexwire.cli.main import cli
from hexwire.emulator.bus_arms import make_bus_arm
from hexwire.emulator.serve_pty import serve_bus
from hexwire.link.serial import SerialLink


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


@pytest.fixture
def port() -> Iterator[str]:
    arm = make_bus_arm("so101", start=time.monotonic())
    paths: queue.Queue[str] = queue.Queue()
    ended = threading.Event()
    thread = threading.Thread(
        target=lambda: serve_bus(arm.servos, baud=0, stop=ended.is_set, announce=paths.put, arm=arm.model)
    )
    thread.start()
    try:
        yield paths.get(timeout=30)
    finally:
        ended.set()
        thread.join(30)


def run(*words: str) -> Result:
    return CliRunner().invoke(cli, ["sim", "hand", *words])


def test_it_says_what_came_of_the_motion(port: str) -> None:
    free = run("shoulder_pan", "+20", "--duration", "0.3")
    assert free.output == "shoulder_pan moved by 20 deg\n" or free.output.startswith("shoulder_pan moved by 19.9")
    document = json.loads(run("1", "-20", "--duration", "0.3", "--port", port, "--json").output)
    assert document["joint"] == "shoulder_pan"
    assert document["moved_deg"] == pytest.approx(-20.0, abs=0.3)
    assert (document["torque"], document["blocked"]) == (False, False)
    # 90 degrees at first, give or take half a tooth of the horn.
    assert "moved by 11.8" in (stop := run("ELBOW_FLEX", "30", "--duration", "0.5").output)
    assert stop.endswith(", to its stop\n")
    weak = run("gripper", "+30", "--duration", "0.3", "--strength", "5").output
    assert weak == "gripper moved by 0 deg, not 30: the hand is too weak or too fast\n"


def test_a_joint_with_torque_gives_way_and_goes_back(port: str) -> None:
    with ServoBus(SerialLink(port)) as bus:
        assert bus.write_raw(1, "torque_enable", 1).ok
        before = bus.read(1, "present_position").raw
        output = run("1", "+40", "--duration", "0.3").output
        assert output.startswith("shoulder_pan has torque: it gave way by 3")
        assert output.endswith("deg and returns\n")
        deadline = time.monotonic() + 30.0
        while abs((bus.read(1, "present_position").raw or 0) - (before or 0)) > 2:
            assert time.monotonic() < deadline


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (["x", "4"], 2, "no joint 'x'; so101 has shoulder_pan"),
        (["9", "4"], 2, "no servo '9'; there are 1, 2"),
        (["1", "foo"], 2, "not a number"),
        (["1", "nan"], 2, "not a number"),
        (["1", "4000"], 2, "-3600 to 3600"),
        (["1", "4", "--duration", "0"], 2, "not above 0"),
        (["1", "4", "--duration", "700"], 2, "seconds is 700"),
        (["1", "4", "--strength", "2000"], 2, "force"),
        (["1", "4", "--prot", "x"], 2, "Did you mean '--port'?"),
        (["1", "4", "--port", "/dev/null"], 2, "is not an emulated arm"),
        (["1", "4", "--port", "zenoh:lab/arm1"], 2, "is a shared arm"),
        (["1", "4", "--port", "/dev/pts/none"], 1, "there is no /dev/pts/none"),
        (["1", "4", "--port", "sim://hex7bot"], 1, "no emulated arm of this user is running at sim://hex7bot"),
    ],
)
def test_errors_are_one_line(words: list[str], status: int, said: str, port: str) -> None:
    result = run(*words)
    assert (result.exit_code, len(result.stderr.splitlines())) == (status, 1)
    assert said in result.stderr


def test_without_an_arm_it_says_how_to_start_one() -> None:
    result = run("1", "4")
    assert (result.exit_code, "start 'hexwire sim bus'" in result.stderr) == (1, True)
