"""Several points of one motion, typed: places, poses by name, corners, waypoints without times."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner, Result
from tests.cli.test_motion import tip, tool
from tests.drivers.puma_server import served_puma
from tests.motion.arms import HOME

import hexwire
from hexwire.cli.main import cli
from hexwire.cli.motion import Point, points_argument, pose_options, to_points
from hexwire.control.motion.via import Place
from hexwire.control.requests.pose_file import PoseFile, home_pose
from hexwire.drivers.registry import make_driver
from hexwire.errors import UsageError
from hexwire.model.aim import Aim
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.model.arms.puma260.kinematics import Puma260Model


@pytest.fixture
def poses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> PoseFile:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    file = PoseFile(HEX7BOT)
    file.save("nod", {"J1": HOME["J1"] + 0.4, "J7": 0.3})
    return file


def typed(*words: str) -> tuple[Result, list[Any]]:
    got: list[Any] = []

    @click.command(context_settings={"ignore_unknown_options": True})
    @points_argument
    @pose_options
    def command(points: list[Point], aim: Aim, relative: bool) -> None:
        got.extend((points, aim, relative))

    return CliRunner().invoke(command, words), got


def test_numbers_are_places_and_words_are_poses() -> None:
    result, got = typed("0", "-220", "2e2", "home", "a b", "1", "2", "3", "--relative", "--pitch", "30")
    assert result.exit_code == 0, result.output
    assert got == [
        [(0.0, -220.0, 200.0), "home", "a b", (1.0, 2.0, 3.0)],
        Aim(pitch=math.radians(30)),
        True,
    ]


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (("0", "220"), "X Y Z takes 3 values, not 2"),
        (("0", "220", "200", "5"), "X Y Z takes 3 values, not 4"),
        (("0", "home", "200"), "'home' is not a number"),
        (("0", "inf", "200"), "'inf' is not a number"),
        ((), "Missing argument"),
    ],
)
def test_places_that_are_no_places(words: tuple[str, ...], error: str) -> None:
    result, _ = typed(*words)
    assert result.exit_code == 2
    assert error in result.output


def test_units_and_aims() -> None:
    result, got = typed("0.1", "0.2", "0.3", "--rpy", "90", "0", "0")
    assert result.exit_code == 0, result.output
    how = got[1]
    (place,) = to_points(got[0], Puma260Model(), how, False)
    assert isinstance(place, Place)
    assert place.position == (0.1, 0.2, 0.3)
    assert place.aim.rpy == (math.pi / 2, 0.0, 0.0)
    with pytest.raises(UsageError, match=r"in millimetres, and 0 0\.22 0\.15 mm is inside the base of the arm"):
        to_points([(0.0, 0.22, 0.15)], Hex7BotModel(), Aim(), False)
    with pytest.raises(UsageError, match="without a geometry"):
        to_points(["home"], None, how, False)


def test_goto_passes_places_and_poses_without_a_stop(bench: Any, poses: PoseFile) -> None:
    words = ("goto", "0", "220", "200", "60", "200", "160", "nod")
    out = bench.ok(*words)
    assert out.startswith("goto 0 220 200 mm, 60 200 160 mm, nod: ")
    assert out.count("lowest point") == 1
    there = bench.positions()
    assert there["J1"] == pytest.approx(math.degrees(HOME["J1"] + 0.4), abs=0.3)
    assert there["J7"] == pytest.approx(math.degrees(0.3), abs=0.3)
    assert tip(bench)[2] == pytest.approx(160, abs=1.5)
    # Poses alone need no place.
    assert bench.ok("goto", "nod").startswith("goto nod: ")


def test_goto_takes_less_time_than_with_stops(bench: Any) -> None:
    places = [("0", "220", "200"), ("15", "215", "190"), ("30", "210", "180"), ("45", "205", "170")]
    bench.ok("goto", *places[0])
    whole = bench.json("goto", *(word for place in places[1:] for word in place), "--dry-run")
    alone = 0.0
    for place in places[1:]:
        alone += bench.json("goto", *place)["legs"][0]["duration_s"]
    assert whole["legs"][0]["duration_s"] < 0.8 * alone


def test_relative_places_count_from_the_one_before(bench: Any) -> None:
    bench.ok("goto", "0", "220", "200")
    out = bench.ok("goto", "--relative", "10", "0", "-10", "10", "0", "-10")
    # From where the servos have come to rest, about 0.1 mm off.
    second = out.partition(", ")[2].split()[:3]
    assert [float(value) for value in second] == pytest.approx([20, 220, 180], abs=1.0)
    assert tip(bench) == pytest.approx([20, 220, 180], abs=1.5)


def test_the_gripper_moves_meanwhile(bench: Any, poses: PoseFile) -> None:
    out = bench.ok("goto", "0", "220", "200", "--grip", "open")
    assert out.endswith("; the gripper 100 % open\n")
    shaft = bench.board.wire.servos[6].motion
    shaft.obstacle = (None, shaft.position + 500)
    told = bench.json("line", "0", "220", "180", "--grip", "close")
    assert (told["arrived"], told["holds"], told["open_fraction"]) == (True, True, pytest.approx(0.5, abs=0.05))
    shaft.obstacle = (None, None)
    # The pose has a place for the gripper, too.
    assert bench.ok("goto", "nod", "--grip", "40%").endswith("; the gripper 40 % open\n")
    assert "holds" not in bench.json("goto", "home")
    assert bench.run("goto", "home", "--grip", "wide").exit_code == 2
    assert bench.run("goto", "home", "--grip", "130").exit_code == 2


def test_line_rounds_the_corners_and_keeps_the_tools_direction(bench: Any) -> None:
    bench.ok("goto", "0", "200", "160", "--down")
    out = bench.ok("line", "40", "200", "160", "40", "200", "120", "--speed", "60")
    assert out.startswith("line to 40 200 160 mm, 40 200 120 mm: ")
    assert tip(bench) == pytest.approx([40, 200, 120], abs=1.0)
    assert tool(bench) == pytest.approx([0, 0, -1], abs=0.02)
    words = ("line", "0", "200", "120", "0", "200", "160", "--dry-run")
    round_, sharp = (bench.json(*words, *more)["legs"][0]["duration_s"] for more in ((), ("--round", "0")))
    assert round_ < sharp - 0.1


def test_line_to_a_pose(bench: Any, poses: PoseFile) -> None:
    poses.save("near", {"J1": HOME["J1"] + 0.1, "J2": HOME["J2"] + 0.1})
    assert bench.ok("line", "near").startswith("line to near: ")
    assert bench.positions()["J1"] == pytest.approx(math.degrees(HOME["J1"] + 0.1), abs=0.5)


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (("goto", "nod", "nad"), "'nad' is neither a number nor a pose of hex7bot; there are home, nod"),
        (("goto", "0", "220", "200", "0", "900", "0"), "point 2: out of reach"),
        (("goto", *("0", "220", "200", "0", "221", "200") * 60), "121 points are too many for one motion"),
        (("line", "10", "0", "0", "0", "0", "-300", "--relative"), "of the line: "),
        (("goto", "nod", "0", "200", "40", "--down", "--table", "50"), "below the table at 50 mm"),
        (("line", "0", "220", "200", "--round", "-1"), "-1 is less than 0"),
    ],
)
def test_what_cannot_be_done_is_refused_before_anything_moves(
    bench: Any, poses: PoseFile, words: tuple[str, ...], error: str
) -> None:
    before = bench.positions()
    result = bench.run(*words)
    assert result.exit_code == 2
    assert error in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert bench.positions() == before


def test_play_passes_waypoints_as_fast_as_it_may(bench: Any, tmp_path: Path) -> None:
    rows = [[HOME["J1"] + 0.1 * i, 0.05 * i] for i in range(8)]
    data = {"joint_names": ["J1", "J4"], "points": [{"positions": row} for row in rows]}
    file = tmp_path / "w.json"
    file.write_text(json.dumps(data), encoding="utf-8")
    fast = bench.json("play", str(file), "--fastest", "--dry-run")["legs"][-1]
    # Full speed is 2.6 rad/s; it is reached in less than half a second.
    assert fast["duration_s"] < 0.7 / 2.6 + 0.8
    slow = bench.json("play", str(file), "--fastest", "--speed", "0.1")["legs"][-1]
    assert slow["duration_s"] == pytest.approx(0.7 / 0.26, rel=0.1)
    assert bench.positions()["J1"] == pytest.approx(math.degrees(HOME["J1"] + 0.7), abs=0.3)
    result = bench.run("play", str(file))
    assert (result.exit_code, "time_from_start" in result.stderr) == (2, True)
    result = bench.run("play", str(tmp_path / "a.mcap"), "--fastest")
    assert (result.exit_code, "--fastest is for waypoints" in result.stderr) == (2, True)
    data["points"][3]["positions"] = [0.1]
    file.write_text(json.dumps(data), encoding="utf-8")
    result = bench.run("play", str(file), "--fastest")
    assert (result.exit_code, "1 values for 2 joints" in result.stderr) == (2, True)


# -- home: the chapter's position_init, but only when it is asked for ------------------------------------


HOMEWARD = [("goto", "home"), ("move", "home", "--wait")]
"""All robots, both dialects, a servo bus, a controller go to the middle of every joint but the gripper."""


@pytest.mark.parametrize("dialect", [1, 2])
def test_a_hex7bot_has_a_home_and_goes_there_when_asked(make_bench: Any, poses: PoseFile, dialect: int) -> None:
    for words in HOMEWARD:
        bench = make_bench(dialect=dialect)
        result = bench.run(*words)
        assert (result.exit_code, "arrived" in result.stdout) == (0, True), (words, result.output)
        there = {name: math.radians(angle) for name, angle in bench.positions().items()}
        assert {name: there[name] for name in HOME} == pytest.approx(HOME, abs=0.03), words


@pytest.mark.parametrize("robot", ["so100", "so101"])
def test_an_so_arm_has_a_home_and_goes_there_when_asked(
    so_bench: Callable[..., Result], poses: PoseFile, robot: str
) -> None:
    arm = ("--robot", robot)
    for words in HOMEWARD:
        assert so_bench("move", "shoulder_pan=20", "--wait", *arm).exit_code == 0
        result = so_bench(*words, *arm)
        assert (result.exit_code, "arrived" in result.stdout) == (0, True), (words, result.output)
        (pan, *_) = json.loads(so_bench("state", "--json", *arm).stdout)["joints"]
        assert pan["position_deg"] == pytest.approx(0.0, abs=1.5), words


@pytest.mark.slow
@pytest.mark.system
def test_a_puma_has_a_home_and_goes_there_when_asked(poses: PoseFile) -> None:
    with served_puma() as puma:
        for words in HOMEWARD:
            result = CliRunner().invoke(cli, [*words, "--port", puma.tcp, "--robot", "puma260"])
            assert (result.exit_code, "arrived" in result.stdout) == (0, True), (words, result.output)


def test_home_is_the_same_pose_in_every_front() -> None:
    """The commands', and those of the parameter files of ROS and of an arm's package."""
    import yaml

    folder = Path(hexwire.__file__).parent / "ros1" / "share" / "hexwire" / "config"
    for robot in ("hex7bot", "puma260", "so100", "so101"):
        url = "tcp://127.0.0.1:1" if robot == "puma260" else "/dev/ttyTEST"
        model = make_driver(url, robot).model
        home = home_pose(model)
        assert set(model.names) - set(home) <= {"J7", "gripper"}, robot
        for joint, angle in home.items():
            model.joint(joint).check(angle)
        given = yaml.safe_load((folder / f"{robot}.yaml").read_text())["poses"]["home"]
        assert home == pytest.approx(given, abs=1e-3), robot


def test_home_is_checked_as_any_motion(bench: Any, poses: PoseFile) -> None:
    bench.ok("stop")
    for words in (("goto", "home"), ("move", "home"), ("move", "home", "J7=300"), ("move", "home", "J1=1")):
        result = bench.run(*words)
        assert result.exit_code == (2 if len(words) > 2 else 1), words
        assert result.stderr.startswith("error: "), words
        assert len(words) > 2 or "stopped" in result.stderr, words


def test_a_saved_home_is_the_users(bench: Any, poses: PoseFile) -> None:
    poses.save("home", {"J1": HOME["J1"] + 0.2})
    assert "J1 6.4" in bench.ok("move", "home")
