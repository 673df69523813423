"""The program hexwire-ros1: its options, and what it needs before a node starts."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import hexwire
from hexwire.cli import ros1
from hexwire.ros1.parameters import PARAMETERS
from hexwire.ros1.path import ROS_MISSING

SCRIPTS = Path(sys.executable).parent


def _run(*args: str, **variables: str) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, **variables}
    return subprocess.run(
        [sys.executable, "-m", "hexwire.cli.ros1", *args], env=env, capture_output=True, text=True, timeout=60
    )


def _evaluated(lines: str, **variables: str) -> dict[str, str]:
    """What a POSIX shell has after the lines."""
    show = 'printf "%s\\n" "$ROS_PACKAGE_PATH" "$PATH"'
    result = subprocess.run(
        ["/bin/sh", "-c", f"{lines}\n{show}"], env=variables, check=True, capture_output=True, text=True, timeout=60
    )
    packages, path = result.stdout.splitlines()
    return {"ROS_PACKAGE_PATH": packages, "PATH": path}


def test_help_says_what_it_is_and_how_parameters_are_given() -> None:
    result = _run("--help")
    assert result.returncode == 0
    for text in ("hardware_interface", "_port:=/dev/ttyUSB0", "--env", "--package-path", "roslaunch hexwire"):
        assert text in result.stdout
    assert max(map(len, result.stdout.splitlines())) <= 116


def test_help_has_every_parameter_with_its_default() -> None:
    words = _run("--help").stdout.split()
    assert {f"_{row.name}:={row.default_text}" for row in PARAMETERS} <= set(words)


def test_version() -> None:
    result = _run("--version")
    assert (result.returncode, result.stdout) == (0, f"hexwire-ros1 {hexwire.__version__}\n")


def test_package_path_holds_the_package() -> None:
    folder = Path(_run("--package-path").stdout.strip())
    assert (folder / "hexwire" / "package.xml").is_file()


def _program(before: str, *args: str) -> subprocess.CompletedProcess[str]:
    """The program in an interpreter in which something was done `before`."""
    text = f"{before}; from hexwire.cli.ros1 import main; main()"
    return subprocess.run([sys.executable, "-c", text, *args], capture_output=True, text=True, timeout=60)


def test_without_ros_it_says_what_to_install() -> None:
    result = _program("from hexwire.ros1 import path; path.find_ros = lambda: False", "_port:=/dev/ttyUSB0")
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr == f"error: {ROS_MISSING}\n"
    assert "apt-get install" in ROS_MISSING


_STUB = (
    "import sys, types; from hexwire.ros1 import path; path.find_ros = lambda: True; "
    "node = sys.modules['hexwire.ros1.node'] = types.ModuleType('node'); node.run = "
)


def test_arguments_of_ros_go_to_the_node_as_they_are() -> None:
    args = ["_port:=/dev/tty USB0", "__name:=x", "command:=foo", "--odd:=1"]
    result = _program(f"{_STUB} lambda argv: print(argv)", *args)
    assert (result.returncode, result.stdout) == (0, f"{args}\n")


def test_exit_status_is_that_of_the_node() -> None:
    assert _program(f"{_STUB} lambda argv: 7").returncode == 7


def test_an_error_of_the_node_is_one_line() -> None:
    result = _program(
        f"{_STUB} lambda argv: exec('from hexwire.errors import DeviceError as E; raise E(\"gone\")')"
    )
    assert (result.returncode, result.stderr) == (1, "error: gone\n")


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_in_what_ros_does_at_the_end_ends_it_without_a_word(name: str) -> None:
    at_the_end = f"import atexit, os, signal; atexit.register(lambda: os.kill(os.getpid(), signal.{name}))"
    result = _program(f"{at_the_end}; {_STUB} lambda argv: 0")
    assert (result.returncode, result.stderr) == (-signal.Signals[name], "")


@pytest.mark.parametrize("args", [["--nonsense"], ["-x", "_port:=a"], ["/dev/ttyUSB0"], ["--help", "_port:=a"]])
def test_unknown_arguments_are_refused_on_one_line(args: list[str]) -> None:
    result = _run(*args)
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert args[0] in result.stderr
    assert "--help" in result.stderr


def test_a_port_without_its_name_is_refused_with_an_example() -> None:
    assert "_port:=" in _run("/dev/ttyUSB0").stderr


def test_env_puts_the_package_in_front() -> None:
    lines = ros1.environment({"ROS_PACKAGE_PATH": "/opt/ros/noetic/share"}, None)
    seen = _evaluated(lines, PATH="/bin")
    assert seen == {"ROS_PACKAGE_PATH": f"{ros1.package_path()}:/opt/ros/noetic/share", "PATH": "/bin"}


def test_env_leaves_a_package_path_that_has_it() -> None:
    before = f"/a:{ros1.package_path()}:/b"
    assert _evaluated(ros1.environment({"ROS_PACKAGE_PATH": before}, None))["ROS_PACKAGE_PATH"] == before


def test_env_twice_changes_nothing() -> None:
    once = _evaluated(ros1.environment({"PATH": "/bin"}, SCRIPTS / ros1.PROGRAM), PATH="/bin")
    assert once["PATH"] == f"{SCRIPTS}:/bin"
    assert _evaluated(ros1.environment(once, SCRIPTS / ros1.PROGRAM), **once) == once


def test_env_quotes_what_a_shell_would_take_apart(tmp_path: Path) -> None:
    folder = tmp_path / "it's a $(false) `place`"
    folder.mkdir()
    program = folder / ros1.PROGRAM
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    variables = {"PATH": "/bin:/s p a c e", "ROS_PACKAGE_PATH": '/"quoted" $HOME'}
    seen = _evaluated(ros1.environment(variables, program), **variables)
    assert seen["PATH"] == f"{folder}:/bin:/s p a c e"
    assert seen["ROS_PACKAGE_PATH"] == f'{ros1.package_path()}:/"quoted" $HOME'


def test_env_puts_this_program_before_another_of_its_name(tmp_path: Path) -> None:
    for name in ("ours", "other"):
        program = tmp_path / name / ros1.PROGRAM
        program.parent.mkdir()
        program.write_text("#!/bin/sh\n")
        program.chmod(0o755)
    lines = ros1.environment({"PATH": f"{tmp_path}/other"}, tmp_path / "ours" / ros1.PROGRAM)
    assert _evaluated(lines)["PATH"] == f"{tmp_path}/ours:{tmp_path}/other"


def test_env_of_the_installed_program_finds_it() -> None:
    result = subprocess.run(
        [str(SCRIPTS / ros1.PROGRAM), "--env"], env={"PATH": "/bin"}, capture_output=True, text=True, timeout=60
    )
    assert result.returncode == 0
    assert _evaluated(result.stdout, PATH="/bin")["PATH"].split(":")[0] == str(SCRIPTS)
