from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result
from tests.motion.arms import HOME, state
from tests.recorded import make_positions

from hexwire.drivers.arm_file import load_profile
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.model.arms.so_arm.kinematics import SoArmModel
from hexwire.model.arms.so_arm.links import SO_ARMS
from hexwire.model.calibration import Calibration, JointCalibration
from hexwire.model.state import JointFlag, JointState
from hexwire.trace.recording import RecordingWriter, read_joint_states

A = Hex7BotModel()


def tip(bench: Any) -> list[float]:
    """Where the tip is by the board's own joint angles, millimetres."""
    angles = A.from_joints({name: math.radians(deg) for name, deg in bench.positions().items()})
    return [1e3 * v for v in A.forward(angles).position]


def tool(bench: Any) -> list[float]:
    """Direction of the tool."""
    angles = A.from_joints({name: math.radians(deg) for name, deg in bench.positions().items()})
    return [row[2] for row in A.forward(angles).rotation]


def test_a_speed_and_a_rounding_beyond_any_arm_are_as_fast_and_round_as_it_can(bench: Any) -> None:
    bench.ok("goto", "0", "220", "200")

    def duration(most: str) -> float:
        words = ("line", "0", "220", "190", "0", "220", "180", "--dry-run", "--json")
        result = bench.run(*words, "--speed", most, "--round", most)
        assert result.exit_code == 0, result.output
        assert re.fullmatch(
            r"note: this takes .* as long as planned, since J3 cannot follow faster\n", result.stderr
        )
        return float(json.loads(result.stdout)["legs"][0]["duration_s"])

    assert duration("90000") == pytest.approx(duration("3000"))


def test_goto_takes_the_tip_there(bench: Any) -> None:
    out = bench.ok("goto", "0", "220", "200")
    assert out.startswith("goto 0 220 200 mm: ")
    assert out.endswith("arrived\n")
    assert tip(bench) == pytest.approx([0, 220, 200], abs=1.0)


@pytest.mark.parametrize(
    "words", [("goto", "0", "220", "200"), ("line", "0", "10", "0", "--relative", "--dry-run")]
)
def test_a_missed_answer_before_a_motion_is_asked_for_again(
    bench: Any, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    """As of an arm behind a computer that was busy for a moment."""
    read, left = Hex7BotDriver.read, 3

    def missed(robot: Hex7BotDriver) -> JointState:
        nonlocal left
        found, left = read(robot), left - 1
        silent = (int(JointFlag.SILENT),) * 7
        return found if left < 0 else replace(found, flags=silent, position=(math.nan,) * 7)

    monkeypatch.setattr(Hex7BotDriver, "read", missed)
    bench.ok(*words)
    assert left < 0


def test_goto_negative_and_down(bench: Any) -> None:
    bench.ok("goto", "-60", "180", "100", "--down")
    assert tip(bench) == pytest.approx([-60, 180, 100], abs=1.0)
    assert tool(bench) == pytest.approx([0, 0, -1], abs=0.02)


def test_goto_relative(bench: Any) -> None:
    bench.ok("goto", "0", "220", "200")
    bench.ok("goto", "--relative", "20", "0", "-30")
    assert tip(bench) == pytest.approx([20, 220, 170], abs=1.5)


def test_line_keeps_to_the_line_and_the_tools_direction(bench: Any) -> None:
    bench.ok("goto", "0", "200", "180", "--down")
    bench.ok("line", "60", "200", "100", "--speed", "60")
    assert tip(bench) == pytest.approx([60, 200, 100], abs=1.0)
    assert tool(bench) == pytest.approx([0, 0, -1], abs=0.02)


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (("goto", "0", "600", "100"), "out of reach: the wrist would be"),
        (("line", "0", "0", "-300", "--relative"), "of the line: "),
        (("goto", "0", "200", "40", "--down", "--table", "50"), "below the table at 50 mm; nothing was sent"),
        (("goto", "0", "200", "100", "--down", "--rpy", "0", "0", "0"), "--down and --rpy contradict each other"),
        (("goto", "0", "200"), "takes 3 values"),
        (("goto", "0", "220", "200", "--plot", "a.txt"), "must end in .png, .svg, .pdf"),
        (("goto", "0", "220", "200", "--links", "Z"), "no link set 'Z'"),
    ],
)
def test_an_impossible_motion_is_refused_before_anything_moves(
    bench: Any, words: tuple[str, ...], error: str
) -> None:
    before = bench.positions()
    result = bench.run(*words)
    assert result.exit_code == 2
    assert error in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert bench.positions() == before
    assert bench.torque() == []


def test_dry_run_moves_nothing(bench: Any) -> None:
    before = bench.positions()
    assert "arrived" not in bench.ok("goto", "0", "220", "200", "--dry-run")
    assert bench.positions() == before
    assert bench.torque() == []


def test_a_silent_servo_is_said_and_nothing_moves(make_bench: Any) -> None:
    bench = make_bench("silent:2")
    result = bench.run("goto", "0", "220", "200")
    assert result.exit_code == 1
    assert "the position of J3 is unknown" in result.stderr


def recording(path: Path, goal: float) -> None:
    with RecordingWriter(path) as writer:
        for i in range(41):
            share = 0.5 - 0.5 * math.cos(math.pi * i / 40)
            moved = {"J1": HOME["J1"] + goal * share}
            writer.joint_state(state(moved), 1700000000.0 + 0.05 * i)


def test_play_moves_to_the_start_and_follows_the_recording(bench: Any, tmp_path: Path) -> None:
    recording(tmp_path / "a.mcap", 0.4)
    out = bench.ok("play", str(tmp_path / "a.mcap"), "--speed", "2")
    assert "approach: " in out
    assert "play a.mcap: 1.00 s" in out
    expected = math.degrees(HOME["J1"] + 0.4)
    assert bench.positions()["J1"] == pytest.approx(expected, abs=0.5)


def test_a_recording_that_is_cut_off_is_not_played(bench: Any, tmp_path: Path) -> None:
    recording(tmp_path / "a.mcap", 0.4)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((tmp_path / "a.mcap").read_bytes()[:-300])
    before = bench.positions()
    result = bench.run("play", str(cut))
    assert result.exit_code == 2
    assert result.stderr.count("\n") == 1
    assert "cut.mcap: the recording is truncated" in result.stderr
    assert "hexwire record recover" in result.stderr
    assert bench.positions() == before


def test_play_a_part_twice(bench: Any, tmp_path: Path) -> None:
    recording(tmp_path / "a.mcap", 0.4)
    out = bench.ok("play", str(tmp_path / "a.mcap"), "--to", "1.0", "--smooth", "0.1", "--trim", "--repeat", "2")
    assert out.count("play a.mcap") == 2
    assert out.count("approach") == 2
    assert bench.positions()["J1"] == pytest.approx(math.degrees(HOME["J1"] + 0.2), abs=1.0)


def waypoints(path: Path, **change: Any) -> Path:
    here = [HOME["J1"], HOME["J4"]]
    data: dict[str, Any] = {
        "joint_names": ["J1", "J4"],
        "points": [
            {"time_from_start": 0, "positions": here, "velocities": [0, 0]},
            {"time_from_start": {"secs": 1, "nsecs": 500000000}, "positions": [0.3, 0.5], "velocities": [0, 0]},
        ],
    }
    path.write_text(json.dumps(data | change), encoding="utf-8")
    return path


def test_play_waypoints_as_ros_writes_them(bench: Any, tmp_path: Path) -> None:
    out = bench.ok("play", str(waypoints(tmp_path / "w.json")))
    assert "play w.json: 1.50 s" in out
    assert bench.positions()["J4"] == pytest.approx(math.degrees(0.5), abs=0.3)


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"joint_names": ["J1", "J9"]}, "moves J9; hex7bot has J1, J2"),
        ({"points": 7}, "points must be a list, not 7"),
        ({"points": []}, "a trajectory without a point"),
        ({"joint_names": ["J1"]}, "2 values for 1 joints"),
    ],
)
def test_waypoints_with_a_mistake_are_refused(
    bench: Any, tmp_path: Path, change: dict[str, Any], error: str
) -> None:
    result = bench.run("play", str(waypoints(tmp_path / "w.json", **change)))
    assert result.exit_code == 2
    assert error in result.stderr


PROGRAM = """
[[steps]]
pose = "home"
[[steps]]
grip = 100
[[steps]]
repeat = 2
[[steps.steps]]
joints = { J1 = 10 }
speed = 1
[[steps.steps]]
joints = { J1 = 5 }
speed = 1
"""


def test_a_step_of_a_program_that_is_stopped_has_not_arrived(
    bench: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "a.toml"
    file.write_text("[[steps]]\njoints = { J1 = 10 }\n[[steps]]\njoints = { J1 = -20 }\n")
    step = bench.board.step

    def stopped(now: float) -> None:
        step(now)
        # On the way back.
        if bench.board.wire[0].motion.velocity * HEX7BOT.joints[0].sign < 0.0:
            bench.board.state.stopped = True

    monkeypatch.setattr(bench.board, "step", stopped)
    result = bench.run("play", str(file), "--json")
    assert result.exit_code == 1
    told = json.loads(result.stdout)
    assert told["arrived"] is False
    assert [(row["step"], row["arrived"]) for row in told["steps"]] == [("1", True), ("2", False)]


def test_play_runs_a_program(bench: Any, tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    file.write_text(PROGRAM)
    before = bench.positions()
    planned = bench.ok("play", str(file), "--dry-run").splitlines()
    # What is repeated is said once from each place where it begins.
    assert [line.partition(":")[0] for line in planned] == ["step 1", "step 3.1", "step 3.2", "step 3.1"]
    assert bench.positions() == before
    done = bench.ok("play", str(file)).splitlines()
    ends = [line for line in done if "arrived" in line or "gripper" in line]
    assert [line.partition(":")[0] for line in ends] == ["step 1", "step 2", *("step 3.1", "step 3.2") * 2]
    assert bench.positions()["J1"] == pytest.approx(5, abs=1)
    rows = json.loads(bench.ok("play", str(file), "--json", "--step", "3"))
    assert rows["arrived"] is True
    assert [(row["step"], row["arrived"]) for row in rows["steps"]] == [("3.1", True), ("3.2", True)] * 2
    file.write_text(PROGRAM + "[[steps]]\nask = 'go on?'\n")
    for words, said in (
        ((), "waits for a person: run it in a terminal"),
        (("--speed", "2"), "--speed is for motions"),
        (("--from", "2"), "--from is for motions"),
        (("--step", "9", "--dry-run"), "there is no step 9: the program has 4"),
    ):
        result = bench.run("play", str(file), *words)
        assert result.exit_code == 2, result.output
        assert said in result.stderr
    assert bench.run("play", str(tmp_path / "a.mcap"), "--step", "2").exit_code == 2


def test_play_too_fast_is_refused(bench: Any, tmp_path: Path) -> None:
    recording(tmp_path / "a.mcap", 0.4)
    result = bench.run("play", str(tmp_path / "a.mcap"), "--speed", "20")
    assert result.exit_code == 2
    assert "J1 would turn at" in result.stderr
    offered = re.search(r"it keeps the limits at ([\d.]+) of its speed: --speed ([\d.]+), or --fit", result.stderr)
    assert offered is not None
    assert offered[1] == offered[2]
    dry = ("play", str(tmp_path / "a.mcap"), "--dry-run")
    slower = bench.ok(*dry, "--speed", offered[1])
    above = bench.run(*dry, "--speed", str(round(float(offered[1]) + 0.001, 3)))
    assert (above.exit_code, "--fit" in above.stderr) == (2, True)
    fit = bench.run(*dry, "--speed", "20", "--fit")
    assert (fit.exit_code, fit.stdout) == (0, slower)
    assert f"played at {offered[1]} of its speed" in fit.stderr
    # What is not too fast stays as it is.
    assert bench.ok(*dry, "--fit") == bench.ok(*dry)
    assert bench.torque() == []


def test_save_what_was_edited_without_a_robot(bench: Any, tmp_path: Path) -> None:
    recording(tmp_path / "a.mcap", 0.4)
    words = ["play", str(tmp_path / "a.mcap"), "--from", "0.5", "--to", "1.5", "--speed", "2"]
    out = bench.run(*words, "--save", str(tmp_path / "b.mcap"), port=None)
    assert out.exit_code == 0, out.stderr
    assert "21 states, 0.50 s" in out.stdout
    rows = list(read_joint_states(tmp_path / "b.mcap"))
    assert rows[-1].time - rows[0].time == pytest.approx(0.5, abs=1e-3)
    assert rows[10].position[0] == pytest.approx(HOME["J1"] + 0.2, abs=1e-6)
    assert bench.urls == []
    again = bench.run(*words, "--save", str(tmp_path / "a.mcap"), port=None)
    assert again.exit_code == 2
    assert "would overwrite" in again.stderr


def test_teach_and_play_back(bench: Any, tmp_path: Path) -> None:
    file = tmp_path / "t.mcap"
    out = bench.run("teach", str(file), "--duration", "1", "--yes")
    assert out.exit_code == 0
    assert "20 states in" in out.stdout
    assert "the arm holds" in out.stdout
    rows = list(read_joint_states(file))
    assert len(rows) == 20
    assert rows[0].names == HEX7BOT.names
    assert bench.torque() == list(HEX7BOT.names)
    assert "arrived" in bench.ok("play", str(file))


def test_teach_leaves_the_torque_off_if_asked(bench: Any, tmp_path: Path) -> None:
    bench.run("torque", "on")
    result = bench.run("teach", str(tmp_path / "t.mcap"), "--duration", "0.2", "--yes", "--limp", "--rate", "10")
    assert "2 states" in result.stdout
    assert bench.torque() == []


def test_teach_asks_for_somebody_to_hold_the_arm(bench: Any, tmp_path: Path) -> None:
    result = bench.run("teach", str(tmp_path / "t.mcap"))
    assert result.exit_code == 2
    assert "hold it, and confirm with --yes" in result.stderr
    assert not (tmp_path / "t.mcap").exists()
    assert bench.run("teach", str(tmp_path / "t.txt"), "--yes").exit_code == 2


def test_dialect_1_moves_slowly_but_arrives(make_bench: Any) -> None:
    bench = make_bench(dialect=1)
    out = bench.run("goto", "0", "220", "200", "--speed", "20")
    assert out.exit_code == 0, out.stderr
    assert tip(bench) == pytest.approx([0, 220, 200], abs=1.5)


def test_a_rate_that_no_loop_keeps_is_refused_and_does_not_stop_the_arm(bench: Any) -> None:
    result = bench.run("goto", "0", "220", "200", "--rate", "1e9")
    assert (result.exit_code, result.stdout) == (2, "")
    assert "a rate of 1e+09 Hz is not possible" in result.stderr
    state = bench.board.state
    assert (state.stopped, state.watchdog_timeout) == (False, 0.0)


def test_a_rate_that_makes_no_sense_leaves_the_torque_on(bench: Any, tmp_path: Path) -> None:
    bench.ok("torque", "on")
    result = bench.run("teach", str(tmp_path / "a.mcap"), "--rate", "1e300", "--yes", "--duration", "1")
    assert result.exit_code == 2
    assert "a rate of 1e+300 Hz is not possible" in result.stderr
    assert all(joint["torque_on"] for joint in bench.json("state")["joints"])


def test_a_speed_that_leaves_no_time_is_refused(bench: Any, tmp_path: Path) -> None:
    for speed, words in (("1e300", "would turn at"), ("1e-300", "too long for a motion")):
        result = bench.run("play", str(waypoints(tmp_path / "w.json")), "--speed", speed)
        assert result.exit_code == 2
        assert words in result.stderr


# -- five joints on a servo bus ---------------------------------------------------------------------------


class EmulatedArm:
    """An emulated SO-100 or SO-101, and what its kinematics say of it."""

    def __init__(self, run: Callable[..., Result], robot: str) -> None:
        self._run, self.robot = run, robot
        name = robot if robot in SO_ARMS else "so101"
        self.model = SoArmModel(SO_ARMS[name])

    def run(self, *words: str) -> Result:
        return self._run(*words, "--robot", self.robot)

    def ok(self, *words: str) -> str:
        result = self.run(*words)
        assert result.exit_code == 0, result.output
        return result.stdout

    def state(self) -> dict[str, Any]:
        data: dict[str, Any] = json.loads(self.ok("state", "--json"))
        return data

    def angles(self) -> tuple[float, ...]:
        return self.model.from_joints(
            {joint["name"]: math.radians(joint["position_deg"]) for joint in self.state()["joints"]}
        )

    def tip(self) -> list[float]:
        return [1e3 * v for v in self.model.forward(self.angles()).position]

    def pitch(self) -> float:
        return math.degrees(self.model.pitch(self.angles()))


@pytest.fixture(params=["so101", pytest.param("so100", marks=pytest.mark.slow), "left.toml"])
def so_arm(request: pytest.FixtureRequest, so_bench: Callable[..., Result], tmp_path: Path) -> EmulatedArm:
    if request.param != "left.toml":
        return EmulatedArm(so_bench, request.param)
    # An arm with a calibration of its own; its wrist_roll goes no further than 60 degrees.
    ends = [*[(1000, 3000)] * 4, (1365, 2731), (1900, 3200)]
    joints = tuple(
        JointCalibration(joint.name, joint.servo_id, 2048, *end)
        for joint, end in zip(load_profile("so101").model.joints, ends, strict=True)
    )
    (tmp_path / "cal.toml").write_text(Calibration("so101", "", joints).serialize(), encoding="utf-8")
    file = tmp_path / "left.toml"
    file.write_text('name = "left"\nbase = "so101"\ncalibration = "cal.toml"\n', encoding="utf-8")
    return EmulatedArm(so_bench, str(file))


def test_five_joints_go_to_a_position_and_a_pitch_and_follow_a_line(so_arm: EmulatedArm) -> None:
    out = so_arm.ok("goto", "240", "60", "80", "--pitch", "70", "--roll", "30")
    assert out.startswith("goto 240 60 80 mm: ")
    assert out.endswith("arrived\n")
    assert so_arm.tip() == pytest.approx([240, 60, 80], abs=1.0)
    assert so_arm.pitch() == pytest.approx(70, abs=0.5)
    assert math.degrees(so_arm.angles()[4]) == pytest.approx(30, abs=0.5)
    so_arm.ok("goto", "240", "60", "80", "--pitch", "60")
    assert so_arm.pitch() == pytest.approx(60, abs=0.5)
    assert math.degrees(so_arm.angles()[4]) == pytest.approx(30, abs=0.5)
    so_arm.ok("goto", "240", "60", "80", "--pitch", "70")
    so_arm.ok("line", "--relative", "0", "-100", "0", "--speed", "80")
    assert so_arm.tip() == pytest.approx([240, -40, 80], abs=1.5)
    assert so_arm.pitch() == pytest.approx(70, abs=0.7)
    so_arm.ok("goto", "230", "0", "40", "--down")
    assert so_arm.tip() == pytest.approx([230, 0, 40], abs=1.0)
    assert so_arm.pitch() == pytest.approx(90, abs=0.5)


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (("goto", "600", "0", "100"), "out of reach: the wrist would be"),
        (("goto", "240", "0", "80", "--pitch", "-70"), "no joint angles within limits; nearest is front, elbow"),
        (("goto", "240", "0", "80", "--rpy", "0", "0", "0"), "five joints, and the heading of its tool follows"),
        (("goto", "240", "0", "80", "--roll", "10"), "--roll needs --pitch"),
        (("goto", "240", "0", "80", "--down", "--pitch", "10"), "--down and --pitch contradict each other"),
        (("line", "0", "0", "-400", "--relative"), "of the line: "),
        (("goto", "240", "0", "40", "--down", "--table", "50"), "below the table at 50 mm; nothing was sent"),
        (("move", "shoulder_lift=95", "elbow_flex=5", "--wait"), "below the table at 0 mm"),
    ],
)
def test_what_five_joints_cannot_do_is_refused_before_anything_moves(
    so_bench: Callable[..., Result], words: tuple[str, ...], error: str
) -> None:
    arm = EmulatedArm(so_bench, "so101")
    before = arm.angles()
    result = arm.run(*words)
    assert (result.exit_code, result.stdout) == (2, "")
    # The servos of the emulated arm are new.
    (line,) = [line for line in result.stderr.splitlines() if not line.startswith("note: not calibrated")]
    assert error in line
    assert arm.angles() == before
    assert not any(joint["torque_on"] for joint in arm.state()["joints"])


def test_limits_of_the_calibration_choose_the_branch(so_arm: EmulatedArm) -> None:
    result = so_arm.run("goto", "240", "0", "80", "--pitch", "70", "--roll", "75")
    if so_arm.robot in SO_ARMS:
        assert result.exit_code == 0, result.output
    else:
        assert result.exit_code == 2
        assert "wrist_roll=75 deg is 15 deg above its limits -60.03 to 60.03 deg" in result.stderr


def test_an_arm_that_rests_on_a_stop_moves_and_plays_what_it_was_taught_there(
    so_bench: Callable[..., Result], tmp_path: Path
) -> None:
    # The base rests 7 counts outside its limit, as a calibration leaves it that ends just before the stop.
    joints = tuple(
        JointCalibration(
            joint.name, joint.servo_id, *((2100, 2055) if joint.name == "shoulder_pan" else (2048, 1000)), 3200
        )
        for joint in load_profile("so101").model.joints
    )
    (tmp_path / "cal.toml").write_text(Calibration("so101", "", joints).serialize(), encoding="utf-8")
    file = tmp_path / "left.toml"
    file.write_text('name = "left"\nbase = "so101"\ncalibration = "cal.toml"\n', encoding="utf-8")
    arm = EmulatedArm(so_bench, str(file))
    names, rest = load_profile("so101").model.names, math.radians((2048 - 2100) * 360 / 4096)
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        for i in range(41):
            share = 0.5 - 0.5 * math.cos(math.pi * i / 40)
            pan = rest + (0.3 - rest) * share
            writer.joint_state(make_positions(names, (pan, 0.0, 0.0, 0.0, 0.0, 0.0)), 1.7e9 + i / 20)
    assert arm.angles()[0] == pytest.approx(rest, abs=0.005)
    result = arm.run("play", str(tmp_path / "a.mcap"))
    assert result.exit_code == 0, result.output
    assert "a joint that rested on its stop goes to its limit instead" in result.stderr
    assert arm.angles()[0] == pytest.approx(0.3, abs=0.01)
    arm.ok("move", "shoulder_pan=0.7", "--wait")
    arm.ok("goto", "240", "-60", "80", "--pitch", "70")
    assert arm.tip() == pytest.approx([240, -60, 80], abs=1.0)


def test_pitch_is_for_five_joints(bench: Any) -> None:
    result = bench.run("goto", "0", "220", "200", "--pitch", "90")
    assert result.exit_code == 2
    assert "hex7bot has six joints: give --rpy instead of --pitch" in result.stderr
