"""An arm that is not hexwire's, of a package with one entry point: everything that knows arms knows it."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from tests.packages import install

import hexwire
from hexwire.cli.main import cli
from hexwire.drivers.registry import load_bus_arm, robot_names
from hexwire.link.open import make_link
from hexwire.model.arms import assembled_arms
from hexwire.model.geometry import kinematics_for
from hexwire.setup.arm_setup import ArmSetup, label, picture
from hexwire.studio.geometry import make_geometry
from hexwire.studio.plugged import emulated
from hexwire.studio.twins import twin_for

NAME = "longarm"
PAGE = (Path(__file__).parents[1] / "docs" / "adding-an-arm.md").read_text(encoding="utf-8")


def block(language: str) -> str:
    """The first block of a language."""
    found = re.search(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)
    assert found is not None
    return found[1]


@pytest.fixture(autouse=True)
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The package of the page, installed; what is imported from it is forgotten afterwards."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, NAME, raising=False)
    entries = {"hexwire.arms": dict(re.findall(rf'^({NAME}) = "(.*)"$', PAGE, re.MULTILINE))}
    files = {f"{NAME}/__init__.py": block("python"), f"{NAME}/arm.toml": block("toml")}
    install(tmp_path, NAME, entries, files)


def run(*words: str) -> Result:
    result = CliRunner().invoke(cli, words)
    assert result.exit_code == 0, (words, result.output)
    return result


def test_its_geometry_is_its_own() -> None:
    assert NAME in robot_names()
    model = load_bus_arm(NAME).described().model
    kinematics, short = kinematics_for(model), kinematics_for(load_bus_arm("so101").described().model)
    assert kinematics is not None
    assert short is not None
    zero = [0.0] * 5
    ahead = kinematics.forward(zero).position[0] - short.forward(zero).position[0]
    assert ahead == pytest.approx(0.030)
    assert '"robot": "longarm"' in run("model", "fk", "--robot", NAME, *["0"] * 5, "--json").stdout


def test_an_emulated_one_has_all_verbs() -> None:
    with hexwire.connect(f"sim://{NAME}") as arm:
        arm.torque(True)
        arm.goto(z=arm.tip.position[2] + 0.02)
        assert arm.open().arrived
        assert arm.driver.model.kind == NAME


def test_its_picture_and_its_files_for_ros(tmp_path: Path) -> None:
    assert f'<robot name="{NAME}"' in run("model", "urdf", "--robot", NAME).stdout
    run("model", "ros2-package", "--robot", NAME, str(tmp_path / "ros"))
    assert list((tmp_path / "ros").rglob(f"{NAME}.srdf"))


def test_its_set_up_has_its_picture() -> None:
    setup = ArmSetup(load_bus_arm(NAME).described().model, 1_000_000)
    assert any("(6) gripper" in line for line in picture(setup))
    assert label(setup.model, "gripper", leader=True) == "1:147 (C046)"


def test_its_physics_and_the_studio() -> None:
    link = make_link(f"sim://{NAME}?physics=1")
    link.open()
    link.close()
    assert make_geometry(load_bus_arm(NAME).described().model) is not None
    assert any(row.device == f"sim://{NAME}" for row in emulated())
    assert twin_for(NAME, ()) == NAME
    # Its set-up and calibration on the page Servos.
    assert assembled_arms()[NAME] == "SO-101 with a long forearm"


def test_an_arm_that_nobody_knows_names_it() -> None:
    """A misspelt name lists it."""
    result = CliRunner().invoke(cli, ["sim", "bus", "--arm", "longarn"])
    assert (result.exit_code, NAME in result.stderr) == (2, True), result.output
