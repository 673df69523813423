from __future__ import annotations

import importlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from hexwire.ros1 import path
from hexwire.ros1.path import ROS_MISSING, find_ros

NEEDED = ("rospy", "actionlib", "sensor_msgs", "trajectory_msgs", "diagnostic_msgs", "std_srvs", "yaml")


@pytest.fixture(autouse=True)
def _no_ros(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Only what a test puts on the path is there."""
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if not (Path(entry) / "rospy").is_dir()])
    loaded = {name for name in sys.modules if name.partition(".")[0] in NEEDED}
    for name in loaded:
        monkeypatch.delitem(sys.modules, name)
    importlib.invalidate_caches()
    yield
    importlib.invalidate_caches()


def installed(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).mkdir(parents=True)
        (folder / name / "__init__.py").touch()
    return folder


def test_the_first_that_holds_rospy_goes_to_the_end(tmp_path: Path) -> None:
    before = list(sys.path)
    own, system = installed(tmp_path / "opt", *NEEDED[:-1]), installed(tmp_path / "usr", "yaml")
    assert find_ros([(tmp_path / "none", system), (own, system), (tmp_path / "other",)])
    assert sys.path == [*before, str(own), str(system)]


def test_what_is_found_already_is_left_alone(tmp_path: Path) -> None:
    sys.path.append(str(installed(tmp_path / "here", *NEEDED)))
    before = list(sys.path)
    assert find_ros([(installed(tmp_path / "other", *NEEDED),)])
    assert sys.path == before


def test_twice_is_once(tmp_path: Path) -> None:
    folders = (installed(tmp_path / "usr", *NEEDED),)
    assert find_ros([folders])
    before = list(sys.path)
    assert find_ros([folders])
    assert sys.path == before


def test_an_incomplete_installation_does_not_count(tmp_path: Path) -> None:
    before = list(sys.path)
    assert not find_ros([(installed(tmp_path / "usr", "rospy", "yaml"),)])
    assert not find_ros([(tmp_path / "none",)])
    assert sys.path == before


def test_what_to_do_is_one_line_that_apt_takes() -> None:
    assert "\n" not in ROS_MISSING
    packages = ROS_MISSING.partition("apt-get install ")[2].split()
    # PyYAML comes with python3-rospy.
    assert {name.removeprefix("python3-").replace("-", "_") for name in packages} == set(NEEDED) - {"yaml"}


@pytest.mark.slow
def test_debians_packages_from_an_interpreter_that_does_not_see_them() -> None:
    code = (
        "import sys\n"
        "from hexwire.ros1.path import find_ros\n"
        "before = list(sys.path)\n"
        "assert find_ros()\n"
        "assert sys.path[: len(before)] == before\n"
        "import actionlib, rospy\n"
    )
    subprocess.run([sys.executable, "-P", "-c", code], check=True)


def test_noetic_is_looked_for_before_debian() -> None:
    own, debian = path._INSTALLATIONS
    assert own[0].is_relative_to("/opt/ros/noetic")
    assert own[1:] == debian
