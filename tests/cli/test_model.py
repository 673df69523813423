from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from tests.model.poses import VECTORS

from hexwire.cli.main import cli


def run(*args: object, stdin: str = "") -> Result:
    return CliRunner().invoke(cli, ["model", *map(str, args)], input=stdin)


def answer(*args: object, stdin: str = "") -> dict[str, Any]:
    result = run(*args, "--json", stdin=stdin)
    assert result.exit_code == 0, result.output
    data: dict[str, Any] = json.loads(result.stdout)
    return data


def flat(rows: list[list[float]]) -> list[float]:
    return [value for row in rows for value in row]


@pytest.mark.parametrize("row", VECTORS["hex7bot_A"], ids=lambda row: "/".join(map(str, row["q"])))
def test_fk_answers_the_published_poses(row: dict[str, Any]) -> None:
    got = answer("fk", "--links", "A", *row["q"])
    assert got["wrist_mm"] == pytest.approx(row["wrist"], abs=6e-7)
    assert got["tip_mm"] == pytest.approx(row["tip"], abs=6e-7)
    assert got["side_mm"] == pytest.approx(row["side"], abs=6e-7)
    assert flat(got["rotation"]) == pytest.approx(flat(row["R"]), abs=6e-10)
    assert got["elbow_deg"] == pytest.approx(row["elbow_deg"], abs=6e-7)


@pytest.mark.parametrize("row", VECTORS["puma260"], ids=lambda row: "/".join(map(str, row["q"])))
def test_fk_of_the_puma(row: dict[str, Any]) -> None:
    got = answer("fk", "--robot", "puma260", *row["q"])
    assert got["position_m"] == pytest.approx(row["p_m"], abs=1e-12)
    assert flat(got["rotation"]) == pytest.approx(flat(row["R"]), abs=1e-12)


def test_negative_numbers_are_no_options() -> None:
    got = answer("fk", "--links", "B", -30, 100, 80, "-12.5", 0, "-1e-1")
    assert got["angles_deg"] == [-30, 100, 80, -12.5, 0, -0.1]
    assert any("t3=-12.5 deg" in text for text in got["violations"])
    assert answer("fk", -170, -90, -90, -90, -90, -90, "--robot", "puma260")["angles_deg"][0] == -170


def test_ik_reads_what_fk_wrote() -> None:
    pose = run("fk", "--links", "V1", 120, 100, 60, 60, 30, 45, "--json").stdout
    got = answer("ik", "-", stdin=pose)
    assert len(got["solutions"]) == 8
    assert got["solutions"][0]["allowed"]
    assert got["solutions"][0]["angles_deg"] == pytest.approx([120, 100, 60, 60, 30, 45], abs=1e-7)


def test_ik_of_typed_numbers() -> None:
    pose = answer("fk", 60, 80, 100, 70, 40, 80)
    numbers = [f"{v:.6f}" for v in flat(pose["rotation"])]
    got = answer("ik", *(f"{v:.4f}" for v in pose["tip_mm"]), "--rotation", *numbers)
    assert got["solutions"][0]["angles_deg"] == pytest.approx([60, 80, 100, 70, 40, 80], abs=1e-3)
    by_wrist = answer("ik", "--wrist", *pose["wrist_mm"], "--rotation", *numbers)
    assert by_wrist["solutions"][0]["angles_deg"] == pytest.approx([60, 80, 100, 70, 40, 80], abs=1e-3)


def test_ik_of_the_wrist_alone_is_the_librarys_documented_point() -> None:
    got = answer("ik", "--wrist", 0, 188, 188)
    assert got["solutions"][0]["angles_deg"] == pytest.approx([90, 103.156, 102.840], abs=6e-4)


def test_ik_with_rpy_for_the_puma() -> None:
    got = answer("ik", 0.254, -0.12446, 0.10795, "--rpy", 0, 0, 0, "--robot", "puma260")
    assert any(s["angles_deg"] == pytest.approx([0] * 6, abs=1e-6) for s in got["solutions"])


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (
            ("ik", 0, 500, 100, "--rpy", 0, 0, 0),
            "out of reach: the wrist would be 475.7 mm from the shoulder, 164.5 mm",
        ),
        (("ik", "--wrist", 0, 900, 0), "out of reach: the wrist would be"),
        (("ik", 0, 200), "a position has three coordinates X Y Z, got 2"),
        (("ik", 0, 200, 100), "a pose needs --rotation or --rpy; or --wrist"),
        (("ik", 0, 200, "up", "--rpy", 0, 0, 0), "'up' is not a number"),
        (("ik", 0, 0.2, 0.1, "--rpy", 0, 0, 0, "--robot", "puma260", "--wrist"), "--wrist is for the 7Bot only"),
        (("ik", "-"), "standard input:1:1: not JSON"),
        (("fk", 1, 2, 3, 4, 5), "takes 6 values"),
        (("fk", 1, 2, 3, 4, 5, "nan"), "'nan' is not a number"),
        (("fk", "--links", "C", 1, 2, 3, 4, 5, 6), "no link set 'C'"),
        (("check", 90, 40, 40, 90, 90, 90), "elbow open 25 deg too far"),
    ],
)
def test_invalid_values_give_one_line_and_status_2(args: tuple[object, ...], words: str) -> None:
    result = run(*args)
    assert result.exit_code == 2
    assert words in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_check_and_its_json() -> None:
    assert run("check", 90, 100, 80, 90, 45, 90).stdout.endswith("allowed\n")
    assert answer("check", 90, 90, 90, 90, 90, 90)["near_singularity"] == ["wrist"]


def test_own_link_set_from_a_file(tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    file.write_text("a=120\nb=40\nc=188\nd=24.28\ne=79\nf=121.6\ng=12\nh=34.8\noffset=90\n", encoding="utf-8")
    assert answer("fk", "--links", file, 90, 90, 90, 90, 90, 90)["tip_mm"][1] == pytest.approx(333.88)
    file.write_text("a=120\nz=1\n", encoding="utf-8")
    result = run("fk", "--links", file, 90, 90, 90, 90, 90, 90)
    assert result.exit_code == 2
    assert "own.toml:2:3: z is an unknown key; known: a, b, c" in result.stderr
    assert run("fk", "--links", tmp_path / "none.toml", 90, 90, 90, 90, 90, 90).exit_code == 2


def test_text_for_people() -> None:
    text = run("fk", 90, 90, 90, 90, 90, 270).stdout
    assert "tip mm           0.000    233.880    233.800" in text
    assert "warning      near a singularity: wrist" in text
    table = run("ik", "--wrist", 0, 188, 188).stdout.splitlines()
    assert table[0].split() == ["t0", "t1", "t2", "branch"]
    assert table[1].endswith("allowed")


def test_urdf_to_a_file(tmp_path: Path) -> None:
    assert run("urdf", "--robot", "puma260", "-o", tmp_path / "arm.urdf").exit_code == 0
    assert (tmp_path / "arm.urdf").read_text(encoding="utf-8") == run("urdf", "--robot", "puma260").stdout


def test_no_heavy_package_is_loaded_for_one_pose() -> None:
    code = (
        "import sys\n"
        "from hexwire.cli.main import cli\n"
        "try:\n"
        "    cli.main(['model', 'fk', '90', '90', '90', '90', '90', '90', '--json'])\n"
        "except SystemExit as end:\n"
        "    assert end.code == 0\n"
        "heavy = {'numpy', 'matplotlib', 'mujoco', 'ruckig', 'mcap', 'rich'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    subprocess.run([sys.executable, "-P", "-c", code], check=True, stdout=subprocess.DEVNULL)


# -- five joints ----------------------------------------------------------------------------------------------


def test_fk_and_ik_of_the_so101() -> None:
    pose = run("fk", "--robot", "so101", 10, 20, -15, 30, 40, "--json").stdout
    report = json.loads(pose)
    assert report["pitch_deg"] == pytest.approx(35)
    assert report["roll_deg"] == 40
    got = answer("ik", "-", stdin=pose)
    assert got["robot"] == "so101"
    assert got["solutions"][0]["angles_deg"] == pytest.approx([10, 20, -15, 30, 40], abs=1e-6)
    typed = answer("ik", *report["tip_mm"], "--pitch", 35, "--roll", 40, "--robot", "so101")
    assert typed["solutions"][0]["angles_deg"] == pytest.approx([10, 20, -15, 30, 40], abs=1e-6)
    assert {s["branch"] for s in typed["solutions"]} == {"front, elbow up", "front, elbow down"}


@pytest.mark.parametrize(
    ("robot", "tip"), [("so101", "391.362 -0.011 226.469"), ("so100", "400.200 0.000 228.870")]
)
def test_zero_of_the_so_arms_for_people(robot: str, tip: str) -> None:
    lines = [" ".join(line.split()) for line in run("fk", "--robot", robot, 0, 0, 0, 0, 0).stdout.splitlines()]
    assert f"tip mm {tip}" in lines
    assert "pitch deg 0.000" in lines


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("fk", 1, 2, 3, 4, 5, 6), "T0 T1 T2 T3 T4 takes 5 values, not 6"),
        (("check", 1, 2, 3, 4), "T0 T1 T2 T3 T4 takes 5 values, not 4"),
        (("check", 0, 0, 0, 100, 0), "wrist_flex=100 deg is 5 deg above its limits -95 to 95 deg"),
        (("ik", 900, 0, 100, "--pitch", 90), "out of reach: the wrist would be"),
        (("ik", 200, 100, 200, "--rpy", 0, 90, 0), "so101 would miss the rotation by 31.83 deg"),
        (("ik", 200, 0, 100, "--roll", 0, "--rpy", 0, 0, 0), "--roll needs --pitch"),
        (("ik", 200, 0, 100, "--pitch", 0, "--rpy", 0, 0, 0), "--pitch contradicts the rotation"),
        (("ik", 200, 0, 100, "--pitch", "inf"), "'inf' is not a number"),
        (("ik", 200, 0, 100), "a pose needs --rotation or --rpy, or --pitch"),
    ],
)
def test_invalid_values_of_five_joints_give_one_line_and_status_2(args: tuple[object, ...], words: str) -> None:
    result = run(*args, "--robot", "so101")
    assert result.exit_code == 2
    assert words in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_pitch_of_an_arm_of_six_joints_is_refused() -> None:
    result = run("ik", 0, 200, 100, "--pitch", 90)
    assert result.exit_code == 2
    assert "hex7bot has six joints: give its rotation" in result.stderr


# -- ros2-package ----------------------------------------------------------------------------------------------


def package_files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_ros2_package_writes_a_folder(tmp_path: Path) -> None:
    folder = tmp_path / "ws" / "src" / "arm"
    result = run("ros2-package", folder, "--robot", "so101", "--distribution", "Kilted")
    assert result.exit_code == 0, result.output
    assert result.stdout == f"hexwire_so101 for ROS 2 kilted: {len(package_files(folder))} files in {folder}\n"
    assert {"package.xml", "urdf/so101.urdf", "config/so101.srdf"} <= set(package_files(folder))
    # Others build it, too.
    assert (folder / "package.xml").stat().st_mode & 0o777 == 0o644


def test_ros2_package_is_for_the_distribution_of_the_shell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The node of the package would speak another one than its neighbours otherwise."""
    monkeypatch.setenv("ROS_DISTRO", "lyrical")
    said = run("ros2-package", tmp_path / "arm", "--robot", "so101").stdout
    assert said.startswith("hexwire_so101 for ROS 2 lyrical:")
    assert "distribution: lyrical\n" in (tmp_path / "arm" / "config" / "hardware_interface.yaml").read_text()
    assert "for ROS 2 jazzy:" in run("ros2-package", tmp_path / "other", "--distribution", "jazzy").stdout


def test_ros2_package_overwrites_only_by_force_and_nothing_otherwise(tmp_path: Path) -> None:
    assert run("ros2-package", tmp_path).exit_code == 0
    before = package_files(tmp_path)
    mine = tmp_path / "config" / "joint_limits.yaml"
    mine.write_text("mine")
    (tmp_path / "CMakeLists.txt").unlink()
    result = run("ros2-package", tmp_path)
    assert result.exit_code == 2
    assert "already exists; --force overwrites it" in result.stderr
    assert mine.read_text() == "mine"
    # Not even the file that was missing: all or none.
    assert not (tmp_path / "CMakeLists.txt").exists()
    assert run("ros2-package", tmp_path, "--force").exit_code == 0
    assert package_files(tmp_path) == before


def test_ros2_package_does_not_mix_two_arms(tmp_path: Path) -> None:
    assert run("ros2-package", tmp_path, "--robot", "so100").exit_code == 0
    before = package_files(tmp_path)
    for more in ([], ["--force"]):
        result = run("ros2-package", tmp_path, "--robot", "so101", *more)
        assert result.exit_code == 2
        assert "contains another package; choose a folder of its own for hexwire_so101" in result.stderr
    assert package_files(tmp_path) == before


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--distribution", "foxy"), "no ROS 2 distribution 'foxy'"),
        (("--robot", "sevenbot"), "no geometry is known for robot 'sevenbot'"),
        (("--links", "C"), "no link set 'C'"),
    ],
)
def test_ros2_package_refuses_unknown_names(tmp_path: Path, words: tuple[str, ...], reason: str) -> None:
    result = run("ros2-package", tmp_path / "new", *words)
    assert result.exit_code == 2
    assert reason in result.stderr
    assert not (tmp_path / "new").exists()


def test_ros2_package_follows_no_link(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.write_text("mine")
    folder = tmp_path / "arm"
    folder.mkdir()
    (folder / "README.md").symlink_to(elsewhere)
    result = run("ros2-package", folder, "--force")
    assert result.exit_code == 2
    assert "symbolic link" in result.stderr
    assert elsewhere.read_text() == "mine"
