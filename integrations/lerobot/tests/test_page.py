"""docs/so101.md: each command that is not one of hexwire's is run, on emulated arms.

`make test` runs those of hexwire (tests/test_so101_page.py), and checks that there are no others.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from string import Template

import numpy as np
import pytest
from emulated import bus, calibrated, patiently, reach
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.robots.so_follower import SO101Follower, SO101FollowerConfig
from lerobot.teleoperators.so_leader import SO101Leader, SO101LeaderConfig

from hexwire.emulator.hand import HandOrder
from hexwire.emulator.serve_hand import move_by_hand

ROOT = Path(__file__).resolve().parents[3]
TEXT = (ROOT / "docs" / "so101.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\S*)\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)
LINES = [line for kind, block in BLOCKS if kind == "console" for line in block.replace("\\\n", "").splitlines()]
COMMANDS = [line.removeprefix("$ ") for line in LINES]
SERVE = next(command for command in COMMANDS if command.startswith("hexwire serve "))
NEW = not version("lerobot").startswith("0.4.")
"""A LeRobot that runs policies by a program of its own, and adds the date to names of datasets."""
SHORT = {
    "lerobot-teleoperate": ("--teleop_time_s=2",),
    "lerobot-record": (
        *("--dataset.num_episodes=1", "--dataset.episode_time_s=1", "--dataset.reset_time_s=0"),
        *("--dataset.fps=10", "--play_sounds=false", *(("--dataset.no_stamp=true",) if NEW else ())),
    ),
    "lerobot-rollout": ("--duration=2", "--device=cpu", "--play_sounds=false"),
    "lerobot-replay": ("--play_sounds=false",),
    "lerobot-train": (
        *("--steps=1", "--batch_size=1", "--num_workers=0", "--policy.device=cpu"),
        *("--policy.pretrained_backbone_weights=null", "--policy.dim_model=32", "--policy.n_heads=2"),
        *("--policy.dim_feedforward=32", "--policy.use_vae=false", "--dataset.video_backend=pyav"),
    ),
}
"""Added to a command, so that it ends soon and downloads nothing."""


class Camera:
    """What OpenCV opens: a camera whose picture changes."""

    def __init__(self, *where: object) -> None:
        self.values: dict[int, float] = {}

    def isOpened(self) -> bool:  # noqa: N802
        return True

    def set(self, what: int, value: float) -> bool:
        self.values[what] = value
        return True

    def get(self, what: int) -> float:
        return self.values.get(what, 0.0)

    def read(self) -> tuple[bool, np.ndarray]:
        time.sleep(1 / 30)
        return True, np.full((480, 640, 3), int(time.monotonic() * 100) % 255, np.uint8)

    def release(self) -> None:
        pass


class Owner:
    """Who types the commands of the page, and what is on the table."""

    def __init__(self, folder: Path, program: Callable[..., None], **ports: str) -> None:
        self.folder, self.program, self.variables = folder, program, dict(ports)

    def run(self, command: str) -> None:
        name = re.split("[ =]", command)[0]
        text = command.replace("~/.cache/huggingface/lerobot", os.environ["HF_LEROBOT_HOME"])
        if name in ("FOLLOWER", "LEADER"):
            return
        if name == "CALIBRATION":
            self.variables[name] = text.partition("=")[2]
            return
        words = shlex.split(Template(text).substitute(self.variables))
        if name in ("mkdir", "cp"):
            subprocess.run(words, cwd=self.folder, check=True)
        elif name == "pip":
            self.install(words[1:])
        else:
            # A command whose port is that of a shared arm needs the command that shares it.
            with self.serving() if "zenoh:" in command else self.nothing():
                self.program(name.replace("-", "_"), *words[1:], *SHORT.get(name, ()))

    def install(self, words: list[str]) -> None:
        """As pip does, but beside the packages of this environment, and without the internet."""
        uv = max((ROOT / ".tools").glob("uv-*/bin/uv"))
        target = self.folder / "packages"
        how = ("--quiet", "--no-deps", "--no-build-isolation", "--offline", "--python", sys.executable)
        subprocess.run([uv, "pip", *words, *how, "--target", target], cwd=ROOT, check=True)
        look = (
            "from importlib.metadata import metadata, requires;"
            "import hexwire.cli.main, lerobot_robot_hexwire as plug_in;"
            "extras = metadata('hexwire').get_all('Provides-Extra');"
            "needs = requires('lerobot_robot_hexwire');"
            "print(hexwire.__file__, plug_in.__file__, *needs, *extras, sep='\\n')"
        )
        found = subprocess.run(
            [sys.executable, "-c", look],
            env={**os.environ, "PYTHONPATH": str(target)},
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split("\n")
        assert [Path(place).is_relative_to(target) for place in found[:2]] == [True, True]
        # `hexwire --record` and `hexwire serve` need these extras.
        assert words[1] == ".[fleet,record]"
        assert {"hexwire", "lerobot>=0.4.4", "fleet", "record"} <= set(found[2:])

    @contextmanager
    def nothing(self) -> Iterator[None]:
        yield

    @contextmanager
    def serving(self) -> Iterator[None]:
        words = shlex.split(Template(SERVE).substitute(self.variables))[1:]
        # A machine that stalls loses a lease of half a second.
        command = [sys.executable, "-m", "hexwire.cli", *words, "--lease", "10"]
        with subprocess.Popen(command, cwd=self.folder, stdout=subprocess.PIPE, text=True) as server:
            try:
                assert server.stdout is not None
                assert server.stdout.readline()
                yield
            finally:
                server.terminate()
                server.communicate(timeout=30.0)


def test_the_page_from_calibrated_arms_to_a_policy(
    program: Callable[..., None], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("cv2.VideoCapture", Camera)
    asked: list[str] = []
    monkeypatch.setattr("builtins.input", lambda text="": asked.append(text) or "")
    for name, text in ((block.split('"')[1], block) for kind, block in BLOCKS if kind == "toml"):
        (tmp_path / f"{name}.toml").write_text(text)
    with bus("--baud", "0") as follower, bus("--leader", "--baud", "0") as leader:
        owner = Owner(tmp_path, program, FOLLOWER=follower, LEADER=leader)
        # What the steps before have found and stored; LeRobot has no file yet.
        for name, port, led in (("follower", follower, False), ("leader", leader, True)):
            calibrated(port, "made", leader=led).rename(tmp_path / f"{name}.json")
        move_by_hand(leader, HandOrder("shoulder_pan", 20.0, 0.4))
        for command in COMMANDS:
            runs_policy = command.startswith("lerobot-record ") and "--policy.path" in command
            if command.startswith("hexwire ") or (runs_policy if NEW else command.startswith("lerobot-rollout ")):
                continue
            owner.run(command)
            if command.startswith("cp leader"):
                # LeRobot's own classes find the files, and the same in the servos.
                for own in (
                    SO101Follower(SO101FollowerConfig(port=follower, id="black")),
                    SO101Leader(SO101LeaderConfig(port=leader, id="blue")),
                ):
                    reach(own.bus)
                    assert len(own.calibration) == 6
                    assert patiently(lambda own=own: own.bus.is_calibrated)
                    own.bus.disconnect(disable_torque=False)
            if command.startswith("lerobot-calibrate"):
                assert asked.pop().startswith("Press ENTER to use the calibration in ")
                assert not asked
        made = ("arm-only", "cube") if NEW else ("arm-only", "cube", "eval_cube")
        data = {name: LeRobotDataset(f"me/{name}", video_backend="pyav") for name in made}
        assert {one.meta.robot_type for one in data.values()} == {"so_follower"}
        assert all(len(one) >= 5 for one in data.values())
        assert list(data["cube"].meta.camera_keys) == ["observation.images.front"]
        assert float(data["cube"][4]["action"][0]) == pytest.approx(20.0, abs=3.0)
