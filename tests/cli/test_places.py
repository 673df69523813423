from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from hexwire.cli.main import cli


def test_the_tip_is_where_goto_has_sent_it(bench: Any) -> None:
    assert bench.run("goto", "0", "220", "200").exit_code == 0
    found = bench.json("tip")
    assert found["position_m"] == pytest.approx([0, 0.22, 0.2], abs=2e-3)
    x, y, z = map(float, bench.ok("tip").split(" mm, rpy ")[0].split())
    assert [x, y, z] == pytest.approx([1e3 * value for value in found["position_m"]], abs=0.06)
    assert found["pitch_roll_deg"] is None


def test_the_tip_of_five_joints_has_a_pitch_and_a_roll(so_bench: Any) -> None:
    result = so_bench("tip", "--robot", "so101")
    assert result.exit_code == 0, result.output
    assert " mm, pitch " in result.stdout
    assert ", roll " in result.stdout


def test_limits_are_those_that_a_refusal_names(bench: Any) -> None:
    row = bench.json("limits")[0]
    assert row["name"] == "J1"
    assert (row["minimum_deg"], row["maximum_deg"]) == pytest.approx((-85, 75), abs=1e-3)
    assert "outside its limits -85 to 75 deg" in bench.run("move", "J1=200").stderr
    assert bench.ok("limits").splitlines()[1].split()[:3] == ["J1", "-85.0", "75.0"]


def test_a_pose_is_saved_listed_gone_to_and_deleted(bench: Any, monkeypatch: Any, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert bench.ok("poses").startswith("home: J1=")
    bench.run("move", "J1=10", "--wait")
    bench.ok("poses", "--save", "pick")
    again = bench.run("poses", "--save", "pick")
    assert (again.exit_code, again.stderr) == (2, "error: there is a pose 'pick' already; --force replaces it\n")
    bench.ok("poses", "--save", "pick", "--force")
    assert list(bench.json("poses")) == ["home", "pick"]
    assert bench.json("poses")["pick"]["J1"] == pytest.approx(10, abs=0.2)
    assert bench.run("goto", "pick").exit_code == 0
    assert "pick" not in bench.ok("poses", "--delete", "pick")
    gone = bench.run("poses", "--delete", "pick")
    assert (gone.exit_code, gone.stderr) == (2, "error: there is no pose 'pick'\n")


@pytest.mark.parametrize("words", [("--force",), ("--save", "a", "--delete", "b")])
def test_options_that_fit_nothing_are_refused(bench: Any, words: tuple[str, ...]) -> None:
    assert bench.run("poses", *words).exit_code == 2
    assert bench.urls == []


@pytest.mark.parametrize("command", ["poses", "limits"])
def test_what_needs_no_answer_is_said_of_an_arm_that_is_not_there(
    tmp_path: Path, monkeypatch: Any, command: str
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    result = CliRunner().invoke(cli, [command, "--port", "/dev/ttyNONE", "--robot", "so101", "--json"])
    assert result.exit_code == 0, result.output
    assert "shoulder_pan" in result.stdout
