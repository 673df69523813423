"""docs/so101.md: its commands are run one after the other on an emulated arm, in simulated time."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
from click.testing import CliRunner
from tests.cli.test_bus_arm_setup import Person
from tests.cli.test_bus_calibrate import CalibrateCli
from tests.control.so_bench import NAMES

from hexwire.cli.main import cli
from hexwire.drivers.arm_file import load_arm_file, load_calibration
from hexwire.link.ports import PortInfo

TEXT = (Path(__file__).resolve().parent.parent / "docs" / "so101.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```console\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)
COMMANDS = [line.removeprefix("$ ") for block in BLOCKS for line in block.splitlines()]
ARM_FILE = re.findall(r"^```toml\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)


def test_the_page_from_the_box_to_a_calibrated_arm(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert len(COMMANDS) == 8
    assert len(ARM_FILE) == 1
    arm = CalibrateCli(monkeypatch)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HEXWIRE_PORT", "/dev/ttyTEST")
    (tmp_path / "left.toml").write_text(ARM_FILE[0])
    servos, wire = list(arm.parts.arm.servos), arm.parts.device.wire

    def unplugging() -> None:
        one, two = PortInfo("/dev/ttyACM0"), PortInfo("/dev/ttyTEST", guess="an adapter")
        looks = [[one, two], [one], [one, two], [one, two]]
        now = [0.0]
        monkeypatch.setattr("hexwire.link.ports.list_ports", lambda: looks.pop(0) if len(looks) > 1 else looks[0])
        clock = SimpleNamespace(monotonic=lambda: now[0], sleep=lambda s: now.__setitem__(0, now[0] + s))
        monkeypatch.setattr("hexwire.cli.look.time", clock)

    def new_servos() -> None:
        acts: list[Callable[[], object] | str] = []
        wire.servos[:] = []
        for count in range(1, 7):
            acts.append(lambda count=count: wire.servos.__setitem__(slice(None), servos[-count:]))  # type: ignore[misc]
            if count < 6:
                acts.append("y")
        for servo in servos:
            servo.registers.put_stored("id", 1)
        monkeypatch.setattr("hexwire.cli.bus_arm_setup.sys", SimpleNamespace(stdin=Person(*acts)))

    prepare = {"hexwire ports --find": unplugging, "hexwire bus setup so101 --follower": new_servos}
    said = {}
    for command in COMMANDS:
        prepare.get(command, lambda: None)()
        words = shlex.split(command)
        assert words[0] == "hexwire"
        # Its questions: hold the arm, the middle of wrist_roll, and whether it may move.
        result = CliRunner().invoke(cli, words[1:], input="y\n\n\n")
        assert result.exit_code == 0, f"{command}: {result.output}"
        said[command] = result.stdout
    assert "/dev/ttyTEST" in said["hexwire ports --find"]
    assert [servo.servo_id for servo in servos] == [1, 2, 3, 4, 5, 6]
    assert "BAD" not in said["hexwire bus health 1-6"]
    assert list(json.loads((tmp_path / "left.json").read_text())) == list(NAMES)
    assert load_calibration(tmp_path / "left-cal.toml").joints == load_calibration(tmp_path / "left.json").joints
    assert load_arm_file(tmp_path / "left.toml").calibration is not None
    # It was put down folded, and its angles say so.
    assert re.search(r"shoulder_lift +-9[123]\.\d", said["hexwire state --robot left.toml"])
    assert "offset" not in said["hexwire probe --robot left.toml"]


def test_every_step_of_lerobot_has_its_command() -> None:
    for theirs in ("lerobot-find-port", "lerobot-setup-motors", "lerobot-calibrate"):
        assert re.search(rf"\| `{theirs}` \| `hexwire ", TEXT)
