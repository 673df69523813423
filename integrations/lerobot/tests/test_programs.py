"""LeRobot's programs with emulated arms of hexwire."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from emulated import CALIBRATION, bus, calibrated
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from hexwire.drivers.bus_arm import So101Arm
from hexwire.emulator.hand import HandOrder
from hexwire.emulator.serve_hand import move_by_hand
from hexwire.setup.hand_calibration import HandCalibration

Program = Callable[..., None]


def pair(follower: str, leader: str) -> tuple[str, ...]:
    return (
        "--robot.type=hexwire_so101",
        f"--robot.port={follower}",
        "--robot.id=black",
        "--robot.disable_torque_on_disconnect=false",
        "--teleop.type=hexwire_so101_leader",
        f"--teleop.port={leader}",
        "--teleop.id=blue",
    )


def angle(port: str, joint: str, file: str = "robots/so_follower/black.json") -> float:
    """Where a joint is, LeRobot's degrees."""
    row = json.loads((CALIBRATION / file).read_text())[joint]
    with So101Arm.from_url(port) as arm:
        counts = arm.bus.read(row["id"], "present_position").check().raw
    assert counts is not None
    return (counts - (row["range_min"] + row["range_max"]) / 2) * 360 / 4095


def test_teleoperate(program: Program, follower: str, leader: str) -> None:
    move_by_hand(leader, HandOrder("shoulder_pan", 25.0, 0.5))
    program("lerobot_teleoperate", *pair(follower, leader), "--teleop_time_s=4")
    led = angle(leader, "shoulder_pan", "teleoperators/so_leader/blue.json")
    assert led == pytest.approx(25.0, abs=3.0)
    assert angle(follower, "shoulder_pan") == pytest.approx(led, abs=3.0)


def test_record_then_replay(program: Program, follower: str, leader: str, tmp_path: Path) -> None:
    move_by_hand(leader, HandOrder("shoulder_pan", -15.0, 0.4))
    data = ("--dataset.repo_id=hexwire/test", f"--dataset.root={tmp_path / 'data'}")
    program(
        "lerobot_record",
        *pair(follower, leader),
        *data,
        "--dataset.single_task=wave",
        "--dataset.num_episodes=1",
        "--dataset.episode_time_s=3",
        "--dataset.reset_time_s=0",
        "--dataset.fps=15",
        "--dataset.push_to_hub=false",
        "--play_sounds=false",
    )
    dataset = LeRobotDataset("hexwire/test", root=tmp_path / "data")
    assert dataset.meta.robot_type == "so_follower"
    names = [f"{joint}.pos" for joint in So101Arm.described().model.names]
    assert dataset.features["action"]["names"] == names
    assert dataset.features["observation.state"]["names"] == names
    assert len(dataset) > 10
    last = dataset[len(dataset) - 1]
    assert float(last["action"][0]) == pytest.approx(-15.0, abs=3.0)
    with So101Arm.from_url(follower) as arm:
        arm.torque(False)
    move_by_hand(follower, HandOrder("shoulder_pan", 30.0, 0.5))
    program("lerobot_replay", *pair(follower, leader)[:4], *data, "--dataset.episode=0", "--play_sounds=false")
    assert angle(follower, "shoulder_pan") == pytest.approx(-15.0, abs=4.0)


def test_find_joint_limits(
    program: Program, follower: str, leader: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    urdf = tmp_path / "so101.urdf"
    subprocess.run(
        [sys.executable, "-m", "hexwire.cli", "model", "urdf", "--robot", "so101", "-o", str(urdf)], check=True
    )
    program(
        "lerobot_find_joint_limits",
        *pair(follower, leader),
        f"--urdf_path={urdf}",
        "--target_frame_name=tool",
        "--warmup_time_s=0.5",
        "--teleop_time_s=1.5",
    )
    said = capsys.readouterr().out
    assert "FINAL RESULTS" in said
    assert "max_ee = [" in said


def test_a_program_that_does_not_look_for_plug_ins_is_run_through_the_package() -> None:
    command = [sys.executable, "-m", "lerobot_robot_hexwire"]
    assert (
        "lerobot-find-joint-limits" in subprocess.run(command, capture_output=True, text=True, check=False).stderr
    )
    found = subprocess.run(
        [*command, "lerobot-find-joint-limits", "--help"], capture_output=True, text=True, check=True
    )
    assert "hexwire_so101_leader" in found.stdout


def test_calibrate_with_the_console_script_finds_the_plug_in_and_stores_a_file() -> None:
    with bus("--baud", "0") as port:
        file = calibrated(port, "green")
        with So101Arm.from_url(port) as arm:
            from hexwire.bus.setup import write_setting

            write_setting(arm.bus, 2, "position_offset", 99)
        words = ("--robot.type=hexwire_so101", f"--robot.port={port}", "--robot.id=green")
        script = Path(sys.executable).with_name("lerobot-calibrate")
        command = [str(script)] if script.exists() else [sys.executable, "-m", "lerobot.scripts.lerobot_calibrate"]
        done = subprocess.run([*command, *words], input="\n", capture_output=True, text=True, check=True)
        assert "Stored in the servos of shoulder_lift" in done.stdout
        with So101Arm.from_url(port) as arm:
            row = json.loads(file.read_text())["shoulder_lift"]
            assert arm.bus.read(2, "position_offset").raw == row["homing_offset"]


def test_calibrate_without_a_console_ends_with_an_error(program: Program, monkeypatch: pytest.MonkeyPatch) -> None:
    def ended(text: str = "") -> str:
        raise EOFError

    monkeypatch.setattr("builtins.input", ended)
    with bus("--baud", "0") as port, pytest.raises(RuntimeError, match="the input has ended; nothing was saved"):
        program("lerobot_calibrate", "--robot.type=hexwire_so101", f"--robot.port={port}", "--robot.id=nobody")


def test_calibrate_by_hand(program: Program, monkeypatch: pytest.MonkeyPatch) -> None:
    with bus("--leader", "--baud", "0") as port:
        file = CALIBRATION / "teleoperators" / "so_leader" / "new.json"
        asked: list[str] = []
        monkeypatch.setattr("builtins.input", lambda text="": asked.append(text) or "")
        seen: list[HandCalibration] = []
        made = HandCalibration.__init__

        def remember(hand: HandCalibration, *args: object, **named: object) -> None:
            made(hand, *args, **named)
            seen.append(hand)

        monkeypatch.setattr(HandCalibration, "__init__", remember)
        ways = [(joint, sign * 400.0) for joint in So101Arm.described().model.names for sign in (1, -1)]

        def entered(seconds: float) -> bool:
            # A hand moves one joint to one stop at a time, while the program samples.
            if ways and not moving.poll_busy():
                moving.start(*ways.pop(0))
            return not ways and not moving.poll_busy()

        class Moving:
            def __init__(self) -> None:
                self.process: subprocess.Popen[bytes] | None = None

            def poll_busy(self) -> bool:
                return self.process is not None and self.process.poll() is None

            def start(self, joint: str, degrees: float) -> None:
                if joint != "wrist_roll":
                    words = ["sim", "hand", joint, f"{degrees:+g}", "--duration", "1.5", "--port", port]
                    self.process = subprocess.Popen(
                        [sys.executable, "-m", "hexwire.cli", *words], stdout=subprocess.DEVNULL
                    )

        moving = Moving()
        monkeypatch.setattr("lerobot_robot_hexwire.calibrating._entered", entered)
        words = ("--teleop.type=hexwire_so101_leader", f"--teleop.port={port}", "--teleop.id=new")
        program("lerobot_calibrate", *words)
        assert len(asked) == 2
        assert not seen[0].missing
        rows = json.loads(file.read_text())
        assert rows["wrist_roll"]["range_max"] == 4095
        # From stop to stop, as the arm was assembled.
        assert rows["elbow_flex"]["range_max"] - rows["elbow_flex"]["range_min"] == pytest.approx(
            203.6 * 4096 / 360, abs=25
        )
        time.sleep(0.1)
        with So101Arm.from_url(port) as arm:
            for name, row in rows.items():
                got = arm.bus.read(row["id"], "position_offset").raw
                assert (name, got) == (name, row["homing_offset"])
