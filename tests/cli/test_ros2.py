"""The program hexwire-ros2: its options, and what it says before a node starts."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import hexwire
from hexwire.cli import ros2
from hexwire.ros2.settings import PARAMETERS

Done = subprocess.CompletedProcess[str]
Run = Callable[..., Done]
SCRIPT = Path(sys.executable).parent / "hexwire-ros2"


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs the program in this process."""

    def run_here(*args: str, **variables: str) -> Done:
        for name in [name for name in os.environ if name.startswith(("ROS_", "ZENOH_", "HEXWIRE_"))]:
            monkeypatch.delenv(name)
        for name, value in variables.items():
            monkeypatch.setenv(name, value)
        monkeypatch.setattr(sys, "argv", ["hexwire-ros2", *args])
        with pytest.raises(SystemExit) as end:
            ros2.main()
        return Done(args, end.value.code or 0, *capsys.readouterr())  # type: ignore[arg-type]  # it is a number

    return run_here


def _program(before: str, *args: str) -> subprocess.CompletedProcess[str]:
    """The program in an interpreter in which something was done `before`."""
    text = f"{before}\nfrom hexwire.cli.ros2 import main; main()"
    return subprocess.run([sys.executable, "-c", text, *args], capture_output=True, text=True, timeout=60)


def _refused(result: subprocess.CompletedProcess[str], status: int = 2) -> str:
    """Its only line."""
    assert (result.returncode, result.stdout) == (status, ""), result.stderr
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    return result.stderr


def test_help_says_what_it_is_and_has_every_parameter(run: Run) -> None:
    result = run("--help")
    assert result.returncode == 0
    for text in ("hardware_interface", "--ros-args -p port:=/dev/ttyUSB0", "robot_joint_commands", "fleet router"):
        assert text in " ".join(result.stdout.split())
    assert max(map(len, result.stdout.splitlines())) <= 116
    words = result.stdout.split()
    assert all(any(word.startswith((f"{row.name}:=", f"{row.name}.")) for word in words) for row in PARAMETERS)


def test_version() -> None:
    for option in ("-V", "--version"):
        result = subprocess.run([SCRIPT, option], capture_output=True, text=True, timeout=60)
        assert (result.returncode, result.stdout) == (0, f"hexwire-ros2 {hexwire.__version__}\n"), option


@pytest.mark.parametrize("args", [["--nonsense"], ["-x", "--ros-args"], ["/dev/ttyUSB0"], ["--help", "--ros-args"]])
def test_unknown_arguments_are_refused_on_one_line(run: Run, args: list[str]) -> None:
    assert args[0] in _refused(run(*args))


def test_a_port_without_its_name_is_refused_with_an_example(run: Run) -> None:
    assert "--ros-args -p port:=" in _refused(run("/dev/ttyUSB0"))


@pytest.mark.parametrize(
    ("args", "text"),
    [
        (["--ros-args", "-p"], "-p flag"),
        (["--ros-args", "--nonsense"], "unknown ROS arguments"),
        (["--ros-args", "-r", "__node:=1st"], "1st"),
        (["--ros-args", "--params-file", "/nowhere.yaml"], "/nowhere.yaml"),
        (["--ros-args", "-p", "prot:=x"], "prot: unknown, did you mean port?"),
        (["--ros-args", "-p", "port:=x", "-p", "watchdog:=-1", "-p", "pose_speed:=2"], "parameters are wrong: "),
        (["--ros-args", "-p", "robot:=r2d2"], "robot: "),
        (
            ["--ros-args", "-p", "robot:=sevenbot", "-p", "port:=/dev/null", "-p", "publish_tf:=true"],
            "publish_tf: ",
        ),
    ],
)
def test_wrong_arguments_and_parameters_are_told_on_one_line(run: Run, args: list[str], text: str) -> None:
    assert text in _refused(run(*args))


@pytest.mark.parametrize(
    ("variables", "text"),
    [
        ({"ROS_DOMAIN_ID": "-1"}, "ROS_DOMAIN_ID"),
        ({"ZENOH_CONFIG_OVERRIDE": "nonsense"}, "ZENOH_CONFIG_OVERRIDE"),
        ({"ZENOH_ROUTER_CHECK_ATTEMPTS": "soon"}, "ZENOH_ROUTER_CHECK_ATTEMPTS"),
    ],
)
def test_a_wrong_environment_is_told_on_one_line(run: Run, variables: dict[str, str], text: str) -> None:
    assert text in _refused(run("--ros-args", "-p", "port:=/dev/null", **variables))


def test_a_port_that_cannot_be_opened_is_a_fault_of_the_device() -> None:
    result = _program("", "--ros-args", "-p", "port:=/dev/not_there", "-p", "connect_timeout:=0.0")
    assert result.returncode == 1
    assert result.stderr.splitlines()[-1].startswith("error: ")
    assert "/dev/not_there" in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize(("module", "status"), [("zenoh_ros2", 2), pytest.param("yaml", 1, marks=pytest.mark.slow)])
def test_without_its_extra_it_says_what_to_install(module: str, status: int) -> None:
    result = _program(f"import sys; sys.modules[{module!r}] = None", "--ros-args", "-p", "port:=/dev/null")
    assert "pip install 'hexwire[ros2]'" in _refused(result, status)
